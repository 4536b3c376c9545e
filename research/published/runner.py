"""`published`: run the selected cases, and write results and report."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from granular.shared.files import make_directory, write_json
from research.campaign import RESULTS, Plain, write_results
from research.published.both_causes import summary_of_both, with_both_causes
from research.published.calculations import calculated
from research.published.causes import comparisons
from research.published.collecting import checked, collected, earlier_results, missing, with_local_stale_marks
from research.published.judging import counts, judged, strength
from research.published.plan import Group, full_plan, quick_plan
from research.published.results import Results, committed, counted, read, sittings_of
from research.published.series_runs import forget, run_groups
from research.published.statements import counted_statements, statements

Length = Literal["quick", "full", "check"]

COMMAND = "python -m research.published"


def published(
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
            shown = compare(Path(index), length, workers=workers, progress=progress)
    else:
        shown = compare(Path(directory), length, workers=workers, progress=progress)
    return shown.report or {}


class Shown(NamedTuple):
    """Results, and the data of ``report.json``."""

    results: Results
    report: Plain | None = None


def compare(
    folder: Path, length: Length | None = None, *, workers: int | None = None, progress: bool = True
) -> Shown:
    """Run and write like `published`, and also return the results."""
    make_directory(folder)
    quick: Results | None = None
    if length == "quick":
        calculated(folder, full=False)
        run_groups(quick_plan(), folder, workers=workers, progress=progress)
        quick, shown = collected(quick_plan(), folder, f"{COMMAND} --quick"), committed()
    elif length == "full":
        shown = _full(folder, workers, progress)
    else:
        shown = _kept(folder)
        if length == "check":
            shown = checked(shown, full_plan(), _say)
    if length != "quick":
        _write_results(shown, folder)
    return Shown(shown, _write_report(shown, quick, folder))


def _kept(folder: Path) -> Results:
    """Return a full run's results from a directory, and the committed results for the rest."""
    local = read(folder / RESULTS)
    if not local.series and not (folder / "cases").exists():
        return committed()
    former = earlier_results(local, committed())
    return with_local_stale_marks(collected(full_plan(), folder, f"{COMMAND} --full", former), local)


def _full(folder: Path, workers: int | None, progress: bool) -> Results:
    """Run missing series, and series that the present code no longer reproduces."""
    plan, command = full_plan(), f"{COMMAND} --full"
    local = read(folder / RESULTS)
    former = earlier_results(local, committed())
    times = 1 + sittings_of(former)
    before = with_local_stale_marks(collected(plan, folder, command, former, times), local)
    known = checked(before, plan, _say)
    stale = {key for key, item in known.series.items() if item.get("stale")}
    for series in (item for group in plan for item in group.series if item.key in stale):
        forget(series, folder)
    former = [known]
    calculated(folder, full=True)

    def write() -> None:
        _write_results(collected(plan, folder, command, former), folder)

    write()
    run_groups(_waiting(plan, folder, former), folder, workers=workers, progress=progress, after=write)
    return collected(plan, folder, command, former)


def _waiting(plan: Sequence[Group], folder: Path, former: Sequence[Results]) -> list[Group]:
    """Return the plan with only the starts that were not run yet."""
    return [
        Group(
            group.title,
            [
                series._replace(seeds=seeds)
                for series in group.series
                if (seeds := missing(series, folder, former))
            ],
        )
        for group in plan
    ]


def _say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)


def _write_results(results: Results, folder: Path) -> None:
    rows = [row.to_plain() for row in judged(results)]
    write_results(results.to_plain() | {"entries": rows}, folder / RESULTS)


def _write_report(shown: Results, quick: Results | None, folder: Path) -> dict[str, Any]:
    from research.published.page import page

    result = summary(shown)
    if quick is not None:
        result["quick"] = summary(quick)
    write_json(folder / "report.json", result)
    page(shown, quick).save(folder / "report.html")
    return result


def summary(results: Results) -> dict[str, Any]:
    """Return entries with verdicts, statements and comparisons, as plain data."""
    rows = judged(results)
    checks = [(item, item.check(results)) for item in statements()]
    return {
        "made": dict(results.made),
        "summary": counts(rows),
        "strength": strength(rows),
        "series": counted(results),
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
        "both_causes": summary_of_both(with_both_causes(results)),
        "statement_counts": counted_statements(results),
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
            for item in comparisons(results)
        ],
    }


def text(result: dict[str, Any]) -> str:
    """Return the entries as a table for the console, and the number of agreements."""
    from granular.shared.blocks import Table

    shown = result.get("quick", result)
    rows = [
        (
            item["what"],
            _number(item["published"], item["unit"]),
            _number(item["ours"], item["unit"]),
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


def _number(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:.4g} {unit}".rstrip()
