"""A side of the cell as a wall sees it, and what a law of the distance alone does there.

The law of a wall is a named tuple whose class has, as static methods, ``force(law, w)``,
``energy(law, w)`` and ``stiffness(law, w)`` of a grain of the first species at the distance w [D],
and ``turning_point_stiffness(law, speed)``, the stiffness per mass where a grain of that speed turns;
``is_behind(law, w)`` where another test than the sign of w is quicker. A law that is more than that
has ``add_forces``, ``add_tangential_forces`` and ``measure_energy_and_stiffness`` instead.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import call_hook

if TYPE_CHECKING:
    from jaxtyping import Float

SIDES = ("left", "right", "bottom", "top")
LEFT, RIGHT, BOTTOM, TOP = range(len(SIDES))
"""Walls in the order in which their forces are entered."""


class WallSide(NamedTuple):
    """A wall's position, and the grains' coordinates as seen from it."""

    position: Float[Array, "m"]  # coordinates across the wall [D]
    along: Float[Array, "m"]  # coordinates along it [D]
    offset: float  # [D]; w = sign * (position - offset)
    sign: float


@compiled
def _zero_function_of_distance(law: Any, w: float) -> float:
    return 0.0


@compiled
def _is_at_negative_distance(law: Any, w: float) -> bool:
    return not w > 0.0


_is_behind = call_hook("is_behind", "w", _is_at_negative_distance)
_force, _energy, _stiffness = (
    call_hook(name, "w", _zero_function_of_distance) for name in ("force", "energy", "stiffness")
)


@compiled(inline=True)
def add_normal_wall_forces(
    law: Any,
    count: int,
    moments: Float[Array, "m"] | None,
    side: WallSide,
    force: Float[Array, "m"],
    normal: Float[Array, "m"],
    tangential: Array | None,
) -> int:
    """Add the forces of a wall away from it, by a law of the distance alone; force, normal [F*]."""
    outside = 0
    for i in range(count):
        w = side.sign * (side.position[i] - side.offset)
        normal[i] = _force(law, w)
        if moments is not None:
            normal[i] *= moments[i]
        force[i] += side.sign * normal[i]
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
