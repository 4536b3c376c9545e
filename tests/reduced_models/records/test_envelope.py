"""Envelopes against motions whose amplitude, frequency and damping are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord
from granular.shared.errors import RecordError
from reduced_models.laws.elliptic_motion import DuffingVanDerPolOscillator, averaged_frequency
from reduced_models.records.envelope import envelope

TIME = np.linspace(0.0, 60.0, 4000)


def noisy(height: np.ndarray, level: float) -> PistonRecord:
    return PistonRecord(TIME, height + np.random.default_rng(5).normal(0.0, level, len(TIME)))


@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_a_damped_cosine_has_constant_frequency_and_damping(noise: float) -> None:
    found = envelope(noisy(0.06 + 0.002 * np.exp(-0.03 * TIME) * np.cos(2.0 * TIME + 0.4), noise))
    tolerance = 1e-4 + 100.0 * noise
    np.testing.assert_allclose(found.level, 0.06, atol=2e-6 + 3.0 * noise)
    np.testing.assert_allclose(found.amplitude, 0.002 * np.exp(-0.03 * found.time), rtol=2e-3 + 5e3 * noise)
    np.testing.assert_allclose(np.mean(found.frequency), 2.0, rtol=tolerance)
    assert np.mean(found.damping) == pytest.approx(0.03, rel=0.03)
    assert np.mean(found.damping_ratio) == pytest.approx(0.015, rel=0.03)
    # one extreme between two passages, and of each three in a row a cycle
    assert len(found.time) == int(60.0 * 2.0 / np.pi) - 3


def test_the_backbone_of_a_duffing_motion() -> None:
    solved = solve_ivp(
        lambda _, y: [y[1], -0.02 * y[1] - y[0] - 0.5 * y[0] ** 3],
        (0.0, 60.0),
        [1.5, 0.0],
        "DOP853",
        TIME,
        rtol=1e-11,
        atol=1e-12,
    )
    found = envelope(noisy(solved.y[0], 0.002))
    expected = 2.0 * np.pi * averaged_frequency(found.amplitude, DuffingVanDerPolOscillator(1.0, 0.5, 0.01))
    assert np.ptp(expected) > 0.05  # there is a backbone to see
    away = (found.frequency - expected) / found.frequency_noise
    assert np.sqrt((away**2).mean()) < 2.0
    np.testing.assert_allclose(found.frequency, expected, rtol=5e-3)


def test_a_growing_swing_has_negative_damping() -> None:
    found = envelope(noisy(np.exp(0.02 * TIME) * np.sin(1.5 * TIME), 1e-3))
    assert np.mean(found.damping) == pytest.approx(-0.02, rel=0.05)


def test_noise_alone_and_too_few_swings_are_refused() -> None:
    for height in (noisy(np.zeros(len(TIME)), 1.0).height, np.cos(0.1 * TIME)):
        with pytest.raises(RecordError, match="extremes"):
            envelope(PistonRecord(TIME, height))


def test_few_cycles_tell_little_of_the_damping() -> None:
    """A ratio four times too large is contradicted by forty rows, and not by three (Student's quantile)."""
    for cycles, sure in ((3.1, False), (20.0, True)):
        time = np.linspace(0.0, cycles, int(60 * cycles))
        swing = np.exp(-0.01 * np.pi * time) * np.cos(2.0 * np.pi * time)
        random = np.random.default_rng(0)
        seen = envelope(PistonRecord(time, 1e-3 * (swing + random.normal(0.0, 0.03, len(time)))))
        assert seen.peak_damping.contradicts(0.02) == sure
