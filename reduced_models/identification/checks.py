"""Further runs of a scene: step error and scatter of its figures, another lift, other falls."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import GranularError, InputError, RecordError
from reduced_models.falls.scores import DropScores, score_drops
from reduced_models.fitting.fit import fit
from reduced_models.identification.engineering import Figure
from reduced_models.models.model import ReducedModel

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene

CHECK_SEEDS = 2
"""Further random starts of the bed that are run to see the scatter."""
LIFT_TIMES = 3.0
"""Height of a lift that no law sees, over that of the scene: far enough that a law's shape counts.
"""
_RESOLVED = 1.0  # step times highest frequency up to which a method shows its order; half the limit
DROPS = (0.4, 0.6, 1.4, 1.8)
"""Heights, over that of the scene's drop, from which the piston falls instead."""
PERIODS = 10.0
"""Of the small swing, for which falls are followed: by then they have died out, or swing small."""
FEWEST = 100
"""Samples of a fall."""
STARTS = 8
"""Of each fit: a fall without noise, which few starts find, and the scene says where to begin."""
_STILL = 0.05  # of the drop: what falls less far is a nudge


class RunCheck(NamedTuple):
    """A further run of a scene.

    Attributes
    ----------
    what : str
        In words, for messages.
    changes : mapping
        To the run: its ``dt``, or keys of its scene.
    """

    what: str
    changes: Mapping[str, Any]


class Failure(NamedTuple):
    """Why a check has no record."""

    what: str
    cause: str


class StepCheck(NamedTuple):
    """A run with another time step.

    Attributes
    ----------
    check : RunCheck
    factor : float
        Error of the step that was used, over what the other one changes.
    """

    check: RunCheck
    factor: float


class FurtherRuns(NamedTuple):
    """Records of further runs of a scene, and laws judged on its falls.

    Attributes
    ----------
    swings : tuple of (str, PistonRecord or Failure)
        With another time step, and then from other random starts, each behind its name.
    step_factor : float
        See `StepCheck`.
    lift : PistonRecord or None
        With another lift.
    falls : DropScores or None
    failures : tuple of Failure
        Of all that were asked for.
    """

    swings: tuple[tuple[str, PistonRecord | Failure], ...]
    step_factor: float
    lift: PistonRecord | None
    falls: DropScores | None
    failures: tuple[Failure, ...]


def further_runs(
    run: Trajectory, period: float | None, executor: Executor | None, progress: bool, *, lift: bool
) -> FurtherRuns:
    """Run the scene of a run with another step, other random starts, another lift, other falls.

    Parameters
    ----------
    run : Trajectory
    period : float, optional
        Of the small swing [s], where falls are asked for. They are run where the scene begins with
        one.
    executor, progress
        As of `identify`.
    lift : bool
        Whether another lift is run.
    """
    step, seeds = scene_with_other_step(run), scenes_with_other_seeds(run)
    swings = [step.check, *seeds]
    lifts = [other] if lift and (other := lift_for_testing(run.scene)) is not None else []
    fall = None if period is None else first_fall(run, period)
    falls = [] if fall is None else fall_checks(run, fall)
    records = checked_records(run, [*swings, *lifts, *falls], executor, progress)
    failures = [record for record in records if isinstance(record, Failure)]
    first, last = len(swings), len(swings) + len(lifts)
    scores = None if fall is None else score_run_falls(run, fall, falls, records[last:])
    if isinstance(scores, Failure):
        failures.append(scores)
    return FurtherRuns(
        swings=tuple(zip((swing.what for swing in swings), records[:first], strict=True)),
        step_factor=step.factor,
        lift=next(
            (record for record in records[first:last] if isinstance(record, PistonRecord)), None
        ),
        falls=scores if isinstance(scores, DropScores) else None,
        failures=tuple(failures),
    )


def check_figures(
    figures: Mapping[str, Figure], model: ReducedModel, record: PistonRecord, runs: FurtherRuns
) -> tuple[dict[str, Figure], list[Failure]]:
    """Return figures with step error and scatter, as far as there are runs, and what failed.

    The records of the runs are fitted by the law and map of the figures' model, over the duration
    of its record.
    """
    duration = float(record.time[-1] - record.time[0])
    results = [_refit_check(what, swing, duration, model) for what, swing in runs.swings]
    other, *scattered = [None if isinstance(result, Failure) else result for result in results]
    checked = {}
    for name, figure in figures.items():
        values = [figure.value, *(values[name] for values in scattered if values is not None)]
        values = [value for value in values if math.isfinite(value)]
        checked[name] = dataclasses.replace(
            figure,
            step_error=(
                None if other is None else runs.step_factor * abs(figure.value - other[name])
            ),
            seed_spread=float(np.std(values, ddof=1)) if len(values) > 1 else None,
        )
    return checked, [result for result in results if isinstance(result, Failure)]


def _refit_check(
    what: str, record: PistonRecord | Failure, duration: float, model: ReducedModel
) -> dict[str, float] | Failure:
    if isinstance(record, Failure):
        return record
    start = float(record.time[0])
    try:
        part = record.between(start, start + duration * (1.0 + 1e-9))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            again = fit(
                part,
                model.law,
                map="fitted" if model.map.fitted else model.map,
                starts=model.quality.starts,
                test_fraction=0.0,
            )
    except GranularError as error:
        return Failure(what, str(error))
    if again.at_rest is None:
        return Failure(what, "its fit has no level of rest")
    values = dataclasses.asdict(again.at_rest)
    return {name: values[name] for name in model.at_rest.intervals} if model.at_rest else {}


