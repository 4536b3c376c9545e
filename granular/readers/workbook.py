"""Workbooks of Excel and LibreOffice."""

from __future__ import annotations

import csv
import datetime
import io
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from zipfile import ZipFile

from granular.readers.delimited import read_delimited
from granular.readers.reading import Reading
from granular.readers.sheet import Sheet
from granular.readers.text import read_bytes
from granular.readers.workbook_rows import (
    MOST_CELLS,
    check_parts,
    excel_sheets,
    libre_office_sheets,
    table_of,
)
from granular.shared.errors import RecordError
from granular.shared.messages import quoted, visible

_MOST_BYTES = 64 * 2**20
_OLD = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
"""What a workbook of Excel 97 to 2003 begins with."""
_ERRORS = ("#NULL!", "#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#NUM!", "#N/A")
"""What stands in a cell whose formula has no value."""


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
    tables = _tables(path, read_bytes(path, _MOST_BYTES))
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


def _tables(path: Path, content: bytes) -> dict[str, list[Sequence[Any]]]:
    try:
        with ZipFile(io.BytesIO(content)) as archive:
            check_parts(archive)
            if path.suffix.lower() == ".ods":
                sheets = libre_office_sheets(archive)
            else:
                sheets = excel_sheets(io.BytesIO(content))
            tables: dict[str, list[Sequence[Any]]] = {}
            left = MOST_CELLS
            for name, rows in sheets:
                tables[name] = table_of(rows, left)
                left -= len(tables[name]) * _width(tables[name])
            return tables
    except ImportError:
        raise RecordError(
            f"{path.suffix} files need openpyxl, which is not installed; pip install "
            "'granular-damper[workbooks]', or save as CSV"
        ) from None
    except RecordError as error:
        raise RecordError(
            f"{visible(path)}: {error}: save the columns that are wanted as CSV"
        ) from None
    except Exception as error:  # zip, XML and openpyxl have their own kinds
        words = " ".join(str(error).split())
        raise RecordError(
            f"{visible(path)}: cannot be read as a workbook: {visible(words)}; save it anew, or as "
            "CSV"
        ) from None


def _width(table: Sequence[Sequence[Any]]) -> int:
    return max(map(len, table), default=0)


def _text(table: Sequence[Sequence[Any]]) -> str:
    """A sheet as text; what the program shows for a cell stays exact."""
    width = _width(table)
    written = io.StringIO()
    csv.writer(written, delimiter="\t").writerows(
        itertools.chain(map(_cell, row), itertools.repeat("", width - len(row))) for row in table
    )
    return written.getvalue()


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, str) and value.startswith("#") and value in _ERRORS):
        return ""
    if isinstance(value, datetime.datetime | datetime.time):
        return value.isoformat()
    return " ".join(str(value).split())
