"""Every law finds itself in its own motion, at 1 % noise."""

from __future__ import annotations

import dataclasses
import math
import warnings
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import InputError, RecordError
from reduced_models import FirstGuesses, FitOptions, Parameter, ReducedModel, fit, load_model
from reduced_models.laws import LAWS
from reduced_models.laws.equation import compile_jacobian, parse_equation
from reduced_models.laws.law import law_from_text
from reduced_models.laws.linearization import harmonic_cycles, law_rates
from reduced_models.laws.solution import solve_law
from reduced_models.laws.van_der_pol_like import law_with_quadratic_damping


def errors(model: ReducedModel, true: dict[str, float]) -> list[float]:
    return [abs(model.parameters[key] / value - 1.0) for key, value in true.items()]


# Springs and dampings: tests/reduced_models/models/test_printed_equation.py; a state of its own:
# tests/reduced_models/fitting/test_history.py; friction: tests/reduced_models/fitting/test_dry_friction.py.
QUICK = ("linear",)


@pytest.mark.parametrize(
    "name", [one if one in QUICK else pytest.param(one, marks=pytest.mark.long) for one in LAWS]
)
def test_a_law_finds_itself(made: Any, name: str) -> None:
    """Within five of its own standard errors; 95 % intervals are two of them to each side."""
    true = made.true[name]
    line = {key: Parameter(true[key], fixed=True) for key in ("shift", "scale") if key in true}
    model = fit(made(name, seed=1), name, parameters=line)
    assert model.quality.converged >= 4
    assert model.quality.relative == pytest.approx(0.01, rel=0.05)
    for key, value in true.items():
        if key in line:
            continue
        low, high = model.intervals[key]
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        assert abs(middle - value) < 2.5 * half
        assert half < 0.05 * abs(value)


@pytest.mark.long
@pytest.mark.parametrize("name", LAWS)
def test_laws_are_recovered_within_half_a_per_cent(made: Any, name: str) -> None:
    """In the median of ten records with noise of their own, each parameter."""
    wrong = [errors(fit(made(name, seed), name), made.true[name]) for seed in range(10)]
    assert np.median(wrong, axis=0).max() < 0.005


@pytest.mark.long
@pytest.mark.parametrize("name", LAWS)
def test_intervals_cover_the_truth(made: Any, name: str) -> None:
    """95 % intervals of 100 records with noise of their own; all parameters together."""
    covered = []
    for seed in range(100, 200):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = fit(made(name, seed), name, test_fraction=0.0, starts=4)
        covered.append(
            [
                model.intervals[key][0] <= value <= model.intervals[key][1]
                for key, value in made.true[name].items()
            ]
        )
    fractions = np.mean(covered, axis=0)
    print(f"\n{name}: hold {fractions}")
    assert fractions.min() >= 0.85
    assert fractions.max() <= 0.99


def test_friction_lets_the_swing_fall_in_a_straight_line() -> None:
    """By 4 friction/omega^2 a period, until it is as small as friction/omega^2."""
    time = np.linspace(0.0, 60.0, 2000)
    found = solve_law(LAWS["coulomb"], time, 3.0, 0.0, (0.06, 1.0, 0.0), 1.0)
    peaks = [found.z[np.abs(time - 2.0 * math.pi * k).argmin()] for k in range(8)]
    assert np.diff(peaks) == pytest.approx([-0.24] * 7, rel=0.02)


@pytest.mark.long  # quick: the time in a law of `test_words`, the own law of `test_fit`
@pytest.mark.parametrize(
    ("name", "equation", "values"),
    [
        ("linear", "z'' + 2*d*z' + k*z = g", (0.05, 1.1025, -1.0)),
        ("duffing", "z'' + c*z' + k*(z-r) + b*(z-r)**3 = 0", (0.1, 1.1025, 0.5, 0.8)),
    ],
)
def test_a_law_by_its_text_alone(made: Any, name: str, equation: str, values: tuple[float, ...]) -> None:
    """Where to start is told by the record's accelerations."""
    model = fit(made(name), equation)
    assert tuple(model.parameters.values()) == pytest.approx(values, rel=0.005)
    assert model.quality.converged >= 12


