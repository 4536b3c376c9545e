"""Noise of real records: correlated, heavy-tailed, drifting, rounded; outliers; and residuals."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models import FitOptions, ReducedModel, fit
from reduced_models.fitting.fit_data import replace_outliers_by_running_median
from reduced_models.fitting.residual_diagnostics import residual_tests
from tests.reduced_models.made import damped_cosine

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

TIME = np.linspace(0.0, 40.0, 2000)
TRUE = {"lam": 0.05, "omega": 1.05, "g0": -1.0}
KINDS: dict[str, dict[str, Any]] = {
    "white": {},
    "correlated": {},
    "long memory": {},
    "Student's t": {},
    "drift": {},  # found by the residuals
    "outliers": {"loss": "soft_l1"},
}


def noisy(kind: str, clean: np.ndarray, seed: int) -> PistonRecord:
    from scipy.signal import lfilter

    random, level, count = np.random.default_rng(seed), 0.02 * clean.std(), len(clean)
    noise = random.normal(0.0, level, count)
    if kind == "correlated":
        noise = np.sqrt(0.19) * lfilter([1.0], [1.0, -0.9], noise)
    elif kind == "long memory":  # settled before the record begins
        long = random.normal(0.0, level, 3 * count)
        noise = np.sqrt(1.0 - 0.99**2) * lfilter([1.0], [1.0, -0.99], long)[-count:]
    elif kind == "Student's t":
        noise = level * random.standard_t(3, count) / np.sqrt(3.0)
    elif kind == "drift":
        noise = noise + np.cumsum(random.normal(0.0, 0.1 * level, count))
    elif kind == "outliers":
        noise = noise + 20.0 * noise * (random.uniform(size=count) < 0.03)
    return PistonRecord(TIME, clean + noise)


def fits(kind: str, clean: np.ndarray, count: int) -> list[ReducedModel]:
    return [
        fit(noisy(kind, clean, seed), "linear", starts=1, test_fraction=0.0, **KINDS[kind])
        for seed in range(count)
    ]


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_confidence_intervals_contain_the_true_values_under_realistic_noise(
    made: Callable[..., PistonRecord], kind: str
) -> None:
    clean = made("linear", level=0.0).height
    models = fits(kind, clean, 240)
    for name, value in TRUE.items():
        pairs = [model.intervals[name] for model in models]
        assert 0.88 <= np.mean([low <= value <= high for low, high in pairs]) <= 1.0
        scatter = np.std([model.parameters[name] for model in models])
        assert np.median([high - low for low, high in pairs]) / 2.0 < 2.5 * scatter


def test_fit_of_a_drifting_record_is_as_accurate_as_the_best_linear_estimate(
    made: Callable[..., PistonRecord],
) -> None:
    """The best linear estimate uses the true covariance of the noise."""
    clean = made("linear", level=0.0).height
    values = np.array([*TRUE.values(), 1.0, 0.0])
    steps = 1e-6 * np.eye(len(values))
    slopes = np.stack(
        [(linear_oscillation(values + h) - linear_oscillation(values - h)) / 2e-6 for h in steps], axis=1
    )
    steady = np.arange(1, len(TIME) + 1)
    walk = 0.1**2 * np.minimum.outer(steady, steady)
    noise = (0.02 * clean.std()) ** 2 * (np.eye(len(TIME)) + walk)
    weighted = np.linalg.solve(noise, slopes)
    covariance = np.linalg.inv(slopes.T @ weighted)
    exact = np.sqrt(np.diag(covariance))[: len(TRUE)]
    for seed, model in enumerate(fits("drift", clean, 4)):
        best = covariance @ weighted.T @ (noisy("drift", clean, seed).height - clean)
        for k, name in enumerate(TRUE):
            assert abs(model.parameters[name] - values[k] - best[k]) < 0.25 * exact[k]
            assert 0.7 < np.diff(model.intervals[name])[0] / (2.0 * 1.96 * exact[k]) < 1.4


def linear_oscillation(values: np.ndarray) -> np.ndarray:
    """Heights of the linear law for parameters and initial height and velocity (5,)."""
    lam, omega, g0, height, velocity = values
    quick, rest = np.sqrt(omega**2 - lam**2), g0 / omega**2
    phasor = (height - rest) - 1j * (velocity + lam * (height - rest)) / quick
    return np.asarray(rest + (phasor * np.exp((-lam + 1j * quick) * TIME)).real)


def test_drift_is_fitted_and_noted(
    made: Callable[..., PistonRecord], command: Callable, tmp_path: Path
) -> None:
    """Drift is found from the residuals unless drift=False.

    The notes give the argument and the command-line option.
    """
    record = noisy("drift", made("linear", level=0.0).height, 0)
    with pytest.warns(UserWarning, match=r"zero drifts.* FitOptions\(drift=False\) \(fit --no-drift on the"):
        found = fit(record, "linear", starts=1)
    with pytest.warns(UserWarning, match=r"drift slowly.* FitOptions\(drift=True\) \(fit --drift on the"):
        fit(record, "linear", starts=1, options=FitOptions(drift=False))
    record.to_csv(tmp_path / "record.csv")
    words = ("fit", str(tmp_path / "record.csv"), "--law", "linear", "--starts", "1")
    assert "zero drifts" in command("reduced_models", *words).stdout
    assert "drift slowly" in command("reduced_models", *words, "--no-drift").stdout
    printed = command("reduced_models", *words, "--drift").stdout
    assert "drift of the record's zero: " in printed
    assert "note: " not in printed
    modelled = fit(record, "linear", starts=1, options=FitOptions(drift=True))
    assert not any("drift" in note for note in modelled.notes)
    assert found.parameters == pytest.approx(modelled.parameters, rel=1e-4)
    low, high = modelled.intervals["g0"]
    assert low < -1.0 < high


@pytest.mark.parametrize("kind", ["white", "correlated", "Student's t"])
def test_no_drift_is_found_in_noise_without_drift(made: Callable[..., PistonRecord], kind: str) -> None:
    (model,) = fits(kind, made("linear", level=0.0).height, 1)
    assert not any("zero drifts" in note for note in model.notes)


DECAY_TIME = np.arange(0.0, 6.0, 0.005)


def decay(frequency: float = 5.0) -> np.ndarray:
    """Free decay from 1 mm with a damping ratio of 1 %."""
    rate = math.tau * frequency
    return damped_cosine(DECAY_TIME, 1e-3, 0.01 * rate, rate)


def fitted(height: np.ndarray, drift: bool | None = None) -> ReducedModel:
    """Fit of the linear law from one start."""
    record, options = PistonRecord(DECAY_TIME, height), FitOptions(drift=drift)
    return fit(record, "linear", starts=1, test_fraction=0.0, options=options)


def test_a_fast_second_mode_is_noted() -> None:
    """The residuals due to it alternate in sign, so that their correlation time is below one sample."""
    noise = np.random.default_rng(0).normal(0.0, 2e-5, len(DECAY_TIME))
    model = fitted(decay() + 0.1 * decay(17.0) + noise)
    assert model.quality.correlation < 1.5
    assert model.quality.whiteness < 1e-30
    assert any("not white noise" in note for note in model.notes)


@pytest.mark.parametrize("parts", [5, 10, 50])
def test_sensor_rounding_is_not_reported_as_a_wrong_law(parts: int) -> None:
    step = 1e-3 / parts
    for seed in range(4):
        shift = step * np.random.default_rng(seed).uniform()
        height = np.round((decay() + shift) / step) * step
        model = fitted(height)
        assert model.notes == ()
        assert "within the rounding of the sensor" in str(model)
        tests = residual_tests(model, DECAY_TIME, height, model.simulate(DECAY_TIME).height)
        assert tests.verdict == "rounding"


def test_a_wrong_law_is_noted_despite_sensor_rounding() -> None:
    step = 2e-5
    model = fitted(np.round((decay() + 0.06 * decay(17.0)) / step) * step)
    assert any("not white noise" in note for note in model.notes)


@pytest.mark.parametrize("drift", [None, True])
def test_fitted_drift_is_reported_and_does_not_count_as_residual(drift: bool | None) -> None:
    random = np.random.default_rng(1)
    walk = 2e-6 * np.cumsum(random.normal(size=len(DECAY_TIME)))
    height = decay() + walk + random.normal(0.0, 1e-5, len(DECAY_TIME))
    model = fitted(height, drift)
    # The filter's innovations: noise and walk of these sizes leave 1.1 times the noise (Muth 1960).
    assert model.quality.residual == pytest.approx(1.105e-5, rel=0.05)
    assert model.quality.zero_drift == pytest.approx(float(np.ptp(walk)), rel=0.2)
    assert f"drift of the record's zero: {model.quality.zero_drift:.2g} m" in str(model)
    printed = [note for note in model.notes if "drift" in note]
    assert [note.startswith("the record's zero drifts by 0.") for note in printed] == [True] * (drift is None)
    tests = residual_tests(model, DECAY_TIME, height, model.simulate(DECAY_TIME).height)
    assert tests.rms == pytest.approx(1.105e-5, rel=0.05)
    assert tests.verdict == "noise"


@pytest.mark.long
def test_white_residuals_rarely_cause_a_note() -> None:
    """At most 2 of 40 records of the true law give a note."""
    random = np.random.default_rng(0)
    noted = [fitted(decay() + random.normal(0.0, 1e-5, len(DECAY_TIME))).notes != () for _ in range(40)]
    assert sum(noted) <= 2


def with_outliers(seed: int) -> tuple[np.ndarray, PistonRecord]:
    """Return a linear oscillation with noise, and the same oscillation with a fraction of outliers."""
    random, count = np.random.default_rng(seed), len(TIME)
    plain = damped_cosine(TIME, 1.0, 0.05, 1.05) + random.normal(0.0, 0.01, count)
    away = (random.uniform(size=count) < 0.03) * random.normal(0.0, 0.4, count)
    return plain, PistonRecord(TIME, plain + away)


def test_removal_of_outliers_keeps_all_other_samples() -> None:
    plain, dirty = with_outliers(0)
    found = replace_outliers_by_running_median(dirty)
    assert np.abs(dirty.height - plain).max() > 0.3
    assert np.abs(found.height - plain).max() < 0.1
    kept = dirty.height == plain
    assert (found.height[kept] == plain[kept]).mean() > 0.999
    # Seven samples per cycle and no noise: the motion itself changes much between samples.
    few = PistonRecord(TIME, np.cos(2.0 * np.pi * np.arange(2000) / 7.0))
    np.testing.assert_array_equal(replace_outliers_by_running_median(few).height, few.height)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.filterwarnings("error")
def test_a_robust_fit_starts_from_data_without_outliers(seed: int) -> None:
    """One start is enough, and the outliers do not count against the law."""
    model = fit(with_outliers(seed)[1], "linear", starts=1, test_fraction=0.0, loss="soft_l1")
    assert model.parameters["omega"] == pytest.approx(1.05, abs=0.005)
