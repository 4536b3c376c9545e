"""Calibration of a sensor, sampling rates, misleading headings, and description files of records."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from granular import PistonRecord
from granular.records.calibration import Calibration, parse_calibration
from granular.records.options import read_described_path_and_options, write_record_description
from granular.shared.errors import RecordError

TIME = np.arange(400) / 200.0
HEIGHT = 0.01 * np.exp(-0.5 * TIME) * np.cos(25.0 * TIME)


def write(path: Path, head: str | None, *columns: np.ndarray, separator: str = ",") -> Path:
    """Write columns below a heading, and return the path."""
    rows = [separator.join(f"{value:.15g}" for value in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([*([head] if head else []), *rows]) + "\n", encoding="utf-8")
    return path


def scaled(text: str, zero: str | None = None, role: str = "height") -> Calibration:
    """Return a calibration by a scale and a zero."""
    return parse_calibration(role, {"scale": text} | ({} if zero is None else {"zero": zero}))


@pytest.mark.parametrize(
    ("text", "factor", "uncertainty", "unit", "raw_unit"),
    [
        ("2.4894 mm/V", 2.4894e-3, 0.0, "m", "V"),
        ("2.4894 +- 0.003 mm/V", 2.4894e-3, 0.003 / 2.4894, "m", "V"),
        ("2 ± 0.1 mm/V", 2e-3, 0.05, "m", "V"),
        ("2 +- 5 % mm/V", 2e-3, 0.05, "m", "V"),
        ("360 deg/2048 counts", 2.0 * np.pi / 2048.0, 0.0, "rad", "counts"),
        ("-0.5 um/px", -5e-7, 0.0, "m", "px"),
        ("1 in / 10 mV", 2.54e-3, 0.0, "m", "mV"),
    ],
)
def test_sensor_scales_with_units_are_parsed(
    text: str, factor: float, uncertainty: float, unit: str, raw_unit: str
) -> None:
    scale = scaled(text)
    assert scale.coefficients == pytest.approx([0.0, factor], rel=1e-14)
    spread = np.abs(scale.deviations).sum(axis=0)
    assert spread == pytest.approx([0.0, uncertainty * abs(factor)], rel=1e-12)
    assert (scale.unit, scale.raw_unit) == (unit, raw_unit)


@pytest.mark.parametrize(
    ("role", "text", "factor"),
    [
        ("force", "100 N/V", 100.0),
        ("force", "10 lb/V", 44.482216152605),
        ("acceleration", "2 g/V", 2.0 * 9.80665),
        ("acceleration", "5 m/s^2/V", 5.0),
        ("velocity", "2 mm/s / mV", 2e-3),
        ("current", "3 mA/V", 3e-3),
    ],
)
def test_sensor_scales_of_columns_other_than_the_height_are_parsed(
    role: str, text: str, factor: float
) -> None:
    assert scaled(text, role=role).coefficients[1] == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize("text", ["", "2.5", "mm/V", "2.5 kg/V", "0 mm/V", "2.5 mm", "x" * 200])
def test_invalid_sensor_scales_are_refused(text: str) -> None:
    with pytest.raises(RecordError, match="scale = "):
        scaled(text)


@given(st.floats(1e-3, 1e3), st.floats(-1e3, 1e3))
def test_calibration_followed_by_its_inverse_gives_the_original_values(size: float, zero: float) -> None:
    raw = HEIGHT / (size * 1e-3) + zero
    heights, deviations = scaled(f"{size!r} mm/V", f"{zero!r} V").apply(raw, "V")
    assert np.abs(heights - HEIGHT).max() <= 1e-12 * (1.0 + abs(zero) * size)
    assert not len(deviations)


def test_sensor_zero_and_heading_may_be_in_mv_if_the_scale_is_per_volt() -> None:
    heights, _ = scaled("2 mm/V", "500 mV").apply(np.array([1500.0]), "mV")
    assert heights == pytest.approx([2e-3])
    with pytest.raises(RecordError, match="heading is in 'mm'"):
        scaled("2 mm/V").apply(np.array([1.0]), "mm")
    with pytest.raises(RecordError, match="zero is in 'counts'"):
        scaled("2 mm/V", "3 counts")


def test_uncertainties_of_scale_and_zero_of_a_sensor_are_independent() -> None:
    raw = np.array([2.0, 3.0])
    _, deviations = scaled("2 +- 0.1 mm/V", "1 +- 0.5 V").apply(raw, "V")
    assert deviations == pytest.approx(np.array([[1e-4, 2e-4], [-1e-3, -1e-3]]))


def test_coefficients_define_a_polynomial_calibration() -> None:
    texts = ["1 mm", "2 +- 0.1 mm/V", "0.5 mm/V^2"]
    heights, deviations = parse_calibration("height", {"coefficients": texts}).apply(np.array([2.0]), "V")
    assert heights == pytest.approx([7e-3])
    assert deviations == pytest.approx(np.array([[2e-4]]))
    for wrong in (["1 mm", "2 mm"], ["1 mm/V"], ["1 mm", "2 mm/V", "1 mm/V"], ["1 s"], []):
        with pytest.raises(RecordError, match="coefficients"):
            parse_calibration("height", {"coefficients": wrong})


def test_the_uncertainty_of_a_calibration_line_matches_its_error() -> None:
    """Over many simulated calibrations, the error of the fitted line agrees with its stated uncertainty."""
    random = np.random.default_rng(5)
    raw, at, errors, claimed = np.linspace(-2.0, 7.0, 8), np.array([6.0]), [], []
    for _ in range(300):
        value = 2.5 * (raw - 2.5) + random.normal(0.0, 0.02, 8)
        points = {"raw": raw, "value": value, "uncertainty": np.full(8, 0.02)}
        points["units"] = {"raw": "V", "value": "mm"}
        height, deviations = parse_calibration("height", {"points": points}).apply(at, "V")
        errors.append(float(height[0]) - 2.5e-3 * 3.5)
        claimed.append(float(np.sqrt((deviations**2).sum())))
    assert np.std(errors) == pytest.approx(2e-5 * np.sqrt(1 / 8 + 3.5**2 / 69.4), rel=0.1)
    assert np.mean(claimed) == pytest.approx(np.std(errors), rel=0.2)


def test_calibration_points_are_read_from_a_file_named_in_the_description_file(tmp_path: Path) -> None:
    write(tmp_path / "lvdt.csv", "time [s],lvdt [V]", TIME, HEIGHT / 2.5e-3 + 2.5)
    volts = np.linspace(-2.0, 4.0, 6)
    write(tmp_path / "points.csv", "raw [V],value [mm]", volts, 2.5 * (volts - 2.5))
    text = 'file = "lvdt.csv"\n[calibration]\npoints = "points.csv"\ndegree = 2\n'
    (tmp_path / "record.toml").write_text(text, encoding="utf-8")
    with pytest.warns(UserWarning, match="beyond the calibration points"):
        record = PistonRecord.from_file(tmp_path / "record.toml")
    assert np.abs(record.height - HEIGHT).max() < 1e-12
    options = read_described_path_and_options(tmp_path / "record.toml")[1]
    (tmp_path / "other").mkdir()
    again = tmp_path / "other" / "again.toml"
    write_record_description(again, tmp_path / "lvdt.csv", options)
    with pytest.warns(UserWarning, match="beyond the calibration points"):
        assert np.array_equal(PistonRecord.from_file(again).height, record.height)


def test_error_does_not_show_contents_of_a_calibration_file_outside_the_folder_of_the_description(
    tmp_path: Path,
) -> None:
    (tmp_path / "secret.csv").write_text("word,is\nxyzzy,here\n", encoding="utf-8")
    home = tmp_path / "home"
    home.mkdir()
    write(home / "a.csv", "time [s],lvdt [V]", TIME, HEIGHT)
    text = 'file = "a.csv"\n[calibration]\npoints = "../secret.csv"\n'
    (home / "record.toml").write_text(text, encoding="utf-8")
    with pytest.raises(RecordError, match="details are withheld") as caught:
        PistonRecord.from_file(home / "record.toml")
    assert "xyzzy" not in str(caught.value)


def test_several_columns_of_a_record_can_have_separate_calibrations(tmp_path: Path) -> None:
    force = np.sin(TIME)
    columns = (HEIGHT / 2.5e-3 + 2.5, 10.0 * force, 1e3 * HEIGHT)
    path = write(tmp_path / "a.csv", "time [s],lvdt [V],cell [mV],base [mm]", TIME, *columns)
    record = PistonRecord.from_file(
        path,
        columns={"force": "cell", "base_height": "base"},
        scale={"lvdt": "2.5 mm/V", "force": "100 +- 1 N/V"},
        zero={"height": "2.5 V"},
    )
    assert np.abs(record.height - HEIGHT).max() < 1e-14
    assert record.force is not None
    assert np.abs(record.force - force).max() < 1e-14
    assert np.abs(record.extra["base_height"] - HEIGHT).max() < 1e-15
    assert record.deviations["force"] == pytest.approx(0.01 * force[None], abs=1e-15)
    with pytest.raises(RecordError, match="unknown column 'lvtd'; did you mean 'lvdt'"):
        PistonRecord.from_file(path, scale={"lvtd": "2.5 mm/V"})
    with pytest.raises(RecordError, match="zero of 'force' is given without scale"):
        PistonRecord.from_file(path, zero={"force": "1 V"})


def test_columns_of_a_record_other_than_the_motion_are_converted_to_si_units(tmp_path: Path) -> None:
    head = "time [s],height [mm],acc [g],table [mm/s^2],valve [mA]"
    path = write(tmp_path / "a.csv", head, TIME, 1e3 * HEIGHT, HEIGHT, HEIGHT, HEIGHT)
    said = {"acceleration": "acc", "base_acceleration": "table", "current": "valve"}
    record = PistonRecord.from_file(path, columns=said)
    for name, size in (("acceleration", 9.80665), ("base_acceleration", 1e-3), ("current", 1e-3)):
        assert record.extra[name] == pytest.approx(size * HEIGHT, rel=1e-12), name
    with pytest.raises(RecordError, match="did you mean 'acceleration'"):
        PistonRecord.from_file(path, columns={"acelleration": "acc"})


def test_uncertainties_stay_with_their_samples_if_a_record_is_sorted_and_cut(tmp_path: Path) -> None:
    raw = HEIGHT / 2.5e-3 + 2.5
    raw[7] = np.nan
    order = np.random.default_rng(3).permutation(len(TIME))
    path = write(tmp_path / "a.csv", "time [s],lvdt [V]", TIME[order], raw[order])
    with pytest.warns(UserWarning, match="are dropped"):
        record = PistonRecord.from_file(
            path, scale="2.5 +- 0.1 mm/V", zero="2.5 V", sort=True, between=(0.1, 1.0)
        )
    assert len(record) == 181
    assert np.abs(record.deviations["height"] - 0.04 * record.height).max() < 1e-15
    assert np.abs(record.first(9).deviations["height"] - 0.04 * record.height[:9]).max() < 1e-15


def test_a_measured_voltage_is_converted_to_a_height(tmp_path: Path) -> None:
    path = write(tmp_path / "lvdt.csv", "time [s],lvdt [V]", TIME, HEIGHT / 2.5e-3 + 2.5)
    record = PistonRecord.from_file(path, scale="2.5 mm/V", zero="2.5 V")
    assert np.abs(record.height - HEIGHT).max() < 1e-14
    with pytest.raises(RecordError, match=r"--scale '2.5 mm/V'"):
        PistonRecord.from_file(path)
    described = tmp_path / "record.toml"
    described.write_text('file = "lvdt.csv"\nscale = "2.5 mm/V"\nzero = "2500 mV"\n', "utf-8")
    assert np.abs(PistonRecord.from_file(described).height - HEIGHT).max() < 1e-14


def test_measured_counts_are_converted_to_an_angle(tmp_path: Path) -> None:
    path = write(tmp_path / "encoder.csv", "time [s],encoder [counts]", TIME, HEIGHT * 1e5)
    record = PistonRecord.from_file(path, scale="360 deg/2048 counts")
    assert record.coordinate_unit == "rad"
    assert np.allclose(record.height, HEIGHT * 1e5 * 2.0 * np.pi / 2048.0, rtol=1e-13)


def test_times_of_a_record_are_computed_from_a_given_sampling_rate(tmp_path: Path) -> None:
    path = write(tmp_path / "values.csv", "height [mm]", 1e3 * HEIGHT)
    record = PistonRecord.from_file(path, rate="200 Hz")
    assert np.allclose(record.time, TIME)
    assert np.allclose(record.height, HEIGHT)
    with pytest.raises(RecordError, match="rate = 0 Hz"):
        PistonRecord.from_file(path, rate=0.0)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_an_evenly_spaced_column_is_taken_as_time(tmp_path: Path) -> None:
    rising = np.linspace(1.0, 2.0, len(TIME)) ** 2
    record = PistonRecord.from_file(write(tmp_path / "a.csv", None, rising, TIME))
    assert np.allclose(record.time, TIME)
    assert np.allclose(record.height, rising)


def test_a_velocity_column_that_disagrees_with_the_derivative_of_the_height_is_noted(tmp_path: Path) -> None:
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
def test_records_are_made_from_pandas_series_and_their_index() -> None:
    pandas = pytest.importorskip("pandas")
    series = pandas.Series(HEIGHT, index=pandas.to_timedelta(TIME, unit="s"))
    assert np.allclose(PistonRecord.from_table(series).time, TIME)
    frame = pandas.DataFrame({"height": HEIGHT}, index=pandas.to_timedelta(TIME, unit="s"))
    assert np.allclose(PistonRecord.from_table(frame).height, HEIGHT)
    assert np.allclose(PistonRecord.from_table(pandas.Series(HEIGHT, index=TIME)).time, TIME)


TABLE = "time [s],height [mm]\n0,1\n1,2\n"
SECRETS = ("root:x:0:0:root:/root:/bin/bash\n", "secret a b\n1 2 3\n4 5 6\n", "time,height\n0,key\n")


def described(folder: Path, name: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "record.toml").write_text(f"file = '{name}'\n")
    return folder / "record.toml"


@pytest.mark.parametrize("text", SECRETS)
def test_error_does_not_show_contents_of_a_record_file_outside_the_folder_of_the_description(
    text: str, tmp_path: Path
) -> None:
    away, here = tmp_path / "secret.csv", tmp_path / "here"
    away.write_text(text)
    for name in (str(away), "../secret.csv", "linked.csv"):
        description = described(here, name)
        if name == "linked.csv":
            (here / name).symlink_to(away)
        with pytest.raises(RecordError, match="outside the description's folder") as caught:
            PistonRecord.from_file(description)
        words = str(caught.value).replace(str(tmp_path), "").replace("secret.csv", "")
        assert not {"root", "secret", "'a'", "key"} & set(words.replace("'", " ").split())
        assert "/bin/bash" not in words


def test_a_record_file_outside_the_folder_of_its_description_is_read(tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text(TABLE)
    record = PistonRecord.from_file(described(tmp_path / "out", "../lab.csv"))
    assert record.height.tolist() == [1e-3, 2e-3]


def test_error_in_a_record_file_inside_the_folder_of_the_description_shows_the_wrong_value(
    tmp_path: Path,
) -> None:
    (tmp_path / "lab.csv").write_text(TABLE.replace("2\n", "two\n"))
    with pytest.raises(RecordError, match=r"height of sample 1 \(line 3\) is 'two'"):
        PistonRecord.from_file(described(tmp_path, "lab.csv"))
    for name in ("none.csv", "../none.csv", "a" * 5000):
        with pytest.raises(RecordError, match=r"does not exist|cannot be read"):
            PistonRecord.from_file(described(tmp_path, name))