@pytest.mark.long  # quick: `test_driven`
def test_inputs_are_columns_of_the_record(tmp_path: Any) -> None:
    """A driven Duffing oscillator, with its drive as a column; to CSV, to JSON and back.

    Law and times are those of `test_driven`, so that both share compiled code.
    """
    time = 0.2 * np.arange(2000)
    drive = 0.5 * np.cos(1.3 * time) + 0.2 * np.sign(np.sin(0.4 * time))
    text = "z'' + c*z' + k*z + b*z**3 = g*forcing"
    law = law_from_text(text, ["forcing"])
    assert law.inputs == ("forcing",)
    true = {"c": 0.1, "k": 1.1, "b": 0.8, "g": 1.2}
    found = solve_law(law, time, 0.5, 0.0, [true[key] for key in law.parameters], 1.0, [drive])
    assert found.ending == "complete"
    noise = np.random.default_rng(0).normal(0.0, 0.01 * found.z.std(), len(time))
    record = PistonRecord(time, found.z + noise, extra={"forcing": drive})
    record.to_csv(tmp_path / "driven.csv")
    record = PistonRecord.from_csv(tmp_path / "driven.csv")
    model = fit(record, text, starts=1, options=FitOptions(input_interpolation="spline"))
    assert model.parameters == pytest.approx(true, rel=0.005)
    assert model.quality.relative == pytest.approx(0.01, rel=0.05)
    model.save(tmp_path / "model.json")
    back = load_model(tmp_path / "model.json")
    assert back.to_plain() == model.to_plain()
    assert np.array_equal(back.simulate_record(record).height, model.simulate_record(record).height)
    with pytest.raises(InputError, match="has the input 'forcing'; give inputs"):
        back.simulate(time)
    with pytest.raises(RecordError, match="no column of that name; found: none"):
        fit(PistonRecord(time, found.z), law)


def test_driven_solutions_agree_with_scipy() -> None:
    """Heights and velocities, under a smooth drive."""
    from scipy.integrate import solve_ivp

    time = np.linspace(0.0, 20.0, 4001)
    drive = np.cos(2.0 * time)
    law = law_from_text("z'' + c*z' + k*z + f*w = u; w' = z' - Abs(z')*w", ["u"])
    assert law.hidden == ("w",)
    found = solve_law(law, time, 1.0, 0.0, (0.1, 1.0, 0.2), 1.0, [drive])

    def rates(t: float, state: np.ndarray) -> list[float]:
        z, v, w = state
        return [v, np.cos(2 * t) - 0.1 * v - z - 0.2 * w, v - abs(v) * w]

    exact = solve_ivp(rates, (0, 20), [1, 0, 0], "DOP853", rtol=1e-11, atol=1e-12, t_eval=time)
    np.testing.assert_allclose(found.z, exact.y[0], atol=3e-6)
    np.testing.assert_allclose(found.velocity, exact.y[1], atol=3e-6)


def test_a_driven_solution_that_blows_up_says_so() -> None:
    time = np.linspace(0.0, 40.0, 400)
    law = law_from_text("z'' = k*z**3 + u", ["u"])
    found = solve_law(law, time, 1.0, 0.0, (1.0,), 1.0, [np.zeros(400)])
    assert found.ending == "blow-up"
    assert np.isnan(found.z[-1])


@pytest.mark.parametrize("name", LAWS)
def test_laws_are_well_declared(name: str) -> None:
    law = LAWS[name]
    assert set(law.units) == set(law.parameters)
    assert set(law.positive) <= set(law.parameters)
    assert law.source
    assert parse_equation(law.equation).parameters == law.parameters


def test_the_damping_of_dry_friction_by_its_sign() -> None:
    """Its energy in a cycle is 4 friction A, in closed form."""
    rates = law_rates(law_from_text("z'' + friction*sign(z') + k*z = g0"), [0.06, 1.1025, 0.2])
    for size in (0.3, 3.0):
        found = harmonic_cycles(rates, 0, size, 0.2 / 1.1025, 1.05)
        assert float(found.damping_ratio[0]) == pytest.approx(0.12 / (math.pi * 1.1025 * size), rel=1e-3)


