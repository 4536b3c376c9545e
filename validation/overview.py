"""Overview: the first screen of the report.

It shows the cost of accuracy in a scene, the cost of its effects, and the endings of hard cases. To measure
the cost of an effect, the steps of a scene are timed twice: with the effect added to a scene without effects,
and with the effect removed from the full scene.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any, NamedTuple

import numba
import numpy as np

from granular.engine.step_size import StepSchedule
from granular.methods import METHODS
from granular.run.engines import NO_TICKS, TickRequest, advance_with_compiled_loop
from granular.run.plan import can_run, plan
from granular.run.protocol_runner import ProtocolRunner
from granular.run.summary import active_effect_names
from granular.run.work_precision import FLOORS
from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene
from granular.shared.blocks import Block, Heading, Table, Text
from granular.shared.errors import GranularError
from granular.shared.plotting import COLOURS, GREY, STYLES
from validation.accuracy_cost import (
    STEPS,
    ScenesWithReferences,
    choose_reference_setting,
    compile_code_of_setting,
    quarter_bed_compression_scene,
    run_repeatedly_and_time,
    run_scene_with_setting,
    scene_depends_on_seed,
    scenes_with_other_seeds,
    scenes_with_reference_values,
)
from validation.hard_case_outcomes import HardCaseOutcome, outcome_count_table, outcome_summary, run_hard_case
from validation.hard_cases import hard_case_catalogue
from validation.measured_quantities import QUANTITIES, MeasuredQuantity
from validation.report_tasks import PlainData, Section, Task, make_one_axes_picture, scene_key
from validation.work_precision_result import (
    LEVELS,
    USUAL,
    AdvisedSetting,
    SolverSettings,
    WorkPrecision,
    WorkPrecisionPoint,
    draw_work_precision_points,
    duration_text,
    label_run_time_axis,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


STEP = 0.02
"""Default time step [tau] of `EngineSteps`."""


class EngineSteps:
    """Engine that makes the time steps of a scene and records nothing."""

    def __init__(self, scene: Scene, threads: int = 1, step: float = STEP) -> None:
        self.threads, self.step = threads, step
        self.run = ProtocolRunner(plan(scene, threads=threads))
        self.run.begin_stage()
        self.watch = self.run.stop_criteria()._replace(stiff=math.inf, rest=-1.0)

    def make_steps(self, steps: int) -> None:
        """Make a number of steps, and check the final state."""
        numba.set_num_threads(self.threads)
        schedule = StepSchedule(steps * self.step, self.step, 1, 1, steps, 0)
        run, window = self.run, NO_TICKS._replace(ticks=1)
        ticks = TickRequest(window, schedule, run.tables, run.motion, run.measurement, self.watch)
        advance_with_compiled_loop(run.system, run.state, ticks)


STILL = 1e-5
"""Time step [tau] of timed steps, so short that grains stay in the cell even without walls."""

ROUNDS = 40
# Approximate duration of one timing [s]: a million times the clock's resolution, and short compared with
# disturbances of the machine.
BURST = 4e-3

_HELD: dict[str, Any] = {
    "protocol": [{"kind": "hold", "name": "hold", "duration": 60.0}],
    "output.record": None,
}
"""Protocol with a held piston, which needs no wall force."""

SUMS = ("direct", "cut-off", "mesh")

FULL, NOTHING = "all effects", "no effect"

AGREE = 0.2
"""Two costs of an effect count as equal if they differ by less than this fraction of the larger one."""


class EffectCost(NamedTuple):
    """Time that an effect adds to a bare scene, or its removal saves in a full one, with uncertainties."""

    effect: str
    first: float  # [us]
    first_doubt: float  # [us]
    last: float  # [us]
    last_doubt: float  # [us]

    def costs_agree(self) -> bool:
        """Return True if the two costs of the effect agree within a fifth."""
        return abs(self.first - self.last) <= AGREE * max(abs(self.first), abs(self.last))


@dataclasses.dataclass(frozen=True)
class EffectCosts(PlainData):
    """Time [us] of one step of a scene, split by effect, and time of a step with each pair sum."""

    scene: str
    grains: int
    step: float
    nothing: float
    effects: tuple[EffectCost, ...]
    sums: dict[str, float]

    def table(self) -> Table:
        """Return the cost [us] of each effect: time added to the bare scene, time saved in the full one."""
        rows = [
            (
                cost.effect,
                _cost_with_uncertainty_text(cost.first, cost.first_doubt),
                _cost_with_uncertainty_text(cost.last, cost.last_doubt),
                "yes" if cost.costs_agree() else "no",
            )
            for cost in self.effects
        ]
        columns = ("time added to the bare scene [us]", "time saved in the full scene [us]")
        return Table(("effect", *columns, "equal within a fifth"), rows)

    def blocks(self) -> list[Block]:
        """Make the table and its explanation for a page."""
        sums = ", ".join(f"{name} {value:.3g}" for name, value in self.sums.items())
        return [
            Heading(f"{self.scene}: cost of effects"),
            Text(
                f"A step of {self.grains} grains on one core takes {self.step:.3g} microseconds with all "
                f"effects and {self.nothing:.2g} without effects (medians of interleaved runs). Effects may "
                f"share work, so both costs are given if they differ by more than a fifth. An effect that a "
                f"scene does not contain adds nothing to its step; "
                '"python -m benchmarks --part absent" compares such a step with one written by hand.'
            ),
            self.table(),
            Text(f"Time of a whole step by pair sum: {sums} microseconds."),
        ]


def _cost_with_uncertainty_text(value: float, doubt: float) -> str:
    return "cannot be run" if math.isnan(value) else f"{value:.3g} ± {doubt:.1g}"


def effect_costs(scene: Scene, rounds: int = ROUNDS, workers: int = 2) -> EffectCosts:
    """Measure the time [us] of one step of a scene, split by effect, and the time with each pair sum."""
    # Steps are timed in turn, so that a slow minute of the machine affects all of them equally; the cost is
    # the median over the rounds of the difference of two steps timed in one round.
    names = active_effect_names(scene)
    held = scene.replace(**_HELD)
    builds = _scenes_to_time(held, names)
    if workers > 1:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            list(pool.map(_compile_engine, builds.values()))
    calls, steps = _calls_of_equal_duration_and_step_counts(builds)
    seconds = _measure_time_of_calls(calls, rounds)
    value = {name: 1e6 * values / steps[name] for name, values in seconds.items()}
    costs = [
        EffectCost(
            name,
            *_median_difference_and_half_width(value.get(f"{name} alone"), value[NOTHING]),
            *_median_difference_and_half_width(value[FULL], value.get(f"without {name}")),
        )
        for name in names
    ]
    step, nothing = (float(np.median(value[name])) for name in (FULL, NOTHING))
    sums = {name: float(np.median(value[name])) for name in SUMS if name in value}
    return EffectCosts(scene.name, scene.grains.count, step, nothing, tuple(costs), sums)


def _scenes_to_time(scene: Scene, names: tuple[str, ...]) -> dict[str, Scene]:
    """Return the variants of a scene whose steps are timed, except variants that cannot be run."""
    none = {f"effects.{name}": None for name in names}
    wanted: dict[str, dict[str, Any]] = {NOTHING: none, FULL: {}}
    for name in names:
        wanted[f"{name} alone"] = {key: None for key in none if key != f"effects.{name}"}
    wanted |= {f"without {name}": {f"effects.{name}": None} for name in names}
    wanted |= {name: {"pairs.method": name} for name in SUMS}
    result = {}
    for name, changes in wanted.items():
        with contextlib.suppress(GranularError):  # such as the mesh sum without four walls
            result[name] = scene.replace(**changes)
    return result


def _compile_engine(scene: Scene) -> None:
    EngineSteps(scene, step=STILL).make_steps(1)


def _calls_of_equal_duration_and_step_counts(
    builds: Mapping[str, Scene],
) -> tuple[dict[str, Callable[[], None]], dict[str, int]]:
    """Return functions that each take about `BURST`, and the number of steps that each function makes."""
    calls: dict[str, Callable[[], None]] = {}
    steps: dict[str, int] = {}
    for name, scene in builds.items():
        engine = EngineSteps(scene, step=STILL)
        engine.make_steps(16)
        started = time.thread_time()
        engine.make_steps(64)
        steps[name] = max(16, math.ceil(64 * BURST / (time.thread_time() - started)))
        calls[name] = partial(engine.make_steps, steps[name])
    return calls, steps


def _measure_time_of_calls(calls: Mapping[str, Callable[[], None]], rounds: int) -> dict[str, np.ndarray]:
    """Measure the processor time [s] of each call in each round, without the time of other programs."""
    result = {name: np.empty(rounds) for name in calls}
    for k in range(rounds):
        for name, call in calls.items():
            started = time.thread_time()
            call()
            result[name][k] = time.thread_time() - started
    return result


def _median_difference_and_half_width(
    more: np.ndarray | None, less: np.ndarray | None
) -> tuple[float, float]:
    """Return the median difference of paired times, and its 95 % half-width; NaN if a time is missing."""
    if more is None or less is None:
        return math.nan, math.nan
    off = more - less
    quarters = np.percentile(off, [25.0, 75.0])
    return float(np.median(off)), float(1.57 * (quarters[1] - quarters[0]) / math.sqrt(len(off)))


QUICK_SECONDS, FULL_SECONDS = 75.0, 1200.0
"""Time limits [s] for all runs of one scene in the quick and in the full report."""

MANY_STARTS, FEW_STARTS = 8, 3
"""Numbers of random initial states for scenes with short and with long runs."""

OTHERS = ("blanes-moan-4",)
"""Methods to compare with Verlet's method."""

