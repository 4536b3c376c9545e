"""Cases of a scene on an executor, while the caller does other work."""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from typing import Any, Generic, NamedTuple, Self, TypeVar

from granular.scene.scene import Scene
from granular.shared.progress_bars import progress_bar
from granular.studies.cases import Case, CaseOutcome, Measure, make_cases
from granular.studies.executors import ProcessPool, compute_case
from granular.studies.sweep import compute_outcomes_with_retries, future_outcome

T = TypeVar("T")


class BackgroundCase(NamedTuple):
    """A case that was handed to an executor."""

    case: Case
    future: Future[CaseOutcome]


@dataclasses.dataclass(frozen=True)
class BackgroundCall(Generic[T]):
    """A call that was handed to a process; None: that its caller is to make."""

    future: Future[T] | None
    function: Callable[..., T]
    args: tuple[Any, ...]

    def result(self) -> T:
        """Wait for the call, or make it here if no process has begun it, or its process died."""
        if self.future is not None and not self.future.cancel():
            with contextlib.suppress(BrokenExecutor):
                return self.future.result()
        return self.function(*self.args)


class BackgroundCaseRunner:
    """Cases that are computed while the caller works; what nobody waits for is ended."""

    def __init__(self, measure: Measure, executor: Executor | None) -> None:
        self._measure, self._own = measure, executor is None
        # One processor stays for the caller, who works meanwhile.
        self._pool = executor or ProcessPool(max(1, (os.cpu_count() or 1) - 1))
        self._started: list[BackgroundCase] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._own:
            self._pool.shutdown(wait=False, cancel_futures=True)
            return
        for started in self._started:
            started.future.cancel()

    def submit_cases(
        self, scene: Scene, changes: Sequence[Mapping[str, Any]], settings: Mapping[str, Any]
    ) -> list[BackgroundCase]:
        """Hand cases to the executor, without waiting for them."""
        started = []
        for case in make_cases(scene, {}, changes, settings, self._measure) if changes else ():
            try:
                future = self._pool.submit(compute_case, case, self._measure, None, False, True)
            except BrokenExecutor as error:  # whoever waits tries again
                future = Future()
                future.set_exception(error)
            started.append(BackgroundCase(case, future))
        self._started += started
        return started

    def submit_call(self, function: Callable[..., T], *args: Any, here: bool = False) -> BackgroundCall[T]:
        """Hand a call to the processes of this machine; another executor is for runs alone."""
        future: Future[T] | None = None
        if self._own and not here:
            with contextlib.suppress(BrokenExecutor):  # whoever asks for the result computes it
                future = self._pool.submit(function, *args)
        return BackgroundCall(future, function, args)

    def wait_for_outcomes(
        self, started: Sequence[BackgroundCase], title: str, progress: bool
    ) -> list[CaseOutcome]:
        """Wait for cases, and compute the last ones; those whose process died are tried again."""
        waiting = {entry.future for entry in started}
        done = {future for future in waiting if future.done()}
        outcomes: dict[str, CaseOutcome] = {}
        with progress_bar(
            wanted=progress, total=len(started), initial=len(done), desc=title, unit="run"
        ) as bar:
            for entry in reversed(started):
                if self._own and entry.future.cancel():
                    outcomes[entry.case.key] = compute_case(entry.case, self._measure, None, False)
                    waiting.remove(entry.future)
                    bar.update()
            for _ in concurrent.futures.as_completed(waiting - done):
                bar.update()
        for entry in started:
            if entry.future in waiting and (outcome := future_outcome(entry.future)) is not None:
                outcomes[entry.case.key] = outcome
        lost = [entry.case for entry in started if entry.case.key not in outcomes]
        for case, outcome in compute_outcomes_with_retries(lost, self._measure, None, False, self._pool):
            outcomes[case.key] = outcome
        return [outcomes[entry.case.key] for entry in started]
