"""An identification on one screen: at most twenty lines of at most a hundred columns."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from granular.shared.text_tables import align_columns
from reduced_models.falls.unseen_fall_scores import DropScores, format_percent_of_drop
from reduced_models.identification.comparison_table import Comparison, format_percent, root_mean_square
from reduced_models.identification.result import Identification
from reduced_models.identification.swing_quantities import DAMPING_RATIO, PARTS, swing_noun
from reduced_models.models.model import ReducedModel

COLUMNS = 100
"""Width of a line."""
LINES = 19
"""Most lines above the one that names the report."""
_FEWEST_LAWS = 2  # of the table of laws; the report has all
_LEAST_DIGITS = 4  # of a parameter


def summary_before_checks(result: Identification) -> str:
    """Own swing, equation and figures of an identification whose checks are not done yet."""
    lines = [*_measured_lines(result), *_equation_lines(result), *_swing_figure_lines(result)]
    return "\n".join([*lines, "checks go on: step, random starts, another lift, other falls"])


def terminal_summary(result: Identification) -> str:
    """Own swing, equation, figures, laws, falls, and what to doubt, of an identification."""
    lines = [*_measured_lines(result), *_equation_lines(result), *_swing_figure_lines(result)]
    end = []
    if result.falls is not None:
        end.append(_shorten_line(_fall_errors_text(result.falls)))
    if doubts := _collect_doubts(result):
        first = f"to doubt: {doubts[0]}"
        fits = len(doubts) == 1 and len(first) <= COLUMNS
        end.append(first if fits else _shorten_line(first, f" ({len(doubts)} in all: --verbose)"))
    laws = _law_error_lines(result.comparison)
    free_lines = max(LINES - len(lines) - len(end), _FEWEST_LAWS + 2)
    return "\n".join([*lines, *laws[:free_lines], *end])


def _measured_lines(result: Identification) -> list[str]:
    """Frequency and damping of the record itself, and whether the law agrees."""
    own = result.own
    if own is None:
        return []
    by = "extremes" if own.record.method == "envelope" else "restoring force"
    rows = [
        (f"  at {own.amplitude_text(k)}", *(figure.text_with_error for figure in own.quantities_at(k)))
        for k in own.headline_indices
    ]
    header = f"frequency and damping ratio at an amplitude, by the record's own {by}, without a law:"
    agreement = _shorten_line(f"  {own.agreement_text}")
    lines = [_shorten_line(header), *align_columns(rows).splitlines()]
    return [*lines, agreement] if own.law_agrees else [_shorten_line(own.agreement_text), *lines]


def _shorten_line(words: str, end: str = "") -> str:
    """Return words in one line, cut where they are long, and an end that is never cut."""
    indent = words[: len(words) - len(words.lstrip())]
    return indent + textwrap.shorten(words, COLUMNS - len(indent) - len(end), placeholder=" ...") + end


def _equation_lines(result: Identification) -> list[str]:
    model = result.best
    count = sum(not row.failure for row in result.comparison.rows)
    choice = f"the best of {count} laws" if count > 1 else "the law"
    meaning = f"z is the {'angle in radians' if model.angle else 'height in metres'}"
    if model.law.mapped:
        meaning = f"{model.map_text(_LEAST_DIGITS)}, a pure number,"
    values = [
        f"{name} = {value:.{max(_LEAST_DIGITS, model.printed_digits)}g} {model.unit_of_parameter(name)}"
        for name, value in model.parameters.items()
    ]
    return [
        *_wrap_in_two_lines(f"{choice} is {model.law.name}, where {meaning} and ' the rate of change:", ""),
        *_wrap_in_two_lines(model.law.equation),
        *_wrap_in_two_lines("with " + ", ".join(value.removesuffix(" 1") for value in values)),
    ]


def _wrap_in_two_lines(words: str, indent: str = "  ") -> list[str]:
    return textwrap.wrap(
        words,
        COLUMNS,
        initial_indent=indent,
        subsequent_indent=indent + "  ",
        max_lines=2,
        placeholder=" ...",
        break_on_hyphens=False,
    )


def _swing_figure_lines(result: Identification) -> list[str]:
    """Rest, frequency, damping and stiffness with their total errors."""
    known = {figure.name: figure for figure in result.figures_to_print}
    if not known:
        return ["it has no level of rest near the record, so no small swing can be told"]
    meanings = {
        "natural frequency": "without damping",
        DAMPING_RATIO: "of the damping at which nothing swings",
    }
    shown = [name for name in known if name.startswith(("level", "natural", DAMPING_RATIO, "friction"))]
    rows = [(f"  {name}", known[name].text_with_error, meanings.get(name, "")) for name in shown]
    parts = [part for part in PARTS if any(part in figure.parts for figure in result.figures)]
    of = f"total error: {', '.join(parts)}" if len(parts) > 1 else "error of the fit"
    header = f"{swing_noun(result.model_of_figures)} about rest by {result.figures_law} (± {of}):"
    return [_shorten_line(header), *align_columns(rows).splitlines(), *_spring_line(result)]


def _spring_line(result: Identification) -> list[str]:
    """Stiffness and damping, told as what they are of."""
    spring, dashpot = result.figure("stiffness"), result.figure("damping")
    if spring is None:
        return []
    if result.record.angle:
        words = f"  stiffness over moment of inertia {spring.text_with_error}"
        return [words if dashpot is None else f"{words}, damping over it {dashpot.text_with_error}"]
    mass = "a mass" if result.mass is None else f"{result.mass:.4g} kg"
    words = f"  as {mass} on a spring of {spring.text_with_error}"
    return [
        _shorten_line(words if dashpot is None else f"{words} with a dashpot of {dashpot.text_with_error}")
    ]


def _law_error_lines(table: Comparison) -> list[str]:
    """Errors of the laws on what they have not seen, the best first."""
    sound = [row for row in table.rows if not row.failure]
    lifted = bool(sound[0].records)
    rows = [("  law", "parameters", "test swings", *(["higher lift"] if lifted else []))]
    for row in sound:
        later = format_percent(root_mean_square(row.stretches)) if row.stretches else "-"
        lifts = [format_percent(record.relative) for record in row.records]
        rows.append((f"  {row.name}", str(row.parameters), later, *lifts))
    rest = f"standing still: {format_percent(table.at_rest)}"
    return [
        _shorten_line(f"errors on what no law has seen, in % of the rms swing ({rest}):"),
        *(_shorten_table_line(line) for line in align_columns(rows).splitlines()),
    ]


def _shorten_table_line(line: str) -> str:
    return line if len(line) <= COLUMNS else f"{line[: COLUMNS - 4]} ..."


def _fall_errors_text(falls: DropScores) -> str:
    """Errors of the laws that predict unseen falls best."""
    errors = [
        f"{row.name} {format_percent_of_drop(row.median_error)}"
        for row in falls.rows
        if row.model is not None
    ]
    return f"other falls, errors in % of the drop (median): {', '.join(errors[:2])}"


def _collect_doubts(result: Identification) -> Sequence[str]:
    """Doubts, the gravest first."""
    best: ReducedModel = result.best
    words = [*result.notes, *best.notes, *result.advice]
    if result.figures and result.figures_law != best.law.name:
        words.append(f"the figures are those of {result.figures_law}")
    return tuple(dict.fromkeys(words))
