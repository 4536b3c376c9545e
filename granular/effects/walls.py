"""The walls of the cell: left, right, bottom, and the piston as the top. Each has a law of its own.

The force on every wall is the sum of the reactions of the grains; that of the top wall is the
piston force.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects import wall_experimental, wall_infinite, wall_slab
from granular.pairs.vector import lane_sum
from granular.scene.schema import FieldError, Section, choice, one, quantity

LAWS = ("experimental", "infinite", "slab")
SIDES = ("left", "right", "bottom", "top")
LEFT, RIGHT, BOTTOM, TOP = range(len(SIDES))


class Wall(Section):
    """One wall.

    Attributes
    ----------
    law : str
        ``"experimental"``: force ~ distance^-3.5 [D, eq. 2.8]; ``"infinite"``: ~ distance^-3
        [D, eq. 3.3]; ``"slab"``: a magnetic slab of finite length [D, eq. 3.17].
    length : float or None
        Of a slab [m], from the corner at the origin. Must be given for a slab at the side; the
        bottom and the piston are as long as the cell is wide.
    gap_start, gap_end : float or None
        A gap in a bottom slab, along x [m]: two slabs, between which grains flow out.
    """

    law: str = choice(*LAWS, default="experimental")
    length: float | None = quantity("m", above=0.0, default=None, optional=True)
    gap_start: float | None = quantity("m", least=0.0, default=None, optional=True)
    gap_end: float | None = quantity("m", above=0.0, default=None, optional=True)

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Wall:
        return super().from_plain({"law": plain} if isinstance(plain, str) else plain, diameter)

    @property
    def has_gap(self) -> bool:
        return self.gap_start is not None

    def validate(self) -> None:
        if self.law != "slab" and (self.length is not None or self.has_gap):
            raise FieldError(f"only a slab has a length or a gap; this wall is {self.law!r}", "law")
        if (self.gap_start is None) != (self.gap_end is None):
            raise FieldError("give both ends of the gap", "gap_start")
        if self.has_gap and not (self.gap_end or 0.0) > (self.gap_start or 0.0):
            raise FieldError(
                f"{self.gap_end:g} m must be above gap_start, {self.gap_start:g} m", "gap_end"
            )

    def kernel(self, width: float, unit: float) -> WallLaw:
        """The law in natural units, for a cell of that width [m] and the length unit D [m]."""
        if self.law == "experimental":
            return WallLaw(experimental=True)
        if self.law == "infinite":
            return WallLaw(infinite=True)
        ends = [0.0, width if self.length is None else self.length]
        if self.gap_start is not None and self.gap_end is not None:
            ends = [0.0, self.gap_start, self.gap_end, ends[1]]
        natural = np.array(ends) / unit
        return WallLaw(slab=Slab(natural[::2].copy(), natural[1::2].copy(), not self.has_gap))


class Walls(Section):
    """The four walls; the top is the piston. ``"none"`` leaves a side open."""

    left: Wall | None = one(Wall, default=Wall(), optional=True)
    right: Wall | None = one(Wall, default=Wall(), optional=True)
    bottom: Wall | None = one(Wall, default=Wall(), optional=True)
    top: Wall | None = one(Wall, default=Wall(), optional=True)

    def validate(self) -> None:
        for side in SIDES:
            wall = getattr(self, side)
            if wall is None:
                continue
            if wall.has_gap and side != "bottom":
                raise FieldError("only the bottom can have a gap", side, "gap_start")
            upright = side in ("left", "right")
            if wall.law == "slab" and wall.length is None and upright:
                raise FieldError("must be given for a slab at the side", side, "length")
            if wall.length is not None and not upright:
                raise FieldError("is the cell's width here; leave it out", side, "length")

    def check_size(self, width: float, height: float | None) -> None:
        """Raise `FieldError` unless slabs fit a cell of that width and piston height [m]."""
        bottom = self.bottom
        if bottom is not None and bottom.gap_end is not None and bottom.gap_end > width:
            raise FieldError(
                f"{bottom.gap_end:g} m must be at most the cell's width, {width:g} m",
                "bottom",
                "gap_end",
            )
        for side in ("left", "right"):
            wall = getattr(self, side)
            if wall is not None and wall.length is not None and wall.length < (height or 0.0):
                raise FieldError(
                    f"{wall.length:g} m is less than the piston's height, {height:g} m; grains "
                    "would come behind the slab",
                    side,
                    "length",
                )

    @property
    def sides(self) -> tuple[Wall | None, ...]:
        """In the order of `SIDES`; None where a side is open."""
        return tuple(getattr(self, side) for side in SIDES)

    @property
    def has_slab(self) -> bool:
        return any(wall is not None and wall.law == "slab" for wall in self.sides)

    @property
    def has_gap(self) -> bool:
        return self.bottom is not None and self.bottom.has_gap

    def kernel(self, width: float, unit: float) -> WallLaws:
        """The laws in natural units; see `Wall.kernel`."""
        return WallLaws(
            *(None if wall is None else wall.kernel(width, unit) for wall in self.sides)
        )


class Slab(NamedTuple):
    """One or two slabs in a line.

    Attributes
    ----------
    starts, ends : float64 (k,)
        Where each slab begins and ends along the wall [D].
    closed : bool
        Whether no grain can come behind it.
    """

    starts: Array
    ends: Array
    closed: bool


class WallLaw(NamedTuple):
    """The law of one wall as the kernels take it: exactly one field is not None."""

    experimental: bool | None = None
    infinite: bool | None = None
    slab: Slab | None = None


class WallLaws(NamedTuple):
    """The law of each side; None is open."""

    left: WallLaw | None
    right: WallLaw | None
    bottom: WallLaw | None
    top: WallLaw | None


OPEN = WallLaws(None, None, None, None)


class Side(NamedTuple):
    """A wall's place, and the grains' coordinates as seen from it.

    Attributes
    ----------
    place, along : float64 (m,)
        Coordinates of the grains across and along the wall [D].
    offset, sign : float
        The distance from the wall is sign * (place - offset).
    """

    place: Array
    along: Array
    offset: float
    sign: float


@compiled(inline=True)
def _add_normal_forces(
    experimental: bool | None,
    infinite: bool | None,
    slab: Slab | None,
    count: int,
    moments: Array | None,
    side: Side,
    force: Array,
    normal: Array,
    tangential: Array | None,
) -> int:
    """Add the forces of one wall away from it.

    Those along it, which slabs alone have, are left in ``tangential``, for grains of moment 1.
    """
    outside = 0
    if experimental is not None:
        for i in range(count):
            w = side.sign * (side.place[i] - side.offset)
            normal[i] = wall_experimental.force(w)
            if moments is not None:
                normal[i] *= moments[i]
            force[i] += side.sign * normal[i]
    if infinite is not None:
        for i in range(count):
            w = side.sign * (side.place[i] - side.offset)
            normal[i] = wall_infinite.force(w)
            if moments is not None:
                normal[i] *= moments[i]
            force[i] += side.sign * normal[i]
            outside += not w > 0.0
    if slab is not None and tangential is not None:
        for i in range(count):
            w = side.sign * (side.place[i] - side.offset)
            normal[i] = 0.0
            tangential[i] = 0.0
            for k in range(slab.starts.size):
                a, b = side.along[i] - slab.starts[k], slab.ends[k] - side.along[i]
                normal[i] += wall_slab.normal_force(w, a, b)
                tangential[i] += wall_slab.tangential_force(w, a, b)
            if moments is not None:
                normal[i] *= moments[i]
            force[i] += side.sign * normal[i]
            outside += (not w > 0.0) if slab.closed else (not abs(w) >= 0.0)
    return outside


@compiled
def _add_tangential_forces(
    slab: Slab | None,
    count: int,
    moments: Array | None,
    along_force: Array,
    tangential: Array | None,
) -> None:
    if slab is not None and tangential is not None:
        for i in range(count):
            ratio = 1.0
            if moments is not None:
                ratio = moments[i]
            along_force[i] += ratio * tangential[i]


@compiled(inline=True)
def _add_side(
    law: WallLaw | None,
    which: int,
    count: int,
    moments: Array | None,
    side: Side,
    force: Array,
    along_force: Array,
    normal: Array,
    tangential: Array | None,
    wall_forces: Array,
) -> int:
    if law is None:
        return 0
    outside = _add_normal_forces(
        law.experimental, law.infinite, law.slab, count, moments, side, force, normal, tangential
    )
    _add_tangential_forces(law.slab, count, moments, along_force, tangential)
    wall_forces[which] = lane_sum(normal)
    if law.experimental is not None:
        # Behind this wall the force is no number, so the total tells.
        outside += not wall_forces[which] < math.inf
    return outside


@compiled(inline=True)
def add_wall_forces(
    laws: WallLaws,
    count: int,
    moments: Array | None,
    x: Array,
    y: Array,
    fx: Array,
    fy: Array,
    width: float,
    height: float,
    normal: Array,
    tangential: Array | None,
    wall_forces: Array,
) -> int:
    """Add the walls' forces on the grains.

    Parameters
    ----------
    laws : WallLaws
    width, height : float
        Cell width and piston height [D].
    normal, tangential : float64 (m,), the second None without slabs
        Scratch: the force of one wall on each grain, across and along it; zero behind the grains.
    wall_forces : float64 (4,)
        Overwritten by the force on each wall, in the order of `SIDES` [F*].

    Returns
    -------
    int
        How many times a grain stands on the wrong side of a wall, or is at no number.
    """
    left, right = Side(x, y, 0.0, 1.0), Side(x, y, width, -1.0)
    bottom, top = Side(y, x, 0.0, 1.0), Side(y, x, height, -1.0)
    return (
        _add_side(laws.left, LEFT, count, moments, left, fx, fy, normal, tangential, wall_forces)
        + _add_side(
            laws.right, RIGHT, count, moments, right, fx, fy, normal, tangential, wall_forces
        )
        + _add_side(
            laws.bottom, BOTTOM, count, moments, bottom, fy, fx, normal, tangential, wall_forces
        )
        + _add_side(laws.top, TOP, count, moments, top, fy, fx, normal, tangential, wall_forces)
    )


@compiled
def _measure(
    experimental: bool | None,
    infinite: bool | None,
    slab: Slab | None,
    count: int,
    side: Side,
    stiffness: Array,
    energies: Array,
) -> None:
    """Energies at one wall, for grains of moment 1; adds its stiffness over the grain's mass."""
    if experimental is not None:
        for i in range(count):
            w = side.sign * (side.place[i] - side.offset)
            energies[i] = wall_experimental.energy(w)
            stiffness[i] += wall_experimental.stiffness(w)
    if infinite is not None:
        for i in range(count):
            w = side.sign * (side.place[i] - side.offset)
            energies[i] = wall_infinite.energy(w)
            stiffness[i] += wall_infinite.stiffness(w)
    if slab is not None:
        for i in range(count):
            w = side.sign * (side.place[i] - side.offset)
            energies[i] = 0.0
            for k in range(slab.starts.size):
                a, b = side.along[i] - slab.starts[k], slab.ends[k] - side.along[i]
                energies[i] += wall_slab.energy(w, a, b)
                stiffness[i] += wall_slab.stiffness(w, a, b)


