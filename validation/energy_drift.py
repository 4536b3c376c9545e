"""Energy of long runs: a statistical test for drift, phase portraits, and controls whose energy drifts.

The energy error is divided by the energy turned over (the maximum kinetic energy). If the energy
ledger (the engine's balance of energy) stops a run, the run is tested up to that time. The test for a trend
is statistical; it does not bound the drift.

The energy error of a symplectic method oscillates with the motion indefinitely, and rounding makes it wander
like a random walk (Hairer, McLachlan and Razakarivony 2008, doi:10.1007/s10543-008-0170-3). Neither is a
trend. The series is cut into blocks and each block is averaged, which removes the oscillation. The block
borders are spaced unevenly (by the golden ratio), so that an oscillation commensurate with the blocks is not
aliased into a slow change. A trend is claimed only if it is significant against both kinds of noise:

- Stationary noise: a straight line is fitted to the block means by least squares. The variance of its slope
  is multiplied by (1 + a)/(1 - a), where a is the autocorrelation of the residuals. The estimate of a is
  corrected for its bias, (2 + 4 a)/n (Kendall 1954, doi:10.1093/biomet/41.3-4.403).
- A random walk: Student's t compares the mean step from block to block with the scatter of these steps. The
  variance of the mean is multiplied by 3/2, since averaging correlates neighbouring steps by 1/4
  (Working 1960, doi:10.2307/1907574).

The p-value is the larger of the two p-values, as in an intersection-union test (Berger 1982,
doi:10.1080/00401706.1982.10487790), so it is valid under either kind of noise.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from granular.methods import METHODS, method_named
from granular.run.trajectory import Trajectory
from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.blocks import Block, Caution, Picture, Table, Text
from granular.shared.errors import InputError, RunError
from granular.shared.plotting import COLOURS, GREY, figure, line_style
from validation import exact_solution
from validation.report_tasks import PlainData, Section, Task, make_one_axes_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# The line then has thirty degrees of freedom. More blocks hold fewer periods each, so the oscillation remains
# in their means; fewer blocks detect less of a trend (minimum 8).
BLOCKS = 32
# One run in a hundred is reported to have a trend although it has none.
SIGNIFICANCE = 0.01
# The variance grows by (1 + a)/(1 - a), here 39 times; at a = 1 no trend would ever be detected.
_GREATEST_CORRELATION = 0.95
# Its multiples, modulo 1, fill the interval most evenly, so no period is commensurate with the borders.
_GOLDEN = 0.6180339887498949
# Averaging leaves 2/3 of the variance of a random walk's steps (Working 1960).
_WORKING = 1.5


@dataclasses.dataclass(frozen=True)
class EnergyTrend:
    """Linear trend of a series, and its significance."""

    rate: float  # [unit/s]
    interval: tuple[float, float]  # [unit/s]
    p_stationary: float  # probability of such a slope without a trend, in stationary noise
    p_walk: float  # probability of such a slope without a trend, in a random walk
    swing: float  # standard deviation about the line [unit]
    duration: float  # [s]

    @property
    def p_value(self) -> float:
        """Larger p-value of the two tests: probability of such a slope without a trend."""
        return max(self.p_stationary, self.p_walk)

    @property
    def total_drift(self) -> float:
        """Change of the energy along the fitted line over the complete series, in the unit of the energy."""
        return self.rate * self.duration

    def verdict(self, significance: float = SIGNIFICANCE) -> str:
        """Return ``"gains"``, ``"loses"``, or ``"none"`` without a significant trend."""
        if self.p_value > significance:
            return "none"
        return "gains" if self.rate > 0.0 else "loses"


def energy_trend(time: np.ndarray, energy: np.ndarray, blocks: int = BLOCKS) -> EnergyTrend:
    """Test the energy of a run for a trend, against stationary noise and against a random walk.

    The energy is averaged in blocks, and two tests use the block means. The first fits a straight line; the
    variance of the slope is increased for autocorrelation (bias: Kendall 1954,
    doi:10.1093/biomet/41.3-4.403). The second is Student's t test of the steps between successive means;
    the variance is increased because averaging correlates the steps (Working 1960, doi:10.2307/1907574).
    The p-value is the larger of the two p-values (intersection-union test; Berger 1982,
    doi:10.1080/00401706.1982.10487790).

    Parameters
    ----------
    time : float (n,)
        Equidistant, increasing times [s]; only the first and the last are used.
    energy : float (n,)
        Energy, or its error, in any unit. A block should contain at least one period of its oscillation.
    blocks : int
        Number of block means in the test, 8 or more.

    Returns
    -------
    EnergyTrend
        Slope over the run with its 99 % interval [unit/s], p-values, and standard deviation about the line.

    Raises
    ------
    InputError
        If there are fewer than 4 samples per block or fewer than 8 blocks, if times and energies differ in
        number, if an energy is not finite, or if times do not increase.
    """
    energy = np.asarray(energy, dtype=float)
    if energy.ndim != 1 or blocks < 8 or len(energy) < 4 * blocks or len(time) != len(energy):
        raise InputError(
            f"{energy.size} samples at {len(time)} times in {blocks} blocks; 8 or more blocks with 4 or "
            f"more samples each are needed; record more often, or run longer"
        )
    if not np.isfinite(energy).all():
        raise InputError(
            "the energy has a value that is not finite, as after a failed run; give a finished run"
        )
    edges = _unevenly_spaced_block_edges(len(energy), blocks)
    means = np.add.reduceat(energy, edges[:-1]) / np.diff(edges)
    duration = float(time[-1] - time[0])
    if not 0.0 < duration < np.inf:
        raise InputError(f"times from {time[0]:g} s to {time[-1]:g} s; give increasing times")
    positions = 0.5 * (edges[1:] + edges[:-1] - 1) * duration / (len(energy) - 1)
    index = np.arange(len(energy))
    line = np.polynomial.Polynomial.fit(index, energy, 1)
    return _fit_energy_trend(positions, means, duration, float((energy - line(index)).std()))


def _unevenly_spaced_block_edges(length: int, blocks: int) -> np.ndarray:
    """Return block borders (blocks + 1,); the inner borders are shifted by up to a quarter block."""
    inner = np.arange(1, blocks)
    shift = 0.5 * (np.modf(inner * _GOLDEN)[0] - 0.5)
    edges = np.round((inner + shift) * length / blocks).astype(int)
    return np.concatenate([[0], edges, [length]])


def _fit_energy_trend(positions: np.ndarray, means: np.ndarray, duration: float, swing: float) -> EnergyTrend:
    from scipy import stats

    count = len(means)
    away = positions - positions.mean()
    slope = float(away @ means / (away @ away))
    rest = means - means.mean() - slope * away
    error = float(
        np.sqrt(rest @ rest / (count - 2) / (away @ away) * _variance_inflation_by_autocorrelation(rest))
    )
    rates = np.diff(means) * (count - 1) / (positions[-1] - positions[0])
    walk = float(rates.mean())
    walk_error = float(rates.std(ddof=1) * np.sqrt(_WORKING / (count - 1)))
    margin = float(stats.t.ppf(0.995, count - 2)) * max(error, walk_error)
    return EnergyTrend(
        rate=slope,
        interval=(slope - margin, slope + margin),
        p_stationary=_two_sided_p_value(slope, error, count - 2),
        p_walk=_two_sided_p_value(walk, walk_error, count - 2),
        swing=swing,
        duration=duration,
    )


def _variance_inflation_by_autocorrelation(rest: np.ndarray) -> float:
    """Return the factor by which autocorrelation of the residuals increases the slope's variance."""
    power = float(rest @ rest)
    if power == 0.0:
        return 1.0
    correlation = float(rest[1:] @ rest[:-1]) / power
    correlation += (2.0 + 4.0 * max(correlation, 0.0)) / len(rest)
    correlation = min(max(correlation, 0.0), _GREATEST_CORRELATION)
    return (1.0 + correlation) / (1.0 - correlation)


