"""Records of the piston: written and read as CSV and Parquet, errors, and drives of the piston."""

import itertools
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from granular import PistonRecord, Scene, quantity, simulate, stage
from granular.shared.errors import RecordError
from tests.modes import quick_in_plain_python

FINITE = st.floats(-1e300, 1e300, allow_nan=False)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    steps=arrays(float, st.integers(1, 30), elements=st.floats(1e-6, 1e3)),
    data=st.data(),
    velocity=st.booleans(),
)
def test_written_records_are_read_with_the_same_numbers(
    tmp_path: Path, ending: str, steps: np.ndarray, data: st.DataObject, velocity: bool
) -> None:
    time = np.concatenate([[0.0], np.cumsum(steps)])
    column = arrays(float, len(time), elements=FINITE)
    record = PistonRecord(
        time,
        data.draw(column),
        velocity=data.draw(column) if velocity else None,
        extra={"temperature": data.draw(column)},
    )
    path = tmp_path / f"record{ending}"
    (record.to_csv if ending == ".csv" else record.to_parquet)(path)
    back = PistonRecord.from_file(path)
    assert list(back.columns) == list(record.columns)
    for name, column_values in record.columns.items():
        assert np.array_equal(back.columns[name], column_values)


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_units_of_a_record_are_taken_from_the_headings_or_an_argument(tmp_path: Path) -> None:
    path = write(tmp_path / "lab.csv", "# lab 3\ntime [ms];height (mm);velocity\n0;59;0\n2;60;0.5\n")
    record = PistonRecord.from_csv(path)
    assert record.time.tolist() == [0.0, 0.002]
    assert record.height.tolist() == pytest.approx([0.059, 0.060])
    assert record.velocity.tolist() == [0.0, 0.5]
    given_units = PistonRecord.from_csv(path, units={"height": "cm"})
    assert given_units.height.tolist() == pytest.approx([0.59, 0.60])


GOOD = [
    '"time","height"\n0,1\n1,2\n',
    '"time [s]", "height [m]"\n"0", "1"\n1, 2\n',
    "\ufeffTime (s);HEIGHT[m];\n0;1;\n1;2;\n",
    'time,"load, in percent",height\n0,7,1\n1,8,2\n',
    "time\tremark (see page 3) of (4)\theight\n0\t5\t1\n1\t5\t2\n",
    "time,operator,height\n0,Ada,1\n1,Ben,2\n",
    "time,temperature,height\n0,,1\n1,293,2\n",
    "time,temperature,height\n0,nan,1\n1,inf,2\n",
]


@pytest.mark.parametrize("text", GOOD)
def test_records_with_unusual_headings_and_additional_columns_are_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "lab.csv").write_text(text, encoding="utf-8")
    record = PistonRecord.from_csv(tmp_path / "lab.csv")
    assert record.time.tolist() == [0.0, 1.0]
    assert record.height.tolist() == [1.0, 2.0]
    assert set(record.extra) <= {"load, in percent", "remark (see page 3) of (4)"}


def test_additional_columns_of_numbers_in_a_record_are_kept(tmp_path: Path) -> None:
    path = write(tmp_path / "lab.csv", 'time,"load, in percent",who,height\n0,7,a,1\n1,8,b,2\n')
    record = PistonRecord.from_csv(path)
    assert {name: column.tolist() for name, column in record.extra.items()} == {
        "load, in percent": [7.0, 8.0]
    }
    record.to_csv(tmp_path / "back.csv")
    back = PistonRecord.from_csv(tmp_path / "back.csv")
    assert back.extra["load, in percent"].tolist() == [7.0, 8.0]


BAD = [
    ("", "is empty"),
    ("time,height\n", "no rows of numbers"),
    ("time,height\n0,1\n", "1 samples"),
    ("time,height,height\n0,1,2\n1,2,3\n", "the name 'height' occurs twice"),
    ("time,height\n0,1\n1,two\n", "height of sample 1 (line 3) is 'two', not a number"),
    ("time,height\n0,1\n1\n", "sample 1 has 1 values for 2 columns"),
    ("time,height\n0,1\n1,nan\n", "1 samples"),
    ("time,height\n0,1\n1,inf\n", "height of sample 1 (line 3) is inf"),
    ("time,height\n0,1\n0,2\n", "occurs twice"),
    ("time,height\n1,1\n0,2\n", "comes after 1 s"),
    ("time,height\n0,one\n1,2\n", "height of sample 0 (line 2) is 'one', not a number"),
    ("force,load\n0,1\n1,2\n", "no column 'time'; found: 'force', 'load'"),
    ("time,acc\n0,1\n1,2\n", "only the acceleration 'acc'"),
    ("time,height [mm^-200]\n0,1\n1,2\n", "exceeds 9"),
    ("time,height [nm^9 nm^9]\n0,1\n1,2\n", "write a smaller power"),
    ("time [kg],height\n0,1\n1,2\n", "the unit 'kg' does not fit; a unit like s is needed"),
    ("time,height [furlong]\n0,1\n1,2\n", "unknown unit 'furlong'"),
]


