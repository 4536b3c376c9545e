"""What is printed says what was found: its numbers have as many digits as that takes."""

from __future__ import annotations

import math
import re
import warnings
from typing import Any

import numpy as np
import pytest
import sympy

from granular import PistonRecord
from reduced_models import ReducedModel, fit
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.law import HeightLine
from reduced_models.laws.linearization import (
    NoSwing,
    Rates,
    SmallSwing,
    equation_rates,
    harmonic_cycles,
    law_rates,
    small_swing,
    small_swing_of_equation,
)
from reduced_models.laws.printing import mathml, mathml_of_rate, round_significant
from reduced_models.models.at_rest import AtRest

COMBINED = ("van-der-pol", "viscous-coulomb", "viscous-quadratic", "pendulum-coulomb", "pendulum-quadratic")
"""Laws of parts that other laws here have or nearly have, each of which takes seconds to compile.

The damping of van-der-pol is that of van-der-pol-like, but for its centre and its sign.
"""
NUMBER = r"(-?[0-9.]+(?:e[+-]?[0-9]+)?)"


def inside(model: ReducedModel, height: float, omega: float, damping: float) -> None:
    """Level, period and damping ratio lie in the printed intervals."""
    rest = model.at_rest
    assert rest is not None
    found = {"height": height, "period": 2.0 * math.pi / omega, "damping_ratio": damping / (2.0 * omega)}
    for name, value in found.items():
        low, high = rest.intervals[name]
        assert low <= value <= high, name


def damping_ratio(rest: AtRest, rates: Rates, swing: SmallSwing, hidden: int = 0) -> float:
    """Of the printed law, at the amplitude that the fit's is of (no map has another scale here)."""
    if rest.equivalent is None:
        return swing.damping_ratio
    omega = 2.0 * math.pi / swing.period
    found = harmonic_cycles(rates, hidden, rest.equivalent.amplitude, swing.z, omega)
    return float(found.damping_ratio[0])


@pytest.fixture(scope="module", params=[1e-4, pytest.param(1e-6, marks=pytest.mark.long)])
def record(request: pytest.FixtureRequest) -> PistonRecord:
    """A swing about 59 mm, at two levels of noise."""
    time = np.linspace(0.0, 2.0, 2000)
    height = 0.059 + 0.0012 * np.exp(-0.8 * time) * np.cos(21.8 * time)
    noise = np.random.default_rng(5).normal(0.0, request.param, len(time))
    return PistonRecord(time, height + noise)


def test_the_linear_law_as_it_is_printed(record: PistonRecord) -> None:
    """In LaTeX, on the page, and as a list of parameters."""
    model = fit(record, "linear")
    pattern = rf"\\ddot{{z}} \+ {NUMBER} \\dot{{z}} \+ {NUMBER} z = {NUMBER}"
    match = re.fullmatch(pattern, model.fitted_latex)
    assert match is not None
    damping, stiffness, force = map(float, match.groups())
    inside(model, force / stiffness, math.sqrt(stiffness), damping)
    on_page = mathml(model.printed_equation)
    assert all(f"<mn>{number}</mn>" in on_page for number in match.groups())
    assert all(number in model.text for number in match.groups())
    for name, value in model.parameters.items():
        found = re.search(rf"\b{name} {NUMBER} ± {NUMBER} ", str(model))
        assert found is not None
        half = 0.5 * (model.intervals[name][1] - model.intervals[name][0])
        assert float(found[2]) == pytest.approx(half, rel=0.05)
        assert float(found[1]) == pytest.approx(value, abs=0.05 * half)


@pytest.mark.parametrize("product", ["friction*tanh(v)", "c*gain", "friction*c"])
def test_words_of_a_product_stand_apart_on_pages(product: str) -> None:
    t = sympy.Symbol("t")
    z = sympy.Function("z")(t)
    names = {name: sympy.Symbol(name) for name in ("friction", "c", "gain")}
    factors = {"tanh(v)": sympy.tanh(z.diff(t)), **names}
    first, second = (factors[text] for text in product.split("*"))
    term = mathml(sympy.Eq(z.diff(t, 2) + first * second, 0)).split("</math>")[1]
    bare = re.sub(r"<mspace[^>]*/>", " ", term.replace("<mo>&InvisibleTimes;</mo>", ""))
    assert re.search(r"\b(friction|gain)\b", re.sub(r"<(?!mspace)[^>]*>", "", bare))


def test_letters_of_a_product_stay_together_on_pages() -> None:
    t, c, k = sympy.symbols("t c k")
    z = sympy.Function("z")(t)
    assert "<mspace" not in mathml(sympy.Eq(z.diff(t, 2) + c * k * z, 0))


