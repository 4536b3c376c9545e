"""Order of convergence: the error against the exact solution over the time step.

The slope is fitted, in logarithms, over the finest decade of steps whose error is well above
rounding. Rounding is not guessed but measured at the finest step: the problem is run again from
starts that differ by a unit or two in the last place, which shows what the run makes of rounding at
random; and with one step more and less, where the second difference of the ends shows rounding that
is the same in every step (truncation is smooth, its second difference less by the number of steps
squared). Coarser runs take fewer steps and round less.

Where a motion is not smooth, as where friction stops a grain, the error depends on where in its
step that happens; what counts then is the worst of 21 neighbouring numbers of steps.
"""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.shared.errors import InputError, RunError
from validation.exact.problem import Moment, Problem
from validation.table import TextTable, table

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

    from granular.run.trajectory import Trajectory

CLEAR = 7.0
"""An error this many times the rounding moves the slope of a decade by 0.04 at most, and only where
the finest steps reach so far down: with methods of order four and more."""

COARSE = {1: 1e-2}
COARSE_OTHERWISE = 1e-3
"""Steps count from the first one whose error is below this part of a grain's diameter; a method of
order one gets no nearer at a bearable price."""

DECADE = 10.0
LEAST_SPAN = 3.0
"""Least ratio of the steps in a fit; where rounding leaves no whole decade, the table says so."""

HIGH_ORDER, LONGER = 6, 4.0
"""Methods of this order and more have many stages a step, and start from steps this much longer:
a decade of steps takes their error through six decades or more, which must lie above rounding."""

LATER = 4.0
"""Methods of order one begin at steps this much shorter still: their second-order error, which
falls only one power faster, would bend the line."""

MOST_STEPS = 2**26
NUDGES = (1, -1, 2)
NEIGHBOURS = 21
_LEAST_POINTS = 4
_SLACK = 0.98  # numbers of steps are whole, so a decade may be a little less

Solver = Callable[[Problem, int], Moment]
"""The grains at a problem's time, after that many equal steps."""


class Slope(NamedTuple):
    """A fitted slope.

    Attributes
    ----------
    value : float
    interval : tuple of float
        95 % interval of the straight line's fit. The errors are not random; the interval says how
        straight the line is.
    first, last : int
        Indices of the coarsest and the finest step of the fit.
    """

    value: float
    interval: tuple[float, float]
    first: int
    last: int


