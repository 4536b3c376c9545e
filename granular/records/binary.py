"""Files that libraries read: workbooks, MATLAB's, and Parquet.

Reading of files whose few bytes may stand for many, in a process of limited memory and time.

Workbooks, MATLAB's files and TDMS are squeezed, repeat cells and nest arrays: a library that reads one has no
limit of its own. If its process ends at a limit, this one goes on. What it may hand over is limited by
the readers.
"""

from __future__ import annotations

import contextlib
import csv
import datetime
import io
import itertools
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granular.records.headings import TIME, guess_column_role, name_and_unit, parse_header
from granular.records.options import ReadOptions, note_on_other_tables
from granular.records.sheet import Column, Sheet, is_number, report_parsing_errors
from granular.records.text import read_delimited
from granular.shared.errors import RecordError, quote
from granular.shared.files import write_atomically

MAX_MEGABYTES, MAX_SECONDS = 2048, 20
"""Memory, and processor time, that one file may take: a full sheet of four columns needs half of them."""
MAX_NUMBERS = 50_000_000
"""Numbers of a file, five columns of ten million, in whatever few bytes: reading takes 1.5 GB."""
_WAIT = 6.0
"""Times the seconds after which a process that waits is ended, as on a machine with other work."""
_OUT_OF_MEMORY = 3
_AT_A_LIMIT = {_OUT_OF_MEMORY, *(-getattr(signal, name, 0) for name in ("SIGXCPU", "SIGKILL", "SIGABRT"))}
_PROGRAM = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from granular.records.binary import serve
from granular.records.{module} import {function}
serve({function})
"""
_REMEDY = "save time and height alone, as CSV"

Content = tuple[Any, list[np.ndarray]]
"""Content of a file: texts, integers, lists and dicts of such, and arrays that the integers may count."""


def read_within_limits(read: Callable[[bytes], Content], content: bytes) -> Content:
    """Return what a function of a file of this room reads of bytes."""
    program = _PROGRAM.format(module=read.__module__.rpartition(".")[2], function=read.__name__)
    if not sys.executable or getattr(sys, "frozen", False):
        raise RecordError(f"is read by a Python of its own, and none is known here; {_REMEDY}")
    try:
        # Isolated, and with the present path: nothing of the working directory is run.
        done = subprocess.run(
            [sys.executable, "-I", "-c", program, json.dumps([item for item in sys.path if item])],
            input=content,
            capture_output=True,
            check=False,
            timeout=_WAIT * MAX_SECONDS,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
    except OSError as error:
        raise RecordError(f"is read by a Python of its own, which fails: {error.strerror}") from None
    except subprocess.TimeoutExpired:
        done = None
    if done is None or done.returncode in _AT_A_LIMIT:
        raise RecordError(
            f"takes more than {MAX_MEGABYTES} MB or {MAX_SECONDS} s to read, the limits; {_REMEDY}"
        )
    if done.returncode == 1:  # Python's own, of a fault in here
        raise RuntimeError(done.stderr.decode(errors="replace"))
    if done.returncode or not done.stdout:
        raise RecordError(f"stops what reads it (code {done.returncode}); {_REMEDY}")
    answer, *arrays = np.load(io.BytesIO(done.stdout), allow_pickle=False).values()
    plain = json.loads(answer.tobytes())
    if isinstance(plain, str):
        raise RecordError(plain)
    return plain, arrays


def serve(read: Callable[[bytes], Content]) -> None:
    """Read the bytes of the standard input, and write what they hold, or why they hold nothing."""
    _set_limits()
    # What else is printed must not stand in the answer.
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        try:
            plain, arrays = read(sys.stdin.buffer.read())
        except RecordError as error:
            plain, arrays = str(error), []
        with output:
            np.savez(output, np.frombuffer(json.dumps(plain).encode(), dtype=np.uint8), *arrays)
    except MemoryError:
        sys.exit(_OUT_OF_MEMORY)


def check_count(numbers: int) -> None:
    """Refuse a file of too many numbers."""
    if numbers > MAX_NUMBERS:
        raise RecordError(
            f"holds {numbers} numbers; at most {MAX_NUMBERS} are read: save time and height alone, or sample "
            "less often"
        )


def _set_limits() -> None:
    """Limit memory and time where the system can; Windows cannot, and macOS not the memory."""
    with contextlib.suppress(ImportError):
        import resource

        wanted = {"RLIMIT_AS": MAX_MEGABYTES * 2**20, "RLIMIT_CPU": MAX_SECONDS, "RLIMIT_CORE": 0}
        for name, most in wanted.items():
            with contextlib.suppress(ValueError, OSError):
                kind = getattr(resource, name)
                hard = resource.getrlimit(kind)[1]
                resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard),) * 2)


# Workbooks ---------------------------------------------------------------------------------------

MAX_WORKBOOK_BYTES = 64 * 2**20
_FEWEST_ROWS = 20
"""Rows of a sheet up to which it is no record."""
_MAX_CELLS, _MAX_LETTERS = 2**22, 2**26
"""Cells of all sheets, four columns of as many rows as a sheet has, and letters of all of them."""
_MAX_LETTERS_OF_CELL = 2**15
"""As in Excel."""
_ERRORS = ("#NULL!", "#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#NUM!", "#N/A")
"""Contents of a cell whose formula has no value."""
_DURATION = re.compile(r"PT(\d+)H(\d+)M(\d+(?:[.,]\d+)?)S", re.ASCII)
"""A time of LibreOffice that calamine leaves as it stands: of a day and more, or with a decimal comma."""

Table = Sequence[Sequence[str]]


def read_workbook(content: bytes, options: ReadOptions) -> Sheet:
    """Read a sheet of a workbook: the first that holds a table, or that which is named."""
    every, _ = read_within_limits(list_sheets, content)
    tables: Mapping[str, Table] = options.select_table(every, "sheet")
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


def list_sheets(content: bytes) -> Content:
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
        return tables, []


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


# MATLAB ------------------------------------------------------------------------------------------


def read_matlab(content: bytes, options: ReadOptions) -> Sheet:
    """Read the vectors of one length in a MATLAB file of version 4 to 7."""
    every, arrays = read_within_limits(list_variables, content)
    variables = dict(options.select_table(every, "variable"))
    vectors = _numeric_vectors(variables, arrays)
    lengths = [len(values) for values in vectors.values()]
    length = max(lengths, key=lengths.count, default=0)
    columns = [
        Column(*parse_header(name), np.asarray(values, dtype=np.float64))
        for name, values in vectors.items()
        if len(values) == length
    ]
    timed = TIME in options.columns or any(guess_column_role(column.name) == TIME for column in columns)
    # PicoScope: its channels A, B, ... are whatever was connected.
    if "Tinterval" in variables and columns and not timed:
        for column in columns:
            column.channel = len(column.name) == 1
        given = {name: arrays[item] if isinstance(item, int) else item for name, item in variables.items()}
        columns.insert(0, _sampling_times(given, length))
    if len(columns) < 2:
        raise RecordError(
            f"holds no two vectors of one length; found: "
            f"{', '.join(map(quote, variables)) or 'nothing'}; save time and height as vectors"
        )
    return Sheet(columns, None, any(column.name for column in columns), "MATLAB file")


def list_variables(content: bytes) -> Content:
    """Variables of a file: places among the arrays of those that hold numbers, and words on the others."""
    import scipy.io

    arrays: list[np.ndarray] = []
    with report_parsing_errors("a MATLAB file"):
        try:
            loaded = scipy.io.loadmat(io.BytesIO(content), squeeze_me=True, simplify_cells=True)
        except NotImplementedError:
            raise RecordError(
                "is of MATLAB's version 7.3, which is not read; save it with save(..., '-v7')"
            ) from None
        named = {name: value for name, value in loaded.items() if not name.startswith("__")}
        variables = _without_arrays(named, arrays)
    check_count(sum(array.size for array in arrays))
    return variables, arrays


def _without_arrays(value: Any, arrays: list[np.ndarray]) -> Any:
    if isinstance(value, dict):  # a structure
        return {name: _without_arrays(item, arrays) for name, item in value.items()}
    array = np.asarray(value if isinstance(value, np.ndarray | int | float | complex) else str(value))
    if array.dtype.kind in "iufc":
        arrays.append(array)
        return len(arrays) - 1
    return f"of the type {array.dtype}" if isinstance(value, np.ndarray) else str(value)


def _sampling_times(given: Mapping[str, Any], length: int) -> Column:
    """Return times by PicoScope's start and interval."""
    first, step = (
        value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value
        for value in (given.get("Tstart", 0.0), given["Tinterval"])
    )
    if not _is_finite_number(first) or not _is_finite_number(step) or step <= 0.0:
        raise RecordError(
            f"Tstart = {quote(first)} and Tinterval = {quote(step)}; a start "
            "and an interval above 0, both in s, are wanted: or save the times as a vector"
        )
    return Column(TIME, "s", float(first) + float(step) * np.arange(length))


