"""A model that was written before the packages had rooms is read as it was."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from reduced_models import law_named, load_model

FORMER = Path(__file__).parents[1] / "data" / "former" / "model.json"


def test_the_model_is_read() -> None:
    model = load_model(FORMER)
    assert model.law == law_named("linear")
    assert model.parameters["omega"] == pytest.approx(math.sqrt(145.0), rel=1e-9)
    assert (model.confidence, model.quality.samples, model.notes) == (0.95, 150, ())
    assert model.at_rest is not None
    assert model.at_rest.height == pytest.approx(0.05, rel=1e-9)
    again = json.loads(json.dumps(model.to_plain()))
    former = json.loads(FORMER.read_text(encoding="utf-8"))
    shown = ("latex",)  # numbers in it are rounded for people
    # What was not known then is added to what is said of the fit.
    again["quality"] = {key: again["quality"][key] for key in former["quality"]}
    assert {key: again[key] for key in former if key not in shown} == {
        key: value for key, value in former.items() if key not in shown
    }


def test_the_model_predicts_its_record() -> None:
    """Which was 5 cm + exp(-t) cos(12 t) cm, without noise."""
    time = np.linspace(0.0, 3.0, 301)
    found = load_model(FORMER).simulate(time)
    expected = 0.05 + 0.01 * np.exp(-time) * np.cos(12.0 * time)
    np.testing.assert_allclose(found.height, expected, rtol=0.0, atol=1e-9)
