"""Walls of the cell: each side has a wall law or is open.

The force on each wall is the sum of the reactions of the grains; the piston force is the force on the
sides that move with the piston.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from granular.effects.dipole import species_discs
from granular.effects.effect import WALL_LAWS, Effect, EffectContext, ForceEffect, recorded_energy_variable
from granular.effects.wall_discs import DiscWall, tabulate_disc_wall
from granular.effects.wall_laws import CellSidesWithLaws, ExperimentalWall, InfiniteWall, SlabWall
from granular.effects.wall_side import Side
from granular.kernel_data.state import CELL, PISTON
from granular.schema.apparatus import Grains, Piston
from granular.schema.cell import Cell, Point, SideLine
from granular.schema.field_kinds import FieldError, FieldKind, NestedSectionKind, add_key_to_errors
from granular.schema.sections import Section, quantity, section_field, text_field
from granular.shared.errors import quote, unknown_word_message

LAWS = ("experimental", "infinite", "slab", "discs")
FORMULA = "formula"
"""Name of the law of a wall whose energy is given by a formula."""


@dataclasses.dataclass(frozen=True)
class SectionObjectKind(FieldKind):
    """Type of a scene key whose value is a section object instead of plain data."""

    def parse(self, value: Any, diameter: float | None) -> Any:
        """Return the section unchanged; diameter [m]."""
        return value


class Wall(Section):
    """The wall at one side of the cell.

    Attributes
    ----------
    law : str
        ``"experimental"``: force ~ distance^-3.5 [D, eq. 2.8]; ``"infinite"``: ~ distance^-3 [D, eq. 3.3];
        ``"slab"``: a magnetic slab of finite length [D, eq. 3.17]; ``"discs"``: an infinite row of magnets of
        the first species (`granular.effects.wall_discs`), which treats grains as discs for any
        ``grains.magnets``. The default for sides that are not listed is a row of touching magnets if grains
        are discs, otherwise ``"experimental"``.
    length : float or None
        Length [m], from the bottom, of a slab at the left or right side of a rectangle; required for such a
        slab. All other slabs are as long as their sides.
    gap_start, gap_end : float or None
        Start and end of a gap along a slab [m], through which grains flow out.
    pitch : float
        Distance between neighbouring magnets in a row of discs [m]. The first end of the side lies halfway
        between two magnets; for a rectangle this is the corner next to the origin.
    own : section or None
        Parameters of a user-defined law; in a scene they are given next to ``law``. See
        `granular.effects.custom`.
    """

    law: str = text_field(default="experimental")
    length: float | None = quantity("m", above=0.0, default=None, optional=True)
    gap_start: float | None = quantity("m", least=0.0, default=None, optional=True)
    gap_end: float | None = quantity("m", above=0.0, default=None, optional=True)
    pitch: float | None = quantity("m", above=0.0, default=None, optional=True)
    own: Any = section_field(SectionObjectKind(True), default=None)

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Wall:
        """Read a wall: the name of its law, or a table with the law's keys; diameter [m]."""
        plain = {"law": plain} if isinstance(plain, str) else plain
        if not isinstance(plain, Mapping) or "own" in plain:
            return super().from_plain(plain, diameter)
        law = plain.get("law", FORMULA if "energy" in plain else None)
        if not isinstance(law, str) or law in LAWS:
            return super().from_plain(plain, diameter)
        if law not in WALL_LAWS:
            raise FieldError(unknown_word_message(law, (*LAWS, *WALL_LAWS), WALL_LAWS.kind))
        given = {name: value for name, value in plain.items() if name != "law"}
        return cls(law=law, own=WALL_LAWS[law].from_plain(given, diameter))

    def to_plain(self) -> dict[str, Any]:
        """Convert the wall to a table with the law's keys, which `from_plain` converts back."""
        if self.own is None:
            return super().to_plain()
        return {"law": self.law, **self.own.to_plain()}

    @property
    def has_gap(self) -> bool:
        """True for a slab with a gap."""
        return self.gap_start is not None

    def validate(self) -> None:
        """Check that length, gap and pitch are given only for laws that have them."""
        if (self.own is None) != (self.law in LAWS):
            raise FieldError("the parameters of a user-defined law are missing; give them next to law", "law")
        if self.law != "slab" and (self.length is not None or self.has_gap):
            raise FieldError(
                f"only a slab has a length or a gap; remove them from the wall {self.law!r}", "law"
            )
        if (self.law == "discs") != (self.pitch is not None):
            raise FieldError(
                "is required for law = 'discs' and allowed only for this law; add it, or remove it", "pitch"
            )
        if (self.gap_start is None) != (self.gap_end is None):
            raise FieldError("only one end of the gap is given; give gap_start and gap_end", "gap_start")
        if self.has_gap and not (self.gap_end or 0.0) > (self.gap_start or 0.0):
            raise FieldError(
                f"{self.gap_end:g} m is not above gap_start, {self.gap_start:g} m; give a larger value",
                "gap_end",
            )

    def make_kernel_law(self, context: EffectContext, line: SideLine) -> Any:
        """Make the law of the wall at a side for the compiled loop, in natural units."""
        scales = context.scales
        if self.own is not None:
            return self.own.make_kernel_law(scales)
        if self.law == "experimental":
            return ExperimentalWall()
        if self.law == "infinite":
            return InfiniteWall()
        if self.pitch is not None:
            discs = species_discs(context.grains, scales.length)
            # The centres of coated magnets are half a coated diameter, 1/2 D, behind the face.
            tables = tabulate_disc_wall(discs, discs[0], 1.0, self.pitch / scales.length, 0.5)
            # A copy for each wall, since grains that leave are removed from it.
            return DiscWall(tables, context.species.copy() if len(discs) > 1 else None)
        length = line.length if self.length is None else self.length
        assert length is not None
        ends = [0.0, length]
        if self.gap_start is not None and self.gap_end is not None:
            ends = [0.0, self.gap_start, self.gap_end, length]
        natural = np.array(ends) / scales.length
        walls: Any = context.effects["walls"]
        # Grains that have left a polygon may be behind the line of any slab.
        closed = not self.has_gap and not (context.cell.is_polygon and walls.has_gap)
        return SlabWall(natural[::2].copy(), natural[1::2].copy(), closed)


