"""Count of project functions called by a fit or an identification: ``python -m benchmarks.calls fit``.

The tasks are ``fit`` and ``identify`` of a laboratory record, and ``damper``, the main job. A source (scene,
run or record) passes a file if a called function of the file gets it as an argument.
"""

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
SOURCES = {"Scene", "Trajectory", "PistonRecord"}


class Calls(NamedTuple):
    """Numbers of called functions, of their files, of files passed by a source, and of imported modules."""

    functions: int
    files: int
    files_of_source: int
    modules: int
    has_numba: bool


def count_calls(task: Callable[[], Any]) -> Calls:
    """Count the project functions called by a task, in all threads, without lambdas and classes."""
    seen: set[tuple[str, int]] = set()
    passed: set[str] = set()

    def look(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        is_function = code.co_flags & inspect.CO_OPTIMIZED and not code.co_name.startswith("<")
        if event == "call" and is_function and code.co_filename.startswith(ROOMS):
            seen.add((code.co_filename, code.co_firstlineno))
            if code.co_filename not in passed:
                given = list(frame.f_locals.values())[: code.co_argcount + code.co_kwonlyargcount]
                if any(type(value).__name__ in SOURCES for value in given):
                    passed.add(code.co_filename)

    threading.setprofile(look)
    sys.setprofile(look)
    try:
        task()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    modules = [name for name in sys.modules if name.startswith(("granular", "reduced_models", "validation"))]
    files = len({name for name, _ in seen})
    return Calls(len(seen), files, len(passed), len(modules), "numba" in sys.modules)


def laboratory_record() -> Path:
    """Write a decaying motion with noise, like a laboratory record, and return its file."""
    time = np.linspace(0.0, 4.0, 2000)
    random = np.random.default_rng(0)
    height = 60.0 + np.exp(-0.8 * time) * np.cos(21.8 * time) + 2e-3 * random.normal(size=2000)
    path = Path(tempfile.mkdtemp()) / "lab.csv"
    np.savetxt(
        path, np.column_stack([time, height]), delimiter=",", header="time [s],height [mm]", comments=""
    )
    return path


def main(what: str) -> None:
    """Print the counts of one task; each task needs a separate process to count its imports."""
    warnings.simplefilter("ignore")
    path = laboratory_record()

    def task() -> Any:
        if what == "fit":
            from reduced_models import fit

            return fit(path, "linear")
        from reduced_models import identify

        source = "damper" if what == "damper" else path
        return identify(source, path.parent / "out", progress=False)

    calls = count_calls(task)
    print(
        f"{what}: {calls.functions} functions in {calls.files} files, of which a source passes "
        f"{calls.files_of_source}; {calls.modules} modules of ours"
        f"{', numba among the others' if calls.has_numba else ''}"
    )


if __name__ == "__main__":
    for name in sys.argv[1:] or ("fit",):
        main(name)
