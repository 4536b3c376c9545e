"""The motion in a record: clipped samples and further releases are left out, and that is said."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from reduced_models import PistonRecord, fit
from reduced_models.records.motion import find_motion

RATE, FREQUENCY, DAMPING = 500.0, 4.1, 0.05
OMEGA = 2.0 * np.pi * FREQUENCY


def decay(duration: float) -> np.ndarray:
    """Free decay from a release at rest, of amplitude 1."""
    time = np.arange(0.0, duration, 1.0 / RATE)
    quick = OMEGA * np.sqrt(1.0 - DAMPING**2)
    return np.exp(-DAMPING * OMEGA * time) * (
        np.cos(quick * time) + DAMPING * OMEGA / quick * np.sin(quick * time)
    )


def record_of(height: np.ndarray, noise: float = 0.01) -> PistonRecord:
    """Record of a height with noise."""
    noisy = height + np.random.default_rng(1).normal(0.0, noise, len(height))
    return PistonRecord(np.arange(len(height)) / RATE, 3e-3 * noisy)


def found(record: PistonRecord) -> tuple[PistonRecord, list[str]]:
    """The motion, and what was said."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        motion = find_motion(record)
    return motion, [str(one.message) for one in caught]


def test_one_decay_is_taken_whole() -> None:
    record = record_of(decay(3.0))
    motion, said = found(record)
    assert motion is record
    assert not said


@pytest.mark.parametrize("hold", [0.0, 0.1, 1.5])
def test_the_first_of_three_releases_is_taken(hold: float) -> None:
    piece = np.concatenate([np.ones(int(hold * RATE)), decay(2.5)])
    motion, said = found(record_of(np.concatenate([piece] * 3)))
    assert any("holds 3 releases" in words for words in said)
    assert motion.time[-1] < hold + 2.6
    rest = fit(motion, "linear", test_fraction=0.0, starts=2).at_rest
    assert rest is not None
    assert rest.period == pytest.approx(1.0 / FREQUENCY / np.sqrt(1.0 - DAMPING**2), rel=2e-3)
    assert rest.damping_ratio == pytest.approx(DAMPING, rel=0.03)


def test_clipped_peaks_are_left_out() -> None:
    record = record_of(decay(3.0))
    clipped = PistonRecord(record.time, np.clip(record.height, -2e-3, 2e-3))
    motion, said = found(clipped)
    assert any("limit of the sensor" in words for words in said)
    assert np.abs(motion.height).max() < 2e-3
    rest = fit(motion, "linear", test_fraction=0.0, starts=2).at_rest
    assert rest is not None
    assert rest.damping_ratio == pytest.approx(DAMPING, rel=0.03)


def test_a_sensor_that_rounds_is_not_clipped() -> None:
    record = record_of(decay(3.0), noise=0.0)
    rounded = PistonRecord(record.time, np.round(record.height, 4))
    motion, said = found(rounded)
    assert len(motion) == len(rounded)
    assert not any("limit" in words for words in said)


def test_beats_are_one_motion() -> None:
    time = np.arange(0.0, 8.0, 1.0 / RATE)
    beats = np.cos(OMEGA * time) * (0.6 + 0.4 * np.cos(2.0 * np.pi * 0.4 * time))
    motion, said = found(record_of(beats))
    assert not any("releases" in words for words in said)
    assert len(motion) == len(time)
