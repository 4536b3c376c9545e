"""Which of the lines above the numbers is the header."""

from pathlib import Path

import pytest

from granular import PistonRecord
from granular.shared.errors import RecordError


def read(path: Path, *head: str) -> PistonRecord:
    rows = [f"{0.01 * k:.2f},{55.0 + k % 3}" for k in range(20)]
    path.write_text("\n".join([*head, *rows, ""]), encoding="utf-8")
    return PistonRecord.from_file(path)


@pytest.mark.parametrize("line", ["Time,noon", "Elapsed time,12 min and more", "Date,noon"])
def test_a_line_about_time_above_the_header_is_none(line: str, tmp_path: Path) -> None:
    """The names and units directly above the numbers count."""
    for header in ("x [s],height [mm]", "t,height [mm]", "time [s],level [mm]"):
        record = read(tmp_path / "record.csv", line, header)
        assert record.height[0] == pytest.approx(0.055)


def test_what_was_done_to_a_column_stands_below_its_unit(tmp_path: Path) -> None:
    record = read(tmp_path / "record.csv", "TIMESTAMP,Piston height", "s,mm", "Smp,Avg")
    assert record.height[0] == pytest.approx(0.055)


@pytest.mark.parametrize("unit", ["[mm]", "(mm)", "{mm}", "in mm", "[mm] as wired"])
def test_a_long_header_keeps_its_unit(unit: str, tmp_path: Path) -> None:
    name = "distance from the laser below to the plate that moves with the piston, " * 3
    path = tmp_path / "record.csv"
    path.write_text(f'time [s],"{name}{unit}"\n' + "".join(f"0.0{k},{k}\n" for k in range(5)))
    record = PistonRecord.from_file(path, columns={"height": 2})
    assert record.height[1] == pytest.approx(0.001)


PAIRS = "0,000000,0,035000\n0,010000,-0,034000\n0,020000,0,033000\n"


@pytest.mark.parametrize("said", [{}, {"decimal": ","}])
def test_commas_that_separate_and_are_decimal_ones(said: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_text(PAIRS)
    with pytest.warns(UserWarning, match="time is column 1"):
        record = PistonRecord.from_file(path, **said)
    assert record.time.tolist() == [0.0, 0.01, 0.02]
    assert record.height.tolist() == [0.035, -0.034, 0.033]
    assert not record.extra


def test_commas_that_may_be_either(tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_text("0,5,1,2\n1,5,1,3\n2,5,1,4\n")
    with pytest.raises(RecordError, match=r"4 integers, or 2 with decimal commas; say"):
        PistonRecord.from_file(path)
    with pytest.warns(UserWarning, match="time is column 1"):
        assert PistonRecord.from_file(path, decimal=".").height.tolist() == [5.0, 5.0, 5.0]
    with pytest.warns(UserWarning, match="time is column 1"):
        assert PistonRecord.from_file(path, decimal=",").height.tolist() == [1.2, 1.3, 1.4]


@pytest.mark.parametrize(
    "text", ["0, 5, 1, 2\n1, 5, 1, 3\n", "0,510,1,2\n1,5,1,30\n2,50,1,4\n", "0,5,1.0,2\n1,5,1.5,3\n"]
)
def test_four_columns_without_names(text: str, tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_text(text)
    with pytest.warns(UserWarning, match="time is column 1"):
        record = PistonRecord.from_file(path)
    assert record.time[:2].tolist() == [0.0, 1.0]
    assert record.height[0] in (5.0, 510.0)


def test_columns_of_which_no_row_is_full(tmp_path: Path) -> None:
    (tmp_path / "cut.csv").write_bytes(b",timestep,positio\nn\n0,0.0,0.06\xe1\n[1,0.005,0.061971")
    with pytest.raises(RecordError, match="no line holds numbers in each of the columns 1, 2, 3"):
        PistonRecord.from_file(tmp_path / "cut.csv")
