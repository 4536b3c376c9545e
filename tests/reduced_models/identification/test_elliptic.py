"""A record of an elliptic motion is named as what it is, and as the Duffing law that it solves."""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

from granular import PistonRecord
from reduced_models import identify, law_named, load_model
from reduced_models.identification.elliptic_averaging import average_elliptically

SAVED = Path(__file__).parents[2] / "data" / "model.json"


def test_an_elliptic_motion_and_its_duffing_law_are_one() -> None:
    time = np.linspace(0.0, 40.0, 2000)  # as in other tests: fits of one shape are compiled once
    z = 1.2 * ellipj(1.1 * time, 0.6)[1]
    z += np.random.default_rng(0).normal(0.0, 0.01 * z.std(), len(z))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = identify(PistonRecord(time, z), laws=["linear", "duffing"], starts=2, progress=False)
    motion = found.elliptic_motion
    assert motion is not None
    assert motion.function == "cn"
    assert motion[2:] == pytest.approx((1.2, 1.1, 0.6), rel=0.01)
    assert found.best.law.name == "duffing"
    assert found.best.parameters["k"] == pytest.approx((1.0 - 2.0 * 0.6) * 1.1**2, rel=0.05)
    assert "one motion" in found.verdict
    assert found.to_plain()["elliptic"]["m"] == motion.m
    drift = found.elliptic_averaging
    assert drift is not None
    assert drift.amplitudes == pytest.approx((1.2, 1.2), rel=0.02)
    assert drift.amplitudes == pytest.approx(drift.solved_amplitudes, rel=0.002)
    assert drift.frequencies == pytest.approx((1.1 / (4.0 * ellipk(0.6)),) * 2, rel=0.005)
    assert drift.text[1:] in " ".join(str(found).split())
    assert "of duffing by elliptic averaging" in found.page().to_html()
    assert found.to_plain()["averaging"]["critical"] == drift.critical < 0.01


def test_a_cosine_is_no_elliptic_motion() -> None:
    time = np.linspace(0.0, 40.0, 2000)
    z = np.cos(1.1 * time) + np.random.default_rng(0).normal(0.0, 0.005, len(time))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = identify(PistonRecord(time, z), laws=["linear", "duffing"], starts=2, progress=False)
    assert found.elliptic_motion is None
    assert found.elliptic_averaging is None
    assert "elliptic" not in found.verdict


@pytest.mark.parametrize(("alpha", "held"), [(0.02, True), (1.0, False)])
def test_averaging_says_where_it_does_not_hold(alpha: float, held: bool) -> None:
    """The Van der Pol-like law about z = 1 has a limit cycle of 2, a smooth one or a jerky one."""
    model = dataclasses.replace(
        load_model(SAVED),
        law=law_named("van-der-pol-like"),
        parameters={"alpha": alpha, "omega": 1.05, "g0": 1.05**2, "shift": 0.0, "scale": 1.0},
        initial=(2.6, 0.0),
    )
    time = np.linspace(0.0, 40.0, 2000)
    found = average_elliptically(model, time)
    assert found is not None
    assert (found.critical < 1.0) == held
    assert ("in the first cycle" in found.text) == held
    assert ("holds below 1" in found.text) != held
    if held:
        assert found.amplitudes == pytest.approx(found.solved_amplitudes, rel=0.01)
        assert found.amplitudes[1] > found.amplitudes[0] + 0.05
