"""Errors and wall times of many settings: the front, the advice, a table and a picture."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from granular.shared.plotting import COLOURS, GREY, STYLES, axes_or_new
from validation.cost.advised_setting import (
    USUAL,
    AdvisedSetting,
    WorkPrecisionPoint,
    advise_setting,
    group_by_family,
    time_then_error,
)
from validation.report_tasks import PlainData
from validation.text_tables import TextTable, text_table

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
    points : tuple of WorkPrecisionPoint
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
    points: tuple[WorkPrecisionPoint, ...]
    floor: float
    reference: str

    def pareto_front(self) -> tuple[WorkPrecisionPoint, ...]:
        """Pareto front, from fast to accurate: no setting is both faster and more accurate."""
        own = [point for point in self.points if not point.has_failed and not point.setting.is_external]
        front: list[WorkPrecisionPoint] = []
        for point in sorted(own, key=time_then_error):
            if not front or point.error < front[-1].error:
                front.append(point)
        return tuple(front)

    def advise(self, tolerance: float) -> AdvisedSetting:
        """Return the setting to take for a tolerance, and from how many starts."""
        return advise_setting(self.points, self.floor, tolerance)

    def cheapest_point(self, tolerance: float) -> WorkPrecisionPoint | None:
        """Fastest setting one run of which is accurate to a tolerance, and not so by luck."""
        result = self.advise(tolerance)
        return None if result.needs_more_starts else result.point

    def default_point(self) -> WorkPrecisionPoint | None:
        """Point of the default method and step, in the first form that did not fail."""
        finished = (point for point in self.points if not point.has_failed)
        return next((point for point in finished if point.setting[:2] == USUAL), None)

    def points_by_family(self) -> dict[str, tuple[WorkPrecisionPoint, ...]]:
        """Points by family, from coarse to fine."""
        return group_by_family(self.points)

    def cost_of_digit(self) -> float | None:
        """Factor by which the time grows for a tenth of the error, along the Pareto front."""
        points = [point for point in self.pareto_front() if point.error > max(0.0, point.doubt)]
        if len(points) < 2 or not points[-1].error < points[0].error:
            return None
        digits = math.log10(points[0].error / points[-1].error)
        return float((points[-1].seconds / points[0].seconds) ** (1.0 / digits))

    def table(self) -> TextTable:
        """One row a setting, the front marked with a star."""
        front = self.pareto_front()
        rows = []
        for point in self.points:
            said = "" if point.failure is None else point.failure.split(":", 1)[0]
            shown = (
                f"{point.error:.3g}",
                f"{point.doubt:.1g}" if point.doubt else "",
                f"{point.seconds:.3g}",
                f"{point.steps}",
            )
            rows.append(
                (
                    "*" if point in front else "",
                    point.setting.family,
                    point.setting.fineness,
                    *(("",) * 4 if said else shown),
                    said,
                )
            )
        unit = "" if self.unit == "1" else f" [{self.unit}]"
        header = (
            "",
            "setting",
            "dt",
            f"error of the {self.quantity}{unit}",
            "standard error",
            "seconds",
            "steps",
            "failed",
        )
        return text_table(header, rows)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw error over seconds, a line a family, what to take ringed, the floor as a band."""
        axes = axes_or_new(ax)
        levels = {words: self.advise(level) for words, level in LEVELS.items()}
        _draw_error_over_cost(axes, self.points, self.pareto_front(), self.floor, levels)
        unit = "" if self.unit == "1" else f" [{self.unit}]"
        axes.set_ylabel(f"error of the {self.quantity}{unit}")
        return axes


# Picture ----------------------------------------------------------------------------------------


def _draw_error_over_cost(
    axes: Axes,
    points: Sequence[WorkPrecisionPoint],
    front: Sequence[WorkPrecisionPoint],
    floor: float,
    levels: Mapping[str, AdvisedSetting],
) -> None:
    """Draw error over seconds, a line a family, with the bounds of the errors as thin bars."""
    for k, (name, family) in enumerate(group_by_family(points).items()):
        _draw_family(axes, name, family, k)
    best = [candidate for candidate in front if candidate.error > 0.0]
    axes.loglog(
        [point.seconds for point in best],
        [point.error for point in best],
        color=GREY,
        linewidth=5.0,
        alpha=0.35,
        zorder=0,
        label="best of all",
    )
    for words, advised in levels.items():
        axes.axhline(advised.tolerance, color="#333333", linewidth=0.6, linestyle=":")
        _mark_advised_setting(axes, words, advised)
    if floor > 0.0:
        low, high = axes.get_ylim()
        axes.axhspan(low, floor, color=GREY, alpha=0.2, linewidth=0.0)
        axes.set_ylim(low, max(high, 1.2 * floor))
    label_run_times(axes)
    axes.set_xlabel("wall time [s]")


def _draw_family(axes: Axes, name: str, points: Sequence[WorkPrecisionPoint], k: int) -> None:
    done = [point for point in points if not point.has_failed and point.error > 0.0]
    failed = sum(point.has_failed for point in points)
    outside = points[0].setting.is_external
    seconds, errors = [point.seconds for point in done], [point.error for point in done]
    colour = COLOURS[k % len(COLOURS)]
    axes.loglog(
        seconds,
        errors,
        marker="x" if outside else "o",
        markersize=3.5,
        color=colour,
        linestyle=":" if outside else STYLES[k // len(COLOURS) % len(STYLES)],
        linewidth=0.9 if outside else 1.5,
        label=f"{name} ({failed} failed)" if failed else name,
    )
    if any(point.doubt > 0.0 for point in done):
        axes.vlines(seconds, errors, [point.upper_error_bound for point in done], color=colour, linewidth=0.9)


def _mark_advised_setting(axes: Axes, words: str, advised: AdvisedSetting) -> None:
    """Ring the setting to take for a level, and name it at the level's line."""
    best = advised.point
    if best is not None and not advised.needs_more_starts and best.error > 0.0:
        axes.plot(
            best.seconds,
            best.error,
            "o",
            markersize=11.0,
            color="#333333",
            markerfacecolor="none",
            markeredgewidth=1.4,
        )
    said = f"{advised.starts:.2g} starts" if advised.needs_more_starts else str(advised)
    axes.annotate(
        f"{words}: {said}",
        (0.99, advised.tolerance),
        xycoords=("axes fraction", "data"),
        xytext=(0, 3),
        textcoords="offset points",
        ha="right",
        fontsize=8,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
    )


def label_run_times(axes: Axes) -> None:
    """Label an axis of run times [s] as they are read: 0.02, 0.05, 0.1 s."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axes.get_xlim()
    subs = (1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,)
    axes.xaxis.set_major_locator(LogLocator(subs=subs))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
