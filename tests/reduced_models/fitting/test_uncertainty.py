"""How sure parameters are in directions that a record leaves open."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from granular import PistonRecord
from reduced_models import fit
from reduced_models.fitting.uncertainty import marginal_information, sandwich_covariance

SAMPLES, SIZE = 400, 4


def _correlated_noise(reach: float) -> np.ndarray:
    times = np.arange(SAMPLES)
    return np.asarray(np.exp(-np.abs(times[:, None] - times[None, :]) / reach))


@pytest.mark.parametrize("left", [0.0, 1e-9, 1e-8, 1e-7])
@pytest.mark.parametrize("seed", range(20))
def test_what_is_open_is_never_called_sure(seed: int, left: float) -> None:
    random = np.random.default_rng(seed)
    phases = np.linspace(0.0, 20.0, SAMPLES)
    slopes = np.stack([np.sin(k * phases) for k in range(1, SIZE + 1)], axis=1)
    slopes[:, -1] = slopes[:, :-1] @ random.normal(size=SIZE - 1) + left * slopes[:, -1]
    slopes *= 10.0 ** random.uniform(-4.0, 4.0, SIZE)
    noise = _correlated_noise(60.0)
    found = sandwich_covariance(slopes.T @ slopes, slopes.T @ noise @ slopes, 1.0)
    # What white residuals of that variance leave open along the last parameter, at the least.
    least = 1.0 / np.linalg.norm(slopes[:, -1]) ** 2
    assert found[-1, -1] > 1e5**2 * least
    assert (np.diag(found) > 0.0).all()


def test_it_is_the_covariance_of_least_squares_under_correlated_noise() -> None:
    slopes = np.random.default_rng(1).normal(size=(SAMPLES, SIZE))
    noise = _correlated_noise(5.0)
    inverse = np.linalg.inv(slopes.T @ slopes)
    exact = inverse @ slopes.T @ noise @ slopes @ inverse
    assert_allclose(sandwich_covariance(slopes.T @ slopes, slopes.T @ noise @ slopes, 1.0), exact, rtol=1e-9)


def test_information_on_some_entries_is_that_of_their_covariance() -> None:
    slopes = np.random.default_rng(2).normal(size=(SAMPLES, SIZE))
    normal, asked = slopes.T @ slopes, np.array([0, 2])
    free = np.ones(SIZE, dtype=bool)
    exact = np.linalg.inv(np.linalg.inv(normal)[np.ix_(asked, asked)])
    assert_allclose(marginal_information(normal, asked, free), exact, rtol=1e-10)


def test_a_start_that_the_motion_forgets_at_once_takes_no_information() -> None:
    slopes = np.random.default_rng(3).normal(size=(SAMPLES, SIZE))
    slopes[:, -1] = 0.0
    normal, asked = slopes.T @ slopes, np.array([0, 1])
    without = marginal_information(normal[:-1, :-1], asked, np.ones(SIZE - 1, dtype=bool))
    assert_allclose(marginal_information(normal, asked, np.ones(SIZE, dtype=bool)), without, rtol=1e-10)


@pytest.mark.long  # quick: `open_model` of `test_fit`, a damping that may be none in `test_profile`
@pytest.mark.parametrize("how", ["linear", "profile"])
def test_intervals_of_a_product_that_alone_matters_stay_open(how: str) -> None:
    time = np.linspace(0.0, 20.0, 300)
    noise = np.random.default_rng(0).normal(0.0, 0.005, 300)
    record = PistonRecord(time, np.exp(-0.05 * time) * np.cos(1.05 * time) + noise)
    law = "z'' + c*z' + a*b*z = 0"
    model = fit(record, law, intervals=how, starts=1, test_fraction=0.0)
    for name in ("a", "b"):
        low, high = model.intervals[name]
        assert high - low > 100.0 * abs(model.parameters[name])
    low, high = model.intervals["c"]
    assert 0.0 < high - low < 0.02
    band = model.predict_with_band(time)
    assert np.isfinite(band.low).all()
    assert (band.high - band.low).max() < 0.01
