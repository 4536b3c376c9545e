"""Printed equations and figures have enough digits to reproduce the fit within its intervals."""

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

from granular import PistonRecord
from reduced_models import Parameter, ReducedModel, fit, load_model
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.law import HeightLine
from reduced_models.laws.linearization import (
    NoOscillationReason,
    Rates,
    SmallOscillation,
    make_acceleration_of_equation,
    make_rates_of_law,
    small_oscillation,
    small_oscillation_of_equation,
    solve_harmonic_balance,
)
from reduced_models.laws.printing import equation_as_mathml, hidden_rate_as_mathml, round_significant
from reduced_models.models.at_rest import AtRest
from reduced_models.models.printed_model import oscillation_quantities
from reduced_models.models.quantities import (
    QuantityWithError,
    caution_lines,
    equation_lines,
    format_percent,
    quantity_lines,
)
from tests.reduced_models.made import damped_cosine, half_width, noisy

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

PRINTED = (
    *("linear", "van-der-pol-like", "duffing", "polynomial-spring", "power-law-spring"),
    *("quadratic-drag", "coulomb"),
)
"""Laws that are parts of others here; laws with a hidden state are printed as two equations."""
NUMBER = r"(-?[0-9.]+(?:e[+-]?[0-9]+)?)"


def inside(model: ReducedModel, height: float, omega: float, damping: float) -> None:
    """Assert that equilibrium, period and damping ratio lie in the printed intervals."""
    rest = model.at_rest
    found = {"height": height, "period": 2.0 * math.pi / omega, "damping_ratio": damping / (2.0 * omega)}
    for name, value in found.items():
        low, high = rest.intervals[name]
        assert low <= value <= high, name


def damping_ratio(rest: AtRest, rates: Rates, swing: SmallOscillation, hidden: int = 0) -> float:
    """Return the damping ratio of the printed law at the amplitude of the fitted law."""
    if rest.equivalent is None:
        return swing.damping_ratio
    omega = 2.0 * math.pi / swing.period
    found = solve_harmonic_balance(rates, hidden, rest.equivalent.amplitude, swing.z, omega)
    return float(found.damping_ratio[0])


@pytest.fixture(scope="module")
def record() -> PistonRecord:
    """A decay about 59 mm."""
    time = np.linspace(0.0, 2.0, 2000)
    return noisy(time, 0.059 + damped_cosine(time, 0.0012), 1e-4, 5)


def test_the_linear_law_is_printed_with_sufficient_digits(record: PistonRecord) -> None:
    """LaTeX, the report and the list of parameters are tested."""
    model = fit(record, "linear")
    pattern = rf"\\ddot{{z}} \+ {NUMBER} \\dot{{z}} \+ {NUMBER} z = {NUMBER}"
    match = re.fullmatch(pattern, model.fitted_latex)
    damping, stiffness, force = map(float, match.groups())
    inside(model, force / stiffness, math.sqrt(stiffness), damping)
    on_page = equation_as_mathml(model.printed_equation)
    assert all(f"<mn>{number}</mn>" in on_page for number in match.groups())
    assert all(number in model.text for number in match.groups())
    for name, value in model.parameters.items():
        found = re.search(rf"\b{name} {NUMBER} ± {NUMBER} ", str(model))
        half = 0.5 * (model.intervals[name][1] - model.intervals[name][0])
        assert float(found[2]) == pytest.approx(half, rel=0.05)
        assert float(found[1]) == pytest.approx(value, abs=0.05 * half)


@pytest.mark.parametrize("product", ["friction*tanh(v)", "c*gain", "friction*c"])
def test_factors_of_a_product_are_separated_in_reports_if_a_name_has_several_letters(product: str) -> None:
    t = sympy.Symbol("t")
    z = sympy.Function("z")(t)
    names = {name: sympy.Symbol(name) for name in ("friction", "c", "gain")}
    factors = {"tanh(v)": sympy.tanh(z.diff(t)), **names}
    first, second = (factors[text] for text in product.split("*"))
    term = equation_as_mathml(sympy.Eq(z.diff(t, 2) + first * second, 0)).split("</math>")[1]
    bare = re.sub(r"<mspace[^>]*/>", " ", term.replace("<mo>&InvisibleTimes;</mo>", ""))
    assert re.search(r"\b(friction|gain)\b", re.sub(r"<(?!mspace)[^>]*>", "", bare))


def test_factors_of_a_product_are_not_separated_in_reports_if_names_have_single_letters() -> None:
    t, c, k = sympy.symbols("t c k")
    z = sympy.Function("z")(t)
    assert "<mspace" not in equation_as_mathml(sympy.Eq(z.diff(t, 2) + c * k * z, 0))


