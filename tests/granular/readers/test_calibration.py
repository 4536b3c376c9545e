"""Calibration of a sensor, a sampling rate, and headings that are not what they seem."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from granular import PistonRecord
from granular.readers.calibration import calibrate_column, parse_scale
from granular.shared.errors import RecordError

TIME = np.arange(400) / 200.0
HEIGHT = 0.01 * np.exp(-0.5 * TIME) * np.cos(25.0 * TIME)


def write(path: Path, head: str | None, *columns: np.ndarray, separator: str = ",") -> Path:
    """Write columns below a heading."""
    rows = [separator.join(f"{value:.15g}" for value in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([*([head] if head else []), *rows]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "factor", "uncertainty", "angle", "unit"),
    [
        ("2.4894 mm/V", 2.4894e-3, 0.0, False, "V"),
        ("2.4894 +- 0.003 mm/V", 2.4894e-3, 0.003 / 2.4894, False, "V"),
        ("2 ± 0.1 mm/V", 2e-3, 0.05, False, "V"),
        ("360 deg/2048 counts", 2.0 * np.pi / 2048.0, 0.0, True, "counts"),
        ("-0.5 um/px", -5e-7, 0.0, False, "px"),
        ("1 in / 10 mV", 2.54e-3, 0.0, False, "mV"),
    ],
)
def test_scales(text: str, factor: float, uncertainty: float, angle: bool, unit: str) -> None:
    scale = parse_scale(text)
    assert scale.factor == pytest.approx(factor, rel=1e-14)
    assert scale.uncertainty == pytest.approx(uncertainty, rel=1e-12)
    assert (scale.angle, scale.unit) == (angle, unit)


@pytest.mark.parametrize("text", ["", "2.5", "mm/V", "2.5 kg/V", "0 mm/V", "2.5 mm", "x" * 200])
def test_what_is_no_scale_is_refused(text: str) -> None:
    with pytest.raises(RecordError, match="scale = "):
        parse_scale(text)


@given(st.floats(1e-3, 1e3), st.floats(-1e3, 1e3))
def test_a_calibration_is_undone(size: float, zero: float) -> None:
    raw = HEIGHT / (size * 1e-3) + zero
    heights = calibrate_column(raw, "V", parse_scale(f"{size!r} mm/V"), f"{zero!r} V")
    assert np.abs(heights - HEIGHT).max() <= 1e-12 * (1.0 + abs(zero) * size)


def test_zero_and_heading_may_have_another_prefix() -> None:
    scale = parse_scale("2 mm/V")
    assert calibrate_column(np.array([1500.0]), "mV", scale, "500 mV") == pytest.approx([2e-3])
    with pytest.raises(RecordError, match="heading is in 'mm'"):
        calibrate_column(np.array([1.0]), "mm", scale, None)
    with pytest.raises(RecordError, match="zero is in 'counts'"):
        calibrate_column(np.array([1.0]), "V", scale, "3 counts")


def test_a_voltage_becomes_a_height(tmp_path: Path) -> None:
    path = write(tmp_path / "lvdt.csv", "time [s],lvdt [V]", TIME, HEIGHT / 2.5e-3 + 2.5)
    record = PistonRecord.from_file(path, scale="2.5 mm/V", zero="2.5 V")
    assert np.abs(record.height - HEIGHT).max() < 1e-14
    with pytest.raises(RecordError, match=r"scale: '2.5 mm/V'"):
        PistonRecord.from_file(path)
    described = tmp_path / "record.toml"
    described.write_text('file = "lvdt.csv"\nscale = "2.5 mm/V"\nzero = "2500 mV"\n', "utf-8")
    assert np.abs(PistonRecord.from_file(described).height - HEIGHT).max() < 1e-14


def test_counts_become_an_angle(tmp_path: Path) -> None:
    path = write(tmp_path / "encoder.csv", "time [s],encoder [counts]", TIME, HEIGHT * 1e5)
    record = PistonRecord.from_file(path, scale="360 deg/2048 counts")
    assert record.angle
    assert np.allclose(record.height, HEIGHT * 1e5 * 2.0 * np.pi / 2048.0, rtol=1e-13)


def test_a_rate_stands_for_the_times(tmp_path: Path) -> None:
    path = write(tmp_path / "values.csv", "height [mm]", 1e3 * HEIGHT)
    record = PistonRecord.from_file(path, rate="200 Hz")
    assert np.allclose(record.time, TIME)
    assert np.allclose(record.height, HEIGHT)
    with pytest.raises(RecordError, match="rate = 0 Hz"):
        PistonRecord.from_file(path, rate=0.0)


def test_rows_are_sorted_where_asked(tmp_path: Path) -> None:
    order = np.random.default_rng(1).permutation(len(TIME))
    path = write(tmp_path / "shuffled.csv", "time [s],height [m]", TIME[order], HEIGHT[order])
    assert np.allclose(PistonRecord.from_file(path, sort=True).height, HEIGHT)


@pytest.mark.parametrize(
    ("head", "time", "height"),
    [
        ("t / s;s / mm", TIME, 1e3 * HEIGHT),
        ("t / ms;s / mm", 1e3 * TIME, 1e3 * HEIGHT),
        ("$t_{1}$;$z_{1}$ [mm]", TIME, 1e3 * HEIGHT),
        ("Zeit in s;Auslenkung in mm", TIME, 1e3 * HEIGHT),
        ("temps (s);déplacement (mm)", TIME, 1e3 * HEIGHT),
        ("tiempo [s];desplazamiento [mm]", TIME, 1e3 * HEIGHT),
        ("time;height [mm]", 1.6e12 + 1e3 * TIME, 1e3 * HEIGHT),
        ("timestamp;height [mm]", 1.6e9 + TIME, 1e3 * HEIGHT),
        ("time [s];displacement (mil)", TIME, HEIGHT / 2.54e-5),
    ],
)
@pytest.mark.filterwarnings("ignore::granular.shared.errors.RecordWarning")
def test_headings_of_engineers(
    tmp_path: Path, head: str, time: np.ndarray, height: np.ndarray
) -> None:
    record = PistonRecord.from_file(write(tmp_path / "a.csv", head, time, height, separator=";"))
    assert np.allclose(record.time - record.time[0], TIME, atol=1e-6)
    assert np.allclose(record.height, HEIGHT, atol=1e-12)


@pytest.mark.parametrize("head", ["time,control voltage", "time [s],gyro [rad/s]", "time,omega"])
def test_what_is_no_position_is_never_taken_for_one(tmp_path: Path, head: str) -> None:
    with pytest.raises(RecordError, match="no column 'height'"):
        PistonRecord.from_file(write(tmp_path / "a.csv", head, TIME, HEIGHT))


@pytest.mark.parametrize(("size", "unit"), [(5600.0, "deg"), (50.0, "rad")])
def test_an_angle_without_a_unit_is_told_by_its_size(
    tmp_path: Path, size: float, unit: str
) -> None:
    path = write(tmp_path / "a.csv", "time,theta", TIME, size * HEIGHT)
    with pytest.warns(UserWarning, match=f"an angle in {unit}"):
        record = PistonRecord.from_file(path)
    assert record.angle
    assert np.allclose(record.height, np.radians(size * HEIGHT) if unit == "deg" else size * HEIGHT)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_regular_steps_make_the_time(tmp_path: Path) -> None:
    rising = np.linspace(1.0, 2.0, len(TIME)) ** 2
    record = PistonRecord.from_file(write(tmp_path / "a.csv", None, rising, TIME))
    assert np.allclose(record.time, TIME)
    assert np.allclose(record.height, rising)


def test_a_velocity_that_is_none_is_said(tmp_path: Path) -> None:
    noise = np.random.default_rng(2).normal(size=len(TIME))
    path = write(tmp_path / "a.csv", "time [s],height [m],velocity [m/s]", TIME, HEIGHT, noise)
    with pytest.warns(UserWarning, match="does not follow the slope"):
        assert PistonRecord.from_file(path).velocity is not None
    true = np.gradient(HEIGHT, TIME)
    path = write(tmp_path / "b.csv", "time [s],height [m],velocity [m/s]", TIME, HEIGHT, true)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        PistonRecord.from_file(path)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_series_and_indices_of_pandas_are_records() -> None:
    pandas = pytest.importorskip("pandas")
    series = pandas.Series(HEIGHT, index=pandas.to_timedelta(TIME, unit="s"))
    assert np.allclose(PistonRecord.from_table(series).time, TIME)
    frame = pandas.DataFrame({"height": HEIGHT}, index=pandas.to_timedelta(TIME, unit="s"))
    assert np.allclose(PistonRecord.from_table(frame).height, HEIGHT)
    assert np.allclose(PistonRecord.from_table(pandas.Series(HEIGHT, index=TIME)).time, TIME)
