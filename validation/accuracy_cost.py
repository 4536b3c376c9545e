"""Cost of accuracy: measure error and wall time of runs with many settings; section of the report."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
import warnings
from collections.abc import Iterable, Sequence
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from granular.run.plan import can_run
from granular.run.trajectory import Trajectory
from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.blocks import Block, Table, Text
from granular.shared.errors import GranularError, InputError
from validation.exact_problems import exact_problem
from validation.external_integrators import ORDERS, solve_adaptively
from validation.measured_quantities import MeasuredQuantity, quantity_named
from validation.report_tasks import PlainData, Section, Task, make_one_axes_picture, scene_key
from validation.work_precision_result import LEVELS, USUAL, SolverSettings, WorkPrecision, WorkPrecisionPoint

# The shorter of two times counts, since disturbances only make a run longer.
REPEATS = 2
LONG = 1.0
"""A run that takes this wall time [s] or longer is not repeated."""

Value = float | np.ndarray
Reference = SolverSettings | float | np.ndarray | None
"""Setting or value from which errors are measured; None means the exact value or, if unknown, a finer run."""


class ReferenceValue(NamedTuple):
    """Reference values of a quantity, one for each initial state."""

    label: str
    values: tuple[Value, ...]  # one for each random initial state
    floor: float  # scatter of the quantity over the initial states, in the unit of the error


def work_precision(
    scene: Scene,
    quantity: str | MeasuredQuantity,
    settings: Iterable[SolverSettings],
    *,
    reference: Reference = None,
    until: float | None = None,
    seeds: int = 0,
    repeats: int = REPEATS,
) -> WorkPrecision:
    """Run a scene with many settings, and compare a quantity with its reference.

    Parameters
    ----------
    scene : Scene
        Scene to run.
    quantity : str or MeasuredQuantity
        Name of one of `validation.measured_quantities.QUANTITIES`, or a custom quantity.
    settings : iterable of SolverSettings
        Settings to try. External integrators are tried for the positions only, and only if ``until`` is
        given.
    reference : SolverSettings or float or ndarray, optional
        Setting that gives the reference value, or the value in the quantity's unit. Default: the quantity's
        exact value, or a run with `choose_reference_setting`.
    until : float, optional
        Stop each run at this time [s]; the position error of a chaotic bed is meaningful only over a short
        time.
    seeds : int
        Number of further random initial states. Every setting and the reference are run from each of them.
        The error is then the mean deviation, with its standard error. The number is ignored if the initial
        state does not depend on the seed.
    repeats : int
        Number of runs of each setting from one initial state, 1 or more; the shortest time counts. A run of 1
        s or longer is not repeated.

    Returns
    -------
    WorkPrecision
        Error (relative, or in the quantity's unit) and wall time [s] of each setting. Both are NaN, with the
        message of the exception, if the setting could not be run, for example if its method is unknown.

    Raises
    ------
    InputError
        If the quantity is unknown, no setting is given, ``repeats`` is below 1, or the reference cannot run
        the scene.
    RunError
        If the reference run fails.
    """
    return work_precision_of_quantities(
        scene, [quantity], settings, references=[reference], until=until, seeds=seeds, repeats=repeats
    )[0]


def work_precision_of_quantities(
    scene: Scene,
    quantities: Sequence[str | MeasuredQuantity],
    settings: Iterable[SolverSettings],
    *,
    references: Sequence[Reference] | None = None,
    until: float | None = None,
    seeds: int = 0,
    repeats: int = REPEATS,
) -> tuple[WorkPrecision, ...]:
    """Run a scene with many settings up to ``until`` [s], and compare several quantities with references."""
    chosen = [quantity_named(quantity) for quantity in quantities]
    wanted = tuple(settings)
    if not wanted:
        raise InputError("no settings are given; give one or more methods and steps")
    if repeats < 1:
        raise InputError(f"repeats = {repeats}; give 1 or more runs")
    given = references or [None] * len(chosen)
    comparison = scenes_with_reference_values(scenes_with_other_seeds(scene, seeds), chosen, given, until)
    return comparison.studies([comparison.measure_points(setting, repeats) for setting in wanted])


STEPS = ("auto*8", "auto*4", "auto*2", "auto", "auto/2", "auto/4", "auto/8")
CANDIDATES = ("stormer-verlet", "adaptive-verlet", "blanes-moan-4", "blanes-moan-6")


def settings_to_try(scene: Scene, methods: Sequence[str] = CANDIDATES) -> tuple[SolverSettings, ...]:
    """Return the settings to try on a scene: each method with steps from ``auto*8`` to ``auto/8``."""
    return tuple(SolverSettings(name, dt) for name in methods for dt in STEPS if can_run(scene, dt, name))


def scenes_with_other_seeds(scene: Scene, seeds: int) -> tuple[Scene, ...]:
    """Return the scene, followed by copies with other initial states if its initial state is random."""
    first = scene.arrangement.seed
    count = seeds if seeds and scene_depends_on_seed(scene) else 0
    more = (scene.replace(**{"arrangement.seed": first + k}) for k in range(1, count + 1))
    return (scene, *more)


def scene_depends_on_seed(scene: Scene) -> bool:
    """Return True if the initial state of a scene depends on its seed."""
    if scene.arrangement.positions is not None:  # these take no seed
        return False
    other = scene.replace(**{"arrangement.seed": scene.arrangement.seed + 1})
    return any(
        not np.array_equal(mine, yours)
        for mine, yours in zip(
            scene.initial_positions_and_velocities(), other.initial_positions_and_velocities(), strict=True
        )
    )


@dataclasses.dataclass(frozen=True)
class ScenesWithReferences:
    """A scene with each of its random initial states, and reference values of the measured quantities."""

    scenes: Sequence[Scene]
    quantities: Sequence[MeasuredQuantity]
    until: float | None  # [s]
    truth: Sequence[ReferenceValue]  # one for each quantity

    def measure_points(self, setting: SolverSettings, repeats: int = 1) -> list[WorkPrecisionPoint | None]:
        """Run the scenes with a setting; measure the wall time and the errors of all quantities."""
        if setting.is_external:
            return self._external_points(setting)
        try:
            compile_code_of_setting(self.scenes[0], setting)
            timed = [run_repeatedly_and_time(scene, setting, self.until, repeats) for scene in self.scenes]
        except GranularError as stop:
            return [_failed_point(setting, stop) for _ in self.quantities]
        runs = [run for run, _ in timed]
        seconds = float(np.mean([spent for _, spent in timed]))
        return [
            _point_of_runs(setting, quantity, runs, item, seconds)
            for quantity, item in zip(self.quantities, self.truth, strict=True)
        ]

    def _external_points(self, setting: SolverSettings) -> list[WorkPrecisionPoint | None]:
        """Measure time and position error of an external integrator; None for other quantities."""
        return [
            _measure_external_point(self.scenes[0], quantity, setting, item.values[0], self.until)
            if quantity.name == "positions" and self.until is not None
            else None
            for quantity, item in zip(self.quantities, self.truth, strict=True)
        ]

    def studies(self, rows: Sequence[Sequence[WorkPrecisionPoint | None]]) -> tuple[WorkPrecision, ...]:
        """Return one study for each quantity, from the points of all settings."""
        return tuple(
            WorkPrecision(
                self.scenes[0].name,
                quantity.name,
                "1" if quantity.relative else quantity.unit,
                self.until,
                tuple(point for row in rows if (point := row[k]) is not None),
                self.truth[k].floor,
                self.truth[k].label,
            )
            for k, quantity in enumerate(self.quantities)
        )


def scenes_with_reference_values(
    scenes: Sequence[Scene],
    quantities: Sequence[MeasuredQuantity],
    given: Sequence[Reference],
    until: float | None,
) -> ScenesWithReferences:
    """Return scenes with reference values: given, exact, or computed by runs up to ``until`` [s]."""
    runs: dict[str, list[Trajectory]] = {}
    truth = []
    for quantity, reference in zip(quantities, given, strict=True):
        wanted = reference
        if wanted is None:
            wanted = choose_reference_setting(scenes[0]) if quantity.exact is None else quantity.exact
        if isinstance(wanted, SolverSettings):
            label = f"{wanted.family}, dt = {wanted.dt}"
            if label not in runs:
                runs[label] = [run_scene_with_setting(scene, wanted, until) for scene in scenes]
            values = tuple(quantity.measure(run) for run in runs[label])
            truth.append(ReferenceValue(label, values, _scatter_over_starts(quantity, values)))
        else:
            label = f"the value {wanted:g}" if isinstance(wanted, float) else "exact values"
            truth.append(ReferenceValue(label, (wanted,) * len(scenes), 0.0))
    return ScenesWithReferences(scenes, quantities, until, truth)


def choose_reference_setting(scene: Scene) -> SolverSettings:
    """Return a setting that is far more accurate than the settings compared with it."""
    best = SolverSettings("blanes-moan-6", "auto/2")
    if can_run(scene, best.dt, best.method):
        return best
    return SolverSettings("stormer-verlet", "auto/16")


def run_scene_with_setting(scene: Scene, setting: SolverSettings, until: float | None) -> Trajectory:
    """Run a scene with a setting up to ``until`` [s]; suppress warnings, because the error is measured."""
    from granular.run.simulation import simulate

    with warnings.catch_warnings(action="ignore"):
        return simulate(
            scene.replace(**setting.changes),
            dt=setting.dt,
            t_end=until,
            method=setting.method,
            progress=False,
        )


def _point_of_runs(
    setting: SolverSettings,
    quantity: MeasuredQuantity,
    runs: Sequence[Trajectory],
    truth: ReferenceValue,
    seconds: float,
) -> WorkPrecisionPoint:
    settings = [run.settings() for run in runs]
    steps = round(float(np.mean([entry["steps"] for entry in settings])))
    frequency = max(entry.get("step_times_highest_frequency", 0.0) for entry in settings)
    try:
        error, doubt = error_and_standard_error_over_starts(
            quantity, [quantity.measure(run) for run in runs], truth.values
        )
    except GranularError as stop:
        return _failed_point(setting, stop)
    return WorkPrecisionPoint(setting, error, seconds, steps, None, doubt, len(runs), frequency)


def error_and_standard_error_over_starts(
    quantity: MeasuredQuantity, values: Sequence[Value], references: Sequence[Value]
) -> tuple[float, float]:
    """Combine a quantity's errors from all initial states; return the error and its standard error."""
    # Deviations from single initial states scatter around zero for any setting, so the mean deviation counts.
    # For a quantity whose value differs by initial state, the largest error counts.
    if quantity.differs_by_start or len(values) == 1:
        errors = [quantity.error(*pair) for pair in zip(values, references, strict=True)]
        return max(errors), float(np.std(errors, ddof=1)) if len(errors) > 1 else 0.0
    off = np.array([np.ravel(a) - np.ravel(b) for a, b in zip(values, references, strict=True)])
    if quantity.relative:
        off /= np.abs(np.mean([np.asarray(reference) for reference in references], axis=0)).max()
    mean = np.abs(off.mean(axis=0))
    worst = int(mean.argmax())
    return float(mean[worst]), float(off[:, worst].std(ddof=1) / math.sqrt(len(values)))


def _scatter_over_starts(quantity: MeasuredQuantity, values: Sequence[Value]) -> float:
    """Return the standard deviation of a quantity between initial states, in the unit of the error."""
    if len(values) < 2 or quantity.differs_by_start:
        return 0.0
    series = np.array([np.asarray(value) for value in values])
    spread = float(series.std(axis=0, ddof=1).max())
    if not quantity.relative:
        return spread
    return spread / float(np.abs(series.mean(axis=0)).max())


def run_repeatedly_and_time(
    scene: Scene, setting: SolverSettings, until: float | None, repeats: int = 1
) -> tuple[Trajectory, float]:
    """Repeat a run up to ``until`` [s]; return the last run and the shortest wall time [s]."""
    seconds = math.inf
    for _ in range(repeats):
        start = time.perf_counter()
        done = run_scene_with_setting(scene, setting, until)
        seconds = min(seconds, time.perf_counter() - start)
        if seconds > LONG:
            break
    return done, seconds


def _failed_point(setting: SolverSettings, stop: GranularError) -> WorkPrecisionPoint:
    return WorkPrecisionPoint(setting, math.nan, math.nan, 0, f"{type(stop).__name__}: {stop}")


def compile_code_of_setting(scene: Scene, setting: SolverSettings) -> None:
    """Compile a setting's code by a very short run with dt = auto, since other steps may exceed this run."""
    with contextlib.suppress(GranularError):
        run_scene_with_setting(scene, setting._replace(dt="auto"), 1e-3 * scene.output.scalars)


def _measure_external_point(
    scene: Scene, quantity: MeasuredQuantity, setting: SolverSettings, truth: Value, until: float
) -> WorkPrecisionPoint:
    solve_adaptively(setting.method, scene, 1e-3 * until, 1e-2)
    started = time.perf_counter()
    solved = solve_adaptively(setting.method, scene, until, float(setting.dt))
    seconds = time.perf_counter() - started
    error = quantity.error(solved.positions / Scales.from_grains(scene.grains).length, truth)
    return WorkPrecisionPoint(setting, error, seconds, solved.steps or 0)


# Scenes -----------------------------------------------------------------------------------------


def quarter_bed_compression_scene() -> Scene:
    """Return the scene of a quarter of de Paula's bed with dry friction, compressed at 33 mm/s [D, 2.3.3]."""
    return load_scene("bed").replace(
        **{
            "name": "compression",
            "grains.count": 92,
            "cell.width": "30 D",
            "piston.height": "45 D",
            "arrangement.height": "40 D",
            "effects.drag": None,
            "effects.friction": {},
            "protocol": [
                {"kind": "hold", "name": "relax", "duration": 1.0},
                {"kind": "move", "name": "compress", "to": "10 D", "speed": "33 mm/s"},
            ],
            "output.scalars": 0.01,
            "output.frames": 1.0,
        }
    )


def bed_scene_without_drag() -> Scene:
    """Return the packaged bed without drag, whose energy is conserved."""
    return load_scene("bed").replace(**{"name": "bed without friction", "effects.drag": None})


def disturbed_lattice_scene(count: int) -> Scene:
    """Return a scene of a disturbed hexagonal lattice at the packing of the packaged bed."""
    scale = math.sqrt(count / 368.0)
    width, height = 60.0 * scale, 20.0 * scale
    apart = math.sqrt(2.0 / math.sqrt(3.0) * width * height / count)
    rows = round(height / (apart * math.sqrt(0.75)))
    fractions = [count // rows + (row < count % rows) for row in range(rows)]
    indices = np.array(
        [
            ((i + 0.5 + 0.25 * (-1) ** row) * width / many, (row + 0.5) * height / rows)
            for row, many in enumerate(fractions)
            for i in range(many)
        ]
    )
    indices += 0.05 * apart * np.random.default_rng(1).standard_normal(indices.shape)
    indices = np.clip(indices, 0.6, np.array([width, height]) - 0.6)
    scene = load_scene("bed")
    diameter = scene.grains.species[0].diameter
    return scene.replace(
        **{
            "grains.count": count,
            "cell.width": width * diameter,
            "piston.height": height * diameter,
            "arrangement": {"positions": (diameter * indices).tolist(), "speed": 0.0},
            "output": {"scalars": 0.01, "frames": 1.0},
        }
    )


# Tasks ------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class TaskStudies(PlainData):
    """Studies of one task, one for each quantity."""

    studies: tuple[WorkPrecision, ...]


class WorkPrecisionPlan(NamedTuple):
    """Plan of a task: a scene, the quantities to measure in it, the settings to try, and options."""

    scene: Scene
    quantities: Sequence[str]
    settings: Sequence[SolverSettings]
    options: dict[str, Any]  # keyword arguments of `work_precision_of_quantities`


OUTSIDE_TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
"""Tolerances of the external integrators. For the bed only the first and third are run, to save time."""

DAMPER_STEPS = {
    "stormer-verlet": ("auto*8", "auto*4", "auto*2", "auto", "auto/2"),
    "blanes-moan-4": ("auto*8", "auto*4", "auto*2"),
}
"""Time steps for the damper, fewer than for other scenes: its runs are long, and their errors soon drop below
the scatter over initial states."""


SUMS: tuple[dict[str, Any], ...] = (
    {"pairs.method": "direct"},
    *({"pairs.method": "mesh", "pairs.tolerance": value} for value in (3e-3, 3e-4, 3e-5)),
    {"pairs.method": "mesh", "pairs.far_every": 1},
    *({"pairs.method": "cut-off", "pairs.cut_off": f"{value} D"} for value in (5, 8, 11.26, 16)),
    *({"pairs.method": "verlet-list", "pairs.cut_off": f"{value} D"} for value in (5, 8, 11.26, 16)),
)
"""Pair sums to compare. One cut-off radius is the 11.26 D of de Paula's pair list [D, 5.2]."""


def work_precision_plans_of_report(full: bool) -> list[WorkPrecisionPlan]:
    """Return the plans: lone grain, frictionless bed, compression; if ``full`` also damper and pair sums."""
    grain, bed, squeezed = (
        load_scene("single-particle"),
        bed_scene_without_drag(),
        quarter_bed_compression_scene(),
    )
    saved = ("energy", "positions")
    outside = [SolverSettings(name, limit) for name in ORDERS for limit in OUTSIDE_TOLERANCES]
    few = [setting for setting in outside if setting.dt in OUTSIDE_TOLERANCES[:3:2]]
    problem = exact_problem("bounce")
    position = problem.exact(1.0).positions / Scales.from_grains(problem.scene.grains).length
    exact = {"until": 1.0, "references": [0.0, position]}
    plans = [
        WorkPrecisionPlan(grain, saved, [*settings_to_try(grain), *outside], exact),
        WorkPrecisionPlan(bed, saved, [*settings_to_try(bed), *few], {"until": 0.02}),
        WorkPrecisionPlan(
            squeezed, ("piston force", "mean distance"), settings_to_try(squeezed), {"seeds": 4}
        ),
    ]
    if not full:
        return plans
    damper = [SolverSettings(name, dt) for name, steps in DAMPER_STEPS.items() for dt in steps]
    quantities = ("rest height", "period", "damping ratio")
    finer = [SolverSettings("stormer-verlet", "auto/8")] * len(quantities)
    lattice = disturbed_lattice_scene(1472).replace(name="1472 grains, by pair sum")
    sums = [SolverSettings("stormer-verlet", "auto", changes) for changes in SUMS]
    direct = [SolverSettings("stormer-verlet", "auto/2", SUMS[0])]
    return [
        *plans,
        WorkPrecisionPlan(
            load_scene("damper"), quantities, damper, {"seeds": 4, "repeats": 1, "references": finer}
        ),
        # The piston's force while the grains settle, for each pair sum.
        WorkPrecisionPlan(
            lattice, ("piston force",), sums, {"until": 0.3, "references": direct, "repeats": 1}
        ),
    ]


def work_precision_task(plan: WorkPrecisionPlan, **more: Any) -> Task:
    """Make the task that runs one scene with many settings."""
    key = {
        **scene_key(plan.scene),
        "quantities": plan.quantities,
        "settings": str(plan.settings),
        "options": str(plan.options),
        **more,
    }
    given = plan.scene, plan.quantities, plan.settings
    return Task(
        plan.scene.name, key, lambda: TaskStudies(work_precision_of_quantities(*given, **plan.options))
    )


# In the report ----------------------------------------------------------------------------------


def _all_studies(results: Sequence[TaskStudies]) -> list[WorkPrecision]:
    """Return the work-precision studies of all tasks in one list."""
    return list(chain.from_iterable(result.studies for result in results))


def work_precision_blocks(results: Sequence[TaskStudies]) -> list[Block]:
    """Make the table of recommended settings and one plot for each study."""
    intro = Text(
        "Error against wall time (compiled code, minimum of the repeats). The broad line is the Pareto "
        "front. With several random starts the error is the mean deviation over the starts, and a thin bar "
        "ends at the upper bound of the error. A dotted line marks each tolerance and names the recommended "
        "setting, whose point has a ring. It is the fastest setting that meets two conditions: the upper "
        "bound of its error is within the tolerance, and no shorter step has an error clearly above the "
        "tolerance. The shaded band is the scatter over random starts. For tolerances below three times the "
        "band, several starts must be averaged, with a setting that has no clear systematic error. The "
        "toolkit's times include records, energy ledger and start-up; the times of SciPy and diffrax (thin, "
        "dotted) include only the integration. The last column is the time divided by the time of the "
        "default setting, stormer-verlet at dt = auto."
    )
    pictures = [
        make_one_axes_picture(
            study.plot, f"{study.quantity} of {study.scene_and_duration_label}, against {study.reference}."
        )
        for study in _all_studies(results)
    ]
    return [intro, advised_setting_table(_all_studies(results)), *pictures]


def advised_setting_table(studies: Sequence[WorkPrecision]) -> Table:
    """Tabulate for each tolerance the recommended setting, and its run time divided by the default's."""
    rows = []
    for study in studies:
        usual = study.default_point()
        seconds = math.nan if usual is None else usual.seconds
        rows += [
            (study.scene, study.quantity, label, *_advised_setting_row(study, level, seconds))
            for label, level in LEVELS.items()
        ]
    header = ("scene", "quantity", "to", "take", "dt", "error", "starts", "seconds", "time / default")
    return Table(header, rows)


def _advised_setting_row(work_precision: WorkPrecision, level: float, usual: float) -> tuple[str, ...]:
    advice = work_precision.advise(level)
    best = advice.point
    if best is None:
        return (str(advice), "", "", "", "", "")
    take = best.setting.family
    if advice.needs_more_starts:
        take = f"average over starts, which scatter by {advice.floor:.2g}"
    ratio = advice.seconds / usual
    return (
        take,
        best.setting.fineness,
        f"{best.error:.2g}",
        f"{advice.starts:.3g}",
        f"{advice.seconds:.3g}",
        "" if math.isnan(ratio) else f"{ratio:.3g}",
    )


def _study_tables(results: Sequence[TaskStudies]) -> list[Block]:
    title = "Cost of the {0.quantity} of {0.scene}; a star marks the Pareto front."
    pairs = [(Text(title.format(study)), study.table()) for study in _all_studies(results)]
    return list(chain.from_iterable(pairs))


def _studies_verdict_and_passed(results: Sequence[TaskStudies]) -> tuple[str, bool]:
    studies = _all_studies(results)
    usual = [study for study in studies if any(point.setting[:2] == USUAL for point in study.points)]
    right = sum(study.default_point() is not None for study in usual)
    words = (
        f"cost of accuracy shown for {len(studies)} quantities; the default setting runs in "
        f"{right} of {len(usual)}"
    )
    return words, right == len(usual)


WORK_PRECISION = Section(
    "work-precision",
    "Cost of accuracy",
    lambda full: [work_precision_task(plan) for plan in work_precision_plans_of_report(full)],
    TaskStudies,
    _studies_verdict_and_passed,
    work_precision_blocks,
    _study_tables,
)
