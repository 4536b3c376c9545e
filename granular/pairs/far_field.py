"""The far field: what the smooth far part of the pair law does to the grains, from a mesh.

Forces are the exact gradient of the mesh's energy. The mesh is no function of distances alone, so
momentum is not kept to the last bit, as it is by sums over pairs; energy is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects.dipole import ENERGY
from granular.pairs.mesh import (
    Mesh,
    find_potential,
    gathered,
    mesh_room,
    open_windows,
    spread,
)
from granular.pairs.split import CUBE
from granular.pairs.stripes import finite

SPACINGS = 4.5
"""Of the finest mesh, in the split radius. With 4.5 the mesh takes about as long as the near part
where it is met every eighth step."""

MOST_POINTS = 1e8
"""Of the finest mesh: all of them take two gigabytes."""


class FarField(NamedTuple):
    """The far field of a scene.

    Attributes
    ----------
    radius : float
        Where the near part ends [D].
    width, height : float
        Of the room for grains [D].
    every : int or None
        Steps from one evaluation to the next, whose force then acts as an impulse; None where the
        far force is a part of every force.
    """

    radius: float
    width: float
    height: float
    every: int | None


class FarForces(NamedTuple):
    """A mesh, and the forces and the energy that were last found with it.

    Attributes
    ----------
    mesh : Mesh
    radius : float
    fx, fy : float64 (m,)
    held : float64 (2, m) or None
        A force that stays as it is and acts all the time, where the far field acts in impulses:
        they make up the difference. Without it, grains at rest would be pushed to and fro. None
        where the far field is a part of every force.
    load : float64 (m,) or None
        Far part of the sums behind the normal force of friction.
    energy : float64 (1,)
    """

    mesh: Mesh
    radius: float
    fx: np.ndarray
    fy: np.ndarray
    held: np.ndarray | None
    load: np.ndarray | None
    energy: np.ndarray


def far_forces_room(field: FarField, size: int, *, loaded: bool) -> FarForces:
    """Room for that many grains (padded)."""
    return FarForces(
        mesh=mesh_room(field.width, field.height, field.radius, field.radius / SPACINGS),
        radius=field.radius,
        fx=np.zeros(size),
        fy=np.zeros(size),
        held=None if field.every is None else np.zeros((2, size)),
        load=np.zeros(size) if loaded else None,
        energy=np.zeros(1),
    )


@compiled
def _gather_forces(
    far: FarForces, x: Array, y: Array, moments: Array | None, weight: Array | None, grains: int
) -> None:
    own = CUBE[0] / (far.radius * far.radius * far.radius)
    total = 0.0
    for i in range(grains):
        value, by_x, by_y = gathered(far.mesh, x[i], y[i])
        q = 1.0 if moments is None else moments[i]
        far.fx[i] = -ENERGY * q * by_x
        far.fy[i] = -ENERGY * q * by_y
        total += q * (value - own * q)
        if far.load is not None and weight is not None:
            # Grains that are all alike have one weight.
            far.load[i] = weight[i] * (value - own)
    far.energy[0] = 0.5 * ENERGY * total


@compiled
def _gather_load(far: FarForces, x: Array, y: Array, weight: Array, grains: int) -> None:
    if far.load is not None:
        own = CUBE[0] / (far.radius * far.radius * far.radius)
        for i in range(grains):
            value, _, _ = gathered(far.mesh, x[i], y[i])
            far.load[i] = value - own * weight[i]


@compiled
def find_far_forces(
    far: FarForces, threaded: bool | None, grains: int, x: Array, y: Array,
    moments: Array | None, weight: Array | None,
) -> int:  # fmt: skip
    """Find forces, energy and, where grains rub, load of the far part; 1 where there is no room.

    Parameters
    ----------
    far : FarForces
    threaded : bool or None
        As in `granular.pairs.direct.direct_sum`.
    grains : int
    x, y, moments, weight
        As in `granular.pairs.direct.direct_sum`.
    """
    if grains == 0:
        return 0
    if not finite(x, y, grains):
        far.fx[:grains] = np.nan
        far.fy[:grains] = np.nan
        return 0
    if not open_windows(far.mesh, x, y, grains):
        far.energy[0] = np.nan
        return 1
    spread(far.mesh, x, y, moments, grains)
    find_potential(far.mesh, threaded)
    _gather_forces(far, x, y, moments, weight, grains)
    if weight is not None and moments is not None:
        spread(far.mesh, x, y, weight, grains)
        find_potential(far.mesh, threaded)
        _gather_load(far, x, y, weight, grains)
    return 0
