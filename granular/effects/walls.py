"""The walls of the cell: left, right, bottom, and the piston as the top. Each has a law of its own.

The force on every wall is the sum of the reactions of the grains; that of the top wall is the
piston force.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.compiled.dispatch import by_law
from granular.effects.effect import Effect, Setting, in_joules
from granular.effects.own_wall import WallText, find_wall_law, wall_laws
from granular.effects.wall_experimental import ExperimentalWall
from granular.effects.wall_infinite import InfiniteWall
from granular.effects.wall_side import Side, distance_energies, distance_forces
from granular.effects.wall_slab import SlabWall
from granular.engine.constants import Constants, moments_of, over_mass, value_of
from granular.engine.state import HEIGHT, State
from granular.pairs.vector import lane_sum
from granular.scene.parts import Cell, Grains, Piston
from granular.scene.scales import Scales
from granular.scene.schema import FieldError, Kind, Section, declare, one, quantity, unknown

LAWS = ("experimental", "infinite", "slab")
FORMULA = "formula"
"""Law of a wall whose energy is written as a formula."""
SIDES = ("left", "right", "bottom", "top")
LEFT, RIGHT, BOTTOM, TOP = range(len(SIDES))


@dataclasses.dataclass(frozen=True)
class LawName(Kind):
    """The name of a law of a wall."""

    def parse(self, value: Any, diameter: float | None) -> str:
        known = (*LAWS, FORMULA, *wall_laws())
        if not isinstance(value, str) or value not in known:
            raise FieldError(unknown(str(value), known, "choice"))
        return value


class Own(Kind):
    """A section that is made already."""

    def parse(self, value: Any, diameter: float | None) -> Any:
        return value


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
    own : section or None
        Of a law of one's own; in a scene its keys stand beside ``law``. See
        `granular.effects.own_wall`.
    """

    law: str = declare(LawName(), default="experimental")
    length: float | None = quantity("m", above=0.0, default=None, optional=True)
    gap_start: float | None = quantity("m", least=0.0, default=None, optional=True)
    gap_end: float | None = quantity("m", above=0.0, default=None, optional=True)
    own: Any = declare(Own(True), default=None)

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Wall:
        plain = {"law": plain} if isinstance(plain, str) else plain
        if not isinstance(plain, Mapping) or "own" in plain:
            return super().from_plain(plain, diameter)
        given = {name: value for name, value in plain.items() if name != "law"}
        law = plain.get("law", FORMULA if "energy" in plain else None)
        if law == FORMULA:
            return cls(law=FORMULA, own=WallText.from_plain(given, diameter))
        own = find_wall_law(law) if isinstance(law, str) and law not in LAWS else None
        if own is not None:
            return cls(law=law, own=own.from_plain(given, diameter))
        if isinstance(law, str) and law not in LAWS:
            raise FieldError(unknown(law, (*LAWS, FORMULA, *wall_laws()), "law of a wall"))
        return super().from_plain(plain, diameter)

    def to_plain(self) -> dict[str, Any]:
        if self.own is None:
            return super().to_plain()
        return {"law": self.law, **self.own.to_plain()}

    @property
    def has_gap(self) -> bool:
        return self.gap_start is not None

    def validate(self) -> None:
        if (self.own is None) != (self.law in LAWS):
            raise FieldError("a law of one's own needs its parameters", "law")
        if self.law != "slab" and (self.length is not None or self.has_gap):
            raise FieldError(f"only a slab has a length or a gap; this wall is {self.law!r}", "law")
        if (self.gap_start is None) != (self.gap_end is None):
            raise FieldError("give both ends of the gap", "gap_start")
        if self.has_gap and not (self.gap_end or 0.0) > (self.gap_start or 0.0):
            raise FieldError(
                f"{self.gap_end:g} m must be above gap_start, {self.gap_start:g} m", "gap_end"
            )

    def law_of(self, width: float, scales: Scales) -> Any:
        """The law in natural units, for a cell of that width [m]."""
        if self.own is not None:
            return self.own.law(scales)
        if self.law == "experimental":
            return ExperimentalWall()
        if self.law == "infinite":
            return InfiniteWall()
        ends = [0.0, width if self.length is None else self.length]
        if self.gap_start is not None and self.gap_end is not None:
            ends = [0.0, self.gap_start, self.gap_end, ends[1]]
        natural = np.array(ends) / scales.length
        return SlabWall(natural[::2].copy(), natural[1::2].copy(), not self.has_gap)


