"""Driven records: what an input does between samples, and grids that end at them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import InputError, RecordError
from reduced_models import FitOptions, Law, LawEstimator, ReducedModel, fit, load_model
from reduced_models.fitting.residuals import grid_over_record
from reduced_models.laws.solution import solve_law
from reduced_models.records.inputs import INTERPOLATIONS, Interpolation, interpolate_inputs, piecewise_cubics

LAW = Law("driven", "z'' + c*z' + k*z + b*z**3 = g*force", inputs=("force",))
TRUE = {"c": 0.1, "k": 1.0, "b": 0.3, "g": 1.0}
TIME = 0.2 * np.arange(2000)


def force() -> np.ndarray:
    """Ten sines up to a fifth of the sampling rate."""
    phases = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, 10)
    return 0.2 * np.sin(np.outer(TIME, np.linspace(0.2, 6.0, 10)) + phases).sum(axis=1)


def motion(how: Interpolation) -> np.ndarray:
    values = [TRUE[name] for name in LAW.parameters]
    found = solve_law(LAW, TIME, 0.0, 0.0, values, 1.0, [force()], (), how)
    assert found.ending == "complete"
    return found.z


@pytest.mark.parametrize("how", INTERPOLATIONS)
def test_pieces_and_values_are_the_same_input(how: Interpolation) -> None:
    columns = [force()]
    found = piecewise_cubics(TIME, columns, how)
    length, cubic = found.length[0], found.cubics[:, :, 0]
    middle = 0.5 * length
    values = cubic @ [1.0, middle, middle**2, middle**3]
    times = np.concatenate([[0.0], np.cumsum(found.length)[:-1]]) + middle
    wanted = interpolate_inputs(TIME, columns, times, how)[:, 0]
    inner = slice(200, -200)
    np.testing.assert_allclose(values[inner], wanted[inner], atol=2e-4)


def test_a_band_limited_input_is_that_between_samples() -> None:
    times = np.linspace(20.0, 300.0, 777)
    phases = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, 10)
    exact = 0.2 * np.sin(np.outer(times, np.linspace(0.2, 6.0, 10)) + phases).sum(axis=1)
    limits: dict[Interpolation, float] = {"band-limited": 1e-4, "spline": 0.02, "linear": 0.1}
    for how, limit in limits.items():
        found = interpolate_inputs(TIME, [force()], times, how)[:, 0]
        assert np.abs(found - exact).max() < limit


@pytest.mark.long  # quick: a band-limited input, which tells how far a spline is off
def test_a_spline_beats_monotone_cubics() -> None:
    from scipy.interpolate import PchipInterpolator

    fine = np.linspace(TIME[0], TIME[-1], 8 * (len(TIME) - 1) + 1)
    values = [TRUE[name] for name in LAW.parameters]
    drive = PchipInterpolator(TIME, force())(fine)
    monotone = solve_law(LAW, fine, 0.0, 0.0, values, 1.0, [drive], (), "linear").z[::8]
    exact = motion("band-limited")
    errors = [np.abs(one - exact)[1000:-20].max() for one in (motion("spline"), monotone)]
    assert errors[1] > 1.5 * errors[0]


def test_steps_end_at_samples() -> None:
    record = PistonRecord(TIME, force(), force=force())
    for period, steps_a_sample in ((40.0, 0.125), (3.3, 1.0), (0.5, 7.0)):
        grid = grid_over_record(record, ("force",), period, 16)
        assert 0.2 / grid.step == pytest.approx(steps_a_sample, rel=1e-12)
        assert grid.steps * grid.step >= TIME[-1] - 1e-9
    even = grid_over_record(record, (), 6.0, 16)
    assert even.steps * even.step == pytest.approx(TIME[-1], rel=1e-12)


@pytest.fixture(scope="module")
def held() -> PistonRecord:
    """A motion under a held input."""
    noise = np.random.default_rng(1).normal(0.0, 1e-3, len(TIME))
    return PistonRecord(TIME, motion("previous") + noise, force=force()).first(900)


@pytest.fixture(scope="module")
def model(held: PistonRecord) -> ReducedModel:
    """Its fit, with the interpolation that fits what is held out best."""
    return fit(held, LAW.equation, starts=1)


def test_the_interpolation_is_chosen_by_what_is_held_out(
    held: PistonRecord, model: ReducedModel, tmp_path: Path
) -> None:
    """A motion under a held input is that of a held input; the model remembers it."""
    record = held
    assert model.input_interpolation == "previous"
    assert model.quality.residual == pytest.approx(1e-3, rel=0.06)
    for name, value in TRUE.items():
        low, high = model.intervals[name]
        assert abs(model.parameters[name] - value) < high - low
    given = fit(record, LAW.equation, starts=1, options=FitOptions(input_interpolation="linear"))
    assert given.quality.residual > 5e-3
    model.save(tmp_path / "model.json")
    back = load_model(tmp_path / "model.json")
    np.testing.assert_array_equal(back.simulate_record(record).height, model.simulate_record(record).height)
    np.testing.assert_allclose(model.simulate_record(record).height + model.residuals(record), record.height)
    with pytest.raises(InputError, match="has the input 'force'; give inputs"):
        back.simulate(TIME)
    with pytest.raises(RecordError, match="no column of that name; found: none"):
        fit(PistonRecord(record.time, record.height), LAW)


def test_an_estimator_takes_the_input_behind_the_time(held: PistonRecord, model: ReducedModel) -> None:
    table = np.column_stack([held.time, held.columns["force"]])
    estimator = LawEstimator(LAW.equation, starts=1, inputs=("force",)).fit(table, held.height)
    assert estimator.n_features_in_ == 2
    assert estimator.model_.parameters == model.parameters
    np.testing.assert_allclose(estimator.predict(table), model.simulate_record(held).height, atol=1e-9)
    with pytest.raises(InputError, match="give 2: the time and force"):
        estimator.fit(table[:, :1], held.height)


def test_the_uncertainty_of_a_force_is_that_of_what_multiplies_it(
    held: PistonRecord, model: ReducedModel
) -> None:
    """Two per cent of a load cell's scale, next to what the record leaves open."""
    table = {"time [s]": held.time, "height [m]": held.height, "cell [V]": held.columns["force"]}
    record = PistonRecord.from_table(table, columns={"force": "cell"}, scale={"force": "1 +- 0.02 N/V"})
    wide = fit(record, LAW.equation, starts=1, options=FitOptions(input_interpolation="previous"))
    assert wide.parameters == pytest.approx(model.parameters, rel=1e-6)
    plain, more = (0.5 * np.diff(one.intervals["g"])[0] for one in (model, wide))
    assert more == pytest.approx(np.hypot(plain, 1.96 * 0.02 * model.parameters["g"]), rel=0.05)
