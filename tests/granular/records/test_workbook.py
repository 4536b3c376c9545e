"""Workbook cells, nearly empty sheets, and MATLAB files with a sampling interval or times."""

import datetime
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from granular import PistonRecord
from granular.records.formats import read_sheet
from granular.records.options import ReadOptions
from granular.shared.errors import RecordError

from .bombs import ods, ods_row, xlsx


def ods_cell(kind: str, text: str = "", **values: str) -> str:
    said = "".join(f' office:{name.replace("_", "-")}="{value}"' for name, value in values.items())
    return f'<table:table-cell office:value-type="{kind}"{said}><text:p>{text}</text:p></table:table-cell>'


def test_all_kinds_of_cells_in_a_libre_office_workbook_are_read(tmp_path: Path) -> None:
    path = tmp_path / "book.ods"
    empty = '<table:table-cell table:number-columns-repeated="16000"/>'
    head = ods_cell("string", "clock<text:s/>in s") + ods_cell("string", "height [mm]")
    rows = [
        ods_cell("time", f"12:00:0{k}", time_value=f"PT12H00M0{k}.25S")
        + ods_cell("percentage" if k else "float", "what is shown", value=f"{k}.125")
        + empty
        for k in range(3)
    ]
    ods(
        path,
        [
            ods_row(empty, 7),
            ods_row(head),
            *map(ods_row, rows),
            ods_row(rows[2], 2),
            ods_row(empty, 1_048_000),
        ],
    )
    sheet = read_sheet(path, ReadOptions())
    assert [column.name for column in sheet.columns] == ["clock", "height"]
    assert sheet.columns[0].values is not None
    assert sheet.columns[0].values.tolist() == [0.0, 1.0, 2.0, 2.0, 2.0]
    assert sheet.columns[1].values is not None
    assert sheet.columns[1].values.tolist() == [0.125, 1.125, 2.125, 2.125, 2.125]


