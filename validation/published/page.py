"""The report: ours beside the published values, with verdicts, pictures and causes."""

from __future__ import annotations

import html
from collections.abc import Sequence

from granular.shared.html import Page
from validation.published import plots
from validation.published.causes import ChangedFigure, comparisons
from validation.published.finding import Finding
from validation.published.judging import Judged, counts, judged
from validation.published.results import Results
from validation.published.statements import statements

TITLE = "Published results, reproduced"

SECTIONS = {
    "Constants and the method": ("default_grain", "walls", "single_particle", "final_height",
                                 "oscillator"),
    "Independence of start and speed": ("independence_of_start", "velocity"),
    "Force on the piston": ("piston_force_direct_sum", "piston_force_verlet", "mono_further"),
    "Mean distance": ("half_mean_distance",),
    "Polygons": ("voronoi_shares_direct_sum", "voronoi_shares_verlet"),
    "Mixtures": ("bidisperse_r_half", "bidisperse_r_zero", "bidisperse_further",
                 "bidisperse_all_r", "bidisperse_variants", "fmax_over_r", "biexponential_fmax"),
    "Damper": ("damper", "damper_implied"),
}  # fmt: skip
"""Sections of the report, with those of ``values.toml`` that they show."""


def page(shown: Results, quick: Results | None = None) -> Page:
    """The report as a page.

    Parameters
    ----------
    shown : Results
        Of the full run.
    quick : Results, optional
        Of a quick run, shown in columns of its own.
    """
    rows = judged(shown)
    beside = [None] * len(rows) if quick is None else judged(quick)
    made = Page(TITLE, _lead(rows, quick))
    _how_to_read(made)
    for title, sections in SECTIONS.items():
        made.section(title)
        chosen = [
            (row, other)
            for row, other in zip(rows, beside, strict=True)
            if row.entry.key.split(".")[0] in sections
        ]
        _entries(made, chosen, quick is not None)
        plots.add(made, title, quick if not shown.series and quick is not None else shown)
    main = shown if shown.series or quick is None else quick
    _statements(made, main)
    _causes(made, comparisons(main))
    _errors(made, main)
    _footer(made, shown, quick)
    return made


def _lead(rows: Sequence[Judged], quick: Results | None) -> str:
    words = "Full run: " + _counted(rows)
    return words if quick is None else f"{words} This quick run: {_counted(judged(quick))}"


def _counted(rows: Sequence[Judged]) -> str:
    number = counts(rows)
    return (
        f"{len(rows)} published numbers; {number['agree']} agree, {number['differ']} differ, "
        f"{number['not comparable']} cannot be compared, {number['not run yet']} not run yet."
    )


def _how_to_read(made: Page) -> None:
    made.text(
        "Ours is a mean over starts ± the standard deviation of single starts; the number in "
        "brackets says how many. It agrees within scatter where the difference is at most twice "
        "the deviation (of theirs and ours together) and half of the last printed digit; otherwise "
        "it agrees within the tolerance that is named, or differs. Protocols: published is the "
        "source's own (relaxation of 5 T; 8.33 or 5.63 mm/s, mixtures 1 mm/s); short compresses "
        "mixtures at 4 mm/s; quick at 16 mm/s, and beds of equal grains at 33 mm/s after 5 s. "
        "What the shorter ones change stands under Causes."
    )


def _entries(made: Page, rows: Sequence[tuple[Judged, Judged | None]], with_quick: bool) -> None:
    header = ["what", "published", "ours", "verdict", "protocol"]
    header += ["quick run", "its verdict"] if with_quick else []
    cells, notes = [], []
    for row, other in rows:
        found = row.found
        cells.append(
            [row.entry.what, _published(row), _ours(found, row.entry.unit), row.verdict.words,
             "" if found is None else found.protocol]
        )  # fmt: skip
        if other is not None:
            cells[-1] += [_ours(other.found, row.entry.unit), other.verdict.words]
        if row.note and row.note not in notes:
            notes.append(row.note)
    made.table(header, cells)
    sources = list(dict.fromkeys(row.source for row, _ in rows))
    made.text("Source: " + "; ".join(sources) + ".")
    for note in notes:
        made.note(note)


def _published(row: Judged) -> str:
    spread = row.published_spread
    digits = row.entry.digits
    value = f"{row.published:.{digits}f}" if digits < 7 else f"{row.published:.2g}"
    return value + ("" if spread is None else f" ± {spread:g}") + _unit(row.entry.unit)


def _ours(found: Finding | None, unit: str) -> str:
    if found is None:
        return "—"
    spread = "" if found.spread is None else f" ± {found.spread:.2g}"
    starts = f" ({found.starts})" if found.starts else ""
    return f"{found.value:.4g}{spread}{_unit(unit)}{starts}"


def _unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def _statements(made: Page, results: Results) -> None:
    made.section("Statements")
    made.text("What the source says without a number, tested on the runs.")
    rows = []
    for one in statements():
        check = one.test(results)
        said = "not run yet" if check is None else "holds" if check.holds else "does not hold"
        rows.append((one.words, one.source, said, "" if check is None else check.figures))
    made.table(("statement", "section", "", "figures"), rows)


def _causes(made: Page, found: Sequence[ChangedFigure]) -> None:
    made.section("Causes")
    made.text(
        "The same bed with one thing changed: what matters moves a mean beyond Student's interval "
        "of 95 % for the starts that were run. A bed without dissipation is left out: it stays a "
        "hot gas whose force depends on the start (13 to 30 N), so that no figure has a meaning."
    )
    if not found:
        made.text("Not run yet.")
        return
    rows = [
        (one.change, one.bed, one.figure, _ours(one.without, one.unit), _ours(one.with_it, ""),
         _mattering(one.matters))
        for one in found
    ]  # fmt: skip
    made.table(("change", "bed", "figure", "without", "with", ""), rows)


def _mattering(matters: bool | None) -> str:
    if matters is None:
        return "one start each"
    return "matters" if matters else "within scatter"


def _errors(made: Page, results: Results) -> None:
    failed = {key: one["errors"] for key, one in results.series.items() if one["errors"]}
    if failed:
        made.section("Cases that failed")
        made.table(("bed", "error"), [(k, e) for k, some in failed.items() for e in some])


def _footer(made: Page, shown: Results, quick: Results | None) -> None:
    for results in (shown, quick):
        if results is not None and results.made:
            versions = ", ".join(f"{k} {v}" for k, v in results.made.items() if k not in _OWN)
            command, date = (html.unescape(results.made[name]) for name in _OWN)
            made.footer(f"Made by {command} on {date} with {versions}.")


_OWN = ("command", "date")
