"""Piston records: to CSV and back, and clear errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from granular import PistonRecord
from granular.errors import RecordError

FINITE = st.floats(-1e300, 1e300, allow_nan=False)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    steps=arrays(float, st.integers(1, 30), elements=st.floats(1e-6, 1e3)),
    data=st.data(),
    velocity=st.booleans(),
)
def test_csv_round_trip(
    tmp_path: Path, steps: np.ndarray, data: st.DataObject, velocity: bool
) -> None:
    time = np.concatenate([[0.0], np.cumsum(steps)])
    column = arrays(float, len(time), elements=FINITE)
    record = PistonRecord(
        time,
        data.draw(column),
        velocity=data.draw(column) if velocity else None,
        extra={"temperature": data.draw(column)},
    )
    record.to_csv(tmp_path / "record.csv")
    back = PistonRecord.from_csv(tmp_path / "record.csv")
    assert np.array_equal(back.time, record.time)
    assert np.array_equal(back.height, record.height)
    assert (back.velocity is None) == (record.velocity is None)
    assert np.array_equal(back.extra["temperature"], record.extra["temperature"])


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_units_from_header_and_argument(tmp_path: Path) -> None:
    path = write(
        tmp_path / "lab.csv", "# lab 3\ntime [ms];height (mm);velocity\n0;59;0\n2;60;0.5\n"
    )
    record = PistonRecord.from_csv(path)
    assert record.time.tolist() == [0.0, 0.002]
    assert record.height.tolist() == pytest.approx([0.059, 0.060])
    assert record.velocity.tolist() == [0.0, 0.5]
    given_units = PistonRecord.from_csv(path, units={"height": "cm"})
    assert given_units.height.tolist() == pytest.approx([0.59, 0.60])


BAD = [
    ("", "is empty"),
    ("time,height\n", "0 samples"),
    ("time,height\n0,1\n", "1 samples"),
    ("time,depth\n0,1\n1,2\n", "no column 'height'"),
    ("0,1\n1,2\n", "no column 'time'"),
    ("time,height,height\n0,1,2\n1,2,3\n", "'height' is there twice"),
    ("time,height\n0,1\n1,two\n", "height of sample 1 is 'two', not a number"),
    ("time,height\n0,1\n1\n", "sample 1 has 1 values for 2 columns"),
    ("time,height\n0,1\n1,nan\n", "height of sample 1 is nan"),
    ("time,height\n0,1\n1,inf\n", "height of sample 1 is inf"),
    ("time,height\n0,1\n0,2\n", "is there twice"),
    ("time,height\n1,1\n0,2\n", "comes after 1 s"),
    ("time [kg],height\n0,1\n1,2\n", "the unit 'kg' does not fit; one of s is wanted"),
    ("time,height [furlong]\n0,1\n1,2\n", "unknown unit 'furlong'"),
]


@pytest.mark.parametrize(("text", "words"), BAD)
def test_bad_files(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(RecordError) as caught:
        PistonRecord.from_csv(write(tmp_path / "bad.csv", text))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="there is no file"):
        PistonRecord.from_csv(tmp_path / "nothing.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(RecordError, match="cannot be read as text"):
        PistonRecord.from_csv(tmp_path / "binary.csv")
    path = write(tmp_path / "lab.csv", "time,height\n0,1\n1,2\n")
    with pytest.raises(RecordError, match="unknown column 'heigth'; did you mean 'height'"):
        PistonRecord.from_csv(path, units={"heigth": "mm"})


def test_arrays_are_checked_and_frozen() -> None:
    with pytest.raises(RecordError, match="shape"):
        PistonRecord(np.arange(3.0), np.arange(4.0))
    record = PistonRecord(np.arange(3.0), np.arange(3.0))
    with pytest.raises(ValueError, match="read-only"):
        record.height[0] = 1.0
    part = record.between(0.5, 5.0)
    assert part.time.tolist() == [1.0, 2.0]
