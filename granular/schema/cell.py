"""The Hele-Shaw cell, with straight sides that move with the cell or with the piston."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection
from typing import Any, ClassVar

import numpy as np

from granular.schema.field_kinds import ChoiceKind, FieldError, FieldKind, PointListKind, SectionListKind
from granular.schema.sections import Section, choice_field, quantity, section_field, text_field
from granular.shared.array_types import Float

BODIES = ("cell", "piston")
CELL, PISTON = range(len(BODIES))
"""Indices of the bodies (cell, piston) with which a side can move."""

ROUNDING = 1e-9
"""Tolerance for rounding errors in the positions of corners, as a fraction of the cell's width."""

Point = tuple[float, float]

Heights = float | np.ndarray | None
"""Height of the piston [m], followed by heights of further pistons; None without a piston."""


class CellSide(Section):
    """One straight side of a cell.

    Attributes
    ----------
    name : str
        Name of the side, by which `effects.walls` gives its law.
    ends : two pairs of float
        First and second end [m]; the inside is to the left of the line from the first to the second. For a
        side of the piston, heights are relative to the piston.
    body : str
        Body with which the side moves: ``"cell"`` or ``"piston"``.
    """

    name: str = text_field()
    ends: tuple[Point, ...] = section_field(PointListKind(unit="m"))
    body: str = choice_field(*BODIES, default="cell")

    def validate(self) -> None:
        """Check that there are two ends."""
        if len(set(self.ends)) != 2 or len(self.ends) != 2:
            raise FieldError("are not two different points; give [[x, y], [x, y]]", "ends")
        if self.name in ("piston", "host"):
            raise FieldError(
                f"{self.name!r} is already the name of another recorded force; give the side another name",
                "name",
            )


@dataclasses.dataclass(frozen=True)
class SideLine:
    """Line of a side, in the frame of its body."""

    name: str
    point: Point  # origin of positions along the side [m]
    normal: Point  # unit vector into the cell
    tangent: Point  # unit vector along the side
    length: float | None  # [m]; None for a vertical side of a rectangle, which ends at the piston
    body: int = CELL

    @property
    def label(self) -> str:
        """Name of the side in messages."""
        return "the piston" if self.body == PISTON else f"the {self.name} wall"

    @property
    def is_level(self) -> bool:
        """True if the side is horizontal."""
        return abs(self.normal[0]) < ROUNDING

    def is_crossed_by_leaving_grains(self, x: float, y: float) -> bool:
        """Return True if the path of a grain that leaves in the direction (x, y) crosses the side's line."""
        nx, ny = self.normal
        return ny > ROUNDING or nx * x + ny * y < -ROUNDING

    def origin(self, height: float) -> Point:
        """Point from which positions along the side are measured, with the piston at the given height."""
        return (self.point[0], self.point[1] + (height if self.body == PISTON else 0.0))

    def distances_from_side(
        self, positions: Float[np.ndarray, "n 2"], height: float
    ) -> Float[np.ndarray, "n"]:
        """Distances of positions from the side, positive inside, with the piston at the given height."""
        return (positions - np.array(self.origin(height))) @ np.array(self.normal)

    def ends(self, height: float, top: float) -> tuple[Point, Point]:
        """Both ends, with the piston at the given height; a side of infinite length ends at ``top``."""
        (x, y), (tx, ty) = self.origin(height), self.tangent
        length = top - y if self.length is None else self.length
        return (x, y), (x + length * tx, y + length * ty)


@dataclasses.dataclass(frozen=True)
class SidesKind(FieldKind):
    """Sides of a cell: ``"closed"``, ``"periodic"``, or a list of sides."""

    word: ClassVar[ChoiceKind] = ChoiceKind(names=("closed", "periodic"))
    table: ClassVar[SectionListKind] = SectionListKind(section=CellSide, least=1)

    def parse(self, value: Any, diameter: float | None) -> Any:
        """Read a word or a list of tables."""
        return (self.word if isinstance(value, str) else self.table).parse(value, diameter)

    def to_plain(self, value: Any) -> Any:
        """Return the word, or the sides as tables."""
        return (self.word if isinstance(value, str) else self.table).to_plain(value)


