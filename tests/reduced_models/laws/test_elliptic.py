"""Jacobi's elliptic functions against mpmath, the Duffing oscillator, and the damped ansatz."""

from __future__ import annotations

import functools
from itertools import pairwise
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord
from granular.shared.errors import RecordError
from reduced_models.jax_setup import jax
from reduced_models.laws import elliptic

FUNCTIONS = {"sn": elliptic.sn, "cn": elliptic.cn, "dn": elliptic.dn}


@jax.jit
def compiled(u: Any, m: Any) -> dict[str, Any]:
    return {name: one(u, m) for name, one in FUNCTIONS.items()}


SLOPES_IN_U = jax.jit(jax.vmap(jax.jacrev(compiled), (0, None)))
SLOPES_IN_M = jax.jit(jax.jacfwd(compiled, argnums=1))
duffing_motion = jax.jit(elliptic.duffing_motion)
damped_elliptic = jax.jit(elliptic.damped_elliptic)
PARAMETERS = [0.0, 1e-300, 1e-16, 1e-8, 1e-3, 0.1, 0.5, 0.5 + 1e-12, 0.9, 0.999, 1.0 - 1e-6,
              1.0 - 1e-10, 1.0 - 1e-15, 1.0 - 2.0**-53, 1.0]  # fmt: skip
OUTSIDE = [-50.0, -3.0, -0.5, -1e-9, 1.0 + 1e-6, 1.5, 4.0]
ARGUMENTS = np.concatenate(
    [[0.0, 1e-9, 1.0, 1.8540746773013719], np.random.default_rng(0).uniform(-40.0, 40.0, 12)]
)


@functools.cache
def exact(name: str, u: float, m: float) -> float:
    with mpmath.workdps(50):
        if m == 1.0:
            return float(mpmath.tanh(u) if name == "sn" else mpmath.sech(u))
        return float(mpmath.re(mpmath.ellipfun(name, mpmath.mpf(u), m=mpmath.mpf(m))))


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("m", PARAMETERS)
def test_functions_agree_with_mpmath(name: str, m: float) -> None:
    expected = [exact(name, u, m) for u in ARGUMENTS]
    for found in (FUNCTIONS[name](ARGUMENTS, m), compiled(ARGUMENTS, m)[name]):
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("m", [0.0, 1e-8, 0.3, 0.5, 0.99, 1.0 - 1e-12])
def test_many_periods_cost_the_rounding_of_their_argument(m: float) -> None:
    far = np.resize([1e3, -12345.678, 1e6, 3.3e7], len(ARGUMENTS))
    for name, found in compiled(far, m).items():
        error = np.abs(found - np.array([exact(name, u, m) for u in far]))
        assert (error <= 1e-15 + np.finfo(float).eps * np.abs(far)).all()


