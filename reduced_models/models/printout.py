"""Blocks of all print-outs: the record, the figures of its motion, the model, cautions.

`identify`, `fit`, `discover`, `compare` and `design` put them together, so that each says the same
thing in the same words: natural frequency f0, damping ratio zeta, equilibrium z0, held-out cycles,
rms displacement, caution.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence

from granular.shared.blocks import align_columns, format_number
from granular.shared.terminal import COLUMNS
from reduced_models.models.quantities import (
    DAMPING_RATIO,
    ERROR_SOURCES,
    LEVEL,
    PARTS,
    QuantityWithError,
    format_fixed,
    format_interval,
)

_SKEW = 0.2  # distance of an interval's middle from the value, over its half-width
_EXACT = 1e-6  # a relative error below it is that of the arithmetic
_JOIN = "\N{NO-BREAK SPACE}"  # within a parameter and its error, which no line breaks


def record_lines(texts: Sequence[str]) -> list[str]:
    """Title of a record, and below it what is known of its samples."""
    return [line for k, text in enumerate(texts) for line in wrap_words(text, "  " * (k > 0))]


def figure_rows(figures: Sequence[QuantityWithError], mass: float | None = None) -> list[list[str]]:
    """Label, symbol, value with error, and remark of each printed figure; mass [kg]."""
    known = {figure.name: figure for figure in figures}
    ratios = [name for name in known if name.startswith(DAMPING_RATIO)]
    remarks = {name: _damping_ratio_text(known[name]) for name in ratios}
    if (damping := known.get("damping")) is not None:
        of_mass = "" if mass is None else f" (for {mass:.4g} kg)"
        remarks["stiffness"] = f"damping c {damping.text_with_error}{of_mass}"
    if (damped := known.get("damped frequency")) is not None:
        remarks["natural frequency"] = f"damped {_format_derived(damped)} Hz"
    rows = [
        [known[name].label, known[name].symbol, known[name].text_with_error, remarks.get(name, "")]
        for name in ("natural frequency", *ratios, "friction", "stiffness", LEVEL)
        if name in known
    ]
    # Motion over two wells has figures of its own.
    return rows or [[item.name, item.symbol, item.text_with_error, ""] for item in figures]


def error_sources_text(figures: Sequence[QuantityWithError], confidence: float) -> str:
    """Level of the intervals behind the figures, and the sources of their errors."""
    parts = [part for part in PARTS if any(part in figure.parts for figure in figures)]
    sources = ", ".join(ERROR_SOURCES[part] for part in parts)
    if "start" in parts:  # of a simulation, whose forces are taken as they are
        sources += "; force laws and parts taken as exact"
    return f"these ± are {100.0 * confidence:g} % intervals: {sources}"


def figure_lines(
    figures: Sequence[QuantityWithError],
    mass: float | None = None,
    confidence: float = 0.95,
    amplitude: str = "",
) -> list[str]:
    """Lines of the figures that are printed, their range of amplitudes, and the sources of their errors."""
    rows = figure_rows(figures, mass)
    if not rows:
        return []
    margin = sum(max(len(row[k]) for row in rows) for k in (0, 1)) + 6
    lines = [f"  {line}" for line in align_columns(rows).splitlines()]
    if amplitude:
        lines += wrap_words(amplitude, "  amplitude".ljust(margin), " " * margin)
    if any(figure.total_error for figure in figures):
        lines.append(f"  {error_sources_text(figures, confidence)}")
    return lines


def _damping_ratio_text(ratio: QuantityWithError) -> str:
    """Amplitude that a damping ratio [%] is of, its logarithmic decrement and its quality factor."""
    where = ratio.name.removeprefix(DAMPING_RATIO).strip()
    words = f"of critical{' ' * bool(where)}{where}"
    value = ratio.value / 100.0
    if not 0.0 < value < 1.0:
        return words
    relative = ratio.total_error / ratio.value
    decrement, quality = (
        _format_derived(ratio._replace(value=size, parts={"fit": relative * size}))
        for size in (math.tau * value / math.sqrt(1.0 - value**2), 0.5 / value)
    )
    return f"{words}; log decrement {decrement}, Q {quality}"


def _format_derived(item: QuantityWithError) -> str:
    """Value that follows from others and stands without an error: at most four digits."""
    most = 3 - math.floor(math.log10(abs(item.value)))
    return format_fixed(item.value, min(item.decimals, most))


def equation_lines(
    equation: str, parameters: Sequence[QuantityWithError], intervals: Mapping[str, tuple[float, float]]
) -> list[str]:
    """Equation, and parameters with their errors, or with intervals that are not about their values."""
    values = (parameter_text(item, intervals.get(item.name)) for item in parameters)
    return [*wrap_words(equation), *wrap_words(", ".join(value.replace(" ", _JOIN) for value in values))]


def parameter_text(item: QuantityWithError, interval: tuple[float, float] | None) -> str:
    """Name and value of a parameter with its error, or with an interval that is not about the value."""
    if interval is not None and set(item.parts) == {"fit"} and math.isfinite(item.total_error):
        low, high = interval
        if abs(low + high - 2.0 * item.value) > _SKEW * (high - low):
            ends = format_interval(low, high, item.decimals)
            return f"{item.name} {item.text_without_error} ({ends})"
    return f"{item.name} {item.text_with_error}"


def caution_lines(cautions: Sequence[str], most: int | None = None) -> list[str]:
    """Cautions, the gravest first; whole ones alone where there are at most so many lines for them."""
    lines: list[str] = []
    for count, words in enumerate(dict.fromkeys(cautions)):
        new = wrap_words(f"caution: {words}", "", "  ")
        left = len(dict.fromkeys(cautions)) - count
        if most is not None and lines and len(lines) + len(new) + (left > 1) > most:
            return [*lines, f"{left} more: --verbose, or the report"]
        lines += new
    return lines


def wrap_words(words: str, indent: str = "  ", later: str = "    ") -> list[str]:
    """Lines of at most a hundred columns that break at spaces alone."""
    lines = textwrap.wrap(
        words, COLUMNS, initial_indent=indent, subsequent_indent=later, break_on_hyphens=False
    )
    return [line.replace(_JOIN, " ") for line in lines]


def format_percent(fraction: float, standard_error: float = 0.0) -> str:
    """Error in per cent, with its standard error where there is one; "diverges" for an infinite one."""
    if math.isinf(fraction):
        return "diverges"
    if 0.0 < fraction < _EXACT:
        return f"< {100.0 * _EXACT:.4f} %"
    spread = f" ± {format_number(100.0 * standard_error, 2)}" if standard_error else ""
    percent = f"{100.0 * fraction:.3g}" if fraction < 10.0 else f"{100.0 * fraction:.0f}"
    return f"{percent}{spread} %"
