"""Rows of each question, a row a bed, beside how they were made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from granular.shared.files import ResultCache
from research.campaign import RESULTS, Plain, kept_rows, made_now, read_results, rounded, write_results
from research.disorder.beds import all_beds
from research.disorder.cycles import SIZES, cycle_key, cycle_row
from research.disorder.forces import KINDS, STARTS, force_key, force_row
from research.disorder.temperature import bed_key, bed_row

Results = Mapping[str, Plain]
"""``made`` and ``rows`` by question."""

DIGITS = 5


class Study(NamedTuple):
    """The beds of a question: cases, the names that rows are kept under, and what makes a row."""

    cases: Sequence[Any]
    key: Callable[[Any], str]
    row: Callable[[Any], Plain]
    quick: int
    """Of so many cases a quick run takes the first each."""


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
    """Results of each question; rows that ``out`` keeps are found again, and all are written there.

    Raises
    ------
    StoreError
        If the directory cannot be written.
    """
    result: dict[str, Plain] = {}
    for question in questions:
        study = STUDIES[question]
        rows = kept_rows(
            study.cases[:: study.quick if quick else 1],
            study.key,
            study.row,
            ResultCache(out / question),
            what=question,
            progress=progress,
        )
        command = f"python -m research.disorder {question} {'--quick' if quick else '--full'}"
        result[question] = {"made": made_now(command), "rows": rounded(rows, DIGITS)}
    write_results({**read_results(out / RESULTS, from_plain, {}), **result}, out / RESULTS)
    return result


def from_plain(plain: Any) -> Results:
    """Results from what a file holds."""
    return {name: {"made": item["made"], "rows": list(item["rows"])} for name, item in plain.items()}


def is_whole(question: str, rows: Sequence[Plain]) -> bool:
    """Whether there is a row of every case."""
    return len(rows) == len(STUDIES[question].cases)
