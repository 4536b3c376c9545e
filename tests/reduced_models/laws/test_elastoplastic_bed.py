"""A bed that yields: its small swing, and the work of its loop."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.linearization import SmallSwing, small_swing
from reduced_models.laws.solution import solve_law

LAW = LAWS["elastoplastic-bed"]
TRUE = {"lam": 0.02, "weight": 9.8, "rest": 0.06, "power": 2.5, "modulus": 0.3, "strength": 0.05}


def values(**changes: float) -> list[float]:
    return [(TRUE | changes)[name] for name in LAW.parameters]


def test_a_small_swing_feels_pressure_and_shear() -> None:
    found = small_swing(LAW, values(), 0.06)
    assert isinstance(found, SmallSwing)
    omega = math.sqrt(9.8 * (2.5 + 0.3) / 0.06)
    assert found.z == pytest.approx(0.06, rel=1e-9)
    assert found.period == pytest.approx(2.0 * math.pi / omega, rel=1e-9)
    assert found.damping_ratio == pytest.approx(0.02 / omega, rel=1e-6)


def test_without_a_modulus_it_is_the_power_law_spring() -> None:
    time = np.linspace(0.0, 2.0, 400)
    spring = LAWS["power-law-spring"]
    plain = solve_law(spring, time, 0.08, 0.0, [TRUE[name] for name in spring.parameters], 0.02)
    soft = solve_law(LAW, time, 0.08, 0.0, values(modulus=1e-12), 0.02)
    np.testing.assert_allclose(soft.z, plain.z, rtol=1e-7)


def test_shear_stress_stops_at_the_strength_and_takes_energy() -> None:
    """Large swings die out by yielding alone; small ones hardly, since they do not yield."""
    time = np.linspace(0.0, 3.0, 3000)
    far = solve_law(LAW, time, 0.09, 0.0, values(lam=1e-9), 0.02).z
    near = solve_law(LAW, time, 0.0603, 0.0, values(lam=1e-9), 0.02).z
    kept = [np.ptp(one[-600:]) / np.ptp(one[:600]) for one in (far, near)]
    assert kept[0] < 0.5
    assert kept[1] > 0.95