def _two_sided_p_value(value: float, error: float, freedom: int) -> float:
    from scipy import stats

    if error == 0.0:
        return 1.0 if value == 0.0 else 0.0
    return float(2.0 * stats.t.sf(abs(value) / error, freedom))


SHOWN = 800
"""Number of points to which a plotted line is reduced."""

# There are 64 samples per block. Runs last 40 to 64 periods, so each period then has 32 samples or more.
SAMPLES = 64 * BLOCKS
_ENERGIES = ("kinetic_energy", "pair_energy", "wall_energy", "weight_energy")


class EnergyRun(NamedTuple):
    """A run whose energy is tested for drift."""

    system: str
    scene: Scene
    method: str
    dt: float | str  # time step [s], or a multiple of the automatic step
    time: float  # [s]


@dataclasses.dataclass(frozen=True)
class EnergyStudy(PlainData):
    """Energy error of a run as a function of time, and the trend of this error.

    Attributes
    ----------
    system, method : str
        Names of the system and of the method.
    keeps : bool
        True if the method is symplectic, or reversible with variable steps: it should show no trend.
    dt : float or str
        Time step [s], or a multiple of the automatic step.
    steps : int
    stopped : str or None
        Error that stopped the run.
    times, errors : tuple of float
        Times [s] of the samples, and their energy errors divided by the energy turned over.
    trend : EnergyTrend
        Trend of all samples.
    heights, velocities : tuple of float
        Phase portrait of the first grain from the frames: height [D], velocity [m/s]; empty for a bed.
    """

    system: str
    method: str
    keeps: bool
    dt: float | str
    steps: int
    stopped: str | None
    times: tuple[float, ...]
    errors: tuple[float, ...]
    trend: EnergyTrend
    heights: tuple[float, ...] = ()
    velocities: tuple[float, ...] = ()


