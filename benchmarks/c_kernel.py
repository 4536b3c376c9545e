"""C kernel for comparison with the pair sum, compiled if a compiler is available."""

from __future__ import annotations

import ctypes
import functools
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

_SOURCE = Path(__file__).with_name("pair_kernel.c")
_FLAGS = ("-O3", "-march=native", "-ffp-contract=off", "-shared", "-fPIC")


def missing() -> str | None:
    """Return the reason why the kernel cannot run here, or None."""
    import llvmlite.binding

    if shutil.which("gcc") is None:
        return "needs gcc"
    if not llvmlite.binding.get_host_cpu_features().get("avx512f"):
        return "needs a processor with AVX-512"
    return None


@functools.cache
def _library() -> ctypes.CDLL:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "pair_kernel.so"
        subprocess.run(["gcc", *_FLAGS, "-o", str(target), str(_SOURCE)], check=True)
        return ctypes.CDLL(str(target))


def pair_forces(x: np.ndarray, y: np.ndarray, fx: np.ndarray, fy: np.ndarray) -> Callable[[], None]:
    """Make a call of the C kernel on padded arrays; it overwrites the forces [F*]."""
    function = _library().pair_forces
    function.restype = None
    size = ctypes.c_long(x.size)
    pointers = [item.ctypes.data_as(ctypes.c_void_p) for item in (x, y, fx, fy)]
    return lambda: function(size, *pointers)