def test_a_law_of_another_coordinate_is_printed_with_its_map_to_the_height(record: PistonRecord) -> None:
    """The map has as many digits as the equation."""
    model = fit(record, "van-der-pol-like")
    line = sympy.Poly(model.printed_height.rhs, sympy.Symbol("z"))
    scale, shift = map(float, line.all_coeffs())
    pattern = (
        rf"\\ddot{{z}} \+ {NUMBER} \\dot{{z}} \\left\(z\^\{{2\}} - 2 z\\right\)"
        rf" \+ {NUMBER} z = {NUMBER}"
    )
    found = re.fullmatch(pattern, model.fitted_latex.replace(r" \cdot 10^", "e"))
    alpha, stiffness, force = map(float, found.groups())
    z = force / stiffness
    inside(model, shift + scale * z, math.sqrt(stiffness), alpha * (z**2 - 2.0 * z))


@pytest.mark.parametrize("name", PRINTED)
def test_every_printed_equation_reproduces_equilibrium_period_and_damping_within_their_intervals(
    name: str, made: Any
) -> None:
    model = fit(made(name, seed=1), name)
    rest = model.at_rest
    digits = max(5, model.printed_digits)
    printed = HeightLine(*(round_significant(value, digits) for value in model.height_line))
    swing = small_oscillation_of_equation(model.printed_equation, printed.coordinate(rest.height))
    figures = {
        "height": printed.height(swing.z),
        "period": swing.period,
        "damping_ratio": damping_ratio(rest, make_acceleration_of_equation(model.printed_equation), swing),
    }
    for key, value in figures.items():
        low, high = rest.intervals[key]
        slack = 1e-6 * abs(getattr(rest, key)) + 1e-12
        assert low - slack <= value <= high + slack, key
    assert name != "duffing" or model.printed_digits <= 5  # few are enough at one per cent noise


def assert_memory_as_printed(model: ReducedModel) -> None:
    """Assert that small oscillations and rates follow from the printed rates of hidden states."""
    law, rest = model.law, model.at_rest
    found = {key: re.search(rf"\b{key} {NUMBER} ", str(model)) for key in law.parameters}
    values = [float(match[1]) for match in found.values() if match is not None]
    swing = small_oscillation(law, values, rest.height)
    assert not isinstance(swing, NoOscillationReason)
    ratio = damping_ratio(rest, make_rates_of_law(law, values), swing, len(law.hidden))
    for key, value in {"height": swing.z, "period": swing.period, "damping_ratio": ratio}.items():
        low, high = rest.intervals[key]
        assert low <= value <= high, key
    assert_rates_as_printed(model)


def assert_rates_as_printed(model: ReducedModel) -> None:
    """Assert that the printed equations of hidden states agree with the simulated rates."""
    law, z, speed = model.law, 0.9, -0.3
    states = [0.02 + 0.01 * k for k in range(len(law.hidden))]
    field = compile_rates(law.equation, law.inputs, "math")
    numbers = [model.parameters[name] for name in law.parameters]
    _, *rates = field(z, speed, *states, *numbers)
    t = sympy.Symbol("t")
    motion = sympy.Function("z")(t)
    at = dict(zip(map(sympy.Symbol, law.hidden), states, strict=True))
    for (name, printed), rate in zip(model.printed_hidden_rates.items(), rates, strict=True):
        value = printed.subs(motion.diff(t), speed).subs(motion, z).subs(at)
        number = sympy.lambdify((), value, [{"min": min, "max": max}, "math"])()
        assert number == pytest.approx(rate, rel=2e-3)
        formula = hidden_rate_as_mathml(name, printed)
        assert f"<mi>{name}</mi><mo>&#x2d9;</mo>" in formula
        assert "<mover><mi>z</mi>" in formula


def test_equilibrium_period_and_damping_are_printed_with_errors() -> None:
    """The errors are half the intervals, to two digits."""
    intervals = {"period": (0.2999, 0.3001), "damping_ratio": (0.08, 0.09)}
    rest = AtRest(0.062123456, 0.3, 0.085, intervals | {"height": (0.06212341, 0.06212350)})
    assert [" ".join(line.split()) for line in str(rest).splitlines()] == [
        "natural frequency f0 3.3333 ± 0.0011 Hz damped 3.321 Hz",
        "damping ratio zeta 8.50 ± 0.50 % of critical; log decrement 0.536, Q 5.88",
        "stiffness k 438.65 ± 0.29 N/m per kg damping c 3.56 ± 0.21 N s/m per kg",
        "equilibrium z0 62.123456 ± 0.000045 mm",
        "these ± are 95 % intervals: fit",
    ]


