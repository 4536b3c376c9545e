"""A side of the cell, with the forces and energies of a wall law, for the compiled loop.

A side is a line with a unit normal n into the cell and a unit tangent t. A grain at r is at the distance w =
n.r - c from the line, and at the position t.r - a along the line. The side moves vertically with its body,
which is the cell or a piston.

A wall law is a named tuple. Its class has the static methods ``force(law, w)``, ``energy(law, w)`` and
``stiffness(law, w)`` for a grain of the first species at distance w [D]. The static method
``turning_point_stiffness(law, speed)`` returns the stiffness per mass at the turning point of a grain of that
speed. ``is_behind(law, w)`` is optional; it replaces the test of the sign of w by a faster test. If a law
depends also on the position along the wall, its class has ``add_forces`` and ``measure_energy_and_stiffness``
instead.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from granular.compiled import Array, compiled, entry
from granular.compiled.hook_calls import make_hook_call_kernel
from granular.kernel_data.state import CELL, HEIGHT, SPEED, Bed, relative_moments
from granular.pairs.direct_sum import reproducible_sum
from granular.pairs.grain_arrays import value_or_one
from granular.shared.array_types import Float

PARALLEL = 1e-9
"""Sides count as parallel if the sine of the angle between them is at most this value."""


class GrainsRelativeToWall(NamedTuple):
    """Positions and forces of the grains, and the geometry of a wall, at one time."""

    x: Float[Array, "m"]  # [D]
    y: Float[Array, "m"]  # [D]
    fx: Float[Array, "m"]  # forces on the grains [F*]
    fy: Float[Array, "m"]  # [F*]
    nx: float  # unit normal into the cell
    ny: float
    offset: float  # [D]; w = n.r - offset
    tx: float  # unit vector along the wall
    ty: float
    begin: float  # [D]; the position along the wall is t.r - begin


@compiled(inline=True)
def distance_from_wall(view: GrainsRelativeToWall, i: int) -> float:
    """Distance of a grain from a wall, negative behind it [D]."""
    return view.nx * view.x[i] + (view.ny * view.y[i] - view.offset)


@compiled(inline=True)
def position_along_wall(view: GrainsRelativeToWall, i: int) -> float:
    """Position of a grain along a wall [D]."""
    return view.tx * view.x[i] + (view.ty * view.y[i] - view.begin)


@compiled(inline=True)
def add_wall_force_to_grain(view: GrainsRelativeToWall, i: int, normal: float, along: float) -> None:
    """Add the normal and the tangential force of a wall [F*] to the force on a grain."""
    view.fx[i] += view.nx * normal + view.tx * along
    view.fy[i] += view.ny * normal + view.ty * along


@compiled
def zero_for_open_side(law: Any, value: float) -> float:
    """Return 0, the force and stiffness of an open side."""
    return 0.0


@compiled
def _is_at_negative_distance(law: Any, w: float) -> bool:
    return not w > 0.0


_is_behind = make_hook_call_kernel("is_behind", "w", _is_at_negative_distance)
force_at_distance, _energy, _stiffness = (
    make_hook_call_kernel(name, "w", zero_for_open_side) for name in ("force", "energy", "stiffness")
)


@compiled(inline=True)
def add_normal_wall_forces(
    law: Any,
    count: int,
    moments: Float[Array, "m"] | None,
    view: GrainsRelativeToWall,
    normal: Float[Array, "m"],
) -> int:
    """Add forces of a wall law that depends only on the distance; store them in ``normal`` [F*]."""
    # Vertical and level walls use one coordinate: with both, a step of 92 grains took about 2 % longer.
    if view.ny == 0.0:
        return _add_forces_along_axis(law, count, moments, view.x, view.fx, view.nx, view.offset, normal)
    if view.nx == 0.0:
        return _add_forces_along_axis(law, count, moments, view.y, view.fy, view.ny, view.offset, normal)
    outside = 0
    for i in range(count):
        w = distance_from_wall(view, i)
        normal[i] = force_at_distance(law, w) * value_or_one(moments, i)
        view.fx[i] += view.nx * normal[i]
        view.fy[i] += view.ny * normal[i]
        outside += _is_behind(law, w)
    return outside


@compiled(inline=True)
def _add_forces_along_axis(
    law: Any,
    count: int,
    moments: Array | None,
    position: Array,
    force: Array,
    sign: float,
    offset: float,
    normal: Array,
) -> int:
    outside = 0
    for i in range(count):
        w = sign * position[i] - offset
        normal[i] = force_at_distance(law, w) * value_or_one(moments, i)
        force[i] += sign * normal[i]
        outside += _is_behind(law, w)
    return outside


@compiled
def add_wall_energies(
    law: Any,
    count: int,
    view: GrainsRelativeToWall,
    stiffness: Float[Array, "m"],
    energies: Float[Array, "m"],
) -> None:
    """Store the energies [F* D] of grains of moment 1 at a wall; add their stiffness [F*/D]."""
    for i in range(count):
        w = distance_from_wall(view, i)
        energies[i] = _energy(law, w)
        stiffness[i] += _stiffness(law, w)


_forces = make_hook_call_kernel("add_forces", "count moments view normal", add_normal_wall_forces)
_energies = make_hook_call_kernel(
    "measure_energy_and_stiffness", "count view stiffness energies", add_wall_energies
)
_turning_point_stiffness = make_hook_call_kernel("turning_point_stiffness", "speed", zero_for_open_side)


class Side(NamedTuple):
    """A straight side of the cell, in the frame of its body, with its law; an open side has the law None."""

    nx: float  # unit normal into the cell
    ny: float
    offset: float  # [D]
    tx: float  # unit vector along it
    ty: float
    begin: float  # [D]
    body: int  # row of the body with which it moves
    law: Any

    @staticmethod
    @compiled(inline=True)
    def add_forces(side: Side, workspace: Any, index: int, bed: Bed) -> int:
        """Add a wall's forces to the grains, and store the outward force on the wall [F*]."""
        if side.law is None:
            return 0
        state, constants = bed.state, bed.constants
        moments = relative_moments(constants)
        outside = _forces(
            side.law, constants.grains, moments, grains_relative_to_side(side, bed), state.scratch
        )
        state.wall_forces[index] = reproducible_sum(state.scratch)
        # The force may be NaN behind a wall and infinite at the wall; either shows in the total.
        return outside + (not state.wall_forces[index] < math.inf)

    @staticmethod
    @compiled
    def energy_and_add_stiffness(side: Side, workspace: Any, index: int, bed: Bed, stiffness: Array) -> float:
        """Return the energy of the grains at a wall [F* D]; add their stiffness at moment 1 [F*/D]."""
        return _wall_energy_and_add_stiffness(side, bed, stiffness)

    @staticmethod
    @compiled
    def add_stiffness_against_body(
        side: Side, workspace: Any, index: int, bed: Bed, body: int, slopes: Array
    ) -> float:
        """Add the stiffness of grains of moment 1 at a side of a body [F*/D]."""
        return _wall_energy_and_add_stiffness(side, bed, slopes) if side.body == body else 0.0

    @staticmethod
    @compiled(inline=True)
    def upward_force(side: Side, workspace: Any, index: int, forces: Array, body: int) -> float:
        """Upward force of the grains on a side of a body [F*]."""
        return -side.ny * forces[index] if side.body == body else 0.0

    @staticmethod
    @compiled(inline=True)
    def pressing_force(
        side: Side, workspace: Any, index: int, x: float, y: float, tx: float, ty: float
    ) -> float:
        """Force [F*] of a side on a grain of moment 1 at x, y [D]; 0 if the side is not along (tx, ty)."""
        if abs(side.tx * ty - side.ty * tx) > PARALLEL:
            return 0.0
        return force_at_distance(side.law, side.nx * x + (side.ny * y - side.offset))

    @staticmethod
    @compiled
    def fill_normal_offset_and_speed(side: Side, workspace: Any, index: int, bed: Bed, walls: Array) -> int:
        """Store normal, offset [D] (-inf if open) and vertical speed [D/tau] of a side in ``walls``."""
        view = grains_relative_to_side(side, bed)
        offset = -math.inf if side.law is None else view.offset
        lift = bed.state.bodies[side.body, SPEED] if side.body != CELL else 0.0
        walls[index, 0], walls[index, 1], walls[index, 2], walls[index, 3] = side.nx, side.ny, offset, lift
        return 0

    @staticmethod
    @compiled
    def turning_point_stiffness(side: Side, workspace: Any, index: int, speed: float) -> float:
        """Stiffness per mass at the turning point of a grain of moment 1 [1/tau^2]; speed [D/tau]."""
        return _turning_point_stiffness(side.law, speed)


