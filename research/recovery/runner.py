"""Fraction of fits that reach the true optimum of thirteen synthetic systems, compared with SciPy."""

from __future__ import annotations

import hashlib
import statistics
import time
import warnings
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.files import ResultCache, digest
from research.campaign import RESULTS, command_date_and_versions, make_or_read_cached_rows, write_results
from research.recovery.peer import (
    RecoveryProblem,
    digest_of_problem,
    fit_with_scipy_from_each_start,
    make_problem,
)
from research.recovery.systems import (
    LOST,
    NOISES,
    REACHED,
    SEEDS,
    SYSTEMS,
    law_of_system,
    make_noisy_record,
    noiseless_motion,
)
from validation.report_tasks import KEY_LENGTH, machine_info

_QUICK = (0.01,)
_PEER_STARTS = 3
_QUICK_PEER_STARTS = 1


class RecoveryCase(NamedTuple):
    """A record of a system: the system's index in `SYSTEMS`, its noise, and the noise's seed."""

    system: int
    noise: float
    seed: int


def run_recovery_study(
    out: str | Path | None = None, *, full: bool = False, progress: bool = True
) -> dict[str, Any]:
    """Fit all systems, and return a row for each of them, and the totals.

    ``full`` takes four levels of noise and five seeds, otherwise one of each. SciPy's least squares
    fits the first seed of each level from the first three starts of the search, or from one; the best of them
    counts. Each fit is cached in ``out`` as soon as it is done, and reused until something that determines it
    changes. Times are processor times, which exclude other programs. ``results.json`` is also written there.
    """
    noises, seeds = (NOISES, SEEDS) if full else (_QUICK, 1)
    cases = [
        RecoveryCase(system, noise, seed)
        for system in range(len(SYSTEMS))
        for noise in noises
        for seed in range(seeds)
    ]
    starts = _PEER_STARTS if full else _QUICK_PEER_STARTS
    cache = None if out is None else ResultCache(Path(out) / "fits")
    fits = make_or_read_cached_rows(
        cases, _cache_key_of_toolkit_fit, _run_toolkit_fit, cache, label="fits", progress=progress
    )
    adjacent = [case for case in cases if not case.seed]
    peers = make_or_read_cached_rows(
        adjacent,
        partial(_cache_key_of_scipy_fits, starts=starts),
        partial(_run_scipy_fits, starts=starts),
        cache,
        label="SciPy",
        progress=progress,
    )
    rows = [
        _row_of_system(
            k,
            [fit for case, fit in zip(cases, fits, strict=True) if case.system == k],
            [peer for case, peer in zip(adjacent, peers, strict=True) if case.system == k],
        )
        for k in range(len(SYSTEMS))
    ]
    reached = sum(row["reached"] for row in rows)
    result: dict[str, Any] = {
        "fits": len(fits),
        "reached": reached,
        "rate": reached / len(fits),
        "wrongly agreed": sum(item["ratio"] > LOST and item["agree"] == 1.0 for item in fits),
        "most misses of a system": max(row["fits"] - row["reached"] for row in rows),
        "rows": rows,
    }
    result["made"] = command_date_and_versions(
        f"python -m research.recovery {'--full' if full else '--quick'}"
    )
    if out is not None:
        write_results(result, Path(out) / RESULTS)
    return result


def _cache_key_of_scipy_fits(case: RecoveryCase, starts: int) -> str:
    return f"scipy-{digest_of_problem(_problem_of_case(case, starts))}"


def _problem_of_case(case: RecoveryCase, starts: int) -> RecoveryProblem:
    return make_problem(make_noisy_record(*case), law_of_system(SYSTEMS[case.system]), starts)


def _run_scipy_fits(case: RecoveryCase, starts: int) -> dict[str, Any]:
    given = _problem_of_case(case, starts)
    begun = time.process_time()
    attempts = fit_with_scipy_from_each_start(given)
    return {
        "ratios": [item.residual / _noise_in_record(case, given.record) for item in attempts],
        "stopped": [item.calls for item in attempts if item.stopped],
        "seconds": (time.process_time() - begun) / starts,
    }


def _noise_in_record(case: RecoveryCase, record: PistonRecord) -> float:
    """Return the rms noise in a record [m]: the maximum residual of a fit of the true law."""
    return float(np.sqrt(((record.height - noiseless_motion(case.system).height) ** 2).mean()))


def _run_toolkit_fit(case: RecoveryCase) -> dict[str, Any]:
    from reduced_models.fitting.fit import fit

    record = make_noisy_record(*case)
    begun = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # doubtful results are counted here
        model = fit(record, SYSTEMS[case.system].law)
    return {
        "ratio": model.quality.residual / _noise_in_record(case, record),
        "agree": model.quality.converged / model.quality.starts,
        "seconds": time.process_time() - begun,
    }


def _cache_key_of_toolkit_fit(case: RecoveryCase) -> str:
    content = {
        "case": case,
        "system": SYSTEMS[case.system]._asdict(),
        "sources": _digest_of_sources(),
        "on": machine_info(),
    }
    return f"fit-{digest(content, KEY_LENGTH)}"


@cache
def _digest_of_sources() -> str:
    """Return a digest of all code that a fit may depend on."""
    import granular
    import reduced_models

    result = hashlib.sha256((Path(__file__).parent / "systems.py").read_bytes())
    for package in (granular, reduced_models):
        assert package.__file__ is not None
        for path in sorted(Path(package.__file__).parent.rglob("*.py")):
            result.update(path.read_bytes())
    return result.hexdigest()


def _row_of_system(
    system: int, fits: Sequence[dict[str, Any]], peers: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    ratios = np.concatenate([item["ratios"] for item in peers])
    return {
        "system": SYSTEMS[system].name,
        "fits": len(fits),
        "reached": sum(item["ratio"] <= REACHED for item in fits),
        "worst": max(item["ratio"] for item in fits),
        "starts that agree": statistics.mean(item["agree"] for item in fits),
        "seconds": statistics.median(item["seconds"] for item in fits),
        "SciPy fits": len(peers),
        "SciPy reached": sum(min(item["ratios"]) <= REACHED for item in peers),
        "SciPy starts": len(ratios),
        "SciPy starts that reach it": float((ratios <= REACHED).mean()),
        "SciPy starts stopped": sum(len(item["stopped"]) for item in peers),
        "SciPy calls when stopped": max((calls for item in peers for calls in item["stopped"]), default=0),
        "SciPy seconds a start": statistics.median(item["seconds"] for item in peers),
    }
