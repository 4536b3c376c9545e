"""Binary files that libraries read: workbooks, MATLAB files and Parquet.

Workbooks, MATLAB files and TDMS files can be compressed, repeat cells or nest arrays, so a small file may
expand to a large amount of data. The libraries that read them do not limit their use of memory. They
therefore run in a separate process with limited memory and time; only this process is killed if it exceeds a
limit. The functions in this module also limit the size of the result.
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

from granular.records.headings import TIME, guess_column_role, name_and_unit, split_header_into_name_and_unit
from granular.records.options import ReadOptions, note_on_other_tables
from granular.records.sheet import Column, Sheet, convert_parsing_errors, is_number_or_timestamp
from granular.records.text import read_delimited
from granular.shared.errors import RecordError, quote
from granular.shared.files import write_atomically

MAX_MEGABYTES, MAX_SECONDS = 2048, 20
"""Limits of memory [MB] and processor time [s] for reading a file. An Excel sheet with four full columns
needs half of the memory and half of the time.
"""
MAX_NUMBERS = 50_000_000
"""Maximum number of values in a file, such as five columns of ten million values; reading takes 1.5 GB."""
_TIMEOUT_FACTOR = 6.0
"""Maximum elapsed time divided by maximum processor time; other programs may delay the reading."""
_OUT_OF_MEMORY = 3
_AT_A_LIMIT = {_OUT_OF_MEMORY, *(-getattr(signal, name, 0) for name in ("SIGXCPU", "SIGKILL", "SIGABRT"))}
_PROGRAM = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from granular.records.binary import read_stdin_and_write_content
from granular.records.{module} import {function}
read_stdin_and_write_content({function})
"""
_REMEDY = "save only time and height, as CSV"

Content = tuple[Any, list[np.ndarray]]
"""Content of a file: nested lists and dicts of strings and integers, and a list of arrays. The integers are
indices in this list.
"""


def read_in_limited_process(read: Callable[[bytes], Content], content: bytes) -> Content:
    """Run a reader on a file's bytes in a process with limited memory and time; return the file's content."""
    program = _PROGRAM.format(module=read.__module__.rpartition(".")[2], function=read.__name__)
    if not sys.executable or getattr(sys, "frozen", False):
        raise RecordError(
            f"cannot be read, since this program has no Python interpreter for a separate process; {_REMEDY}"
        )
    try:
        # The new process is isolated and has this process's path: no code from the working directory is run.
        done = subprocess.run(
            [sys.executable, "-I", "-c", program, json.dumps([item for item in sys.path if item])],
            input=content,
            capture_output=True,
            check=False,
            timeout=_TIMEOUT_FACTOR * MAX_SECONDS,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
    except OSError as error:
        raise RecordError(
            f"cannot be read, since a new Python process fails to start: {error.strerror}; {_REMEDY}"
        ) from None
    except subprocess.TimeoutExpired:
        done = None
    if done is None or done.returncode in _AT_A_LIMIT:
        raise RecordError(
            f"cannot be read within the limits of {MAX_MEGABYTES} MB and {MAX_SECONDS} s; {_REMEDY}"
        )
    if done.returncode == 1:  # an uncaught exception: a fault of this code
        raise RuntimeError(done.stderr.decode(errors="replace"))
    if done.returncode or not done.stdout:
        raise RecordError(f"crashes the process that reads it (exit code {done.returncode}); {_REMEDY}")
    encoded, *arrays = np.load(io.BytesIO(done.stdout), allow_pickle=False).values()
    plain = json.loads(encoded.tobytes())
    if isinstance(plain, str):
        raise RecordError(plain)
    return plain, arrays


def read_stdin_and_write_content(read: Callable[[bytes], Content]) -> None:
    """Read a file from standard input with a reader; write the content or the error to standard output."""
    _limit_memory_and_time()
    # Other print-outs must not mix with the result.
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


def check_number_count(numbers: int) -> None:
    """Raise an error if a file has more than `MAX_NUMBERS` numbers."""
    if numbers > MAX_NUMBERS:
        raise RecordError(
            f"holds {numbers} numbers; the limit is {MAX_NUMBERS}: save only time and height, or sample "
            "less often"
        )


def _limit_memory_and_time() -> None:
    """Limit memory and time of this process; Windows supports neither, macOS only a limit of time."""
    with contextlib.suppress(ImportError):
        import resource

        limits = {"RLIMIT_AS": MAX_MEGABYTES * 2**20, "RLIMIT_CPU": MAX_SECONDS, "RLIMIT_CORE": 0}
        for name, limit in limits.items():
            with contextlib.suppress(ValueError, OSError):
                kind = getattr(resource, name)
                hard = resource.getrlimit(kind)[1]
                resource.setrlimit(kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard),) * 2)


