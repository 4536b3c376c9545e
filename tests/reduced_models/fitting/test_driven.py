"""Driven records, and initial hidden states from the motion before the record."""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord
from granular.shared.errors import InputError, RecordError
from reduced_models import FitOptions, Law, LawEstimator, ReducedModel, fit, load_model
from reduced_models.fitting.residuals import grid_over_record
from reduced_models.laws.catalogue import LAWS as PACKAGED
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.solution import solve_law
from reduced_models.records.inputs import INTERPOLATIONS, Interpolation, interpolate_inputs, piecewise_cubics
from tests.reduced_models.made import assert_found, half_width, noisy
from tests.reduced_models.models.test_printed_equation import assert_memory_as_printed

LAW = Law("driven", "z'' + c*z' + k*z + b*z**3 = g*force", inputs=("force",))
TRUE = {"c": 0.1, "k": 1.0, "b": 0.3, "g": 1.0}
TIME = 0.2 * np.arange(2000)


def force(time: np.ndarray = TIME) -> np.ndarray:
    """Sum of ten sines of frequencies up to a fifth of the sampling rate."""
    phases = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, 10)
    return 0.2 * np.sin(np.outer(time, np.linspace(0.2, 6.0, 10)) + phases).sum(axis=1)


@pytest.mark.parametrize("how", INTERPOLATIONS)
def test_polynomials_that_interpolate_an_input_reproduce_its_samples(how: Interpolation) -> None:
    columns = [force()]
    found = piecewise_cubics(TIME, columns, how)
    length, cubic = found.length[0], found.cubics[:, :, 0]
    middle = 0.5 * length
    values = cubic @ [1.0, middle, middle**2, middle**3]
    times = np.concatenate([[0.0], np.cumsum(found.length)[:-1]]) + middle
    wanted = interpolate_inputs(TIME, columns, times, how)[:, 0]
    inner = slice(200, -200)
    np.testing.assert_allclose(values[inner], wanted[inner], atol=2e-4)


def test_band_limited_interpolation_of_the_input_is_exact_between_samples() -> None:
    times = np.linspace(20.0, 300.0, 777)
    limits: dict[Interpolation, float] = {"band-limited": 1e-4, "spline": 0.02, "linear": 0.1}
    for how, limit in limits.items():
        found = interpolate_inputs(TIME, [force()], times, how)[:, 0]
        assert np.abs(found - force(times)).max() < limit


def test_time_steps_of_driven_laws_end_at_samples_of_the_input() -> None:
    record = PistonRecord(TIME, force(), force=force())
    for period, steps_a_sample in ((40.0, 0.125), (3.3, 1.0), (0.5, 7.0)):
        grid = grid_over_record(record, ("force",), period, 16)
        assert 0.2 / grid.step == pytest.approx(steps_a_sample, rel=1e-12)
        assert grid.steps * grid.step >= TIME[-1] - 1e-9
    even = grid_over_record(record, (), 6.0, 16)
    assert even.steps * even.step == pytest.approx(TIME[-1], rel=1e-12)


@pytest.fixture(scope="module")
def held_input_record() -> PistonRecord:
    """Return a motion under an input that is held constant between samples."""
    values = [TRUE[name] for name in LAW.parameters]
    found = solve_law(LAW, TIME, 0.0, 0.0, values, 1.0, [force()], (), "previous")
    assert found.ending == "complete"
    return noisy(TIME, found.z, 1e-3, 1, force=force()).first(900)


@pytest.fixture(scope="module")
def model(held_input_record: PistonRecord) -> ReducedModel:
    """Return the fit with the interpolation that has the smallest held-out error."""
    return fit(held_input_record, LAW.equation, starts=1)


