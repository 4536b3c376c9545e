"""`compare_and_summarise`: run the selected cases, and write results and report."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from granular.shared.files import make_directory, write_json
from research.campaign import RESULTS, Plain, write_results
from research.published.both_causes import count_distances_within_intervals, distances_with_both_causes
from research.published.calculations import make_missing_calculations
from research.published.causes import compare_figures_with_and_without_changes
from research.published.collecting import (
    collect_results_of_all_series,
    mark_series_not_reproduced_as_stale,
    missing_starts,
    results_of_local_and_packaged_files,
    with_local_stale_marks,
)
from research.published.judging import count_entries_by_verdict, count_strong_comparisons, judge_all_entries
from research.published.plan import SeriesGroup, full_plan, quick_plan
from research.published.results import (
    PublishedResults,
    count_series_by_state,
    full_run_start_count,
    read_committed_results,
    read_results_or_empty,
)
from research.published.series_runs import delete_outcomes_and_reference, run_groups
from research.published.statements import all_statements, count_statements_by_outcome

Length = Literal["quick", "full", "check"]

COMMAND = "python -m research.published"


def compare_and_summarise(
    directory: str | Path | None = None,
    length: Length | None = None,
    *,
    workers: int | None = None,
    progress: bool = True,
) -> dict[str, Any]:
    """Compare de Paula's published values with the toolkit's own.

    Parameters
    ----------
    directory : str or Path, optional
        Directory that caches every finished case, so that an interrupted run can be resumed;
        ``results.json``, ``report.html`` and ``report.json`` are written there. Without it nothing is cached
        or written.
    length : "quick", "full", "check" or None
        Minutes or hours. "full" continues from the committed results, and runs cases that are missing or
        affected by changes of the code. "check" runs only the short references of all series, and shows stale
        results. None runs nothing, and shows results of a full run in ``directory`` and committed results for
        the rest.
    workers : int, optional
        Number of processes. Default: the number of processors.
    progress : bool
        Show the present run, and the remaining time, on standard error.

    Returns
    -------
    dict
        Data of ``report.json``: ``entries``, ``summary``, ``series``, ``statements``,
        ``comparisons`` and ``made``; those of a quick run also under ``quick``.

    Raises
    ------
    InputError
        If the directory cannot be written, or a results file cannot be read.
    """
    if directory is None:
        with tempfile.TemporaryDirectory() as index:
            shown = run_comparison(Path(index), length, workers=workers, progress=progress)
    else:
        shown = run_comparison(Path(directory), length, workers=workers, progress=progress)
    return shown.report or {}


class ResultsWithReport(NamedTuple):
    """Results, and the data of ``report.json``."""

    results: PublishedResults
    report: Plain | None = None


def run_comparison(
    folder: Path, length: Length | None = None, *, workers: int | None = None, progress: bool = True
) -> ResultsWithReport:
    """Run and write like `compare_and_summarise`, and also return the results."""
    make_directory(folder)
    quick: PublishedResults | None = None
    if length == "quick":
        make_missing_calculations(folder, full=False)
        run_groups(quick_plan(), folder, workers=workers, progress=progress)
        quick, shown = (
            collect_results_of_all_series(quick_plan(), folder, f"{COMMAND} --quick"),
            read_committed_results(),
        )
    elif length == "full":
        shown = _run_full_plan(folder, workers, progress)
    else:
        shown = _local_and_committed_results(folder)
        if length == "check":
            shown = mark_series_not_reproduced_as_stale(shown, full_plan(), _print_to_standard_error)
    if length != "quick":
        _write_results_with_entries(shown, folder)
    return ResultsWithReport(shown, _write_and_return_report(shown, quick, folder))


def _local_and_committed_results(folder: Path) -> PublishedResults:
    """Return a full run's results from a directory, and the committed results for the rest."""
    local = read_results_or_empty(folder / RESULTS)
    if not local.series and not (folder / "cases").exists():
        return read_committed_results()
    former = results_of_local_and_packaged_files(local, read_committed_results())
    return with_local_stale_marks(
        collect_results_of_all_series(full_plan(), folder, f"{COMMAND} --full", former), local
    )


