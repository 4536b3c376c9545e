"""Records in the formats of instruments. Each format gives the same motion, and identification succeeds."""

import math
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from granular import PistonRecord
from granular.shared.errors import RecordError

from .forms import FORCE, FORMS, HEIGHT, REFUSED, TIME, in_memory

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("name", FORMS)
def test_the_same_motion_is_read_from_files_of_each_instrument_format(name: str, tmp_path: Path) -> None:
    form = FORMS[name]
    form.write(tmp_path / form.name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        record = PistonRecord.from_file(tmp_path / form.name, **form.said)
    time = record.time - record.time[0]
    expected = form.scale * np.interp(time, TIME, HEIGHT)
    assert len(record) >= len(TIME) - 4
    assert np.abs(time - np.round(time, 2)).max() < 1e-6
    assert np.abs(record.height - expected).max() <= form.places
    if record.force is not None:
        assert np.abs(record.force - np.interp(time, TIME, FORCE)).max() < 1e-4


def test_two_thirds_of_the_instrument_formats_cite_a_public_source() -> None:
    """The guide lists all formats that are read or refused; a source is a web address."""
    pages = ROOT / "docs" / "guide"
    guide = (ROOT / "docs" / "reference" / "laboratory-forms.md").read_text(encoding="utf-8")
    tables = guide.split("| --- | --- | --- |\n")[1:]
    read, refused = (table.partition("\n\n")[0].splitlines() for table in tables)
    print(f"{len(FORMS)} read, {len(REFUSED)} refused")
    assert (len(read), len(refused)) == (len(FORMS), len(REFUSED))
    assert len(FORMS) >= 45
    cited = [row for row in (*read, *refused) if re.search(r"\]\(https?://[\w.-]+\.[a-z]+/\S*\) \|$", row)]
    assert 3 * len(cited) >= 2 * len(read + refused)
    assert f"lists {len(FORMS)} forms" in (pages / "laboratory-record.md").read_text("utf-8")


@pytest.mark.parametrize("name", REFUSED)
def test_files_of_unsupported_instrument_formats_are_refused_in_one_line(name: str, tmp_path: Path) -> None:
    refused = REFUSED[name]
    path = tmp_path / refused.name
    path.write_bytes(refused.content)
    with pytest.raises(RecordError, match=refused.words) as caught:
        PistonRecord.from_file(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", in_memory())
def test_tables_in_memory_give_the_same_motion(name: str) -> None:
    record = PistonRecord.from_table(in_memory()[name])
    assert np.abs(record.height - HEIGHT).max() < 1e-15
    assert np.abs(record.time - TIME).max() < 1e-15


def test_assumptions_made_while_reading_a_record_are_reported_in_warnings(tmp_path: Path) -> None:
    said = {
        "no_header": "column 1 is taken as the time, in s.*height is column 2",
        "depth": "height is the column 'depth', the only other numeric column",
        "gaps": r"3 of 80 samples have no time or height .* sample 7 \(line 9\) and others",
        "ticks": "times are rounded to 0.05 s",
        "footer": "line 82, the last, is not a row of the table",
        "tracker": "",
    }
    for name, words in said.items():
        form = FORMS[name]
        form.write(tmp_path / form.name)
        if not words:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                PistonRecord.from_file(tmp_path / form.name, **form.said)
            continue
        with pytest.warns(UserWarning, match=words):
            PistonRecord.from_file(tmp_path / form.name, **form.said)


def test_angles_of_a_record_are_read_in_radians_and_written_back_unchanged(tmp_path: Path) -> None:
    FORMS["degrees"].write(tmp_path / "degrees.csv")
    record = PistonRecord.from_file(tmp_path / "degrees.csv")
    assert record.coordinate_unit == "rad"
    assert record.units["height"] == "rad"
    record.between(0.1, 0.5).to_csv(tmp_path / "back.csv")
    assert "height [rad]" in (tmp_path / "back.csv").read_text()
    back = PistonRecord.from_file(tmp_path / "back.csv")
    assert back.coordinate_unit == "rad"
    assert np.array_equal(back.height, record.between(0.1, 0.5).height)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"columns": {"heigth": "z"}}, "did you mean 'height'"),
        ({"columns": {"height": "depht"}}, "unknown column 'depht'; did you mean 'depth'"),
        ({"columns": {"height": 7}}, "column 7 does not exist; give one from 1 to 2"),
        ({"columns": {"height": True}}, "give a name or a number"),
        ({"units": {"hight": "mm"}}, "unknown column 'hight'; did you mean 'height'"),
        ({"units": {"height": "kg"}}, "the unit 'kg' does not fit"),
        ({"decimal": ";"}, "decimal = ';' is not valid; give '.' or ','"),
        ({"skip": -1}, "give a number of lines"),
        ({"between": (2.0, 1.0)}, "give the earlier time first"),
        ({"between": (70.0, 80.0)}, "0 samples"),
        ({"skip": 1000}, "is empty"),
    ],
)
def test_contradictory_options_for_reading_a_record_are_refused_with_a_reason(
    said: dict[str, Any], words: str, tmp_path: Path
) -> None:
    FORMS["depth"].write(tmp_path / "depth.csv")
    with pytest.raises(RecordError, match=words) as caught:
        PistonRecord.from_file(tmp_path / "depth.csv", **said)
    assert "\n" not in str(caught.value)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    separator=st.sampled_from(";\t|"),
    decimal=st.sampled_from(".,"),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
    header=st.sampled_from(["Zeit [s]{}Höhe [mm]", "t{}z/mm", "time_s{}height_mm", "Time (sec){}Pos (mm)"]),
    steps=st.lists(st.integers(1, 10**6), min_size=2, max_size=20),
    data=st.data(),
)
def test_numbers_are_read_exactly_with_any_separator_decimal_mark_and_line_end(
    tmp_path: Path,
    separator: str,
    decimal: str,
    end: str,
    encoding: str,
    header: str,
    steps: list[int],
    data: st.DataObject,
) -> None:
    time = np.cumsum(steps) * 1e-3
    height = data.draw(st.lists(st.floats(-1e6, 1e6), min_size=len(time), max_size=len(time)))
    rows = [
        f"{t!r}{separator}{z!r}".replace(".", decimal) for t, z in zip(time.tolist(), height, strict=True)
    ]
    text = end.join([header.format(separator), *rows, ""])
    (tmp_path / "any.txt").write_bytes(text.encode(encoding))
    record = PistonRecord.from_file(tmp_path / "any.txt")
    assert np.array_equal(record.time, time)
    assert np.array_equal(record.height, np.array(height) * 1e-3)