FRACTION = 0.25
"""Each method in `OTHERS` gets this fraction of the time limit, which determines its finest step."""

SINGLE = 0.3
"""Duration of a run without a piston [s]: positions are meaningful only over a short time."""


COSTLY = (
    "slabs",
    "friction",
    "mass ratio",
    "aspect",
    "contact",
    "drop",
    "100 kg",
    "packing",
    "skin",
    "far field",
    "1e6 steps",
    "damping ratio",
    "three species",
    "list of pairs",
    "1e5 grains",
)
"""Phrases in the names of hard cases whose scenes take long to compile or to run."""


class ErrorAtFreshStart(NamedTuple):
    """Error of a recommended setting in a run from a random initial state that the study did not use."""

    scene: str
    quantity: str
    level: str
    setting: str
    error: float
    holds: bool

    def __str__(self) -> str:
        return f"{self.quantity} of {self.scene} to {self.level} by {self.setting}"


@dataclasses.dataclass(frozen=True)
class OverviewResult(PlainData):
    """Result of a task: the studies of a scene, the costs of its effects, or the quick hard cases."""

    studies: tuple[WorkPrecision, ...] = ()
    fresh: tuple[ErrorAtFreshStart, ...] = ()
    starts: int = 1
    effects: EffectCosts | None = None
    outcomes: tuple[HardCaseOutcome, ...] = ()


