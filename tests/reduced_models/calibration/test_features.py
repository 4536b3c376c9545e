"""Features of a record."""

from __future__ import annotations

import math

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models.calibration.simulations import record_features


def test_features_of_a_known_swing() -> None:
    """A linear oscillator: level of rest, undamped period and damping ratio, and its force."""
    times = np.linspace(0.0, 2.0, 2000)
    swing = 1e-3 * np.exp(-0.8 * times) * np.cos(math.sqrt(21.8**2 - 0.8**2) * times)
    force = 70.0 - 7.0 * 21.8**2 * swing
    record = PistonRecord(times, 0.059 + swing, force=force)
    found = record_features(record, "linear", force=True)
    assert found.names == ("height", "period", "damping_ratio", "force")
    expected = (0.059, 2.0 * math.pi / 21.8, 0.8 / 21.8, 70.0)
    assert tuple(found.values) == pytest.approx(expected, rel=2e-3)
    assert found.values[:3] == pytest.approx(expected[:3], rel=1e-6)
