"""Intervals under the noise of real records: correlated, heavy-tailed, with outliers, drifting."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models import FitOptions, ReducedModel, fit

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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return [
            fit(noisy(kind, clean, seed), "linear", starts=1, test_fraction=0.0, **KINDS[kind])
            for seed in range(count)
        ]


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_intervals_hold_under_real_noise(made: Callable[..., PistonRecord], kind: str) -> None:
    clean = made("linear", level=0.0).height
    models = fits(kind, clean, 240)
    for name, value in TRUE.items():
        pairs = [model.intervals[name] for model in models]
        assert 0.88 <= np.mean([low <= value <= high for low, high in pairs]) <= 1.0
        scatter = np.std([model.parameters[name] for model in models])
        assert np.median([high - low for low, high in pairs]) / 2.0 < 2.5 * scatter


def test_under_drift_a_fit_does_what_is_possible(made: Callable[..., PistonRecord]) -> None:
    """It finds what the best linear estimate finds, which knows the noise's covariance.

    So does its scatter, whichever records are made: widths are measured here by what is exact.
    """
    clean = made("linear", level=0.0).height
    values = np.array([*TRUE.values(), 1.0, 0.0])
    steps = 1e-6 * np.eye(len(values))
    slopes = np.stack([(swing(values + h) - swing(values - h)) / 2e-6 for h in steps], axis=1)
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


def swing(values: np.ndarray) -> np.ndarray:
    """Heights of the linear law with parameters, height and velocity at the start (5,)."""
    lam, omega, g0, height, velocity = values
    quick, rest = np.sqrt(omega**2 - lam**2), g0 / omega**2
    sine = (velocity + lam * (height - rest)) / quick * np.sin(quick * TIME)
    return np.asarray(rest + np.exp(-lam * TIME) * ((height - rest) * np.cos(quick * TIME) + sine))


def test_drift_is_noted_and_modelled(
    made: Callable[..., PistonRecord], command: Callable, tmp_path: Path
) -> None:
    """Found by the residuals, unless it is refused; the notes name the argument and the option."""
    record = noisy("drift", made("linear", level=0.0).height, 0)
    with pytest.warns(UserWarning, match=r"zero drifts.* FitOptions\(drift=False\) \(fit --no-drift on the"):
        found = fit(record, "linear", starts=1)
    with pytest.warns(UserWarning, match=r"drift slowly.* FitOptions\(drift=True\) \(fit --drift on the"):
        fit(record, "linear", starts=1, options=FitOptions(drift=False))
    record.to_csv(tmp_path / "record.csv")
    words = ("fit", str(tmp_path / "record.csv"), "--law", "linear", "--starts", "1")
    assert "zero drifts" in command("reduced_models", *words).stdout
    assert "drift slowly" in command("reduced_models", *words, "--no-drift").stdout
    told = command("reduced_models", *words, "--drift").stdout
    assert "drift of the record's zero: " in told
    assert "note: " not in told
    modelled = fit(record, "linear", starts=1, options=FitOptions(drift=True))
    assert not any("drift" in note for note in modelled.notes)
    assert found.parameters == pytest.approx(modelled.parameters, rel=1e-4)
    low, high = modelled.intervals["g0"]
    assert low < -1.0 < high


@pytest.mark.parametrize("kind", ["white", "correlated", "Student's t"])
def test_no_drift_is_found_in_other_noise(made: Callable[..., PistonRecord], kind: str) -> None:
    (model,) = fits(kind, made("linear", level=0.0).height, 1)
    assert not any("zero drifts" in note for note in model.notes)