@dataclasses.dataclass(frozen=True)
class ConvergenceResult:
    """Errors of one method on one exact problem.

    Attributes
    ----------
    problem, method : str
    order : int
        The order that the method declares.
    smooth : bool
        Whether the problem lets a method show its order.
    steps : tuple of float
        Time steps, from coarse to fine [s].
    errors : tuple of float
        Greatest error of a coordinate at the problem's time [m].
    rounding : float
        What rounding does at the finest step [m].
    fit : Slope or None
        None where too few errors stand clear of rounding, or no step was short enough.
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
    fit: Slope | None
    seconds: tuple[float, ...]

    @property
    def slopes(self) -> tuple[float, ...]:
        """Slope from each step to the next finer one; NaN where an error is zero."""
        return tuple(
            math.log(e0 / e1) / math.log(h0 / h1) if e0 > 0.0 < e1 else math.nan
            for h0, h1, e0, e1 in zip(
                self.steps, self.steps[1:], self.errors, self.errors[1:], strict=False
            )
        )

    @property
    def exact(self) -> bool:
        """Whether no error stands clear of rounding."""
        return max(self.errors) <= CLEAR * self.rounding

    def holds(self, tolerance: float) -> bool:
        """Whether the slope is the declared order within a tolerance, or the method is exact."""
        if self.exact:
            return True
        return self.fit is not None and abs(self.fit.value - self.order) <= tolerance

    @property
    def decades(self) -> float:
        """Over how many decades of steps the slope was fitted."""
        if self.fit is None:
            return 0.0
        return math.log10(self.steps[self.fit.first] / self.steps[self.fit.last])

    def summary(self) -> tuple[str, ...]:
        """The row of this result in a table of results; see `HEADER`."""
        measured = "exact to rounding" if self.exact else "too few steps above rounding"
        interval = span = ""
        if self.fit is not None:
            measured = f"{self.fit.value:.4f}"
            interval = f"{self.fit.interval[0]:.3f} to {self.fit.interval[1]:.3f}"
            first, last = self.steps[self.fit.first], self.steps[self.fit.last]
            span = f"{first:.3g} to {last:.3g} ({self.decades:.2f} decades)"
        declared = str(self.order) if self.smooth else f"{self.order}, motion not smooth"
        return (
            self.problem, self.method, declared, measured, interval, span,
            f"{min(self.errors):.2g}", f"{self.rounding:.1g}",
        )  # fmt: skip

    def table(self) -> TextTable:
        """Step, error, local slope and wall time of each run."""
        rows = zip(self.steps, self.errors, ("", *self.slopes), self.seconds, strict=True)
        return table(
            ("step [s]", "error [m]", "slope", "seconds"),
            [
                (f"{h:.4g}", f"{e:.4g}", s if isinstance(s, str) else f"{s:.3f}", f"{t:.3g}")
                for h, e, s, t in rows
            ],
        )

    def to_dataframe(self) -> pandas.DataFrame:
        """A run a row: step [s], error [m], slope to it from the step before, wall time [s]."""
        import pandas

        slopes = (math.nan, *self.slopes)
        columns = {"step": self.steps, "error": self.errors, "slope": slopes}
        return pandas.DataFrame({**columns, "seconds": self.seconds})

    def plot(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Draw error over step, and the fitted line, into logarithmic axes."""
        from granular.shared.plotting import axes_or_new

        axes = axes_or_new(ax)
        errors = np.array(self.errors)
        shown = np.where(errors > 0.0, errors, np.nan)
        label = self.method if self.fit is None else f"{self.method}, slope {self.fit.value:.3f}"
        axes.loglog(self.steps, shown, marker="o", markersize=3.5, label=label, **style)
        if self.fit is not None:
            chosen = slice(self.fit.first, self.fit.last + 1)
            axes.loglog(
                self.steps[chosen], shown[chosen], linewidth=3.0, alpha=0.35,
                color=axes.lines[-1].get_color(),
            )  # fmt: skip
        axes.set_xlabel("time step [s]")
        axes.set_ylabel("error [m]")
        for line in (axes.xaxis, axes.yaxis):
            line.set_minor_formatter("")  # labels between powers of ten would overlap
        return axes

    def to_plain(self) -> dict[str, Any]:
        """The result as plain data."""
        plain = dataclasses.asdict(self)
        plain["fit"] = None if self.fit is None else self.fit._asdict()
        return plain

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> ConvergenceResult:
        """The result from what `to_plain` made, also by way of JSON."""
        fit = plain["fit"]
        return cls(
            **{
                **plain,
                "steps": tuple(plain["steps"]),
                "errors": tuple(plain["errors"]),
                "seconds": tuple(plain["seconds"]),
                "fit": fit and Slope(**{**fit, "interval": tuple(fit["interval"])}),
            }
        )


HEADER = (
    "problem", "method", "order", "slope", "95 % interval", "steps of the fit [s]",
    "least error [m]", "rounding [m]",
)  # fmt: skip


def convergence_table(results: Sequence[ConvergenceResult]) -> TextTable:
    """One row a result."""
    return TextTable(HEADER, tuple(one.summary() for one in results))


summary = convergence_table  # its former name


def toolkit(method: str) -> Solver:
    """The toolkit's own integration by the method of that name.

    A method that chooses its steps itself is asked for the multiple of its automatic step that
    makes about as many.
    """
    from granular.methods import method_named
    from granular.run.simulation import simulate

    variable = method_named(method).variable
    automatic: dict[str, int] = {}

    def step(problem: Problem, count: int) -> float | str:
        if not variable:
            return problem.time / count
        if problem.name not in automatic:
            automatic[problem.name] = int(run(problem, "auto").settings()["steps"])
        return f"auto*{automatic[problem.name] / count:.15f}"

    def run(problem: Problem, dt: float | str) -> Trajectory:
        scene = problem.scene
        if not isinstance(dt, str) and dt > scene.output.scalars:
            scene = scene.replace(**{"output.scalars": dt, "output.frames": dt})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the error is measured here, and shown
            return simulate(
                scene, dt=dt, t_end=problem.time, method=method, threads=1, progress=False
            )

    def solve(problem: Problem, count: int) -> Moment:
        done = run(problem, step(problem, count))
        data, steps = done.dataset, int(done.settings()["steps"])
        return Moment(
            data["position"].values[-1], data["velocity"].values[-1], steps if variable else None
        )

    return solve


def step_counts(problem: Problem, solver: Solver, order: int, points: int = 10) -> tuple[int, ...]:
    """Numbers of steps, a factor sqrt(2) apart, from the first that is not too coarse.

    That is the first one, from `Problem.fewest` on (fewer for high orders, see `LONGER`), at which
    the solver neither fails nor misses by more than `COARSE` diameters.
    """
    exact = problem.exact(problem.time).positions
    coarse = COARSE.get(order, COARSE_OTHERWISE) * problem.scene.grains.species[0].diameter
    start = problem.fewest / (LONGER if order >= HIGH_ORDER else 1.0)
    while start < MOST_STEPS / 16 and not _is_fine(problem, solver, round(start), exact, coarse):
        start *= math.sqrt(2.0)
    start *= LATER if order == 1 else 1.0
    return tuple(round(start * math.sqrt(2.0) ** k) for k in range(points))