def test_fit_recognises_an_input_that_was_held_constant_between_samples(
    held_input_record: PistonRecord, model: ReducedModel, tmp_path: Path
) -> None:
    """The fit compares interpolations by their error on held-out data, and the model stores the best one."""
    assert model.input_interpolation == "previous"
    assert model.quality.residual == pytest.approx(1e-3, rel=0.06)
    assert_found(model, TRUE, 1.0)
    given = fit(held_input_record, LAW.equation, starts=1, options=FitOptions(input_interpolation="linear"))
    assert given.quality.residual > 5e-3
    model.save(tmp_path / "model.json")
    back = load_model(tmp_path / "model.json")
    simulated = model.simulate_record(held_input_record).height
    np.testing.assert_array_equal(back.simulate_record(held_input_record).height, simulated)
    np.testing.assert_allclose(simulated + model.residuals(held_input_record), held_input_record.height)
    with pytest.raises(InputError, match="has the input 'force'; give inputs"):
        back.simulate(TIME)
    with pytest.raises(RecordError, match="no column of that name; its columns: none"):
        fit(PistonRecord(held_input_record.time, held_input_record.height), LAW)


def test_scikit_learn_estimator_reads_the_input_from_the_column_after_the_time(
    held_input_record: PistonRecord, model: ReducedModel
) -> None:
    table = np.column_stack([held_input_record.time, held_input_record.columns["force"]])
    estimator = LawEstimator(LAW.equation, starts=1, inputs=("force",)).fit(table, held_input_record.height)
    assert estimator.n_features_in_ == 2
    assert estimator.model_.parameters == model.parameters
    np.testing.assert_allclose(
        estimator.predict(table), model.simulate_record(held_input_record).height, atol=1e-9
    )
    with pytest.raises(InputError, match="give 2: the time and force"):
        estimator.fit(table[:, :1], held_input_record.height)


def test_calibration_error_of_a_force_widens_the_interval_of_its_coefficient(
    held_input_record: PistonRecord, model: ReducedModel
) -> None:
    """A scale error of 2 % of the load cell adds to the statistical error."""
    table = {
        "time [s]": held_input_record.time,
        "height [m]": held_input_record.height,
        "cell [V]": held_input_record.columns["force"],
    }
    record = PistonRecord.from_table(table, columns={"force": "cell"}, scale={"force": "1 +- 0.02 N/V"})
    wide = fit(record, LAW.equation, starts=1, options=FitOptions(input_interpolation="previous"))
    assert wide.parameters == pytest.approx(model.parameters, rel=1e-6)
    expected = np.hypot(half_width(model, "g"), 1.96 * 0.02 * model.parameters["g"])
    assert half_width(wide, "g") == pytest.approx(expected, rel=0.05)


HYSTERESIS = {"omega": 1.05, "friction": 0.5, "rho": 1.0, "sigma": 0.8, "g0": -1.0}
LONG_TIME = np.linspace(0.0, 55.0, 2750)
CUT = 15.0
NOISE = 0.003


@functools.cache
def motion() -> np.ndarray:
    """Height, velocity and hidden state (3, n), by SciPy."""
    law = PACKAGED["bouc-wen"]
    field, values = compile_rates(law.equation, (), "numpy"), [HYSTERESIS[name] for name in law.parameters]

    def rates(_: float, y: np.ndarray) -> list[float]:
        return [y[1], *field(*y, *values)]

    options = {"method": "DOP853", "t_eval": LONG_TIME, "rtol": 1e-10, "atol": 1e-12}
    return np.asarray(solve_ivp(rates, (0.0, LONG_TIME[-1]), [3.0, 0.0, 0.0], **options).y)


def hysteretic_motion() -> PistonRecord:
    """Return a hysteretic oscillation that begins before the fitted part of the record."""
    return noisy(LONG_TIME, motion()[0], NOISE)


@pytest.fixture(scope="module")
def hysteretic() -> ReducedModel:
    """Fit of the late part of an oscillation, given the motion before it."""
    record = hysteretic_motion()
    before, after = record.between(0.0, CUT), record.between(CUT, LONG_TIME[-1])
    found = fit(after, "bouc-wen", starts=4, options=FitOptions(initial=before))
    assert found.quality.residual == pytest.approx(NOISE, rel=0.05)
    assert_found(found, HYSTERESIS)
    return found


