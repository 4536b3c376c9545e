"""Special and oversized files are refused quickly; numbers are read exactly."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord, load_scene
from granular.records.binary import MAX_NUMBERS
from granular.shared import files
from granular.shared.errors import RecordError, SceneError
from granular.shared.files import parse_toml, read_text, read_toml


def test_text_files_with_and_without_byte_order_mark_are_read(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes("\ufeffname = 'λ'\n".encode())
    assert read_toml(path) == {"name": "λ"}
    assert read_text(path, 100) == "name = 'λ'\n"
    packaged = Path(files.__file__).parents[1] / "scenes" / "bed.toml"
    path.write_text(packaged.read_text(encoding="utf-8"), encoding="utf-8-sig")
    assert load_scene(path) == load_scene("bed")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
def test_pipes_devices_and_directories_are_refused_as_input_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "zero.csv").symlink_to("/dev/zero")
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "file.csv").touch()
    for name, words in (
        ("pipe.csv", "is a pipe or a device; write it to a file first"),
        ("zero.csv", "is a pipe or a device"),
        ("folder.csv", "is a directory; give a file in it"),
        ("nothing.csv", "does not exist"),
        ("file.csv/it.csv", "does not exist"),
        ("null\0.csv", "cannot be read"),
        ("half\ud800.csv", "cannot be read"),
        ("long" * 1000 + ".csv", "cannot be read"),
    ):
        with pytest.raises(RecordError, match=words):
            PistonRecord.from_csv(tmp_path / name)


def test_input_files_that_are_too_long_are_refused_before_they_are_read(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    with path.open("wb") as file:
        file.truncate(2**40)  # a hole, which takes no place
    with pytest.raises(RecordError, match="is too long; the limit is 256 MB"):
        PistonRecord.from_csv(path)
    with pytest.raises(SceneError, match="is too long; the limit is 16 MB"):
        load_scene(path.rename(tmp_path / "long.toml"))


def test_a_small_compressed_file_that_contains_too_many_numbers_is_refused(tmp_path: Path) -> None:
    """An example is a Parquet file with equal numbers."""
    pyarrow, parquet = (pytest.importorskip(name) for name in ("pyarrow", "pyarrow.parquet"))
    path = tmp_path / "record.parquet"
    empty = pyarrow.nulls(MAX_NUMBERS // 2 + 1, pyarrow.int8())
    parquet.write_table(pyarrow.table({"time": empty, "height": empty}), path)
    assert path.stat().st_size < 100_000
    with pytest.raises(RecordError, match=f"rows of 2 columns of numbers; the limit is {MAX_NUMBERS}"):
        PistonRecord.from_parquet(path)
    with path.open("r+b") as file:
        file.truncate(2**40)
    with pytest.raises(RecordError, match="is too long"):
        PistonRecord.from_parquet(path)


@pytest.mark.parametrize(
    "text",
    [
        "[" + ".".join(["a"] * 10**5) + "]",
        ".".join(["a"] * 10**5) + " = 1",
        "x = {" + " . ".join(['"a"'] * 10**5) + " = 1}",
        "[[" + ".".join(["'a'"] * 10**5) + "]]",
        "x = " + "[" * 10**5,
        "x = " + "{a = " * 10**5,
    ],
    ids=["header", "key", "inline table", "array of tables", "lists", "tables"],
)
def test_toml_keys_with_many_parts_and_deep_nesting_are_refused_quickly(text: str) -> None:
    with pytest.raises(ValueError, match=r"a key has more than 20 parts|too deep"):
        parse_toml(text)


def test_dots_outside_keys_of_a_toml_file_are_accepted() -> None:
    numbers = ", ".join(f"{k}.{k}" for k in range(1000))
    assert len(parse_toml(f"a.b.c.d = [{numbers}]")["a"]["b"]["c"]["d"]) == 1000
    assert parse_toml("name = '1.2.3.4'") == {"name": "1.2.3.4"}


def test_tables_with_too_many_columns_are_refused(tmp_path: Path) -> None:
    names = ["time", "height", *(f"c{k}" for k in range(4_000))]
    lines = [",".join(names), *(",".join([str(k)] * len(names)) for k in range(6))]
    path = tmp_path / "wide.csv"
    path.write_text("\n".join(lines))
    assert len(PistonRecord.from_csv(path).extra) == 4_000
    with pytest.raises(RecordError, match="unknown column 'depth'") as caught:
        PistonRecord.from_csv(path, {"depth": "m"})
    assert len(str(caught.value)) < 600


CELLS = ("1_0.5", "0x10", "\uff11\uff12", "\u0663", "True", "1 2", "½", "−1", "1e", "--1")


@pytest.mark.parametrize("cell", CELLS)
def test_table_cells_that_are_not_plain_numbers_are_reported(cell: str, tmp_path: Path) -> None:
    """Among them are underscores and digits of other scripts, which Python's float() accepts."""
    path = tmp_path / "record.csv"
    path.write_text(f'time,height\n0,1\n1,"{cell}"\n', encoding="utf-8")
    with pytest.raises(RecordError, match=r"height of sample 1 \(line 3\) is .*, not a number"):
        PistonRecord.from_csv(path)


@pytest.mark.parametrize(
    "values",
    [
        [True, False],
        ["1", "2"],
        [1 + 2j, 3],
        np.ma.array([1.0, 2.0], mask=[0, 1]),
        [None, 1.0],
        [10**400, 1],
        np.array(["2020", "2021"], dtype="datetime64[D]"),
        {1: 2},
        "ab",
        [[1], [2]],
    ],
)
def test_arrays_of_other_types_than_numbers_are_refused(values: Any) -> None:
    with pytest.raises(RecordError, match="height: "):
        PistonRecord([0.0, 1.0], values)


def test_integers_in_input_files_keep_all_digits() -> None:
    bed = load_scene("bed")
    for seed in (2**53 + 1, 2**63 - 1, "9007199254740993", np.int64(2**53 + 1)):
        assert bed.replace(**{"arrangement.seed": seed}).arrangement.seed == int(seed)
    for seed in (2**63, 10**400, "9" * 400, True, np.True_, "1_0", "\u0661", 2.5, np.nan, "1e400"):
        with pytest.raises(SceneError, match=r"arrangement\.seed: "):
            bed.replace(**{"arrangement.seed": seed})


@pytest.mark.parametrize("value", [True, np.True_, "1_0", "\uff11", 10**400, "1e400", [1.0], None])
def test_invalid_quantities_with_units_are_refused(value: object) -> None:
    with pytest.raises(SceneError, match=r"cell\.width: "):
        load_scene("bed").replace(**{"cell.width": value})
