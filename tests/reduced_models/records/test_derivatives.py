"""Estimators of derivatives: exact on polynomials, and honest about the noise they leave."""

from __future__ import annotations

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import InputError, RecordError
from reduced_models.records.derivatives import DERIVATIVE_METHODS, Derivatives, derivatives

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


@pytest.mark.parametrize("method", DERIVATIVE_METHODS)
def test_parabolas_are_differentiated_exactly(method: str) -> None:
    found = derivatives(PistonRecord(TIME, 0.3 + 0.2 * TIME - 0.05 * TIME**2), method)
    np.testing.assert_allclose(found.velocity[INNER], (0.2 - 0.1 * TIME)[INNER], atol=1e-7)
    np.testing.assert_allclose(found.acceleration[INNER], -0.1, atol=1e-5)


def test_noise_figures_are_those_of_the_weights() -> None:
    """The root of the sum of squared weights, known for both estimators."""
    from scipy.signal import savgol_coeffs

    step = TIME[1]
    for method in ("savitzky-golay", "finite-differences"):
        found = derivatives(noisy(TIME, 1e-4), method)
        if method == "savitzky-golay":
            window = round(found.width / step)
            gains = [np.linalg.norm(savgol_coeffs(window, 5, deriv=order, delta=step)) for order in range(3)]
        else:
            gains = [1.0, 1.0 / (np.sqrt(2.0) * step), np.sqrt(6.0) / step**2]
        assert np.array(found.noise) == pytest.approx(found.record_noise * np.array(gains), rel=0.1)
        assert found.record_noise == pytest.approx(1e-4, rel=0.1)


def test_the_noise_figure_of_the_spline_is_the_scatter_of_records() -> None:
    """At one penalty, over records that differ in their noise alone."""
    from reduced_models.records.derivatives import _choose_smoothing_spline, _noise_of_derivatives

    height = noisy(TIME, 1e-4).height
    smoother, _ = _choose_smoothing_spline(TIME, height, 1e-4)
    figures = _noise_of_derivatives(smoother, len(TIME), 1e-4)
    heights = np.stack([noisy(TIME, 1e-4, seed).height for seed in range(1, 13)])
    found = smoother(heights)[:, :, INNER]
    scatter = np.sqrt((np.std(found, axis=0, ddof=1) ** 2).mean(axis=1))
    assert scatter == pytest.approx(np.array(figures), rel=0.1)


@pytest.mark.parametrize(
    "level", [1e-3, *(pytest.param(level, marks=pytest.mark.long) for level in (1e-4, 1e-6))]
)
@pytest.mark.parametrize("method", ["savitzky-golay", "smoothing-spline"])
def test_smoothing_beats_differences_at_every_noise(method: str, level: float) -> None:
    record = noisy(TIME, level)
    smooth = errors(derivatives(record, method))
    plain = errors(derivatives(record, "finite-differences"))
    assert all(one < 0.5 * other for one, other in zip(smooth, plain, strict=True))


def test_what_smoothing_takes_from_the_motion_is_no_more_than_twice_the_noise() -> None:
    for level in (1e-3, 1e-4, 1e-5, 1e-7):
        found = derivatives(noisy(TIME, level))
        assert all(error < 3.0 * noise for error, noise in zip(errors(found), found.noise, strict=True))


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


def test_unknown_estimators_and_short_records_are_refused() -> None:
    with pytest.raises(InputError, match="savitzky-golay"):
        derivatives(noisy(TIME, 1e-4), "tea-leaves")  # type: ignore[arg-type]  # what is refused
    with pytest.raises(RecordError, match="at least 20"):
        derivatives(PistonRecord(TIME[:19], TIME[:19] ** 2))
