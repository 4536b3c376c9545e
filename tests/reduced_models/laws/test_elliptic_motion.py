"""The elliptic function of an undamped Duffing oscillator, beside a solver and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

from reduced_models.laws.elliptic_motion import elliptic_motion

PLACES = {"sn": 0, "cn": 1, "dn": 2}
TOPS = {"sn": 1.0, "cn": 0.0, "dn": 0.0}
"""Where each function is greatest, in quarter periods."""


@pytest.mark.parametrize(
    ("k", "beta", "start", "function"),
    [
        (1.1, 0.8, 1.3, "cn"),
        (-0.242, 1.0083333, 1.2, "cn"),  # through both wells
        (1.0, -0.3, -1.4, "sn"),
        (-1.0, 1.0, 1.2, "dn"),  # within the upper well
        (-1.0, 1.0, -1.2, "dn"),
    ],
)
def test_it_is_the_solution(k: float, beta: float, start: float, function: str) -> None:
    time = np.linspace(0.0, 20.0, 201)
    rest = 0.3
    solved = solve_ivp(
        lambda _, y: [y[1], -k * (y[0] - rest) - beta * (y[0] - rest) ** 3], (0.0, 20.0),
        [rest + start, 0.0], "DOP853", time, rtol=1e-11, atol=1e-12,
    )  # fmt: skip
    later = 37  # the motion is told from any of its moments
    found = elliptic_motion(k, beta, rest, solved.y[0, later], solved.y[1, later])
    assert found is not None
    assert found.function == function
    phase = TOPS[function] * ellipk(found.m)
    values = ellipj(found.rate * time + phase, found.m)[PLACES[function]]
    sign = 1.0 if function == "dn" else np.sign(start)
    expected = found.rest + sign * found.amplitude * values
    np.testing.assert_allclose(solved.y[0], expected, atol=1e-7)


@pytest.mark.parametrize(
    ("k", "beta", "z0", "v0"),
    [(1.0, 0.5, 0.0, 0.0), (-1.0, 0.0, 1.0, 0.0), (1.0, -1.0, 0.0, 2.0), (1.0, -1.0, 3.0, 0.0)],
)
def test_what_is_not_periodic_is_none(k: float, beta: float, z0: float, v0: float) -> None:
    assert elliptic_motion(k, beta, 0.0, z0, v0) is None


def test_a_linear_spring_moves_by_a_cosine() -> None:
    found = elliptic_motion(4.0, 0.0, 0.0, 0.3, 0.0)
    assert found is not None
    assert found[2:] == pytest.approx((0.3, 2.0, 0.0))
