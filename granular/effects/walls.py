"""The walls of the cell: left, right, bottom, and the piston as the top. Each has a law of its own.

The force on every wall is the sum of the reactions of the grains; that of the top wall is the
piston force.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from granular.effects.dipole import species_discs
from granular.effects.effect import Effect, EffectContext, energy_variable
from granular.effects.force_effect import ForceEffect
from granular.effects.formula import WallFormula
from granular.effects.registry import WALL_LAWS, find_wall_law
from granular.effects.wall_discs import DiscWall, disc_wall_tables
from granular.effects.wall_experimental import ExperimentalWall
from granular.effects.wall_infinite import InfiniteWall
from granular.effects.wall_kernels import WallLaws
from granular.effects.wall_side import SIDES
from granular.effects.wall_slab import SlabWall
from granular.schema.apparatus import Cell, Grains, Piston
from granular.schema.field_kinds import FieldError, FieldKind, unknown_word_message
from granular.schema.sections import Section, nested_section_field, quantity, section_field, text_field

LAWS = ("experimental", "infinite", "slab", "discs")
FORMULA = "formula"
"""Law of a wall whose energy is written as a formula."""


@dataclasses.dataclass(frozen=True)
class AlreadyParsedSection(FieldKind):
    """A section that is made already."""

    def parse(self, value: Any, diameter: float | None) -> Any:
        """Return the section as it is; diameter [m]."""
        return value


class Wall(Section):
    """One wall.

    Attributes
    ----------
    law : str
        ``"experimental"``: force ~ distance^-3.5 [D, eq. 2.8]; ``"infinite"``: ~ distance^-3
        [D, eq. 3.3]; ``"slab"``: a magnetic slab of finite length [D, eq. 3.17]; ``"discs"``: an
        endless row of magnets of the first species (`granular.effects.wall_discs`), to which grains
        are discs whatever ``grains.magnets`` is. A side that is not named has a row of touching
        magnets if grains are discs, ``"experimental"`` else.
    length : float or None
        Length of a slab [m], from the corner at the origin. Must be given for a slab at the side;
        the bottom and the piston are as long as the cell is wide.
    gap_start, gap_end : float or None
        A gap in a bottom slab, along x [m]: two slabs, between which grains flow out.
    pitch : float
        Distance of two magnets of a row of discs [m]; the corner at the origin lies half way between
        two.
    own : section or None
        Of a law of one's own; in a scene its keys stand next to ``law``. See
        `granular.effects.custom`.
    """

    law: str = text_field(default="experimental")
    length: float | None = quantity("m", above=0.0, default=None, optional=True)
    gap_start: float | None = quantity("m", least=0.0, default=None, optional=True)
    gap_end: float | None = quantity("m", above=0.0, default=None, optional=True)
    pitch: float | None = quantity("m", above=0.0, default=None, optional=True)
    own: Any = section_field(AlreadyParsedSection(True), default=None)

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Wall:
        """Read a wall: the name of its law, or a table with the law's keys; diameter [m]."""
        plain = {"law": plain} if isinstance(plain, str) else plain
        if not isinstance(plain, Mapping) or "own" in plain:
            return super().from_plain(plain, diameter)
        law = plain.get("law", FORMULA if "energy" in plain else None)
        if not isinstance(law, str) or law in LAWS:
            return super().from_plain(plain, diameter)
        own = WallFormula if law == FORMULA else find_wall_law(law)
        if own is None:
            raise FieldError(unknown_word_message(law, (*LAWS, FORMULA, *WALL_LAWS), "law of a wall"))
        given = {name: value for name, value in plain.items() if name != "law"}
        return cls(law=law, own=own.from_plain(given, diameter))

    def to_plain(self) -> dict[str, Any]:
        """Wall as a table with its law's keys; `from_plain` makes an equal wall of it."""
        if self.own is None:
            return super().to_plain()
        return {"law": self.law, **self.own.to_plain()}

    @property
    def has_gap(self) -> bool:
        """True for a bottom with a gap."""
        return self.gap_start is not None

    def validate(self) -> None:
        """Check that length, gap and pitch are given where the law has them, and only there."""
        if (self.own is None) != (self.law in LAWS):
            raise FieldError("a law of one's own needs its parameters", "law")
        if self.law != "slab" and (self.length is not None or self.has_gap):
            raise FieldError(f"only a slab has a length or a gap; this wall is {self.law!r}", "law")
        if (self.law == "discs") != (self.pitch is not None):
            raise FieldError("a row of discs has a pitch, and no other wall has one", "pitch")
        if (self.gap_start is None) != (self.gap_end is None):
            raise FieldError("give both ends of the gap", "gap_start")
        if self.has_gap and not (self.gap_end or 0.0) > (self.gap_start or 0.0):
            raise FieldError(f"{self.gap_end:g} m must be above gap_start, {self.gap_start:g} m", "gap_end")

    def make_kernel_law(self, context: EffectContext) -> Any:
        """Make the law of the wall that the compiled loop takes, in natural units."""
        scales, width = context.scales, context.cell.width
        if self.own is not None:
            return self.own.make_kernel_law(scales)
        if self.law == "experimental":
            return ExperimentalWall()
        if self.law == "infinite":
            return InfiniteWall()
        if self.pitch is not None:
            discs = species_discs(context.grains, scales.length)
            # Coated magnets lie as deep as bare ones: by half a diameter, here 1/2 D.
            tables = disc_wall_tables(discs, discs[0], 1.0, self.pitch / scales.length, 0.5)
            # Each wall has its own, since grains that leave are taken out of it.
            return DiscWall(tables, context.species.copy() if len(discs) > 1 else None)
        ends = [0.0, width if self.length is None else self.length]
        if self.gap_start is not None and self.gap_end is not None:
            ends = [0.0, self.gap_start, self.gap_end, ends[1]]
        natural = np.array(ends) / scales.length
        return SlabWall(natural[::2].copy(), natural[1::2].copy(), not self.has_gap)


