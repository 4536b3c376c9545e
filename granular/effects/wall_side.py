"""A side of the cell as a wall sees it, and what a law of the distance alone does there.

The law of a wall is a named tuple whose class has, as static methods, ``force(law, w)``,
``energy(law, w)`` and ``stiffness(law, w)`` of a grain of the first species at the distance w [D],
and ``turning_point_stiffness(law, speed)``, the stiffness per mass where a grain of that speed turns;
``is_behind(law, w)`` where another test than the sign of w is quicker. A law that is more than that
has ``add_forces`` and ``measure_energy_and_stiffness`` instead.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import call_hook
from granular.kernel_data.state import HEIGHT, Bed
from granular.pairs.grain_arrays import value_or_one

if TYPE_CHECKING:
    from jaxtyping import Float

SIDES = ("left", "right", "bottom", "top")
LEFT, RIGHT, BOTTOM, TOP = range(len(SIDES))
"""Walls in the order in which their forces are entered."""


class WallSide(NamedTuple):
    """A wall's position, and the grains' coordinates as seen from it."""

    position: Float[Array, "m"]  # coordinates across the wall [D]
    along: Float[Array, "m"]  # coordinates along it [D]
    force: Float[Array, "m"]  # on the grains, in the direction of ``position`` [F*]
    force_along: Float[Array, "m"]  # [F*]
    offset: float  # [D]; w = sign * (position - offset)
    sign: float


@compiled(inline=True)
def sides_of_cell(bed: Bed) -> tuple[WallSide, WallSide, WallSide, WallSide]:
    """Return the walls of a bed, in the order of `SIDES`."""
    state = bed.state
    x, y, fx, fy = state.x, state.y, state.fx, state.fy
    return (
        WallSide(x, y, fx, fy, 0.0, 1.0),
        WallSide(x, y, fx, fy, bed.constants.width, -1.0),
        WallSide(y, x, fy, fx, 0.0, 1.0),
        WallSide(y, x, fy, fx, state.piston[HEIGHT], -1.0),
    )


@compiled
def zero_of_no_law(law: Any, value: float) -> float:
    """Return 0, for a side that is open."""
    return 0.0


@compiled
def _is_at_negative_distance(law: Any, w: float) -> bool:
    return not w > 0.0


_is_behind = call_hook("is_behind", "w", _is_at_negative_distance)
force_at_distance, _energy, _stiffness = (
    call_hook(name, "w", zero_of_no_law) for name in ("force", "energy", "stiffness")
)


@compiled(inline=True)
def add_normal_wall_forces(
    law: Any, count: int, moments: Float[Array, "m"] | None, side: WallSide, normal: Float[Array, "m"]
) -> int:
    """Add the forces of a wall by a law of the distance alone; fill in ``normal`` [F*]."""
    outside = 0
    for i in range(count):
        w = side.sign * (side.position[i] - side.offset)
        normal[i] = force_at_distance(law, w) * value_or_one(moments, i)
        side.force[i] += side.sign * normal[i]
        outside += _is_behind(law, w)
    return outside


@compiled
def add_wall_energies(
    law: Any, count: int, side: WallSide, stiffness: Float[Array, "m"], energies: Float[Array, "m"]
) -> None:
    """Fill in the energies at a wall of grains of moment 1 [F* D], and add their stiffness [F*/D]."""
    for i in range(count):
        w = side.sign * (side.position[i] - side.offset)
        energies[i] = _energy(law, w)
        stiffness[i] += _stiffness(law, w)
