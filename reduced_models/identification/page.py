"""Blocks of the report of an identification: results, residuals, and each law."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence

from granular.records.options import RecordSource
from granular.shared.blocks import (
    Block,
    Caution,
    Equation,
    Heading,
    Table,
    Text,
    format_number,
    make_cautions,
)
from granular.shared.errors import format_factor
from granular.shared.html_pages import Page, page_footer
from granular.shared.version import current_command_line
from reduced_models.fitting.residual_diagnostics import ResidualTests
from reduced_models.identification.comparison_table import Comparison
from reduced_models.identification.elliptic_averaging import LOWER_WELL
from reduced_models.identification.pictures import comparison_section, drawn_coordinate_of_residuals
from reduced_models.laws.printing import (
    equation_as_mathml,
    hidden_rate_as_mathml,
    parameter_symbol,
    round_expression,
)
from reduced_models.models.model import OPEN, ReducedModel
from reduced_models.models.observed import CYCLE_COLUMNS, force_cycle_rows
from reduced_models.models.quantities import (
    DAMPING_RATIO,
    LEVEL,
    PARTS,
    QuantityWithError,
    decimal_places_of_interval,
    error_sources_text,
    format_fixed,
    format_interval,
    parameter_text,
    quantity_rows,
)

__all__ = ["comparison_page"]

LIBRARIES = ("scipy", "sympy", "jax", "jaxlib", "pandas", "matplotlib")
"""Libraries whose versions are given on a page of fits."""


def comparison_page(table: Comparison) -> Page:
    """Make a page of a comparison of laws.

    Parameters
    ----------
    table : Comparison
        Comparison of laws.

    Returns
    -------
    Page
        Page with verdict, table and plot; notebooks display it, and ``save`` writes it to a file.
    """
    blocks = [*comparison_section(table)]
    for row in table.rows:
        for model in row.models[:1]:
            blocks += law_section(model, " (first)" if row is table.rows[0] else "")
    return Page("Laws compared", table.verdict, blocks, page_footer(LIBRARIES), table)


def capitalise(words: str) -> str:
    """Return the text with its first letter capitalised."""
    return words[:1].upper() + words[1:]


def answer_blocks(
    figures: Sequence[QuantityWithError],
    model: ReducedModel,
    mass: float | None,
    parameters: Sequence[QuantityWithError],
) -> Iterator[Block]:
    """Make the first blocks: results, equation and parameters as in the print-out; ``mass`` is in kg."""
    rows = quantity_rows(figures, mass)
    if rows:
        yield Table(("", "", "value", ""), rows)
    elif model.law.prescribed:
        if model.cycles:
            yield Table(CYCLE_COLUMNS, force_cycle_rows(model))
    else:
        yield Caution(f"No oscillation about an equilibrium: {model.no_swing}.")
    yield from equation_blocks(model)
    values = (
        parameter_text(item, model.intervals.get(item.name))
        for item in (parameters or model.parameter_quantities())
    )
    yield Text(f"{model.law.name}: {', '.join(values)}")
    if rows:  # the sentence follows the last ± to which it applies
        yield Text(f"{capitalise(error_sources_text(figures, model.confidence))}.")


def record_source_section(source: RecordSource | None) -> Iterator[Block]:
    """List a record's file, digest and calibration, notes on its samples, and the command."""
    rows = [("command", current_command_line())]
    if source is not None:
        rows += [("file" if not source.scene else "scene", source.name), ("SHA-256", source.digest)]
        rows += [("calibration", source.calibration), *(("samples", note) for note in source.notes)]
    rows = [row for row in rows if row[1]]
    if rows:
        yield Heading("Source of the record")
        yield Table(("", ""), rows)


