"""Elliptic motions and elliptic averaging, compared with a solver and SciPy."""

import numpy as np
import pytest
from scipy.special import ellipe, ellipj, ellipk

from granular import PistonRecord
from reduced_models.identification.elliptic_averaging import (
    OSCILLATORS,
    DuffingVanDerPolOscillator,
    averaged_amplitude,
    averaged_frequency,
    elliptic_motion,
    maximum_damping_over_rate,
    oscillates_about_equilibrium,
)
from reduced_models.records.envelope import Envelope, envelope
from tests.reduced_models.made import moved

PLACES = {"sn": 0, "cn": 1, "dn": 2}
TOPS = {"sn": 1.0, "cn": 0.0, "dn": 0.0}
"""Time of each function's maximum, in quarter periods."""


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
def test_elliptic_motion_solves_the_equation(k: float, beta: float, start: float, function: str) -> None:
    time = np.linspace(0.0, 20.0, 201)
    rest = 0.3
    z = moved(lambda t, z, v: -k * (z - rest) - beta * (z - rest) ** 3, time, rest + start, rtol=1e-11)
    later = 37  # the motion is determined by its state at any time
    energy = 0.5 * k * start**2 + 0.25 * beta * start**4
    x, side = z[later] - rest, np.sign(z[later + 1] - z[later - 1])
    speed = side * np.sqrt(2.0 * (energy - 0.5 * k * x**2 - 0.25 * beta * x**4))
    found = elliptic_motion(k, beta, rest, z[later], speed)
    assert found.function == function
    phase = TOPS[function] * ellipk(found.m)
    values = ellipj(found.rate * time + phase, found.m)[PLACES[function]]
    sign = 1.0 if function == "dn" else np.sign(start)
    np.testing.assert_allclose(z, found.rest + sign * found.amplitude * values, atol=1e-7)


@pytest.mark.parametrize(
    ("k", "beta", "z0", "v0"),
    [(1.0, 0.5, 0.0, 0.0), (-1.0, 0.0, 1.0, 0.0), (1.0, -1.0, 0.0, 2.0), (1.0, -1.0, 3.0, 0.0)],
)
def test_a_motion_that_is_not_periodic_has_no_elliptic_solution(
    k: float, beta: float, z0: float, v0: float
) -> None:
    assert elliptic_motion(k, beta, 0.0, z0, v0) is None


def test_the_elliptic_motion_of_a_linear_spring_is_a_cosine() -> None:
    found = elliptic_motion(4.0, 0.0, 0.0, 0.3, 0.0)
    assert found[2:] == pytest.approx((0.3, 2.0, 0.0))


TIME = np.linspace(0.0, 40.0, 1000)


def cycles(one: DuffingVanDerPolOscillator, start: float) -> Envelope:
    """Return the cycles of the oscillator's simulated motion, released at x = start."""

    def acceleration(_: float, x: float, v: float) -> float:
        return -2.0 * (one.decay + one.tilt * x + one.bend * x**2) * v - one.k * x - one.beta * x**3

    return envelope(PistonRecord(TIME, moved(acceleration, TIME, start)))


def averaging_errors(one: DuffingVanDerPolOscillator, start: float) -> tuple[float, float]:
    """Return the maximum errors of the averaged amplitude, relative to the first one, and of the
    frequency.
    """
    found = cycles(one, start)
    amplitude = averaged_amplitude(found.time, float(found.amplitude[0]), one)
    frequency = 2.0 * np.pi * averaged_frequency(amplitude, one)
    return (
        float(np.abs(amplitude - found.amplitude).max() / found.amplitude[0]),
        float(np.abs(frequency / found.frequency - 1.0).max()),
    )


def test_the_averaged_motion_of_a_linear_spring_with_drag_decays_exponentially() -> None:
    one = DuffingVanDerPolOscillator(1.21, 0.0, 0.03)
    found = averaged_amplitude(TIME, 0.4, one)
    np.testing.assert_allclose(found, 0.4 * np.exp(-0.03 * TIME), rtol=1e-6)
    np.testing.assert_allclose(averaged_frequency(found, one), 1.1 / (2.0 * np.pi), rtol=1e-12)


