"""Whole jobs in separate processes, as started by users: wall time, processor time, and parts."""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.process import finished

PROGRAM = ("-c", "from validation.console_script import main; raise SystemExit(main())")

_COMPRESSION = """
from granular import mono_bed, simulate
simulate(mono_bed(92, speed=0.1), progress=False)
"""
_STUDY = """
from benchmarks.study import rest_height, small_damper
from granular import sweep
grid = {"piston.mass": [1.6, 1.7, 1.8, 1.9], "arrangement.seed": [1, 2, 3]}
sweep(small_damper(), grid=grid, measure=rest_height, progress=False)
"""

MAIN, AGAIN = "main job, nothing compiled", "main job"

JOBS: dict[str, tuple[str, ...]] = {
    MAIN: (*PROGRAM, "identify", "damper", "--quiet", "--json", "-o", "cold"),
    AGAIN: (*PROGRAM, "identify", "damper", "--quiet", "--json", "-o", "warm"),
    "design": (*PROGRAM, "design", "--frequency", "3.2", "--damping", "0.1", "--quiet"),
    "study of 12 dampers of 92 grains": ("-c", _STUDY),
    "compression of 92 grains": ("-c", _COMPRESSION),
    "examples of records": (*PROGRAM, "example", "-o", "lab", "--quiet"),
    "fit of a record": (*PROGRAM, "fit", "lab/lvdt.toml", "--law", "linear", "--quiet"),
}
"""Arguments of Python by the name of each job. Jobs run in sequence in one directory, with one cache,
initially empty; each but the first runs twice, and the second time counts."""


def job_times(names: Sequence[str] = tuple(JOBS)) -> list[dict[str, Any]]:
    """Return wall and processor time [s] of each job, and of its parts if it reports them.

    ``cores`` is the mean number of busy processors. Processor time includes child processes that were waited
    for.
    """
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            seconds, processor, said = _timed(JOBS[name], folder)
            if name != MAIN and "example" not in JOBS[name]:
                words = [word.replace("warm", "again") for word in JOBS[name]]
                seconds, processor, said = _timed(words, folder)
            rows.append(
                {
                    "job": name,
                    "seconds": seconds,
                    "processor": processor,
                    "cores": processor / seconds,
                    "parts": _parts(said),
                }
            )
    return rows


def _timed(words: Sequence[str], folder: str) -> tuple[float, float, str]:
    store = {
        "NUMBA_CACHE_DIR": f"{folder}/numba",
        "JAX_COMPILATION_CACHE_DIR": f"{folder}/jax",
        "PYTHONPATH": str(Path(__file__).parents[1]),
    }
    started, before = time.perf_counter(), _processor_of_children()
    said = finished([sys.executable, *words], store, Path(folder))
    return time.perf_counter() - started, _processor_of_children() - before, said


def _processor_of_children() -> float:
    """Return the processor time of finished child processes [s]."""
    used = os.times()
    return used.children_user + used.children_system


def _parts(said: str) -> dict[str, float]:
    """Return the wall time of a job's parts [s], from its output."""
    try:
        result = json.loads(said)
    except ValueError:
        return {}
    return dict(result.get("seconds", {})) if isinstance(result, dict) else {}