def energy_runs_of_report(*, full: bool = False) -> tuple[EnergyRun, ...]:
    """Return the energy runs of the report."""
    swings = tuple(
        wall_oscillation_run(name, 64 if full else 40)
        for name in METHODS.built_in
        if not METHODS[name].variable
    )
    if not full:
        return swings
    grain, bed = exact_solution.bounce_problem().scene, load_scene("bed").replace(**{"effects.drag": None})
    bounces = [_make_energy_run_with_whole_steps("bouncing grain", grain, *settings) for settings in _BOUNCES]
    beds = [_make_energy_run_with_whole_steps("bed without friction", bed, *settings) for settings in _BEDS]
    return (*swings, *bounces, variable_step_bounce_run(), *beds)


# The controls run at steps at which their trend is significant but still passes the energy ledger.
_STEPS = {"explicit-euler": 1e-6, "symplectic-euler": 5e-6, "runge-kutta-4": 6e-3}
# 1e8 steps of de Paula's bouncing grain by Verlet's method, and the controls.
_BOUNCES = (
    ("stormer-verlet", 1e-6, 100.0),
    ("stormer-verlet+compensated", 1e-6, 100.0),
    ("explicit-euler", 1e-6, 20.0),
    ("runge-kutta-4", 1e-3, 100.0),
)
_BEDS = (("stormer-verlet", 2e-5, 20.0), ("explicit-euler", 5e-7, 0.1), ("runge-kutta-4", 2e-4, 20.0))
"""Method, step [s] and duration [s] of each run; controls have steps long enough to show their trend."""


def wall_oscillation_run(method: str, periods: int) -> EnergyRun:
    """Make the run of a grain that oscillates above the wall by half its equilibrium height."""
    start, dt = exact_solution.oscillation_problem(0.5), _STEPS.get(method, 2e-3)
    time = periods * exact_solution.harmonic_period(start.scene, 0.5)
    return _make_energy_run_with_whole_steps("oscillation above the wall", start.scene, method, dt, time)


def variable_step_bounce_run() -> EnergyRun:
    """Make the run of 1e4 bounces with variable steps, about 160 for each bounce."""
    scene = exact_solution.bounce_problem().scene
    time = 1e4 * float(exact_solution.bounce_period(scene))
    records = {"output.scalars": time / SAMPLES, "output.frames": time / SAMPLES}
    return EnergyRun("bouncing grain", scene.replace(**records), "adaptive-verlet", "auto*4", time)


def _make_energy_run_with_whole_steps(
    system: str, scene: Scene, method: str, dt: float, time: float
) -> EnergyRun:
    """Make a run with a whole number of steps between records; a lone grain has a frame at every record."""
    record = max(1, round(time / SAMPLES / dt)) * dt
    every = 1 if scene.grains.count == 1 else SAMPLES
    scene = scene.replace(**{"output.scalars": record, "output.frames": every * record})
    return EnergyRun(system, scene, method, dt, time)


