"""The report: one HTML file with everything in it, and its figures as JSON next to it."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from granular.shared.files import make_directory, write_json
from granular.shared.html_pages import HtmlPage
from validation.convergence_order import CONVERGENCE
from validation.cost.report_section import WORK_PRECISION
from validation.depaula_experiment import DEPAULA
from validation.energy_drift import ENERGY
from validation.hard_case_outcomes import STABILITY
from validation.overview import OVERVIEW, outcome_count_table
from validation.report_tasks import FAILED, Plain, Section, machine_info, run_tasks
from validation.text_tables import add_table_to_page

Results = Mapping[str, Sequence[Plain]]

SECTIONS = {
    section.name: section for section in (OVERVIEW, CONVERGENCE, DEPAULA, ENERGY, WORK_PRECISION, STABILITY)
}


def report(
    directory: str | Path | None,
    sections: Sequence[Section] = tuple(SECTIONS.values()),
    *,
    full: bool = False,
    progress: bool = True,
) -> dict[str, Any]:
    """Measure sections, and write ``report.html`` and ``report.json``."""
    where = None if directory is None else Path(directory)
    if where is not None:
        make_directory(where)
    results: dict[str, Sequence[Plain]] = {
        section.name: run_tasks(section.name, section.tasks(full), where, progress=progress)
        for section in sections
    }
    plain = summarise_verdicts(results) | {"full": full, "machine": machine_info(), "parts": results}
    if where is not None:
        report_page(results, full=full).save(where / "report.html")
        write_json(where / "report.json", plain)
    return plain


def report_page(results: Results, *, full: bool) -> HtmlPage:
    """Page of the report from the results of its sections."""
    read = {SECTIONS[name]: _read_results(name, section_entries) for name, section_entries in results.items()}
    verdicts = summarise_verdicts(results)
    wrong = [name for name, held in verdicts["held"].items() if not held]
    lead = f"Not all holds: {', '.join(wrong)}." if wrong else "All holds."
    shown = HtmlPage("Proof of the numbers", lead)
    if OVERVIEW in read:
        _add_section(shown, OVERVIEW, read[OVERVIEW], results)
        if STABILITY in read:
            shown.add_section("Hard cases at a glance")
            add_table_to_page(shown, outcome_count_table(read[STABILITY]))
    shown.add_section("What holds")
    words = {True: "yes", False: "NO"}
    shown.add_table(
        ("part", "holds", "what was found"),
        [(name, words[verdicts["held"][name]], verdict) for name, verdict in verdicts["verdicts"].items()],
    )
    below = {section: section_entries for section, section_entries in read.items() if section is not OVERVIEW}
    for section, section_entries in below.items():
        _add_section(shown, section, section_entries, results)
    if any(section.tables_at_end for section in below):
        shown.add_section("All measurements")
    for section, section_entries in below.items():
        if section.tables_at_end and section_entries:
            for title, table in section.tables(section_entries):
                shown.add_paragraph(title)
                add_table_to_page(shown, table)
    made = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    kind = "full" if full else "quick"
    shown.add_footer(
        f"Made on {made} ({kind}) with " + ", ".join(f"{k} {v}" for k, v in machine_info().items())
    )
    return shown


def _read_results(name: str, results: Sequence[Plain]) -> list[Any]:
    """Results that did not fail."""
    return [SECTIONS[name].parse_result(result) for result in results if FAILED not in result]


def _add_section(page: HtmlPage, section: Section, items: Sequence[Any], results: Results) -> None:
    """Section's texts and figures, its tables unless they stand behind, and what failed."""
    if section.title:
        page.add_section(section.title)
    if items:
        section.show(page, items)
    if items and not section.tables_at_end:
        for _, table in section.tables(items):
            add_table_to_page(page, table)
    for line in _failure_lines(results[section.name]):
        page.add_warning(line)


def _failure_lines(results: Sequence[Plain]) -> list[str]:
    return [f"{result['label']} failed: {result[FAILED]}" for result in results if FAILED in result]


def summarise_verdicts(results: Results) -> dict[str, Any]:
    """Verdicts of all sections, and if they hold."""
    verdicts, held = {}, {}
    for name, result in results.items():
        verdicts[name], right = SECTIONS[name].verdict(_read_results(name, result))
        failed = len(_failure_lines(result))
        if failed:
            verdicts[name] += f" ({failed} could not be measured)"
        held[name] = right and not failed
    return {"verdicts": verdicts, "held": held, "holds": all(held.values())}


def report_text(plain: Mapping[str, Any]) -> str:
    """Text of a report for the console: tables, failures and verdicts."""
    lines = [section_text(name, group) for name, group in plain["parts"].items()]
    return "\n".join([*lines, *(f"{name}: {verdict}" for name, verdict in plain["verdicts"].items())])


def section_text(name: str, results: Sequence[Plain]) -> str:
    """Text of a section for the console: its tables, and what failed."""
    tables = SECTIONS[name].tables(_read_results(name, results))
    texts = [f"{title}\n{table.text()}\n" for title, table in tables]
    return "\n".join([*texts, *_failure_lines(results)])
