"""One relaxing mode follows a column of grains that diffuses against drag."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from scipy.integrate import odeint
from scipy.optimize import newton

from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.linearization import SmallSwing, small_swing

WEIGHT, REST, POWER = 9.8, 0.06, 2.5
OMEGA = math.sqrt(POWER * WEIGHT / REST)


def column(lateness: float) -> tuple[float, float]:
    """Frequency and damping ratio of a piston on a column whose drag is omega R/k = lateness."""

    def balance(p: complex) -> complex:
        s = p * lateness / OMEGA
        return p * p / OMEGA**2 + cmath.sqrt(s) / cmath.tanh(cmath.sqrt(s))

    root = newton(balance, complex(-OMEGA * lateness / 6.0, OMEGA), tol=1e-12)
    return abs(root), -root.real / abs(root)


def swing(name: str, lateness: float) -> SmallSwing:
    known = {
        "lam": OMEGA * lateness / 6.0,
        "weight": WEIGHT,
        "rest": REST,
        "power": POWER,
        "relaxation": lateness / OMEGA / 15.0,
    }
    law = LAWS[name]
    found = small_swing(law, [known[key] for key in law.parameters], REST)
    assert isinstance(found, SmallSwing)
    return found


@pytest.mark.parametrize("lateness", [0.3, 1.0])
def test_a_small_swing_is_that_of_the_column(lateness: float) -> None:
    """Ten times nearer than affine drag, which leaves out the next order in the lateness."""
    frequency, ratio = column(lateness)

    def errors(name: str) -> list[float]:
        found = swing(name, lateness)
        return [abs(2.0 * math.pi / found.period / frequency - 1.0), abs(found.damping_ratio - ratio)]

    near, far = errors("relaxing-column"), errors("power-law-spring")
    assert max(near) < 2e-3
    assert max(near) < 0.1 * max(far)


def motion(name: str) -> np.ndarray:
    """From 80 mm, with a relaxation of a tenth of a millisecond where there is one."""
    known = {"lam": 1.0, "weight": WEIGHT, "rest": REST, "power": POWER, "relaxation": 1e-4}
    law = LAWS[name]
    field = compile_rates(law.equation, (), "math")
    numbers = [known[key] for key in law.parameters]

    def rates(state: np.ndarray, _: float) -> tuple[float, ...]:
        z, v, *hidden = map(float, state)
        return (v, *field(z, v, *hidden, *numbers))

    start = (0.08, *(0.0 for _ in range(1 + len(law.hidden))))
    return np.asarray(odeint(rates, start, np.linspace(0.0, 1.0, 200), rtol=1e-9, atol=1e-11)[:, 0])


def test_without_relaxation_it_is_the_power_law_spring() -> None:
    np.testing.assert_allclose(motion("relaxing-column"), motion("power-law-spring"), atol=2e-5)
