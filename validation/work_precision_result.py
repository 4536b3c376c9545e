"""Errors and wall times of many settings, and the setting to recommend for a tolerance.

Each setting is run from the same few random initial states (starts). Its error is the mean deviation from a
reference for the same starts, with a standard error. The scatter between starts is the floor of the error
of a single run. An error below the floor is reached by averaging more starts, not by a shorter step. A failed
setting is shown as a failure.
Positions may also be computed by external integrators (`validation.external_integrators`); these are shown
but never recommended.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

from granular.run.work_precision import FLOORS, packing_count_to_average
from granular.shared.blocks import Table
from granular.shared.plotting import GREY, axes_or_new, line_style
from validation.external_integrators import ORDERS
from validation.report_tasks import PlainData, label_horizontal_line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SURE = 0.95
"""Probability, one-sided, that an error lies below its upper bound."""


class SolverSettings(NamedTuple):
    """Method, step and changes with which a scene is run.

    Attributes
    ----------
    method : str
        Name of a method, or of an external integrator, one of `validation.external_integrators.ORDERS`.
    dt : float or str
        Time step [s], or a rule such as ``"auto"``; for an external integrator its tolerance, dimensionless.
    changes : mapping of str to anything
        Changes to the scene, by dotted keys, as `granular.Scene.replace` takes them.
    """

    method: str
    dt: float | str
    changes: Mapping[str, Any] = {}

    @property
    def is_external(self) -> bool:
        """True if the method is one of the integrators in `validation.external_integrators.ORDERS`."""
        return self.method in ORDERS

    @property
    def fineness(self) -> str:
        """The step (seconds or a rule) as text; for an external integrator its tolerance, dimensionless."""
        return f"tolerance {self.dt}" if self.is_external else str(self.dt)

    @property
    def family(self) -> str:
        """Text of method and changes, the same for settings that differ only in their step."""
        changes = (f"{key.rpartition('.')[2]} {change}" for key, change in self.changes.items())
        return ", ".join([self.method, *changes])


USUAL = ("stormer-verlet", "auto")
"""Default method and step of `granular.simulate`."""


@cache
def standard_errors_to_upper_bound(starts: int) -> float:
    """Return how many standard errors, 2 or more, the one-sided 95 % bound is above the mean."""
    # The factor is Student's quantile, since the scatter is estimated from the same starts. A single start
    # has no scatter.
    if starts < 2:
        return 0.0
    from scipy.stats import t as student

    return max(2.0, float(student.ppf(SURE, starts - 1)))


@dataclasses.dataclass(frozen=True)
class WorkPrecisionPoint:
    """Error and time of one setting."""

    setting: SolverSettings
    error: float  # mean over the starts; NaN if it failed
    seconds: float  # of one run [s]
    steps: int
    failure: str | None = None
    doubt: float = 0.0  # standard error of ``error``; 0 for one start
    starts: int = 1
    frequency: float = 0.0  # step times highest frequency in the runs; 0 for variable steps

    @property
    def has_failed(self) -> bool:
        """True if the run of the setting ended in an error."""
        return self.failure is not None

    def cells(self) -> tuple[str, ...]:
        """Return error, standard error, seconds and steps for a table, or the error that ended the run."""
        if self.failure is not None:
            return "", "", "", "", self.failure.split(":", 1)[0]
        doubt = f"{self.doubt:.1g}" if self.doubt else ""
        return f"{self.error:.3g}", doubt, f"{self.seconds:.3g}", f"{self.steps}", ""

    @property
    def upper_error_bound(self) -> float:
        """Upper bound of the error, one-sided at 95 % over the starts, in the error's unit."""
        return self.error + standard_errors_to_upper_bound(self.starts) * self.doubt

    @property
    def lower_error_bound(self) -> float:
        """Lower bound of the error, one-sided at 95 % over the starts, in the error's unit; 0 or more."""
        return max(0.0, self.error - standard_errors_to_upper_bound(self.starts) * self.doubt)


def time_and_error_sort_key(point: WorkPrecisionPoint) -> tuple[float, float]:
    """Return a key for sorting: by time [s], and at equal times by error."""
    return point.seconds, point.error


def group_by_family(points: Iterable[WorkPrecisionPoint]) -> dict[str, tuple[WorkPrecisionPoint, ...]]:
    """Group points by family (method and changes of the scene), each from coarse to fine steps."""
    result: dict[str, list[WorkPrecisionPoint]] = {}
    for point in points:
        result.setdefault(point.setting.family, []).append(point)
    # Failed runs count as the coarsest, since runs fail from too long a step.
    for group in result.values():
        group.sort(key=lambda point: 0 if point.has_failed else point.steps)
    return {name: tuple(group) for name, group in result.items()}


