"""De Paula's complete test of Verlet's method [D, 2.3.4], repeated to separate rounding from other errors.

One grain 5 mm in diameter falls from 40 D and bounces on the wall for 2 s, with seven steps from 1e-6 to 1e-8
s. De Paula integrates in the position form, y_{n+1} = 2 y_n - y_{n-1} + h^2 a(y_n), and measures the error at
the end relative to the finest step. The thesis gives 6.8e-9 m as the maximum difference of two peaks. Errors
relative to the finest step h_f fall like h^2 - h_f^2, so the logarithmic plot is not quite straight. In the
position form h^2 a is added to a number 1e10 times as large and loses most of its digits. The same sequence
in increments, d_n = d_{n-1} + h^2 a(y_n), y_{n+1} = y_n + d_n, both sums compensated (Kahan 1965,
doi:10.1145/363707.363723), has the truncation error without the rounding. The difference of the two forms is
rounding. The toolkit's compensated sums are run for comparison.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from granular.effects.wall_laws import ExperimentalWall
from granular.schema.natural_units import Scales
from granular.shared.blocks import Block, Picture, Table, Text
from granular.shared.plotting import COLOURS, GREY, axes_or_new, figure
from validation import exact_solution
from validation.report_tasks import (
    WIDTH,
    PlainData,
    Section,
    Task,
    label_horizontal_line,
    make_one_axes_picture,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STEPS = (1e-6, 5e-7, 2e-7, 1e-7, 5e-8, 2e-8, 1e-8)
PLAIN, COMPENSATED, TOOLKIT = "position form", "compensated increments", "toolkit, compensated"
PRINTED_PEAKS = 6.8e-9
"""Maximum difference [m] of two peaks as printed by de Paula."""

_force = ExperimentalWall.force

# Size of the array of peaks; with a period of 0.402 s there are four peaks in 2 s.
_PEAKS = 16
_SAMPLES = 200


@numba.njit
def _final_height_and_peak_count_by_position_form(
    start: float, weight: float, h: float, steps: int, peaks: np.ndarray, path: np.ndarray
) -> tuple[float, int]:
    """Integrate the position form from rest; return the final height and the number of peaks found."""
    square = h * h
    every = max(1, steps // path.size)
    before = start
    now = start + 0.5 * square * (_force(None, start) - weight)
    result = 0
    path[0] = start
    for step in range(1, steps):
        if step % every == 0 and step < every * path.size:
            path[step // every] = now
        later = 2.0 * now - before + square * (_force(None, now) - weight)
        if now >= before and now > later and result < peaks.size:
            peaks[result] = now
            result += 1
        before, now = now, later
    return now, result


@numba.njit
def _final_height_and_peak_count_by_compensated_form(
    start: float, weight: float, h: float, steps: int, peaks: np.ndarray, path: np.ndarray
) -> tuple[float, int]:
    """Integrate the same sequence in compensated increments; return final height and number of peaks."""
    square = h * h
    every = max(1, steps // path.size)
    gain = 0.5 * square * (_force(None, start) - weight)
    now, lost = start, 0.0
    gain_lost = 0.0
    result = 0
    rising = False
    for step in range(steps):
        if step % every == 0 and step < every * path.size:
            path[step // every] = now
        if step > 0:
            add = square * (_force(None, now) - weight) - gain_lost
            total = gain + add
            gain_lost = (total - gain) - add
            gain = total
        if rising and gain < 0.0 and result < peaks.size:
            # The compensation of a sum is part of its value.
            peaks[result] = now
            result += 1
        rising = gain > 0.0
        add = (gain - gain_lost) - lost
        total = now + add
        lost = (total - now) - add
        now = total
    return now, result


@dataclasses.dataclass(frozen=True)
class DepaulaRun:
    """Run of one form of the method with one step."""

    form: str
    step: float  # [s]
    end: float  # [m]
    error: float  # [m]
    seconds: float  # wall time [s]
    peaks: tuple[float, ...] = ()  # [m]
    path: tuple[float, ...] = ()  # [m]

    @property
    def peak_height_range(self) -> float | None:
        """Return the maximum difference [m] of two peaks, including the initial height."""
        return float(np.ptp((0.0, *self.peaks))) if self.peaks else None


@dataclasses.dataclass(frozen=True)
class DepaulaStepTest(PlainData):
    """Runs of all forms with all steps."""

    runs: tuple[DepaulaRun, ...]

    def runs_of_form(self, form: str) -> tuple[DepaulaRun, ...]:
        """Return the runs of one form of the method, from coarse to fine steps."""
        return tuple(run for run in self.runs if run.form == form)

    def error_slope(self, form: str, finest: float = 5e-8) -> float:
        """Return the logarithmic slope of the error against the exact height, for steps >= ``finest`` [s]."""
        runs = [run for run in self.runs_of_form(form) if run.step >= 0.999 * finest]
        return _fit_logarithmic_slope([run.step for run in runs], [run.error for run in runs])

    def slope_relative_to_finest(self, form: str) -> float:
        """Return the logarithmic slope of the error relative to the finest step, as in [D]."""
        *runs, last = self.runs_of_form(form)
        return _fit_logarithmic_slope([run.step for run in runs], [abs(run.end - last.end) for run in runs])

    def maximum_deviation_from_power_law(self, form: str) -> float:
        """Return the maximum relative deviation of the errors from their fitted power law."""
        *runs, last = self.runs_of_form(form)
        steps = np.log([run.step for run in runs])
        errors = np.log([abs(run.end - last.end) for run in runs])
        away = errors - np.polynomial.Polynomial.fit(steps, errors, 1)(steps)
        return float(np.expm1(np.abs(away).max()))

    def rounding_errors(self) -> dict[float, float]:
        """Return the rounding error [m] of the height after 2 s in the position form, by step [s]."""
        clean = {run.step: run.end for run in self.runs_of_form(COMPENSATED)}
        return {run.step: abs(run.end - clean[run.step]) for run in self.runs_of_form(PLAIN)}

    def maximum_form_difference(self) -> float:
        """Return the maximum height difference [m] between the compensated position and velocity forms."""
        # In exact arithmetic both give the same sequence: y_{n+1} - 2 y_n + y_{n-1} = h^2 a(y_n) follows
        # from two steps of the velocity form (Hairer, Lubich and Wanner 2003,
        # doi:10.1017/S0962492902000144, sec. 1).
        ends = {run.step: run.end for run in self.runs_of_form(COMPENSATED)}
        return max(abs(run.end - ends[run.step]) for run in self.runs_of_form(TOOLKIT))

    def table(self) -> Table:
        """Return one row per run: step [s], error, rounding and peak difference [m]."""
        rounding = self.rounding_errors()
        rows = [
            (
                run.form,
                f"{run.step:g}",
                f"{run.error:.2e}",
                f"{rounding[run.step]:.1e}" if run.form == PLAIN else "",
                "" if run.peak_height_range is None else f"{run.peak_height_range:.1e}",
                f"{run.seconds:.2g}",
            )
            for run in self.runs
        ]
        header = ("form", "step [s]", "error [m]", "rounding [m]", "peak difference [m]", "seconds")
        return Table(header, rows)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Plot errors [m] of each form, relative to the exact and the finest result, against the step [s]."""
        axes = axes_or_new(ax)
        for k, form in enumerate(dict.fromkeys(run.form for run in self.runs)):
            runs = self.runs_of_form(form)
            steps = [run.step for run in runs]
            look: Any = {"marker": "o", "markersize": 3.5, "linestyle": ":" if form == TOOLKIT else "-"}
            axes.loglog(steps, [run.error for run in runs], color=COLOURS[k], label=form, **look)
            if form != TOOLKIT:
                away = [abs(run.end - runs[-1].end) for run in runs[:-1]]
                look = {"marker": "o", "markersize": 7.0, "markerfacecolor": "none", "linestyle": "none"}
                label = f"{form}, relative to the finest"
                axes.loglog(steps[:-1], away, color=COLOURS[k], label=label, **look)
        axes.set(xlabel="time step [s]", ylabel="error after 2 s [m]")
        return axes

    def plot_path(self, ax: Axes | None = None) -> Axes:
        """Draw the height [mm] against time [s] at the finest step, with free fall for comparison."""
        axes = axes_or_new(ax)
        run = self.runs_of_form(COMPENSATED)[-1]
        time = np.arange(len(run.path)) * exact_solution.TIME / len(run.path)
        axes.plot(time, 1e3 * np.array(run.path), color=COLOURS[0], label=f"step {run.step:g} s")
        gravity = exact_solution.bounce_problem().scene.effects.gravity
        assert gravity is not None
        fallen = run.path[0] - 0.5 * gravity.acceleration * time**2
        above = fallen > 0.0
        look: Any = {"color": GREY, "linewidth": 2.5, "zorder": 0}
        axes.plot(time[above], 1e3 * fallen[above], "--", label="free fall", **look)
        axes.set(xlabel="time [s]", ylabel="height [mm]")
        return axes

    def plot_peaks(self, ax: Axes | None = None) -> Axes:
        """Draw the difference [m] of each peak from the initial height, at the finest step."""
        axes = axes_or_new(ax)
        for form, colour in ((PLAIN, COLOURS[0]), (COMPENSATED, COLOURS[1])):
            away = np.abs(self.runs_of_form(form)[-1].peaks)
            shown = np.where(away > 0.0, away, np.nan)
            axes.semilogy(1 + np.arange(len(away)), shown, "o", color=colour, label=form)
        axes.axhline(PRINTED_PEAKS, color="#333333", linewidth=0.8, linestyle=":")
        label_horizontal_line(axes, "printed by de Paula", PRINTED_PEAKS)
        axes.set(xlabel="bounce", ylabel="peak minus start [m]")
        axes.set_xticks(range(1, 1 + len(self.runs_of_form(PLAIN)[-1].peaks)))
        return axes