class Walls(Effect):
    """The four walls; the top is the piston. ``"none"`` leaves a side open."""

    key = "walls"
    rank = 2
    energy_record = in_joules("wall_energy", "energy of the grains at the walls")

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

    def check(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Raise `FieldError` unless slabs fit the cell and the piston's height."""
        try:
            self._check_size(cell.width, None if piston is None else piston.height)
        except FieldError as error:
            raise error.within("effects", self.key) from None

    def _check_size(self, width: float, height: float | None) -> None:
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
    def sources(self) -> tuple[str, ...]:
        own = [wall.own for wall in self.sides if wall is not None and wall.own is not None]
        return tuple(source for one in own for source in one.sources)

    @property
    def has_slab(self) -> bool:
        return any(wall is not None and wall.law == "slab" for wall in self.sides)

    @property
    def has_gap(self) -> bool:
        return self.bottom is not None and self.bottom.has_gap

    def law(self, setting: Setting) -> WallLaws:
        """The laws in natural units; see `Wall.law_of`."""
        width, scales = setting.cell.width, setting.scales
        return WallLaws(
            *(None if wall is None else wall.law_of(width, scales) for wall in self.sides)
        )


class WallLaws(NamedTuple):
    """The law of each side; None is open."""

    left: Any
    right: Any
    bottom: Any
    top: Any

    def room(self, size: int, count: int) -> np.ndarray | None:
        """Room for the forces along a wall, which slabs alone have."""
        slabs = any(hasattr(law, "add_forces") for law in self)
        return np.zeros(size) if slabs else None

    @staticmethod
    @compiled(inline=True)
    def add_forces(
        law: WallLaws, room: Array | None, place: int, state: State, constants: Constants,
        time: float,
    ) -> int:  # fmt: skip
        """Add the walls' forces on the grains, and enter the force on each wall.

        The count is of grains on the wrong side of a wall, or at no number.
        """
        return _add_wall_forces(
            law, constants.grains, moments_of(constants), state.x, state.y, state.fx, state.fy,
            constants.width, state.piston[HEIGHT], state.scratch, room, state.wall_forces,
        )  # fmt: skip

    @staticmethod
    @compiled
    def measure(
        law: WallLaws, room: Array | None, place: int, state: State, constants: Constants,
        time: float, stiffness: Array, energies: Array,
    ) -> int:  # fmt: skip
        """Enter the energy of the grains at the walls."""
        _under_mass(stiffness, constants.moments, constants.masses, constants.grains)
        energies[place] = _measure_walls(
            law, constants.grains, moments_of(constants), state.x, state.y,
            constants.width, state.piston[HEIGHT], stiffness, state.scratch,
        )  # fmt: skip
        over_mass(stiffness, constants.moments, constants.masses, constants.grains)
        return 0

    @staticmethod
    @compiled
    def against_piston(
        law: WallLaws, room: Array | None, place: int, state: State, constants: Constants,
        slopes: Array,
    ) -> int:  # fmt: skip
        """Add the stiffness of the grains against the piston, over the mass."""
        side = Side(state.y, state.x, state.piston[HEIGHT], -1.0)
        _measure_side(law.top, constants.grains, moments_of(constants), side, slopes, state.scratch)
        over_mass(slopes, constants.moments, constants.masses, constants.grains)
        return 0

    @staticmethod
    @compiled
    def collision(
        law: WallLaws, room: None, place: int, speed: float, constants: Constants
    ) -> float:
        """Largest stiffness per mass [1/tau^2] that a grain of this speed meets at any wall."""
        ratio = constants.least_ratio
        speed /= math.sqrt(ratio)
        return ratio * max(
            _turning_side(law.left, speed),
            _turning_side(law.right, speed),
            _turning_side(law.bottom, speed),
            _turning_side(law.top, speed),
        )


@compiled
def _under_mass(stiffness: Array, moments: Array | None, masses: Array | None, count: int) -> None:
    """What `over_mass` takes back: of grains of moment 1, for what the walls add such to."""
    if moments is not None:
        for i in range(count):
            stiffness[i] *= value_of(masses, i) / moments[i]


@compiled
def _no_tangent(
    law: Any, count: int, moments: Array | None, along_force: Array, tangential: Array | None
) -> None:
    """Forces along the wall, of a law of the distance alone."""


_forces = by_law("add_forces", "count moments side force normal tangential", distance_forces)
_tangential_forces = by_law(
    "add_tangential_forces", "count moments along_force tangential", _no_tangent
)
_energies = by_law("measure", "count side stiffness energies", distance_energies)


@compiled
def _unknown(law: Any, speed: float) -> float:
    return 0.0


_turning = by_law("turning_stiffness", "speed", _unknown)


@compiled(inline=True)
def _add_side(
    law: Any, which: int, count: int, moments: Array | None, side: Side, force: Array,
    along_force: Array, normal: Array, tangential: Array | None, wall_forces: Array,
) -> int:  # fmt: skip
    if law is None:
        return 0
    outside = _forces(law, count, moments, side, force, normal, tangential)
    _tangential_forces(law, count, moments, along_force, tangential)
    wall_forces[which] = lane_sum(normal)
    # Behind a wall the force may be no number, and at it infinite, so the total tells.
    return outside + (not wall_forces[which] < math.inf)


@compiled(inline=True)
def _add_wall_forces(
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
    """Add the forces of all four walls.

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
def _measure_side(
    law: Any,
    count: int,
    moments: Array | None,
    side: Side,
    stiffness: Array,
    energies: Array,
) -> float:
    if law is None:
        return 0.0
    _energies(law, count, side, stiffness, energies)
    if moments is not None:
        for i in range(count):
            energies[i] *= moments[i]
    return lane_sum(energies)


@compiled
def _measure_walls(
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
def _turning_side(law: Any, speed: float) -> float:
    if law is None:
        return 0.0
    return _turning(law, speed)