@pytest.mark.long  # quick: its damping above, swings of friction in `test_dry_friction`
def test_dry_friction_by_its_sign(made: Any) -> None:
    """It is fitted unchanged, and its damping is that of swings, where it does not stick."""
    law = "z'' + friction*sign(z') + k*z = g0"
    model = fit(made("coulomb").first(1200), law, test_fraction=0.0, starts=1)
    true = made.true["coulomb"]
    assert model.parameters["friction"] == pytest.approx(true["friction"], rel=0.05)
    assert model.parameters["k"] == pytest.approx(true["omega"] ** 2, rel=0.01)
    rest = model.at_rest
    assert rest is not None
    assert rest.equivalent is not None
    assert rest.equivalent.friction == pytest.approx(model.parameters["friction"], rel=1e-3)
    ratio = 2.0 * true["friction"] / (np.pi * true["omega"] ** 2 * rest.equivalent.amplitude)
    assert rest.damping_ratio == pytest.approx(ratio, rel=0.05)


def test_slopes_of_a_law_that_jumps() -> None:
    slopes = compile_jacobian("z'' + mu*sign(z') + c*z' + k*z = 0")
    assert slopes(0.3, 0.5, 2.0, 0.1, 3.0).tolist() == [[-3.0, -0.1]]
    assert np.isnan(slopes(0.3, 0.0, 2.0, 0.1, 3.0)).all()


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("z'' + k*sign(asin(z)) = 0", (0.0, 0.0)),
        ("z'' + k*abs(log(z)) = 0", (10.0, 0.0)),
        ("z'' + k*(-z)**0.5 = 0", (math.nan, math.nan)),
        ("z'' + (-7)**(k*z) = 0", (math.nan, math.nan)),
        ("z'' + k*exp(1e9*z) = 0", (-math.inf, 0.0)),
    ],
)
def test_slopes_where_sympy_sees_complex_numbers(text: str, wanted: tuple[float, float]) -> None:
    found = tuple(compile_jacobian(text)(0.2, 0.0, 2.0)[0])
    assert found == pytest.approx(wanted, nan_ok=True)


GUESSES = FirstGuesses(0.0, 1.0, 1.0, 0.1, 1.0, 0.0, 10)
"""A motion about 0 of amplitude 1."""


def test_a_quadratic_damping_is_that_of_the_law() -> None:
    """There and back, also of a motion whose equilibrium is unstable and of the mirrored line."""
    alpha, omega, g0 = 0.17, np.array([1.05, 1.2, 0.9]), 0.4
    shift, scale = np.array([0.4, -0.7, 1.3]), np.array([0.6, 0.9, 1.7])
    p, q = -shift / scale, 1.0 / scale
    damping = 2.0 * alpha * np.stack([(p - 1.0) ** 2 - 1.0, 2.0 * q * (p - 1.0), q**2])
    assert min(damping[0]) < 0.0 < max(damping[0])
    for k in range(3):
        force = float((g0 - omega[k] ** 2 * p[k]) / q[k])
        found = law_with_quadratic_damping(GUESSES, damping[:, [k]], omega[[k]] ** 2, force)
        expected = {"alpha": alpha, "omega": omega[k], "g0": g0, "shift": shift[k], "scale": scale[k]}
        for name, value in expected.items():
            assert found[name] == pytest.approx([value], rel=1e-12)
        known = dataclasses.replace(GUESSES, given={"shift": shift[k], "scale": scale[k]})
        again = law_with_quadratic_damping(known, damping[:, [k]], omega[[k]] ** 2, force)
        for name, value in expected.items():
            assert again[name] == pytest.approx([value], rel=1e-12)


def test_a_damping_that_the_law_cannot_have_keeps_its_value_at_rest() -> None:
    """Parabolas that open downwards, or are positive at their vertex, or are straight lines."""
    c0 = np.array([0.8, 0.8, 0.8, -0.3])
    c1, c2 = np.array([0.3, 0.2, 0.0, 0.5]), np.array([-0.4, 0.9, 0.0, 0.0])
    found = law_with_quadratic_damping(GUESSES, np.stack([c0, c1, c2]), np.ones(4), 0.0)
    assert all(np.isfinite(values).all() for values in found.values())
    assert (found["alpha"] > 0.0).all()
    assert (found["scale"] > 0.0).all()
    p = -found["shift"] / found["scale"]
    np.testing.assert_allclose(2.0 * found["alpha"] * ((p - 1.0) ** 2 - 1.0), c0, rtol=1e-9)
