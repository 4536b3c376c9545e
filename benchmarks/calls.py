"""Functions of this project that a fit or an identification calls: ``python -m benchmarks.calls fit``."""

from __future__ import annotations

import inspect
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np

ROOT = Path(__file__).parents[1]
ROOMS = tuple(f"{ROOT / name}/" for name in ("granular", "reduced_models", "validation"))


class Calls(NamedTuple):
    """Different functions that were called, the files that hold them, and modules that were imported."""

    functions: int
    files: int
    modules: int
    has_numba: bool


def count_calls(task: Callable[[], Any]) -> Calls:
    """Count the functions of this project that a task calls, in all threads, without lambdas and classes."""
    seen: set[tuple[str, int]] = set()

    def look(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        is_function = code.co_flags & inspect.CO_OPTIMIZED and not code.co_name.startswith("<")
        if event == "call" and is_function and code.co_filename.startswith(ROOMS):
            seen.add((code.co_filename, code.co_firstlineno))

    threading.setprofile(look)
    sys.setprofile(look)
    try:
        task()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    modules = [name for name in sys.modules if name.startswith(("granular", "reduced_models", "validation"))]
    return Calls(len(seen), len({name for name, _ in seen}), len(modules), "numba" in sys.modules)


def laboratory_record() -> Path:
    """Write a decaying motion with noise, as a laboratory has it, and return its file."""
    time = np.linspace(0.0, 4.0, 2000)
    random = np.random.default_rng(0)
    height = 60.0 + np.exp(-0.8 * time) * np.cos(21.8 * time) + 2e-3 * random.normal(size=2000)
    path = Path(tempfile.mkdtemp()) / "lab.csv"
    np.savetxt(
        path, np.column_stack([time, height]), delimiter=",", header="time [s],height [mm]", comments=""
    )
    return path


def main(what: str) -> None:
    """Print what one task calls; each needs a process of its own, for what it imports."""
    warnings.simplefilter("ignore")
    path = laboratory_record()

    def task() -> Any:
        if what == "fit":
            from reduced_models import fit

            return fit(path, "linear")
        from reduced_models import identify

        return identify(path, path.parent / "out", progress=False)

    calls = count_calls(task)
    print(
        f"{what}: {calls.functions} functions in {calls.files} files; {calls.modules} modules of ours"
        f"{', numba among the others' if calls.has_numba else ''}"
    )


if __name__ == "__main__":
    for name in sys.argv[1:] or ("fit",):
        main(name)
