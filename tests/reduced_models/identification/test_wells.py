"""Two wells that a motion goes over, and the closed form of cubic laws."""

from __future__ import annotations

import functools
import math
import warnings

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

from granular import PistonRecord
from reduced_models import ReducedModel, fit
from reduced_models.identification.elliptic_averaging import solve_elliptic_motion, well_quantities
from reduced_models.models.printout import figure_lines

TIME = np.linspace(0.0, 30.0, 1500)
AMPLITUDE, RATE, M = 1.2, 1.1, 0.6
BETA = 2.0 * M * RATE**2 / AMPLITUDE**2
K = RATE**2 - BETA * AMPLITUDE**2  # below zero: a hump between two wells
WELL = math.sqrt(-K / BETA)


@functools.cache
def fitted(law: str, amplitude: float = AMPLITUDE) -> ReducedModel:
    """Fit to z = 1.2 cn(1.1 t | 0.6) m, or to a motion within one of the wells."""
    if amplitude == AMPLITUDE:
        height = AMPLITUDE * ellipj(RATE * TIME, M)[1]
    else:
        rate = amplitude * math.sqrt(0.5 * BETA)
        height = amplitude * ellipj(rate * TIME, 2.0 + K / rate**2)[2]
    noise = np.random.default_rng(0).normal(0.0, 0.002, len(TIME))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fit(PistonRecord(TIME, height + noise), law, starts=8, test_fraction=0.0)


@pytest.mark.parametrize("law", ["duffing", "z'' = a*z + b*z**3 + c"])
def test_the_wells_and_their_frequencies(law: str) -> None:
    found = {item.name: item for item in well_quantities(fitted(law))}
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
    lines = figure_lines(tuple(found.values()))
    assert lines[0].split()[:2] == ["lower", "well"]
    assert "-48" in lines[0]
    assert len(lines) == len(truth) + 1


def test_a_motion_in_one_well_or_with_one_equilibrium_has_no_two() -> None:
    assert well_quantities(fitted("duffing", 0.6)) == ()
    time = np.linspace(0.0, 2.0, 500)
    swing = PistonRecord(time, 0.06 + 1e-3 * np.exp(-0.8 * time) * np.cos(21.8 * time))
    assert well_quantities(fit(swing, "linear", starts=1, test_fraction=0.0)) == ()


@pytest.mark.parametrize("law", ["duffing", "z'' = a*z + b*z**3 + c"])
def test_a_cubic_law_names_its_closed_form(law: str) -> None:
    model = fitted(law)
    solved = solve_elliptic_motion(model, 30.0)
    assert solved is not None
    motion = solved.motion
    assert motion.function == "cn"
    assert motion.m == pytest.approx(M, abs=2e-3)
    assert motion.rate == pytest.approx(RATE, rel=1e-3)
    assert "z(t) = 1.2 cn(1.1 t + phase | " in solved.text


def test_a_motion_within_a_well_is_a_dn() -> None:
    solved = solve_elliptic_motion(fitted("duffing", 0.6), 30.0)
    assert solved is not None
    assert solved.motion.function == "dn"
