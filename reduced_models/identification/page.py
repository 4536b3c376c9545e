"""Blocks of the report of an identification: the figures, what is left over, and each law."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence

from granular.records.options import RecordSource
from granular.shared.blocks import Block, Caution, Equation, Heading, Table, Text, cautions, format_number
from granular.shared.errors import format_factor
from granular.shared.html_pages import Page, made_with
from granular.shared.version import current_command
from reduced_models.fitting.residual_diagnostics import ResidualTests
from reduced_models.identification.comparison_table import Comparison
from reduced_models.identification.elliptic_averaging import LOWER_WELL
from reduced_models.identification.pictures import comparison_section, residual_axis
from reduced_models.laws.printing import mathml, mathml_of_rate, parameter_symbol, round_expression
from reduced_models.models.model import OPEN, ReducedModel
from reduced_models.models.observed import CYCLE_COLUMNS, cycle_rows
from reduced_models.models.quantities import (
    DAMPING_RATIO,
    LEVEL,
    PARTS,
    QuantityWithError,
    decimal_places_of_interval,
    error_sources_text,
    figure_rows,
    format_fixed,
    format_interval,
    parameter_text,
)

__all__ = ["comparison_page"]

LIBRARIES = ("scipy", "sympy", "jax", "jaxlib", "pandas", "matplotlib")
"""Whose versions a page of fits names."""


def comparison_page(table: Comparison) -> Page:
    """Make a page of a comparison of laws.

    Parameters
    ----------
    table : Comparison
        Comparison of laws.

    Returns
    -------
    Page
        Page with verdict, table and picture; a notebook shows it, and ``save`` writes it.
    """
    blocks = [*comparison_section(table)]
    for row in table.rows:
        for model in row.models[:1]:
            blocks += law_section(model, " (first)" if row is table.rows[0] else "")
    return Page("Laws compared", table.verdict, blocks, made_with(LIBRARIES), table)


def capitalise(words: str) -> str:
    """Return words with a capital in front."""
    return words[:1].upper() + words[1:]


def answer(
    figures: Sequence[QuantityWithError],
    model: ReducedModel,
    mass: float | None,
    parameters: Sequence[QuantityWithError],
) -> Iterator[Block]:
    """Figures, equation and parameters as the print-out has them, for the first screen; mass [kg]."""
    rows = figure_rows(figures, mass)
    if rows:
        yield Table(("", "", "value", ""), rows)
    elif model.law.prescribed:
        if model.cycles:
            yield Table(CYCLE_COLUMNS, cycle_rows(model))
    else:
        yield Caution(f"No oscillation about an equilibrium: {model.no_swing}.")
    yield from equations(model)
    values = (
        parameter_text(item, model.intervals.get(item.name))
        for item in (parameters or model.parameter_quantities())
    )
    yield Text(f"{model.law.name}: {', '.join(values)}")
    if rows:  # behind the last ± that it is true of
        yield Text(f"{capitalise(error_sources_text(figures, model.confidence))}.")


def source_section(source: RecordSource | None) -> Iterator[Block]:
    """File, digest and calibration of a record, notes on its samples, and the command."""
    rows = [("command", current_command())]
    if source is not None:
        rows += [("file" if not source.scene else "scene", source.name), ("SHA-256", source.digest)]
        rows += [("calibration", source.calibration), *(("samples", note) for note in source.notes)]
    rows = [row for row in rows if row[1]]
    if rows:
        yield Heading("Where the record comes from")
        yield Table(("", ""), rows)


def swing_section(
    figures: Sequence[QuantityWithError], model: ReducedModel, mass: float | None, averaging: str
) -> Iterator[Block]:
    """Level, frequency, damping and stiffness of the law's swing, and the parts of their errors."""
    if not figures:
        return
    yield Heading("Frequency, damping, stiffness and equilibrium by the model")
    rows = [(name_in_table(item), item.symbol, item.table_cell, item.unit) for item in figures]
    yield Table(("figure", "symbol", "value", "unit"), rows)
    yield Text(_swing_explanation(figures, model, mass))
    known = [name for name in PARTS if any(name in figure.parts for figure in figures)]
    if len(known) > 1:
        yield Text("The error behind ± is numerical, the root of the sum of squares of its sources:")
        errors = [
            (
                name_in_table(figure),
                *(format_number(figure.parts[name], 2) if name in figure.parts else "" for name in known),
                figure.unit,
            )
            for figure in figures
            if figure.symbol not in _FOLLOWING
        ]
        yield Table(("figure", *known, "unit"), errors)
    yield Text(" ".join(_MEANING_OF_PARTS[name].format(100 * model.confidence) for name in known))
    if averaging:
        yield Text(f"{capitalise(averaging)}.")