def test_dates_of_excel_and_libre_office_are_read(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    start = datetime.datetime(2024, 5, 1)
    book = openpyxl.Workbook()
    book.active.append(["date", "height [mm]"])
    rows = [ods_row(ods_cell("string", "date") + ods_cell("string", "height [mm]"))]
    for day in range(4):
        now = start + datetime.timedelta(days=day, hours=6 * (day == 3))
        book.active.append([now, 0.5 * day])
        text = now.date().isoformat() if day < 3 else now.isoformat()
        value = ods_cell("float", value=f"{0.5 * day}")
        rows.append(ods_row(ods_cell("date", "1. Mai", date_value=text) + value))
    book.save(tmp_path / "a.xlsx")
    ods(tmp_path / "a.ods", rows)
    for name in ("a.xlsx", "a.ods"):
        record = PistonRecord.from_file(tmp_path / name, columns={"time": "date"})
        assert record.time.tolist() == [0.0, 86400.0, 172800.0, 280800.0]
        assert record.height.tolist() == [0.0, 5e-4, 1e-3, 1.5e-3]


def test_a_workbook_cell_without_a_value_is_a_missing_sample(tmp_path: Path) -> None:
    pytest.importorskip("openpyxl")
    rows = ['<row><c t="str"><v>time</v></c><c t="str"><v>height</v></c></row>']
    for k in range(6):
        value = '<c t="e"><v>#DIV/0!</v></c>' if k == 2 else f"<c><v>{k}.5</v></c>"
        rows.append(f"<row><c><v>{k}</v></c>{value}</row>")
    xlsx(tmp_path / "a.xlsx", rows)
    with pytest.warns(UserWarning, match="1 of 6 samples"):
        record = PistonRecord.from_file(tmp_path / "a.xlsx")
    assert record.time.tolist() == [0.0, 1.0, 3.0, 4.0, 5.0]


def test_size_limits_apply_to_all_sheets_of_a_workbook_together(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook(write_only=True)
    for name in ("a", "b"):
        sheet = book.create_sheet(name)
        sheet.append(["time", "height"])
        for k in range(20):
            sheet.append([k, np.sin(k)])
        sheet.append([None] * 16000)
        for _ in range(110):
            sheet.append([])
        sheet.append([*[None] * 15999, 1.0])
    book.save(tmp_path / "a.xlsx")
    with pytest.raises(
        RecordError,
        match="sheet 'b' extends to row 133 and column 16000; the limit over all sheets is 4194304",
    ):
        PistonRecord.from_file(tmp_path / "a.xlsx", sheet="a")


FAR = "9" * 20
LONG_CELL = ['<row><c t="inlineStr"><is><t>', "a" * 2**20, "</t></is></c></row>"]
ROWS = [f'<row r="{row}"><c r="A{row}"><v>1</v></c></row>' for row in ("1", FAR)]


@pytest.mark.parametrize(
    ("rows", "words"), [(ROWS, "2048 MB and 20 s"), (LONG_CELL, "a cell holds 1048576 characters")]
)
def test_a_malformed_workbook_is_refused_in_one_line(rows: list[str], words: str, tmp_path: Path) -> None:
    xlsx(tmp_path / "a.xlsx", rows)
    with pytest.raises(RecordError, match=words) as caught:
        PistonRecord.from_file(tmp_path / "a.xlsx")
    assert "\n" not in str(caught.value)


def test_reading_a_workbook_does_not_run_python_modules_in_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = ['<row><c t="str"><v>time</v></c><c t="str"><v>height</v></c></row>']
    xlsx(
        tmp_path / "a.xlsx",
        [*rows, *(f"<row><c><v>{k}</v></c><c><v>{k % 3}</v></c></row>" for k in range(9))],
    )
    (tmp_path / "json.py").write_text("raise SystemExit(7)", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    assert len(PistonRecord.from_file("a.xlsx")) == 9


def test_libre_office_durations_and_empty_cells_are_read(tmp_path: Path) -> None:
    rows = [ods_row(ods_cell("string", "clock") + ods_cell("string", "height [mm]"))]
    for k in range(6):
        clock = ods_cell("time", time_value=f"PT{23 + k}H59M0{k},5S")
        height = ods_cell("string", "#DIV/0!") if k == 3 else ods_cell("float", value=f"{k}.5")
        rows.append(ods_row(clock + height))
    ods(tmp_path / "a.ods", rows)
    with pytest.warns(UserWarning, match="1 of 6 samples"):
        record = PistonRecord.from_file(tmp_path / "a.ods", columns={"time": "clock"})
    assert record.time.tolist() == [0.0, 3601.0, 7202.0, 14404.0, 18005.0]


def test_stricter_memory_and_time_limits_of_the_system_are_kept_while_a_workbook_is_read(
    tmp_path: Path,
) -> None:
    """A batch system sets such limits."""
    resource = pytest.importorskip("resource")
    xlsx(tmp_path / "a.xlsx", ["<row><c><v>1</v></c></row>"])
    limits = resource.getrlimit(resource.RLIMIT_CPU)
    done = subprocess.run(
        [sys.executable, "-m", "reduced_models", "look", str(tmp_path / "a.xlsx")],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (15, 15)),
    )
    assert resource.getrlimit(resource.RLIMIT_CPU) == limits
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "setrlimit" not in done.stderr


HEIGHT = 55.0 + np.sin(np.arange(60.0))


def saved(path: Path, **variables: Any) -> Path:
    scipy.io.savemat(path, variables)
    return path


def test_a_column_named_by_a_single_letter_is_not_taken_as_an_acceleration_force_or_time(
    tmp_path: Path,
) -> None:
    """Such names denote oscilloscope channels and have no physical meaning."""
    times = {"Tstart": 0.0, "Tinterval": 0.01}
    for letters in ("A", "AB", "FH"):
        path = saved(tmp_path / "a.mat", **times, **dict.fromkeys(letters, HEIGHT))
        with pytest.raises(RecordError, match="only channels: ") as caught:
            PistonRecord.from_file(path)
        assert f"--columns height={letters[0]} --units height=mm" in str(caught.value)
        said = {"columns": {"height": letters[-1]}, "units": {"height": "mm"}}
        record = PistonRecord.from_file(path, **said)
        assert record.height == pytest.approx(1e-3 * HEIGHT)
        assert record.time == pytest.approx(0.01 * np.arange(60))
    path = saved(tmp_path / "b.mat", time=0.01 * np.arange(60), A=HEIGHT)
    with pytest.raises(RecordError, match="only the acceleration 'A'"):
        PistonRecord.from_file(path)


@pytest.mark.parametrize(
    "numbers",
    [
        {"Tinterval": 0.0},
        {"Tinterval": -0.01},
        {"Tinterval": math.nan},
        {"Tinterval": "fast"},
        {"Tinterval": np.arange(3.0)},
        {"Tinterval": 1j},
        {"Tinterval": 0.01, "Tstart": "noon"},
        {"Tinterval": 0.01, "Tstart": np.zeros(3)},
        {"Tinterval": 0.01, "Tstart": 1j},
        {"Tinterval": 0.01, "Tstart": math.inf},
    ],
    ids=str,
)
def test_an_invalid_sampling_interval_in_a_matlab_file_is_refused_in_one_line(
    numbers: dict[str, Any], tmp_path: Path
) -> None:
    path = saved(tmp_path / "a.mat", height=HEIGHT, **numbers)
    with pytest.raises(RecordError, match="Tinterval = ") as caught:
        PistonRecord.from_file(path)
    assert "\n" not in str(caught.value)


def test_times_in_a_matlab_file_take_precedence_over_its_sampling_interval(tmp_path: Path) -> None:
    """The sampling interval is then ignored, even if it is invalid."""
    time = 0.02 * np.arange(60)
    for step in (0.01, 0.0, "fast"):
        path = saved(tmp_path / "a.mat", time=time, height=HEIGHT, Tinterval=step)
        assert PistonRecord.from_file(path).time == pytest.approx(time)
        path = saved(tmp_path / "b.mat", column=time, height=HEIGHT, Tinterval=step)
        assert PistonRecord.from_file(path, columns={"time": "column"}).time == pytest.approx(time)
