"""Runs of a scene with many settings, from the same starts, against a reference."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
import warnings
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from granular.run.plan import can_run
from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.errors import GranularError, InputError
from validation.external_integrators import solve_adaptively
from validation.measured_quantities import MeasuredQuantity, quantity_named
from validation.work_precision_result import SolverSettings, WorkPrecision, WorkPrecisionPoint

# The least time of two counts: whatever disturbs a run makes it longer.
REPEATS = 2
LONG = 1.0
"""A run of this length is timed well enough, and not repeated [s]."""

Value = float | np.ndarray
Reference = SolverSettings | float | np.ndarray | None
"""A setting to take the true value from, the value, or None for the finest or the exact one."""


class ReferenceValue(NamedTuple):
    """Values that a quantity is measured against."""

    words: str
    values: tuple[Value, ...]  # one for each start
    floor: float  # scatter of the quantity over the starts, as an error


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
        One of `validation.measured_quantities.QUANTITIES`, or one's own.
    settings : iterable of SolverSettings
        Settings to try. Outside integrators are tried for the positions alone, where ``until`` is given,
        and left out otherwise.
    reference : SolverSettings or float or ndarray, optional
        A setting to take the true value from, or the value in the quantity's unit; without, the
        quantity's exact value, or what `reference_setting` gives.
    until : float, optional
        Stop each run at this time [s]; the position error of a chaotic bed means something over a
        short horizon only.
    seeds : int
        Further random starts, from each of which every setting and the reference are run too: the
        error is then the mean of the deviations, with its standard error. None are made where the
        start does not depend on the seed.
    repeats : int
        Runs of each setting from a start, from 1; the fastest is timed, and no more follow one of 1 s.

    Returns
    -------
    WorkPrecision
        Error (relative, or in the quantity's unit) and wall time [s] of each setting; NaN, with the error's
        text, where the setting could not be run, as one of an unknown method.

    Raises
    ------
    InputError
        If the quantity is unknown, no setting is given, ``repeats`` is below 1, or the scene cannot be
        run by the reference.
    RunError
        If the reference itself fails.
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
    """Run a scene with many settings, and compare several quantities with their references; until [s]."""
    chosen = [quantity_named(quantity) for quantity in quantities]
    wanted = tuple(settings)
    if not wanted:
        raise InputError("no settings are given; give at least one method and step")
    if repeats < 1:
        raise InputError(f"repeats = {repeats}; give a number of runs from 1")
    given = references or [None] * len(chosen)
    comparison = compare_with_references(scenes_with_other_seeds(scene, seeds), chosen, given, until)
    return comparison.studies([comparison.points(setting, repeats) for setting in wanted])


STEPS = ("auto*8", "auto*4", "auto*2", "auto", "auto/2", "auto/4", "auto/8")
CANDIDATES = ("stormer-verlet", "adaptive-verlet", "blanes-moan-4", "blanes-moan-6")


def candidate_settings(scene: Scene, methods: Sequence[str] = CANDIDATES) -> tuple[SolverSettings, ...]:
    """Return the settings to try on a scene: methods, each with steps from ``auto*8`` to ``auto/8``."""
    return tuple(SolverSettings(name, dt) for name in methods for dt in STEPS if can_run(scene, dt, name))


def scenes_with_other_seeds(scene: Scene, seeds: int) -> tuple[Scene, ...]:
    """Scene, and copies of it from further random starts."""
    first = scene.arrangement.seed
    count = seeds if seeds and depends_on_seed(scene) else 0
    more = (scene.replace(**{"arrangement.seed": first + k}) for k in range(1, count + 1))
    return (scene, *more)


def depends_on_seed(scene: Scene) -> bool:
    """Tell if another seed gives a scene another start."""
    if scene.arrangement.positions is not None:  # which take no seed
        return False
    other = scene.replace(**{"arrangement.seed": scene.arrangement.seed + 1})
    return any(
        not np.array_equal(mine, yours)
        for mine, yours in zip(
            scene.initial_positions_and_velocities(), other.initial_positions_and_velocities(), strict=True
        )
    )


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Starts of a scene, and the true values that quantities of its runs are compared with."""

    scenes: Sequence[Scene]
    quantities: Sequence[MeasuredQuantity]
    until: float | None  # [s]
    truth: Sequence[ReferenceValue]  # of each quantity

    def points(self, setting: SolverSettings, repeats: int = 1) -> list[WorkPrecisionPoint | None]:
        """Measure error and time of a setting, for each quantity from the same runs."""
        if setting.is_external:
            return self._external_points(setting)
        try:
            _compile_setting(self.scenes[0], setting)
            timed = [_run_and_time(scene, setting, self.until, repeats) for scene in self.scenes]
        except GranularError as stop:
            return [_failed_point(setting, stop) for _ in self.quantities]
        runs = [run for run, _ in timed]
        seconds = float(np.mean([spent for _, spent in timed]))
        return [
            _point_of_runs(setting, quantity, runs, item, seconds)
            for quantity, item in zip(self.quantities, self.truth, strict=True)
        ]

    def _external_points(self, setting: SolverSettings) -> list[WorkPrecisionPoint | None]:
        """Points of an outside reference, which gives positions only; compiled before it counts."""
        return [
            _external_point(self.scenes[0], quantity, setting, item.values[0], self.until)
            if quantity.name == "positions" and self.until is not None
            else None
            for quantity, item in zip(self.quantities, self.truth, strict=True)
        ]

    def studies(self, rows: Sequence[Sequence[WorkPrecisionPoint | None]]) -> tuple[WorkPrecision, ...]:
        """Make a study for each quantity, of the points of each setting."""
        return tuple(
            WorkPrecision(
                self.scenes[0].name,
                quantity.name,
                "1" if quantity.relative else quantity.unit,
                self.until,
                tuple(point for row in rows if (point := row[k]) is not None),
                self.truth[k].floor,
                self.truth[k].words,
            )
            for k, quantity in enumerate(self.quantities)
        )