def _fit_logarithmic_slope(steps: list[float], errors: list[float]) -> float:
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def run_depaula_step_test(*, full: bool = True) -> DepaulaStepTest:
    """Run de Paula's test of Verlet's method: a bouncing grain with seven step sizes, in three forms."""
    steps = STEPS if full else STEPS[:4]
    problem = exact_solution.bounce_problem()
    exact = float(problem.exact(exact_solution.TIME).positions[0, 1])
    runs = [_run_depaula_form(form, step, exact) for form in (PLAIN, COMPENSATED) for step in steps]
    runs += [_run_toolkit_method(step, exact) for step in (steps if full else steps[:2])]
    return DepaulaStepTest(tuple(runs))


def _run_depaula_form(form: str, step: float, exact: float) -> DepaulaRun:
    scene = exact_solution.bounce_problem().scene
    scales = Scales.from_grains(scene.grains)
    assert scene.effects.gravity is not None
    weight = scene.effects.gravity.acceleration / scales.acceleration
    loop = (
        _final_height_and_peak_count_by_position_form
        if form == PLAIN
        else _final_height_and_peak_count_by_compensated_form
    )
    peaks, path = np.zeros(_PEAKS), np.zeros(_SAMPLES)
    h, count = step / scales.time, round(exact_solution.TIME / step)
    start = float(exact_solution.START)
    loop(start, weight, h, 2, peaks, path)  # compiles
    start_time = time.perf_counter()
    end, result = loop(start, weight, h, count, peaks, path)
    seconds = time.perf_counter() - start_time
    end *= scales.length
    return DepaulaRun(
        form,
        step,
        end,
        abs(end - exact),
        seconds,
        tuple(((peaks[:result] - start) * scales.length).tolist()),
        tuple((path * scales.length).tolist()),
    )


