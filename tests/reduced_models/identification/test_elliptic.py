"""Elliptic motions, the Duffing law that they solve, and motions over two wells."""

import dataclasses
import functools
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

from granular import PistonRecord
from reduced_models import ReducedModel, fit, identify, law_named, load_model
from reduced_models.identification.elliptic_averaging import (
    average_elliptically,
    solve_elliptic_motion,
    two_well_quantities,
)
from reduced_models.models.quantities import quantity_lines
from tests.reduced_models.made import noisy

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

SAVED = Path(__file__).parents[2] / "data" / "model.json"


def test_an_elliptic_motion_is_recognised_as_a_solution_of_the_duffing_law() -> None:
    time = np.linspace(0.0, 40.0, 2000)  # as in other tests, since fits of one shape are compiled once
    z = 1.2 * ellipj(1.1 * time, 0.6)[1]
    record = noisy(time, z, 0.01 * z.std())
    found = identify(record, laws=["linear", "duffing"], starts=2, progress=False)
    motion = found.elliptic_motion
    assert motion.function == "cn"
    assert motion[2:] == pytest.approx((1.2, 1.1, 0.6), rel=0.01)
    assert found.best.law.name == "duffing"
    assert found.best.parameters["k"] == pytest.approx((1.0 - 2.0 * 0.6) * 1.1**2, rel=0.05)
    assert "describe the same motion" in found.verdict
    assert found.to_plain()["elliptic"]["m"] == motion.m
    drift = found.elliptic_averaging
    assert drift.amplitudes == pytest.approx((1.2, 1.2), rel=0.02)
    assert drift.amplitudes == pytest.approx(drift.solved_amplitudes, rel=0.002)
    assert drift.frequencies == pytest.approx((1.1 / (4.0 * ellipk(0.6)),) * 2, rel=0.005)
    assert drift.text[1:] in " ".join(str(found).split())
    assert "of duffing by elliptic averaging" in found.page().to_html()
    assert found.to_plain()["averaging"]["critical"] == drift.critical < 0.01


def test_a_cosine_is_not_reported_as_an_elliptic_motion() -> None:
    time = np.linspace(0.0, 40.0, 2000)
    record = noisy(time, np.cos(1.1 * time), 0.005)
    found = identify(record, laws=["linear", "duffing"], starts=2, progress=False)
    assert found.elliptic_motion is None
    assert found.elliptic_averaging is None
    assert "elliptic" not in found.verdict


@pytest.mark.parametrize(("alpha", "held"), [(0.02, True), (1.0, False)])
def test_averaging_method_reports_that_the_damping_is_too_large_for_it(alpha: float, held: bool) -> None:
    """The limit cycle of the Van der Pol-like law is nearly harmonic for alpha = 0.02, but not for 1."""
    model = dataclasses.replace(
        load_model(SAVED),
        law=law_named("van-der-pol-like"),
        parameters={"alpha": alpha, "omega": 1.05, "g0": 1.05**2, "shift": 0.0, "scale": 1.0},
        initial=(2.6, 0.0),
    )
    time = np.linspace(0.0, 40.0, 2000)
    found = average_elliptically(model, time)
    assert (found.critical < 1.0) == held
    assert ("in the first cycle" in found.text) == held
    assert ("valid below 1" in found.text) != held
    if held:
        assert found.amplitudes == pytest.approx(found.solved_amplitudes, rel=0.01)
        assert found.amplitudes[1] > found.amplitudes[0] + 0.05


TIME = np.linspace(0.0, 30.0, 1500)
AMPLITUDE, RATE, M = 1.2, 1.1, 0.6
BETA = 2.0 * M * RATE**2 / AMPLITUDE**2
K = RATE**2 - BETA * AMPLITUDE**2  # negative: a barrier between two wells
WELL = math.sqrt(-K / BETA)


@functools.cache
def fitted(law: str, amplitude: float = AMPLITUDE) -> ReducedModel:
    """Return the fit to the motion 1.2 cn(1.1 t) [m] of elliptic parameter 0.6, or to a motion within one
    well.
    """
    if amplitude == AMPLITUDE:
        height = AMPLITUDE * ellipj(RATE * TIME, M)[1]
    else:
        rate = amplitude * math.sqrt(0.5 * BETA)
        height = amplitude * ellipj(rate * TIME, 2.0 + K / rate**2)[2]
    noise = np.random.default_rng(0).normal(0.0, 0.002, len(TIME))
    return fit(PistonRecord(TIME, height + noise), law, test_fraction=0.0)


@pytest.mark.parametrize("law", ["duffing", "z'' = a*z + b*z**3 + c"])
def test_positions_and_frequencies_of_the_two_wells_of_a_potential_are_recovered(law: str) -> None:
    found = {item.name: item for item in two_well_quantities(fitted(law))}
    truth = {
        "lower well": -1e3 * WELL,
        "upper well": 1e3 * WELL,
        "frequency in the lower well": math.sqrt(-2.0 * K) / math.tau,
        "frequency in the upper well": math.sqrt(-2.0 * K) / math.tau,
        "frequency over both wells at 1.2e+03 mm": RATE / (4.0 * ellipk(M)),
    }
    assert set(found) == set(truth)
    for name, value in truth.items():
        error = found[name].total_error
        assert abs(found[name].value - value) < 2.0 * error
        assert error < 0.01 * abs(value)
    lines = quantity_lines(tuple(found.values()))
    assert lines[0].split()[:2] == ["lower", "well"]
    assert "-48" in lines[0]
    assert len(lines) == len(truth) + 1


def test_values_for_two_wells_are_omitted_for_a_motion_in_one_well_or_with_one_equilibrium() -> None:
    assert two_well_quantities(fitted("duffing", 0.6)) == ()
    time = np.linspace(0.0, 2.0, 500)
    swing = PistonRecord(time, 0.06 + 1e-3 * np.exp(-0.8 * time) * np.cos(21.8 * time))
    assert two_well_quantities(fit(swing, "linear", starts=1, test_fraction=0.0)) == ()


@pytest.mark.parametrize("law", ["duffing", "z'' = a*z + b*z**3 + c"])
def test_report_of_a_cubic_law_shows_its_elliptic_solution(law: str) -> None:
    model = fitted(law)
    solved = solve_elliptic_motion(model, 30.0)
    motion = solved.motion
    assert motion.function == "cn"
    assert motion.m == pytest.approx(M, abs=2e-3)
    assert motion.rate == pytest.approx(RATE, rel=1e-3)
    assert "z(t) = 1.2 cn(1.1 t + phase | " in solved.text


def test_a_motion_within_one_well_is_recognised_as_a_dn_function() -> None:
    solved = solve_elliptic_motion(fitted("duffing", 0.6), 30.0)
    assert solved.motion.function == "dn"
