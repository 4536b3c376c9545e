"""Workbooks of Excel and LibreOffice, measured before anything of them is kept.

A workbook is XML in a zip archive, where few bytes stand for many: by squeezing, by a cell far
from all others, and by cells and rows that are repeated.
"""

from __future__ import annotations

import csv
import datetime
import io
import itertools
import re
import warnings
import xml.parsers.expat
from collections.abc import Iterable, Iterator, Sequence
from typing import IO, Any, NamedTuple
from xml.etree.ElementTree import Element, iterparse
from zipfile import ZipFile, ZipInfo

from granular.readers.delimited import read_delimited
from granular.readers.read_options import ReadOptions, note_on_other_tables
from granular.readers.sheet import Sheet, report_parsing_errors
from granular.readers.table_cells import is_number
from granular.shared.errors import RecordError
from granular.shared.message_text import quote

MAX_BYTES = 64 * 2**20
_FEWEST_ROWS = 20
"""Rows of a sheet up to which it is no record."""
_OLD = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
"""First bytes of a workbook of Excel 97 to 2003."""
_ERRORS = ("#NULL!", "#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#NUM!", "#N/A")
"""Contents of a cell whose formula has no value."""

Rows = Iterable[tuple[int, Sequence[Any]]]
"""Numbers of repeats, and the cells of a row."""

MAX_ROWS, MAX_CELLS = 2**20, 2**22
"""Rows that a sheet of Excel has, and the cells of four columns of them."""


class _SizeLimit(NamedTuple):
    """Megabytes of parts when they are unpacked, and elements of XML in them."""

    megabytes: int
    elements: int


_PARTS = {
    "xl/worksheets/": _SizeLimit(512, 12_000_000),
    "content.xml": _SizeLimit(512, 12_000_000),
    "xl/sharedStrings.xml": _SizeLimit(64, 3_000_000),
    "": _SizeLimit(16, 200_000),
}
"""Limits of parts by the starts of their names. A full sheet of four columns has 9.4 million elements in
200 MB."""


def refuse_old_workbook(content: bytes) -> None:
    """Refuse a workbook in the form of Excel 97 to 2003."""
    if content.startswith(_OLD):
        raise RecordError(
            "is a workbook of Excel 97 to 2003 (.xls), which is not read; save it as .xlsx or CSV"
        )


def read_workbook(content: bytes, options: ReadOptions) -> Sheet:
    """Read a sheet of a workbook: the first that holds a table, or that which is named."""
    tables = options.select_table(_sheet_tables(content), "sheet")
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


def _sheet_tables(content: bytes) -> dict[str, list[Sequence[Any]]]:
    with (
        report_parsing_errors("a workbook", "openpyxl", "workbooks"),
        ZipFile(io.BytesIO(content)) as archive,
    ):
        check_archive_sizes(archive)
        if "content.xml" in archive.namelist():
            sheets = iterate_libre_office_sheets(archive)
        else:
            sheets = iterate_excel_sheets(io.BytesIO(content))
        tables: dict[str, list[Sequence[Any]]] = {}
        cells_left = MAX_CELLS
        for name, rows in sheets:
            tables[name] = expand_rows(rows, cells_left)
            cells_left -= len(tables[name]) * _table_width(tables[name])
        return tables


