"""A record of an elliptic motion is named as what it is, and as the Duffing law that it solves."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.special import ellipj

from granular import PistonRecord
from reduced_models import identify


def test_an_elliptic_motion_and_its_duffing_law_are_one() -> None:
    time = np.linspace(0.0, 40.0, 2000)  # as in other tests: fits of one shape are compiled once
    z = 1.2 * ellipj(1.1 * time, 0.6)[1]
    z += np.random.default_rng(0).normal(0.0, 0.01 * z.std(), len(z))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = identify(PistonRecord(time, z), laws=["linear", "duffing"], progress=False)
    motion = found.elliptic
    assert motion is not None
    assert motion.function == "cn"
    assert motion[2:] == pytest.approx((1.2, 1.1, 0.6), rel=0.01)
    assert found.best.law.name == "duffing"
    assert found.best.parameters["k"] == pytest.approx((1.0 - 2.0 * 0.6) * 1.1**2, rel=0.05)
    assert "one motion" in found.verdict
    assert found.to_plain()["elliptic"]["m"] == motion.m


def test_a_cosine_is_no_elliptic_motion() -> None:
    time = np.linspace(0.0, 40.0, 2000)
    z = np.cos(1.1 * time) + np.random.default_rng(0).normal(0.0, 0.005, len(time))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = identify(PistonRecord(time, z), laws=["linear", "duffing"], progress=False)
    assert found.elliptic is None
    assert "elliptic" not in found.verdict
