"""Texts in README and guide on the comparison with the published values."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from granular.shared.blocks import Table
from research.campaign import PageBlock, markdown_of_console_table, markdown_table
from research.published.both_causes import (
    accelerated_cycle_table,
    both_causes_text,
    creep_table,
    creep_text,
    distance_table,
)
from research.published.causes import large_bed_force_text
from research.published.entry import AGREES, DIFFERS
from research.published.falls import fall_error_text
from research.published.judging import (
    JudgedEntry,
    count_entries_by_verdict,
    count_strong_comparisons,
    judge_all_entries,
)
from research.published.page import FIRST, counts_text
from research.published.plan import (
    ASPECTS,
    GAMMAS,
    MASSES,
    SOURCE_DRAG,
    damper_series_name,
    mixture_series_name,
)
from research.published.results import PublishedResults, count_series_by_state
from research.published.statements import count_statements_by_outcome
from validation.measured_quantities import keys_of_published_values

WIDTH = 110
PAGES: Mapping[str, str] = {
    "summary": "docs/results/verification.md",
    "counts": "docs/results/verification.md",
    "figures": "docs/results/verification.md",
    "packaged damper": "docs/results/verification.md",
    "damper law": "docs/results/laws.md",
    "falls": "docs/results/laws.md",
}
"""Files of the blocks."""


def guide_blocks(results: PublishedResults) -> dict[str, PageBlock]:
    """Return the text of every block."""
    makers: Mapping[str, Callable[[PublishedResults], str]] = {
        "summary": _summary_text,
        "counts": _verdict_count_text,
        "figures": _figures_text,
        "damper law": _damper_law_residual_table,
        "packaged damper": _packaged_damper_table,
        "falls": _fall_errors_text,
    }
    return {name: PageBlock(PAGES[name], make(results)) for name, make in makers.items()}


def _summary_text(results: PublishedResults) -> str:
    rows, made = judge_all_entries(results), results.made
    number = count_entries_by_verdict(rows)
    left = f"{number['not run']} are not run yet" if number["not run"] else "all were run"
    printed = sum(1 for _ in keys_of_published_values())
    return _wrap_to_page_width(
        f"- Of {printed} numbers that de Paula (2025) prints, judged as {len(rows)} "
        f"entries, {number[AGREES]} agree and {number[DIFFERS]} differ; {left}. The other entries "
        "agree by construction or cannot be compared "
        f"(`{made.get('command', '')}`, {made.get('date', '')})."
    )


def _verdict_count_text(results: PublishedResults) -> str:
    rows = judge_all_entries(results)
    series = count_series_by_state(results)
    made = results.made
    printed = sum(1 for _ in keys_of_published_values())
    statements = count_statements_by_outcome(results)
    lines = [
        _wrap_to_page_width(
            f"The {printed} published numbers were judged as {len(rows)} entries, with these verdicts:"
        ),
        "",
        markdown_table(
            ("verdict", "entries"),
            [
                (name, str(n))
                for name, n in {**count_entries_by_verdict(rows), **count_strong_comparisons(rows)}.items()
            ],
        ),
        "",
        _wrap_to_page_width(
            f"Of {sum(statements.values())} qualitative statements {counts_text(statements)}."
        ),
        "",
        _wrap_to_page_width(
            f"Of {series['planned']} series of runs {series['whole']} are complete, {series['begun']} are "
            f"incomplete, and {series['stale']} are out of date. In {series['stopped']} series every run was "
            "stopped, because the pair lists are so short that pairs are missed and energy is not conserved. "
            f"In {series['residual above 1e-3']} of the complete series the residual of the energy balance "
            "exceeds 1e-3 of the total energy exchanged. "
            f"(`{made.get('command', '')}` on {made.get('date', '')}, in {made.get('sittings', 0)} "
            "parts.)"
        ),
    ]
    return "\n".join(lines)


def _figures_text(results: PublishedResults) -> str:
    rows = {row.entry.key: row for row in judge_all_entries(results)}
    lines = ["| figure | published | here | verdict |", "|---|---|---|---|"]
    lines += [_markdown_row_of_entry(rows[key]) for key in FIRST]
    parts: list[str | Table] = [
        both_causes_text(results),
        "The table gives half the mean distance in diameters D. A star marks values whose prediction "
        "interval does not contain the published value:",
        distance_table(results),
        creep_text(results),
        creep_table(results),
        accelerated_cycle_table(results),
        large_bed_force_text(results),
        *_dip_test_table_text(results),
    ]
    for part in parts:
        text = (
            _wrap_to_page_width(part)
            if isinstance(part, str)
            else markdown_of_console_table(part)
            if part.rows
            else ""
        )
        lines += ["", text] if text else []
    return "\n".join(lines)


def _markdown_row_of_entry(row: JudgedEntry) -> str:
    from research.published.page import finding_text, published_value_text

    return (
        f"| {row.entry.what} | {published_value_text(row)} | {finding_text(row.found, row.entry.unit)} | "
        f"{row.verdict.words} |"
    )


def _dip_test_table_text(results: PublishedResults) -> list[str | Table]:
    """Return the dip test of compressive forces, by the longest protocol that was run."""
    rows = []
    beds = [("R = 0", mixture_series_name(0.6, 0.0))]
    beds += [(f"R = 0.5, a = {a:g}", mixture_series_name(a, 0.5)) for a in ASPECTS]
    beds += [(f"R = 1, a = {a:g}", mixture_series_name(a, 1.0)) for a in ASPECTS]
    for label, name in beds:
        samples = (results.figure_sample(name, "dip_p", protocol) for protocol in ("published", "quick"))
        sample = next((item for item in samples if item is not None), None)
        if sample is not None:
            low, high = float(sample.values.min()), float(sample.values.max())
            p = f"{low:.2g}" if len(sample.values) == 1 else f"{low:.2g} to {high:.2g}"
            rows.append((label, sample.protocol, p))
    words = (
        "Hartigan's dip test was applied to the distribution of the compressive forces on the grains, both "
        "species together. The table gives the range over the starts of its p value; a small p means that "
        "the distribution has more than one mode:"
    )
    return [words, Table(("mixture", "protocol", "p"), rows)] if rows else []


EXPECTED = (
    ("equilibrium height", "rest_height_D", " D", "9.86 ± 0.1 D"),
    ("period of small oscillations", "period", " s", "0.288 ± 0.003 s"),
    ("damping ratio", "damping_ratio", "", "0.037 ± 0.003"),
)
"""Figures of the packaged damper, and their values from an independent simulation."""


def _packaged_damper_table(results: PublishedResults) -> str:
    lines = ["| figure | here | expected |", "|---|---|---|"]
    for words, figure, unit, expected in EXPECTED:
        sample = results.figure_sample(damper_series_name(MASSES[0]), figure)
        value = "—" if sample is None else f"{sample.values.mean():.4g}{unit}"
        lines.append(f"| {words} | {value} | {expected} |")
    return "\n".join(lines)


def _damper_law_residual_table(results: PublishedResults) -> str:
    """Return the residuals of de Paula's law over the drag."""
    lines = [
        "| drag of a grain | damping ratio | residual of de Paula's law | residual of the linear law | "
        "alpha/omega in de Paula's scaling |",
        "|---|---|---|---|---|",
    ]
    for drag in GAMMAS:
        name = damper_series_name(MASSES[1], drag)
        result = [
            results.figure_sample(name, item)
            for item in ("damping_ratio", "free_misfit", "free_linear_misfit", "alpha_over_omega")
        ]
        known = [float(item.values.mean()) for item in result if item is not None]
        if len(known) == len(result):
            lines.append(
                f"| {drag:g} kg/s | {known[0]:.3f} | {100.0 * known[1]:.1f} % | "
                f"{100.0 * known[2]:.1f} % | {known[3]:.3f} |"
            )
    unit = results.figure_sample(damper_series_name(MASSES[1], SOURCE_DRAG), "unit")
    if unit is None:
        return _wrap_to_page_width("De Paula's damper: its runs are not done.")
    tail = (
        "De Paula's curve has alpha/omega = 0.162 and a damping ratio of 0.427. The thesis gives neither the "
        "drag of its damper nor the unit of time of its curve. With a unit of time of "
        f"{unit.values.mean():.3f} s the simulated omega would equal the printed value, 1.05."
    )
    return "\n".join([*lines, "", _wrap_to_page_width(tail)])


def _fall_errors_text(results: PublishedResults) -> str:
    return _wrap_to_page_width(fall_error_text(results.calculations.get("falls", {})))


def _wrap_to_page_width(text: str) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(text, WIDTH, break_long_words=False, break_on_hyphens=False))
