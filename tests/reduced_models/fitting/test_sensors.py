"""Fits of sensor signals: velocities, accelerations and voltages, with filters."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

from granular import PistonRecord
from granular.shared.errors import InputError, RecordError, RecordWarning
from reduced_models import FitOptions, ReducedModel, Sensor, compare, fit
from reduced_models.fitting.residuals import solution_signal, tabulate_sensor_signal_coefficients
from reduced_models.laws.law import law_from_text
from reduced_models.laws.symmetry import find_compensating_parameters
from reduced_models.records.inputs import StepGrid
from reduced_models.records.sensor import parse_sensor
from tests.reduced_models.made import Made, assert_found, made_signal

OMEGA = 2.0 * math.pi * 6.0
LINEAR = {"lam": 1.1, "omega": OMEGA, "g0": 0.0}


def fitted(made: Made, **options: int) -> ReducedModel:
    return fit(made.record, made.law, options=FitOptions(measured=made.sensor), **options)


def test_a_filtered_acceleration_is_fitted() -> None:
    sensor = Sensor("acceleration", low_pass=200.0, damping_ratio=0.7)
    made = made_signal("linear", LINEAR, 3e-3, sensor, 1.0, 0.3, 0.01, np.random.default_rng(1))
    model = fitted(made, starts=1)
    assert_found(model, {"lam": 1.1, "omega": OMEGA})
    assert model.sensor.offset == pytest.approx(0.3, abs=0.01)
    assert model.untold == ("level", "g0")
    assert "g0 " not in str(model).split("(z: height")[1].split("not determined")[0]
    assert "natural frequency" in str(model)
    assert "\n  equilibrium " not in str(model)
    assert "g0" not in {*model.parameters, *model.intervals}
    assert model.conventions == {"g0": 0.0}
    # The residual is the noise, a hundredth of the signal, at all times.
    assert model.quality.relative == pytest.approx(0.01, rel=0.1)
    residuals = model.residuals(made.record)[100:]
    assert residuals.std() == pytest.approx(model.quality.residual, rel=0.1)
    # A saved model keeps its sensor.
    again = ReducedModel.from_plain(model.to_plain())
    assert (again.sensor, again.untold) == (model.sensor, model.untold)
    assert again.conventions == model.conventions


def test_an_accelerometer_of_unknown_gain_leaves_the_cubic_stiffness_undetermined() -> None:
    """The cubic stiffness depends on the amplitude, which such a sensor does not determine."""
    sensor = Sensor("acceleration", gain="free")
    truth = {"lam": 1.1, "k": OMEGA**2, "rest": 0.0, "beta": 0.5 * OMEGA**2 / 3e-3**2}
    made = made_signal("duffing", truth, 3e-3, sensor, 2.5, 0.0, 0.01, np.random.default_rng(3))
    model = fitted(made, starts=1)
    assert set(model.untold) == {"level", "rest", "size", "beta"}
    assert set(model.parameters) == set(model.intervals) == {"lam", "k"}
    assert model.parameters["k"] == pytest.approx(truth["k"], rel=0.01)
    assert set(model.conventions) == {"rest", "beta"}
    # The motion can still be computed, in the unit of the signal.
    assert model.quality.relative == pytest.approx(0.01, rel=0.1)
    assert "beta =" not in str(model)


@pytest.mark.long
def test_a_geophone_of_unknown_gain_leaves_the_friction_undetermined() -> None:
    sensor = Sensor("velocity", gain="free", high_pass=4.5, damping_ratio=0.6)
    truth = {"friction": 0.05 * OMEGA**2 * 2e-3, "omega": OMEGA, "g0": 0.0}
    made = made_signal("coulomb", truth, 2e-3, sensor, 28.8, 0.1, 0.01, np.random.default_rng(2))
    model = fitted(made)
    assert_found(model, {"omega": OMEGA})
    # Friction in m/s^2 needs the size of the motion.
    assert set(model.untold) == {"level", "g0", "size", "friction"}
    # A gain known to 10 % determines friction to 10 %.
    bounded = Sensor("velocity", gain=(26.0, 32.0), high_pass=4.5, damping_ratio=0.6)
    model = fit(made.record, "coulomb", options=FitOptions(measured=bounded))
    low, high = model.intervals["friction"]
    assert low < truth["friction"] < high
    wanted = 4.0 * (32.0 - 26.0) / 29.0 / math.sqrt(12.0)
    assert (high - low) / truth["friction"] == pytest.approx(wanted, rel=0.2)


@pytest.mark.parametrize(("derivative", "kind", "order"), [(0, "low_pass", 1), (1, "high_pass", 2)])
def test_the_computed_sensor_filter_is_exact_between_grid_points(
    derivative: int, kind: str, order: int
) -> None:
    quantity = ("height", "velocity", "acceleration")[derivative]
    given = {kind: 9.0, "damping_ratio": 0.4 if order == 2 else None}
    sensor = Sensor(quantity, **given)  # type: ignore[arg-type]
    step, omega = 1.0 / 64.0, 2.0 * math.pi
    points = step * np.arange(129)
    motion = tuple((omega**k * np.sin(omega * points + 0.5 * math.pi * k))[:, None] for k in range(3))
    sample = np.linspace(0.0, 1.99, 777)
    point = (sample / step).astype(int)
    tables = tabulate_sensor_signal_coefficients(
        sensor, StepGrid(step, 128), sample / step - point, np.zeros(777)
    )
    result = solution_signal(motion, step, point, derivative, tables, np.zeros((order, 1)))
    corner = 2.0 * math.pi * 9.0
    bottom = [1.0, corner] if order == 1 else [1.0, 0.8 * corner, corner**2]
    top = [corner**order] if kind == "low_pass" else [1.0] + [0.0] * order
    times = np.linspace(0.0, 2.0, 60_001)
    seen = omega**derivative * np.sin(omega * times + 0.5 * math.pi * derivative)
    exact = np.interp(sample, times, lsim((top, bottom), seen, times)[1])
    np.testing.assert_allclose(np.asarray(result)[:, 0], exact, atol=3e-6 * omega**derivative)


def test_parameters_that_depend_on_origin_or_unit_of_the_coordinate_are_found() -> None:
    pendulum = law_from_text("z'' + 2*a*z' + k*sin(z) = 0")
    assert find_compensating_parameters(pendulum, "shift") is None
    assert find_compensating_parameters(pendulum, "scale") is None
    spring = law_from_text("z'' + c*Abs(z')*z' + k*(z - r) + b*(z - r)**3 = 0")
    shift, scale = (
        find_compensating_parameters(spring, "shift"),
        find_compensating_parameters(spring, "scale"),
    )
    assert (shift.moving, shift.level) == (("r",), "r")
    assert set(scale.moving) == {"c", "r", "b"}


def test_the_motion_is_computed_for_a_record_without_a_position() -> None:
    time = np.linspace(0.0, 3.0, 3001)
    motion = 2e-3 * np.exp(-0.5 * time) * np.cos(OMEGA * time)
    acceleration = np.gradient(np.gradient(motion, time), time)[1:-1] + 0.1
    record = PistonRecord.from_columns({"time": time[1:-1], "acceleration": acceleration})
    assert record.measured == "acceleration"
    assert "height" not in record.columns
    inner = slice(300, -300)
    assert np.abs(record.height - motion[1:-1])[inner].max() < 0.1 * 2e-3
    assert record.between(0.0, 1.0).measured == "acceleration"


def test_an_acceleration_column_is_fitted_if_the_description_file_requests_it(tmp_path: Path) -> None:
    time = np.linspace(0.0, 2.0, 800)
    rows = np.exp(-LINEAR["lam"] * time) * np.cos(OMEGA * time) + 0.1
    path = tmp_path / "acc.csv"
    np.savetxt(path, np.column_stack([time, rows]), delimiter=",", header="t,ax [g]", comments="")
    with pytest.raises(RecordError, match="acceleration=ax"):
        PistonRecord.from_file(path)
    with pytest.warns(RecordWarning, match="no position"):
        record = PistonRecord.from_file(path, columns={"acceleration": "ax"})
    assert record.measured == "acceleration"
    np.testing.assert_allclose(record.columns["acceleration"], 9.80665 * rows, rtol=1e-12)
    assert [row.name for row in compare(record, "linear").rows] == ["linear"]


def test_a_sensor_is_parsed_from_a_text() -> None:
    geophone = Sensor("velocity", gain=(20.0, 30.0), high_pass=4.5, absolute=True, column="geo")
    assert parse_sensor("velocity gain=20:30 high_pass=4.5 absolute column=geo") == geophone


@pytest.mark.parametrize(
    "further", ["", " gain", " gain=x", " low_pass=1:2", " absolute=1", " low_pass=free"]
)
def test_invalid_sensor_options_are_refused(further: str) -> None:
    with pytest.raises(InputError):
        parse_sensor(f"velocity{further}" if further else "speed")