# Workbooks ---------------------------------------------------------------------------------------

MAX_WORKBOOK_BYTES = 64 * 2**20
_MIN_ROWS = 20
"""A sheet is regarded as a record only if it has more rows than this."""
_MAX_CELLS, _MAX_CHARACTERS = 2**22, 2**26
"""Maximum numbers of cells (four full columns) and of characters in all sheets of a workbook together."""
_MAX_CHARACTERS_PER_CELL = 2**15
"""Maximum number of characters in a cell, as in Excel."""
_ERRORS = ("#NULL!", "#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#NUM!", "#N/A")
"""Texts of cells whose formula failed."""
_DURATION = re.compile(r"PT(\d+)H(\d+)M(\d+(?:[.,]\d+)?)S", re.ASCII)
"""A LibreOffice duration, which the library calamine returns as text if it is long or has a decimal comma."""

Table = Sequence[Sequence[str]]


def read_workbook(content: bytes, options: ReadOptions) -> Sheet:
    """Read the sheet that the option ``sheet`` names, or else the workbook's first sheet with a table."""
    sheets, _ = read_in_limited_process(read_sheet_cells, content)
    tables: Mapping[str, Table] = options.select_table(sheets, "sheet")
    first_error: RecordError | None = None
    for name, table in tables.items():
        try:
            sheet = read_delimited(
                _sheet_to_tab_separated_text(table), None, options.skip, 2 if options.rate is None else 1
            )
        except RecordError as error:
            first_error = first_error or error
            continue
        sheet.form = f"sheet {quote(name)} of a workbook"
        others = [other for other, cells in tables.items() if other != name and _may_be_record(cells)]
        if others:
            sheet.notes.append(note_on_other_tables("sheet", [name, *others]))
        return sheet
    raise first_error or RecordError("holds no sheet; save the table in a sheet")