def run_energy_study(run: EnergyRun) -> EnergyStudy:
    """Simulate a run and test its energy for drift."""
    from granular.run.simulation import simulate

    stopped = None
    with warnings.catch_warnings(action="ignore"):  # the ledger warns of the drift that is measured here
        try:
            done = simulate(run.scene, dt=run.dt, t_end=run.time, method=run.method, progress=False)
        except RunError as error:
            stopped = f"{type(error).__name__}: {error}"
            done = cast("Trajectory", error.trajectory)
    return _make_energy_study(run, done, stopped)


def _make_energy_study(run: EnergyRun, done: Trajectory, stopped: str | None) -> EnergyStudy:
    data = done.dataset
    time = data["time"].values
    energy = np.sum([data[name].values for name in _ENERGIES if name in data], axis=0)
    energy = (energy - energy[0]) / data["kinetic_energy"].values.max()
    # The last records may be closer together than the others.
    # Records of runs with variable steps are up to one step late.
    method = method_named(run.method)
    even = np.isclose(np.diff(time), time[1] - time[0], rtol=0.02 if method.variable else 1e-6)
    count = len(time) if even.all() else int(np.argmin(even)) + 1
    every = max(1, count // SHOWN)
    portrait: dict[str, tuple[float, ...]] = {}
    if run.scene.grains.count == 1:
        heights = data["position"].values[:, 0, 1] / Scales.from_grains(run.scene.grains).length
        portrait = {
            "heights": tuple(heights.tolist()),
            "velocities": tuple(data["velocity"].values[:, 0, 1].tolist()),
        }
    return EnergyStudy(
        run.system,
        run.method,
        method.symplectic or method.variable,
        run.dt,
        int(done.settings()["steps"]),
        stopped,
        tuple(time[:count:every].tolist()),
        tuple(energy[:count:every].tolist()),
        energy_trend(time[:count], energy[:count]),
        **portrait,
    )


def _method_kind_text(name: str) -> str:
    method = method_named(name)
    if method.symplectic:
        return "symplectic"
    return "reversible" if method.variable else "control"


def energy_study_table(studies: Sequence[EnergyStudy]) -> Table:
    """Return a table with one row per study."""
    rows = [
        (
            study.system,
            study.method,
            _method_kind_text(study.method),
            study.dt if isinstance(study.dt, str) else f"{study.dt:.3g}",
            study.steps,
            f"{study.trend.swing:.1e}",
            f"{study.trend.total_drift:+.1e}",
            f"{study.trend.p_value:.2g}",
            study.trend.verdict(),
            "" if study.stopped is None else study.stopped.split(":", 1)[0],
        )
        for study in studies
    ]
    run = ("system", "method", "kind", "step [s]", "steps")
    return Table((*run, "amplitude", "drift over the run", "p", "trend", "stopped by"), rows)


# In the report ----------------------------------------------------------------------------------

BINS = 40
"""Number of equal parts of a run; plots show the maximum error in each part."""

CONTROLS = {"explicit-euler": "gains", "runge-kutta-4": "loses"}
"""Expected trend of each control."""


def trend_is_as_expected(study: EnergyStudy) -> bool:
    """Return True if a run has no trend, or if a control has its expected trend."""
    # No trend is expected or excluded for a user-defined method that is not symplectic.
    if not study.keeps and study.method not in CONTROLS:
        return True
    return study.trend.verdict() == ("none" if study.keeps else CONTROLS[study.method])


def energy_blocks(studies: Sequence[EnergyStudy]) -> list[Block]:
    """Make cautions for unexpected trends, plots of the energy error, phase portraits and the table."""
    intro = (
        "Energy error, relative to the energy turned over. A trend is claimed if it is significant "
        f"against stationary noise and against a random walk, at p below {SIGNIFICANCE:g}. "
        "Symplectic methods, and reversible variable steps, should show none; the controls gain "
        "(explicit Euler) or lose (Runge-Kutta)."
    )
    wrong = [
        Caution(
            f"{study.method} on the {study.system} {study.trend.verdict()} energy by "
            f"{study.trend.total_drift:.1e} (p = {study.trend.p_value:.1g}), which is not expected."
        )
        for study in studies
        if not trend_is_as_expected(study)
    ]
    systems = dict.fromkeys(study.system for study in studies)
    pictures = [
        shown
        for system in systems
        for shown in _energy_pictures(system, [study for study in studies if study.system == system])
    ]
    return [Text(intro), *wrong, *pictures, energy_study_table(studies)]


def _energy_pictures(system: str, group: Sequence[EnergyStudy]) -> Iterator[Picture]:
    for kind, keeps in (("symplectic or reversible", True), ("controls", False)):
        runs = [run for run in group if run.keeps is keeps]
        if runs:
            caption = (
                f"{system}, {kind}: maximum energy error in each {BINS}th of the run (of "
                f"{_run_durations_text(runs)}), relative to the energy turned over."
            )
            yield make_one_axes_picture(partial(_draw_energy_errors, runs), caption, height=4.2)
    portraits = [run for run in group if run.heights]
    if portraits:
        chosen = [run for run in portraits if run.method in PORTRAYED] or portraits[:1]
        caption = f"{system}: phase portraits, with a zoom at the upper turning point."
        yield Picture(partial(_draw_phase_portraits, chosen), caption)


def _draw_energy_errors(runs: Sequence[EnergyStudy], axes: Axes) -> None:
    for k, run in enumerate(runs):
        axes.semilogy(
            *_middles_and_maximum_errors_of_parts(run),
            **line_style(k),
            label=f"{run.method}, {run.steps:.2g} steps",
        )
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.1 * high), 2.0 * high)  # a curve that hardly changes must look flat
    axes.set(ylabel="maximum energy error", xlabel="fraction of the run")


