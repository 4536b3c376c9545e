"""Features of a record."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import RecordError
from reduced_models import load_model
from reduced_models.calibration.simulations import record_features

SAVED = Path(__file__).parents[2] / "data" / "model.json"


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


def test_a_swing_that_grows_or_never_rests_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """By what a fit says of it; the fits are made up."""
    model = load_model(SAVED)
    assert model.at_rest is not None
    grows = dataclasses.replace(model.at_rest, damping_ratio=-0.09)
    times = np.linspace(0.0, 2.0, 2000)
    record = PistonRecord(times, 0.059 + 1e-3 * np.cos(21.8 * times))
    for at_rest, words in (
        (grows, r"damping ratio is -0\.09; it must be above 0: give a record that comes to rest"),
        (None, "finds no level of rest in the record"),
    ):
        made_up = dataclasses.replace(model, at_rest=at_rest)
        monkeypatch.setattr(f"{record_features.__module__}.fit", lambda *_, found=made_up, **__: found)
        with pytest.raises(RecordError, match=words):
            record_features(record)