def name_in_table(figure: QuantityWithError) -> str:
    """Name a figure as the print-out does."""
    return figure.label if figure.name == LEVEL else figure.name


_FOLLOWING = ("fd", "delta", "Q")
"""Symbols of figures whose errors are those of frequency and damping ratio over again."""
_MEANING_OF_PARTS = {
    "fit": "Fit: half of the {:g} % interval by what the law leaves of the record, noise or misfit.",
    "step": "Step: what twice the time step changes in the same fit (half of it, and the order of the "
    "method, where twice is too coarse); where it is not below the part of the starts, it shows how the "
    "bed packs, not the error of the step.",
    "start": "Start: how far another random start of the bed may lie, with 95 %: the standard deviation "
    "over those that were run, times Student's factor (4.3 for three).",
    "calibration": "Calibration: what the uncertainty of the sensor's scale and zero leaves open.",
}


def _swing_explanation(figures: Sequence[QuantityWithError], model: ReducedModel, mass: float | None) -> str:
    if any(figure.name == LOWER_WELL for figure in figures):
        return (
            f"From the fit of {model.law.name}, without damping: frequencies in the wells are those of small "
            "motions, the other is that of the motion from the record's start."
        )
    small = "small " * (model.at_rest is None or model.at_rest.equivalent is None)
    words = f"Of the {small}swing about rest, from the fit of {model.law.name}. "
    names = {figure.name for figure in figures}
    words += "The natural frequency is that without damping. "
    if DAMPING_RATIO in names:
        words += (
            "The damping ratio is the damping over that at which nothing swings; the logarithmic decrement "
            "is the logarithm of two amplitudes a period apart, and the quality factor the inverse of twice "
            "the damping ratio. "
        )
    elif any(name.startswith(DAMPING_RATIO) for name in names):
        words += (
            "A damping ratio at an amplitude is the energy that a harmonic cycle of it loses, over "
            "4π times that of its swing. Friction is the coefficient of the velocity's sign in the law; "
            "where it has none, an equivalent friction is the constant force that, next to a dashpot, "
            "loses as much at both. "
        )
    if model.coordinate_unit == "rad":
        return words + "Stiffness and damping are over the moment of inertia."
    if mass is None:
        return words + (
            "Stiffness and damping are per kilogram of what moves; --mass gives them in N/m and N s/m."
        )
    return words + (
        f"Stiffness and damping are those of a spring and a dashpot on which a mass of {mass:.6g} kg "
        "swings alike."
    )


def residual_tests_section(
    tests: Mapping[str, ResidualTests], measured: str, coordinate_unit: str
) -> Iterator[Block]:
    """Residuals of each law, and whether they are noise."""
    if not tests:
        return
    _, unit, scale = residual_axis(measured, coordinate_unit)
    rows = [
        (
            name,
            test.verdict,
            f"{format_number(scale * test.rms, 3)} {unit}",
            format_factor(test.swing),
            format_factor(test.double),
            _format_probability(test.whiteness),
            _format_probability(test.signs),
        )
        for name, test in tests.items()
    ]
    yield Heading("Residuals of the laws")
    yield Table(("law", "verdict", "rms", "at f", "at 2f", "white", "signs"), rows)
    yield Text(
        "White and signs: probabilities that white noise is correlated as much (Dalla, Giraitis and "
        "Phillips), and that its signs change as seldom (Wald and Wolfowitz). At f and at 2f: power about "
        "the swing's frequency, and about twice it, over that of the frequencies next to them; about 1 "
        "where a law leaves no structure. A law that leaves structure misses something; the rms "
        "says how much. What a release stirs up besides the swing, and which has faded within a period, is "
        "named and left out of these tests; the rms is that of the whole record."
    )