def overview_tasks(scenes: Sequence[Scene], full: bool, *, hard: bool) -> list[Task]:
    """Make the tasks that measure the cost of accuracy and the cost of effects in each scene."""
    seconds = FULL_SECONDS if full else QUICK_SECONDS
    tasks = []
    for scene in scenes:
        key = {**scene_key(scene), "name": scene.name}
        accuracy, effects = partial(_measure_accuracy, scene, seconds), partial(_measure_effect_costs, scene)
        tasks.append(Task(f"{scene.name}: accuracy", {**key, "seconds": seconds}, accuracy))
        tasks.append(Task(f"{scene.name}: effects", {**key, "what": "effects"}, effects))
    return [*tasks, Task("hard cases", {"what": "hard cases"}, _run_hard_cases)] if hard else tasks


def _measure_effect_costs(scene: Scene) -> OverviewResult:
    return OverviewResult(effects=effect_costs(scene))


def _run_hard_cases() -> OverviewResult:
    light = [case for case in hard_case_catalogue() if not any(word in case.name for word in COSTLY)]
    return OverviewResult(outcomes=tuple(map(run_hard_case, light)))


def quantities_suitable_for_scene(scene: Scene) -> tuple[str, ...]:
    """Return names of the quantities suitable for a scene, by its piston and its stages."""
    if scene.piston is None:
        return ("energy", "positions")
    rests = any(getattr(stage, "until", None) == "rest" for stage in scene.protocol)
    swings = scene.output.record is not None
    result = ("rest height",) if rests else ("piston force", "mean distance")
    return (*result, *(("period", "damping ratio") if swings else ()), "energy")