def _is_finite_number(value: Any) -> bool:
    """Return True for one finite real number."""
    array = np.asarray(value)
    return array.ndim == 0 and array.dtype.kind in "iuf" and bool(np.isfinite(array))


def _numeric_vectors(variables: dict[str, Any], arrays: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    vectors: dict[str, np.ndarray] = {}
    for name, value in variables.items():
        if isinstance(value, dict):  # a structure
            vectors |= _numeric_vectors(value, arrays)
        elif isinstance(value, int):
            array = arrays[value]
            if array.ndim == 1 and array.size > 1 and array.dtype.kind in "iuf":
                vectors[name] = array
            elif array.ndim == 2 and array.dtype.kind in "iuf" and array.shape[1] <= 64 < array.shape[0]:
                vectors |= {f"{name} {k + 1}": column for k, column in enumerate(array.T)}
    return vectors


# Parquet -----------------------------------------------------------------------------------------


def read_parquet(content: bytes, _options: ReadOptions) -> Sheet:
    """Read the columns of a Parquet file, with units in their names or in the fields' metadata."""
    with report_parsing_errors("Parquet", "pyarrow", "parquet"):
        import pyarrow.parquet

        source = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(content))
        schema, rows = source.schema_arrow, source.metadata.num_rows
        # Texts may be many times as large as the file, and no number.
        numeric = [field.name for field in schema if _is_numeric_type(field.type)]
        if rows * len(numeric) > MAX_NUMBERS:
            raise RecordError(
                f"holds {rows} rows of {len(numeric)} columns of numbers; at most "
                f"{MAX_NUMBERS} numbers are read: drop columns, or sample less often"
            )
        table = source.read(columns=numeric)
    notes: list[str] = []
    read: dict[str, list[Any]] = {}  # of one name there may be several
    for field, column in zip(table.schema, table.columns, strict=True):
        read.setdefault(field.name, []).append(column)
    columns = []
    for field in schema:
        columns.append(
            Column(*name_and_unit(field.name, _metadata_unit(field), notes), None, heading=field.name)
        )
        column = read[field.name].pop(0) if field.name in numeric else field
        if _is_numeric_type(column.type):
            values = column.cast(pyarrow.float64(), safe=False).to_numpy()
            columns[-1].values = np.asarray(values, dtype=np.float64)
        else:
            columns[-1].wrong = (0, f"of the type {column.type}")
    return Sheet(columns, None, True, "Parquet", notes)


def write_parquet(path: Path, columns: Mapping[str, np.ndarray], units: Mapping[str, str]) -> None:
    """Write columns to a Parquet file, with units in the metadata of the fields."""
    with report_parsing_errors("Parquet", "pyarrow", "parquet"):
        import pyarrow.parquet

    labels = {name: {"units": units[name]} if name in units else None for name in columns}
    fields = [
        pyarrow.field(name, pyarrow.float64(), nullable=False, metadata=label)
        for name, label in labels.items()
    ]
    arrays = [pyarrow.array(values) for values in columns.values()]
    table = pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields))
    with write_atomically(path, overwrite=True) as part:
        pyarrow.parquet.write_table(table, part)


def _metadata_unit(field: Any) -> str | None:
    metadata = field.metadata or {}
    raw = metadata.get(b"units", metadata.get(b"unit"))
    return None if raw is None else raw.decode(errors="replace").strip() or None


def _is_numeric_type(kind: Any) -> bool:
    import pyarrow

    types = pyarrow.types
    return any(test(kind) for test in (types.is_integer, types.is_floating, types.is_decimal))