NamedWall = tuple[str, Wall | None]


@dataclasses.dataclass(frozen=True)
class _NamedWallsKind(FieldKind):
    """Type of a scene key that gives a wall, or None for an open side, for each listed side of the cell."""

    def parse(self, value: Any, diameter: float | None) -> tuple[NamedWall, ...]:
        if not isinstance(value, Mapping | tuple):
            raise FieldError(f"{quote(value)} is not a table; give a table of sides and walls")
        kind, walls = NestedSectionKind(True, section=Wall), []
        for name, plain in dict(value).items():
            with add_key_to_errors(name):
                walls.append((name, kind.read_value(plain, diameter)))
        return tuple(walls)


class Walls(ForceEffect):
    """Walls by the names of the sides; ``top`` of a rectangle is the piston, and ``"none"`` is an open side.

    Attributes
    ----------
    walls : pairs of str and Wall or None
        Name and wall of each side; in a scene, a table.
    """

    key = "walls"
    rank = 2
    energy_record = recorded_energy_variable("wall_energy", "energy of the grains at the walls")
    unnamed: ClassVar[tuple[str, ...]] = ()  # sides with the default law
    has_gap: ClassVar[bool] = False  # whether grains can flow out between walls

    walls: tuple[NamedWall, ...] = section_field(_NamedWallsKind(), default=())

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Walls:
        """Read a table of walls by their sides; diameter [m]."""
        try:
            return super().from_plain({"walls": {} if plain is True else plain}, diameter)
        except FieldError as error:
            raise FieldError(error.reason, *error.path[1:]) from None

    def to_plain(self) -> dict[str, Any]:
        """Convert the walls to a table by side, which `from_plain` converts back."""
        return {side: "none" if wall is None else wall.to_plain() for side, wall in self.walls}

    def wall_of(self, side: str) -> Wall | None:
        """Wall of a side; None if the side is open."""
        return dict(self.walls).get(side)

    def _inner_section(self, part: str) -> Wall | None:
        """Return the wall of a side, for the next part of a dotted key."""
        return self.wall_of(part)

    def resolve_parts(self, grains: Grains, cell: Cell) -> Walls:
        """Return the walls of all sides of the cell; sides not listed get the default law."""
        sides = tuple(line.name for line in cell.lines)
        given = {side: wall for side, wall in self.walls if side not in self.unnamed}
        for side in given:
            if side not in sides:
                raise FieldError(unknown_word_message(side, sides, "side"), "effects", self.key)
        default = Wall()
        if grains.magnets == "cylinders":
            default = Wall(law="discs", pitch=grains.species[0].diameter)
        result = copy.copy(self)
        object.__setattr__(result, "walls", tuple((side, given.get(side, default)) for side in sides))
        object.__setattr__(result, "unnamed", tuple(side for side in sides if side not in given))
        object.__setattr__(result, "has_gap", bool(result._grain_exit_directions(cell)))
        return result

    def _grain_exit_directions(self, cell: Cell) -> list[Point]:
        """Directions in which grains can leave: through gaps in slabs, and between the walls of a polygon."""
        walled = [(line, wall) for line in cell.lines if (wall := self.wall_of(line.name)) is not None]
        result = [(-line.normal[0], -line.normal[1]) for line, wall in walled if wall.has_gap]
        if not cell.is_polygon:
            return result
        gaps = cell.gap_vectors([line.name for line, _ in walled if line.body == CELL], 0.0)
        # The highest gap is the open top or the piston, which may also come from below.
        filled = next((line.tangent[0] for line, _ in walled if line.body == PISTON), -1.0)
        gaps.sort(key=lambda gap: filled * gap[0])
        if gaps and filled * gaps[-1][0] > 0.0:
            gaps.pop()
        return result + [(y, -x) for x, y in gaps]

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check slabs against the cell and the piston's height, and pitches against the magnets' diameter."""
        height = 0.0 if piston is None else piston.height or 0.0
        diameter = grains.species[0].diameter
        exits = self._grain_exit_directions(cell)
        for line in cell.lines:
            wall = self.wall_of(line.name)
            if wall is not None:
                with add_key_to_errors("effects", self.key, line.name):
                    _check_slab(wall, line, height)
                    _check_pitch_fits_magnets(wall, diameter)
                    if cell.is_polygon:
                        _check_leaves_openings_free(wall, line, exits)

    @property
    def sides_with_walls(self) -> list[tuple[str, Wall]]:
        """Sides with a wall, and their walls."""
        return [(side, wall) for side, wall in self.walls if wall is not None]

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digests (hashes) of the user-defined wall laws, which identify a run."""
        laws = [wall.own for _, wall in self.sides_with_walls if wall.own is not None]
        return tuple(digest for law in laws for digest in law.user_code_digests)

    def make_kernel_law(self, context: EffectContext) -> CellSidesWithLaws:
        """Make the sides with their wall laws for the compiled loop, in natural units."""
        return CellSidesWithLaws(sides_in_natural_units(self, context, context.cell.lines))