def _measure_accuracy(scene: Scene, seconds: float) -> OverviewResult:
    """Study a scene's quantities, and test the recommended settings from a new random initial state."""
    until = SINGLE if scene.piston is None else None
    chosen = [QUANTITIES[name] for name in quantities_suitable_for_scene(scene)]
    ladder, scenes, reference = choose_settings_starts_and_reference(scene, until, seconds)
    given = [None if quantity.exact is not None else reference for quantity in chosen]
    comparison = scenes_with_reference_values(scenes, chosen, given, until)
    studies = comparison.studies([comparison.measure_points(setting) for setting in ladder])
    fresh = _check_with_fresh_start(comparison, studies) if len(scenes) > 1 else ()
    return OverviewResult(studies, tuple(fresh), len(scenes))


def choose_settings_starts_and_reference(
    scene: Scene, until: float | None, seconds: float
) -> tuple[list[SolverSettings], tuple[Scene, ...], SolverSettings]:
    """Choose settings, initial states and a reference so that all runs together take at most ``seconds``."""
    steps = [dt for dt in STEPS if can_run(scene, dt, "stormer-verlet")]
    longest = SolverSettings("stormer-verlet", steps[0])
    compile_code_of_setting(scene, longest)
    _, took = run_repeatedly_and_time(scene, longest, until)
    random = scene_depends_on_seed(scene)
    many = random and MANY_STARTS * took * 2.0**6 <= seconds
    starts = (MANY_STARTS if many else FEW_STARTS) if random else 1
    # Each halving doubles the time of a run: n runs take 2^n - 1 times as long as the first. The reference
    # has one more halving, and takes about as long as all of them.
    entries = math.floor(math.log2(seconds / (starts * took) + 1.0)) - 1
    entries = min(max(entries, 2), len(steps) - 1)
    ladder = [SolverSettings("stormer-verlet", dt) for dt in steps[:entries]]
    for name in OTHERS:
        calls = METHODS[name].force_evaluations_per_step
        runs = seconds * FRACTION / (starts * took * calls)
        more = min(math.floor(math.log2(runs + 1.0)), len(steps)) if runs >= 1.0 else 0
        ladder += [SolverSettings(name, dt) for dt in steps[:more] if can_run(scene, dt, name)]
    reference = (
        SolverSettings("stormer-verlet", steps[entries]) if random else choose_reference_setting(scene)
    )
    return ladder, scenes_with_other_seeds(scene, starts - 1), reference


def _check_with_fresh_start(
    comparison: ScenesWithReferences, studies: Sequence[WorkPrecision]
) -> Iterator[ErrorAtFreshStart]:
    """Run from a new random initial state with each setting that is recommended for a single run."""
    # The value is compared with the exact value, or with the mean of the reference over the other initial
    # states.
    last = comparison.scenes[-1].arrangement.seed
    other = comparison.scenes[0].replace(**{"arrangement.seed": last + 1})
    runs: dict[str, Any] = {}
    for quantity, item, study in zip(comparison.quantities, comparison.truth, studies, strict=True):
        if quantity.differs_by_start and quantity.exact is None:
            continue
        mean = sum(item.values) / len(item.values)
        for words, level in LEVELS.items():
            best = study.cheapest_point(level)
            if best is None:
                continue
            label = f"{best.setting.family}, {best.setting.dt}"
            if label not in runs:
                runs[label] = run_scene_with_setting(other, best.setting, comparison.until)
            error = _error_of_quantity(quantity, runs[label], mean)
            yield ErrorAtFreshStart(other.name, quantity.name, words, label, error, error <= level)


def _error_of_quantity(quantity: MeasuredQuantity, item: Any, reference: Any) -> float:
    try:
        return quantity.error(quantity.measure(item), reference)
    except GranularError:
        return math.inf


def time_factor_per_digit_text(study: WorkPrecision, best: WorkPrecisionPoint | None) -> str:
    """Return, as text, the factor by which run time increases if the error is reduced to a tenth."""
    measured = study.time_factor_per_digit()
    if measured is not None:
        return f"{measured:.2g} times"
    order = METHODS[best.setting.method].order if best is not None else 2
    return f"{10.0 ** (1.0 / order):.2g} times, from the order"


# In the report ----------------------------------------------------------------------------------


def overview_blocks(results: Sequence[OverviewResult]) -> Iterator[Block]:
    """Show the cost of accuracy and the cost of effects for each scene, then the hard cases."""
    for result in results:
        if result.studies:
            yield from _accuracy_blocks(result)
        if result.effects is not None:
            yield from result.effects.blocks()
        if result.outcomes:
            yield Heading("Hard cases: overview")
            yield outcome_count_table(result.outcomes)


