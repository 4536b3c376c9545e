"""A machine that carries the cell or the piston, as matrices: the bodies of `effects.host`.

The coordinates of the bodies are their displacements over the base, from where all is at rest: springs hold
all weights. The frame of the cell moves as the last body, or, if that carries the piston, as the last body
less the piston's height. Each mass in the cell has its velocity in the frame plus the frame's.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.effects.force_effect import ForceEffect
from granular.effects.host_structure import Host
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales

if TYPE_CHECKING:
    from jaxtyping import Float
    from scipy.sparse import csc_matrix


@dataclasses.dataclass(frozen=True, eq=False)
class Machine:
    """Matrices of a machine's bodies."""

    masses: Float[np.ndarray, "b"]  # [kg]
    springs: Float[np.ndarray, "b b"]  # [N/m]
    dashpots: Float[np.ndarray, "b b"]  # [N s/m]
    free_cell_mass: float | None  # of a cell that hangs on the bed, which the piston carries [kg]
    weight_on_piston: float | None  # then [N]

    def frame(self, size: int, piston: int | None) -> Float[np.ndarray, "q"]:
        """Displacement of the cell over the base as a row of the coordinates."""
        result = np.zeros(size)
        result[-1] = 1.0
        if self.free_cell_mass is not None:
            result[piston] = -1.0
        return result

    def mass_matrix(self, masses: Float[np.ndarray, "q"], piston: int | None) -> csc_matrix:
        """Mass matrix of all coordinates, from the masses of grains (twice) and piston [kg]."""
        from scipy.sparse import csc_matrix

        size = len(masses)
        count = size - len(self.masses)
        vertical = np.zeros(size)
        vertical[(count - (piston is not None)) // 2 : count] = 1.0
        carried = csc_matrix((masses * vertical)[:, None])
        row = csc_matrix(self.frame(size, piston)[None])
        total = float(masses @ vertical) + (self.free_cell_mass or 0.0)
        diagonal = masses.copy()
        diagonal[count:] = self.masses
        diagonal = csc_matrix((diagonal, (range(size), range(size))))
        return csc_matrix(diagonal + carried @ row + (carried @ row).T + total * (row.T @ row))


def machine_of(scene: Scene) -> Machine | None:
    """Return the machine of a scene; None without bodies."""
    host: Any = next((effect for effect in scene.effects.acting if effect.key == "host"), None)
    if host is None or not host.bodies:
        return None
    scales = Scales.from_grains(scene.grains)
    gravity = sum(
        effect.downward_acceleration(scales)
        for effect in scene.effects.acting
        if isinstance(effect, ForceEffect)
    )
    weight = host.weight_on_piston(scene.grains, scales, gravity)
    return Machine(
        *matrices_of_bodies(host),
        free_cell_mass=host.cell_mass,
        weight_on_piston=None if weight is None else weight * scales.force,
    )


def matrices_of_bodies(
    host: Host,
) -> tuple[Float[np.ndarray, "b"], Float[np.ndarray, "b b"], Float[np.ndarray, "b b"]]:
    """Masses [kg], and matrices of springs [N/m] and dashpots [N s/m], of a host's bodies."""
    masses, springs, dashpots = np.array(
        [(body.mass, body.stiffness, body.damping) for body in host.bodies]
    ).T
    return masses, _chain_matrix(springs), _chain_matrix(dashpots)


def _chain_matrix(values: Float[np.ndarray, "b"]) -> Float[np.ndarray, "b b"]:
    """Matrix of a chain of springs or dashpots, each between a body and the one before, or the base."""
    differences = np.eye(len(values)) - np.eye(len(values), k=-1)
    return differences.T @ (values[:, None] * differences)
