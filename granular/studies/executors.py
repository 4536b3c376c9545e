"""Computation of a case, and executors that compute cases on this machine or on a cluster."""

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
"""Interval [s] at which a process checks that its parent process still exists."""

_GROWTH_VARIABLE = "LOKY_MAX_MEMORY_LEAK_SIZE"
GROWTH = "2e9"
"""Growth of memory [bytes] at which loky replaces a process. Two compiled laws need more than loky's default,
3e8."""


class ExecutorLostError(GranularError):
    """Error of an executor that has been lost, with all its workers."""


class ProcessPool(Executor):
    """Executor whose processes persist from the first task on, so that each loads compiled code once."""

    def __init__(self, count: int | None = None) -> None:
        self.count = count or os.cpu_count() or 1
        self._pool: Any = None

    def submit(self, function: Callable[..., T], /, *arguments: Any, **keywords: Any) -> Future[T]:
        """Submit a task; the processes start with the first one."""
        if self._pool is not None:
            # If one process dies, the tasks of all processes are lost, and the next task starts new
            # processes.
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
        """Stop the processes."""
        if self._pool is not None:
            self._pool.shutdown(wait=wait, kill_workers=cancel_futures)
            self._pool = None


def exit_with_parent(parent: int) -> None:
    """Start a thread that ends this process within a second after its parent process has ended."""

    # A process whose parent has ended gets another parent process; Windows does not show this.
    def exit_when_parent_has_ended() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK_SECONDS)
        os._exit(1)  # regardless of other threads

    threading.Thread(target=exit_when_parent_has_ended, daemon=True, name="watch the parent").start()


@contextlib.contextmanager
def given_executor_or_new_processes(
    executor: Executor | None, count: int | None = None
) -> Iterator[Executor]:
    """Yield the given executor, or else a pool of processes that end with the block."""
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


def read_or_compute_case_outcome(
    case: Case, measure: Measure, directory: Path | None, keep_runs: bool, wait: bool = True
) -> CaseOutcome:
    """Compute the outcome of a case, or read the stored one."""
    try:
        if directory is None:
            return _run_case(case, measure, None)
        cache = OutcomeCache(directory)
        make_directory(cache.files.directory)
        with lock_file(cache.files.directory / f".{case.key}.lock", wait) as acquired:
            if not acquired:
                return CaseOutcome(error="another sweep computes it", cause=ELSEWHERE)
            outcome = cache.read(case.key, warn=False)  # the study has already reported damaged files
            if outcome is None:
                outcome = _run_case(case, measure, directory / "runs" / case.key if keep_runs else None)
                # The worker itself stores its result, so that it is not lost if the waiting command is
                # killed.
                with contextlib.suppress(StoreError):  # the study retries it
                    cache.store(case.key, outcome)
            return outcome
    except OF_THE_MACHINE as error:
        return CaseOutcome(error=f"{type(error).__name__}: {error}", cause=MACHINE)
    except Exception as error:
        return CaseOutcome(error=f"{type(error).__name__}: {error}", cause=PROGRAM)


def _run_case(case: Case, measure: Measure, out: Path | None) -> CaseOutcome:
    from granular.run.simulation import simulate

    try:
        with warnings.catch_warnings(record=True, action="always") as caught:
            run = simulate(
                case.scene, **case.settings, out=out, resume=out is not None, threads=1, progress=False
            )
            # NumPy scalars are converted to Python numbers, so that JSON keeps every bit.
            figures = {
                name: value.item() if hasattr(value, "item") else value
                for name, value in measure(run).items()
            }
    except (*OF_THE_MACHINE, MissingPackageError):
        raise
    except GranularError as error:
        return CaseOutcome(error=f"{type(error).__name__}: {error}")
    messages = [str(warning.message) for warning in caught if issubclass(warning.category, UserWarning)]
    return CaseOutcome(figures, warning="; ".join(dict.fromkeys(messages)) or None)


RETRIES = 2
"""Number of workers that may die during a case before Dask stops trying to compute it."""


def connect_to_cluster(dask: str | None, mpi: bool) -> contextlib.AbstractContextManager[Executor | None]:
    """Return a context manager that yields the executor of a Dask cluster or MPI processes, or None."""
    if dask is None:
        return _connect_to_mpi() if mpi else contextlib.nullcontext()
    if mpi:
        raise InputError("--dask and --mpi cannot be combined; use one of them")
    return _connect_to_dask(dask)


class DaskClusterExecutor(Executor):
    """Executor of a Dask cluster; its waiting tasks fail if the connection to the scheduler is lost."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, function: Callable[..., T], /, *arguments: Any, **keywords: Any) -> Future[T]:
        """Submit a task to the cluster."""
        # Wait for the scheduler to respond again, as long as the client retries.
        while self._client.status == "connecting":
            time.sleep(0.1)
        if self._client.status != "running":
            raise ExecutorLostError(
                "the Dask scheduler is gone; restart it, then run the same command again to continue"
            )
        remote = self._client.submit(function, *arguments, pure=False, retries=RETRIES, **keywords)
        local: Future[T] = Future()

        def cancel_remote(future: Future[T]) -> None:
            if future.cancelled() and self._client.status == "running":
                remote.cancel()

        local.add_done_callback(cancel_remote)
        remote.add_done_callback(lambda done: _copy_future_result(local, done))
        return local


def _copy_future_result(local: Future[Any], remote: Any) -> None:
    """Copy the result, error or cancellation of a remote task to a local future."""
    with contextlib.suppress(InvalidStateError):  # the task was cancelled
        try:
            local.set_result(remote.result())
        except (OSError, CancelledError, TimeoutError) as error:
            local.set_exception(BrokenExecutor(f"the scheduler was lost: {error}"))
        except InvalidStateError:
            raise
        except Exception as error:
            local.set_exception(error)


@contextlib.contextmanager
def _connect_to_dask(address: str) -> Iterator[Executor]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise InputError("--dask needs Dask; install it with: pip install 'granular-damper[dask]'") from None
    # The command itself reports lost cases.
    for name in ("distributed", "distributed.client", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler responds at {quote(address)} ({type(error).__name__}); check the address"
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