@pytest.mark.parametrize(("text", "words"), BAD)
def test_invalid_csv_files_are_refused_as_records(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(RecordError) as caught:
        PistonRecord.from_csv(write(tmp_path / "bad.csv", text))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def parquet(path: Path, columns: dict[str, object], units: dict[str, str] | None = None) -> Path:
    """Write a Parquet file with units in the metadata of its columns."""
    import pyarrow
    import pyarrow.parquet

    made = {name: pyarrow.array(values) for name, values in columns.items()}
    fields = [
        pyarrow.field(name, values.type, metadata={"units": units[name]} if units and name in units else None)
        for name, values in made.items()
    ]
    table = pyarrow.Table.from_arrays(list(made.values()), schema=pyarrow.schema(fields))
    pyarrow.parquet.write_table(table, path)
    return path


def test_units_and_additional_columns_of_a_parquet_file_are_read(tmp_path: Path) -> None:
    """Units are in names or metadata. Columns contain integers or other types."""
    columns = {
        "time [ms]": [0, 2, 4],
        "Height": [59.0, 60.0, 61.0],
        "who": ["Ada", "Ben", "Ada"],
        "gaps": [1.0, None, 2.0],
        "load": np.array([1.0, 2.0, 3.0], dtype=np.float32),
    }
    path = parquet(tmp_path / "lab.pq", columns, {"Height": "mm"})
    record = PistonRecord.from_file(path)
    assert record.time.tolist() == [0.0, 0.002, 0.004]
    assert record.height.tolist() == pytest.approx([0.059, 0.060, 0.061])
    assert {name: values.tolist() for name, values in record.extra.items()} == {"load": [1.0, 2.0, 3.0]}
    assert PistonRecord.from_parquet(path, {"height": "m"}).height.tolist() == [59.0, 60.0, 61.0]


BAD_TABLES = [
    ({"time": [0.0, 1.0]}, {}, "no column 'height'; found: 'time'"),
    ({"time": [], "height": []}, {}, "time of sample 0 is 'of the type null', not a number"),
    ({"time": [0.0], "height": [1.0]}, {}, "1 samples"),
    (
        {"time": [0.0, 1.0], "height": ["a", "b"]},
        {},
        "height of sample 0 is 'of the type string', not a number",
    ),
    ({"time": [0.0, 1.0], "height": [1.0, None]}, {}, "1 samples"),
    ({"time": [0.0, 1.0], "height": [1.0, np.inf]}, {}, "height of sample 1 is inf"),
    ({"time": [1.0, 0.0], "height": [1.0, 2.0]}, {}, "comes after 1 s"),
    ({"time": [0.0, 0.0], "height": [1.0, 2.0]}, {}, "occurs twice"),
    ({"time": [0.0, 1.0], "height": [1.0, 2.0]}, {"height": "kg"}, "'kg' does not fit"),
    ({"time": [0.0, 1.0], "height": [1.0, 2.0], "Height": [1.0, 2.0]}, {}, "occurs twice"),
]


@pytest.mark.parametrize(("columns", "units", "words"), BAD_TABLES)
def test_invalid_parquet_columns_are_refused(
    tmp_path: Path, columns: dict[str, object], units: dict[str, str], words: str
) -> None:
    path = parquet(tmp_path / "bad.parquet", columns, units)
    with pytest.raises(RecordError) as caught:
        PistonRecord.from_parquet(path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_other_than_parquet_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RecordError, match="does not exist"):
        PistonRecord.from_file(tmp_path / "nothing.parquet")
    (tmp_path / "folder.pq").mkdir()
    with pytest.raises(RecordError, match="cannot be read"):
        PistonRecord.from_file(tmp_path / "folder.pq")
    path = write(tmp_path / "text.parquet", "time,height\n0,1\n1,2\n" * 10)
    with pytest.raises(RecordError, match="cannot be read as Parquet") as caught:
        PistonRecord.from_file(path)
    assert "\n" not in str(caught.value)
    cut = parquet(tmp_path / "cut.parquet", {"time": [0.0, 1.0], "height": [1.0, 2.0]})
    cut.write_bytes(cut.read_bytes()[:-20])
    with pytest.raises(RecordError, match="cannot be read as Parquet"):
        PistonRecord.from_file(cut)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(RecordError, match=r"pip install 'granular-damper\[parquet\]'"):
        PistonRecord.from_file(cut)


def test_arrays_of_a_record_are_validated_and_read_only() -> None:
    with pytest.raises(RecordError, match="shape"):
        PistonRecord(np.arange(3.0), np.arange(4.0))
    record = PistonRecord(np.arange(3.0), np.arange(3.0))
    with pytest.raises(ValueError, match="read-only"):
        record.height[0] = 1.0
    with pytest.raises(RecordError, match="needs 2 or more"):
        record.first(-1)
    part = record.between(0.5, 5.0)
    assert part.time.tolist() == [1.0, 2.0]


MASS, GRAVITY = 2.0, 9.8
BASE = ("base_height", "base_velocity", "base_acceleration")


def empty(*stages: dict[str, Any], **changes: Any) -> Scene:
    """Return a scene of a heavy piston over a cell without grains."""
    return Scene.from_plain(
        {
            "grains": {"count": 0, "species": [{"diameter": "6 mm"}]},
            "cell": {"width": "60 mm"},
            "piston": {"height": "120 mm", "mass": MASS},
            "effects": {"gravity": {}},
            "protocol": list(stages),
            "output": {"scalars": 1e-4, "frames": 0.01},
        }
    ).replace(**changes)


def acceleration(time: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Return the acceleration at the inner, evenly spaced samples, by second differences."""
    return np.diff(height, 2) / np.diff(time)[0] ** 2


def test_record_of_a_shaken_cell_contains_the_base_motion() -> None:
    """Relative to the base at height b, the piston obeys z'' = -g - b''."""
    angle = 0.6
    scene = empty(
        {"kind": "free", "name": "fall", "duration": 0.05},
        **{
            "effects.shaking": {"amplitude": 0.002, "frequency": 25.0, "angle": angle},
            "effects.drag": {"coefficient": 0.0},  # of zero size, with the same types as for falling grains
        },
    )
    record = simulate(scene, progress=False).piston()
    assert tuple(record.extra) == BASE
    found = acceleration(record.time, record.height)
    assert found == pytest.approx(-GRAVITY - record.extra["base_acceleration"][1:-1], abs=2e-3)
    assert record.extra["base_height"].max() == pytest.approx(0.002 * math.sin(angle), rel=1e-3)
    for name, rate in itertools.pairwise(BASE):
        slope = np.gradient(record.extra[name], record.time)[2:-2]
        assert slope == pytest.approx(record.extra[rate][2:-2], abs=2e-4 * np.ptp(slope))


def test_record_of_a_pushed_piston_contains_the_force() -> None:
    """M z'' = -M g + F, where the phase of F is zero at the start of the stage. In other stages F = 0."""
    scene = empty(
        {"kind": "hold", "name": "wait", "duration": 0.0123},
        {"kind": "push", "name": "push", "mean": 3.0, "amplitude": 5.0, "frequency": 40.0, "duration": 0.04},
        {"kind": "free", "name": "fall", "duration": 0.01},
    )
    run = simulate(scene, progress=False)
    record = run.piston("push")
    assert record.extra["outer_force"][0] == pytest.approx(3.0)
    found = acceleration(record.time[:300], record.height[:300])
    force = record.extra["outer_force"][1:299]
    assert found == pytest.approx(-GRAVITY + force / MASS, abs=1e-3)
    integer = run.piston().extra["outer_force"]
    indices = run.dataset["stage"].values
    assert np.count_nonzero(integer) == pytest.approx(np.count_nonzero(indices == 1), abs=2)
    assert "outer_force" not in run.piston("fall").extra


@stage
class Tug:
    """Custom stage with a decaying force on the piston."""

    size: float = quantity("N")

    @staticmethod
    def force(p: Any, time: float) -> float:
        return float(p.size * math.exp(-100.0 * time))


def test_records_contain_piston_forces_given_by_formulas_and_custom_stages() -> None:
    """M z'' = -M g + F in both stages, and F = 0 before them."""
    scene = empty(
        {"kind": "hold", "name": "wait", "duration": 0.01},
        {
            "kind": "force",
            "name": "formula",
            "force": "f*exp(-t/s)",
            "f": "30 N",
            "s": "5 ms",
            "duration": 0.02,
        },
        {"kind": "tug", "name": "own", "size": "40 N", "duration": 0.02},
    )
    run = simulate(scene, progress=False)
    for name, size, rate in (("formula", 30.0, 200.0), ("own", 40.0, 100.0)):
        record = run.piston(name)
        force = record.extra["outer_force"]
        wanted = size * np.exp(-rate * (record.time - run.stage(name).start))
        np.testing.assert_allclose(force, wanted, rtol=1e-9)
        found = acceleration(record.time, record.height)
        assert found == pytest.approx(-GRAVITY + force[1:-1] / MASS, abs=2e-2)
    force = run.piston().extra["outer_force"]
    assert not force[run.piston().time < 0.01 - 1e-9].any()
    assert np.count_nonzero(force) > 390


@quick_in_plain_python
def test_record_on_a_machine_with_a_moving_base_contains_the_base_acceleration() -> None:
    """Relative to the base of height b, z'' = -g - b''."""
    drive = {"displacement": "2 mm", "frequency": "25 Hz"}
    scene = empty(
        {"kind": "free", "name": "fall", "duration": 0.05},
        **{"effects.host": {"mount": "base", "bodies": [], "excitation": drive}},
    )
    record = simulate(scene, dt="auto/4", progress=False).piston()
    assert tuple(record.extra) == ("base_acceleration",)
    found = acceleration(record.time, record.height)
    assert found == pytest.approx(-GRAVITY - record.extra["base_acceleration"][1:-1], abs=2e-3)


def test_record_of_an_undriven_piston_contains_only_time_and_height() -> None:
    run = simulate(empty({"kind": "free", "name": "fall", "duration": 0.01}), progress=False)
    assert run.piston().extra == {}