@pytest.mark.parametrize("beta", [0.8, -0.3])
def test_mean_of_the_drag_over_an_elliptic_cycle_has_a_closed_form(beta: float) -> None:
    """<sn^2 dn^2> = ((2m - 1) E + (1 - m) K)/(3 m K)."""
    swing, step = 1.2, 1e-4
    m = 0.5 * beta * swing**2 / (1.1 + beta * swing**2)
    integer = ellipk(m)
    mean = ((2.0 * m - 1.0) * ellipe(m) + (1.0 - m) * integer) / (3.0 * m * integer)
    found = averaged_amplitude(np.array([0.0, step]), swing, DuffingVanDerPolOscillator(1.1, beta, 0.05))
    assert (found[1] - swing) / step == pytest.approx(-2.0 * 0.05 * swing * mean, rel=1e-4)


@pytest.mark.parametrize("start", [0.1, 1.0])
def test_negative_drag_leads_to_the_limit_cycle_of_van_der_pol(start: float) -> None:
    one = DuffingVanDerPolOscillator(1.0, 0.0, -0.2, 0.0, 0.2 / 0.3**2)
    assert averaged_amplitude(TIME, start, one)[-1] == pytest.approx(2.0 * 0.3, rel=1e-3)


@pytest.mark.parametrize(
    ("k", "beta", "lam"), [(1.1, 0.8, 0.05), (1.0, -0.3, 0.02), (1.0, 0.5, 0.1), (-0.3, 1.0, 0.005)]
)
def test_averaged_duffing_oscillation_agrees_with_simulation(k: float, beta: float, lam: float) -> None:
    """In the last case the motion crosses two wells."""
    one = OSCILLATORS["duffing"]({"k": k, "beta": beta, "lam": lam, "rest": 0.0})
    amplitude, frequency = averaging_errors(one, 1.3)
    assert amplitude < 0.005
    assert frequency < 0.01


def test_averaged_van_der_pol_like_oscillation_agrees_with_simulation() -> None:
    """The law of the coordinate z is converted to a law of the height."""
    errors = []
    for alpha in (0.02, 0.01):
        values = {"alpha": alpha, "omega": 1.05, "g0": -1.0, "shift": 0.05, "scale": 0.01}
        one = OSCILLATORS["van-der-pol-like"](values)
        z = -1.0 / 1.05**2 + np.array([0.7])  # some place, at which both are one damping
        x = 0.01 * 0.7
        damping = one.decay + one.tilt * x + one.bend * x**2
        assert damping == pytest.approx(alpha * float(z[0] ** 2 - 2.0 * z[0]), rel=1e-12)
        errors.append(averaging_errors(one, 0.019))
    assert errors[1][0] < 0.005
    assert errors[1][1] < 0.005
    assert errors[1][0] < 0.6 * errors[0][0]  # of the first order in the damping


@pytest.mark.parametrize(
    ("k", "beta", "amplitude", "turns"),
    [
        (1.0, 0.5, 3.0, True),
        (-1.0, 1.0, 1.5, True),
        (-1.0, 1.0, 1.4, False),  # sqrt(2)
        (1.0, -0.25, 1.9, True),
        (1.0, -0.25, 2.1, False),
        (-1.0, 0.0, 1.0, False),
    ],
)
def test_barriers_of_the_potential_limit_the_amplitude_of_oscillation(
    k: float, beta: float, amplitude: float, turns: bool
) -> None:
    assert (
        oscillates_about_equilibrium(np.array([amplitude]), DuffingVanDerPolOscillator(k, beta, 0.0)) == turns
    )


def test_limit_of_the_averaging_method_uses_the_maximum_damping_over_the_complete_oscillation() -> None:
    assert maximum_damping_over_rate(
        2.0, DuffingVanDerPolOscillator(4.0, 0.0, 0.1, -0.2, 0.3)
    ) == pytest.approx(0.85)