@compiled
def _measure_side(
    law: WallLaw | None,
    count: int,
    moments: Array | None,
    side: Side,
    stiffness: Array,
    energies: Array,
) -> float:
    if law is None:
        return 0.0
    _measure(law.experimental, law.infinite, law.slab, count, side, stiffness, energies)
    if moments is not None:
        for i in range(count):
            energies[i] *= moments[i]
    return lane_sum(energies)


@compiled
def measure_walls(
    laws: WallLaws,
    count: int,
    moments: Array | None,
    x: Array,
    y: Array,
    width: float,
    height: float,
    stiffness: Array,
    energies: Array,
) -> float:
    """Energy of the grains at the walls [F* D]; adds each wall's stiffness over the grain's mass.

    The stiffness per mass is that of a grain of the first species: moments and mass have the same
    ratio for every species.
    """
    return (
        _measure_side(laws.left, count, moments, Side(x, y, 0.0, 1.0), stiffness, energies)
        + _measure_side(laws.right, count, moments, Side(x, y, width, -1.0), stiffness, energies)
        + _measure_side(laws.bottom, count, moments, Side(y, x, 0.0, 1.0), stiffness, energies)
        + _measure_side(laws.top, count, moments, Side(y, x, height, -1.0), stiffness, energies)
    )