def oscillation_section(
    figures: Sequence[QuantityWithError], model: ReducedModel, mass: float | None, averaging: str
) -> Iterator[Block]:
    """List a law's equilibrium, frequency, damping and stiffness, and contributions to their errors."""
    if not figures:
        return
    yield Heading("Frequency, damping, stiffness and equilibrium by the model")
    rows = [(printed_name_of_quantity(item), item.symbol, item.table_cell, item.unit) for item in figures]
    yield Table(("figure", "symbol", "value", "unit"), rows)
    yield Text(_oscillation_explanation(figures, model, mass))
    known = [name for name in PARTS if any(name in figure.parts for figure in figures)]
    if len(known) > 1:
        yield Text("The error after ± is the root of the sum of squares of these numerical errors:")
        errors = [
            (
                printed_name_of_quantity(figure),
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


def printed_name_of_quantity(figure: QuantityWithError) -> str:
    """Return the name of a quantity as in the print-out."""
    return figure.label if figure.name == LEVEL else figure.name


_FOLLOWING = ("fd", "delta", "Q")
"""Symbols of quantities that are computed, with their errors, from frequency and damping ratio."""
_MEANING_OF_PARTS = {
    "fit": "Fit: half-width of the {:g} % interval, computed from the residual (noise or misfit) of the law.",
    "step": "Step: change of the fitted value if the time step is doubled (if a doubled step is too coarse, "
    "estimated from half the step and the order of the method). A change about as large as the start error "
    "is due to a different packing and not to the time step.",
    "start": "Start: half-width of the interval that contains the value of another random packing in 95 % of "
    "the cases. If the table of settled beds contains this bed, the spread in the table is pooled with "
    "the spread of the simulated packings (Smyth 2004). Otherwise Student's t for a further value gives "
    "the half-width (6.1 standard deviations for three packings).",
    "calibration": "Calibration: uncertainty from the scale and zero of the sensor.",
}


def _oscillation_explanation(
    figures: Sequence[QuantityWithError], model: ReducedModel, mass: float | None
) -> str:
    if any(figure.name == LOWER_WELL for figure in figures):
        return (
            f"From the fit of {model.law.name}, with its damping set to zero. The frequencies in the "
            "wells are for small oscillations; the frequency over both wells is for the motion "
            "from the initial state of the record."
        )
    small = "small " * (model.at_rest is None or model.at_rest.equivalent is None)
    words = f"For {small}oscillations about equilibrium, from the fit of {model.law.name}. "
    names = {figure.name for figure in figures}
    words += "The natural frequency is the undamped frequency. "
    if DAMPING_RATIO in names:
        words += (
            "The damping ratio is the fraction of critical damping; the logarithmic decrement is the "
            "logarithm of the ratio of two amplitudes one period apart; the quality factor is the inverse "
            "of twice the damping ratio. "
        )
    elif any(name.startswith(DAMPING_RATIO) for name in names):
        words += (
            "A damping ratio at an amplitude is the energy loss of a harmonic cycle of this amplitude, "
            "divided by 4π times the energy of the oscillation. Friction is the coefficient of the "
            "velocity's sign in the law. "
            "If the law has no such term, the equivalent friction is the constant friction force that, "
            "together with a dashpot, gives the same losses at the two amplitudes in the table. "
        )
    if model.coordinate_unit == "rad":
        return words + "Stiffness and damping are divided by the moment of inertia."
    if mass is None:
        return words + (
            "Stiffness and damping are per kilogram of moving mass; --mass gives them in N/m and N s/m."
        )
    return words + (
        f"Stiffness and damping are the constants of a spring and a dashpot with which a mass of {mass:.6g} "
        "kg oscillates in the same way."
    )


def residual_tests_section(
    tests: Mapping[str, ResidualTests], measured: str, coordinate_unit: str
) -> Iterator[Block]:
    """Residuals of each law, and tests of whether they are noise."""
    if not tests:
        return
    _, unit, scale = drawn_coordinate_of_residuals(measured, coordinate_unit)
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
        "White: probability that white noise is as strongly correlated as the residual (Dalla, Giraitis and "
        "Phillips). Signs: probability that the sign of white noise changes as rarely (Wald and Wolfowitz). "
        "At f and at 2f: power near the oscillation frequency f and near 2f, relative to the power at "
        "neighbouring frequencies; about 1 for residuals without structure. Structured residuals show that "
        "the law lacks an effect; their rms gives the size of the effect. A release transient that decays "
        "within one period is reported separately and excluded from the tests; the rms includes it."
    )


def _format_probability(value: float) -> str:
    return "< 0.001" if value < 1e-3 else format_number(value, 2)


def law_section(model: ReducedModel, remark: str) -> Iterator[Block]:
    """Describe a fitted law: equations, parameters, notes and quality of the fit."""
    yield Heading(f"{model.law.name}{remark}")
    yield from equation_blocks(model)
    meaning = f"z is the {model.coordinate} in {'radians' if model.coordinate_unit == 'rad' else 'metres'}"
    if model.law.parsed_equation.line is not None:
        meaning = f"z is dimensionless and determines the {model.coordinate}"
    yield Text(f"Source of the law: {model.law.source or 'user-defined'}; t is in seconds, {meaning}.")
    yield Table(
        ("parameter", "value", "unit", f"{100 * model.confidence:g} % interval"), _parameter_rows(model)
    )
    # Undetermined directions are written with the symbols of their parameters.
    directions = []
    for product in model.undetermined:
        named = {parameter_symbol(name): power for name, power in product.powers.items()}
        directions.append(str(dataclasses.replace(product, powers=named)))
    yield from make_cautions(f"{capitalise(note)}." for note in (*directions, *model.notes))
    yield Text(_fit_quality_text(model))


def equation_blocks(model: ReducedModel) -> Iterator[Block]:
    """Show the law with symbols and with numbers, and the initial values of its hidden states."""
    symbols = {
        name: round_expression(rate, model.printed_digits) for name, rate in model.law.sympy_hidden().items()
    }
    for equation, rates, words in (
        (model.equation, symbols, model.law.equation),
        (model.printed_equation, model.printed_hidden_rates, ""),
    ):
        yield Equation(equation_as_mathml(equation), words)
        for name, rate in rates.items():
            yield Equation(hidden_rate_as_mathml(name, rate))
    if model.law.parsed_equation.line is not None:
        yield Equation(equation_as_mathml(model.printed_height))
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
        f"{model.error_reference_text.removeprefix('of ')}, over {quality.samples} samples. "
        f"Search: {quality.search_text}."
    )
    if quality.test_error is not None:
        words += (
            f" Fitted without {quality.held_out_part_text}, the law predicts them with an error of "
            f"{100 * quality.test_error:.3g} % {model.error_reference_text}."
        )
    if quality.test_error_at_rest is not None and not model.law.prescribed:
        words += (
            f" A piston that stays at equilibrium would have an error of "
            f"{100 * quality.test_error_at_rest:.3g} %; only a smaller error supports the law."
        )
    return words


def _parameter_rows(model: ReducedModel) -> list[Sequence[str]]:
    rows: list[Sequence[str]] = []
    for name, value in model.parameters.items():
        low, high = model.intervals[name]
        size = math.floor(math.log10(abs(value))) if value else 0
        # Digits follow the interval, but are not fewer than in the equation.
        digits = max(decimal_places_of_interval(value, low, high), model.printed_digits - 1 - size)
        interval = "open" if high - low > OPEN * abs(value) else format_interval(low, high, digits)
        rows.append(
            (parameter_symbol(name), format_fixed(value, digits), model.unit_of_parameter(name), interval)
        )
    return rows
