"""Report page, with the most important figures first, then the differences, then all others."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from granular.shared.blocks import Block, Caution, Heading, Table, Text
from granular.shared.html_pages import Page
from research.campaign import Plain
from research.published import plots
from research.published.both_causes import (
    accelerated_cycle_table,
    both_causes_text,
    creep_table,
    creep_text,
    distances_with_both_causes,
)
from research.published.causes import (
    ChangedFigure,
    compare_figures_with_and_without_changes,
    hysteresis_verdict_text,
    large_bed_force_text,
)
from research.published.entry import AGREES, DIFFERS
from research.published.finding import Finding
from research.published.judging import JudgedEntry, judge_all_entries, verdict_counts_text
from research.published.results import (
    PublishedResults,
    count_series_by_state,
    is_complete,
    is_stopped,
    maximum_energy_residual,
)
from research.published.statements import all_statements, count_statements_by_outcome

TITLE = "Published results, reproduced"

FIRST = (
    "piston_force_direct_sum.mean[0]",
    "piston_force_direct_sum.mean[4]",
    "piston_force_direct_sum.mean[6]",
    "piston_force_verlet.percent_difference[4]",
    "half_mean_distance.minimum[3]",
    "hysteresis_of_distance.hysteresis[3]",
    "hysteresis_of_distance.hysteresis[7]",
    "bidisperse_r_half.least_piston_distance[1]",
    "biexponential_fmax.A[1]",
    "bidisperse_r_half.hexagon_regularity_end[1]",
)
"""The ten most important figures."""

SECTIONS = {
    "Force on the piston": ("piston_force_direct_sum", "piston_force_verlet", "mono_further", "algorithm"),
    "Mean distance": ("half_mean_distance", "hysteresis_of_distance"),
    "Independence of start and speed": ("independence_of_start", "velocity"),
    "Polygons": ("voronoi_shares_direct_sum", "voronoi_shares_verlet"),
    "Mixtures": (
        "bidisperse_r_half",
        "bidisperse_r_zero",
        "bidisperse_further",
        "bidisperse_all_r",
        "bidisperse_variants",
        "fmax_over_r",
        "biexponential_fmax",
    ),
    "Damper": ("damper", "damper_implied"),
    "Experiment": ("experiment",),
    "Constants and the method": ("default_grain", "walls", "single_particle", "final_height", "oscillator"),
}
"""Sections of the report, with their sections of ``published.toml``."""


def report_page(shown: PublishedResults, quick: PublishedResults | None = None) -> Page:
    """Return the report as a page.

    Parameters
    ----------
    shown : Results
        Results of the full run.
    quick : Results, optional
        Results of a quick run, shown in separate columns.
    """
    rows = judge_all_entries(shown)
    return Page(
        TITLE,
        _lead_text(rows, shown, quick),
        tuple(_report_blocks(rows, shown, quick)),
        _footer_text(shown, quick),
    )


def _report_blocks(
    rows: Sequence[JudgedEntry], shown: PublishedResults, quick: PublishedResults | None
) -> Iterator[Block]:
    adjacent = [None] * len(rows) if quick is None else judge_all_entries(quick)
    yield from _most_important_figures_section(rows)
    yield Text(both_causes_text(shown))
    yield Text(creep_text(shown))
    yield from (table for table in (creep_table(shown), accelerated_cycle_table(shown)) if table.rows)
    yield from plots.both_causes_picture(shown)
    yield from _explanation_section()
    yield from _differences_section(rows)
    yield from _statements_section(shown)
    for title, sections in SECTIONS.items():
        yield Heading(title)
        chosen = [
            (row, other)
            for row, other in zip(rows, adjacent, strict=True)
            if row.entry.key.split(".")[0] in sections
        ]
        yield from _entry_table_and_notes(chosen, quick is not None)
        yield from plots.pictures_of_section(title, shown)
    yield from _causes_section(shown, compare_figures_with_and_without_changes(shown))
    yield from _series_state_section(shown)
    yield from _failed_cases_section(shown)


def _lead_text(rows: Sequence[JudgedEntry], shown: PublishedResults, quick: PublishedResults | None) -> str:
    series = count_series_by_state(shown)
    words = (
        f"{len(rows)} published numbers: {verdict_counts_text(rows)}. {series['whole']} of "
        f"{series['planned']} series are complete with the present code; {series['stopped']} were "
        f"stopped in every start, {series['stale']} are stale. "
        f"Statements: {counts_text(count_statements_by_outcome(shown))}."
    )
    return (
        words
        if quick is None
        else f"{words} This quick run: {verdict_counts_text(judge_all_entries(quick))}."
    )


def counts_text(numbers: dict[str, int]) -> str:
    """Return counts as text."""
    return ", ".join(f"{number} {name}" for name, number in numbers.items())


def _most_important_figures_section(rows: Sequence[JudgedEntry]) -> Iterator[Block]:
    yield Heading("The ten most important figures")
    chosen = [row for key in FIRST for row in rows if row.entry.key == key]
    yield from plots.relative_figures_picture(chosen)
    yield from _entry_table_and_notes([(row, None) for row in chosen], False, notes=False)


def _explanation_section() -> Iterator[Block]:
    yield Text(
        "Ours is the mean over starts with its interval of 95 % (Student); the number in brackets is the "
        "number of starts. A published mean with a deviation is judged by Welch's interval of "
        "the difference, with both standard errors. A published number without a deviation is one draw: it "
        "is judged by a prediction interval, our scatter times the root of 1 + 1/n. Half of the last "
        "printed digit is added; if ours has no scatter the digits decide. Distances in beds of equal "
        "grains have equal scatter at all sizes, and one pooled deviation. Differences are limited by a "
        "false discovery rate of 5 % over all entries (Benjamini and Hochberg). A comparison could fail if "
        "its interval is below a fifth of the published "
        "value. The final heights of the mixtures are one formula and one entry; the four numbers "
        "of a fit are judged as the curve. "
        "By construction: ours was made from the published number. Protocols: published is "
        "de Paula's own (relaxation of 5 T; 8.33 or 5.63 mm/s, mixtures 1 mm/s); quick compresses "
        "mixtures at 16 mm/s, and beds of equal grains at 33 mm/s after 5 s. An entry is based on the "
        "longest protocol planned for it, and counts as not run until all of its starts are done: no "
        "shorter protocol replaces it. The effects of the quick protocol are under Causes."
    )


def _differences_section(rows: Sequence[JudgedEntry]) -> Iterator[Block]:
    yield Heading("Differences")
    chosen = [row for row in rows if row.verdict.words == DIFFERS]
    if not chosen:
        yield Text("None among the entries that were run.")
        return
    chosen.sort(key=_relative_difference, reverse=True)
    cells = [
        (
            row.entry.what,
            published_value_text(row),
            finding_text(row.found, row.entry.unit),
            f"{_relative_difference(row):.1%}",
            f"{row.verdict.allowed or 0.0:.2g}",
            row.note,
        )
        for row in chosen
    ]
    header = ("what", "published", "ours", "difference", "allowed", "why")
    yield Table(header, cells)


def _relative_difference(row: JudgedEntry) -> float:
    assert row.found is not None
    return abs(row.found.value - row.published) / max(abs(row.published), 1e-12)


def _entry_table_and_notes(
    rows: Sequence[tuple[JudgedEntry, JudgedEntry | None]], with_quick: bool, notes: bool = True
) -> Iterator[Block]:
    header = ["what", "published", "ours", "verdict", "allowed", "protocol"]
    header += ["quick run", "its verdict"] if with_quick else []
    cells, told = [], []
    for row, other in rows:
        result, allowed = row.found, row.verdict.allowed
        cells.append(
            [
                row.entry.what,
                published_value_text(row),
                finding_text(result, row.entry.unit),
                _verdict_text(row),
                "" if allowed is None else f"{allowed:.2g}",
                "" if result is None else result.protocol,
            ]
        )
        if other is not None:
            cells[-1] += [finding_text(other.found, row.entry.unit), other.verdict.words]
        if row.note and row.note not in told:
            told.append(row.note)
    yield Table(header, cells)
    if not notes:
        return
    sources = list(dict.fromkeys(row.source for row, _ in rows))
    yield Text("Source: " + "; ".join(sources) + ".")
    yield from map(Caution, told)


def _verdict_text(row: JudgedEntry) -> str:
    weak = row.verdict.words == AGREES and not row.verdict.can_fail
    return row.verdict.words + (" (could hardly fail)" if weak else "")


def published_value_text(row: JudgedEntry) -> str:
    """Return the published value with its deviation."""
    spread = row.published_spread
    digits = row.entry.digits
    value = f"{row.published:.{digits}f}" if digits < 7 else f"{row.published:.2g}"
    return value + ("" if spread is None else f" ± {spread:g}") + _unit_with_space(row.entry.unit)


def finding_text(result: Finding | None, unit: str) -> str:
    """Return value, half interval, unit and number of starts."""
    if result is None:
        return "—"
    half = result.half_width()
    interval = "" if half is None else f" ± {half:.2g}"
    starts = f" ({result.starts})" if result.starts else ""
    return f"{result.value:.4g}{interval}{_unit_with_space(unit)}{starts}"


def _unit_with_space(unit: str) -> str:
    return f" {unit}" if unit else ""


def _statements_section(results: PublishedResults) -> Iterator[Block]:
    yield Heading("Statements")
    yield Text("De Paula's qualitative statements, tested on the runs.")
    rows = []
    for item in all_statements():
        check = item.check(results)
        verdict = "not run" if check is None else "holds" if check.holds else "does not hold"
        rows.append((item.words, item.source, verdict, "" if check is None else check.figures))
    yield Table(("statement", "section", "", "figures"), rows)


def _both_causes_table(results: PublishedResults) -> Iterator[Block]:
    rows = [
        (
            str(item.grains),
            item.what,
            f"{item.published:.2f} D",
            finding_text(item.usual, "D"),
            "yes" if item.usual_within else "no",
            finding_text(item.both, "D"),
            f"{item.allowed:.2g}",
            "yes" if item.within else "no",
            finding_text(item.late, "D"),
            "" if item.late is None else f"{item.late_allowed:.2g}",
            "" if item.late is None else "yes" if item.late_within else "no",
        )
        for item in distances_with_both_causes(results)
    ]
    if rows:
        head = (
            "grains",
            "half mean distance",
            "published",
            "exact law",
            "within",
            "both causes",
            "allowed",
            "within",
            "2.17 late",
            "allowed",
            "within",
        )
        yield Table(head, rows)


def _causes_section(results: PublishedResults, result: Sequence[ChangedFigure]) -> Iterator[Block]:
    yield Heading("Causes")
    yield from _both_causes_table(results)
    yield Text(hysteresis_verdict_text(result))
    if large := large_bed_force_text(results):
        yield Text(large)
    yield Text(
        "The same bed with one or several changes. A change matters if it moves a mean beyond Student's "
        "interval of 95 % for the starts that were run; it explains a difference if it brings the mean to "
        "the published number, within the interval of the mean. A bed without dissipation is omitted: it "
        "remains a hot gas whose force depends on the start, so its figures are meaningless. The "
        "cell of 0.36 m contradicts the packing of 0.34 that de Paula prints."
    )
    if not result:
        yield Text("Not run.")
        return
    rows = [
        (
            item.change,
            item.bed,
            item.figure,
            "" if item.published is None else f"{item.published:g}{_unit_with_space(item.unit)}",
            finding_text(item.without, item.unit),
            finding_text(item.with_it, ""),
            _effect_of_change_text(item),
        )
        for item in result
    ]
    yield Table(("change", "bed", "figure", "published", "without", "with", ""), rows)


def _effect_of_change_text(item: ChangedFigure) -> str:
    if item.explains:
        return "explains"
    if item.matters is None:
        return "one start each"
    return "matters" if item.matters else "within scatter"


def _series_state_section(results: PublishedResults) -> Iterator[Block]:
    yield Heading("State of the series")
    yield Text(f"{counts_text(count_series_by_state(results))}.")
    rows = [
        (
            key,
            _series_state_text(item),
            item["step"] + (" (de Paula's scheme)" if item["coarse"] else ""),
            f"{maximum_energy_residual(item):.1e}" if item["done"] else "",
        )
        for key, item in results.series.items()
        if not is_complete(item) or item["coarse"] or maximum_energy_residual(item) > 1e-4
    ]
    if rows:
        yield Text("Series that are incomplete, or with an energy residual above 1e-4:")
        yield Table(("series", "state", "step", "energy residual"), rows)


def _series_state_text(item: Plain) -> str:
    if is_stopped(item):
        return "every start stopped"
    return "stale" if item.get("stale") else f"{len(item['done'])} of {len(item['seeds'])} starts"


def _failed_cases_section(results: PublishedResults) -> Iterator[Block]:
    failed = {key: item["errors"] for key, item in results.series.items() if item["errors"]}
    if failed:
        yield Heading("Cases that failed")
        yield Table(("bed", "error"), [(k, e) for k, some in failed.items() for e in some])


def _footer_text(shown: PublishedResults, quick: PublishedResults | None) -> str:
    made = (results.made for results in (shown, quick) if results is not None and results.made)
    return " ".join(map(_origin_text, made))


def _origin_text(made: Mapping[str, Any]) -> str:
    versions = ", ".join(f"{k} {v}" for k, v in made.items() if k not in _OWN)
    command, date = (html.unescape(str(made[name])) for name in _OWN[:2])
    return f"Made by {command} on {date}, in {made.get('sittings', 1)} parts, with {versions}."


_OWN = ("command", "date", "sittings")
