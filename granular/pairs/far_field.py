"""The far field: forces from the smooth far part of the pair law, by a mesh or by direct sums.

The direct far field is the sum over all pairs minus the sum over near pairs. Action and reaction are
equal and no pair is omitted. Time is saved because the sum over all pairs is computed only once in several
steps.

The far forces from a mesh are exactly minus the gradient of the mesh energy, so energy is conserved. The mesh
energy does not depend on distances alone, so momentum is conserved only up to the error of the mesh, unlike
in sums over pairs.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from granular.compiled import Array, compiled, make_optionally_threaded_kernel
from granular.pairs.cut_off_sum import cut_off_sum
from granular.pairs.dipole_law import CUBE, ENERGY, FIFTH_ENERGY
from granular.pairs.direct_sum import allocate_partial_sums, direct_sum
from granular.pairs.grain_arrays import (
    GrainArrays,
    replace_energy_and_closest,
    replace_sums,
    set_forces_to_nan,
    value_or_one,
)
from granular.pairs.mesh_potential import (
    compute_mesh_potential,
    interpolate_potential_and_gradient,
    spread_grains,
)
from granular.pairs.multilevel_mesh import (
    PARTS,
    MultilevelMesh,
    allocate_multilevel_mesh,
    fit_windows_to_grains,
)
from granular.pairs.near_list import positions_are_finite, store_positions
from granular.pairs.periodic_mesh import allocate_periodic_mesh
from granular.pairs.stripes import Stripes
from granular.shared.array_types import Float, Int


class DirectFarFieldWorkspace(NamedTuple):
    """Workspace for the sum over all pairs and the sum over near pairs."""

    near: Float[np.ndarray, "2 m"]  # forces of the near part, along x and y [F*]
    energy_and_closest: Float[np.ndarray, "2 2"]  # first row: all pairs; second row: near pairs
    buffers: Float[np.ndarray, "parts 5 m"] | None  # see `allocate_partial_sums`
    load: Float[np.ndarray, "m"] | None  # near part of the sums for the normal force [1/D^3]


def allocate_direct_far_field(size: int, *, with_loads: bool) -> DirectFarFieldWorkspace:
    """Allocate the arrays of the far field as a difference of direct sums."""
    return DirectFarFieldWorkspace(
        near=np.zeros((2, size)),
        energy_and_closest=np.zeros((2, 2)),
        buffers=allocate_partial_sums(size),
        load=np.zeros(size) if with_loads else None,
    )


@compiled(inline=True)
def _subtract_if_given(values: Array | None, other: Array | None, grains: int) -> None:
    if values is not None and other is not None:
        for i in range(grains):
            values[i] -= other[i]


@compiled
def compute_direct_far_field(
    workspace: DirectFarFieldWorkspace,
    stripes: Stripes,
    radius: float,
    threaded: bool | None,
    grains: int,
    arrays: GrainArrays,
    energy: Float[Array, "1"],
) -> None:
    """Overwrite forces, energy and, if requested, loads with the far part of the law."""
    if not positions_are_finite(arrays.x, arrays.y, grains):
        set_forces_to_nan(arrays, grains)
        return
    forces, total, near = workspace.near, workspace.energy_and_closest[0], workspace.energy_and_closest[1]
    direct_sum(replace_energy_and_closest(arrays, total), workspace.buffers, threaded, None)
    close = replace_sums(arrays, forces[0], forces[1], None, near, workspace.load)
    cut_off_sum(stripes, radius, True, threaded, grains, close)
    _subtract_if_given(arrays.fx, forces[0], grains)
    _subtract_if_given(arrays.fy, forces[1], grains)
    _subtract_if_given(arrays.load, workspace.load, grains)
    energy[0] = ENERGY * (total[0] - near[0])


SPACINGS = 4.5
"""Ratio of the radius beyond which the far field acts to the spacing of the finest mesh. With 4.5 the mesh,
evaluated every eighth step, takes about as long as the near part.
"""

UNCHANGED_DISTANCE = 5e-4
"""Displacement of a grain [D] up to which the far field is taken as unchanged in beds with wall friction.

In a bed as dense as at full compression, with rho grains per D^2, the far field changes by at most 25 rho /
r_c^3 times twice this displacement. At a radius r_c of 6.5 D this is 3e-5 F*, a fifth of the tolerance of the
mesh. If grains move together, the change is far smaller.
"""

UNCHANGED_DISTANCE_EXACT = 5e-5
"""The displacement of `UNCHANGED_DISTANCE` for the direct far field, which has no mesh error; the far field
then changes by 3e-6 F*.
"""

EXTRAPOLATION_STEPS = 8
"""Default number of steps for which the far field is extrapolated linearly while grains slide fast.