def test_the_initial_hidden_state_is_computed_from_the_preceding_motion(hysteretic: ReducedModel) -> None:
    assert abs(true := motion()[2][np.searchsorted(LONG_TIME, CUT)]) > 0.2
    assert hysteretic.hidden["w"] == pytest.approx(true, abs=0.01)
    late = hysteretic_motion().between(CUT, LONG_TIME[-1])
    still = dataclasses.replace(hysteretic, hidden={}).simulate(late.time - late.time[0]).height
    assert np.abs(still - late.height).max() > 10.0 * NOISE


def test_exported_python_code_of_a_hysteretic_law_starts_from_the_fitted_hidden_state(
    hysteretic: ReducedModel,
) -> None:
    times = np.linspace(0.0, 10.0, 300)
    assert abs(hysteretic.hidden["w"]) > 0.2
    space: dict[str, Any] = {}
    exec(hysteretic.numpy_source, space)
    np.testing.assert_allclose(space["simulate"](times), hysteretic.simulate(times).height, atol=1e-5)


def test_hysteresis_loop_area_equals_the_work_of_the_force(hysteretic: ReducedModel) -> None:
    """The energy of a cycle of a Bouc-Wen law and the ends of its loop are computed by another solver."""
    friction, rho, sigma = (hysteretic.parameters[key] for key in ("friction", "rho", "sigma"))
    size, omega = 6.0, 0.7

    def rates(t: float, state: np.ndarray) -> list[float]:
        w, v = state[0], -size * omega * np.sin(omega * t)
        return [rho * (v - sigma * abs(v) * abs(w) * w + (sigma - 1.0) * v * w**2), friction * w * v]

    period = 2.0 * np.pi / omega
    times = [0.0, 3.0 * period, 4.0 * period]
    work = solve_ivp(rates, (0, times[-1]), [0, 0], rtol=1e-9, atol=1e-10, t_eval=times).y[1]
    loop = hysteretic.harmonic_cycle(size, omega)
    assert loop.energy == pytest.approx(work[2] - work[1], rel=2e-3)
    assert 0.5 < loop.energy / (4.0 * friction * size) < 1.0
    assert hysteretic.harmonic_cycle(size, 2.0 * omega).energy == pytest.approx(loop.energy, rel=1e-9)


def test_printed_parameters_of_a_bouc_wen_law_describe_its_oscillation(hysteretic: ReducedModel) -> None:
    assert_memory_as_printed(hysteretic)


def test_without_the_preceding_motion_the_initial_hidden_state_is_fitted() -> None:
    late, options = hysteretic_motion().between(CUT, LONG_TIME[-1]), FitOptions(initial="free")
    free = fit(late, "bouc-wen", starts=4, options=options)
    assert free.hidden["w"] == pytest.approx(motion()[2][np.searchsorted(LONG_TIME, CUT)], abs=0.01)
    assert free.quality.residual == pytest.approx(NOISE, rel=0.05)


def test_invalid_motions_before_a_record_are_refused(made: Callable[..., PistonRecord]) -> None:
    record = hysteretic_motion()
    late = record.between(CUT, LONG_TIME[-1])
    for initial, words in (
        (record.between(0.0, 5.0), r"ends at 4\.\d+ s, but the record begins at 15\.\d+ s; cut both"),
        (record, "cut both from one record"),
        ([record.between(0.0, CUT)] * 2, "2 motions for 1 records; give one motion for each"),
        (PistonRecord(LONG_TIME, LONG_TIME, force=LONG_TIME).between(0.0, CUT), "columns"),
    ):
        with pytest.raises(InputError, match=words):
            fit(late, "bouc-wen", options=FitOptions(initial=initial))
    with pytest.raises(InputError, match="has no hidden state"):
        fit(made("linear"), "linear", options=FitOptions(initial=record))
    with pytest.raises(InputError, match="or the record of the preceding motion"):
        fit(late, "bouc-wen", options=FitOptions(initial=3))  # type: ignore[call-overload]  # what types forbid
