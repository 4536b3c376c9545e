"""The estimator of derivatives: exact on polynomials, and honest about the noise it leaves."""

from __future__ import annotations

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import RecordError
from reduced_models.records.derivatives import Derivatives, derivatives

TIME = np.linspace(0.0, 30.0, 1000)
INNER = slice(100, -100)


def swing(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    z = 0.06 + 0.01 * np.cos(1.3 * time)
    return z, -0.013 * np.sin(1.3 * time), -0.0169 * np.cos(1.3 * time)


def noisy(time: np.ndarray, level: float, seed: int = 0) -> PistonRecord:
    noise = np.random.default_rng(seed).normal(0.0, level, len(time))
    return PistonRecord(time, swing(time)[0] + noise)


def errors(found: Derivatives) -> list[float]:
    estimates = (found.height, found.velocity, found.acceleration)
    return [
        float(np.std((one - true)[INNER])) for one, true in zip(estimates, swing(found.time), strict=True)
    ]


def test_parabolas_are_differentiated_exactly() -> None:
    found = derivatives(PistonRecord(TIME, 0.3 + 0.2 * TIME - 0.05 * TIME**2))
    np.testing.assert_allclose(found.velocity[INNER], (0.2 - 0.1 * TIME)[INNER], atol=1e-7)
    np.testing.assert_allclose(found.acceleration[INNER], -0.1, atol=1e-5)


def noises(found: Derivatives) -> list[float]:
    """Standard deviations of height, velocity and acceleration, by the root of the sum of squared weights."""
    from scipy.signal import savgol_coeffs

    step = TIME[1]
    window = round(found.width / step)
    weights = [savgol_coeffs(window, 5, deriv=order, delta=step) for order in range(3)]
    return [found.record_noise * float(np.linalg.norm(row)) for row in weights]


def test_noise_of_the_acceleration_is_that_of_the_weights() -> None:
    found = derivatives(noisy(TIME, 1e-4))
    assert found.acceleration_noise == pytest.approx(noises(found)[2], rel=0.1)
    assert found.record_noise == pytest.approx(1e-4, rel=0.1)


@pytest.mark.parametrize(
    "level", [1e-3, *(pytest.param(level, marks=pytest.mark.long) for level in (1e-4, 1e-6))]
)
def test_smoothing_beats_differences_at_every_noise(level: float) -> None:
    record = noisy(TIME, level)
    found = derivatives(record)
    speed = np.gradient(record.height, TIME)
    plain = found._replace(height=record.height, velocity=speed, acceleration=np.gradient(speed, TIME))
    assert all(one < 0.5 * other for one, other in zip(errors(found), errors(plain), strict=True))


def test_what_smoothing_takes_from_the_motion_is_no_more_than_twice_the_noise() -> None:
    for level in (1e-3, 1e-4, 1e-5, 1e-7):
        found = derivatives(noisy(TIME, level))
        assert all(error < 3.0 * noise for error, noise in zip(errors(found), noises(found), strict=True))


def test_uneven_samples_do_as_well_as_even_ones() -> None:
    kept = np.sort(np.random.default_rng(1).choice(2000, 1000, replace=False))
    time = np.linspace(0.0, 30.0, 2000)[kept]
    uneven, even = derivatives(noisy(time, 1e-4)), derivatives(noisy(TIME, 1e-4))
    assert uneven.record_noise == pytest.approx(1e-4, rel=0.1)
    for one, other in zip(errors(uneven), errors(even), strict=True):
        assert one < 3.0 * other


def test_even_and_uneven_fits_are_the_same() -> None:
    from reduced_models.records.derivatives import _polynomials_at_uneven_times, _SavitzkyGolayFilter

    record = noisy(TIME, 1e-4)
    even = _SavitzkyGolayFilter(float(TIME[-1] - TIME[0]) / (len(TIME) - 1), 41)(record.height[None])[0]
    uneven = _polynomials_at_uneven_times(record.height[None], TIME, 41)[0]
    np.testing.assert_allclose(uneven[:, 25:-25], even[:, 25:-25], rtol=1e-6, atol=1e-8)


def test_short_records_are_refused() -> None:
    with pytest.raises(RecordError, match="at least 20"):
        derivatives(PistonRecord(TIME[:19], TIME[:19] ** 2))
