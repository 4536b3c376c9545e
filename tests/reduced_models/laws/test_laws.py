"""Every law is recovered from its simulated motion, and solutions use a suitable solver."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from reduced_models import FirstGuesses, Law, fit
from reduced_models.laws import LAWS, solution
from reduced_models.laws.equation import compile_jacobian, parse_equation
from reduced_models.laws.law import law_from_text
from reduced_models.laws.linearization import make_rates_of_law, solve_harmonic_balance
from reduced_models.laws.solution import Solution, solve_law
from reduced_models.laws.van_der_pol_like import parameters_from_quadratic_damping
from tests.reduced_models.made import assert_found, half_width, moved

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


def test_parameters_of_each_law_are_recovered(made: Any) -> None:
    """They agree within five standard errors. A 95 % interval is about two standard errors to either side."""
    model = fit(made("linear", seed=1), "linear")
    assert model.quality.converged >= 4
    assert model.quality.relative == pytest.approx(0.01, rel=0.05)
    assert_found(model, made.true["linear"], 1.25)
    assert all(half_width(model, name) < 0.05 * abs(value) for name, value in made.true["linear"].items())


@pytest.mark.long
@pytest.mark.parametrize("name", LAWS)
def test_confidence_intervals_contain_the_true_values_for_each_law(made: Any, name: str) -> None:
    """The 95 % intervals are tested for 100 records with independent noise.

    For beds they are also not too wide.
    """
    covered, halves, values, true = [], [], [], made.true[name]
    for seed in range(100, 200):
        model = fit(made(name, seed), name, test_fraction=0.0, starts=4)
        covered.append([low <= true[key] <= high for key, (low, high) in model.intervals.items()])
        halves.append([half_width(model, key) for key in model.intervals])
        values.append([model.parameters[key] for key in model.intervals])
    fractions, width = np.mean(covered, axis=0), np.median(halves, axis=0) / np.std(values, axis=0, ddof=1)
    print(f"\n{name}: hold {fractions}, half-width over sigma {width.round(2)}")
    assert fractions.min() >= 0.85
    assert fractions.max() <= 0.99
    assert name not in ("elastoplastic-bed", "annealing-bed") or width.max() <= 2.5


def test_decay_by_dry_friction_is_linear_in_time() -> None:
    """The amplitude falls by 4 friction/omega^2 per period, until it is as small as friction/omega^2."""
    time = np.linspace(0.0, 60.0, 2000)
    found = solve_law(LAWS["coulomb"], time, 3.0, 0.0, (0.06, 1.0, 0.0), 1.0)
    peaks = [found.z[np.abs(time - 2.0 * math.pi * k).argmin()] for k in range(8)]
    assert np.diff(peaks) == pytest.approx([-0.24] * 7, rel=0.02)


def test_driven_solutions_agree_with_scipy() -> None:
    """Heights and velocities are compared for a smooth drive."""
    from scipy.integrate import solve_ivp

    time = np.linspace(0.0, 20.0, 4001)
    law = law_from_text("z'' + c*z' + k*z + f*w = u; w' = z' - Abs(z')*w", ["u"])
    assert law.hidden == ("w",)
    found = solve_law(law, time, 1.0, 0.0, (0.1, 1.0, 0.2), 1.0, [np.cos(2.0 * time)])

    def rates(t: float, state: np.ndarray) -> list[float]:
        z, v, w = state
        return [v, np.cos(2 * t) - 0.1 * v - z - 0.2 * w, v - abs(v) * w]

    exact = solve_ivp(rates, (0, 20), [1, 0, 0], "DOP853", rtol=1e-11, atol=1e-12, t_eval=time)
    np.testing.assert_allclose([found.z, found.velocity], exact.y[:2], atol=3e-6)


def test_a_diverging_driven_solution_is_reported() -> None:
    time = np.linspace(0.0, 40.0, 400)
    law = law_from_text("z'' = k*z**3 + u", ["u"])
    found = solve_law(law, time, 1.0, 0.0, (1.0,), 1.0, [np.zeros(400)])
    assert found.ending == "blow-up"
    assert np.isnan(found.z[-1])


@pytest.mark.parametrize("name", LAWS)
def test_declarations_of_laws_are_consistent(name: str) -> None:
    law = LAWS[name]
    assert set(law.units) == set(law.parameters)
    assert set(law.positive) <= set(law.parameters)
    assert law.source
    assert parse_equation(law.equation).parameters == law.parameters


def test_equivalent_damping_of_dry_friction_has_its_closed_form() -> None:
    """The energy loss per cycle is 4 friction A."""
    rates = make_rates_of_law(law_from_text("z'' + friction*sign(z') + k*z = g0"), [0.06, 1.1025, 0.2])
    for size in (0.3, 3.0):
        found = solve_harmonic_balance(rates, 0, size, 0.2 / 1.1025, 1.05)
        assert float(found.damping_ratio[0]) == pytest.approx(0.12 / (math.pi * 1.1025 * size), rel=1e-3)


def test_derivatives_of_a_discontinuous_law_are_nan_only_at_the_jump() -> None:
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
def test_derivatives_of_functions_that_sympy_treats_as_complex_are_correct(
    text: str, wanted: tuple[float, float]
) -> None:
    found = tuple(compile_jacobian(text)(0.2, 0.0, 2.0)[0])
    assert found == pytest.approx(wanted, nan_ok=True)


GUESSES = FirstGuesses(0.0, 1.0, 1.0, 0.1, 1.0, 0.0, 10)
"""A motion about 0 of amplitude 1."""


def test_quadratic_damping_is_converted_to_the_van_der_pol_like_law_and_back() -> None:
    """Motions with an unstable equilibrium and with a reversed coordinate are included."""
    signs = []
    for omega, shift, scale in ((1.05, 0.4, 0.6), (1.2, -0.7, 0.9), (0.9, 1.3, 1.7)):
        expected = {"alpha": 0.17, "omega": omega, "g0": 0.4, "shift": shift, "scale": scale}
        p, q = -shift / scale, 1.0 / scale
        damping = 0.34 * np.array([[(p - 1.0) ** 2 - 1.0], [2.0 * q * (p - 1.0)], [q**2]])
        signs.append(np.sign(damping[0, 0]))
        force = (0.4 - omega**2 * p) / q
        known = dataclasses.replace(GUESSES, given={"shift": shift, "scale": scale})
        for guesses in (GUESSES, known):
            found = parameters_from_quadratic_damping(guesses, damping, np.array([omega**2]), force)
            for name, value in expected.items():
                assert found[name] == pytest.approx([value], rel=1e-12)
    assert set(signs) == {-1.0, 1.0}


def test_damping_that_the_law_cannot_represent_keeps_its_value_at_equilibrium() -> None:
    """Examples are parabolas that open downwards or are positive at their vertex, and straight lines."""
    c0 = np.array([0.8, 0.8, 0.8, -0.3])
    c1, c2 = np.array([0.3, 0.2, 0.0, 0.5]), np.array([-0.4, 0.9, 0.0, 0.0])
    found = parameters_from_quadratic_damping(GUESSES, np.stack([c0, c1, c2]), np.ones(4), 0.0)
    assert all(np.isfinite(values).all() for values in found.values())
    assert (found["alpha"] > 0.0).all()
    assert (found["scale"] > 0.0).all()
    p = -found["shift"] / found["scale"]
    np.testing.assert_allclose(2.0 * found["alpha"] * ((p - 1.0) ** 2 - 1.0), c0, rtol=1e-9)


STIFF = "z'' + k*z + c*w = 0; w' = r*(z' - w)"
BOUC_WEN = "z'' + k*z + f*w = 0; w' = r*(z' - s*Abs(z')*w - (1 - s)*z'*Abs(w))"
OMEGA, COUPLING = 8.0 * np.pi, 0.4


@pytest.fixture
def solvers(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Record the kind of solver of each call: True if implicit."""
    calls: list[bool] = []
    make = solution._compile_adaptive_solver

    def follow(*given: Any, implicit: bool) -> Callable[..., Any]:
        calls.append(implicit)
        return make(*given, implicit=implicit)

    monkeypatch.setattr(solution, "_compile_adaptive_solver", follow)
    return calls


