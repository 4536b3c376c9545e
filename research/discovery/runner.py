"""`discovery`: run the cases that are wanted, and write what they give."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from granular.shared.files import ResultCache
from research.campaign import RESULTS, kept_rows, made_now, read_results, write_results
from research.discovery.cases import NOISES, SEEDS, Case, all_cases, measured
from research.discovery.results import EMPTY, Results
from research.discovery.systems import system_named

COMMAND = "python -m research.discovery"
_QUICK = ("linear", "pendulum", "quadratic drag")


def discovery(
    out: str | Path | None = None,
    *,
    quick: bool = False,
    systems: Sequence[str] = (),
    noises: Sequence[float] = NOISES,
    seeds: int = SEEDS,
    anew: bool = False,
    progress: bool = True,
) -> Results:
    """How often `discover` and two peers find the laws of made systems.

    Parameters
    ----------
    out : str or Path, optional
        Keeps every case as soon as it is done, so that an interrupted run goes on where it was;
        ``results.json`` is written there.
    quick : bool
        Three systems, 1 % of noise, one seed.
    systems : sequence of str
        Their names; all if empty.
    noises : sequence of float
        Of those of `NOISES`.
    seeds : int
        How many, from 0 on.
    anew : bool
        Run also what is kept.
    progress : bool

    Returns
    -------
    Results
        Also of cases that earlier runs kept.

    Raises
    ------
    InputError
        If there is no such system.
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
        rows = kept_rows(cases, lambda case: case.key, _measured, cache, what="searches", progress=progress)
    finally:
        if out is not None and cache is not None:
            result = _kept(cache, read_results(Path(out) / RESULTS, Results.from_plain, EMPTY))
            write_results(result.to_plain(), Path(out) / RESULTS)
    if out is None:
        return Results(dict(zip(cases, rows, strict=True)), made_now(COMMAND))
    return result


def _measured(case: Case) -> dict[str, Any]:
    row = measured(case)
    _forget_compiled()
    return row


def _forget_compiled() -> None:
    """Drop what JAX compiled for a case: that of hundreds would take gigabytes."""
    jax = sys.modules.get("jax")
    if jax is not None:
        jax.clear_caches()


def _kept(cache: ResultCache, former: Results) -> Results:
    """All cases of a directory, also those of earlier runs."""
    rows = {case: row for case in all_cases() if (row := cache.read(case.key)) is not None}
    return Results({**former.rows, **rows}, made_now(COMMAND))