def _run_full_plan(folder: Path, workers: int | None, progress: bool) -> PublishedResults:
    """Run missing series, and series that the present code no longer reproduces."""
    plan, command = full_plan(), f"{COMMAND} --full"
    local = read_results_or_empty(folder / RESULTS)
    former = results_of_local_and_packaged_files(local, read_committed_results())
    times = 1 + full_run_start_count(former)
    before = with_local_stale_marks(
        collect_results_of_all_series(plan, folder, command, former, times), local
    )
    known = mark_series_not_reproduced_as_stale(before, plan, _print_to_standard_error)
    stale = {key for key, item in known.series.items() if item.get("stale")}
    for series in (item for group in plan for item in group.series if item.key in stale):
        delete_outcomes_and_reference(series, folder)
    former = [known]
    make_missing_calculations(folder, full=True)

    def write_collected_results() -> None:
        _write_results_with_entries(collect_results_of_all_series(plan, folder, command, former), folder)

    write_collected_results()
    run_groups(
        _plan_of_missing_starts(plan, folder, former),
        folder,
        workers=workers,
        progress=progress,
        after=write_collected_results,
    )
    return collect_results_of_all_series(plan, folder, command, former)


def _plan_of_missing_starts(
    plan: Sequence[SeriesGroup], folder: Path, former: Sequence[PublishedResults]
) -> list[SeriesGroup]:
    """Return the plan with only the starts that were not run yet."""
    return [
        SeriesGroup(
            group.title,
            [
                series._replace(seeds=seeds)
                for series in group.series
                if (seeds := missing_starts(series, folder, former))
            ],
        )
        for group in plan
    ]


def _print_to_standard_error(words: str) -> None:
    print(words, file=sys.stderr, flush=True)


def _write_results_with_entries(results: PublishedResults, folder: Path) -> None:
    rows = [row.to_plain() for row in judge_all_entries(results)]
    write_results(results.to_plain() | {"entries": rows}, folder / RESULTS)


def _write_and_return_report(
    shown: PublishedResults, quick: PublishedResults | None, folder: Path
) -> dict[str, Any]:
    from research.published.page import report_page

    result = summarise_results(shown)
    if quick is not None:
        result["quick"] = summarise_results(quick)
    write_json(folder / "report.json", result)
    report_page(shown, quick).save(folder / "report.html")
    return result


def summarise_results(results: PublishedResults) -> dict[str, Any]:
    """Return entries with verdicts, statements and comparisons, as plain data."""
    rows = judge_all_entries(results)
    checks = [(item, item.check(results)) for item in all_statements()]
    return {
        "made": dict(results.made),
        "summary": count_entries_by_verdict(rows),
        "strength": count_strong_comparisons(rows),
        "series": count_series_by_state(results),
        "entries": [row.to_plain() for row in rows],
        "statements": [
            {
                "source": item.source,
                "words": item.words,
                "holds": None if check is None else check.holds,
                "figures": None if check is None else check.figures,
            }
            for item, check in checks
        ],
        "both_causes": count_distances_within_intervals(distances_with_both_causes(results)),
        "statement_counts": count_statements_by_outcome(results),
        "comparisons": [
            {
                "change": item.change,
                "bed": item.bed,
                "figure": item.figure,
                "unit": item.unit,
                "published": item.published,
                "without": item.without._asdict(),
                "with": item.with_it._asdict(),
                "matters": item.matters,
            }
            for item in compare_figures_with_and_without_changes(results)
        ],
    }


def entries_text(result: dict[str, Any]) -> str:
    """Return the entries as a table for the console, and the number of agreements."""
    from granular.shared.blocks import Table

    shown = result.get("quick", result)
    rows = [
        (
            item["what"],
            _number_with_unit(item["published"], item["unit"]),
            _number_with_unit(item["ours"], item["unit"]),
            item["protocol"] or "",
            item["verdict"],
        )
        for item in shown["entries"]
        if item["ours"] is not None or shown is result
    ]
    both = shown["summary"] | shown["strength"] | shown["both_causes"]
    numbers = ", ".join(f"{count} {name}" for name, count in both.items())
    series = ", ".join(f"{count} {name}" for name, count in shown["series"].items())
    shape = ("what", "published", "ours", "protocol", "verdict")
    return f"{Table(shape, rows)}\n{numbers}\nseries: {series}"


def _number_with_unit(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:.4g} {unit}".rstrip()
