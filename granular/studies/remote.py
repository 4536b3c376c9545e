"""Executors on other machines."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Iterator
from concurrent.futures import Executor
from typing import Any

from granular.shared.errors import InputError
from granular.shared.messages import quoted


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
        yield from _dask(dask)
    elif mpi:
        yield from _mpi()
    else:
        yield None


def _dask(address: str) -> Iterator[Executor]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise InputError(
            "--dask needs Dask; install it with: pip install 'granular-damper[dask]'"
        ) from None
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler answers at {quoted(address)} ({type(error).__name__}); check the "
            "address"
        ) from None
    with client:
        yield client.get_executor(retries=2)


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
