"""Results of convergence studies: errors for each step, fitted slope, tables, plots and verdicts."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.shared.blocks import Block, Caution, Picture, Table, Text
from granular.shared.plotting import axes_or_new, line_style
from validation.external_integrators import ORDERS
from validation.report_tasks import PlainData, make_one_axes_picture

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

HIGH_ORDER = 6
"""Methods of this order or more count as methods of high order (see `validation.convergence_order`)."""

CLEAR = 7.0
"""Minimum ratio of an error in a fit to the rounding error. At this ratio rounding changes the slope over a
decade by 0.04 at most, and only for methods of order four or more, whose finest steps come this close to
rounding."""

DECADE = 10.0
MINIMUM_SPAN = 3.0
"""Minimum ratio of the coarsest to the finest step in a fit. A fit over less than a decade is marked."""

# With three points the slope has one degree of freedom, for which Student's t at 95 % is 12.7, not 4.3.
_MINIMUM_POINTS = 4
_SLACK = 0.98  # numbers of steps are integers, so a decade may be slightly less


class FittedSlope(NamedTuple):
    """A fitted slope."""

    value: float
    interval: tuple[float, float]  # 95 % interval; errors are not random, so it measures straightness
    first: int  # index of the coarsest step in the fit
    last: int  # index of the finest step in the fit


def fit_convergence_slope(
    steps: Sequence[float], errors: Sequence[float], rounding: float
) -> FittedSlope | None:
    """Fit the slope over the finest decade of steps [s] with errors of `CLEAR` times the rounding or more."""
    clear = [k for k, error in enumerate(errors) if error > CLEAR * rounding]
    # Beyond the first error near rounding, a larger error is a coincidence.
    while clear and clear[-1] != len(clear) - 1:
        clear.pop()
    if len(clear) < _MINIMUM_POINTS or steps[0] < MINIMUM_SPAN * _SLACK * steps[clear[-1]]:
        return None
    last = clear[-1]
    first = max((k for k in clear if steps[k] >= DECADE * _SLACK * steps[last]), default=0)
    return fit_slope_with_interval(steps, errors, first, last)


def fit_slope_with_interval(
    steps: Sequence[float], errors: Sequence[float], first: int, last: int
) -> FittedSlope:
    from scipy import stats

    chosen = slice(first, last + 1)
    line = stats.linregress(np.log(steps[chosen]), np.log(errors[chosen]))
    margin = float(stats.t.ppf(0.975, last - first - 1)) * float(line.stderr)
    value = float(line.slope)
    return FittedSlope(value, (value - margin, value + margin), first, last)


@dataclasses.dataclass(frozen=True)
class ConvergenceResult(PlainData):
    """Errors of one method on one exact problem.

    Attributes
    ----------
    problem, method : str
        Names of the problem and of the method.
    order : int
        Declared order of the method.
    smooth : bool
        True if the motion is smooth enough for a method to show its order.
    steps : tuple of float
        Time steps, from coarse to fine [s].
    errors : tuple of float
        Maximum error of a coordinate at the problem's time [m].
    rounding : float
        Rounding error at the finest step [m].
    fit : FittedSlope or None
        Fitted slope; None if too few errors are well above rounding, or no step was short enough.
    seconds : tuple of float
        Wall time of a run with each step.
    """

    problem: str
    method: str
    order: int
    smooth: bool
    steps: tuple[float, ...]
    errors: tuple[float, ...]
    rounding: float
    fit: FittedSlope | None
    seconds: tuple[float, ...]

    @property
    def local_slopes(self) -> tuple[float, ...]:
        """Slopes between successive steps, one fewer than there are steps; NaN if an error is zero."""
        return tuple(
            math.log(e0 / e1) / math.log(h0 / h1) if e0 > 0.0 < e1 else math.nan
            for h0, h1, e0, e1 in zip(self.steps, self.steps[1:], self.errors, self.errors[1:], strict=False)
        )

    @property
    def is_exact(self) -> bool:
        """True if no error is well above rounding, that is, above seven times the rounding error."""
        return max(self.errors) <= CLEAR * self.rounding

    def shows_declared_order(self, tolerance: float) -> bool:
        """Return True if the slope is the declared order within a tolerance, or the method is exact."""
        if self.is_exact:
            return True
        return self.fit is not None and abs(self.fit.value - self.order) <= tolerance

    @property
    def decades_of_fit(self) -> float:
        """Decades of steps in the fit of the slope; 0 without a fit."""
        if self.fit is None:
            return 0.0
        return math.log10(self.steps[self.fit.first] / self.steps[self.fit.last])

    def table_row(self) -> tuple[str, ...]:
        """Return the row of this result in a table of results; see `HEADER`."""
        measured = "exact to rounding" if self.is_exact else "too few steps above rounding"
        interval = steps_range = ""
        if self.fit is not None:
            measured = f"{self.fit.value:.4f}"
            interval = f"{self.fit.interval[0]:.3f} to {self.fit.interval[1]:.3f}"
            first, last = self.steps[self.fit.first], self.steps[self.fit.last]
            steps_range = f"{first:.3g} to {last:.3g} ({self.decades_of_fit:.2f} decades)"
        declared = str(self.order) if self.smooth else f"{self.order}, motion not smooth"
        return (
            self.problem,
            self.method,
            declared,
            measured,
            interval,
            steps_range,
            f"{min(self.errors):.2g}",
            f"{self.rounding:.1g}",
        )

    def table(self) -> Table:
        """Return a table of step [s], error [m], local slope and wall time [s] of each run."""
        slopes = ("", *(f"{slope:.3f}" for slope in self.local_slopes))
        rows = [
            (f"{h:.4g}", f"{error:.4g}", slope, f"{seconds:.3g}")
            for h, error, slope, seconds in zip(self.steps, self.errors, slopes, self.seconds, strict=True)
        ]
        return Table(("step [s]", "error [m]", "slope", "seconds"), rows)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return one row per run: step [s], error [m], slope from the previous step, wall time [s]."""
        import pandas

        slopes = (math.nan, *self.local_slopes)
        columns = {"step": self.steps, "error": self.errors, "slope": slopes}
        return pandas.DataFrame({**columns, "seconds": self.seconds})

    def plot(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Draw the error [m] against the step [s], with the fitted line, on logarithmic axes."""
        axes = axes_or_new(ax)
        errors = np.array(self.errors)
        shown = np.where(errors > 0.0, errors, np.nan)
        label = self.method if self.fit is None else f"{self.method}, slope {self.fit.value:.3f}"
        axes.loglog(self.steps, shown, marker="o", markersize=3.5, label=label, **style)
        if self.fit is not None:
            chosen = slice(self.fit.first, self.fit.last + 1)
            colour = axes.lines[-1].get_color()
            axes.loglog(self.steps[chosen], shown[chosen], linewidth=3.0, alpha=0.35, color=colour)
        axes.set(xlabel="time step [s]", ylabel="error [m]")
        for line in (axes.xaxis, axes.yaxis):
            line.set_minor_formatter("")  # labels between powers of ten would overlap
        return axes


HEADER = (
    "problem",
    "method",
    "order",
    "slope",
    "95 % interval",
    "steps of the fit [s]",
    "smallest error [m]",
    "rounding [m]",
)


def convergence_table(results: Sequence[ConvergenceResult]) -> Table:
    """Make a table of convergence results, one row per result.

    Parameters
    ----------
    results : sequence of ConvergenceResult
        Results, one for each method and problem.

    Returns
    -------
    Table
        Texts under `HEADER`: problem, method, declared order, measured slope with its 95 % interval (or the
        reason why it is missing), steps of the fit [s], smallest error [m] and rounding error [m].
    """
    return Table(HEADER, [result.table_row() for result in results])


# In the report ----------------------------------------------------------------------------------

# An error of order p falls through all sixteen digits in 16/p decades of steps, so high orders have few
# points between rounding and the next term of the error.
TOLERANCES = {2: 0.02, 6: 0.1, 10: 0.3}
"""Maximum difference between slope and declared order, by the highest order to which it applies."""

# Decades of steps that a slope must span, for orders up to six; numbers of steps are integers.
FULL = 0.99

# For a root there are two halvings: the error of a root is made in one step, so rounding sets in sooner.
ROOT_SPAN = 0.6

BED_ROOT = "bed-root"
"""Name of the problem in which the root of a small motion is compared."""

OUTSIDE_REACH = 1e-12
"""Error [m] of the position that an external integrator must reach."""


def convergence_blocks(results: Sequence[ConvergenceResult]) -> list[Block]:
    """Make the table of slopes and, for each problem, a plot of the error against the step."""
    intro = (
        "Final error relative to the exact solution (closed forms, or quadrature of the energy "
        "integral to thirty digits), against the time step. The slope is fitted to the finest decade of "
        f"steps whose error is {CLEAR:g} times the measured rounding error or more; its "
        "interval measures how straight the line is. A motion that is not smooth (friction stops the grain) "
        "limits every method to order two. Methods of order six and more run with "
        "compensated sums, so that a decade of steps lies above rounding; SciPy and diffrax are "
        "external references with separately written forces, which must reach the same exact solution. "
        "The problem bed-root measures a root s of small motions exp(s t) of three magnets under a piston "
        "at rest; the exact root comes from linear algebra, and the slope from two halvings of the step. If "
        "a cell is empty, the method cannot run the problem, or was not run on it."
    )
    failed = [
        Caution(f"{result.method} on {result.problem} does not show its order {result.order}.")
        for result in results
        if not convergence_holds(result)
    ]
    problems = dict.fromkeys(result.problem for result in results)
    pictures = [_picture_of_problem(name, results) for name in problems]
    return [Text(intro), slope_table(results), *failed, *pictures]


def _picture_of_problem(name: str, results: Sequence[ConvergenceResult]) -> Picture | Text:
    group = [result for result in results if result.problem == name and not result.is_exact]
    if not group:
        return Text(f"On {name} every method shown is exact to rounding.")

    def draw(axes: Axes) -> None:
        for k, result in enumerate(group):
            result.plot(axes, linewidth=1.0, **line_style(k))

    return make_one_axes_picture(draw, f"{name}: final error against the time step.", height=5.2)


def slope_table(results: Sequence[ConvergenceResult]) -> Table:
    """Make the table of measured slopes: one row per method, one column per problem."""
    problems = tuple(dict.fromkeys(result.problem for result in results))
    declared = {result.method: result.order for result in results}
    cells = {(result.method, result.problem): _slope_text(result) for result in results}
    rows = [
        (method, order, *(cells.get((method, problem), "") for problem in problems))
        for method, order in sorted(declared.items(), key=lambda pair: pair[1])
    ]
    return Table(("method", "order", *problems), rows)


def _slope_text(result: ConvergenceResult) -> str:
    wrong = "" if convergence_holds(result) else " (!)"
    if result.fit is None:
        return f"{'exact' if result.is_exact else 'too few steps'}{wrong}"
    return f"{result.fit.value:.3f}{wrong}"


def convergence_holds(result: ConvergenceResult) -> bool:
    """Return True if the slope over a decade is the declared order, or the method is exact here."""
    if not result.smooth:
        return result.fit is not None and abs(result.fit.value - min(result.order, 2)) <= 0.1
    if result.method in ORDERS:
        # The order of external integrators is not tested; they must reach the exact solution.
        return min(result.errors) <= OUTSIDE_REACH
    if result.fit is None and result.order > HIGH_ORDER:
        return True  # errors of order eight reach rounding within half a decade of steps
    clear = (
        result.is_exact
        or result.decades_of_fit >= (ROOT_SPAN if result.problem == BED_ROOT else FULL)
        or result.order > HIGH_ORDER
    )
    tolerance = next(allowed for highest, allowed in TOLERANCES.items() if result.order <= highest)
    if result.order in (3, 5, 7, 9) and result.fit is not None and result.fit.value > result.order:
        # On a motion symmetric in time the leading error of an odd order may cancel.
        return clear and result.fit.value < result.order + 1 + tolerance
    return clear and result.shows_declared_order(tolerance)


def convergence_verdict_and_passed(results: Sequence[ConvergenceResult]) -> tuple[str, bool]:
    """Return a sentence on how many slopes agree with the declared order, and True if all do."""
    right = sum(map(convergence_holds, results))
    return f"{right} of {len(results)} slopes agree with the declared order", right == len(results)