def read_sheet_cells(content: bytes) -> Content:
    """Return the cells of all sheets as strings, row by row, up to the last cell with content."""
    from python_calamine import CalamineWorkbook, SheetTypeEnum

    with convert_parsing_errors("a workbook"):
        book = CalamineWorkbook.from_filelike(io.BytesIO(content))
        names = [sheet.name for sheet in book.sheets_metadata if sheet.typ == SheetTypeEnum.WorkSheet]
        tables: dict[str, list[list[str]]] = {}
        cells_left, characters_left = _MAX_CELLS, _MAX_CHARACTERS
        for name in names:
            sheet = book.get_sheet_by_name(name)
            rows, columns = sheet.total_height + 1, sheet.total_width + 1  # counted from 0
            cells_left -= rows * columns
            if cells_left < 0:
                raise RecordError(
                    f"sheet {quote(name)} extends to row {rows} and column {columns}; the limit over all "
                    f"sheets is {_MAX_CELLS} cells: save the columns that you need as CSV"
                )
            tables[name] = [list(map(_cell_text, row)) for row in sheet.to_python(skip_empty_area=False)]
            characters_left -= sum(len(text) for row in tables[name] for text in row)
            if characters_left < 0:
                raise RecordError(
                    f"the cells hold more than {_MAX_CHARACTERS} characters, which is the limit; save the "
                    "columns that you need as CSV"
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
    if len(text) > _MAX_CHARACTERS_PER_CELL:
        raise RecordError(
            f"a cell holds {len(text)} characters; the limit is {_MAX_CHARACTERS_PER_CELL}: empty this cell"
        )
    if duration := _DURATION.fullmatch(text):
        return ":".join(duration.groups()).replace(",", ".")
    return "" if text in _ERRORS else " ".join(text.split())


def _may_be_record(table: Table) -> bool:
    """Return True if a sheet has many rows, and two or more numbers in both the middle and the last row."""
    rows = (table[len(table) // 2], table[-1]) if len(table) > _MIN_ROWS else ()
    counts = [sum(is_number_or_timestamp(text, ".") for text in row) for row in rows]
    return min(counts, default=0) > 1


def _sheet_to_tab_separated_text(table: Table) -> str:
    """Convert a sheet to tab-separated text without rounding its numbers."""
    width = max(map(len, table), default=0)
    written = io.StringIO()
    csv.writer(written, delimiter="\t").writerows(
        itertools.chain(row, itertools.repeat("", width - len(row))) for row in table
    )
    return written.getvalue()


# MATLAB ------------------------------------------------------------------------------------------


def read_matlab(content: bytes, options: ReadOptions) -> Sheet:
    """Read the vectors of a MATLAB file, or of its variable ``sheet``, that have the most frequent length."""
    contents, arrays = read_in_limited_process(list_variables, content)
    variables = dict(options.select_table(contents, "variable"))
    vectors = _numeric_vectors(variables, arrays)
    lengths = [len(values) for values in vectors.values()]
    length = max(lengths, key=lengths.count, default=0)
    columns = [
        Column(*split_header_into_name_and_unit(name), np.asarray(values, dtype=np.float64))
        for name, values in vectors.items()
        if len(values) == length
    ]
    timed = TIME in options.columns or any(guess_column_role(column.name) == TIME for column in columns)
    # PicoScope: the names A, B, ... of its channels do not identify the sensors.
    if "Tinterval" in variables and columns and not timed:
        for column in columns:
            column.is_channel = len(column.name) == 1
        given = {name: arrays[item] if isinstance(item, int) else item for name, item in variables.items()}
        columns.insert(0, _times_from_start_and_interval(given, length))
    if len(columns) < 2:
        raise RecordError(
            f"needs two vectors of equal length; found: "
            f"{', '.join(map(quote, variables)) or 'nothing'}; save time and height as vectors"
        )
    return Sheet(columns, None, any(column.name for column in columns), "MATLAB file")


def list_variables(content: bytes) -> Content:
    """Return each variable by name: the index of its array, or a description if it is not numeric."""
    import scipy.io

    arrays: list[np.ndarray] = []
    with convert_parsing_errors("a MATLAB file"):
        try:
            loaded = scipy.io.loadmat(io.BytesIO(content), squeeze_me=True, simplify_cells=True)
        except NotImplementedError:  # version 7.3
            from granular.records.matlab_hdf5 import load_hdf5

            loaded = load_hdf5(content, check_number_count)
        named = {name: value for name, value in loaded.items() if not name.startswith("__")}
        variables = _replace_arrays_by_indices(named, arrays)
    check_number_count(sum(array.size for array in arrays))
    return variables, arrays


def _replace_arrays_by_indices(value: Any, arrays: list[np.ndarray]) -> Any:
    if isinstance(value, dict):  # a structure
        return {name: _replace_arrays_by_indices(item, arrays) for name, item in value.items()}
    array = np.asarray(value if isinstance(value, np.ndarray | int | float | complex) else str(value))
    if array.dtype.kind in "iufc":
        arrays.append(array)
        return len(arrays) - 1
    return f"of the type {array.dtype}" if isinstance(value, np.ndarray) else str(value)


def _times_from_start_and_interval(given: Mapping[str, Any], length: int) -> Column:
    """Compute the sampling times [s] of a PicoScope file from its first time and its sampling interval."""
    first, step = (
        value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value
        for value in (given.get("Tstart", 0.0), given["Tinterval"])
    )
    if not _is_finite_number(first) or not _is_finite_number(step) or step <= 0.0:
        raise RecordError(
            f"Tstart = {quote(first)} and Tinterval = {quote(step)} do not give the sampling "
            "times; give a start and an interval above 0, both in s, or save the times as a vector"
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
    with convert_parsing_errors("Parquet", "pyarrow", "parquet"):
        import pyarrow.parquet

        source = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(content))
        schema, rows = source.schema_arrow, source.metadata.num_rows
        # Texts may expand far beyond the size of the file, and are not needed.
        numeric = [field.name for field in schema if _is_numeric_type(field.type)]
        if rows * len(numeric) > MAX_NUMBERS:
            raise RecordError(
                f"holds {rows} rows of {len(numeric)} columns of numbers; the limit is "
                f"{MAX_NUMBERS} numbers: drop columns, or sample less often"
            )
        table = source.read(columns=numeric)
    notes: list[str] = []
    read: dict[str, list[Any]] = {}  # several columns may share a name
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
            columns[-1].first_invalid = (0, f"of the type {column.type}")
    return Sheet(columns, None, True, "Parquet", notes)


def write_parquet(path: Path, columns: Mapping[str, np.ndarray], units: Mapping[str, str]) -> None:
    """Write columns to a Parquet file, with their units in the metadata of the fields."""
    with convert_parsing_errors("Parquet", "pyarrow", "parquet"):
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
