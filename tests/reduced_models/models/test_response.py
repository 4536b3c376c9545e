"""Models as objects: decays, cycles, drives, text, and the manners of an estimator."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import LawEstimator, ReducedModel, fit, law_with_force_input, load_model
from reduced_models.laws import LAWS, law_named
from reduced_models.laws.solution import solve_law


@pytest.fixture(scope="module")
def linear(made: Any) -> ReducedModel:
    return fit(made("linear"), "linear")


@pytest.fixture(scope="module")
def duffing(made: Any) -> ReducedModel:
    return fit(made("duffing"), "duffing", starts=1)


def test_a_linear_cycle_is_exact(linear: ReducedModel) -> None:
    """Stiffness omega^2, damping 2 lam, energy pi A^2 omega 2 lam, at any amplitude."""
    lam, omega = linear.parameters["lam"], linear.parameters["omega"]
    for amplitude in (1e-3, 1.0, 1e3):
        loop = linear.harmonic_cycle(amplitude)
        assert loop.stiffness == pytest.approx(omega**2, rel=1e-9)
        assert loop.damping == pytest.approx(2.0 * lam, rel=1e-9)
        assert loop.frequency == pytest.approx(omega, rel=1e-9)
        assert loop.energy == pytest.approx(2.0 * math.pi * lam * omega * amplitude**2, rel=1e-9)
        assert loop.damping_ratio == pytest.approx(lam / omega, rel=1e-9)
        assert loop.centre == pytest.approx(linear.at_rest.height, abs=1e-6 * amplitude)


def test_the_linear_frequency_response_is_the_textbook_one(linear: ReducedModel) -> None:
    lam, omega = linear.parameters["lam"], linear.parameters["omega"]
    drive = np.linspace(0.2, 3.0, 50)
    found = linear.frequency_response(0.1, drive)
    exact = 0.1 / np.hypot(omega**2 - drive**2, 2.0 * lam * drive)
    np.testing.assert_allclose(found.low, exact, rtol=1e-3)
    np.testing.assert_allclose(found.high, exact, rtol=1e-3)


def test_describing_functions_of_duffing(duffing: ReducedModel) -> None:
    """K + 3/4 beta A^2 (exact), and the driven simulation within the method's few per cent."""
    values = duffing.parameters
    loop = duffing.harmonic_cycle(0.8)
    expected = values["k"] + 0.75 * values["beta"] * 0.64
    assert loop.stiffness == pytest.approx(expected, rel=1e-9)
    drive = 0.8
    found = duffing.frequency_response(0.05, np.array([drive]))
    time = np.linspace(0.0, 40.0 * 2.0 * math.pi / drive, 8000)
    law = law_with_force_input(duffing.law)
    parameters = [values[name] for name in law.parameters]
    push = 0.05 * np.cos(drive * time)
    steady = solve_law(law, time, values["rest"], 0.0, parameters, 1.0, [push]).z[-1000:]
    assert found.high[0] == pytest.approx(0.5 * np.ptp(steady), rel=0.03)


def test_a_decay_loses_the_energy_of_its_cycles(linear: ReducedModel) -> None:
    record = linear.free_decay(0.5, periods=6.0)
    assert record.height[0] == pytest.approx(linear.at_rest.height + 0.5, rel=1e-9)
    energies = (
        0.5 * record.velocity**2
        + 0.5 * linear.parameters["omega"] ** 2 * (record.height - linear.at_rest.height) ** 2
    )
    rate = -2.0 * linear.parameters["lam"] * record.time[-1]
    assert energies[-1] / energies[0] == pytest.approx(math.exp(rate), rel=0.1)


def test_cycles_that_cannot_be(linear: ReducedModel, made: Any) -> None:
    with pytest.raises(InputError, match="give one above 0"):
        linear.harmonic_cycle(0.0)
    with pytest.raises(InputError, match=r"frequency = 0\.0 rad/s"):
        linear.harmonic_cycle(1.0, 0.0)
    with pytest.raises(InputError, match="periods = nan"):
        linear.free_decay(1.0, math.nan)
    with pytest.raises(InputError, match="frequencies must be"):
        linear.frequency_response(0.1, np.array([0.0]))
    with pytest.raises(InputError, match=r"largest = 0\.0 m"):
        linear.frequency_response(0.1, np.array([1.0]), 0.0)
    with pytest.raises(InputError, match="does not name"):
        law_with_force_input(linear.law, "pi")
    law, values = LAWS["power-law-spring"], made.true["power-law-spring"]
    spring = dataclasses.replace(linear, law=law, parameters=values)
    with pytest.raises(InputError, match="leaves where the law"):
        spring.harmonic_cycle(50.0, 1.0)


@pytest.mark.parametrize(
    "name",
    ["duffing", pytest.param("bouc-wen", marks=pytest.mark.long)],  # quick: Bouc-Wen's of `test_exports`
)
def test_text_that_runs_alone(name: str, duffing: ReducedModel, made: Any) -> None:
    times = np.linspace(0.0, 10.0, 300)
    model = duffing
    if name != "duffing":
        model = dataclasses.replace(
            duffing, law=law_named(name), parameters=made.true[name], initial=(3.0, 0.0)
        )
    space: dict[str, Any] = {}
    exec(model.numpy_source, space)
    np.testing.assert_allclose(space["simulate"](times), model.simulate(times).height, atol=1e-5)
    assert "LaTeX:" in duffing.text
    assert "sha256" in duffing.text


def test_domain_and_provenance(duffing: ReducedModel, tmp_path: Any) -> None:
    assert duffing.outside_range_text(duffing.free_decay(0.5)) == ""
    assert "extrapolation" in duffing.outside_range_text(duffing.free_decay(9.0, periods=1.0))
    duffing.save(tmp_path / "model.json")
    back = load_model(tmp_path / "model.json")
    assert back.provenance == duffing.provenance
    assert back.provenance["data"].startswith("2000 samples over 40 s, sha256 ")


def test_the_manners_of_an_estimator(made: Any) -> None:
    record = made("linear")
    times = record.time[:, None]
    estimator = LawEstimator("linear").fit(times, record.height)
    assert estimator.score(times, record.height) == pytest.approx(1.0 - 1e-4, abs=2e-5)
    shuffle = np.random.default_rng(0).permutation(times)
    again = estimator.predict(shuffle)[np.argsort(shuffle[:, 0])]
    assert np.array_equal(again, estimator.predict(times))
    with pytest.raises(InputError, match="give times from there on"):
        estimator.predict(np.array([[-1.0]]))
    assert isinstance(estimator.model_.simulate_record(record), PistonRecord)