def solve(text: str, time: np.ndarray, z0: float = 1.0, **values: float) -> Solution:
    law = law_from_text(text)
    return solve_law(law, time, z0, 0.0, [values[name] for name in law.parameters], 1.0)


@pytest.mark.parametrize("rate", [1e5, 1e7])
def test_fast_relaxation_in_a_slow_oscillation_agrees_with_the_closed_form(
    solvers: list[bool], rate: float
) -> None:
    """The oscillation has 4 Hz."""
    time = np.linspace(0.0, 20.0, 2000)
    found = solve(STIFF, time, k=OMEGA**2, c=COUPLING, r=rate)
    matrix = np.array([[0.0, 1.0, 0.0], [-(OMEGA**2), 0.0, -COUPLING], [0.0, rate, -rate]])
    rates, shapes = np.linalg.eig(matrix)
    modes = shapes[0] * np.linalg.solve(shapes, [1.0, 0.0, 0.0])
    exact = (np.exp(np.outer(time, rates)) @ modes).real
    np.testing.assert_allclose(found.z, exact, atol=1e-9)
    assert solvers == [False, True, True]


def test_relaxation_oscillation_agrees_with_scipy(solvers: list[bool]) -> None:
    time = np.linspace(0.0, 1500.0, 500)
    found = solve("z'' - mu*(1 - z**2)*z' + z = 0", time, 2.0, mu=1e3)
    exact = moved(lambda t, z, v: 1e3 * (1.0 - z**2) * v - z, time, 2.0, method="Radau", rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.z, exact, atol=1e-5)
    assert solvers[-1]


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("z'' + mu*tanh(z'/v) + k*z = 0", {"mu": 1e-3, "v": 1e-4, "k": 600.0}),
        (BOUC_WEN, {"k": 600.0, "f": 1e-3, "r": 10.0, "s": 0.9}),
    ],
)
def test_kinks_of_a_law_cause_no_change_to_the_solver_for_stiff_equations(
    solvers: list[bool], text: str, values: dict[str, float]
) -> None:
    found = solve(text, np.linspace(0.0, 60.0, 9000), **values)
    assert found.ending == "complete"
    assert len(solvers) > 1
    assert not any(solvers)