_UNNAMED = Wall()
"""Wall of a side that a scene does not name, known by its identity: others may be equal."""


class Walls(ForceEffect):
    """The four walls; the top is the piston. ``"none"`` leaves a side open."""

    key = "walls"
    rank = 2
    energy_record = energy_variable("wall_energy", "energy of the grains at the walls")
    unnamed: ClassVar[tuple[str, ...]] = ()  # sides whose law follows from the grains

    left: Wall | None = nested_section_field(Wall, default=_UNNAMED, optional=True)
    right: Wall | None = nested_section_field(Wall, default=_UNNAMED, optional=True)
    bottom: Wall | None = nested_section_field(Wall, default=_UNNAMED, optional=True)
    top: Wall | None = nested_section_field(Wall, default=_UNNAMED, optional=True)

    def resolve_parts(self, grains: Grains, cell: Cell) -> Walls:
        """Return the walls with rows of the grains' magnets on unnamed sides, where grains are discs."""
        unnamed = self.unnamed or tuple(side for side in SIDES if getattr(self, side) is _UNNAMED)
        if not unnamed:
            return self
        result, wall = copy.copy(self), _UNNAMED
        if grains.magnets == "cylinders":
            wall = Wall(law="discs", pitch=grains.species[0].diameter)
        for side in unnamed:
            object.__setattr__(result, side, wall)
        object.__setattr__(result, "unnamed", unnamed)
        return result

    def validate(self) -> None:
        """Check that a gap is in the bottom, and that slabs at the sides alone have a length."""
        for side, wall in self.present_walls:
            if wall.has_gap and side != "bottom":
                raise FieldError("only the bottom can have a gap", side, "gap_start")
            upright = side in ("left", "right")
            if wall.law == "slab" and wall.length is None and upright:
                raise FieldError("must be given for a slab at the side", side, "length")
            if wall.length is not None and not upright:
                raise FieldError("is the cell's width here; leave it out", side, "length")

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check that slabs fit the cell and the piston's height, and a pitch the magnets."""
        height = 0.0 if piston is None else piston.height or 0.0
        diameter = grains.species[0].diameter
        for side, wall in self.present_walls:
            path = ("effects", self.key, side)
            if wall.gap_end is not None and wall.gap_end > cell.width:
                raise FieldError(
                    f"{wall.gap_end:g} m must be at most the cell's width, {cell.width:g} m", *path, "gap_end"
                )
            if wall.length is not None and wall.length < height:
                raise FieldError(
                    f"{wall.length:g} m is less than the piston's height, {height:g} m; grains "
                    "would come behind the slab",
                    *path,
                    "length",
                )
            # 1e-12: rounding of a pitch that is written as one diameter.
            if wall.pitch is not None and wall.pitch < diameter * (1.0 - 1e-12):
                raise FieldError(
                    f"{wall.pitch:g} m must be at least the magnets' diameter, {diameter:g} m", *path, "pitch"
                )

    @property
    def walls_in_order(self) -> tuple[Wall | None, ...]:
        """Walls in the order of `SIDES`; None where a side is open."""
        return tuple(getattr(self, side) for side in SIDES)

    @property
    def present_walls(self) -> list[tuple[str, Wall]]:
        """Sides that are not open, with their walls."""
        sides = zip(SIDES, self.walls_in_order, strict=True)
        return [(side, wall) for side, wall in sides if wall is not None]

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digests of the user's own laws of walls, for the run's settings."""
        own = [wall.own for _, wall in self.present_walls if wall.own is not None]
        return tuple(source for law in own for source in law.user_code_digests)

    @property
    def has_slab(self) -> bool:
        """True where a wall is a slab."""
        return any(wall.law == "slab" for _, wall in self.present_walls)

    @property
    def has_gap(self) -> bool:
        """True where the bottom has a gap."""
        return self.bottom is not None and self.bottom.has_gap

    def make_kernel_law(self, context: EffectContext) -> WallLaws:
        """Make the laws of all four walls that the compiled loop takes, in natural units."""
        return WallLaws(
            *(None if wall is None else wall.make_kernel_law(context) for wall in self.walls_in_order)
        )
