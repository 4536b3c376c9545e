"""Rows of each question, one per bed, with the command that made them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from granular.shared.files import ResultCache
from research.campaign import RESULTS, Plain, cached_rows, made_now, read_results, rounded, write_results
from research.disorder.beds import all_beds
from research.disorder.cycles import SIZES, cycle_key, cycle_row
from research.disorder.forces import KINDS, STARTS, force_key, force_row
from research.disorder.temperature import bed_key, bed_row

Results = Mapping[str, Plain]
"""``made`` and ``rows`` by question."""

DIGITS = 5


class Study(NamedTuple):
    """The beds of a question: cases, keys of their rows, and the function that makes a row."""

    cases: Sequence[Any]
    key: Callable[[Any], str]
    row: Callable[[Any], Plain]
    quick: int
    """Step through the cases in a quick run, which takes the first of each group of this size."""


STUDIES: Mapping[str, Study] = {
    "temperature": Study(all_beds(), bed_key, bed_row, 25),
    "forces": Study(
        [(kind, seed + 1) for kind in KINDS for seed in range(STARTS)], force_key, force_row, STARTS
    ),
    "slip": Study(
        [(count, seed + 1) for count, starts in SIZES.items() for seed in range(starts)],
        cycle_key,
        cycle_row,
        16,
    ),
}


def run_studies(
    questions: Sequence[str], out: Path, *, quick: bool = False, progress: bool = True
) -> Results:
    """Return the results of each question; rows cached in ``out`` are reused, and all are written there.

    Raises
    ------
    StoreError
        If the directory cannot be written.
    """
    result: dict[str, Plain] = {}
    for question in questions:
        study = STUDIES[question]
        rows = cached_rows(
            study.cases[:: study.quick if quick else 1],
            study.key,
            study.row,
            ResultCache(out / question),
            label=question,
            progress=progress,
        )
        command = f"python -m research.disorder {question} {'--quick' if quick else '--full'}"
        result[question] = {"made": made_now(command), "rows": rounded(rows, DIGITS)}
    write_results({**read_results(out / RESULTS, from_plain, {}), **result}, out / RESULTS)
    return result


def from_plain(plain: Any) -> Results:
    """Return results from the data of a file."""
    return {name: {"made": item["made"], "rows": list(item["rows"])} for name, item in plain.items()}


def is_whole(question: str, rows: Sequence[Plain]) -> bool:
    """Return True if there is a row for every case."""
    return len(rows) == len(STUDIES[question].cases)