SAVED = Path(__file__).parents[2] / "data" / "model.json"
TIME = np.linspace(0.0, 2.0, 2000)


def quantity(value: float, error: float, unit: str = "mm") -> QuantityWithError:
    return QuantityWithError("a", "a", unit, value, {"fit": error})


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (2.3111159e-30, 0.0, "2.31112e-30 mm"),  # `fit` gives 0 instead, see below
        (0.80000000001, 1e-13, "0.8 mm"),
        (1744.76931503685, 12.3, "1745 ± 12 mm"),
        (59.113399, 0.021, "59.113 ± 0.021 mm"),
        (-4.7e-7, 1.0e-6, "-5e-07 ± 1e-06 mm"),
        (5.0, math.inf, "5.000 mm (not determined)"),
    ],
)
def test_a_result_is_printed_to_two_digits_of_its_error(value: float, error: float, text: str) -> None:
    assert quantity(value, error).text_with_error == text


@pytest.mark.parametrize(
    ("fraction", "text"),
    [(3.83e-12, "< 0.0001 %"), (0.0194, "1.94 %"), (12.345, "1234 %"), (math.inf, "diverges"), (0.0, "0 %")],
)
def test_relative_errors_are_printed_in_per_cent(fraction: float, text: str) -> None:
    assert format_percent(fraction) == text


def test_parameters_are_never_truncated_or_broken_across_lines() -> None:
    """Twelve parameters take as many lines as they need."""
    values = tuple(
        QuantityWithError(f"c{k}", f"c{k}", "1/(m s^2)", 1e4 + k, {"fit": 12.0}) for k in range(12)
    )
    lines = equation_lines("z'' = " + " + ".join(f"c{k}*z**{k}" for k in range(12)), values, {})
    assert max(map(len, lines)) <= 100
    assert "..." not in "".join(lines)
    for item in values:
        assert sum(f"{item.name} {item.text_with_error}" in line for line in lines) == 1


def test_an_asymmetric_interval_is_printed_in_place_of_the_error() -> None:
    (_, line) = equation_lines("z'' = -k*z", [quantity(2.0, 0.5, "1/s^2")], {"a": (1.8, 2.8)})
    assert line.strip() == "a 2.00 1/s^2 (1.80 to 2.80)"


def test_results_of_a_fit_are_printed_in_a_fixed_order_and_aligned() -> None:
    lines = quantity_lines(oscillation_quantities(load_model(SAVED), 7.5), 7.5, 0.95, "1 to 2 mm: constant")
    names = ["natural frequency", "damping ratio", "stiffness", "equilibrium", "amplitude"]
    assert [line.split("  ")[1] for line in lines[:-1]] == names
    assert "(for 7.5 kg)" in lines[2]
    assert lines[5] == "  these ± are 95 % intervals: fit"
    assert lines[4].index("1 to 2 mm") == lines[0].index(lines[0].split("f0")[1].strip()[:4])


def test_an_equilibrium_at_zero_is_printed_as_zero() -> None:
    """A computed value of 1e-37 is printed as 0, and no number has 15 digits."""
    held = {"g0": Parameter(0.0, fixed=True)}
    model = fit(PistonRecord(TIME, damped_cosine(TIME)), "linear", starts=2, parameters=held)
    assert model.at_rest.height == 0.0
    assert "z0    0 mm" in str(model)
    assert max(map(len, str(model).replace(",", " ").split())) < 15
    assert model.printed_digits <= 9


def test_cautions_are_printed_in_full_or_the_number_of_omitted_ones_is_given() -> None:
    words = ["the record " + "rounds " * 20, "a", "b", "c"]
    lines = caution_lines(words, 4)
    assert len(lines) <= 4
    assert lines[-1] == "2 more: --verbose, or the report" or lines[-1].startswith("3 more")
    assert caution_lines(words) == [*caution_lines(words[:1]), "caution: a", "caution: b", "caution: c"]


def test_small_oscillations_of_an_angle_are_printed_in_degrees_and_listed_as_a_table_row() -> None:
    rest = load_model(SAVED).at_rest
    turned = str(dataclasses.replace(rest, coordinate_unit="rad"))
    assert " °" in turned
    assert " mm" not in turned
    row, names = rest.to_series(), ["height", "period", "damping_ratio"]
    assert list(row.index) == [*names, *(f"{name}_error" for name in names)]
    assert row["period_error"] == pytest.approx(half_width(rest, "period"))