def sides_in_natural_units(
    walls: Walls | None, context: EffectContext, lines: tuple[SideLine, ...]
) -> tuple[Side, ...]:
    """Return the sides of the cell with their laws, in natural units; without walls, all sides are open."""
    host, sides = context.effects.get("host"), []
    bodies = {} if host is None else host.body_rows_by_side()
    for line in lines:
        wall = None if walls is None else walls.wall_of(line.name)
        law = None if wall is None else wall.make_kernel_law(context, line)
        (x, y), (nx, ny), (tx, ty) = line.point, line.normal, line.tangent
        offset, begin = (nx * x + ny * y) / context.scales.length, (tx * x + ty * y) / context.scales.length
        sides.append(Side(nx, ny, offset, tx, ty, begin, bodies.get(line.name, line.body), law))
    return tuple(sides)


def _check_slab(wall: Wall, line: SideLine, height: float) -> None:
    """Check that a slab at an infinite side has a length, and that a gap is within the side; height [m]."""
    if wall.law == "slab" and wall.length is None and line.length is None:
        raise FieldError("is missing, but a slab at this side needs a length; give it", "length")
    if wall.length is not None and line.length is not None:
        raise FieldError(
            f"is not allowed at this side, whose length is {line.length:g} m; remove it", "length"
        )
    if wall.has_gap and (line.length is None or line.body != CELL):
        raise FieldError(
            "an infinite side or a side of the piston cannot have a gap; remove gap_start and gap_end",
            "gap_start",
        )
    if wall.gap_end is not None and line.length is not None and wall.gap_end > line.length:
        raise FieldError(
            f"{wall.gap_end:g} m exceeds the length of the side, {line.length:g} m; give a smaller value",
            "gap_end",
        )
    if wall.length is not None and wall.length < height:
        raise FieldError(
            f"{wall.length:g} m is less than the piston's height, {height:g} m, and grains could get "
            "behind the slab; give a larger length",
            "length",
        )
    if line.body != CELL and not line.is_level and wall.law in ("slab", "discs"):
        raise FieldError(
            f"{wall.law!r} exerts a tangential force, which is not supported at an inclined side of the "
            "piston; use 'infinite'",
            "law",
        )


def _check_leaves_openings_free(wall: Wall, line: SideLine, exits: list[Point]) -> None:
    """Check that no infinitely long wall crosses the path of grains that leave through an opening."""
    if (
        line.body == CELL
        and wall.law != "slab"
        and any(line.is_crossed_by_leaving_grains(*out) for out in exits)
    ):
        raise FieldError(
            f"{wall.law!r} is infinitely long and would block the opening of the cell; use 'slab', or "
            "close the opening",
            "law",
        )


def _check_pitch_fits_magnets(wall: Wall, diameter: float) -> None:
    # 1e-12 allows for rounding of a pitch of exactly one diameter.
    if wall.pitch is not None and wall.pitch < diameter * (1.0 - 1e-12):
        raise FieldError(
            f"{wall.pitch:g} m is below the magnets' diameter, {diameter:g} m; give a larger pitch", "pitch"
        )
