"""Errors and wall times of many settings: the front, the advice, a table and a picture."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from granular.shared.plotting import COLOURS, GREY, STYLES, axes_or_new
from validation.cost.point import (
    USUAL,
    Advice,
    Point,
    advice,
    cost,
    families,
)
from validation.runner import PlainData
from validation.table import TextTable, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEVELS = {"1 %": 1e-2, "0.1 %": 1e-3, "1e-6": 1e-6}
"""Tolerances that a picture answers for."""


@dataclasses.dataclass(frozen=True)
class WorkPrecision(PlainData):
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
        """Return the setting to take for a tolerance, and from how many starts."""
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
        """Return how many times as long a digit takes, along the front; None without two points."""
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
        axes = axes_or_new(ax)
        levels = {words: self.advice(level) for words, level in LEVELS.items()}
        _draw(axes, self.points, self.front(), self.floor, levels)
        unit = "" if self.unit == "1" else f" [{self.unit}]"
        axes.set_ylabel(f"error of the {self.quantity}{unit}")
        return axes


# Picture ----------------------------------------------------------------------------------------


def _draw(
    axes: Axes, points: Sequence[Point], front: Sequence[Point], floor: float,
    levels: Mapping[str, Advice],
) -> None:  # fmt: skip
    """Draw error over seconds, a line a family, with the bounds of the errors as thin bars.

    A family's label says how many of its settings failed.
    """
    for k, (name, ones) in enumerate(families(points).items()):
        _draw_family(axes, name, ones, k)
    best = [one for one in front if one.error > 0.0]
    axes.loglog(
        [one.seconds for one in best], [one.error for one in best],
        color=GREY, linewidth=5.0, alpha=0.35, zorder=0, label="best of all",
    )  # fmt: skip
    for words, advised in levels.items():
        axes.axhline(advised.tolerance, color="#333333", linewidth=0.6, linestyle=":")
        _mark(axes, words, advised)
    if floor > 0.0:
        low, high = axes.get_ylim()
        axes.axhspan(low, floor, color=GREY, alpha=0.2, linewidth=0.0)
        axes.set_ylim(low, max(high, 1.2 * floor))
    plain_numbers(axes)
    axes.set_xlabel("wall time [s]")


def _draw_family(axes: Axes, name: str, points: Sequence[Point], k: int) -> None:
    done = [one for one in points if not one.failed and one.error > 0.0]
    failed = sum(one.failed for one in points)
    outside = points[0].setting.outside
    seconds, errors = [one.seconds for one in done], [one.error for one in done]
    colour = COLOURS[k % len(COLOURS)]
    axes.loglog(
        seconds, errors,
        marker="x" if outside else "o", markersize=3.5, color=colour,
        linestyle=":" if outside else STYLES[k // len(COLOURS) % len(STYLES)],
        linewidth=0.9 if outside else 1.5, label=f"{name} ({failed} failed)" if failed else name,
    )  # fmt: skip
    if any(one.doubt > 0.0 for one in done):
        axes.vlines(seconds, errors, [one.bound for one in done], color=colour, linewidth=0.9)


def _mark(axes: Axes, words: str, advised: Advice) -> None:
    """Ring the setting to take for a level, and name it at the level's line."""
    best = advised.point
    if best is not None and not advised.below_floor and best.error > 0.0:
        axes.plot(best.seconds, best.error, "o", markersize=11.0, color="#333333",
                  markerfacecolor="none", markeredgewidth=1.4)  # fmt: skip
    said = f"{advised.starts:.2g} starts" if advised.below_floor else str(advised)
    axes.annotate(
        f"{words}: {said}", (0.99, advised.tolerance), xycoords=("axes fraction", "data"),
        xytext=(0, 3), textcoords="offset points", ha="right", fontsize=8,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
    )  # fmt: skip


def plain_numbers(axes: Axes) -> None:
    """Label seconds as they are read: 0.02, 0.05, 0.1; fewer of them over many decades."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axes.get_xlim()
    subs = (1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,)
    axes.xaxis.set_major_locator(LogLocator(subs=subs))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