def _accuracy_blocks(result: OverviewResult) -> Iterator[Block]:
    first = result.studies[0]
    yield Heading(f"{first.scene}: cost of accuracy")
    if result.starts > 1:
        yield Text(
            f"Errors are means over {result.starts} starts, relative to a finer step from the same starts; "
            f"bars end at the upper bound over the starts. The dashed line is the scatter of the starts. "
            f"A single run cannot be recommended for an error below {FLOORS:g} times that scatter; the mean "
            f"of more starts can reach it, at a higher cost. The method is {USUAL[0]} if none is named."
        )
    draw = partial(plot_error_over_run_time, result.studies)
    yield make_one_axes_picture(
        draw, f"{first.scene_and_duration_label}: error against the time of a run.", height=4.2
    )
    yield advice_table(result.studies)


def plot_error_over_run_time(studies: Sequence[WorkPrecision], axes: Axes) -> None:
    """Draw errors against a run's wall time [s]: a colour for each quantity, a line for each method."""
    for k, study in enumerate(studies):
        colour = COLOURS[k % len(COLOURS)]
        for j, (name, family) in enumerate(study.points_by_family().items()):
            look = {"marker": "os^vD"[j % 5], "linestyle": STYLES[j % len(STYLES)], "linewidth": 1.2}
            words = study.quantity if j == 0 else f"{study.quantity}, {name}"
            draw_work_precision_points(axes, family, words, color=colour, **look)
        if study.floor > 0.0:
            axes.axhline(study.floor, color=colour, linestyle=(0, (6, 3)), linewidth=0.9)
    for level in LEVELS.values():
        axes.axhline(level, color=GREY, linewidth=0.6, linestyle=":")
    label_run_time_axis(axes)
    axes.set(xlabel="time of a run [s]", ylabel="error")


def advice_table(studies: Sequence[WorkPrecision]) -> Table:
    """Tabulate the recommended setting, with its run time, for each quantity and tolerance."""
    rows = []
    for study in studies:
        advised = [study.advise(level) for level in LEVELS.values()]
        scatter = f"{study.floor:.1g}" if study.floor else "none"
        rows.append(
            (
                study.quantity,
                *map(_setting_and_cost_text, advised),
                scatter,
                time_factor_per_digit_text(study, advised[0].point),
            )
        )
    return Table(("quantity", *LEVELS, "scatter of starts", "cost of a digit"), rows)


def _setting_and_cost_text(advice: AdvisedSetting) -> str:
    """Return the text of the setting recommended for a tolerance and of its run time."""
    if advice.point is None:
        return str(advice)
    method, price = advice.point.setting.method, duration_text(advice.seconds)
    if advice.needs_more_starts:
        number = f"{advice.starts:d}" if advice.starts < 1000 else f"{advice.starts:.0e}"
        return f"mean of {number} starts: {price}"
    named = "" if method == USUAL[0] else f"{method} "
    return f"{named}{advice.point.setting.fineness}: {price}"


def _overview_verdict_and_passed(results: Sequence[OverviewResult]) -> tuple[str, bool]:
    fresh = [start for result in results for start in result.fresh]
    hard = [outcome for result in results for outcome in result.outcomes]
    missed = [start for start in fresh if not start.holds]
    words = f"{len(fresh) - len(missed)} of {len(fresh)} recommended settings hold for a new start"
    if missed:
        words += f", not {'; '.join(map(str, missed))}"
    if hard:
        words += f"; {outcome_summary(hard).rstrip('.')}"
    return words, not missed and all(outcome.allowed for outcome in hard)


def overview_section_for(scenes: Sequence[Scene]) -> Section:
    """Make the overview section of the report for the user's scenes, with the quick hard cases."""
    return OVERVIEW._replace(tasks=lambda full: overview_tasks(scenes, full, hard=True))


def _packaged_overview_tasks(full: bool) -> list[Task]:
    """Make the tasks for the packaged damper and the compression with dry friction."""
    return overview_tasks([load_scene("damper"), quarter_bed_compression_scene()], full, hard=False)


OVERVIEW = Section(
    "overview", "", _packaged_overview_tasks, OverviewResult, _overview_verdict_and_passed, overview_blocks
)
