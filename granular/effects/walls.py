"""The walls of the cell: left, right, bottom, and the piston as the top. Each has a law of its own.

The force on every wall is the sum of the reactions of the grains; that of the top wall is the
piston force.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from granular.compiled import Array, compiled
from granular.effects import wall_experimental
from granular.pairs.vector import lane_sum
from granular.schema import Section, choice, one

LAWS = ("experimental",)
SIDES = ("left", "right", "bottom", "top")


class Wall(Section):
    """One wall.

    Attributes
    ----------
    law : str
        ``"experimental"``: force proportional to distance^-3.5 [D, eq. 2.8].
    """

    law: str = choice(*LAWS, default="experimental")

    @classmethod
    def build(cls, plain: Any, diameter: float | None = None) -> Wall:
        return super().build({"law": plain} if isinstance(plain, str) else plain, diameter)


class Walls(Section):
    """The four walls; the top is the piston. ``"none"`` leaves a side open."""

    left: Wall | None = one(Wall, default=Wall(), optional=True)
    right: Wall | None = one(Wall, default=Wall(), optional=True)
    bottom: Wall | None = one(Wall, default=Wall(), optional=True)
    top: Wall | None = one(Wall, default=Wall(), optional=True)

    def kernel(self) -> WallLaws:
        return WallLaws(*(_law(getattr(self, side)) for side in SIDES))


class Law(NamedTuple):
    """The law of one wall as the kernels take it: exactly one field is not None."""

    experimental: bool | None = None


class WallLaws(NamedTuple):
    left: Law | None
    right: Law | None
    bottom: Law | None
    top: Law | None


def _law(wall: Wall | None) -> Law | None:
    return None if wall is None else Law(**{wall.law: True})


@compiled
def _press(
    experimental: bool | None,
    count: int,
    charge: Array | None,
    place: Array,
    offset: float,
    sign: float,
    force: Array,
    push: Array,
) -> int:
    outside = 0
    if experimental is not None:
        for i in range(count):
            w = sign * (place[i] - offset)
            push[i] = wall_experimental.force(w)
            outside += not w > 0.0
    if charge is not None:
        for i in range(count):
            push[i] *= charge[i]
    for i in range(count):
        force[i] += sign * push[i]
    return outside


@compiled
def _press_side(
    law: Law | None,
    side: int,
    count: int,
    charge: Array | None,
    place: Array,
    offset: float,
    sign: float,
    force: Array,
    push: Array,
    totals: Array,
) -> int:
    if law is None:
        return 0
    outside = _press(law.experimental, count, charge, place, offset, sign, force, push)
    totals[side] = lane_sum(push)
    return outside


@compiled
def add_wall_forces(
    laws: WallLaws,
    count: int,
    charge: Array | None,
    x: Array,
    y: Array,
    fx: Array,
    fy: Array,
    width: float,
    height: float,
    push: Array,
    totals: Array,
) -> int:
    """Add the walls' forces on the grains.

    Parameters
    ----------
    laws : WallLaws
    width, height : float
        Cell width and piston height [D].
    push : float64 (m,)
        Scratch, zero behind the grains.
    totals : float64 (4,)
        Overwritten by the force on each wall, in the order of `SIDES` [F*].

    Returns
    -------
    int
        How many times a grain stands on the wrong side of a wall, or is at no number.
    """
    return (
        _press_side(laws.left, 0, count, charge, x, 0.0, 1.0, fx, push, totals)
        + _press_side(laws.right, 1, count, charge, x, width, -1.0, fx, push, totals)
        + _press_side(laws.bottom, 2, count, charge, y, 0.0, 1.0, fy, push, totals)
        + _press_side(laws.top, 3, count, charge, y, height, -1.0, fy, push, totals)
    )


@compiled
def _measure(
    experimental: bool | None,
    count: int,
    charge: Array | None,
    place: Array,
    offset: float,
    sign: float,
    stiffness: Array,
    push: Array,
) -> float:
    if experimental is not None:
        for i in range(count):
            w = sign * (place[i] - offset)
            push[i] = wall_experimental.energy(w)
            stiffness[i] += wall_experimental.stiffness(w)
    if charge is not None:
        for i in range(count):
            push[i] *= charge[i]
    return lane_sum(push)


@compiled
def _measure_side(
    law: Law | None,
    count: int,
    charge: Array | None,
    place: Array,
    offset: float,
    sign: float,
    stiffness: Array,
    push: Array,
) -> float:
    if law is None:
        return 0.0
    return _measure(law.experimental, count, charge, place, offset, sign, stiffness, push)


@compiled
def measure_walls(
    laws: WallLaws,
    count: int,
    charge: Array | None,
    x: Array,
    y: Array,
    width: float,
    height: float,
    stiffness: Array,
    push: Array,
) -> float:
    """Energy of the grains at the walls [F* D]; adds each wall's stiffness over the grain's mass.

    The stiffness per mass is that of a grain of the first species: charge and mass have the same
    ratio for every species.
    """
    return (
        _measure_side(laws.left, count, charge, x, 0.0, 1.0, stiffness, push)
        + _measure_side(laws.right, count, charge, x, width, -1.0, stiffness, push)
        + _measure_side(laws.bottom, count, charge, y, 0.0, 1.0, stiffness, push)
        + _measure_side(laws.top, count, charge, y, height, -1.0, stiffness, push)
    )


@compiled
def _top_stiffness(
    experimental: bool | None, count: int, charge: Array | None, y: Array, height: float
) -> tuple[float, float]:
    total = 0.0
    largest = 0.0
    if experimental is not None:
        for i in range(count):
            slope = wall_experimental.stiffness(height - y[i])
            largest = max(largest, slope)
            total += slope if charge is None else slope * charge[i]
    return total, largest


@compiled
def piston_stiffness(
    law: Law | None, count: int, charge: Array | None, y: Array, height: float
) -> tuple[float, float]:
    """Stiffness of all grains against the piston [F*/D], and the largest of one grain per mass."""
    if law is None:
        return 0.0, 0.0
    return _top_stiffness(law.experimental, count, charge, y, height)


@compiled
def _turning(experimental: bool | None, speed: float) -> float:
    square = 0.0
    if experimental is not None:
        square = wall_experimental.turning_stiffness(speed)
    return square


@compiled
def _turning_side(law: Law | None, speed: float) -> float:
    if law is None:
        return 0.0
    return _turning(law.experimental, speed)


@compiled
def turning_stiffness(laws: WallLaws, speed: float) -> float:
    """Largest stiffness per mass [1/tau^2] that a grain of this speed meets at any wall."""
    return max(
        _turning_side(laws.left, speed),
        _turning_side(laws.right, speed),
        _turning_side(laws.bottom, speed),
        _turning_side(laws.top, speed),
    )
