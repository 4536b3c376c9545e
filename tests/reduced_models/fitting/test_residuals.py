"""Residuals judged by their whiteness, and causes that are named only where they act."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models import FitOptions, ReducedModel, fit
from reduced_models.identification.residual_tests import residual_tests

TIME = np.arange(0.0, 6.0, 0.005)


def decay(frequency: float = 5.0) -> np.ndarray:
    """Free decay of 1 mm with a damping ratio of 1 %."""
    rate = math.tau * frequency
    return np.asarray(1e-3 * np.exp(-0.01 * rate * TIME) * np.cos(rate * TIME))


def fitted(height: np.ndarray, drift: bool | None = None) -> ReducedModel:
    """Fit of the linear law from one start."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fit(
            PistonRecord(TIME, height), "linear", starts=1, test_fraction=0.0, options=FitOptions(drift=drift)
        )


def test_a_fast_second_mode_is_noted() -> None:
    """Its residuals alternate, so that their correlation time is below a sample."""
    noise = np.random.default_rng(0).normal(0.0, 2e-5, len(TIME))
    model = fitted(decay() + 0.1 * decay(17.0) + noise)
    assert model.quality.correlation < 1.5
    assert model.quality.whiteness < 1e-30
    assert any("not white noise" in note for note in model.notes)


@pytest.mark.parametrize("parts", [5, 10, 50])
def test_a_sensor_that_rounds_is_no_other_cause(parts: int) -> None:
    step = 1e-3 / parts
    for seed in range(4):
        shift = step * np.random.default_rng(seed).uniform()
        height = np.round((decay() + shift) / step) * step
        model = fitted(height)
        assert model.notes == ()
        assert "within the rounding of the sensor" in str(model)
        tests = residual_tests(model, TIME, height, model.simulate(TIME).height)
        assert tests.verdict == "rounding"


def test_a_wrong_law_is_noted_though_the_sensor_rounds() -> None:
    step = 2e-5
    model = fitted(np.round((decay() + 0.06 * decay(17.0)) / step) * step)
    assert any("not white noise" in note for note in model.notes)


@pytest.mark.parametrize("drift", [None, True])
def test_a_fitted_drift_is_told_and_is_no_residual(drift: bool | None) -> None:
    random = np.random.default_rng(1)
    walk = 2e-6 * np.cumsum(random.normal(size=len(TIME)))
    height = decay() + walk + random.normal(0.0, 1e-5, len(TIME))
    model = fitted(height, drift)
    # The filter's innovations: noise and walk of these sizes leave 1.1 times the noise (Muth 1960).
    assert model.quality.residual == pytest.approx(1.105e-5, rel=0.05)
    assert model.quality.zero_drift == pytest.approx(float(np.ptp(walk)), rel=0.2)
    assert f"drift of the record's zero: {model.quality.zero_drift:.2g} m" in str(model)
    told = [note for note in model.notes if "drift" in note]
    assert [note.startswith("the record's zero drifts, by 0.") for note in told] == [True] * (drift is None)
    tests = residual_tests(model, TIME, height, model.simulate(TIME).height)
    assert tests.rms == pytest.approx(1.105e-5, rel=0.05)
    assert tests.verdict == "noise"


@pytest.mark.long
def test_white_noise_is_not_noted() -> None:
    """In 40 records of the true law at most two."""
    random = np.random.default_rng(0)
    noted = [fitted(decay() + random.normal(0.0, 1e-5, len(TIME))).notes != () for _ in range(40)]
    assert sum(noted) <= 2
