"""How often fits reach the true optimum of thirteen made systems, beside SciPy."""

from __future__ import annotations

import statistics
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granular.shared.files import write_json
from validation.recovery.peer import scipy_fit
from validation.recovery.systems import NOISES, SEEDS, SYSTEMS, clean_motion, made_record
from validation.table import table

REACHED = 1.05
"""A residual up to so many times the noise that was added is that of the true optimum."""
LOST = 1.5
"""Above so many times it, no search may say that all of its starts agree."""
_QUICK = (0.01,)
_PEER_STARTS = 3
_QUICK_PEER_STARTS = 1


def recovery(
    out: str | Path | None = None, *, full: bool = False, progress: bool = True
) -> dict[str, Any]:
    """Fit all systems; a row for each of them, and the totals.

    ``full`` takes four levels of noise and five seeds, otherwise one of each. SciPy's least squares
    fits the first seed of each level from the first three starts of the search, or from one; the
    best of them counts.
    """
    from granular.shared.progress import progress_bar

    noises, seeds = (NOISES, SEEDS) if full else (_QUICK, 1)
    cases = [
        (system, noise, seed)
        for system in range(len(SYSTEMS))
        for noise in noises
        for seed in range(seeds)
    ]
    peers = _PEER_STARTS if full else _QUICK_PEER_STARTS
    shown = progress_bar(iterable=cases, desc="recovery", wanted=progress, leave=False)
    fits = [_fitted(system, noise, seed, peers) for system, noise, seed in shown]
    rows = [_row(k, [one for one in fits if one["system"] == k]) for k in range(len(SYSTEMS))]
    reached = sum(one["ratio"] <= REACHED for one in fits)
    found = {
        "fits": len(fits),
        "reached": reached,
        "rate": reached / len(fits),
        "wrongly agreed": sum(one["ratio"] > LOST and one["agree"] == 1.0 for one in fits),
        "most misses of a system": max(row["fits"] - row["reached"] for row in rows),
        "rows": rows,
    }
    if out is not None:
        Path(out).mkdir(parents=True, exist_ok=True)
        write_json(Path(out) / "recovery.json", found)
    return found


def _fitted(system: int, noise: float, seed: int, peers: int) -> dict[str, Any]:
    from reduced_models.fitting.fitting import fit

    record = made_record(system, noise, seed)
    level = noise * float(clean_motion(system).height.std())
    begun = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is doubted is counted here
        model = fit(record, SYSTEMS[system].law)
    seconds = time.perf_counter() - begun
    found: dict[str, Any] = {
        "system": system,
        "ratio": model.quality.residual / level,
        "agree": model.quality.converged / model.quality.starts,
        "seconds": seconds,
    }
    if seed == 0:
        begun = time.perf_counter()
        best = scipy_fit(record, model.law, peers)
        found["peer"] = [each / level for each in best]
        found["peer seconds"] = (time.perf_counter() - begun) / peers
    return found


def _row(system: int, fits: Sequence[dict[str, Any]]) -> dict[str, Any]:
    peers = [one for one in fits if "peer" in one]
    ratios = np.concatenate([one["peer"] for one in peers])
    return {
        "system": SYSTEMS[system].name,
        "fits": len(fits),
        "reached": sum(one["ratio"] <= REACHED for one in fits),
        "worst": max(one["ratio"] for one in fits),
        "starts that agree": statistics.mean(one["agree"] for one in fits),
        "seconds": statistics.median(one["seconds"] for one in fits),
        "SciPy fits": len(peers),
        "SciPy reached": sum(min(one["peer"]) <= REACHED for one in peers),
        "SciPy starts that reach it": float((ratios <= REACHED).mean()),
        "SciPy seconds a start": statistics.median(one["peer seconds"] for one in peers),
    }


def recovery_text(found: dict[str, Any]) -> str:
    """The table, and the totals in words."""
    header = (
        "system", "reached", "worst residual/noise", "starts that agree", "s", "SciPy",
        "its starts", "s",
    )  # fmt: skip
    rows = [
        (
            row["system"], f"{row['reached']} of {row['fits']}", f"{row['worst']:.3f}",
            f"{100 * row['starts that agree']:.0f} %", f"{row['seconds']:.2f}",
            f"{row['SciPy reached']} of {row['SciPy fits']}",
            f"{100 * row['SciPy starts that reach it']:.0f} %",
            f"{row['SciPy seconds a start']:.2f}",
        )
        for row in found["rows"]
    ]  # fmt: skip
    return (
        f"{table(header, rows).text()}\n"
        f"{found['reached']} of {found['fits']} fits leave a residual within {REACHED} of the "
        f"noise; {found['wrongly agreed']} of the others say that all starts agree"
    )
