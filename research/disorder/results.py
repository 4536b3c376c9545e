"""Results of each question, with one row per bed and the command that made them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from granular.shared.files import ResultCache
from research.campaign import (
    RESULTS,
    Plain,
    command_date_and_versions,
    make_or_read_cached_rows,
    read_results,
    round_floats_in_plain_data,
    write_results,
)
from research.disorder.beds import all_beds
from research.disorder.cycles import SIZES, key_of_cycle_row, simulate_and_measure_cycle
from research.disorder.forces import KINDS, STARTS, key_of_force_row, simulate_and_measure_forces
from research.disorder.temperature import key_of_bed, simulate_and_measure_bed

Results = Mapping[str, Plain]
"""``made`` and ``rows`` by question."""

DIGITS = 5


class QuestionStudy(NamedTuple):
    """The beds of a question: cases, keys of their rows, and the function that makes a row."""

    cases: Sequence[Any]
    key: Callable[[Any], str]
    row: Callable[[Any], Plain]
    quick: int
    """Step through the cases in a quick run, which takes the first of each group of this size."""


STUDIES: Mapping[str, QuestionStudy] = {
    "temperature": QuestionStudy(all_beds(), key_of_bed, simulate_and_measure_bed, 25),
    "forces": QuestionStudy(
        [(kind, seed + 1) for kind in KINDS for seed in range(STARTS)],
        key_of_force_row,
        simulate_and_measure_forces,
        STARTS,
    ),
    "slip": QuestionStudy(
        [(count, seed + 1) for count, starts in SIZES.items() for seed in range(starts)],
        key_of_cycle_row,
        simulate_and_measure_cycle,
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
        rows = make_or_read_cached_rows(
            study.cases[:: study.quick if quick else 1],
            study.key,
            study.row,
            ResultCache(out / question),
            label=question,
            progress=progress,
        )
        command = f"python -m research.disorder {question} {'--quick' if quick else '--full'}"
        result[question] = {
            "made": command_date_and_versions(command),
            "rows": round_floats_in_plain_data(rows, DIGITS),
        }
    write_results({**read_results(out / RESULTS, results_from_plain, {}), **result}, out / RESULTS)
    return result


def results_from_plain(plain: Any) -> Results:
    """Return results from the data of a file."""
    return {name: {"made": item["made"], "rows": list(item["rows"])} for name, item in plain.items()}


def has_row_for_every_case(question: str, rows: Sequence[Plain]) -> bool:
    """Return True if there is a row for every case."""
    return len(rows) == len(STUDIES[question].cases)