def test_a_law_with_a_map_as_it_is_printed(record: PistonRecord) -> None:
    """The height as a line in z is printed next to the equation, with as many digits."""
    model = fit(record, "van-der-pol-like")
    line = sympy.Poly(model.printed_height.rhs, sympy.Symbol("z"))
    scale, shift = map(float, line.all_coeffs())
    pattern = (
        rf"\\ddot{{z}} \+ {NUMBER} \\dot{{z}} \\left\(z\^\{{2\}} - 2 z\\right\)"
        rf" \+ {NUMBER} z = {NUMBER}"
    )
    found = re.fullmatch(pattern, model.fitted_latex.replace(r" \cdot 10^", "e"))
    assert found is not None
    alpha, stiffness, force = map(float, found.groups())
    z = force / stiffness
    inside(model, shift + scale * z, math.sqrt(stiffness), alpha * (z**2 - 2.0 * z))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.long if name in COMBINED else ())
        for name, law in LAWS.items()
        if not law.hidden  # else two equations, one by one
    ],
)
@pytest.mark.parametrize("level", [0.01, pytest.param(1e-5, marks=pytest.mark.long)])
def test_every_law_as_it_is_printed(name: str, level: float, made: Any) -> None:
    """Level, period and damping ratio of the printed equation lie within their intervals."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = fit(made(name, seed=1, level=level), name)
    rest = model.at_rest
    assert rest is not None
    digits = max(5, model.printed_digits)
    printed = HeightLine(*(round_significant(value, digits) for value in model.height_line))
    swing = small_swing_of_equation(model.printed_equation, printed.coordinate(rest.height))
    assert swing is not None
    figures = {
        "height": printed.height(swing.z),
        "period": swing.period,
        "damping_ratio": damping_ratio(rest, equation_rates(model.printed_equation), swing),
    }
    for key, value in figures.items():
        low, high = rest.intervals[key]
        slack = 1e-6 * abs(getattr(rest, key)) + 1e-12
        assert low - slack <= value <= high + slack, key


def test_few_digits_where_little_is_known(made: Any) -> None:
    """Four are enough at one per cent of noise."""
    assert fit(made("duffing", seed=1), "duffing").printed_digits <= 5


@pytest.mark.long  # quick: Bouc-Wen's in `test_history`
@pytest.mark.parametrize("name", [name for name, law in LAWS.items() if law.hidden])
def test_a_law_with_memory_by_its_printed_parameters(name: str, made: Any) -> None:
    """Its small swing, hidden states included, lies within the printed intervals."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = fit(made(name, seed=1, level=1e-3), name, starts=4)
    assert_memory_as_printed(model)


def assert_memory_as_printed(model: ReducedModel) -> None:
    """The small swing of a law with hidden states, and their rates, are those of what is printed."""
    law = model.law
    found = {key: re.search(rf"\b{key} {NUMBER} ", str(model)) for key in law.parameters}
    values = {key: float(match[1]) for key, match in found.items() if match is not None}
    rest = model.at_rest
    assert rest is not None
    swing = small_swing(law, [values[key] for key in law.parameters], rest.height)
    assert not isinstance(swing, NoSwing)
    rates = law_rates(law, [values[key] for key in law.parameters])
    figures = {
        "height": swing.z,
        "period": swing.period,
        "damping_ratio": damping_ratio(rest, rates, swing, len(law.hidden)),
    }
    for key, value in figures.items():
        low, high = rest.intervals[key]
        assert low <= value <= high, key
    assert_rates_as_printed(model)


def assert_rates_as_printed(model: ReducedModel) -> None:
    """The equations of the hidden states are those that the motion follows."""
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
        formula = mathml_of_rate(name, printed)
        assert f"<mi>{name}</mi><mo>&#x2d9;</mo>" in formula
        assert "<mover><mi>z</mi>" in formula


def test_what_a_law_says_of_rest_is_printed_with_its_errors() -> None:
    """To two digits of half the interval."""
    intervals = {
        "height": (0.06212341, 0.06212350),
        "period": (0.2999, 0.3001),
        "damping_ratio": (0.08, 0.09),
    }
    rest = AtRest(0.062123456, 0.3, 0.085, intervals)
    assert [" ".join(line.split()) for line in str(rest).splitlines()] == [
        "natural frequency f0 3.3333 ± 0.0011 Hz damped 3.321 Hz",
        "damping ratio zeta 8.50 ± 0.50 % of critical; log decrement 0.536, Q 5.88",
        "stiffness k 438.65 ± 0.29 N/m per kg damping c 3.56 ± 0.21 N s/m per kg",
        "equilibrium z0 62.123456 ± 0.000045 mm",
        "these ± are 95 % intervals: fit",
    ]
