"""Further runs of a scene: what time step and random start do to a figure, and another lift."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from typing import TYPE_CHECKING, Any, NamedTuple

from granular.run.record import PistonRecord
from granular.shared.errors import RecordError

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene

CHECK_SEEDS = 2
"""Further random starts of the bed that are run to see the scatter."""
LIFT_TIMES = 3.0
"""Height of a lift that no law sees, over that of the scene: far enough that a law's shape counts.
"""
_RESOLVED = 1.0  # step times highest frequency up to which a method shows its order; half the limit


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


def step_check(run: Trajectory) -> StepCheck:
    """The scene of a run with twice its time step, or half of it where twice is too coarse.

    A method of order p is off by 1/(2^p - 1) of what twice the step changes; all of the change is
    taken for the error, which it bounds also where a bed that packs otherwise follows no order.
    Half the step changes 1 - 2^-p of the error.
    """
    from granular.run.allowed import is_allowed
    from granular.run.time_step import doubled, halved

    settings = run.settings()
    dt = settings["dt"]
    coarser = 2.0 * settings["step_times_highest_frequency"]
    if coarser <= _RESOLVED and is_allowed(run.scene, doubled(dt), run.method):
        return StepCheck(RunCheck("twice the time step", {"dt": doubled(dt)}), 1.0)
    power = 2.0**run.method.order
    return StepCheck(RunCheck("half the time step", {"dt": halved(dt)}), power / (power - 1.0))


def seed_checks(run: Trajectory) -> list[RunCheck]:
    """The scene of a run from other random starts, all else alike."""
    first = run.scene.arrangement.seed + 1
    return [
        RunCheck(f"random start {seed}", {"arrangement.seed": seed})
        for seed in range(first, first + CHECK_SEEDS)
    ]


def held_out_lift(scene: Scene) -> RunCheck | None:
    """The scene with a lift three times as high; None where not just one stage lifts."""
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
    """The records of further runs, or why there is none, in the order of the checks.

    They are run side by side, where `granular.sweep` runs cases or by an executor that is given.
    """
    from granular.studies.measures import piston_columns
    from granular.studies.sweep import sweep

    settings = run.settings()
    study = sweep(
        run.scene,
        cases=[one.changes for one in checks],
        measure=piston_columns,
        dt=settings["dt"],
        t_end=_forced_end(run),
        method=settings["method"],
        executor=executor,
        progress=progress,
        title="checks of step, seeds, lift and falls",
    )
    return [
        _record_of(check, outcome) for check, outcome in zip(checks, study.outcomes, strict=True)
    ]


def _record_of(check: RunCheck, outcome: Mapping[str, Any]) -> PistonRecord | Failure:
    if outcome["error"] is not None:
        return Failure(check.what, " ".join(outcome["error"].split()))
    try:
        return PistonRecord.from_columns(outcome["figures"])
    except RecordError as error:
        return Failure(check.what, str(error))


def _forced_end(run: Trajectory) -> float | None:
    """End of a run whose last stage has no end of its own."""
    height = 1.0 if run.scene.piston is None else run.scene.piston.height
    if run.scene.protocol[-1].span(height) is not None:
        return None
    return float(run.dataset["time"].values[-1])