class AdvisedSetting(NamedTuple):
    """Recommended setting for a tolerance, and the number of starts to average over."""

    tolerance: float
    point: WorkPrecisionPoint | None  # None if no setting reaches the tolerance
    starts: int  # number to average over; 1 if a single run is accurate enough
    floor: float  # scatter of the quantity over the starts

    @property
    def needs_more_starts(self) -> bool:
        """True if the scatter between starts prevents a single run from reaching the tolerance."""
        return self.tolerance < FLOORS * self.floor

    @property
    def seconds(self) -> float:
        """Total wall time of all runs [s]; NaN if no setting is recommended."""
        return math.nan if self.point is None else self.starts * self.point.seconds

    def __str__(self) -> str:
        if self.needs_more_starts:
            words = f"single runs scatter by {self.floor:.2g} over the starts"
            if self.point is None:
                return f"{words}, and every setting tried also has a systematic error"
            return f"{words}; the mean of {self.starts:.3g} starts takes {duration_text(self.seconds)}"
        if self.point is None:
            return "not reached"
        return f"{self.point.setting.family}, {self.point.setting.fineness}"


def duration_text(seconds: float) -> str:
    """Return the text of a duration in suitable units: 0.3 s, 12 minutes, 5 days."""
    sizes = (("years", 3.156e7), ("days", 86400.0), ("hours", 3600.0), ("minutes", 120.0))
    for unit, size in sizes:
        if seconds >= size:
            count = seconds / (60.0 if unit == "minutes" else size)
            return f"{float(f'{count:.2g}'):g} {unit}"
    return f"{seconds:.2g} s"


def advise_setting_and_averaging(
    points: Iterable[WorkPrecisionPoint], floor: float, tolerance: float
) -> AdvisedSetting:
    """Return the fastest setting that reaches a tolerance, and the number of starts to average over."""
    own = [point for point in points if not point.setting.is_external]
    if tolerance < FLOORS * floor:
        best = min(
            (point for fam in group_by_family(own).values() for point in points_without_clear_error(fam)),
            key=time_and_error_sort_key,
            default=None,
        )
        return AdvisedSetting(tolerance, best, packing_count_to_average(floor, tolerance), floor)
    sound = [point for fam in group_by_family(own).values() for point in accurate_points(fam, tolerance)]
    return AdvisedSetting(tolerance, min(sound, key=time_and_error_sort_key, default=None), 1, floor)


def accurate_points(family: Sequence[WorkPrecisionPoint], tolerance: float) -> list[WorkPrecisionPoint]:
    """Return points within a tolerance, from fine to coarse; stop at an error clearly above it."""
    # The upper bound of the error must be within the tolerance, and no point of the family with more steps
    # may lie clearly above the tolerance. An error that is small by chance at a long step grows again at a
    # shorter one.
    return [
        point
        for point in _fine_points_before_inaccurate_one(family, tolerance)
        if point.upper_error_bound <= tolerance
    ]


def points_without_clear_error(family: Sequence[WorkPrecisionPoint]) -> list[WorkPrecisionPoint]:
    """Return the points whose errors, like the errors of all finer points, are compatible with zero."""
    return list(_fine_points_before_inaccurate_one(family, 0.0))


def _fine_points_before_inaccurate_one(
    family: Sequence[WorkPrecisionPoint], tolerance: float
) -> Iterator[WorkPrecisionPoint]:
    """Yield points from fine to coarse; stop at a failed point or an error clearly above a tolerance."""
    return itertools.takewhile(
        lambda point: not point.has_failed and point.lower_error_bound <= tolerance, reversed(family)
    )


LEVELS = {"1 %": 1e-2, "0.1 %": 1e-3, "1e-6": 1e-6}
"""Tolerances for which a plot marks the recommended setting."""


