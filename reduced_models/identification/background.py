"""Further runs of a scene on an executor, while the caller does other work."""

from __future__ import annotations

import concurrent.futures
import contextlib
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from granular.run.record import PistonRecord
from granular.shared.errors import RecordError

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene
    from granular.studies.cases import Case

RECORD, FALL = "record", "fall"
"""Names of what `free_motions` gives."""


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


class Motions(NamedTuple):
    """Motions of the piston in a further run.

    Attributes
    ----------
    record : PistonRecord
        Record of the scene.
    fall : PistonRecord or None
        First stage of the protocol, where that is a free motion and another one than the record.
    """

    record: PistonRecord
    fall: PistonRecord | None


class RunningCheck(NamedTuple):
    """A further run that was handed to an executor."""

    check: RunCheck
    case: Case
    future: Future[dict[str, Any]]


class BackgroundRuns:
    """Further runs that go on while the caller works; what nobody waits for is ended.

    Parameters
    ----------
    executor : Executor, optional
        Where they are computed; processes on this machine, one fewer than it has processors, if not
        given.
    """

    def __init__(self, executor: Executor | None) -> None:
        self._given, self._pool = executor, executor
        self._started: list[RunningCheck] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._given is not None:
            for running in self._started:
                running.future.cancel()
        elif self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)

    @property
    def pool(self) -> Executor:
        """Executor, whose processes start with the first run."""
        if self._pool is None:
            from granular.studies.workers import Workers

            self._pool = Workers(max(1, (os.cpu_count() or 1) - 1))
        return self._pool

    def start(
        self, scene: Scene, checks: Sequence[RunCheck], settings: Mapping[str, Any]
    ) -> list[RunningCheck]:
        """Hand runs to the executor.

        Parameters
        ----------
        scene : Scene
        checks : sequence of RunCheck
        settings : mapping
            ``dt``, ``t_end`` and ``method`` of checks without their own.
        """
        if not checks:
            return []
        from granular.studies.cases import make_cases
        from granular.studies.workers import compute_case

        changes = [check.changes for check in checks]
        started = []
        for check, case in zip(
            checks, make_cases(scene, {}, changes, settings, free_motions), strict=True
        ):
            try:
                future = self.pool.submit(compute_case, case, free_motions, None, False, True)
            except BrokenExecutor as error:  # `finish` tries again
                future = Future()
                future.set_exception(error)
            started.append(RunningCheck(check, case, future))
        self._started += started
        return started

    def finish(self, running: Sequence[RunningCheck], progress: bool) -> list[Motions | Failure]:
        """Wait for runs; each one's motions, or why there are none.

        Runs whose process died are tried again, as `granular.sweep` does.
        """
        from granular.shared.progress import progress_bar
        from granular.studies.sweep import future_outcome, iterate_outcomes

        waiting = {entry.future for entry in running}
        done = {future for future in waiting if future.done()}
        with progress_bar(
            wanted=progress, total=len(running), initial=len(done), unit="run",
            desc="checks of step, random starts, lift and falls",
        ) as bar:  # fmt: skip
            for _ in concurrent.futures.as_completed(waiting - done):
                bar.update()
        outcomes = {
            entry.case.key: outcome
            for entry in running
            if (outcome := future_outcome(entry.future)) is not None
        }
        lost = [entry.case for entry in running if entry.case.key not in outcomes]
        for case, outcome in iterate_outcomes(lost, free_motions, None, False, self.pool):
            outcomes[case.key] = outcome
        return [_motions(entry.check, outcomes[entry.case.key]) for entry in running]


def free_motions(run: Trajectory) -> Mapping[str, Any]:
    """Piston's record of a run, and of its first stage where that is free, as columns."""
    from granular.protocol.free import Free

    motions = {RECORD: run.piston()}
    first = run.scene.protocol[0]
    if isinstance(first, Free) and first.name != run.scene.output.record:
        with contextlib.suppress(RecordError):
            motions[FALL] = run.piston(first.name)
    return {
        name: {column: values.tolist() for column, values in motion.columns.items()}
        for name, motion in motions.items()
    }


def _motions(check: RunCheck, outcome: Mapping[str, Any]) -> Motions | Failure:
    if outcome["error"] is not None:
        return Failure(check.what, " ".join(outcome["error"].split()))
    columns = outcome["figures"]
    try:
        fall = PistonRecord.from_columns(columns[FALL]) if FALL in columns else None
        return Motions(PistonRecord.from_columns(columns[RECORD]), fall)
    except RecordError as error:
        return Failure(check.what, str(error))
