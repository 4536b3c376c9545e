"""`run_discovery_study`: run the selected cases, and write their results."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from granular.shared.files import ResultCache
from research.campaign import (
    RESULTS,
    command_date_and_versions,
    make_or_read_cached_rows,
    read_results,
    write_results,
)
from research.discovery.cases import NOISES, SEEDS, DiscoveryCase, all_cases, run_case
from research.discovery.results import EMPTY, DiscoveryResults
from research.discovery.systems import system_named

COMMAND = "python -m research.discovery"
_QUICK = ("linear", "pendulum", "quadratic drag")


def run_discovery_study(
    out: str | Path | None = None,
    *,
    quick: bool = False,
    systems: Sequence[str] = (),
    noises: Sequence[float] = NOISES,
    seeds: int = SEEDS,
    anew: bool = False,
    progress: bool = True,
) -> DiscoveryResults:
    """Measure how often `discover` and two peers find the laws of synthetic systems.

    Parameters
    ----------
    out : str or Path, optional
        Directory that caches every finished case, so that an interrupted run can be resumed; ``results.json``
        is written there.
    quick : bool
        Whether only three systems are run, with 1 % of noise and one seed.
    systems : sequence of str
        Names of systems; all if empty.
    noises : sequence of float
        Noise levels from `NOISES`.
    seeds : int
        Number of seeds, from seed 0.
    anew : bool
        Whether cached cases are run again.
    progress : bool

    Returns
    -------
    Results
        Results, including cases cached by earlier runs.

    Raises
    ------
    InputError
        If a system is unknown.
    StoreError
        If the directory cannot be written.
    """
    for name in systems:
        system_named(name)
    if quick:
        systems, noises, seeds = systems or _QUICK, (0.01,), 1
    cases = all_cases(systems, noises, seeds)
    cache = None if out is None else ResultCache(Path(out) / "cases")
    if anew and cache is not None:
        for case in cases:
            cache.path(case.key).unlink(missing_ok=True)
    try:
        rows = make_or_read_cached_rows(
            cases,
            lambda case: case.key,
            _run_case_and_clear_jax_caches,
            cache,
            label="searches",
            progress=progress,
        )
    finally:
        if out is not None and cache is not None:
            result = _results_with_earlier_runs(
                cache, read_results(Path(out) / RESULTS, DiscoveryResults.from_plain, EMPTY)
            )
            write_results(result.to_plain(), Path(out) / RESULTS)
    if out is None:
        return DiscoveryResults(dict(zip(cases, rows, strict=True)), command_date_and_versions(COMMAND))
    return result


def _run_case_and_clear_jax_caches(case: DiscoveryCase) -> dict[str, Any]:
    row = run_case(case)
    _clear_jax_caches()
    return row


def _clear_jax_caches() -> None:
    """Drop the code compiled by JAX for a case, which for hundreds of cases would take gigabytes."""
    jax = sys.modules.get("jax")
    if jax is not None:
        jax.clear_caches()


def _results_with_earlier_runs(cache: ResultCache, former: DiscoveryResults) -> DiscoveryResults:
    """Return all cases of a directory, including earlier runs."""
    rows = {case: row for case in all_cases() if (row := cache.read(case.key)) is not None}
    return DiscoveryResults({**former.rows, **rows}, command_date_and_versions(COMMAND))