def _is_fine(
    problem: Problem, solver: Solver, count: int, exact: np.ndarray, coarse: float
) -> bool:
    try:
        return bool(np.abs(solver(problem, count).positions - exact).max() < coarse)
    except (RunError, InputError):
        return False  # too long a step may be refused, or stopped


def fits(problem: Problem, method: str) -> bool:
    """Whether the method suits the problem.

    Some methods take no dry friction, and variable steps follow distances, so there must be some.
    """
    from granular.methods import method_named
    from granular.run.allowed import is_allowed

    effects = problem.scene.effects
    distances = effects.dipole is not None or effects.walls is not None
    variable = method_named(method).variable
    return is_allowed(problem.scene, "auto", method) and (distances or not variable)


def convergence(
    problem: Problem,
    method: str,
    counts: Sequence[int] | None = None,
    *,
    solver: Solver | None = None,
    order: int | None = None,
) -> ConvergenceResult:
    """Measure a method's order of convergence on an exact problem.

    Parameters
    ----------
    problem : Problem
    method : str
        One of `granular.methods.METHODS`, or any name where a solver is given.
    counts : sequence of int, optional
        Numbers of equal steps up to the problem's time, increasing; `step_counts` without.
    solver : callable, optional
        Another integration than the toolkit's: a control.
    order : int, optional
        The order that the solver declares; the method's own without.

    Raises
    ------
    InputError
        If the method is unknown.
    RunError
        If a run fails; a step that is too coarse for the problem is the caller's choice.
    """
    from granular.methods import method_named

    order = method_named(method).order if order is None else order
    solve = toolkit(method) if solver is None else solver
    counts = step_counts(problem, solve, order) if counts is None else tuple(counts)
    exact = problem.exact(problem.time).positions
    solve(problem, counts[0])  # compiles, so that the wall times do not hold it
    steps, errors, seconds = [], [], []
    for count in counts:
        begun = time.perf_counter()
        found = [solve(problem, near) for near in _neighbours(problem, count)]
        seconds.append((time.perf_counter() - begun) / len(found))
        errors.append(max(float(np.abs(one.positions - exact).max()) for one in found))
        steps.append(problem.time / (found[0].steps or count))
    rounding = _rounding(problem, solve, counts[-1], found[0].positions)
    return ConvergenceResult(
        problem.name, method, order, problem.smooth, tuple(steps), tuple(errors), rounding,
        fitted_slope(steps, errors, rounding), tuple(seconds),
    )  # fmt: skip


def _neighbours(problem: Problem, count: int) -> range:
    return range(count, count + (1 if problem.smooth else NEIGHBOURS))


def _rounding(problem: Problem, solve: Solver, count: int, plain: np.ndarray) -> float:
    found = [solve(problem.nudged(bits), count).positions - plain for bits in NUDGES]
    if problem.smooth:
        less, more = (solve(problem, count + by).positions for by in (-1, 1))
        found.append((less - plain) + (more - plain))
    # The exact place itself can only be told to half a unit in its last place.
    return max(*(float(np.abs(one).max()) for one in found), float(np.spacing(np.abs(plain).max())))


def fitted_slope(steps: Sequence[float], errors: Sequence[float], rounding: float) -> Slope | None:
    """Slope over the finest decade of steps whose errors are `CLEAR` of rounding.

    Parameters
    ----------
    steps, errors : sequence of float
        Steps from coarse to fine.
    rounding : float

    Returns
    -------
    Slope or None
        None where fewer than four steps, or less than half a decade, stand clear.
    """
    clear = [k for k, error in enumerate(errors) if error > CLEAR * rounding]
    # Behind the first error that does not stand clear, one that does is a matter of luck.
    while clear and clear[-1] != len(clear) - 1:
        clear.pop()
    if len(clear) < _LEAST_POINTS or steps[0] < LEAST_SPAN * _SLACK * steps[clear[-1]]:
        return None
    last = clear[-1]
    first = max((k for k in clear if steps[k] >= DECADE * _SLACK * steps[last]), default=0)
    return _line(steps, errors, first, last)


def _line(steps: Sequence[float], errors: Sequence[float], first: int, last: int) -> Slope:
    from scipy import stats

    chosen = slice(first, last + 1)
    line = stats.linregress(np.log(steps[chosen]), np.log(errors[chosen]))
    margin = float(stats.t.ppf(0.975, last - first - 1)) * float(line.stderr)
    value = float(line.slope)
    return Slope(value, (value - margin, value + margin), first, last)
