"""The one way in which kernels are compiled: cached on disk, strict in arithmetic, without the GIL.

Numba's disk cache looks only at the file of the function that is called. A kernel here calls
functions of other files, so the stamp of the cache is a digest of every kernel file: editing any
of them compiles afresh, and nothing stale is ever run.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

__all__ = ["Array", "compiled"]

F = TypeVar("F", bound=Callable[..., Any])

_MARKS = (b"@compiled", b"@intrinsic", b"llvmlite")


@functools.cache
def kernel_digest() -> str:
    """Digest of the source of every file that holds compiled code."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        source = path.read_bytes()
        if any(mark in source for mark in _MARKS):
            digest.update(path.name.encode() + source)
    return digest.hexdigest()


def compiled(function: F | None = None, *, parallel: bool = False, inline: bool = False) -> Any:
    """Compile a kernel.

    Multiplications and additions may fuse; nothing else is reordered, so a result depends neither
    on the number of threads nor on what is recorded.

    Parameters
    ----------
    parallel : bool
        Run its ``prange`` loops on Numba's threads.
    inline : bool
        Put the code into every caller. A call that passes the whole state writes some 200 words;
        several of them in a step took 30 % of the time of 92 grains.
    """
    if function is None:
        return functools.partial(compiled, parallel=parallel, inline=inline)
    kernel = numba.njit(
        cache=True,
        error_model="numpy",
        nogil=True,
        fastmath={"contract"},
        parallel=parallel,
        forceinline=inline,
    )(function)
    cache_file = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if cache_file is not None:
        cache_file._source_stamp = kernel_digest()
    return kernel