@pytest.mark.parametrize("m", OUTSIDE)
def test_other_parameters_agree_with_mpmath(m: float) -> None:
    """The reciprocal and the imaginary transformation; mpmath has both."""
    near = 0.25 * ARGUMENTS
    for name, found in compiled(near, m).items():
        np.testing.assert_allclose(found, [exact(name, u, m) for u in near], rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("m", [0.0, 0.2, 0.5, 0.8, 1.0 - 1e-9, 1.0, -2.0])
def test_slopes_in_u_are_those_of_the_differential_equations(m: float) -> None:
    u = 0.375 * ARGUMENTS
    found = compiled(u, m)
    s, c, d = (np.asarray(found[name]) for name in FUNCTIONS)
    expected = {"sn": c * d, "cn": -s * d, "dn": -m * s * c}
    for name, slope in SLOPES_IN_U(u, m).items():
        np.testing.assert_allclose(slope, expected[name], rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("m", [1e-9, 0.2, 0.5, 0.501, 0.9, 1.0 - 1e-9, -2.0, 3.0])
def test_slopes_in_m_agree_with_mpmath(name: str, m: float) -> None:
    for u in (0.4, 2.7, -7.3):
        with mpmath.workdps(60):
            step = mpmath.mpf("1e-20")
            sides = [
                mpmath.re(mpmath.ellipfun(name, mpmath.mpf(u), m=mpmath.mpf(m) + side))
                for side in (step, -step)
            ]
            expected = float((sides[0] - sides[1]) / (2 * step))
        assert float(SLOPES_IN_M(u, m)[name]) == pytest.approx(expected, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("m", [0.0, 1.0])
def test_slopes_in_m_at_the_limits(m: float) -> None:
    """Abramowitz & Stegun 16.13 and 16.15: the first terms of the series about both limits."""
    u = 0.8
    s, c, h, k = np.sin(u), np.cos(u), np.tanh(u), 1.0 / np.cosh(u)
    expected = (
        {"sn": -0.25 * (u - s * c) * c, "cn": 0.25 * (u - s * c) * s, "dn": -0.5 * s * s}
        if m == 0.0
        else {
            "sn": -0.25 * (np.sinh(u) * np.cosh(u) - u) * k**2,
            "cn": 0.25 * (np.sinh(u) * np.cosh(u) - u) * h * k,
            "dn": -0.25 * (np.sinh(u) * np.cosh(u) + u) * h * k,
        }
    )
    for name, slope in SLOPES_IN_M(u, m).items():
        assert float(slope) == pytest.approx(expected[name], rel=1e-9)


def test_complete_integrals_agree_with_mpmath() -> None:
    for m in (-5.0, 0.0, 1e-9, 0.5, 0.99, 1.0 - 1e-12):
        with mpmath.workdps(30):
            first, second = float(mpmath.ellipk(m)), float(mpmath.ellipe(m))
        assert float(elliptic.quarter_period(m)) == pytest.approx(first, rel=1e-14)
        assert float(elliptic.second_integral(m)) == pytest.approx(second, rel=1e-13)


@pytest.mark.parametrize(
    ("omega", "beta", "z0", "v0"),
    [(1.05, 0.4, 1.3, -0.7), (21.8, 3e6, 0.003, 0.0), (2.0, -0.9, 1.0, 0.5), (1.0, 0.0, 0.2, 0.3)],
)
def test_the_duffing_motion_solves_its_equation(
    omega: float, beta: float, z0: float, v0: float
) -> None:
    time = np.linspace(0.0, 40.0 / omega, 301)
    found = np.asarray(duffing_motion(time, omega, beta, z0, v0))
    solved = solve_ivp(
        lambda _, y: [y[1], -(omega**2) * y[0] - beta * y[0] ** 3], (0.0, time[-1]), [z0, v0],
        "DOP853", time, rtol=1e-13, atol=1e-15,
    )  # fmt: skip
    np.testing.assert_allclose(found, solved.y[0], atol=1e-9 * np.abs(found).max())


def test_a_duffing_motion_beyond_its_barrier_is_not_a_number() -> None:
    assert np.isnan(duffing_motion(np.ones(301), 1.0, -1.0, 0.0, 2.0)).all()


def test_the_duffing_frequency_is_that_of_the_motion() -> None:
    for beta, swing in ((0.5, 1.4), (-0.3, 1.2), (0.0, 1.0)):
        period = 2.0 * np.pi / float(elliptic.duffing_frequency(swing, 1.1, beta))
        later = duffing_motion(period * np.arange(301), 1.1, beta, swing, 0.0)[1:8:6]
        np.testing.assert_allclose(later, swing, rtol=1e-11)


def damped_duffing(decay: float, time: np.ndarray) -> np.ndarray:
    found = solve_ivp(
        lambda _, y: [y[1], -2.0 * decay * y[1] - y[0] - 0.8 * y[0] ** 3], (0.0, time[-1]),
        [1.5, 0.0], "DOP853", time, rtol=1e-11, atol=1e-13,
    )  # fmt: skip
    return np.asarray(found.y[0])


def test_the_damped_ansatz_tends_to_the_solution_as_the_damping_falls() -> None:
    time = np.linspace(0.0, 30.0, 900)
    errors = []
    for decay in (0.04, 0.02, 0.01):
        ansatz = elliptic.DampedElliptic(0.0, 1.5, 0.0, decay, 1.0, 0.8)
        motion = damped_duffing(decay, time)
        errors.append(np.abs(np.asarray(damped_elliptic(time, ansatz)) - motion).max())
    assert errors[0] < 0.1
    assert all(later < 0.6 * former for former, later in pairwise(errors))


def test_the_damped_ansatz_without_cubic_term_is_a_damped_cosine() -> None:
    time = np.linspace(0.0, 20.0, 900)
    ansatz = elliptic.DampedElliptic(0.3, 1.2, 0.4, 0.1, 2.0, 0.0)
    expected = 0.3 + 1.2 * np.exp(-0.1 * time) * np.cos(2.0 * time + 0.4)
    np.testing.assert_allclose(damped_elliptic(time, ansatz), expected, atol=1e-7)


@pytest.mark.long  # quick: tests/reduced_models/identification/test_elliptic.py
def test_the_ansatz_is_found_in_a_record() -> None:
    """From its own motion with noise, in metres, within five standard errors."""
    true = elliptic.DampedElliptic(0.06, 0.004, 0.7, 0.6, 21.0, 1.2e7)
    time = np.linspace(0.0, 3.0, 900)
    clean = np.asarray(damped_elliptic(time, true))
    noise = np.random.default_rng(3).normal(0.0, 2e-5, len(time))
    found = elliptic.fit_damped_elliptic(PistonRecord(time, clean + noise))
    assert found.residual == pytest.approx(2e-5, rel=0.1)
    for value, error, expected in zip(found.ansatz, found.errors, true, strict=True):
        assert abs(value - expected) < 5.0 * error
        assert error < 0.05 * abs(expected)


def test_a_motion_without_a_level_of_rest_has_no_ansatz() -> None:
    time = np.linspace(0.0, 10.0, 900)
    rough = np.random.default_rng(0).normal(size=900)
    with pytest.raises(RecordError, match="damped elliptic"):
        elliptic.fit_damped_elliptic(PistonRecord(time, rough))
