"""`repeat_entry_and_compare`: repeat one entry from scratch, and compare it with the results file."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from granular.shared.errors import InputError, unknown_word_message
from research.published.calculations import make_missing_calculations
from research.published.catalogue import all_entries
from research.published.collecting import collect_results_of_all_series
from research.published.entry import Entry
from research.published.judging import judge_entry, keys_of_series_behind_entry
from research.published.plan import SeriesGroup, full_plan
from research.published.results import PublishedResults, read_committed_results
from research.published.series_runs import run_groups

TIMED = ("seconds",)
"""Figures that differ from run to run (times)."""


def repeat_entry_and_compare(
    key: str, *, workers: int | None = None, progress: bool = True
) -> dict[str, Any]:
    """Repeat all series behind an entry, and compare every figure with the committed file.

    Parameters
    ----------
    key : str
        Key of the entry, such as ``"piston_force_direct_sum.mean[0]"``.
    workers : int, optional
        Number of processes. Default: the number of processors.
    progress : bool
        Show the present run, and the remaining time, on standard error.

    Returns
    -------
    dict
        ``key``, ``series``; ``ours`` and ``committed`` values; ``timed``, True if these are times, which
        differ from run to run; ``same``, True if every figure of every start except times, and the values
        unless timed, are equal to the last digit; ``differences``, figures that differ; ``lacking``, series
        that are incomplete in the file.

    Raises
    ------
    InputError
        If the entry is unknown.
    """
    known = {item.key: item for item in all_entries()}
    if key not in known:
        raise InputError(unknown_word_message(key, tuple(known), "entry"))
    entry, former = known[key], read_committed_results()
    names = keys_of_series_behind_entry(entry, former)
    chosen = [item for group in full_plan() for item in group.series if item.key in names]
    with tempfile.TemporaryDirectory() as index:
        directory = Path(index)
        groups = [SeriesGroup(key, chosen)] if chosen else []
        run_groups(groups, directory, workers=workers, progress=progress)
        if not chosen:
            make_missing_calculations(directory, full=True)
        result = collect_results_of_all_series(
            groups, directory, f"python -m research.published --only {key}"
        )
    ours, before = (judge_entry(entry, item).found for item in (result, former))
    differences = [
        f"{name}, {figure}, start {seed}: {new} and {old} in the file"
        for name in names
        for figure, values in result.series[name]["figures"].items()
        if figure not in TIMED
        for seed, new, old in zip(
            result.series[name]["done"], values, former.series[name]["figures"].get(figure, []), strict=False
        )
        if new != old
    ]
    timed = _depends_on_times(entry, result)
    equal = ours is not None and before is not None and (timed or ours.value == before.value)
    return {
        "key": key,
        "series": names,
        "ours": None if ours is None else ours.value,
        "committed": None if before is None else before.value,
        "timed": timed,
        "same": equal and not differences,
        "differences": differences,
        "lacking": [name for name in names if former.series[name]["done"] != result.series[name]["done"]],
    }


def comparison_text(result: dict[str, Any]) -> str:
    """Return the text for the console."""
    lines = [f"{result['key']}: {result['ours']} now, {result['committed']} in the file"]
    lines += [f"the file lacks starts of {name}" for name in result["lacking"]]
    lines += result["differences"]
    if result["timed"]:
        lines.append("timed: not comparable to the last digit")
    else:
        lines.append("same to the last digit" if result["same"] else "not the same")
    return "\n".join(lines)


def _depends_on_times(entry: Entry, results: PublishedResults) -> bool:
    """Return True if an entry's value is a time, or computed from times."""
    result = entry.measure(results)
    if result is None or result.protocol == "timed":
        return result is not None
    without = {
        key: {**item, "figures": {k: v for k, v in item["figures"].items() if k not in TIMED}}
        for key, item in results.series.items()
    }
    return entry.measure(PublishedResults(without, results.calculations, results.made)) is None