def _run_toolkit_method(step: float, exact: float) -> DepaulaRun:
    from granular.run.simulation import simulate

    start_time = time.perf_counter()
    run = simulate(
        exact_solution.bounce_problem().scene,
        dt=step,
        t_end=exact_solution.TIME,
        method="stormer-verlet+compensated",
        progress=False,
    )
    end = float(run.dataset["position"].values[-1, 0, 1])
    seconds = time.perf_counter() - start_time
    return DepaulaRun(TOOLKIT, step, end, abs(end - exact), seconds)


# In the report ----------------------------------------------------------------------------------


def depaula_step_test_blocks(experiments: Sequence[DepaulaStepTest]) -> list[Block]:
    """Make plots of the errors and of the peaks, with and without rounding, and a table of the runs."""
    return [block for experiment in experiments for block in _step_test_blocks(experiment)]


def _step_test_blocks(experiment: DepaulaStepTest) -> list[Block]:
    clean, plain = experiment.runs_of_form(COMPENSATED)[-1], experiment.runs_of_form(PLAIN)[-1]
    errors = (
        "A grain 5 mm in diameter, dropped from 40 D, bounces for 2 s [D, 2.3.4]. With compensated sums the "
        f"error against the exact height falls with the slope {experiment.error_slope(COMPENSATED):.4f}, "
        f"to {clean.error:.1e} m at a step of {clean.step:g} s. In the plain position form the error at this "
        f"step is {plain.error:.1e} m, all but {clean.error:.0e} m of it rounding; at steps below 1e-6 s "
        f"only rounding is visible. The maximum difference of two peaks is "
        f"{plain.peak_height_range:.1e} m in the plain form (de Paula prints {PRINTED_PEAKS:g} m) and "
        f"{clean.peak_height_range:.1e} m with compensated sums. The toolkit's velocity form is the same "
        f"sequence: with compensated sums its heights and the heights of the position form differ by "
        f"{experiment.maximum_form_difference():.1g} m at most."
    )
    scatter = (
        "In de Paula's plot the points scatter about the line, which the thesis attributes to errors "
        "measured relative to the finest step. With compensated sums, such errors have a slope of "
        f"{experiment.slope_relative_to_finest(COMPENSATED):.3f} and lie within "
        f"{experiment.maximum_deviation_from_power_law(COMPENSATED):.0%} of the line. "
        "In the plain position form, where rounding is added, the slope is "
        f"{experiment.slope_relative_to_finest(PLAIN):.2f} and the points deviate from the line by up to "
        f"{experiment.maximum_deviation_from_power_law(PLAIN):.0%}."
    )
    over_step = "Error of the height after 2 s: against the exact height (dots), and the finest step (rings)."
    peaks = "Height over time at the finest step, and difference of each peak from the initial height."
    return [
        Text(errors),
        Text(scatter),
        make_one_axes_picture(experiment.plot, over_step, height=5.2, columns=1),
        Picture(partial(_draw_path_and_peaks, experiment), peaks),
        experiment.table(),
    ]


def _draw_path_and_peaks(experiment: DepaulaStepTest) -> Figure:
    with figure(2, 1, width=WIDTH, height=5.6) as (drawing, (above, below)):
        experiment.plot_path(above)
        experiment.plot_peaks(below)
        above.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
        below.legend(fontsize=8, loc="center right")
    return drawing


def _error_slope_verdict_and_passed(experiments: Sequence[DepaulaStepTest]) -> tuple[str, bool]:
    slopes = [experiment.error_slope(COMPENSATED) for experiment in experiments]
    words = f"de Paula's test has the slope {', '.join(f'{slope:.4f}' for slope in slopes)}"
    return words, all(abs(slope - 2.0) <= 0.01 for slope in slopes)


def _depaula_tasks(full: bool) -> list[Task]:
    label = "seven steps" if full else "four steps"
    return [Task(label, {"full": full}, partial(run_depaula_step_test, full=full))]


DEPAULA = Section(
    "depaula",
    "De Paula's test of Verlet's method",
    _depaula_tasks,
    DepaulaStepTest,
    _error_slope_verdict_and_passed,
    depaula_step_test_blocks,
)
