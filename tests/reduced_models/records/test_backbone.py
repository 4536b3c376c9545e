"""Derivatives, envelopes, and frequency and damping against amplitude (backbone), for motions with
known parameters.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import RecordError
from reduced_models.identification.elliptic_averaging import DuffingVanDerPolOscillator, averaged_frequency
from reduced_models.records.backbone import backbone_of_driven_oscillation, backbone_of_free_oscillation
from reduced_models.records.derivatives import Derivatives, derivatives
from reduced_models.records.envelope import envelope
from tests.reduced_models.made import damped_cosine, moved, noisy

SEEDS = range(10)
KINDS = ("dry", "dry and viscous", "quadratic")


def decay(kind: str, seed: int) -> tuple[PistonRecord, Callable[[float], float], float]:
    """Simulated free decay with noise, its damping ratio at an amplitude, and its angular frequency."""
    random = np.random.default_rng(seed)
    omega, size = math.tau * random.uniform(1.5, 5.0), random.uniform(1e-3, 8e-3)
    halves = random.uniform(4.0, 12.0)  # half cycles until friction stops the motion
    friction = 0.0 if kind == "quadratic" else omega**2 * size / (4.0 * halves)
    lam = omega * random.uniform(0.005, 0.03) if "viscous" in kind else 0.0
    drag = random.uniform(0.02, 0.15) / size if kind == "quadratic" else 0.0
    time = np.linspace(0.0, (24.0 if drag else 12.0) * math.tau / omega, 3000)

    def acceleration(_: float, z: float, v: float) -> float:
        slip = math.tanh(v / (1e-3 * omega * size))
        return -(omega**2) * z - 2.0 * lam * v - friction * slip - drag * abs(v) * v

    height = 0.06 + moved(acceleration, time, size, method="LSODA", rtol=1e-9)
    noise = random.choice([1e-4, 1e-3, 5e-3]) * size

    def ratio(amplitude: float) -> float:
        dry = 2.0 * friction / (math.pi * omega**2 * amplitude)
        return lam / omega + dry + 4.0 * drag * amplitude / (3.0 * math.pi)

    return PistonRecord(time, height + random.normal(0.0, noise, len(time))), ratio, omega


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "seed", [SEEDS[0], *(pytest.param(seed, marks=pytest.mark.long) for seed in SEEDS[1:])]
)
def test_damping_ratio_at_an_amplitude_is_recovered(kind: str, seed: int) -> None:
    """The error is below a tenth at the reported amplitudes, although the ratio changes tenfold within
    the record.
    """
    record, ratio, omega = decay(kind, seed)
    found = backbone_of_free_oscillation(record)
    for amplitude in found.amplitudes_to_show(1e3):
        point = found.interpolate_at(amplitude)
        assert point.damping_ratio == pytest.approx(ratio(amplitude), rel=0.1)
        assert point.frequency == pytest.approx(omega, rel=0.01)
    assert (found.damping_ratio < 1.0).all()


def test_error_bars_of_a_noisy_linear_decay_cover_the_truth() -> None:
    time, inside = np.linspace(0.0, 5.0, 2500), []
    for seed in range(10):
        record = noisy(time, 0.06 + damped_cosine(time, 1e-3, 0.4, 20.0), 2e-5, seed)
        point = backbone_of_free_oscillation(record).interpolate_at(5e-4)
        inside.append(abs(point.damping_ratio - 0.02) < point.damping_error)
        inside.append(abs(point.frequency - 20.0) < point.frequency_error)
    assert np.mean(inside) > 0.8


@pytest.mark.parametrize("beta", [0.0, 3e7])
def test_backbone_of_a_driven_record_is_found_from_the_restoring_force(beta: float) -> None:
    """An oscillator is swept through resonance. Its spring is linear or cubic.

    At amplitude A, the cubic spring beta z^3 adds 3/4 beta A^2 to the squared frequency.
    """
    time = np.linspace(0.0, 40.0, 20001)
    omega, lam = 20.0, 0.6

    def push(t: Any) -> Any:
        return 0.08 * np.sin((14.0 + 0.15 * t) * t)

    def acceleration(t: float, z: float, v: float) -> float:
        return push(t) - omega**2 * z - beta * z**3 - 2.0 * lam * v

    height = 0.06 + moved(acceleration, time, 0.0, method="LSODA", rtol=1e-9)
    found = backbone_of_driven_oscillation(noisy(time, height, 1e-7), lambda z, v: push(time))
    for amplitude in found.amplitudes_to_show(1e3)[:2]:
        point = found.interpolate_at(amplitude)
        expected = math.sqrt(omega**2 + 0.75 * beta * amplitude**2)
        assert point.frequency == pytest.approx(expected, rel=0.01)
        assert point.damping_ratio == pytest.approx(lam / expected, rel=0.1)


def test_a_record_of_noise_has_no_backbone() -> None:
    noise = np.random.default_rng(0).normal(0.0, 1.0, 4000)
    with pytest.raises(RecordError, match="extremes"):
        backbone_of_free_oscillation(PistonRecord(np.linspace(0.0, 60.0, 4000), noise))


TIME = np.linspace(0.0, 60.0, 4000)


def blurred(height: np.ndarray, level: float) -> PistonRecord:
    return noisy(TIME, height, level, 5)


@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_backbone_of_a_damped_cosine_has_constant_frequency_and_damping(noise: float) -> None:
    found = envelope(blurred(0.06 + 0.002 * np.exp(-0.03 * TIME) * np.cos(2.0 * TIME + 0.4), noise))
    tolerance = 1e-4 + 100.0 * noise
    np.testing.assert_allclose(found.level, 0.06, atol=2e-6 + 3.0 * noise)
    np.testing.assert_allclose(found.amplitude, 0.002 * np.exp(-0.03 * found.time), rtol=2e-3 + 5e3 * noise)
    np.testing.assert_allclose(np.mean(found.frequency), 2.0, rtol=tolerance)
    assert np.mean(found.damping) == pytest.approx(0.03, rel=0.03)
    assert np.mean(found.damping_ratio) == pytest.approx(0.015, rel=0.03)
    # one extreme between two passages, and of each three in a row a cycle
    assert len(found.time) == int(60.0 * 2.0 / np.pi) - 3


def test_backbone_of_a_duffing_oscillation_agrees_with_theory() -> None:
    found = envelope(blurred(moved(lambda t, z, v: -0.02 * v - z - 0.5 * z**3, TIME, 1.5), 0.002))
    expected = 2.0 * np.pi * averaged_frequency(found.amplitude, DuffingVanDerPolOscillator(1.0, 0.5, 0.01))
    assert np.ptp(expected) > 0.05  # there is a backbone to see
    away = (found.frequency - expected) / found.frequency_noise
    assert np.sqrt((away**2).mean()) < 2.0
    np.testing.assert_allclose(found.frequency, expected, rtol=5e-3)


def test_a_growing_oscillation_has_negative_damping() -> None:
    found = envelope(blurred(np.exp(0.02 * TIME) * np.sin(1.5 * TIME), 1e-3))
    assert np.mean(found.damping) == pytest.approx(-0.02, rel=0.05)


def test_envelope_of_noise_or_too_few_cycles_is_refused() -> None:
    for height in (blurred(np.zeros(len(TIME)), 1.0).height, np.cos(0.1 * TIME)):
        with pytest.raises(RecordError, match="extremes"):
            envelope(PistonRecord(TIME, height))


def test_damping_from_few_cycles_is_uncertain() -> None:
    """A damping ratio four times too large is contradicted by peaks of 20 cycles, but not of 3 cycles."""
    for cycles, sure in ((3.1, False), (20.0, True)):
        time = np.linspace(0.0, cycles, int(60 * cycles))
        displacement = np.exp(-0.01 * np.pi * time) * np.cos(2.0 * np.pi * time)
        random = np.random.default_rng(0)
        seen = envelope(PistonRecord(time, 1e-3 * (displacement + random.normal(0.0, 0.03, len(time)))))
        assert seen.peak_damping.contradicts(0.02) == sure


EVEN_TIME = np.linspace(0.0, 30.0, 1000)
INNER = slice(100, -100)


def exact_oscillation(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    z = 0.06 + 0.01 * np.cos(1.3 * time)
    return z, -0.013 * np.sin(1.3 * time), -0.0169 * np.cos(1.3 * time)


def noisy_oscillation(time: np.ndarray, level: float) -> PistonRecord:
    return noisy(time, exact_oscillation(time)[0], level)


def errors(found: Derivatives) -> list[float]:
    estimates = (found.height, found.velocity, found.acceleration)
    return [
        float(np.std((one - true)[INNER]))
        for one, true in zip(estimates, exact_oscillation(found.time), strict=True)
    ]


def test_smoothed_derivatives_of_parabolas_are_exact() -> None:
    found = derivatives(PistonRecord(EVEN_TIME, 0.3 + 0.2 * EVEN_TIME - 0.05 * EVEN_TIME**2))
    np.testing.assert_allclose(found.velocity[INNER], (0.2 - 0.1 * EVEN_TIME)[INNER], atol=1e-7)
    np.testing.assert_allclose(found.acceleration[INNER], -0.1, atol=1e-5)


def noises(found: Derivatives) -> list[float]:
    """Return the standard deviations of height, velocity and acceleration, from the sums of squared
    filter weights.
    """
    from scipy.signal import savgol_coeffs

    step = EVEN_TIME[1]
    window = round(found.width / step)
    weights = [savgol_coeffs(window, 5, deriv=order, delta=step) for order in range(3)]
    return [found.record_noise * float(np.linalg.norm(row)) for row in weights]


def test_noise_of_the_acceleration_equals_the_norm_of_the_filter_weights() -> None:
    found = derivatives(noisy_oscillation(EVEN_TIME, 1e-4))
    assert found.acceleration_noise == pytest.approx(noises(found)[2], rel=0.1)
    assert found.record_noise == pytest.approx(1e-4, rel=0.1)


@pytest.mark.parametrize(
    "level", [1e-3, *(pytest.param(level, marks=pytest.mark.long) for level in (1e-4, 1e-6))]
)
def test_smoothed_derivatives_are_better_than_finite_differences_at_all_noise_levels(level: float) -> None:
    record = noisy_oscillation(EVEN_TIME, level)
    found = derivatives(record)
    speed = np.gradient(record.height, EVEN_TIME)
    plain = found._replace(height=record.height, velocity=speed, acceleration=np.gradient(speed, EVEN_TIME))
    assert all(one < 0.5 * other for one, other in zip(errors(found), errors(plain), strict=True))


def test_bias_of_smoothed_derivatives_is_below_twice_their_noise() -> None:
    for level in (1e-3, 1e-4, 1e-5, 1e-7):
        found = derivatives(noisy_oscillation(EVEN_TIME, level))
        assert all(error < 3.0 * noise for error, noise in zip(errors(found), noises(found), strict=True))


def test_derivatives_from_uneven_samples_are_as_accurate_as_from_even_ones() -> None:
    kept = np.sort(np.random.default_rng(1).choice(2000, 1000, replace=False))
    time = np.linspace(0.0, 30.0, 2000)[kept]
    uneven, even = (
        derivatives(noisy_oscillation(time, 1e-4)),
        derivatives(noisy_oscillation(EVEN_TIME, 1e-4)),
    )
    assert uneven.record_noise == pytest.approx(1e-4, rel=0.1)
    for one, other in zip(errors(uneven), errors(even), strict=True):
        assert one < 3.0 * other


def test_filters_for_even_and_uneven_samples_agree_on_even_samples() -> None:
    from reduced_models.records.derivatives import _polynomials_at_uneven_times, _SavitzkyGolayFilter

    record = noisy_oscillation(EVEN_TIME, 1e-4)
    even = _SavitzkyGolayFilter(float(EVEN_TIME[-1] - EVEN_TIME[0]) / (len(EVEN_TIME) - 1), 41)(
        record.height[None]
    )[0]
    uneven = _polynomials_at_uneven_times(record.height[None], EVEN_TIME, 41)[0]
    np.testing.assert_allclose(uneven[:, 25:-25], even[:, 25:-25], rtol=1e-6, atol=1e-8)


def test_derivatives_of_short_records_are_refused() -> None:
    with pytest.raises(RecordError, match="20 or more"):
        derivatives(PistonRecord(EVEN_TIME[:19], EVEN_TIME[:19] ** 2))
