"""`published`: run what is wanted, and write results and report."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any, Literal

from granular.shared.files import finite, make_directory, write_json, write_text
from validation.published.calculations import calculated
from validation.published.causes import comparisons
from validation.published.judging import counts, judged
from validation.published.plan import full_plan, quick_plan
from validation.published.results import EMPTY, Results, collected, committed
from validation.published.running import run_groups
from validation.published.statements import statements

Length = Literal["quick", "full"]

COMMAND = "python -m validation published"


def published(
    directory: str | Path | None = None,
    length: Length | None = None,
    *,
    workers: int | None = None,
    progress: bool = True,
) -> dict[str, Any]:
    """Compare the source's published values with the toolkit's own.

    Parameters
    ----------
    directory : str or Path, optional
        Keeps every case as soon as it is done, so that an interrupted run goes on where it was;
        ``results.json``, ``report.html`` and ``report.json`` are written there. Nothing is kept
        or written without one.
    length : "quick", "full" or None
        Minutes or hours; None runs nothing and shows what ``directory`` keeps of a full run, and
        the results that come with the package for the rest.
    workers : int, optional
        How many processes; as many as there are processors if not given.
    progress : bool
        Show what is run, and the time left, on standard error.

    Returns
    -------
    dict
        What ``report.json`` holds: ``entries``, ``summary``, ``statements``, ``comparisons`` and
        ``made``; of a quick run its own ones under ``quick`` too.

    Raises
    ------
    InputError
        If the directory cannot be written, or a results file cannot be read.
    """
    if directory is None:
        with tempfile.TemporaryDirectory() as place:
            return _published(Path(place), length, workers, progress)
    where = Path(directory)
    make_directory(where)
    return _published(where, length, workers, progress)


def _published(
    where: Path, length: Length | None, workers: int | None, progress: bool
) -> dict[str, Any]:
    if length == "quick":
        calculated(where, full=False)
        run_groups(quick_plan(), where, workers=workers, progress=progress)
        quick: Results | None = collected(quick_plan(), where, f"{COMMAND} --quick")
        shown = committed()
    else:
        if length == "full":
            calculated(where, full=True)
            run_groups(
                full_plan(), where, workers=workers, progress=progress,
                after=lambda: _write_results(_full(where), where),
            )  # fmt: skip
        quick, shown = None, _full(where).with_others(committed())
        _write_results(shown, where)
    return _write_report(shown, quick, where)


def _full(where: Path) -> Results:
    """What a directory keeps of a full run."""
    found = collected(full_plan(), where, f"{COMMAND} --full")
    return found if found.series else EMPTY


def _write_results(results: Results, where: Path) -> None:
    rows = [row.to_plain() for row in judged(results)]
    text = json.dumps(finite(results.to_plain() | {"entries": rows}), separators=(",", ":"))
    # One line a series and an entry, so that changes of the file can be read.
    text = text.replace('},"', '},\n"').replace('},{"', '},\n{"')
    write_text(where / "results.json", text + "\n")


def _write_report(shown: Results, quick: Results | None, where: Path) -> dict[str, Any]:
    from validation.published.page import page

    found = summary(shown)
    if quick is not None:
        found["quick"] = summary(quick)
    write_json(where / "report.json", found)
    page(shown, quick).save(where / "report.html")
    return found


def summary(results: Results) -> dict[str, Any]:
    """Entries with verdicts, statements and comparisons, as plain data."""
    rows = judged(results)
    return {
        "made": dict(results.made),
        "summary": counts(rows),
        "entries": [row.to_plain() for row in rows],
        "statements": [
            {"source": one.source, "words": one.words,
             "holds": None if check is None else check.holds,
             "figures": None if check is None else check.figures}
            for one in statements()
            for check in [one.test(results)]
        ],
        "comparisons": [
            {"change": one.change, "bed": one.bed, "figure": one.figure, "unit": one.unit,
             "without": one.without._asdict(), "with": one.with_it._asdict(),
             "matters": one.matters}
            for one in comparisons(results)
        ],
    }  # fmt: skip


def text(found: dict[str, Any]) -> str:
    """The entries as a table for the console, and how many agree."""
    from validation.table import table

    shown = found.get("quick", found)
    rows = [
        (one["what"], _number(one["published"], one["unit"]), _number(one["ours"], one["unit"]),
         one["protocol"] or "", one["verdict"])
        for one in shown["entries"]
        if one["ours"] is not None or shown is found
    ]  # fmt: skip
    numbers = ", ".join(f"{count} {name}" for name, count in shown["summary"].items())
    return f"{table(('what', 'published', 'ours', 'protocol', 'verdict'), rows).text()}\n{numbers}"


def _number(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:.4g} {unit}".rstrip()