def test_the_explicit_solver_handles_kinks_between_stiff_intervals(solvers: list[bool]) -> None:
    found = solve(BOUC_WEN, np.linspace(0.0, 20.0, 200), k=600.0, f=1e-3, r=1e3, s=0.9)
    assert found.ending == "complete"
    assert sum(solvers) == 1
    assert not solvers[-1]


def test_the_solution_of_a_long_record_equals_the_solution_in_parts(solvers: list[bool]) -> None:
    """State and time step are passed on from part to part, with a driving force."""
    time = np.linspace(0.0, 300.0, 30001)
    drive = np.sin(1.3 * time)
    law = Law("driven", "z'' + c*z' + k*z + b*z**3 = force", inputs=("force",))
    values = (0.1, 1.0, 0.3)
    whole = solve_law(law, time, 1.0, 0.0, values, 1.0, [drive])
    assert len(solvers) == 15
    half = slice(15000, None)
    z, v = whole.z[15000], whole.velocity[15000]
    second = solve_law(law, time[half], z, v, values, 1.0, [drive[half]])
    np.testing.assert_allclose(second.z, whole.z[half], atol=1e-7)


@pytest.mark.parametrize(
    ("text", "last"),
    [("z'' + mu*sign(z') + k*z = 0", 1.3), ("z'' = exp(mu*z) + 0*k", 1.4), ("z'' = mu*log(z) - 3*k", 1.4)],
)
def test_solutions_that_would_never_end_are_aborted(solvers: list[bool], text: str, last: float) -> None:
    """Examples are motion held at the jump of a sign function, a singularity, and a law that becomes
    undefined.
    """
    time = np.linspace(0.0, 40.0, 2000)
    found = solve(text, time, mu=30.0 if "sign" in text else 1.0, k=600.0 if "sign" in text else 1.0)
    assert found.ending == "steps"
    assert len(solvers) <= 12
    reached = np.isfinite(found.z)
    assert 0.5 < time[reached][-1] < last
