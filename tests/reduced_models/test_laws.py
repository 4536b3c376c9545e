"""Every law finds itself in its own motion, at 1 % noise."""

from __future__ import annotations

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models import fit
from reduced_models.laws import LAWS
from reduced_models.rollout import motion

TRUE = {
    "linear": ({"lam": 0.8, "omega": 21.8, "g0": 28.0}, 0.063),
    "van-der-pol": ({"mu": 4.0, "rest": 0.06, "width": 0.001, "omega": 21.8}, 0.061),
    "duffing": ({"lam": 0.5, "omega": 21.8, "rest": 0.06, "beta": 3e7}, 0.066),
    "polynomial-spring": (
        {"lam": 0.5, "k1": 475.0, "rest": 0.06, "k2": -6e4, "k3": 1e7},
        0.066,
    ),
    "power-law-spring": ({"lam": 0.5, "weight": 9.8, "rest": 0.06, "power": 2.8}, 0.1),
    "quadratic-drag": ({"c": 30.0, "omega": 21.8, "g0": 28.0}, 0.066),
}


@pytest.mark.parametrize("name", TRUE)
def test_a_law_finds_itself(name: str) -> None:
    """Half a per cent in the median over records of 4000 samples with noise of their own."""
    law, (true, start) = LAWS[name], TRUE[name]
    time = np.linspace(0.0, 4.0, 4000)
    values = [true[key] for key in law.parameters]
    clean = motion(law, time, start, 0.0, values, 1e-3)
    assert clean.ending == "complete"
    wrong = []
    for seed in range(5):
        noise = np.random.default_rng(seed).normal(0.0, 0.01 * clean.z.std(), len(time))
        model = fit(PistonRecord(time, clean.z + noise), law)
        assert model.quality.converged >= 8
        wrong.append([abs(model.parameters[key] / true[key] - 1.0) for key in law.parameters])
    assert np.median(wrong, axis=0).max() < 0.005
