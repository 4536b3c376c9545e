"""Records with outliers: what a fit starts from does not see them."""

from __future__ import annotations

import warnings

import numpy as np

from granular import PistonRecord
from reduced_models import fit
from reduced_models.fitting.fit_data import clip_outliers

TIME = np.linspace(0.0, 40.0, 2000)


def swing(noise: float, fraction: float, seed: int) -> tuple[PistonRecord, PistonRecord]:
    """A linear swing with noise, and the same with a fraction of samples far away."""
    random = np.random.default_rng(seed)
    clean = np.exp(-0.05 * TIME) * np.cos(1.05 * TIME)
    plain = clean + random.normal(0.0, noise, len(TIME))
    away = random.uniform(size=len(TIME)) < fraction
    height = np.where(away, plain + random.normal(0.0, 40.0 * noise, len(TIME)), plain)
    return PistonRecord(TIME, plain), PistonRecord(TIME, height)


def test_outliers_are_drawn_in_and_nothing_else() -> None:
    plain, dirty = swing(0.01, 0.03, 0)
    found = clip_outliers(dirty)
    assert np.abs(dirty.height - plain.height).max() > 0.3
    assert np.abs(found.height - plain.height).max() < 0.1
    kept = np.abs(dirty.height - plain.height) == 0.0
    assert (found.height[kept] == plain.height[kept]).mean() > 0.999
    # Seven samples a swing and no noise: the motion itself goes far between them.
    few = PistonRecord(TIME, np.cos(2.0 * np.pi * np.arange(2000) / 7.0))
    np.testing.assert_array_equal(clip_outliers(few).height, few.height)


def test_a_fit_that_spares_outliers_starts_without_them() -> None:
    """One start is enough, and nobody calls the law wrong for what the loss spares."""
    for seed in range(3):
        _, dirty = swing(0.01, 0.03, seed)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            model = fit(dirty, "linear", starts=1, test_fraction=0.0, loss="soft_l1")
        assert abs(model.parameters["omega"] - 1.05) < 0.005
