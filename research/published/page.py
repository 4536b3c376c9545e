"""The report: first the most important figures, then the differences, then the rest."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from granular.shared.blocks import Block, Caution, Heading, Table, Text
from granular.shared.html_pages import Page
from research.campaign import Plain
from research.published import plots
from research.published.both_causes import (
    table_of_creep,
    table_of_haste,
    with_both_causes,
    words_on_both,
    words_on_creep,
)
from research.published.causes import ChangedFigure, comparisons, verdict_on_hysteresis, words_on_large_beds
from research.published.entry import AGREES, DIFFERS
from research.published.finding import Finding
from research.published.judging import Judged, counts_text, judged
from research.published.results import Results, counted, is_stopped, is_whole, worst_residual
from research.published.statements import counted_statements, statements

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


def page(shown: Results, quick: Results | None = None) -> Page:
    """Return the report as a page.

    Parameters
    ----------
    shown : Results
        Results of the full run.
    quick : Results, optional
        Results of a quick run, shown in separate columns.
    """
    rows = judged(shown)
    return Page(TITLE, _lead(rows, shown, quick), tuple(_blocks(rows, shown, quick)), _footer(shown, quick))


def _blocks(rows: Sequence[Judged], shown: Results, quick: Results | None) -> Iterator[Block]:
    adjacent = [None] * len(rows) if quick is None else judged(quick)
    yield from _first(rows)
    yield Text(words_on_both(shown))
    yield Text(words_on_creep(shown))
    yield from (table for table in (table_of_creep(shown), table_of_haste(shown)) if table.rows)
    yield from plots.both_causes(shown)
    yield from _how_to_read()
    yield from _differences(rows)
    yield from _statements(shown)
    for title, sections in SECTIONS.items():
        yield Heading(title)
        chosen = [
            (row, other)
            for row, other in zip(rows, adjacent, strict=True)
            if row.entry.key.split(".")[0] in sections
        ]
        yield from _entries(chosen, quick is not None)
        yield from plots.section_pictures(title, shown)
    yield from _causes(shown, comparisons(shown))
    yield from _state(shown)
    yield from _errors(shown)


def _lead(rows: Sequence[Judged], shown: Results, quick: Results | None) -> str:
    series = counted(shown)
    words = (
        f"{len(rows)} published numbers: {counts_text(rows)}. {series['whole']} of "
        f"{series['planned']} series are complete with the present code; {series['stopped']} were "
        f"stopped in every start, {series['stale']} are stale. "
        f"Statements: {describe_fields(counted_statements(shown))}."
    )
    return words if quick is None else f"{words} This quick run: {counts_text(judged(quick))}."


def describe_fields(numbers: dict[str, int]) -> str:
    """Return counts as text."""
    return ", ".join(f"{number} {name}" for name, number in numbers.items())


def _first(rows: Sequence[Judged]) -> Iterator[Block]:
    yield Heading("The ten most important figures")
    chosen = [row for key in FIRST for row in rows if row.entry.key == key]
    yield from plots.adjacent(chosen)
    yield from _entries([(row, None) for row in chosen], False, notes=False)


def _how_to_read() -> Iterator[Block]:
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


def _differences(rows: Sequence[Judged]) -> Iterator[Block]:
    yield Heading("Differences")
    chosen = [row for row in rows if row.verdict.words == DIFFERS]
    if not chosen:
        yield Text("None among the entries that were run.")
        return
    chosen.sort(key=_relative, reverse=True)
    cells = [
        (
            row.entry.what,
            published_of(row),
            ours_of(row.found, row.entry.unit),
            f"{_relative(row):.1%}",
            f"{row.verdict.allowed or 0.0:.2g}",
            row.note,
        )
        for row in chosen
    ]
    header = ("what", "published", "ours", "difference", "allowed", "why")
    yield Table(header, cells)


def _relative(row: Judged) -> float:
    assert row.found is not None
    return abs(row.found.value - row.published) / max(abs(row.published), 1e-12)


def _entries(
    rows: Sequence[tuple[Judged, Judged | None]], with_quick: bool, notes: bool = True
) -> Iterator[Block]:
    header = ["what", "published", "ours", "verdict", "allowed", "protocol"]
    header += ["quick run", "its verdict"] if with_quick else []
    cells, told = [], []
    for row, other in rows:
        result, allowed = row.found, row.verdict.allowed
        cells.append(
            [
                row.entry.what,
                published_of(row),
                ours_of(result, row.entry.unit),
                _verdict(row),
                "" if allowed is None else f"{allowed:.2g}",
                "" if result is None else result.protocol,
            ]
        )
        if other is not None:
            cells[-1] += [ours_of(other.found, row.entry.unit), other.verdict.words]
        if row.note and row.note not in told:
            told.append(row.note)
    yield Table(header, cells)
    if not notes:
        return
    sources = list(dict.fromkeys(row.source for row, _ in rows))
    yield Text("Source: " + "; ".join(sources) + ".")
    yield from map(Caution, told)


def _verdict(row: Judged) -> str:
    weak = row.verdict.words == AGREES and not row.verdict.can_fail
    return row.verdict.words + (" (could hardly fail)" if weak else "")


def published_of(row: Judged) -> str:
    """Return the published value with its deviation."""
    spread = row.published_spread
    digits = row.entry.digits
    value = f"{row.published:.{digits}f}" if digits < 7 else f"{row.published:.2g}"
    return value + ("" if spread is None else f" ± {spread:g}") + _unit(row.entry.unit)


def ours_of(result: Finding | None, unit: str) -> str:
    """Return value, half interval, unit and number of starts."""
    if result is None:
        return "—"
    half = result.half_width()
    interval = "" if half is None else f" ± {half:.2g}"
    starts = f" ({result.starts})" if result.starts else ""
    return f"{result.value:.4g}{interval}{_unit(unit)}{starts}"


def _unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def _statements(results: Results) -> Iterator[Block]:
    yield Heading("Statements")
    yield Text("De Paula's qualitative statements, tested on the runs.")
    rows = []
    for item in statements():
        check = item.check(results)
        verdict = "not run" if check is None else "holds" if check.holds else "does not hold"
        rows.append((item.words, item.source, verdict, "" if check is None else check.figures))
    yield Table(("statement", "section", "", "figures"), rows)


def _both(results: Results) -> Iterator[Block]:
    rows = [
        (
            str(item.grains),
            item.what,
            f"{item.published:.2f} D",
            ours_of(item.usual, "D"),
            "yes" if item.usual_within else "no",
            ours_of(item.both, "D"),
            f"{item.allowed:.2g}",
            "yes" if item.within else "no",
            ours_of(item.late, "D"),
            "" if item.late is None else f"{item.late_allowed:.2g}",
            "" if item.late is None else "yes" if item.late_within else "no",
        )
        for item in with_both_causes(results)
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


def _causes(results: Results, result: Sequence[ChangedFigure]) -> Iterator[Block]:
    yield Heading("Causes")
    yield from _both(results)
    yield Text(verdict_on_hysteresis(result))
    if large := words_on_large_beds(results):
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
            "" if item.published is None else f"{item.published:g}{_unit(item.unit)}",
            ours_of(item.without, item.unit),
            ours_of(item.with_it, ""),
            _mattering(item),
        )
        for item in result
    ]
    yield Table(("change", "bed", "figure", "published", "without", "with", ""), rows)


def _mattering(item: ChangedFigure) -> str:
    if item.explains:
        return "explains"
    if item.matters is None:
        return "one start each"
    return "matters" if item.matters else "within scatter"


def _state(results: Results) -> Iterator[Block]:
    yield Heading("State of the series")
    yield Text(f"{describe_fields(counted(results))}.")
    rows = [
        (
            key,
            _word(item),
            item["step"] + (" (de Paula's scheme)" if item["coarse"] else ""),
            f"{worst_residual(item):.1e}" if item["done"] else "",
        )
        for key, item in results.series.items()
        if not is_whole(item) or item["coarse"] or worst_residual(item) > 1e-4
    ]
    if rows:
        yield Text("Series that are incomplete, or with an energy residual above 1e-4:")
        yield Table(("series", "state", "step", "energy residual"), rows)


def _word(item: Plain) -> str:
    if is_stopped(item):
        return "every start stopped"
    return "stale" if item.get("stale") else f"{len(item['done'])} of {len(item['seeds'])} starts"


def _errors(results: Results) -> Iterator[Block]:
    failed = {key: item["errors"] for key, item in results.series.items() if item["errors"]}
    if failed:
        yield Heading("Cases that failed")
        yield Table(("bed", "error"), [(k, e) for k, some in failed.items() for e in some])


def _footer(shown: Results, quick: Results | None) -> str:
    made = (results.made for results in (shown, quick) if results is not None and results.made)
    return " ".join(map(_made_with, made))


def _made_with(made: Mapping[str, Any]) -> str:
    versions = ", ".join(f"{k} {v}" for k, v in made.items() if k not in _OWN)
    command, date = (html.unescape(str(made[name])) for name in _OWN[:2])
    return f"Made by {command} on {date}, in {made.get('sittings', 1)} parts, with {versions}."


_OWN = ("command", "date", "sittings")
