"""Intervals that hold the truth where noise grows with the speed, or a sensor rounds."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models import fit
from reduced_models.fitting.residual_diagnostics import fit_autoregression, gradient_covariance
from reduced_models.fitting.uncertainty import standing_reading_covariance
from reduced_models.laws.catalogue import law_named
from reduced_models.laws.solution import solve_law

TIME = np.arange(0.0, 12.0, 0.01)
OMEGA = math.tau
LAWS = {
    "viscous-coulomb": {"lam": 0.02 * OMEGA, "friction": 0.05 * OMEGA**2 / 4.0, "omega": OMEGA, "g0": 0.0},
    "coulomb": {"friction": 0.08 * OMEGA**2 / 4.0, "omega": OMEGA, "g0": 0.0},
}


def record(law: str, disturbance: str, seed: int) -> PistonRecord:
    """Free motion from 1 m, its clock unsteady by 1.5 ms, or rounded to 0.1 m, or under white noise."""
    random, values = np.random.default_rng(seed), tuple(LAWS[law].values())
    time, noise = TIME, 3e-3 if disturbance == "white" else 1e-4
    if disturbance == "jitter":
        moments = TIME + np.append(0.0, random.normal(0.0, 1.5e-3, len(TIME) - 1))
        time = np.maximum.accumulate(moments + 1e-9 * np.arange(len(TIME)))
    height = solve_law(law_named(law), time, 1.0, 0.0, values, 1.0).z
    height = height + random.normal(0.0, noise, len(TIME))
    if disturbance == "rounding":
        shift = 0.1 * random.uniform()
        height = np.round((height + shift) / 0.1) * 0.1 - shift
    return PistonRecord(TIME, height)


@pytest.mark.long
@pytest.mark.parametrize("disturbance", ["white", "jitter", "rounding"])
@pytest.mark.parametrize("law", LAWS)
def test_intervals_hold_the_truth(law: str, disturbance: str) -> None:
    """On 30 records; white noise of constant size was taken for granted before."""
    count, held = 30, dict.fromkeys(LAWS[law], 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for seed in range(count):
            model = fit(record(law, disturbance, seed), law, starts=1, test_fraction=0.0)
            for name, value in LAWS[law].items():
                low, high = model.intervals[name]
                held[name] += low <= value <= high
    assert min(held.values()) >= 0.85 * count


def test_noise_that_grows_with_the_speed_counts_where_it_is() -> None:
    """The covariance of a gradient, against many draws of the noise."""
    random, count = np.random.default_rng(0), 2000
    phase = 0.1 * np.arange(count)
    slopes, level = np.stack([np.cos(phase), np.sin(phase)], axis=1), np.abs(np.sin(phase))
    noise = level[:, None] * random.normal(size=(count, 400))
    seen = np.cov(slopes.T @ noise)
    told = np.mean(
        [gradient_covariance(slopes, left, fit_autoregression(left), level) for left in noise.T[:20]], axis=0
    )
    np.testing.assert_allclose(np.diag(told), np.diag(seen), rtol=0.2)
    assert told[1, 1] > 2.0 * told[0, 0]


def test_equal_readings_in_a_row_count_as_one() -> None:
    """They err alike if the motion stands or turns; a level that is passed errs to both sides."""
    slopes = np.ones((14, 1))
    standing = np.append(np.arange(6.0), np.full(8, 6.0))
    assert standing_reading_covariance(slopes, standing)[0, 0] == pytest.approx((8.0**2 - 8.0) / 12.0)
    passing = np.repeat(np.arange(7.0), 2)
    assert standing_reading_covariance(slopes, passing)[0, 0] == pytest.approx(2.0 * (4.0 - 2.0) / 12.0)
    turning = np.repeat([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 4.0], 2)
    assert standing_reading_covariance(slopes, turning)[0, 0] == pytest.approx(3.0 * (4.0 - 2.0) / 12.0)
    smooth = np.random.default_rng(0).normal(size=14)
    assert standing_reading_covariance(slopes, smooth)[0, 0] == 0.0