AT_ONCE = (
    "excel_german",
    "excel_unicode",
    "savetxt",
    "campbell",
    "phyphox",
    "labview",
    "tdms",
    "excel",
    "matlab",
    "logger_pro",
    "matlab_73",
    "universal",
    "mdf",
)
OMEGA = math.hypot(21.0, 0.8)
"""Of the motion in all files [rad/s]: it swings at 21 and decays at 0.8 1/s."""
TRUTH = {
    "equilibrium": (59.0, "mm"),
    "natural frequency": (OMEGA / (2.0 * math.pi), "Hz"),
    "damping ratio": (100.0 * 0.8 / OMEGA, "%"),
}


def test_ten_instrument_formats_are_read_without_options() -> None:
    assert len(AT_ONCE) >= 10
    assert not any(FORMS[name].said for name in AT_ONCE)


@pytest.mark.long
@pytest.mark.parametrize("name", AT_ONCE)
def test_printed_confidence_intervals_for_each_instrument_format_contain_the_true_parameters(
    name: str, command: Callable, tmp_path: Path
) -> None:
    path = tmp_path / FORMS[name].name
    FORMS[name].write(path)
    done = command("reduced_models", "identify", str(path), "-o", str(tmp_path / "out"), "--quiet")
    assert done.returncode == 0, done.stderr
    for quantity, (true, unit) in TRUTH.items():
        row = rf"  {quantity} +\w+ +(\S+)(?: ± (\S+))? {unit}"
        found = re.search(row, done.stdout)
        assert found is not None, quantity
        value, error = float(found[1]), float(found[2] or 0.0)
        rounding = 10.0 ** -len(found[1].partition(".")[2])
        assert abs(value - true) <= error + rounding, (quantity, found[0], true)
    assert (tmp_path / "out" / "report.html").is_file()