The error is of second order in this number. The same holds if the far field is instead applied as an impulse,
once in this number of steps.
"""

TIME, CALLS, CHANGING = range(3)
"""Entries of an array: time of the last evaluation [tau]; number of force evaluations since then; 1 if the
far field is extrapolated.
"""

MAX_POINTS = 1e8
"""Maximum number of points of the finest mesh, with which all levels together take 2 GB of memory."""


class FarFieldSettings(NamedTuple):
    """Settings of the far field of a scene."""

    radius: float  # distance at which the near part ends [D]
    size: tuple[float, float] | None  # width and height of the mesh [D]; None: direct far field
    every: int | None  # steps between impulses; None: the far force is added to every force
    rubbing: int | None = None  # steps between evaluations while grains slide; None: every force
    periodic: bool = False  # the mesh covers a periodic cell of this size
    inverse_fifth_factor: float = 0.0  # of discs: coefficient of r^-5 relative to r^-3 [D^2]
    load_fifth_factor: float = 0.0  # of discs: the same in loads [D^2]


class FarFieldState(NamedTuple):
    """Forces and energy of the last evaluation, and the arrays that compute them."""

    mesh: MultilevelMesh | None
    load_mesh: MultilevelMesh | None  # for loads of discs; shares the arrays of ``mesh``
    direct: DirectFarFieldWorkspace | None  # instead of the mesh: a difference of direct sums
    radius: float  # [D]
    self_potential: float  # potential that a grain of moment 1 has at its own position [1/D^3]
    self_load: float  # load that a grain of weight 1 exerts on itself [1/D^3]
    fx: Float[np.ndarray, "m"]  # [F*]
    fy: Float[np.ndarray, "m"]  # [F*]
    held_forces: Float[np.ndarray, "2 m"] | None  # constant; impulses add the difference [F*]
    load: Float[np.ndarray, "m"] | None  # far part of the sums for the normal force [1/D^3]
    evaluated_at: Float[np.ndarray, "2 m"] | None  # positions at the last evaluation [D]; None: no reuse
    rates: Float[np.ndarray, "3 m"] | None  # time derivatives of fx, fy, load; None: no extrapolation
    extrapolation_steps: int  # maximum number of steps of extrapolation
    unchanged_distance: float  # see `UNCHANGED_DISTANCE` [D]
    timing: Float[np.ndarray, "3"]  # see `TIME` to `CHANGING`
    energy: Float[np.ndarray, "1"]  # [F* D]
    part_totals: Float[np.ndarray, "parts"]  # twice the energy of each part, divided by `ENERGY`


def allocate_far_field_state(field: FarFieldSettings, size: int, *, with_loads: bool) -> FarFieldState:
    """Allocate the far field of a scene, with the mesh or the direct sum that computes it."""
    mesh, load_mesh = _allocate_far_field_mesh(field, field.inverse_fifth_factor, size), None
    if mesh is not None and with_loads and field.load_fifth_factor != field.inverse_fifth_factor:
        other = _allocate_far_field_mesh(field, field.load_fifth_factor, size)
        assert other is not None
        load_mesh = mesh._replace(
            band_along=other.band_along,
            band_across=other.band_across,
            rest_along=other.rest_along,
            rest_across=other.rest_across,
        )
    return FarFieldState(
        mesh=mesh,
        load_mesh=load_mesh,
        direct=allocate_direct_far_field(size, with_loads=with_loads) if mesh is None else None,
        radius=field.radius,
        self_potential=_self_potential(field.radius, field.inverse_fifth_factor),
        self_load=_self_potential(field.radius, field.load_fifth_factor),
        fx=np.zeros(size),
        fy=np.zeros(size),
        # Without these the impulses would push grains at rest back and forth.
        held_forces=None if field.every is None else np.zeros((2, size)),
        load=np.zeros(size) if with_loads else None,
        evaluated_at=None if field.rubbing is None else np.full((2, size), np.nan),
        rates=np.zeros((3, size)) if field.rubbing is not None and field.rubbing > 1 else None,
        extrapolation_steps=field.rubbing or 0,
        unchanged_distance=UNCHANGED_DISTANCE_EXACT if mesh is None else UNCHANGED_DISTANCE,
        timing=np.zeros(3),
        energy=np.zeros(1),
        part_totals=np.zeros(PARTS),
    )


def _allocate_far_field_mesh(field: FarFieldSettings, fifth: float, size: int) -> MultilevelMesh | None:
    if field.size is None:
        return None
    spacing = field.radius / SPACINGS
    if field.periodic:
        return allocate_periodic_mesh(*field.size, field.radius, spacing, fifth)
    return allocate_multilevel_mesh(*field.size, field.radius, spacing, size, fifth)


def _self_potential(radius: float, fifth: float) -> float:
    return CUBE[0] / (radius * radius * radius) + FIFTH_ENERGY[0] * fifth / radius**5


@compiled(inline=True)
def _store_load_if_given(load: Array | None, i: int, value: float) -> None:
    if load is not None:
        load[i] = value


@compiled
def _interpolate_forces_of_part(
    mesh: MultilevelMesh,
    arrays: GrainArrays,
    order: Array,
    grains: int,
    self_potential: float,
    totals: Array,
    part: int,
) -> None:
    """Interpolate the forces on a part of the grains, and their loads if all grains are equal."""
    total = 0.0
    for k in range(part * grains // PARTS, (part + 1) * grains // PARTS):
        i = order[k]
        x, y, q = arrays.x[i], arrays.y[i], value_or_one(arrays.moments, i)
        value, by_x, by_y = interpolate_potential_and_gradient(mesh.points_per_length, mesh, x, y)
        arrays.fx[i] = -ENERGY * q * by_x
        arrays.fy[i] = -ENERGY * q * by_y
        total += q * (value - self_potential * q)
        _store_load_if_given(arrays.load, i, value_or_one(arrays.weight, i) * (value - self_potential))
    totals[part] = total


@compiled
def _interpolate_loads_of_part(
    mesh: MultilevelMesh, arrays: GrainArrays, order: Array, grains: int, self_load: float, part: int
) -> None:
    """Interpolate the loads on a part of the grains from a mesh on which the grains' weights were spread."""
    for k in range(part * grains // PARTS, (part + 1) * grains // PARTS):
        i = order[k]
        value, _, _ = interpolate_potential_and_gradient(
            mesh.points_per_length, mesh, arrays.x[i], arrays.y[i]
        )
        _store_load_if_given(arrays.load, i, value - self_load * value_or_one(arrays.weight, i))


@make_optionally_threaded_kernel
def _interpolate_forces(
    mesh: MultilevelMesh, arrays: GrainArrays, order: Array, grains: int, self_potential: float, totals: Array
) -> None:
    for part in numba.prange(PARTS):
        _interpolate_forces_of_part(mesh, arrays, order, grains, self_potential, totals, part)


@make_optionally_threaded_kernel
def _interpolate_loads(
    mesh: MultilevelMesh, arrays: GrainArrays, order: Array, grains: int, self_load: float
) -> None:
    for part in numba.prange(PARTS):
        _interpolate_loads_of_part(mesh, arrays, order, grains, self_load, part)


@compiled(inline=True)
def _fit_windows_unless_periodic(
    points_per_length: Array | None, mesh: MultilevelMesh, x: Array, y: Array, grains: int
) -> bool:
    return True if points_per_length is not None else fit_windows_to_grains(mesh, x, y, grains)


@compiled(inline=True)
def _compute_loads_unless_equal_dipoles(
    weight: Array | None,
    moments: Array | None,
    load_mesh: MultilevelMesh | None,
    mesh: MultilevelMesh,
    threaded: bool | None,
    arrays: GrainArrays,
    order: Array,
    grains: int,
    self_load: float,
) -> None:
    """Compute the loads of discs and unequal grains; loads of equal dipoles are computed with the forces."""
    if weight is not None:
        if load_mesh is not None:
            _compute_loads(load_mesh, threaded, weight, arrays, order, grains, self_load)
        elif moments is not None:
            _compute_loads(mesh, threaded, weight, arrays, order, grains, self_load)


@compiled
def _compute_loads(
    mesh: MultilevelMesh,
    threaded: bool | None,
    weight: Array,
    arrays: GrainArrays,
    order: Array,
    grains: int,
    self_load: float,
) -> None:
    spread_grains(mesh.points_per_length, mesh, threaded, arrays.x, arrays.y, weight, order, grains)
    compute_mesh_potential(mesh.points_per_length, mesh, threaded)
    _interpolate_loads(threaded, mesh, arrays, order, grains, self_load)


@compiled
def compute_mesh_far_field(
    mesh: MultilevelMesh,
    far: FarFieldState,
    threaded: bool | None,
    grains: int,
    arrays: GrainArrays,
    order: Int[Array, "m"],
) -> int:
    """Compute far forces, energy and (with friction) loads with the mesh; return 1 if the mesh overflows."""
    if grains == 0:
        return 0
    x, y = arrays.x, arrays.y
    if not positions_are_finite(x, y, grains):
        set_forces_to_nan(arrays, grains)
        return 0
    if not _fit_windows_unless_periodic(mesh.points_per_length, mesh, x, y, grains):
        far.energy[0] = np.nan
        return 1
    spread_grains(mesh.points_per_length, mesh, threaded, x, y, arrays.moments, order, grains)
    compute_mesh_potential(mesh.points_per_length, mesh, threaded)
    _interpolate_forces(threaded, mesh, arrays, order, grains, far.self_potential, far.part_totals)
    total = 0.0
    for part in range(PARTS):
        total += far.part_totals[part]
    far.energy[0] = 0.5 * ENERGY * total
    store_positions(far.evaluated_at, x, y, grains)
    _compute_loads_unless_equal_dipoles(
        arrays.weight, arrays.moments, far.load_mesh, mesh, threaded, arrays, order, grains, far.self_load
    )
    return 0
