"""Workbooks of Excel and LibreOffice."""

from __future__ import annotations

import csv
import datetime
import io
import itertools
import re
from collections.abc import Mapping, Sequence
from typing import Any

from granular.readers.delimited import read_delimited
from granular.readers.limited_process import read_within_limits
from granular.readers.read_options import ReadOptions, note_on_other_tables
from granular.readers.sheet import Sheet, report_parsing_errors
from granular.readers.table_cells import is_number
from granular.shared.errors import RecordError
from granular.shared.message_text import quote

MAX_BYTES = 64 * 2**20
_FEWEST_ROWS = 20
"""Rows of a sheet up to which it is no record."""
_OLD = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
"""First bytes of a workbook of Excel 97 to 2003, whatever its file is called."""
_MAX_CELLS, _MAX_LETTERS = 2**22, 2**26
"""Cells of all sheets, four columns of as many rows as a sheet has, and letters of all of them."""
_MAX_LETTERS_OF_CELL = 2**15
"""As in Excel."""
_ERRORS = ("#NULL!", "#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#NUM!", "#N/A")
"""Contents of a cell whose formula has no value."""
_DURATION = re.compile(r"PT(\d+)H(\d+)M(\d+(?:[.,]\d+)?)S", re.ASCII)
"""A time of LibreOffice that calamine leaves as it stands: of a day and more, or with a decimal comma."""

Table = Sequence[Sequence[str]]


def is_old_workbook(content: bytes) -> bool:
    """Tell a workbook in the form of Excel 97 to 2003."""
    return content.startswith(_OLD)


def read_workbook(content: bytes, options: ReadOptions) -> Sheet:
    """Read a sheet of a workbook: the first that holds a table, or that which is named."""
    every: Mapping[str, Table] = read_within_limits(list_sheets, content)
    tables = options.select_table(every, "sheet")
    first_error: RecordError | None = None
    for name, table in tables.items():
        try:
            sheet = read_delimited(_sheet_to_csv(table), None, options.skip, 2 if options.rate is None else 1)
        except RecordError as error:
            first_error = first_error or error
            continue
        sheet.form = f"sheet {quote(name)} of a workbook"
        others = [other for other, cells in tables.items() if other != name and _may_be_record(cells)]
        if others:
            sheet.notes.append(note_on_other_tables("sheet", [name, *others]))
        return sheet
    raise first_error or RecordError("holds no sheet; save the table in one")


def list_sheets(content: bytes) -> dict[str, list[list[str]]]:
    """Cells of all sheets as texts, row by row, up to the last that holds something."""
    from python_calamine import CalamineWorkbook, SheetTypeEnum

    with report_parsing_errors("a workbook"):
        book = CalamineWorkbook.from_filelike(io.BytesIO(content))
        names = [sheet.name for sheet in book.sheets_metadata if sheet.typ == SheetTypeEnum.WorkSheet]
        tables: dict[str, list[list[str]]] = {}
        cells_left, letters_left = _MAX_CELLS, _MAX_LETTERS
        for name in names:
            sheet = book.get_sheet_by_name(name)
            rows, columns = sheet.total_height + 1, sheet.total_width + 1  # counted from 0
            cells_left -= rows * columns
            if cells_left < 0:
                raise RecordError(
                    f"sheet {quote(name)} reaches to row {rows} and column {columns}; at most {_MAX_CELLS} "
                    "cells of all sheets are read: save the columns that are wanted as CSV"
                )
            tables[name] = [list(map(_cell_text, row)) for row in sheet.to_python(skip_empty_area=False)]
            letters_left -= sum(len(text) for row in tables[name] for text in row)
            if letters_left < 0:
                raise RecordError(
                    f"its cells hold more than {_MAX_LETTERS} letters, the limit; save the columns that "
                    "are wanted as CSV"
                )
        return tables


def _cell_text(value: Any) -> str:
    if isinstance(value, float) and value.is_integer() and abs(value) < 2.0**53:
        return str(int(value))
    if isinstance(value, datetime.datetime | datetime.time):
        return value.isoformat()
    if isinstance(value, datetime.date):
        return f"{value.isoformat()}T00:00:00"
    if isinstance(value, datetime.timedelta):
        minutes, seconds = divmod(abs(value.total_seconds()), 60.0)
        sign = "-" if value < datetime.timedelta(0) else ""
        return f"{sign}{int(minutes // 60)}:{int(minutes % 60):02}:{seconds:09.6f}"
    text = str(value)
    if len(text) > _MAX_LETTERS_OF_CELL:
        raise RecordError(
            f"a cell holds {len(text)} letters; at most {_MAX_LETTERS_OF_CELL} are read: empty it"
        )
    if duration := _DURATION.fullmatch(text):
        return ":".join(duration.groups()).replace(",", ".")
    return "" if text in _ERRORS else " ".join(text.split())


def _may_be_record(table: Table) -> bool:
    """Return True for a sheet with many rows that have two numbers in its middle and at its end."""
    rows = (table[len(table) // 2], table[-1]) if len(table) > _FEWEST_ROWS else ()
    counts = [sum(is_number(text, ".") for text in row) for row in rows]
    return min(counts, default=0) > 1


def _sheet_to_csv(table: Table) -> str:
    """Write a sheet as text; numbers of cells stay exact."""
    width = max(map(len, table), default=0)
    written = io.StringIO()
    csv.writer(written, delimiter="\t").writerows(
        itertools.chain(row, itertools.repeat("", width - len(row))) for row in table
    )
    return written.getvalue()