def compare_with_references(
    scenes: Sequence[Scene],
    quantities: Sequence[MeasuredQuantity],
    given: Sequence[Reference],
    until: float | None,
) -> Comparison:
    """Find the true values of quantities, from runs, given numbers or exact solutions; until [s]."""
    runs: dict[str, list[Trajectory]] = {}
    truth = []
    for quantity, reference in zip(quantities, given, strict=True):
        wanted = reference
        if wanted is None:
            wanted = reference_setting(scenes[0]) if quantity.exact is None else quantity.exact
        if isinstance(wanted, SolverSettings):
            words = f"{wanted.family}, dt = {wanted.dt}"
            if words not in runs:
                runs[words] = [run_setting(scene, wanted, until) for scene in scenes]
            values = tuple(quantity.measure(run) for run in runs[words])
            truth.append(ReferenceValue(words, values, _scatter_over_starts(quantity, values)))
        else:
            words = f"the value {wanted:g}" if isinstance(wanted, float) else "exact values"
            truth.append(ReferenceValue(words, (wanted,) * len(scenes), 0.0))
    return Comparison(scenes, quantities, until, truth)


def reference_setting(scene: Scene) -> SolverSettings:
    """Return a setting far more accurate than any that is worth while."""
    best = SolverSettings("blanes-moan-6", "auto/2")
    if can_run(scene, best.dt, best.method):
        return best
    return SolverSettings("stormer-verlet", "auto/16")


def run_setting(scene: Scene, setting: SolverSettings, until: float | None) -> Trajectory:
    """Run a scene with a setting, without its warnings: its error is measured anyway; until [s]."""
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
        error, doubt = deviation_over_starts(quantity, [quantity.measure(run) for run in runs], truth.values)
    except GranularError as stop:
        return _failed_point(setting, stop)
    return WorkPrecisionPoint(setting, error, seconds, steps, None, doubt, len(runs), frequency)


def deviation_over_starts(
    quantity: MeasuredQuantity, values: Sequence[Value], references: Sequence[Value]
) -> tuple[float, float]:
    """Error of a quantity over the starts, and its standard error."""
    # Single starts that are off to either side are scatter, which no setting corrects: the mean counts. A
    # quantity with a value of its own in each start has the greatest error.
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
    """Return the standard deviation of a quantity over starts, as an error."""
    if len(values) < 2 or quantity.differs_by_start:
        return 0.0
    series = np.array([np.asarray(value) for value in values])
    spread = float(series.std(axis=0, ddof=1).max())
    if not quantity.relative:
        return spread
    return spread / float(np.abs(series.mean(axis=0)).max())


def _run_and_time(
    scene: Scene, setting: SolverSettings, until: float | None, repeats: int
) -> tuple[Trajectory, float]:
    """Run, and the least time [s] of its repeats."""
    seconds = math.inf
    for _ in range(repeats):
        start = time.perf_counter()
        done = run_setting(scene, setting, until)
        seconds = min(seconds, time.perf_counter() - start)
        if seconds > LONG:
            break
    return done, seconds


def _failed_point(setting: SolverSettings, stop: GranularError) -> WorkPrecisionPoint:
    return WorkPrecisionPoint(setting, math.nan, math.nan, 0, f"{type(stop).__name__}: {stop}")


def _compile_setting(scene: Scene, setting: SolverSettings) -> None:
    """Compile, by a run so short that it costs nothing; a long step may not even fit into it."""
    with contextlib.suppress(GranularError):
        run_setting(scene, setting._replace(dt="auto"), 1e-3 * scene.output.scalars)


def _external_point(
    scene: Scene, quantity: MeasuredQuantity, setting: SolverSettings, truth: Value, until: float
) -> WorkPrecisionPoint:
    solve_adaptively(setting.method, scene, 1e-3 * until, 1e-2)
    started = time.perf_counter()
    solved = solve_adaptively(setting.method, scene, until, float(setting.dt))
    seconds = time.perf_counter() - started
    error = quantity.error(solved.positions / Scales.from_grains(scene.grains).length, truth)
    return WorkPrecisionPoint(setting, error, seconds, solved.steps or 0)