def _may_be_record(table: Sequence[Sequence[Any]]) -> bool:
    """Return True for a sheet with many rows that have two numbers in its middle and at its end."""
    rows = (table[len(table) // 2], table[-1]) if len(table) > _FEWEST_ROWS else ()
    counts = [sum(is_number(_cell_text(value), ".") for value in row) for row in rows]
    return min(counts, default=0) > 1


def _table_width(table: Sequence[Sequence[Any]]) -> int:
    return max(map(len, table), default=0)


def _sheet_to_csv(table: Sequence[Sequence[Any]]) -> str:
    """Write a sheet as text; numbers of cells stay exact."""
    width = _table_width(table)
    written = io.StringIO()
    csv.writer(written, delimiter="\t").writerows(
        itertools.chain(map(_cell_text, row), itertools.repeat("", width - len(row))) for row in table
    )
    return written.getvalue()


def _cell_text(value: Any) -> str:
    if value is None or (isinstance(value, str) and value.startswith("#") and value in _ERRORS):
        return ""
    if isinstance(value, datetime.datetime | datetime.time):
        return value.isoformat()
    return " ".join(str(value).split())


# Limits ----------------------------------------------------------------------------------------


def _too_large_error(what: str) -> RecordError:
    return RecordError(f"{what}: save the columns that are wanted as CSV")


def check_archive_sizes(archive: ZipFile) -> None:
    """Refuse an archive whose parts of XML hold too much, before any of them is read."""
    parts: dict[str, list[ZipInfo]] = {start: [] for start in _PARTS}
    for info in archive.infolist():
        if info.filename.endswith((".xml", ".rels")):
            parts[next(start for start in _PARTS if info.filename.startswith(start))].append(info)
    for start, most in _PARTS.items():
        size = sum(info.file_size for info in parts[start]) / 2**20
        if size > most.megabytes:
            raise _too_large_error(
                f"its parts {start or 'besides sheets and texts'} unpack to {size:.0f} MB; at most "
                f"{most.megabytes} MB are read"
            )
        elements = itertools.count(1)
        for info in parts[start]:
            with archive.open(info) as part:
                _check_element_count(info.filename, part, elements, most.elements)


def _check_element_count(name: str, part: IO[bytes], elements: Iterator[int], max_elements: int) -> None:
    rows = itertools.count(1)

    def begin(kind: str, _attributes: object) -> None:
        if next(elements) > max_elements:
            raise _too_large_error(f"{name} in it, and those before, hold more than {max_elements} elements")
        if kind.endswith("row") and next(rows) > MAX_ROWS:
            raise _too_large_error(f"{name} in it holds more than {MAX_ROWS} rows, the limit")

    def refuse(*_declared: object) -> None:
        raise _too_large_error(f"{name} in it declares entities, which no workbook needs")

    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler = begin
    parser.EntityDeclHandler = refuse
    parser.ParseFile(part)


def expand_rows(rows: Rows, max_cells: int = MAX_CELLS) -> list[Sequence[Any]]:
    """List the rows up to the last that holds something, with repeated ones repeated."""
    table: list[Sequence[Any]] = []
    number = widest = 0
    for repeat, cells in rows:
        number += repeat
        width = next((k for k in range(len(cells), 0, -1) if cells[k - 1] is not None), 0)
        if not width:
            continue
        widest = max(widest, width)
        if number > MAX_ROWS or number * widest > max_cells:
            raise _too_large_error(
                f"a sheet reaches to row {number} and column {widest}; at most {MAX_ROWS} rows, "
                f"and {MAX_CELLS} cells of all sheets, are read"
            )
        table += [()] * (number - repeat - len(table))
        table += [cells[:width]] * repeat
    return table


# Excel -----------------------------------------------------------------------------------------


def iterate_excel_sheets(file: IO[bytes]) -> Iterator[tuple[str, Rows]]:
    """Yield the sheets of a workbook in Office Open XML (.xlsx)."""
    import openpyxl

    with warnings.catch_warnings(action="ignore"):  # of parts that are no table
        book = openpyxl.load_workbook(file, read_only=True, data_only=True, keep_links=False)
        for sheet in book.worksheets:
            sheet.reset_dimensions()  # those that are written may be wrong
            yield sheet.title, ((1, row) for row in sheet.iter_rows(values_only=True))


# LibreOffice -----------------------------------------------------------------------------------

_OFFICE, _TABLE, _TEXT = (
    f"{{urn:oasis:names:tc:opendocument:xmlns:{name}:1.0}}" for name in ("office", "table", "text")
)
_CELLS = (f"{_TABLE}table-cell", f"{_TABLE}covered-table-cell")
_VALUES = {"date": "date-value", "time": "time-value", "boolean": "boolean-value"}
_DURATION = re.compile(r"PT(\d+)H(\d+)M(\d+(?:[.,]\d+)?)S", re.ASCII)


def iterate_libre_office_sheets(archive: ZipFile) -> Iterator[tuple[str, Rows]]:
    """Yield the sheets of an OpenDocument spreadsheet (.ods)."""
    with archive.open("content.xml") as part:
        events = iterparse(part, ("start", "end"))
        for event, element in events:
            if (event, element.tag) == ("start", f"{_TABLE}table"):
                yield element.get(f"{_TABLE}name", ""), _rows_of_open_table(events)


def _rows_of_open_table(events: Iterator[tuple[str, Element]]) -> Rows:
    for event, element in events:
        if event == "start":
            continue
        if element.tag == f"{_TABLE}table-row":
            yield _repeat_count(element, "rows"), _row_cells(element)
            element.clear()
        elif element.tag == f"{_TABLE}table":
            return


def _repeat_count(element: Element, what: str) -> int:
    return int(element.get(f"{_TABLE}number-{what}-repeated", "1"))


def _row_cells(row: Element) -> list[Any]:
    cells: list[Any] = []
    empty = 0
    for cell in row:
        if cell.tag not in _CELLS:
            continue
        value, repeat = _cell_value(cell), _repeat_count(cell, "columns")
        if value is None:
            empty += repeat
            continue
        if len(cells) + empty + repeat > MAX_CELLS:
            raise _too_large_error(f"a row has more than {MAX_CELLS} cells, the limit")
        cells += [None] * empty + [value] * repeat
        empty = 0
    return cells


def _cell_value(cell: Element) -> str | None:
    kind = cell.get(f"{_OFFICE}value-type")
    if kind is None:
        return None
    value = cell.get(f"{_OFFICE}{_VALUES.get(kind, 'value')}")
    if value is None:
        return " ".join(map(_paragraph_text, cell.findall(f"{_TEXT}p"))) or None
    if kind == "date" and "T" not in value:
        return f"{value}T00:00:00"
    duration = _DURATION.fullmatch(value) if kind == "time" else None
    return value if duration is None else ":".join(duration.groups())


def _paragraph_text(paragraph: Element) -> str:
    for space in paragraph.iter(f"{_TEXT}s"):
        space.text = " "
    return "".join(paragraph.itertext())
