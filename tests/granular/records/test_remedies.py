"""Remedies in errors and notes, and the meaning of a column's name, heading or unit."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord
from granular.records.headings import is_derived_from_motion, name_and_unit, split_header_into_name_and_unit
from granular.schema.units import unit_size
from granular.shared.errors import RecordError

from .test_calibration import HEIGHT, TIME, write

MM = 1e3 * HEIGHT


def read(path: Path, **said: Any) -> PistonRecord:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return PistonRecord.from_file(path, **said)


def refusal(path: Path, **said: Any) -> str:
    with pytest.raises(RecordError) as caught:
        read(path, **said)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# Columns ---------------------------------------------------------------------------------------


def test_a_column_of_row_numbers_is_not_taken_as_data(tmp_path: Path) -> None:
    index = np.arange(400)
    said = refusal(write(tmp_path / "a.csv", ",time [s],left [mm],right [mm]", index, TIME, MM, 2.0 * MM))
    assert "height may be 'left' or 'right'" in said
    assert "no column 'height'; found: 'time'" in refusal(write(tmp_path / "b.csv", ",time", index, TIME))
    assert "column 1 counts samples" in refusal(write(tmp_path / "c.csv", ",height [mm]", index, MM))
    filtered = np.delete(index, [3, 4, 90])
    rows = write(tmp_path / "d.csv", ",time [s],x [mm]", filtered, TIME[filtered], MM[filtered])
    assert np.allclose(read(rows).height, HEIGHT[filtered], atol=1e-10)
    headless = write(tmp_path / "e.csv", "", index, MM)  # perhaps one sample per second is meant
    assert np.array_equal(read(headless).time, index)


def test_a_repeated_column_name_with_a_number_in_brackets_selects_one_column(tmp_path: Path) -> None:
    path = write(tmp_path / "lab.csv", "time [s],height [mm],cell,cell", TIME, MM, TIME, 2.0 * TIME)
    assert {"cell (3)", "cell (4)"} <= set(read(path).extra)
    assert np.allclose(read(path, columns={"drive": "cell (4)"}).extra["drive"], 2.0 * TIME)


def test_the_unit_of_a_column_can_be_given_by_its_full_heading(tmp_path: Path) -> None:
    path = write(tmp_path / "lab.csv", "time [s],height [cm]", TIME, MM)
    assert np.allclose(read(path, units={"Height [cm]": "mm"}).height, HEIGHT, atol=1e-10)


@pytest.mark.parametrize("said", ["left [mm]", "LEFT  [mm]", "left", "3"])
def test_a_full_heading_selects_a_column(said: str, tmp_path: Path) -> None:
    path = write(tmp_path / "lab.csv", "time [s],height [mm],left [mm]", TIME, 2.0 * MM, MM)
    found = read(path, columns={"height": said})
    assert np.allclose(found.height, HEIGHT, atol=1e-10)
    assert np.allclose(found.extra["height (2)"], 2.0 * MM)  # which does not replace the other


def test_a_column_with_a_repeated_name_is_selected_by_number_or_heading(tmp_path: Path) -> None:
    head = "time [s],force [N],force [kN],stroke [in],stroke [mm]"
    path = write(tmp_path / "lab.csv", head, TIME, TIME, 2.0 * TIME, TIME, MM)
    for said in ({"stroke": 5, "force": 3}, {"stroke": "stroke [mm]", "force": "force [kN]"}):
        found = read(path, columns=said)
        assert np.allclose(found.height, HEIGHT, atol=1e-10)
        assert np.allclose(found.columns["force"], 2e3 * TIME)
    assert "--columns stroke=4 or --columns stroke=5" in refusal(
        path, columns={"stroke": "stroke", "force": 3}
    )


# Units -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("header", "size"),
    [
        ("Position (x10^-3 m)", 1e-3),
        ("Position (×10⁻³ m)", 1e-3),
        ("Position [1e-6 m]", 1e-6),
        ("Position (x 10-4 m)", 1e-4),
        ("Position (10^-3 mm)", 1e-6),
    ],
)
def test_a_unit_that_follows_a_power_of_ten_in_a_heading_is_read(
    header: str, size: float, tmp_path: Path
) -> None:
    assert split_header_into_name_and_unit(header)[0] == "Position"
    path = write(tmp_path / "lab.csv", f"Time (s),{header}", TIME, HEIGHT / size)
    assert np.allclose(read(path).height, HEIGHT, atol=1e-10)


def test_powers_of_ten_and_days_are_units() -> None:
    assert unit_size("10^-3 m/s") == (1e-3, (1, 0, -1, 0))
    assert unit_size("d")[0] == 86400.0
    assert split_header_into_name_and_unit("x_d") == ("x_d", None)  # a name
    assert split_header_into_name_and_unit("days") == ("time", "days")


def test_the_unit_in_a_channel_label_takes_precedence_over_a_unit_in_its_name() -> None:
    notes: list[str] = []
    assert name_and_unit("Position (Filtered)", "mm", notes) == ("Position (Filtered)", "mm")
    assert name_and_unit("Position (m)", "m", notes) == ("Position", "m")
    assert name_and_unit("Position (mm)", "-", notes) == ("Position", "mm")
    assert not notes
    assert name_and_unit("Position (m)", "mm", notes) == ("Position", "mm")
    assert "'Position (m)' is in mm according to its label (for m: --units Position=m)" in notes[0]


def test_units_in_a_separate_row_take_precedence_over_units_in_the_headings(tmp_path: Path) -> None:
    path = write(tmp_path / "lab.csv", "Time,Position (Filtered)\ns,mm", TIME, MM)
    assert np.allclose(read(path).height, HEIGHT, atol=1e-10)


@pytest.mark.parametrize(
    "row",
    [
        "{t},{z} cm",
        "{t} s;{z} cm",
        "{t}\t{z}cm",
        "{t} s {z} cm",
        "{t} {z} cm",
        "{t} s,{z} cm",
        '"{t} s";"{z} cm"',
    ],
)
@pytest.mark.parametrize("comma", [False, True])
def test_units_that_follow_the_numbers_in_cells_are_read(row: str, comma: bool, tmp_path: Path) -> None:
    mark = next((mark for mark in ";\t," if mark in row), " ")
    if comma and mark == ",":
        pytest.skip("no decimal comma between commas")
    cells = [(f"{t:.4f}", f"{100.0 * z:.8f}") for t, z in zip(TIME, HEIGHT, strict=True)]
    rows = [row.format(t=t, z=z) for t, z in cells]
    rows = [one.replace(".", ",") for one in rows] if comma else rows
    (tmp_path / "lab.txt").write_text("\n".join([f"time{mark}height", *rows, ""]))
    found = read(tmp_path / "lab.txt")
    assert np.allclose(found.time, TIME)
    assert np.allclose(found.height, HEIGHT, atol=1e-9)
    rows[7] = rows[7].replace("cm", "mm")
    (tmp_path / "lab.txt").write_text("\n".join([f"time{mark}height", *rows, ""]))
    assert "line 9 holds a number in 'mm'" in refusal(tmp_path / "lab.txt")


@pytest.mark.parametrize("rows", ["\t", ";", " "])
@pytest.mark.parametrize(
    "head",
    [
        "Time (s)      Position (mm)",
        "Time (s)\tPosition (mm)",
        "Time (s);Position (mm)",
        "Elapsed Time (s) Stage Position (mm)",
    ],
)
def test_a_heading_line_with_another_separator_than_the_rows_is_read(
    head: str, rows: str, tmp_path: Path
) -> None:
    lines = [f"{t:.4f}{rows}{z:.7f}" for t, z in zip(TIME, MM, strict=True)]
    (tmp_path / "lab.dat").write_text("\n".join(["run 3, Ada Byron", head, *lines, ""]))
    assert np.allclose(read(tmp_path / "lab.dat").height, HEIGHT, atol=1e-9)


@pytest.mark.parametrize("units", ["(s)         (mm)", "s           mm", "[s]\t[mm]"])
def test_a_row_of_units_with_another_separator_than_the_numbers_is_read(units: str, tmp_path: Path) -> None:
    lines = [f"{t:.4f};{z:.7f}" for t, z in zip(TIME, MM, strict=True)]
    (tmp_path / "lab.dat").write_text("\n".join(["Time        Position", units, *lines, ""]))
    assert np.allclose(read(tmp_path / "lab.dat").height, HEIGHT, atol=1e-9)


def test_a_title_above_the_rows_is_not_taken_as_column_names(tmp_path: Path) -> None:
    lines = [f"{t:.4f}\t{z:.7f}" for t, z in zip(TIME, HEIGHT, strict=True)]
    (tmp_path / "lab.dat").write_text("\n".join(["Piston height, run 3", *lines, ""]))
    assert np.allclose(read(tmp_path / "lab.dat").height, HEIGHT, atol=1e-6)


def test_a_column_in_decibels_is_not_taken_as_a_length(tmp_path: Path) -> None:
    said = refusal(write(tmp_path / "lab.csv", "time [s],envelope [dBm]", TIME, MM))
    assert "a logarithmic level: write the amplitude" in said
    assert "scale" not in said


# Times -----------------------------------------------------------------------------------------


def test_evenly_spaced_frequencies_or_lengths_are_not_taken_as_times(tmp_path: Path) -> None:
    for head in ("frequency,amplitude [mm]", "x [mm],force [N]", "wavelength [nm],i", "length,force [N]"):
        said = refusal(write(tmp_path / "lab.csv", head, TIME, MM))
        assert "is not a time, as in a spectrum or a curve" in said
        assert "--units time=s" not in said
    days = read(write(tmp_path / "lab.csv", "days,height [mm]", TIME, MM))
    assert np.allclose(days.time, 86400.0 * TIME)


def test_columns_without_names_are_selected_by_number(tmp_path: Path) -> None:
    said = refusal(write(tmp_path / "lab.csv", "", MM, 2.0 * MM, 3.0 * MM))
    assert "columns 1, 2, 3, none with a name" in said
    assert "--columns time=1,height=2" in said


def test_error_for_repeated_times_in_a_record_gives_a_remedy(tmp_path: Path) -> None:
    times = np.floor(1e3 * np.sort(np.random.default_rng(0).uniform(0.0, 2.0, 400))) / 1e3
    path = write(tmp_path / "lab.csv", "time [s],height [mm]", times, MM)
    said = refusal(path)
    assert "--rate '" in said
    assert "--sort" in said
    found = read(path, sort=True)
    assert np.array_equal(found.time, np.unique(times))
    first = int(np.argmax(np.diff(times) == 0.0))
    here = np.flatnonzero(times == times[first])
    assert found.height[np.searchsorted(found.time, times[first])] == pytest.approx(
        HEIGHT[here].mean(), abs=1e-10
    )
    assert np.allclose(read(path, rate="200 Hz").time, TIME)


# Phones ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("quantity", "unit", "role"),
    [("Linear Acceleration", "m/s^2", "acceleration"), ("Gyroscope", "rad/s", "velocity")],
)
def test_of_several_sensor_axes_the_one_that_varies_most_is_proposed_first(
    quantity: str, unit: str, role: str, tmp_path: Path
) -> None:
    head = ",".join(
        ["Time (s)", *(f"{quantity} {axis} ({unit})" for axis in ("x", "y", "z")), f"Absolute ({unit})"]
    )
    said = refusal(write(tmp_path / "a.csv", head, TIME, 0.1 * MM, MM, 0.5 * MM, 2.0 * np.abs(MM)))
    options = [f"--columns '{role}={quantity} {axis}'" for axis in ("y", "z", "x")]
    assert (
        f"{options[0]}, which varies most, or {options[1]} or {options[2]} or --columns {role}=Absolute"
        in said
    )


# Other files and objects -----------------------------------------------------------------------


class Unit(str):
    """Substitute for a unit of pint, with its short name in the format ``~``."""

    def __format__(self, spec: str) -> str:
        return str(self) if spec == "~" else "millimeter"


class Quantity:
    """Substitute for a quantity of pint, with magnitude and units."""

    def __init__(self, magnitude: Any, unit: str) -> None:
        self.magnitude, self.units = magnitude, Unit(unit)

    def __array__(self, *_: Any, **__: Any) -> np.ndarray:
        return np.asarray(self.magnitude)


def test_pint_quantities_in_memory_are_converted_by_their_units() -> None:
    table = {"time": Quantity(1e3 * TIME, "ms"), "height": Quantity(MM, "mm")}
    for found in (PistonRecord.from_table(table), PistonRecord(**table)):  # type: ignore[arg-type]
        assert np.allclose(found.time, TIME)
        assert np.allclose(found.height, HEIGHT)
    with pytest.raises(RecordError, match="'kg' does not fit; a unit like m is needed"):
        PistonRecord(TIME, Quantity(MM, "kg"))  # type: ignore[arg-type]


class Polars:
    """Substitute for a polars DataFrame, with names as ``columns`` and series by name."""

    columns = ("time [ms]", "height [mm]")

    def __getitem__(self, name: str) -> np.ndarray:
        return {"time [ms]": 1e3 * TIME, "height [mm]": MM}[name]


def test_records_are_made_from_polars_pyarrow_and_numpy_tables() -> None:
    pyarrow = pytest.importorskip("pyarrow")
    structured = np.zeros(400, dtype=[("time", float), ("height [mm]", float)])
    structured["time"], structured["height [mm]"] = TIME, MM
    for table in (Polars(), pyarrow.table({"time": TIME, "height [mm]": MM}), structured):
        found = PistonRecord.from_table(table)
        assert np.allclose(found.time, TIME)
        assert np.allclose(found.height, HEIGHT)
    with pytest.raises(RecordError, match="'list' is not a table"):
        PistonRecord.from_table([1.0, 2.0])


def test_columns_derived_from_the_motion_are_not_taken_as_external_drives() -> None:
    motions = ("K", "kinetic energy (J)", "px", "y", "vx", "omega", "frame", "Gyroscope z")
    drives = ("u", "force", "load cell", "valve", "temperature", "base_height", "lam")
    assert [*filter(is_derived_from_motion, motions + drives)] == [*motions]
