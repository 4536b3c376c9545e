"""Processor time of fits without cached code, and JAX's part of it: ``python -m benchmarks.compilations``."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.jobs import JOBS, MAIN

ROOT = Path(__file__).parents[1]
DUFFING = """
import numpy as np
from reduced_models import PistonRecord, fit
from reduced_models.laws import LAWS
from reduced_models.laws.solution import solve_law
time = np.linspace(0.0, 500.0, 9000)
z = solve_law(LAWS["duffing"], time, 1e-3, 0.0, [2e-3, 4.0 * np.pi**2, 0.0, 2e6], 1e-3).z
noise = np.random.default_rng(0).normal(0.0, 1e-5, len(time))
model = fit(PistonRecord(time, z + noise), "z'' + 2*lam*z' + k*(z - rest) + beta*(z - rest)**3 = 0")
print(model.parameters)
"""
"""Fit of a law given as text to 500 periods."""
TASKS: dict[str, tuple[str, ...]] = {"duffing": ("-c", DUFFING), "identify": JOBS[MAIN]}
_STEPS = {
    "tracing": r"Finished tracing (\S+) for \S+ in ([\d.e-]+) sec",
    "lowering": r"Finished jaxpr to MLIR module conversion (\S+) in ([\d.e-]+) sec",
    "compiling": r"Finished XLA compilation of (\S+) in ([\d.e-]+) sec",
}


class Compilations(NamedTuple):
    """Processor time [s] of a task, and the programs compiled by JAX in all of its processes."""

    processor: float
    counts: dict[str, int]
    seconds: dict[str, float]
    longest: tuple[tuple[float, str], ...]  # programs with the longest compilation times


def count_compilations(words: Sequence[str]) -> Compilations:
    """Run Python with arguments, without cached code, and count programs traced, lowered, compiled by JAX."""
    with tempfile.TemporaryDirectory() as folder:
        store = {"NUMBA_CACHE_DIR": f"{folder}/numba", "JAX_COMPILATION_CACHE_DIR": f"{folder}/jax"}
        environment = os.environ | store | {"JAX_LOG_COMPILES": "1", "PYTHONPATH": str(ROOT)}
        before = os.times()
        done = subprocess.run(
            [sys.executable, *words], capture_output=True, text=True, check=True, cwd=folder, env=environment
        )
        after = os.times()
    processor = after.children_user + after.children_system - before.children_user - before.children_system
    steps = {
        name: [(float(seconds), label) for label, seconds in re.findall(pattern, done.stderr)]
        for name, pattern in _STEPS.items()
    }
    return Compilations(
        processor,
        {name: len(entries) for name, entries in steps.items()},
        {name: sum(seconds for seconds, _ in entries) for name, entries in steps.items()},
        tuple(sorted(steps["compiling"], reverse=True)[:8]),
    )


def main(names: Sequence[str]) -> None:
    """Print the figures of the given tasks."""
    for name in names:
        result = count_compilations(TASKS[name])
        print(f"{name}: {result.processor:.1f} s of processor")
        for step, count in result.counts.items():
            print(f"  {step} {count}, {result.seconds[step]:.1f} s")
        for seconds, label in result.longest:
            print(f"    {seconds:.2f} s {label}")


if __name__ == "__main__":
    main(sys.argv[1:] or tuple(TASKS))