@compiled
def piston_stiffness(
    law: WallLaw | None, count: int, moments: Array | None, x: Array, y: Array, height: float,
    slopes: Array, energies: Array,
) -> tuple[float, float]:  # fmt: skip
    """Stiffness of all grains against the piston [F*/D], and the largest of one grain per mass."""
    slopes[:] = 0.0
    _measure_side(law, count, moments, Side(y, x, height, -1.0), slopes, energies)
    total = 0.0
    largest = 0.0
    for i in range(count):
        largest = max(largest, slopes[i])
        total += slopes[i] if moments is None else slopes[i] * moments[i]
    return total, largest


@compiled
def _turning(
    experimental: bool | None, infinite: bool | None, slab: Slab | None, speed: float
) -> float:
    square = 0.0
    if experimental is not None:
        square = wall_experimental.turning_stiffness(speed)
    if infinite is not None:
        square = wall_infinite.turning_stiffness(speed)
    if slab is not None:
        # At its end a slab has half the infinite wall's energy: a grain comes sqrt(2) nearer.
        square = 4.0 * wall_infinite.turning_stiffness(speed)
    return square


@compiled
def _turning_side(law: WallLaw | None, speed: float) -> float:
    if law is None:
        return 0.0
    return _turning(law.experimental, law.infinite, law.slab, speed)


@compiled
def turning_stiffness(laws: WallLaws, speed: float) -> float:
    """Largest stiffness per mass [1/tau^2] that a grain of this speed meets at any wall."""
    return max(
        _turning_side(laws.left, speed),
        _turning_side(laws.right, speed),
        _turning_side(laws.bottom, speed),
        _turning_side(laws.top, speed),
    )
