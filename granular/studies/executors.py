"""Executors that compute cases, on this machine or a cluster, and the work on one case."""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, InvalidStateError
from pathlib import Path
from typing import Any, TypeVar

from granular.shared.errors import GranularError, InputError, MissingPackageError, StoreError, quote
from granular.shared.files import lock_file, make_directory
from granular.studies.cases import ELSEWHERE, MACHINE, PROGRAM, Case, CaseOutcome, Measure, OutcomeCache

T = TypeVar("T")

LOOK_SECONDS = 1.0
"""Time between checks that the process that started this one still lives."""

_GROWTH_VARIABLE = "LOKY_MAX_MEMORY_LEAK_SIZE"
GROWTH = "2e9"
"""Memory [bytes] by which a process grows before loky starts another; two compiled laws pass its own 3e8."""


class ExecutorLostError(GranularError):
    """The executor is gone, with all its workers."""


class ProcessPool(Executor):
    """Processes that start with the first task and stay: each loads the compiled code once."""

    def __init__(self, count: int | None = None) -> None:
        self.count = count or os.cpu_count() or 1
        self._pool: Any = None

    def submit(self, function: Callable[..., T], /, *arguments: Any, **keywords: Any) -> Future[T]:
        """Submit a task to the processes, which start with the first one."""
        if self._pool is not None:
            # A process that dies takes the tasks of all others with it; the next task starts new ones.
            with contextlib.suppress(BrokenExecutor):
                future: Future[T] = self._pool.submit(function, *arguments, **keywords)
                return future
        from loky import ProcessPoolExecutor

        self._pool = ProcessPoolExecutor(
            max_workers=self.count,
            initializer=exit_with_parent,
            initargs=(os.getpid(),),
            env={_GROWTH_VARIABLE: os.environ.get(_GROWTH_VARIABLE, GROWTH)},
        )
        first: Future[T] = self._pool.submit(function, *arguments, **keywords)
        return first

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(wait=wait, kill_workers=cancel_futures)
            self._pool = None


def exit_with_parent(parent: int) -> None:
    """Start a thread that ends this process within a second after its parent."""

    # A process that loses its parent belongs to another one from then on; Windows does not show it.
    def look() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK_SECONDS)
        os._exit(1)  # whatever the other threads do

    threading.Thread(target=look, daemon=True, name="look for the parent").start()


@contextlib.contextmanager
def case_executor(executor: Executor | None, count: int | None = None) -> Iterator[Executor]:
    """Give an executor for cases: one that is given, or processes that end with the block."""
    if executor is not None:
        yield executor
        return
    workers = ProcessPool(count)
    try:
        yield workers
    except BaseException:
        workers.shutdown(wait=False, cancel_futures=True)
        raise
    workers.shutdown()


OF_THE_MACHINE = (OSError, StoreError, MemoryError)


def compute_case(
    case: Case, measure: Measure, directory: Path | None, keep_runs: bool, wait: bool = True
) -> CaseOutcome:
    """Compute the outcome of a case, or read the one that was computed before."""
    try:
        if directory is None:
            return _run_case(case, measure, None)
        cache = OutcomeCache(directory)
        make_directory(cache.files.directory)
        with lock_file(cache.files.directory / f".{case.key}.lock", wait) as alone:
            if not alone:
                return CaseOutcome(error="another sweep computes it", cause=ELSEWHERE)
            done = cache.read(case.key, warn=False)  # the study has said what is damaged
            if done is None:
                done = _run_case(case, measure, directory / "runs" / case.key if keep_runs else None)
                # A worker writes its result itself: it is not lost with the command that waits for it.
                with contextlib.suppress(StoreError):  # the study tries it again
                    cache.keep(case.key, done)
            return done
    except OF_THE_MACHINE as error:
        return CaseOutcome(error=f"{type(error).__name__}: {error}", cause=MACHINE)
    except Exception as error:
        return CaseOutcome(error=f"{type(error).__name__}: {error}", cause=PROGRAM)


def _run_case(case: Case, measure: Measure, out: Path | None) -> CaseOutcome:
    from granular.run.simulation import simulate

    try:
        with warnings.catch_warnings(record=True, action="always") as raised:
            run = simulate(
                case.scene, **case.settings, out=out, resume=out is not None, threads=1, progress=False
            )
            # NumPy's scalars as Python's own, so that JSON keeps every bit.
            figures = {
                name: value.item() if hasattr(value, "item") else value
                for name, value in measure(run).items()
            }
    except (*OF_THE_MACHINE, MissingPackageError):
        raise
    except GranularError as error:
        return CaseOutcome(error=f"{type(error).__name__}: {error}")
    doubts = [str(warning.message) for warning in raised if issubclass(warning.category, UserWarning)]
    return CaseOutcome(figures, warning="; ".join(dict.fromkeys(doubts)) or None)


RETRIES = 2
"""Workers that Dask lets a case lose before it calls it lost."""


def cluster_executor(dask: str | None, mpi: bool) -> contextlib.AbstractContextManager[Executor | None]:
    """Connect to a Dask cluster, or to the processes of MPI."""
    if dask is None:
        return _connect_to_mpi() if mpi else contextlib.nullcontext()
    if mpi:
        raise InputError("--dask and --mpi name two executors; give one of them")
    return _connect_to_dask(dask)


class DaskClusterExecutor(Executor):
    """A Dask cluster whose scheduler may go away: no task then waits for ever."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, function: Callable[..., T], /, *arguments: Any, **keywords: Any) -> Future[T]:
        """Submit a task to the cluster."""
        # The next task waits until the scheduler answers again, for as long as the client tries.
        while self._client.status == "connecting":
            time.sleep(0.1)
        if self._client.status != "running":
            raise ExecutorLostError(
                "the Dask scheduler is gone; start it again, and the same command goes on"
            )
        there = self._client.submit(function, *arguments, pure=False, retries=RETRIES, **keywords)
        here: Future[T] = Future()

        def take_back(future: Future[T]) -> None:
            if future.cancelled() and self._client.status == "running":
                there.cancel()

        here.add_done_callback(take_back)
        there.add_done_callback(lambda done: _pass_on_result(here, done))
        return here


def _pass_on_result(here: Future[Any], there: Any) -> None:
    """Pass on what has become of a task."""
    with contextlib.suppress(InvalidStateError):  # of one that was taken back
        try:
            here.set_result(there.result())
        except (OSError, CancelledError, TimeoutError) as error:
            here.set_exception(BrokenExecutor(f"the scheduler was lost: {error}"))
        except InvalidStateError:
            raise
        except Exception as error:
            here.set_exception(error)


@contextlib.contextmanager
def _connect_to_dask(address: str) -> Iterator[Executor]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise InputError("--dask needs Dask; install it with: pip install 'granular-damper[dask]'") from None
    # The command says itself what is lost.
    for name in ("distributed", "distributed.client", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler answers at {quote(address)} ({type(error).__name__}); check the address"
        ) from None
    with client:
        yield DaskClusterExecutor(client)


@contextlib.contextmanager
def _connect_to_mpi() -> Iterator[Executor]:
    try:
        from mpi4py.futures import MPIPoolExecutor
    except ImportError:
        raise InputError(
            "--mpi needs mpi4py; install it, and start: mpirun python -m mpi4py.futures -m granular sweep ..."
        ) from None
    with MPIPoolExecutor() as pool:
        yield pool