@compiled(inline=True)
def grains_relative_to_side(side: Side, bed: Bed) -> GrainsRelativeToWall:
    """Return the grains of a bed relative to a side at the side's current position."""
    state = bed.state
    height = state.bodies[side.body, HEIGHT] if side.body != CELL else 0.0
    return _make_grains_relative_to_wall(side, state.x, state.y, state.fx, state.fy, height)


@compiled(inline=True)
def _make_grains_relative_to_wall(
    side: Side, x: Array, y: Array, fx: Array, fy: Array, height: float
) -> GrainsRelativeToWall:
    offset, begin = side.offset + side.ny * height, side.begin + side.ty * height
    return GrainsRelativeToWall(x, y, fx, fy, side.nx, side.ny, offset, side.tx, side.ty, begin)


@entry
def add_wall_forces(
    side: Side,
    x: Float[Array, "n"],
    y: Float[Array, "n"],
    height: float,
    moments: Float[Array, "n"],
    forces: Float[Array, "3 n"],
) -> int:
    """Add the x, y and normal components of a wall's forces on grains [F*]; x, y, body's height [D]."""
    return _forces(
        side.law,
        x.size,
        moments,
        _make_grains_relative_to_wall(side, x, y, forces[0], forces[1], height),
        forces[2],
    )


@compiled
def _wall_energy_and_add_stiffness(side: Side, bed: Bed, stiffness: Array) -> float:
    if side.law is None:
        return 0.0
    energies, constants = bed.state.scratch, bed.constants
    moments = relative_moments(constants)
    _energies(side.law, constants.grains, grains_relative_to_side(side, bed), stiffness, energies)
    for i in range(constants.grains):
        energies[i] *= value_or_one(moments, i)
    return reproducible_sum(energies)