def _run_durations_text(runs: Sequence[EnergyStudy]) -> str:
    lengths = sorted({f"{run.times[-1]:.3g}" for run in runs}, key=float)
    return f"{lengths[0]} s" if len(lengths) == 1 else f"{lengths[0]} to {lengths[-1]} s"


def _middles_and_maximum_errors_of_parts(study: EnergyStudy) -> tuple[np.ndarray, np.ndarray]:
    """Return the middle of each part, as a fraction of the run, and the maximum error in each part."""
    bins = min(BINS, len(study.errors))
    greatest = np.array([part.max() for part in np.array_split(np.abs(study.errors), bins)])
    middles = np.array([part.mean() for part in np.array_split(np.array(study.times), bins)])
    return middles / study.times[-1], np.where(greatest > 0.0, greatest, np.nan)


def _draw_phase_portraits(runs: Sequence[EnergyStudy]) -> Figure:
    options: Any = {"height": 5.0, "width": 2.6 * len(runs) + 0.8, "squeeze": False}
    with figure(2, len(runs), **options) as (drawing, panels):
        for column, run in zip(panels.T, runs, strict=True):
            for axes in column:
                axes.plot(run.heights, run.velocities, ".", color=COLOURS[0], markersize=1.2)
            column[0].set_title(run.method, fontsize=9)
            _set_turning_point_limits(column[1], run)
            column[1].set_xlabel("height [D]")
        panels[0, 0].set_ylabel("velocity [m/s]")
        panels[1, 0].set_ylabel("velocity [m/s], zoom")
    return drawing


PORTRAYED = ("stormer-verlet", "stormer-verlet+compensated", "explicit-euler", "runge-kutta-4")


def _set_turning_point_limits(axes: Axes, study: EnergyStudy) -> None:
    """Set the axes' limits around the upper turning point, wide enough for a drift of 1 %."""
    top, fastest = study.heights[0], max(map(abs, study.velocities))
    axes.set_xlim(0.98 * top, 1.02 * top)
    axes.set_ylim(-0.25 * fastest, 0.25 * fastest)
    axes.axvline(top, color=GREY, linewidth=0.8)


def _energy_verdict_and_passed(studies: Sequence[EnergyStudy]) -> tuple[str, bool]:
    right = sum(map(trend_is_as_expected, studies))
    words = f"{right} of {len(studies)} energy runs are as expected (no trend, or the trend of a control)"
    return words, right == len(studies)


def energy_task(run: EnergyRun, **more: Any) -> Task:
    """Make the task that tests the energy of one long run."""
    key = {**run._asdict(), "scene": run.scene.digest(), **more}
    return Task(f"{run.method}: {run.system}", key, partial(run_energy_study, run))


ENERGY = Section(
    "energy",
    "Energy over long runs",
    lambda full: [energy_task(run) for run in energy_runs_of_report(full=full)],
    EnergyStudy,
    _energy_verdict_and_passed,
    energy_blocks,
)