class Cell(Section):
    """The Hele-Shaw cell: a rectangle, or a convex polygon.

    Attributes
    ----------
    width : float
        Distance between the side walls of a rectangle [m]; for other cells, computed from the sides.
    separation : float
        Distance E between the glass plates [m].
    sides : str, or tuple of CellSide
        ``"closed"``: a rectangle with the sides ``left``, ``right``, ``bottom`` and ``top`` (the piston),
        with the walls of `granular.effects.walls`; ``"periodic"``: a cell that is periodic in both
        directions, has no piston, and in which grains interact with the periodic images of all other grains;
        or the sides of a convex polygon, with openings between sides that do not meet. The lowest corner of
        the polygon must have y = 0, and the leftmost x = 0.
    height : float or None
        Height of a periodic cell [m]; not given for a closed cell, which ends at the piston.
    """

    unwritten_defaults = ("sides",)

    width: float = quantity("m", above=0.0, default=None, optional=True)
    separation: float = quantity("m", default=0.0031, above=0.0)
    sides: str | tuple[CellSide, ...] = section_field(SidesKind(), default="closed")
    height: float | None = quantity("m", above=0.0, default=None, optional=True)

    @property
    def periods(self) -> tuple[float, float] | None:
        """Width and height of a periodic cell [m]; None if the cell is not periodic."""
        return None if self.height is None else (self.width, self.height)

    def wrap_positions(self, positions: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
        """Return positions wrapped into a periodic cell; for a closed cell, the unchanged positions."""
        if self.periods is None:
            return positions
        inside = np.mod(positions, self.periods)
        # A position just below 0 is rounded to the period itself.
        return np.asarray(np.where(inside < self.periods, inside, 0.0 * inside))

    def nearest_image_displacements(
        self, displacements: Float[np.ndarray, "... 2"]
    ) -> Float[np.ndarray, "... 2"]:
        """Displacements of the nearest images (Allen and Tildesley 1987); unchanged in a closed cell."""
        if self.periods is None:
            return displacements
        return np.asarray(displacements - self.periods * np.round(displacements / self.periods))

    @property
    def is_polygon(self) -> bool:
        """True if the cell is given by a list of sides, and not as a rectangle by its width."""
        return not isinstance(self.sides, str)

    @property
    def lines(self) -> tuple[SideLine, ...]:
        """Lines of the sides; left, right, bottom and top for a rectangle."""
        if not isinstance(self.sides, str):
            return tuple(_line_between_ends(side) for side in self.sides)
        origin, wide = (0.0, 0.0), self.width
        return (
            SideLine("left", origin, (1.0, 0.0), (0.0, 1.0), None),
            SideLine("right", (wide, 0.0), (-1.0, 0.0), (0.0, 1.0), None),
            SideLine("bottom", origin, (0.0, 1.0), (1.0, 0.0), wide),
            SideLine("top", origin, (0.0, -1.0), (1.0, 0.0), wide, PISTON),
        )

    def validate(self) -> None:
        """Check that a periodic cell has a height and a polygon is convex; set the width of a polygon."""
        if self.sides == "periodic" and self.height is None:
            raise FieldError("is missing; a periodic cell needs a height", "height")
        if self.sides != "periodic" and self.height is not None:
            raise FieldError(
                "only a periodic cell has a height; for a closed cell give piston.height", "height"
            )
        if isinstance(self.sides, str):
            if self.width is None:
                raise FieldError("must be given", "width")
            return
        if self.width is not None:
            raise FieldError("is computed from the sides, and cannot also be given; remove it", "width")
        corners = np.array([end for side in self.sides if side.body == "cell" for end in side.ends])
        if not len(corners):
            raise FieldError(
                "all sides move with the piston; give one or more sides with body = 'cell'", "sides"
            )
        object.__setattr__(self, "width", float(corners[:, 0].max()))
        if not self.width > 0.0 or (np.abs(corners.min(axis=0)) > ROUNDING * self.width).any():
            x, y = corners.min(axis=0)
            raise FieldError(
                "the leftmost corner must be at x = 0 and the lowest at y = 0; shift all corners by "
                f"{-x:g}, {-y:g} m",
                "sides",
            )
        self.check_convex(None)

    def gap_vectors(self, names: Collection[str], height: float) -> list[Point]:
        """Vectors across the gaps between successive sides with the given names, for a piston height [m]."""
        ends = np.array([line.ends(height, 0.0) for line in self.lines if line.name in names])
        if not len(ends):
            return []
        x, y = (ends.mean(axis=1) - ends.mean(axis=(0, 1))).T
        ends = ends[np.argsort(np.arctan2(y, x))]
        gaps = np.roll(ends[:, 0], -1, axis=0) - ends[:, 1]
        return [(x, y) for x, y in gaps.tolist() if math.hypot(x, y) > 100.0 * ROUNDING * self.width]

    def check_convex(self, height: float | None) -> None:
        """Check that all corners lie inside all sides; piston height in m, or None without a piston."""
        lines = [line for line in self.lines if line.body == CELL or height is not None]
        corners = [(line, end) for line in lines for end in line.ends(height or 0.0, 0.0)]
        for line in lines:
            for other, corner in corners:
                outside = -float(line.distances_from_side(np.array(corner), height or 0.0))
                # The cell may extend above its piston.
                if outside > ROUNDING * self.width and (line.body == CELL or other.body == PISTON):
                    raise FieldError(
                        f"an end of {other.name!r} is {outside:.4g} m outside {line.name!r}; make the cell "
                        "convex, with the inside to the left of the line from the first to the second end "
                        "of each side",
                        "cell",
                        "sides",
                    )

    def to_plain(self) -> dict[str, Any]:
        """Return plain data as `Section.to_plain` does, without the sides of a closed rectangle."""
        plain = super().to_plain()
        if self.is_polygon:
            del plain["width"]
        return plain


def piston_wall_key(lines: tuple[SideLine, ...]) -> str:
    """Return the key of the wall that moves with the piston, for use in messages."""
    names = [line.name for line in lines if line.body == PISTON]
    return f"effects.walls.{names[0]}" if names else "a side with body = 'piston' in cell.sides"


def _line_between_ends(side: CellSide) -> SideLine:
    (x, y), (to_x, to_y) = side.ends
    length = math.hypot(to_x - x, to_y - y)
    tx, ty = (to_x - x) / length, (to_y - y) / length
    return SideLine(side.name, (x, y), (-ty, tx), (tx, ty), length, BODIES.index(side.body))
