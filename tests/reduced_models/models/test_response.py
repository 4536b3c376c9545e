"""Methods of models: decays, cycles, driven responses, bands, posterior draws, plots, serialisation."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import LawEstimator, ReducedModel, fit, law_with_force_input, load_model, sample_posterior
from reduced_models.laws import LAWS
from reduced_models.laws.solution import solve_law
from tests.reduced_models.made import half_width


@pytest.fixture(scope="module")
def linear(made: Any) -> ReducedModel:
    return fit(made("linear"), "linear")


@pytest.fixture(scope="module")
def duffing(made: Any) -> ReducedModel:
    return fit(made("duffing"), "duffing", starts=1)


def test_a_cycle_of_the_linear_law_is_exact(linear: ReducedModel) -> None:
    """At any amplitude A: stiffness omega^2, damping 2 lam, and energy loss pi A^2 omega 2 lam."""
    lam, omega = linear.parameters["lam"], linear.parameters["omega"]
    for amplitude in (1e-3, 1.0, 1e3):
        loop = linear.harmonic_cycle(amplitude)
        assert loop.stiffness == pytest.approx(omega**2, rel=1e-9)
        assert loop.damping == pytest.approx(2.0 * lam, rel=1e-9)
        assert loop.frequency == pytest.approx(omega, rel=1e-9)
        assert loop.energy == pytest.approx(2.0 * math.pi * lam * omega * amplitude**2, rel=1e-9)
        assert loop.damping_ratio == pytest.approx(lam / omega, rel=1e-9)
        assert loop.centre == pytest.approx(linear.at_rest.height, abs=1e-6 * amplitude)


def test_the_linear_frequency_response_equals_the_textbook_formula(linear: ReducedModel) -> None:
    lam, omega = linear.parameters["lam"], linear.parameters["omega"]
    drive = np.linspace(0.2, 3.0, 50)
    found = linear.frequency_response(0.1, drive)
    exact = 0.1 / np.hypot(omega**2 - drive**2, 2.0 * lam * drive)
    np.testing.assert_allclose(found.low, exact, rtol=1e-3)
    np.testing.assert_allclose(found.high, exact, rtol=1e-3)


def test_describing_functions_of_the_duffing_law_agree_with_theory_and_simulation(
    duffing: ReducedModel,
) -> None:
    """The stiffness is k + 3/4 beta A^2. The driven simulation agrees within a few per cent."""
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


def test_the_energy_loss_of_a_decay_equals_the_loss_of_its_cycles(linear: ReducedModel) -> None:
    record = linear.free_decay(0.5, periods=6.0)
    assert record.height[0] == pytest.approx(linear.at_rest.height + 0.5, rel=1e-9)
    energies = (
        0.5 * record.velocity**2
        + 0.5 * linear.parameters["omega"] ** 2 * (record.height - linear.at_rest.height) ** 2
    )
    rate = -2.0 * linear.parameters["lam"] * record.time[-1]
    assert energies[-1] / energies[0] == pytest.approx(math.exp(rate), rel=0.1)


def test_cycles_and_frequency_responses_outside_their_range_are_refused(
    linear: ReducedModel, made: Any
) -> None:
    one, law = np.array([1.0]), LAWS["power-law-spring"]
    spring = dataclasses.replace(linear, law=law, parameters=made.true["power-law-spring"])
    for act, words in (
        (lambda: linear.harmonic_cycle(0.0), "give a value above 0"),
        (lambda: linear.harmonic_cycle(1.0, 0.0), r"frequency = 0\.0 rad/s"),
        (lambda: linear.free_decay(1.0, math.nan), "periods = nan"),
        (lambda: linear.frequency_response(0.1, 0.0 * one), "frequencies must be"),
        (lambda: linear.frequency_response(0.1, one, 0.0), r"largest = 0\.0 m"),
        (lambda: law_with_force_input(linear.law, "pi"), "does not contain the input"),
        (lambda: spring.harmonic_cycle(50.0, 1.0), "leaves the range in which the law"),
    ):
        with pytest.raises(InputError, match=words):
            act()


def test_the_exported_python_module_runs_without_the_toolkit(duffing: ReducedModel) -> None:
    times = np.linspace(0.0, 10.0, 300)
    space: dict[str, Any] = {}
    exec(duffing.numpy_source, space)
    np.testing.assert_allclose(space["simulate"](times), duffing.simulate(times).height, atol=1e-5)
    assert "LaTeX:" in duffing.text
    assert "sha256" in duffing.text


def test_a_model_stores_the_range_of_its_data_and_their_origin(duffing: ReducedModel, tmp_path: Any) -> None:
    assert duffing.outside_range_text(duffing.free_decay(0.5)) == ""
    assert "extrapolation" in duffing.outside_range_text(duffing.free_decay(9.0, periods=1.0))
    duffing.save(tmp_path / "model.json")
    back = load_model(tmp_path / "model.json")
    assert back.provenance == duffing.provenance
    assert back.provenance["data"].startswith("2000 samples over 40 s, sha256 ")


def test_the_estimator_of_a_law_predicts_and_scores_a_motion(made: Any) -> None:
    record = made("linear")
    times = record.time[:, None]
    estimator = LawEstimator("linear").fit(times, record.height)
    assert estimator.score(times, record.height) == pytest.approx(1.0 - 1e-4, abs=2e-5)
    shuffle = np.random.default_rng(0).permutation(times)
    again = estimator.predict(shuffle)[np.argsort(shuffle[:, 0])]
    assert np.array_equal(again, estimator.predict(times))
    with pytest.raises(InputError, match="give later times"):
        estimator.predict(np.array([[-1.0]]))
    assert isinstance(estimator.model_.simulate_record(record), PistonRecord)


TRUE = {"lam": 0.05, "omega": 1.05, "g0": -1.0}


def test_prediction_bands_follow_from_the_covariance(
    made: Callable[..., PistonRecord], tmp_path: Path
) -> None:
    record = made("linear")
    model = fit(record, "linear")
    assert model.covariance_names == ("lam", "omega", "g0", "height", "velocity")
    spread = np.sqrt(np.diag(model.covariance))
    for k, name in enumerate(TRUE):
        assert half_width(model, name) == pytest.approx(1.96 * spread[k], rel=0.01)
    np.testing.assert_allclose(np.diag(model.correlation), 1.0)
    band = model.predict_with_band(record.time)
    clean = made("linear", level=0.0).height
    assert ((band.low <= clean) & (clean <= band.high)).mean() > 0.8
    assert 1e-4 < float((band.high - band.low).mean()) < 0.02
    np.testing.assert_allclose(model.residuals(record), record.height - band.height, atol=1e-12)
    model.save(tmp_path / "model.json")
    back = load_model(tmp_path / "model.json")
    np.testing.assert_array_equal(back.covariance, model.covariance)
    wider = back.predict_with_band(record.time, confidence=0.99)
    assert float((wider.high - wider.low).mean()) > float((band.high - band.low).mean())
    with pytest.raises(InputError, match="a fraction between 0 and 1"):
        model.predict_with_band(record.time, confidence=2.0)
    bare = model.to_plain() | {"covariance_names": [], "covariance": []}
    with pytest.raises(InputError, match="has no covariance; fit it to a record"):
        ReducedModel.from_plain(bare).predict_with_band(record.time)


def test_a_model_has_text_html_and_latex_representations(made: Callable[..., PistonRecord]) -> None:
    record = made("linear", level=0.02)
    model = fit(record, "linear")
    assert [len(one.lines) for one in model.plot(record).figure.axes] == [2, 1]
    ax = Figure().subplots()
    assert model.plot(record, ax) is ax
    assert len(ax.figure.axes) == 1
    swing, rest = model.plot().lines[0].get_ydata(), model.at_rest.height
    seen = np.array(model.domain["height"])
    assert abs(swing[0] - 1e3 * rest) == pytest.approx(1e3 * np.abs(seen - rest).max())
    assert repr(model).startswith("ReducedModel 'linear': z'' + 2*lam*z' + omega**2*z = g0\n  lam =")
    assert "<math" in model._repr_html_()
    assert model._repr_latex_() == f"$${model.fitted_latex}$$"


@pytest.mark.long
def test_posterior_distribution_for_small_noise_is_normal_about_the_fit(
    made: Callable[..., PistonRecord],
) -> None:
    """Its covariance equals the covariance of the linearised problem."""
    arviz, _ = pytest.importorskip("arviz"), pytest.importorskip("numpyro")
    record = made("linear", level=0.02)
    record = PistonRecord(record.time[::5], record.height[::5])
    model = fit(record, "linear")
    draws = sample_posterior(model, record, draws=200, warmup=150).posterior
    for name in TRUE:
        values, width = draws[name].values.ravel(), half_width(model, name)
        assert abs(values.mean() - model.parameters[name]) < 0.3 * width
        assert 1.96 * values.std() == pytest.approx(width, rel=0.25)
    assert set(arviz.summary(draws.dataset).index) == set(draws.data_vars)
    assert float(draws["noise"].mean()) == pytest.approx(model.quality.residual, rel=0.1)
    with pytest.raises(InputError, match="1 models for 2 records"):
        sample_posterior(model, [record, record])


@pytest.mark.long
def test_posterior_samples_for_several_records_have_a_dimension_for_the_records(
    made: Callable[..., PistonRecord],
) -> None:
    pytest.importorskip("numpyro")
    record = made("linear", level=0.02)
    record = PistonRecord(record.time[::5], record.height[::5])
    model = fit(record, "linear")
    draws = sample_posterior([model] * 3, [record] * 3, per_record=["lam"], draws=20, warmup=40).posterior
    assert dict(draws.sizes) == {"chain": 2, "draw": 20, "record": 3}
    assert {name for name in draws.data_vars if "record" in draws[name].dims} == {"lam", "height", "velocity"}
