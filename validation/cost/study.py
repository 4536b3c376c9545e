"""Errors and wall times of many settings: the front, the advice, a table and a picture."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from validation.cost.advice import Advice, advice
from validation.cost.point import USUAL, Point, Setting, cost, families
from validation.table import TextTable, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEVELS = {"1 %": 1e-2, "0.1 %": 1e-3, "1e-6": 1e-6}
"""Tolerances that a picture answers for."""


@dataclasses.dataclass(frozen=True)
class WorkPrecision:
    """Errors and wall times of many settings.

    Attributes
    ----------
    scene, quantity, unit : str
        ``unit`` of the errors: ``"1"`` where they are relative.
    horizon : float or None
        Until when the scene was run [s]; None for its whole protocol.
    points : tuple of Point
    floor : float
        Standard deviation of the quantity over the starts, as an error; 0 for one start, and where
        each start has a value of its own.
    reference : str
        What the errors are measured against.
    """

    scene: str
    quantity: str
    unit: str
    horizon: float | None
    points: tuple[Point, ...]
    floor: float
    reference: str

    def front(self) -> tuple[Point, ...]:
        """The Pareto front, from fast to accurate: no setting is both faster and more accurate."""
        own = [one for one in self.points if not one.failed and not one.setting.outside]
        front: list[Point] = []
        for one in sorted(own, key=cost):
            if not front or one.error < front[-1].error:
                front.append(one)
        return tuple(front)

    def advice(self, tolerance: float) -> Advice:
        """Which setting to take for a tolerance, and from how many starts."""
        return advice(self.points, self.floor, tolerance)

    def cheapest(self, tolerance: float) -> Point | None:
        """The fastest setting one run of which is accurate to a tolerance, and not so by luck."""
        found = self.advice(tolerance)
        return None if found.below_floor else found.point

    def usual(self) -> Point | None:
        """The default method and step, in the first form that was tried and did not fail."""
        ones = (one for one in self.points if not one.failed)
        return next((one for one in ones if one.setting[:2] == USUAL), None)

    def families(self) -> dict[str, tuple[Point, ...]]:
        """The points by family, from coarse to fine."""
        return families(self.points)

    def digit(self) -> float | None:
        """What a digit costs: how many times as long, along the front; None without two points."""
        ones = [one for one in self.front() if one.error > max(0.0, one.doubt)]
        if len(ones) < 2 or not ones[-1].error < ones[0].error:
            return None
        digits = math.log10(ones[0].error / ones[-1].error)
        return float((ones[-1].seconds / ones[0].seconds) ** (1.0 / digits))

    def table(self) -> TextTable:
        """One row a setting, the front marked with a star."""
        front = self.front()
        rows = []
        for one in self.points:
            said = "" if one.failure is None else one.failure.split(":", 1)[0]
            shown = (
                f"{one.error:.3g}", f"{one.doubt:.1g}" if one.doubt else "",
                f"{one.seconds:.3g}", f"{one.steps}",
            )  # fmt: skip
            rows.append(
                ("*" if one in front else "", one.setting.family, one.setting.fineness,
                 *(("",) * 4 if said else shown), said)
            )  # fmt: skip
        unit = "" if self.unit == "1" else f" [{self.unit}]"
        header = ("", "setting", "dt", f"error of the {self.quantity}{unit}", "standard error",
                  "seconds", "steps", "failed")  # fmt: skip
        return table(header, rows)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw error over seconds, a line a family, what to take ringed, the floor as a band."""
        from granular.shared.plotting import axes_or_new
        from validation.cost.picture import draw

        axes = axes_or_new(ax)
        levels = {words: self.advice(level) for words, level in LEVELS.items()}
        draw(axes, self.points, self.front(), self.floor, levels)
        unit = "" if self.unit == "1" else f" [{self.unit}]"
        axes.set_ylabel(f"error of the {self.quantity}{unit}")
        return axes

    def to_plain(self) -> dict[str, Any]:
        """The result as plain data; None for what was not measured."""
        plain = dataclasses.asdict(self)
        for row, one in zip(plain["points"], self.points, strict=True):
            row["setting"] = {**one.setting._asdict(), "changes": dict(one.setting.changes)}
            row |= {name: _finite(row[name]) for name in ("error", "seconds")}
        return plain

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> WorkPrecision:
        """The result from what `to_plain` made, also by way of JSON."""
        points = tuple(
            Point(**{
                **row, "setting": Setting(**row["setting"]), "error": _number(row["error"]),
                "seconds": _number(row["seconds"]),
            })
            for row in plain["points"]
        )  # fmt: skip
        return cls(**{**plain, "points": points})


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return math.nan if value is None else value
