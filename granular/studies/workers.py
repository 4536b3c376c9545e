"""Processes of this machine that compute cases side by side."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from typing import Any, TypeVar

from granular.shared.errors import GranularError

T = TypeVar("T")

LOOK_SECONDS = 1.0
"""From look to look whether the process that has started this one still lives."""


class ExecutorLostError(GranularError):
    """Where cases are computed is gone, with all its workers."""


class Workers(Executor):
    """Processes that start with the first task and stay: each loads the compiled code once.

    The tasks of a process that dies end in `BrokenExecutor`, and so do all others that were waiting
    then; the next one that is submitted starts new processes. They end with the process that
    started them, also where that one is killed.

    Parameters
    ----------
    count : int, optional
        How many; as many as there are processors if not given.
    """

    def __init__(self, count: int | None = None) -> None:
        self.count = count or os.cpu_count() or 1
        self._pool: Any = None

    def submit(self, function: Callable[..., T], /, *arguments: Any, **keywords: Any) -> Future[T]:
        """As of any executor."""
        if self._pool is not None:
            with contextlib.suppress(BrokenExecutor):
                future: Future[T] = self._pool.submit(function, *arguments, **keywords)
                return future
        from loky import ProcessPoolExecutor

        self._pool = ProcessPoolExecutor(
            max_workers=self.count, initializer=end_with, initargs=(os.getpid(),)
        )
        first: Future[T] = self._pool.submit(function, *arguments, **keywords)
        return first

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let the processes end; with ``cancel_futures`` at once, whatever they do."""
        if self._pool is not None:
            self._pool.shutdown(wait=wait, kill_workers=cancel_futures)
            self._pool = None


def end_with(parent: int) -> None:
    """Let this process end soon after its parent, whose number this is.

    Who loses its parent belongs to another one from then on. Windows does not tell.
    """

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK_SECONDS)
        os._exit(1)  # whatever the other threads do

    threading.Thread(target=look, daemon=True, name="look for the parent").start()


@contextlib.contextmanager
def workshop(executor: Executor | None, count: int | None = None) -> Iterator[Executor]:
    """Where cases are computed: an executor that is given, or processes that end with the work.

    On Ctrl-C and errors they end at once. An executor that is given is left to who gave it.
    """
    if executor is not None:
        yield executor
        return
    workers = Workers(count)
    try:
        yield workers
    except BaseException:
        workers.shutdown(wait=False, cancel_futures=True)
        raise
    workers.shutdown()