def _format_probability(value: float) -> str:
    return "< 0.001" if value < 1e-3 else format_number(value, 2)


def law_section(model: ReducedModel, remark: str) -> Iterator[Block]:
    """Fitted law: its equations, parameters, notes and quality."""
    yield Heading(f"{model.law.name}{remark}")
    yield from equations(model)
    meaning = f"z is the {model.coordinate} in {'radians' if model.coordinate_unit == 'rad' else 'metres'}"
    if model.law.parsed_equation.line is not None:
        meaning = f"z a pure number, from which the {model.coordinate} follows"
    yield Text(f"Source of the law: {model.law.source or 'own'}; t is in seconds, {meaning}.")
    yield Table(
        ("parameter", "value", "unit", f"{100 * model.confidence:g} % interval"), _parameter_rows(model)
    )
    # Open directions have the signs of their parameters as formulas have them.
    directions = []
    for product in model.undetermined:
        named = {parameter_symbol(name): power for name, power in product.powers.items()}
        directions.append(str(dataclasses.replace(product, powers=named)))
    yield from cautions(f"{capitalise(note)}." for note in (*directions, *model.notes))
    yield Text(_fit_quality_text(model))


def equations(model: ReducedModel) -> Iterator[Block]:
    """Law with symbols and with its numbers, and those of its hidden states."""
    symbols = {
        name: round_expression(rate, model.printed_digits) for name, rate in model.law.sympy_hidden().items()
    }
    for equation, rates, words in (
        (model.equation, symbols, model.law.equation),
        (model.printed_equation, model.printed_hidden_rates, ""),
    ):
        yield Equation(mathml(equation), words)
        for name, rate in rates.items():
            yield Equation(mathml_of_rate(name, rate))
    if model.law.parsed_equation.line is not None:
        yield Equation(mathml(model.printed_height))
    if model.law.hidden:
        starts = (f"{name} = {format_number(model.hidden.get(name, 0.0), 3)}" for name in model.law.hidden)
        yield Text(f"At the start {', '.join(starts)}.")


def _fit_quality_text(model: ReducedModel) -> str:
    quality = model.quality
    size, unit = (180.0 / math.pi, "degrees") if model.coordinate_unit == "rad" else (1e6, "micrometres")
    if model.law.prescribed:
        size, unit = 1.0, "N"
    words = (
        f"Residual {size * quality.residual:.3g} {unit}, {100 * quality.relative:.3g} % of "
        f"{model.rms_noun.removeprefix('of ')}, over {quality.samples} samples. {quality.converged} of "
        f"{quality.starts} random starts led to this fit."
    )
    if quality.test_error is not None:
        words += (
            f" Fitted without {quality.test_swings_text} it predicts them to "
            f"{100 * quality.test_error:.3g} % {model.rms_noun}."
        )
    if quality.test_error_at_rest is not None and not model.law.prescribed:
        words += (
            f" A motionless piston at equilibrium would score "
            f"{100 * quality.test_error_at_rest:.3g} % there; "
            "only a smaller error speaks for the law."
        )
    return words


def _parameter_rows(model: ReducedModel) -> list[Sequence[str]]:
    rows: list[Sequence[str]] = []
    for name, value in model.parameters.items():
        low, high = model.intervals[name]
        size = math.floor(math.log10(abs(value))) if value else 0
        # As many digits as the interval is worth, and no fewer than the equation has.
        digits = max(decimal_places_of_interval(value, low, high), model.printed_digits - 1 - size)
        interval = "open" if high - low > OPEN * abs(value) else format_interval(low, high, digits)
        rows.append(
            (parameter_symbol(name), format_fixed(value, digits), model.unit_of_parameter(name), interval)
        )
    return rows
