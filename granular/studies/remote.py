"""Executors on other machines."""

from __future__ import annotations

import contextlib
import importlib
import logging
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, InvalidStateError
from typing import Any, TypeVar

from granular.shared.errors import InputError
from granular.shared.messages import quoted
from granular.studies.workers import ExecutorLostError

T = TypeVar("T")

RETRIES = 2
"""Workers that Dask lets a case lose before it calls it lost."""


@contextlib.contextmanager
def executor(dask: str | None, mpi: bool) -> Iterator[Executor | None]:
    """The executor of a Dask cluster or of MPI's ranks; None where neither is asked for.

    Raises
    ------
    InputError
        If both are asked for, a library is missing, or the cluster does not answer.
    """
    if dask is not None and mpi:
        raise InputError("--dask and --mpi name two executors; give one of them")
    if dask is not None:
        with _dask(dask) as pool:
            yield pool
    elif mpi:
        with _mpi() as pool:
            yield pool
    else:
        yield None


class Cluster(Executor):
    """A Dask cluster whose scheduler may go away: no task then waits for ever.

    Tasks that were under way end in `BrokenExecutor`. The next one that is submitted waits until
    the scheduler answers again, and for as long as the client tries.

    Parameters
    ----------
    client : distributed.Client
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, function: Callable[..., T], /, *arguments: Any, **keywords: Any) -> Future[T]:
        """As of any executor.

        Raises
        ------
        ExecutorLostError
            If the scheduler is gone.
        """
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
        there.add_done_callback(lambda done: _settle(here, done))
        return here


def _settle(here: Future[Any], there: Any) -> None:
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
def _dask(address: str) -> Iterator[Executor]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise InputError(
            "--dask needs Dask; install it with: pip install 'granular-damper[dask]'"
        ) from None
    for name in (
        "distributed",
        "distributed.client",
        "tornado",
        "asyncio",
    ):  # the command says itself what is lost
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler answers at {quoted(address)} ({type(error).__name__}); check the "
            "address"
        ) from None
    with client:
        yield Cluster(client)


@contextlib.contextmanager
def _mpi() -> Iterator[Executor]:
    try:
        from mpi4py.futures import MPIPoolExecutor
    except ImportError:
        raise InputError(
            "--mpi needs mpi4py; install it and start with: mpirun -n 4 python -m mpi4py.futures "
            "-m granular sweep ..."
        ) from None
    with MPIPoolExecutor() as pool:
        yield pool
