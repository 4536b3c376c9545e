"""A bed that orders: stiffer at rest, soft again once it has been strained far."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import odeint

from reduced_models.laws.annealing_bed import HARDENING, PLASTIC, STIFFENING, TIME
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.linearization import SmallSwing, small_swing

LAW = LAWS["annealing-bed"]
TRUE = {"lam": 0.02, "weight": 9.8, "rest": 0.06, "power": 2.5, "modulus": 0.3, "strength": 0.05}


def values(**changes: float) -> list[float]:
    return [(TRUE | changes)[name] for name in LAW.parameters]


def test_a_small_swing_is_that_of_the_ordered_bed() -> None:
    """All of what order adds to the modulus, as it has had its time."""
    found = small_swing(LAW, values(), 0.06)
    assert isinstance(found, SmallSwing)
    omega = math.sqrt(9.8 * (2.5 + 0.3 * (1.0 + STIFFENING)) / 0.06)
    assert found.z == pytest.approx(0.06, rel=1e-9)
    assert found.period == pytest.approx(2.0 * math.pi / omega, rel=1e-9)


def rates(z: float, speed: float, w: float, order: float) -> tuple[float, float]:
    """Of the shear stress, and of the order."""
    _, stress, ordering = compile_rates(LAW.equation, (), "numpy")(z, speed, w, order, *values())
    return float(stress), float(ordering)


@pytest.mark.parametrize("order", [0.0, 0.4, 1.0])
def test_stress_stops_at_a_strength_that_order_raises(order: float) -> None:
    strength = 0.05 * (1.0 + HARDENING * order)
    for speed in (-0.7, 0.7):
        assert rates(0.05, speed, -math.copysign(strength, speed), order)[0] == pytest.approx(0.0)
        assert abs(rates(0.05, speed, 0.0, order)[0]) == pytest.approx(
            0.3 * (1.0 + STIFFENING * order) * 0.7 / 0.05
        )


def test_order_grows_at_rest_and_goes_with_plastic_strain() -> None:
    assert rates(0.05, 0.0, 0.03, 0.25)[1] == pytest.approx(0.75 / TIME)
    yielding = rates(0.05, -2.0, 0.05 * (1.0 + HARDENING), 1.0)[1]
    assert yielding == pytest.approx(-2.0 / (PLASTIC * 0.05))
    assert rates(0.05, -2.0, 0.0, 1.0)[1] == pytest.approx(0.0)  # elastic


def test_an_ordered_bed_swings_faster_than_one_that_was_let_go() -> None:
    field, time = compile_rates(LAW.equation, (), "math"), np.linspace(0.0, 0.2, 2000)

    def slopes(state: np.ndarray, _: float) -> tuple[float, ...]:
        return (float(state[1]), *field(*map(float, state), *values()))

    fresh, ordered = (
        odeint(slopes, [0.06006, 0.0, 0.0, order], time, rtol=1e-9, atol=1e-11)[:, 0] for order in (0.0, 1.0)
    )
    # The lowest point comes after half a period, which goes with the root of the stiffness.
    ratio = math.sqrt((2.5 + 0.3) / (2.5 + 0.3 * (1.0 + STIFFENING)))
    assert ordered.argmin() / fresh.argmin() == pytest.approx(ratio, abs=0.003)
    assert ratio < 0.99
