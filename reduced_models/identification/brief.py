"""An identification on one screen: at most twenty lines of at most a hundred columns."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

from granular.shared.tables import align_columns
from reduced_models.falls.scores import DropScores, percent_of_drop
from reduced_models.identification.comparison_table import Comparison, as_percent, root_mean_square
from reduced_models.identification.engineering import (
    DAMPING_RATIO,
    Quantity,
    format_fixed,
    small_swing_sentence,
    widen,
)
from reduced_models.identification.result import Identification
from reduced_models.models.model import ReducedModel

COLUMNS = 100
"""Width of a line."""
MOST_LAWS = 4
"""Rows of the table of laws; the report has all."""
_LEAST_DIGITS = 4  # of a parameter
_SHOWN = ("level of rest", "natural frequency", DAMPING_RATIO, "stiffness", "damping")


def first_words(result: Identification) -> str:
    """Equation and figures of an identification whose checks are not done yet."""
    lines = [*_equation_lines(result), *_figure_lines(result)]
    return "\n".join([*lines, "checks go on: step, random starts, another lift, other falls"])


def brief(result: Identification) -> str:
    """Answer, equation, laws, falls, and what to doubt, of an identification."""
    lines = [*_equation_lines(result), *_figure_lines(result), *_law_lines(result.comparison)]
    if result.falls is not None:
        lines.append(_fit_line(_falls_text(result.falls)))
    if doubts := _doubts(result):
        lines.append(_fit_line(f"to doubt: {doubts[0]}", f" ({len(doubts)} in all: --verbose)"))
    return "\n".join(lines)


def _fit_line(words: str, end: str = "") -> str:
    """Return words in one line, cut where they are long, and an end that is never cut."""
    return textwrap.shorten(words, COLUMNS - len(end), placeholder=" ...") + end


def _equation_lines(result: Identification) -> list[str]:
    model = result.best
    count = sum(not row.failure for row in result.comparison.rows)
    choice = f"the best of {count} laws" if count > 1 else "the law"
    unit = "angle in radians" if model.angle else "height in metres"
    if model.law.mapped:
        unit = f"{model.map_text(_LEAST_DIGITS)}, a pure number"
    values = [
        f"{name} = {value:.{max(_LEAST_DIGITS, model.printed_digits)}g} {model.unit_of(name)}"
        for name, value in model.parameters.items()
    ]
    return [
        _fit_line(f"{choice} is {model.law.name}, where z is the {unit} and ' the rate of change:"),
        *_wrap(model.law.equation),
        *_wrap("with " + ", ".join(value.removesuffix(" 1") for value in values)),
    ]


def _wrap(words: str) -> list[str]:
    return textwrap.wrap(
        words, COLUMNS, initial_indent="  ", subsequent_indent="    ", max_lines=2, placeholder=" ..."
    )


def _figure_lines(result: Identification) -> list[str]:
    """Rest, frequency, damping and stiffness with what they may be off by."""
    known = [widen(quantity, result.figures) for quantity in result.engineering]
    shown = [quantity for quantity in known if quantity.name.startswith(_SHOWN)]
    if not shown:
        return ["it has no level of rest near the record, so no small swing can be told"]
    of = f"fit's {100 * result.shown.confidence:g} % interval"
    if any(figure.checked for figure in result.figures.values()):
        of = f"widest of: {of}, step's error, scatter of starts"
    mass = "1 kg" if result.mass is None else f"{result.mass:.4g} kg"
    meanings = {
        "natural frequency": "without damping",
        DAMPING_RATIO: "of the damping at which nothing swings",
        "stiffness": f"of a spring on which {mass} swings alike",
        "damping": "of a dashpot next to that spring",
    }
    if result.record.angle:
        meanings |= {"stiffness": "per moment of inertia", "damping": "per moment of inertia"}
    rows = [
        (f"  {quantity.name}", _with_error(quantity), meanings.get(quantity.name, "")) for quantity in shown
    ]
    header = f"{small_swing_sentence(result.shown)} about rest (+- {of}):"
    return [_fit_line(header), *align_columns(rows).splitlines()]


def _with_error(quantity: Quantity) -> str:
    half = 0.5 * (quantity.high - quantity.low)
    value = format_fixed(quantity.value, quantity.digits)
    error = f" +- {format_fixed(half, quantity.digits)}" if math.isfinite(half) else ", open"
    return f"{value}{error} {quantity.unit}"


def _law_lines(table: Comparison) -> list[str]:
    """Errors of the laws on what they have not seen, the best first."""
    sound = [row for row in table.rows if not row.failure]
    lifted = bool(sound[0].records)
    rows = [("  law", "parameters", "later motion", *(["higher lift"] if lifted else []))]
    for row in sound[:MOST_LAWS]:
        later = as_percent(root_mean_square(row.stretches)) if row.stretches else "-"
        lifts = [as_percent(record.relative) for record in row.records]
        rows.append((f"  {row.name}", str(row.parameters), later, *lifts))
    rest = f"a piston at rest: {as_percent(table.at_rest)}"
    return [
        _fit_line(f"errors on what no law has seen, in % of the rms swing ({rest}):"),
        *(_fit_line_of_table(line) for line in align_columns(rows).splitlines()),
    ]


def _fit_line_of_table(line: str) -> str:
    return line if len(line) <= COLUMNS else f"{line[: COLUMNS - 4]} ..."


def _falls_text(falls: DropScores) -> str:
    """Errors of the laws that predict unseen falls best."""
    errors = [f"{row.name} {percent_of_drop(row.median)}" for row in falls.rows if row.model is not None]
    return f"other falls, errors in % of the drop (median): {', '.join(errors[:2])}"


def _doubts(result: Identification) -> Sequence[str]:
    """Doubts, the gravest first."""
    best: ReducedModel = result.best
    words = [*result.notes, *best.notes, *result.advice]
    if result.figures and result.figures_law != best.law.name:
        words.append(f"the figures are those of {result.figures_law}")
    return tuple(dict.fromkeys(words))
