"""Blocks of README and guide that say how the published values compare."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from research.campaign import Block
from research.published.both_causes import words_on_both, words_on_creep
from research.published.causes import words_on_large_beds
from research.published.entry import AGREES, DIFFERS
from research.published.falls import words_on_falls
from research.published.judging import Judged, counts, judged, said
from research.published.page import FIRST, describe_fields
from research.published.plan import ASPECTS, GAMMAS, MASSES, SOURCE_DRAG, damper_name, mixture_name
from research.published.results import Results, counted
from research.published.statements import counted_statements
from validation.measured_quantities import published_keys

WIDTH = 110
PAGES: Mapping[str, str] = {
    "summary": "docs/results/verification.md",
    "counts": "docs/results/verification.md",
    "figures": "docs/results/verification.md",
    "packaged damper": "docs/results/verification.md",
    "damper law": "docs/results/laws.md",
    "falls": "docs/results/laws.md",
}
"""Files by the blocks that they hold."""


def blocks(results: Results) -> dict[str, Block]:
    """The text of every block."""
    makers: Mapping[str, Callable[[Results], str]] = {
        "summary": _summary,
        "counts": _counts,
        "figures": _figures,
        "damper law": _damper_law,
        "packaged damper": _packaged_damper,
        "falls": _falls,
    }
    return {name: Block(PAGES[name], make(results)) for name, make in makers.items()}


def _summary(results: Results) -> str:
    rows, made = judged(results), results.made
    number = counts(rows)
    left = f"{number['not run']} are not run yet" if number["not run"] else "none is left to run"
    printed = sum(1 for _ in published_keys())
    return _wrapped(
        f"- Of {printed} numbers that de Paula (2025) prints, judged as {len(rows)} "
        f"entries, {number[AGREES]} agree, "
        f"{number[DIFFERS]} differ and {left}; the others hold by construction or cannot be "
        "compared "
        f"(`{made.get('command', '')}`, {made.get('date', '')})."
    )


def _counts(results: Results) -> str:
    rows = judged(results)
    series = counted(results)
    made = results.made
    printed = sum(1 for _ in published_keys())
    sentences = [
        f"Of {len(rows)} entries, of {printed} published numbers: {said(rows)}.",
        f"Of {sum(counted_statements(results).values())} statements: "
        f"{describe_fields(counted_statements(results))}.",
        f"{series['whole']} of {series['planned']} series are run whole, {series['begun']} begun, "
        f"{series['stale']} stale; of {series['stopped']} every start was stopped, for lists so "
        "short that they lose pairs do not keep the energy. "
        f"{series['residual above 1e-3']} of those run miss the energy by more than 1e-3 of that "
        "turned over.",
        f"Made by `{made.get('command', '')}` on {made.get('date', '')}, begun "
        f"{made.get('sittings', 0)} times.",
    ]
    return _wrapped(" ".join(sentences))


def _figures(results: Results) -> str:
    rows = {row.entry.key: row for row in judged(results)}
    lines = ["| figure | published | here | verdict |", "|---|---|---|---|"]
    lines += [_row(rows[key]) for key in FIRST]
    modes = _modes(results)
    lines += ["", _wrapped(words_on_both(results)), "", _wrapped(words_on_creep(results))]
    lines += ["", _wrapped(large)] if (large := words_on_large_beds(results)) else []
    lines += ["", _wrapped(modes)] if modes else []
    return "\n".join(lines)


def _row(row: Judged) -> str:
    from research.published.page import ours_of, published_of

    return (
        f"| {row.entry.what} | {published_of(row)} | {ours_of(row.found, row.entry.unit)} | "
        f"{row.verdict.words} |"
    )


def _modes(results: Results) -> str:
    """The dip test of compressive forces, of the longest protocol that is there."""
    words = []
    beds = [("R = 0", mixture_name(0.6, 0.0))]
    beds += [(f"R = 0.5, a = {a:g}", mixture_name(a, 0.5)) for a in ASPECTS]
    beds += [(f"R = 1, a = {a:g}", mixture_name(a, 1.0)) for a in ASPECTS]
    for label, name in beds:
        result = [
            item
            for protocol in ("published", "quick")
            if (item := results.sample(name, "dip_p", protocol)) is not None
        ]
        if result:
            low, high = float(result[0].values.min()), float(result[0].values.max())
            p = f"{low:.2g}" if len(result[0].values) == 1 else f"{low:.2g} to {high:.2g}"
            words.append(f"{label} ({result[0].protocol}): {p}")
    if not words:
        return ""
    return (
        "Compressive forces on the grains, both species together: p of Hartigan's dip test for one "
        f"mode over the starts, {'; '.join(words)}."
    )


EXPECTED = (
    ("rest height", "rest_height_D", " D", "9.86 ± 0.1 D"),
    ("period of the small swing", "period", " s", "0.288 ± 0.003 s"),
    ("damping ratio", "damping_ratio", "", "0.037 ± 0.003"),
)
"""Figures of the packaged damper, and what an independent simulation gave."""


def _packaged_damper(results: Results) -> str:
    lines = ["| figure | here | expected |", "|---|---|---|"]
    for words, figure, unit, expected in EXPECTED:
        sample = results.sample(damper_name(MASSES[0]), figure)
        value = "—" if sample is None else f"{sample.values.mean():.4g}{unit}"
        lines.append(f"| {words} | {value} | {expected} |")
    return "\n".join(lines)


def _damper_law(results: Results) -> str:
    """How de Paula's law follows the swing, over the drag."""
    lines = [
        "| drag of a grain | damping ratio | left over by de Paula's law | by the linear one | "
        "alpha/omega in de Paula's scaling |",
        "|---|---|---|---|---|",
    ]
    for drag in GAMMAS:
        name = damper_name(MASSES[1], drag)
        result = [
            results.sample(name, item)
            for item in ("damping_ratio", "free_misfit", "free_linear_misfit", "alpha_over_omega")
        ]
        known = [float(item.values.mean()) for item in result if item is not None]
        if len(known) == len(result):
            lines.append(
                f"| {drag:g} kg/s | {known[0]:.3f} | {100.0 * known[1]:.1f} % | "
                f"{100.0 * known[2]:.1f} % | {known[3]:.3f} |"
            )
    unit = results.sample(damper_name(MASSES[1], SOURCE_DRAG), "unit")
    if unit is None:
        return _wrapped("De Paula's damper: its runs are not done.")
    tail = (
        "De Paula's curve has alpha/omega = 0.162 and the damping ratio 0.427. The thesis prints "
        "no drag for its damper, and no unit of time: one of "
        f"{unit.values.mean():.3f} s would make omega its 1.05."
    )
    return "\n".join([*lines, "", _wrapped(tail)])


def _falls(results: Results) -> str:
    return _wrapped(words_on_falls(results.calculations.get("falls", {})))


def _wrapped(text: str) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(text, WIDTH, break_long_words=False, break_on_hyphens=False))
