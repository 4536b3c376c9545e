"""Laws from the drift of an elliptic motion, beside what made the record."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord
from granular.shared.errors import RecordError
from reduced_models import HeightMap, fit
from reduced_models.laws.elliptic import DampedElliptic, damped_elliptic
from reduced_models.laws.elliptic_averaging import (
    AveragedMotion,
    averaged_motion,
    fit_averaged_motion,
)

TIME = np.linspace(0.0, 40.0, 1000)


def record(law: Callable[[float, float], float], start: float) -> PistonRecord:
    """Of z'' = law(z, z') with 1 % of noise."""
    z = solve_ivp(
        lambda _, y: [y[1], law(*y)], (0.0, TIME[-1]), [start, 0.0], "DOP853", TIME, rtol=1e-10,
        atol=1e-12,
    ).y[0]  # fmt: skip
    return PistonRecord(TIME, z + np.random.default_rng(0).normal(0.0, 0.01 * z.std(), len(z)))


def duffing(lam: float, k: float, beta: float) -> PistonRecord:
    return record(lambda z, v: -2.0 * lam * v - k * z - beta * z**3, 1.3)


def van_der_pol_like(alpha: float) -> PistonRecord:
    """With omega = 1.05 and g0 = -1, from z = 1."""
    return record(lambda z, v: -1.0 - 1.1025 * z - 2.0 * alpha * (z**2 - 2.0 * z) * v, 1.0)


@pytest.mark.parametrize(
    "beta",
    [-0.3, pytest.param(0.0, marks=pytest.mark.long), pytest.param(0.8, marks=pytest.mark.long)],
)
def test_with_linear_drag_it_is_the_damped_ansatz(beta: float) -> None:
    """Two programmes: one by JAX with closed forms of the means, one by quadrature."""
    motion = AveragedMotion(0.2, 1.3, 0.4, 0.03, 0.0, 1.21, beta)
    expected = damped_elliptic(TIME, DampedElliptic(0.2, 1.3, 0.4, 0.03, 1.1, beta))
    np.testing.assert_allclose(averaged_motion(TIME, motion), expected, atol=5e-3)


@pytest.mark.parametrize(
    ("lam", "k", "beta"),
    [
        (0.05, 1.1, 0.8),
        pytest.param(0.02, 1.0, -0.3, marks=pytest.mark.long),
        pytest.param(0.1, 1.0, 0.5, marks=pytest.mark.long),
    ],
)
def test_a_duffing_law_with_drag_from_the_drift(lam: float, k: float, beta: float) -> None:
    found = fit_averaged_motion(duffing(lam, k, beta)).duffing
    assert [found[name] for name in ("lam", "k", "beta")] == pytest.approx([lam, k, beta], rel=0.02)
    assert found["rest"] == pytest.approx(0.0, abs=0.005)


@pytest.mark.long  # quick: the Duffing law
@pytest.mark.parametrize("alpha", [0.01, 0.03])
def test_the_van_der_pol_like_law_from_the_drift(alpha: float) -> None:
    """The direct fit, through the differential equation, is ten times closer."""
    made = van_der_pol_like(alpha)
    found = fit_averaged_motion(made).van_der_pol_like(HeightMap())
    assert found == pytest.approx({"alpha": alpha, "omega": 1.05, "g0": -1.0}, rel=0.03)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        direct = fit(made, "van-der-pol-like", map=HeightMap()).parameters
    assert direct["alpha"] == pytest.approx(alpha, rel=0.01)
    assert direct["omega"] == pytest.approx(1.05, rel=0.001)


@pytest.mark.long  # quick: the Duffing law
def test_a_damping_beyond_critical_is_refused() -> None:
    """The source's own alpha: averaging would be off by a quarter."""
    with pytest.raises(RecordError, match=r"comes to 2\.\d of critical"):
        fit_averaged_motion(van_der_pol_like(0.17)).van_der_pol_like(HeightMap())


@pytest.mark.long  # quick: the residual of a motion that is there
def test_noise_has_no_averaged_motion() -> None:
    rough = np.random.default_rng(0).normal(size=len(TIME))
    with pytest.raises(RecordError, match="damped elliptic motion"):
        fit_averaged_motion(PistonRecord(TIME, rough))