def scene_with_other_step(run: Trajectory) -> StepCheck:
    """Scene of a run with twice its time step, or half of it where twice is too coarse.

    A method of order p is off by 1/(2^p - 1) of what twice the step changes; all of the change is
    taken for the error, which it bounds also where a bed that packs otherwise follows no order.
    Half the step changes 1 - 2^-p of the error.
    """
    from granular.run.options import double_step, halve_step, is_allowed

    settings = run.settings()
    dt = settings["dt"]
    coarser = 2.0 * settings["step_times_highest_frequency"]
    if coarser <= _RESOLVED and is_allowed(run.scene, double_step(dt), run.method):
        return StepCheck(RunCheck("twice the time step", {"dt": double_step(dt)}), 1.0)
    power = 2.0**run.method.order
    return StepCheck(RunCheck("half the time step", {"dt": halve_step(dt)}), power / (power - 1.0))


def scenes_with_other_seeds(run: Trajectory) -> list[RunCheck]:
    """Scene of a run from other random starts, all else alike."""
    first = run.scene.arrangement.seed + 1
    return [
        RunCheck(f"random start {seed}", {"arrangement.seed": seed})
        for seed in range(first, first + CHECK_SEEDS)
    ]


def lift_for_testing(scene: Scene) -> RunCheck | None:
    """Scene with a lift three times as high; None where not just one stage lifts."""
    from granular.protocol.prescribed import Lift

    lifts = [stage for stage in scene.protocol if isinstance(stage, Lift)]
    if len(lifts) != 1:
        return None
    return RunCheck(
        "a lift three times as high", {f"protocol.{lifts[0].name}.by": LIFT_TIMES * lifts[0].by}
    )


def checked_records(
    run: Trajectory, checks: Sequence[RunCheck], executor: Executor | None, progress: bool
) -> list[PistonRecord | Failure]:
    """Return the records of further runs, or why there is none, in the order of the checks.

    They are run side by side, where `granular.sweep` runs cases or by an executor that is given.
    """
    from granular.studies.measures import piston_columns
    from granular.studies.sweep import sweep

    settings = run.settings()
    study = sweep(
        run.scene,
        cases=[check.changes for check in checks],
        measure=piston_columns,
        dt=settings["dt"],
        t_end=_forced_end(run),
        method=settings["method"],
        executor=executor,
        progress=progress,
        title="checks of step, seeds, lift and falls",
    )
    return [
        _record_of_check(check, outcome)
        for check, outcome in zip(checks, study.outcomes, strict=True)
    ]


def _record_of_check(check: RunCheck, outcome: Mapping[str, Any]) -> PistonRecord | Failure:
    if outcome["error"] is not None:
        return Failure(check.what, " ".join(outcome["error"].split()))
    try:
        return PistonRecord.from_columns(outcome["figures"])
    except RecordError as error:
        return Failure(check.what, str(error))


def _forced_end(run: Trajectory) -> float | None:
    """End of a run whose last stage has no end of its own."""
    height = 1.0 if run.scene.piston is None else run.scene.piston.height
    if run.scene.protocol[-1].total_duration(height) is not None:
        return None
    return float(run.dataset["time"].values[-1])


def first_fall(run: Trajectory, period: float) -> PistonRecord | None:
    """Fall with which a run begins; None where it begins otherwise."""
    from granular.protocol.free import Free

    scene = run.scene
    if scene.piston is None or scene.effects.gravity is None or not scene.protocol:
        return None
    first = scene.protocol[0]
    if not isinstance(first, Free):
        return None
    try:
        record = run.piston(first.name)
    except RecordError:
        return None
    start = float(record.time[0])
    record = record.between(start, min(float(record.time[-1]), start + PERIODS * period))
    rest = run.stage(first.name).height
    falls = record.height[0] - rest > _STILL * rest
    return record if falls and len(record) >= FEWEST else None


def fall_checks(run: Trajectory, fall: PistonRecord) -> list[RunCheck]:
    """Run the fall alone, from other heights that the grains fit under, and other starts."""
    scene = run.scene
    assert scene.piston is not None
    first = scene.protocol[0]
    rest, height = run.stage(first.name).height, scene.piston.height
    grid = scene.arrangement.height
    stage = {"kind": "free", "name": first.name, "duration": float(fall.time[-1] - fall.time[0])}
    alone = {"protocol": [stage], "output.record": first.name}
    drops = []
    for ratio in DROPS:
        other = rest + ratio * (height - rest)
        below = None if grid is None else other - (height - grid)
        changes = {**alone, "piston.height": other, "arrangement.height": below}
        drops.append(RunCheck(f"from {1e3 * other:.0f} mm", changes))
    seed = scene.arrangement.seed + 1
    drops += [
        RunCheck(f"start {k}", {**alone, "arrangement.seed": k})
        for k in range(seed, seed + CHECK_SEEDS)
    ]
    return [drop for drop in drops if _fits_scene(scene, drop)]


def _fits_scene(scene: Scene, check: RunCheck) -> bool:
    """Return true for a scene that can be changed so; a lower piston may leave no space."""
    try:
        scene.replace(**check.changes)
    except GranularError:
        return False
    return True


def score_run_falls(
    run: Trajectory,
    fall: PistonRecord,
    checks: Sequence[RunCheck],
    records: Sequence[PistonRecord | Failure],
) -> DropScores | Failure:
    """Laws judged on the falls that could be run."""
    unseen = {
        check.what: record
        for check, record in zip(checks, records, strict=True)
        if isinstance(record, PistonRecord)
    }
    try:
        return score_drops(
            fall, unseen, rest=run.stage(run.scene.protocol[0].name).height, scene=run.scene,
            starts=STARTS,
        )  # fmt: skip
    except InputError as cause:
        return Failure("other falls", str(cause))