@dataclasses.dataclass(frozen=True)
class WorkPrecision(PlainData):
    """Errors and wall times of many settings.

    Attributes
    ----------
    scene, quantity, unit : str
        ``unit`` is the unit of the errors: ``"1"`` if they are relative.
    horizon : float or None
        Time at which the runs were stopped [s]; None for the complete protocol.
    points : tuple of WorkPrecisionPoint
        Error and time of each setting.
    floor : float
        Standard deviation of the quantity between starts, in ``unit``. It is 0 for one start, and for a
        quantity that necessarily differs between starts, such as positions.
    reference : str
        Value or run with which results are compared.
    """

    scene: str
    quantity: str
    unit: str
    horizon: float | None
    points: tuple[WorkPrecisionPoint, ...]
    floor: float
    reference: str

    def pareto_front(self) -> tuple[WorkPrecisionPoint, ...]:
        """Pareto front, from fast to accurate: no other setting is better in both time and error."""
        own = [point for point in self.points if not point.has_failed and not point.setting.is_external]
        front: list[WorkPrecisionPoint] = []
        for point in sorted(own, key=time_and_error_sort_key):
            if not front or point.error < front[-1].error:
                front.append(point)
        return tuple(front)

    def advise(self, tolerance: float) -> AdvisedSetting:
        """Return the recommended setting for a tolerance, and the number of starts to average over."""
        return advise_setting_and_averaging(self.points, self.floor, tolerance)

    def cheapest_point(self, tolerance: float) -> WorkPrecisionPoint | None:
        """Return the fastest setting for a tolerance; None if a single run cannot reach the tolerance."""
        result = self.advise(tolerance)
        return None if result.needs_more_starts else result.point

    def default_point(self) -> WorkPrecisionPoint | None:
        """Return the first successful point with the default method and step, or None."""
        finished = (point for point in self.points if not point.has_failed)
        return next((point for point in finished if point.setting[:2] == USUAL), None)

    def points_by_family(self) -> dict[str, tuple[WorkPrecisionPoint, ...]]:
        """Return the points by family, from coarse to fine."""
        return group_by_family(self.points)

    def time_factor_per_digit(self) -> float | None:
        """Return the factor by which the time grows along the Pareto front if the error falls to a tenth."""
        points = [point for point in self.pareto_front() if point.error > max(0.0, point.doubt)]
        if len(points) < 2 or not points[-1].error < points[0].error:
            return None
        digits = math.log10(points[0].error / points[-1].error)
        return float((points[-1].seconds / points[0].seconds) ** (1.0 / digits))

    @property
    def scene_and_duration_label(self) -> str:
        """Name of the scene, and the duration of its runs if they end before the protocol does."""
        return self.scene if self.horizon is None else f"{self.scene} over {self.horizon:g} s"

    @property
    def error_label(self) -> str:
        """Name of the error, with its unit."""
        return f"error of the {self.quantity}" + ("" if self.unit == "1" else f" [{self.unit}]")

    def table(self) -> Table:
        """Return one row per setting, with a star for the Pareto front."""
        front = self.pareto_front()
        rows = [
            ("*" if point in front else "", point.setting.family, point.setting.fineness, *point.cells())
            for point in self.points
        ]
        numbers = (self.error_label, "standard error", "seconds", "steps", "failed")
        return Table(("", "setting", "dt", *numbers), rows)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw error against time: lines for families, rings at recommended settings, the floor shaded."""
        axes = axes_or_new(ax)
        for k, (name, family) in enumerate(self.points_by_family().items()):
            _draw_family(axes, name, family, k)
        best = [point for point in self.pareto_front() if point.error > 0.0]
        seconds, errors = [point.seconds for point in best], [point.error for point in best]
        broad: dict[str, Any] = {"color": GREY, "linewidth": 5.0, "alpha": 0.35, "zorder": 0}
        axes.loglog(seconds, errors, label="Pareto front", **broad)
        for words, level in LEVELS.items():
            axes.axhline(level, color=DARK, linewidth=0.6, linestyle=":")
            _mark_advised_setting(axes, words, self.advise(level))
        if self.floor > 0.0:
            low, high = axes.get_ylim()
            axes.axhspan(low, self.floor, color=GREY, alpha=0.2, linewidth=0.0)
            axes.set_ylim(low, max(high, 1.2 * self.floor))
        label_run_time_axis(axes)
        axes.set(xlabel="wall time [s]", ylabel=self.error_label)
        return axes


# Picture ----------------------------------------------------------------------------------------

DARK = "#333333"


def _draw_family(axes: Axes, name: str, points: Sequence[WorkPrecisionPoint], k: int) -> None:
    failed = sum(point.has_failed for point in points)
    label = f"{name} ({failed} failed)" if failed else name
    if points[0].setting.is_external:
        style: dict[str, Any] = {"marker": "x", "linestyle": ":", "linewidth": 0.9}
    else:
        style = {"marker": "o", "linewidth": 1.5}
    draw_work_precision_points(axes, points, label, **line_style(k) | style)


def draw_work_precision_points(
    axes: Axes, points: Sequence[WorkPrecisionPoint], label: str, **style: Any
) -> None:
    """Draw errors against wall time as a line, with thin bars up to the upper bounds of the errors."""
    done = [point for point in points if not point.has_failed and point.error > 0.0]
    seconds, errors = [point.seconds for point in done], [point.error for point in done]
    axes.loglog(seconds, errors, markersize=3.5, label=label, **style)
    if any(point.doubt > 0.0 for point in done):
        bounds = [point.upper_error_bound for point in done]
        axes.vlines(seconds, errors, bounds, color=style["color"], linewidth=0.9)


def _mark_advised_setting(axes: Axes, words: str, advised: AdvisedSetting) -> None:
    """Draw a ring at the setting recommended for a tolerance, and its name at the tolerance's line."""
    best = advised.point
    if best is not None and not advised.needs_more_starts and best.error > 0.0:
        ring: dict[str, Any] = {"markersize": 11.0, "markerfacecolor": "none", "markeredgewidth": 1.4}
        axes.plot(best.seconds, best.error, "o", color=DARK, **ring)
    said = f"{advised.starts:.2g} starts" if advised.needs_more_starts else str(advised)
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
    label_horizontal_line(axes, f"{words}: {said}", advised.tolerance, bbox=box)


def label_run_time_axis(axes: Axes) -> None:
    """Label an axis of run times [s] in decimals: 0.02, 0.05, 0.1 s."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axes.get_xlim()
    subs = (1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,)
    axes.xaxis.set_major_locator(LogLocator(subs=subs))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
