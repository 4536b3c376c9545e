"""Workbooks of Excel and LibreOffice."""

from __future__ import annotations

import csv
import datetime
import io
from pathlib import Path
from typing import Any

from granular.readers.delimited import read_delimited
from granular.readers.reading import Reading
from granular.readers.sheet import Sheet
from granular.readers.text import read_bytes
from granular.shared.errors import RecordError
from granular.shared.messages import quoted, visible

_ENGINES = {".xlsx": "openpyxl", ".xlsm": "openpyxl", ".ods": "odf"}
_MOST_BYTES = 64 * 2**20
_OLD = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
"""What a workbook of Excel 97 to 2003 begins with."""


def refuse_old(path: Path, content: bytes) -> None:
    """Refuse a workbook in the form of Excel 97 to 2003.

    Raises
    ------
    RecordError
        If it is one.
    """
    if content.startswith(_OLD):
        raise RecordError(
            f"{visible(path)}: is a workbook of Excel 97 to 2003 (.xls), which is not read; save "
            "it as .xlsx or CSV"
        )


def read_workbook(path: Path, reading: Reading) -> Sheet:
    """A sheet of a workbook: the first that holds a table, or that which is named.

    Raises
    ------
    RecordError
        If it cannot be read as such, there is no such sheet, or what reads it is not installed.
    """
    content, engine = read_bytes(path, _MOST_BYTES), _ENGINES[path.suffix.lower()]
    tables = _tables(path, content, engine)
    if reading.sheet is not None and reading.sheet not in tables:
        raise RecordError(
            f"{visible(path)}: no sheet {quoted(reading.sheet)}; found: "
            f"{', '.join(map(quoted, tables))}"
        )
    names = list(tables) if reading.sheet is None else [reading.sheet]
    failed: RecordError | None = None
    for name in names:
        try:
            sheet = read_delimited(path, _text(tables[name]), None, reading.skip)
        except RecordError as error:
            failed = failed or error
            continue
        sheet.form = f"sheet {quoted(name)} of a workbook"
        return sheet
    raise failed or RecordError(f"{visible(path)}: holds no sheet; save the table in one")


def _tables(path: Path, content: bytes, engine: str) -> dict[str, Any]:
    import pandas

    try:
        return pandas.read_excel(
            io.BytesIO(content),
            sheet_name=None,
            header=None,
            dtype=object,
            engine=engine,
        )
    except ImportError:
        raise RecordError(
            f"{path.suffix} files need {'odfpy' if engine == 'odf' else engine}, which is not "
            "installed; pip install 'granular-damper[workbooks]', or save as CSV"
        ) from None
    except Exception as error:  # each engine has its own kinds
        words = " ".join(str(error).split())
        raise RecordError(
            f"{visible(path)}: cannot be read as a workbook: {visible(words)}; save it anew, or as "
            "CSV"
        ) from None


def _text(table: Any) -> str:
    """A sheet as CSV; what the program shows for a cell stays exact."""
    written = io.StringIO()
    csv.writer(written, delimiter="\t").writerows(
        [_cell(value) for value in row] for row in table.itertuples(index=False)
    )
    return written.getvalue()


def _cell(value: Any) -> str:
    import pandas

    if pandas.isna(value):
        return ""
    if isinstance(value, datetime.datetime | datetime.time):
        return value.isoformat()
    return " ".join(str(value).split())
