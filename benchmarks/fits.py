"""Time of a fit: without compiled code, in a later process, and again in the same process.

Each law is fitted to records of its motion with noise, in separate processes (``python -m benchmarks.fits``);
the first process starts with an empty cache of compiled code.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from benchmarks.process import finished

DURATION = 40.0
"""Duration of a record, in the law's time unit: about seven periods."""
NOISE = 0.01
"""Noise of a record, in its standard deviations."""


class Truth(NamedTuple):
    """True motion of a law: its parameters, and initial z, with zero velocity."""

    parameters: Mapping[str, float]
    start: float


TRUTHS = {
    "van-der-pol-like": Truth({"alpha": 0.17, "omega": 1.05, "g0": -1.0, "shift": 0.0, "scale": 1.0}, 1.0),
    "linear": Truth({"lam": 0.05, "omega": 1.05, "g0": -1.0}, 1.0),
    "duffing": Truth({"lam": 0.05, "k": 1.1025, "rest": 0.5, "beta": 0.8}, 2.0),
    "polynomial-spring": Truth({"lam": 0.05, "k1": 1.1, "rest": 0.5, "k2": -0.3, "k3": 0.3}, 2.5),
}


def fits(law: str, samples: int, rounds: int = 7) -> list[dict[str, Any]]:
    """Return the times [s] of the first fit, of the first one in a later process, and of further fits.

    Parameters
    ----------
    law : str
        One of `TRUTHS`.
    samples : int
        Number of samples of a record.
    rounds : int
        Number of further fits, each of another record.

    Returns
    -------
    list of one dict
        ``cold``, ``next process``, ``warm`` (the median) [s]; ``error``, the median over records of the
        maximum relative error of a parameter; ``converged``, the minimum fraction of random starts that
        converged to the fit.

    Raises
    ------
    ProcessError
        If a process fails.
    """
    with tempfile.TemporaryDirectory() as store:
        cold = _measured(law, samples, rounds, store)
        later = _measured(law, samples, 0, store)
    return [
        {
            "law": law,
            "samples": samples,
            "cold": cold["first"],
            "next process": later["first"],
            "warm": statistics.median(cold["warm"]),
            "error": cold["error"],
            "converged": cold["converged"],
        }
    ]


def _measured(law: str, samples: int, rounds: int, store: str) -> dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks.fits", law, str(samples), str(rounds)]
    result: dict[str, Any] = json.loads(finished(command, {"JAX_COMPILATION_CACHE_DIR": store}))
    return result


def measured_here(law: str, samples: int, rounds: int) -> dict[str, Any]:
    """Return the times [s] of the first and of further fits in this process, with their errors."""
    from granular.records.record import PistonRecord
    from reduced_models.fitting.fit import fit
    from reduced_models.laws.catalogue import law_named
    from reduced_models.laws.solution import solve_law

    truth, shape = TRUTHS[law], law_named(law)
    values = [truth.parameters[name] for name in shape.parameters]
    times = np.linspace(0.0, DURATION, samples)
    clean = solve_law(shape, times, truth.start, 0.0, values, 1.0).z
    seconds, errors, converged = [], [], []
    for seed in range(1 + rounds):
        noise = np.random.default_rng(seed).normal(0.0, NOISE * clean.std(), samples)
        record = PistonRecord(times, clean + noise)
        started = time.perf_counter()
        model = fit(record, law)
        seconds.append(time.perf_counter() - started)
        errors.append([model.parameters[name] / truth.parameters[name] - 1.0 for name in shape.parameters])
        converged.append(model.quality.converged / model.quality.starts)
    worst = float(np.abs(np.median(np.abs(errors), axis=0)).max())
    return {"first": seconds[0], "warm": seconds[1:], "error": worst, "converged": min(converged)}


if __name__ == "__main__":
    print(json.dumps(measured_here(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))))
