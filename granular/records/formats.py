"""Files of all formats: reading them as tables (`sheet`), and choosing the columns of time and motion."""

from __future__ import annotations

import codecs
import contextlib
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.records.binary import MAX_WORKBOOK_BYTES, read_matlab, read_parquet, read_workbook
from granular.records.headings import (
    ACCELERATION,
    FORCE,
    TIME,
    guess_column_role,
    has_dimension_of_any,
    normalize_unit,
)
from granular.records.instruments import LABVIEW, RIGOL, read_labview, read_rigol, read_tdms
from granular.records.interpret import (
    SheetInterpretation,
    interpret_sheet,
    require_numeric_values,
    spread_rounded_times,
)
from granular.records.options import ReadOptions, described_file_and_options, name_description_in_errors
from granular.records.roles import find_time_column, is_row_number_column
from granular.records.sheet import Column, Sheet
from granular.records.text import read_delimited
from granular.schema.units import unit_size
from granular.shared.array_types import Float
from granular.shared.errors import RecordError, RecordWarning, SceneError, quote, sanitize
from granular.shared.files import read_bytes
from granular.shared.registry import Registry

__all__ = ["FileFormat"]

MAX_BYTES = 256 * 2**20
"""Maximum size of a file."""
_MAX_LINES = 3_000_000
"""Maximum number of lines in a text; reading takes 500 bytes of memory per line."""

_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_LEGACY = "cp1252"
"""Default encoding of Windows in Western Europe and America."""
_ROLES = {"N": FORCE, "m/s^2": ACCELERATION}
"""Role of the column to be read, for each SI unit of its values."""
_BEGINNINGS = {
    ".xlsx": re.compile(rb"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"),  # Excel 97 to 2003
    ".uff": re.compile(rb"\s*-1[ \t]*\r?\n[ \t]*\d{2,4}b?[ \t\r\n]"),  # -1, then a data set's number
    ".mf4": re.compile(rb"MDF {5}|UnFinMF "),
}
"""First bytes of binary formats, for files with a misleading suffix such as .xls or .dat."""
_MAX_SHOWN = 20


class FileFormat(NamedTuple):
    """A format of record files.

    Attributes
    ----------
    read : function
        Function that takes the file's bytes and the `ReadOptions`, and returns a `Sheet`.
    max_bytes : int
        Maximum size of a file [bytes].
    """

    read: Callable[[bytes, ReadOptions], Sheet]
    max_bytes: int = MAX_BYTES


def interpret_record_file(
    path: Path, options: ReadOptions, file_format: FileFormat | None = None
) -> SheetInterpretation:
    """Read a file, or the file named in a record description; return its columns in SI with their roles."""
    file, described = described_file_and_options(path, options)
    complete_options = _options_with_calibration_points(path, described)
    with name_description_in_errors(path, file):
        sheet = read_sheet(file, complete_options, file_format if file == path else None)
        with _name_file_in_errors(file):
            return interpret_sheet(sheet, complete_options)


def _options_with_calibration_points(path: Path, options: ReadOptions) -> ReadOptions:
    """Return the options with the calibration points read from their files."""
    calibrations = {}
    for column, given in options.calibrations().items():
        if isinstance(given.get("points"), str):
            file = Path(given["points"])
            with name_description_in_errors(path, file):
                calibrations[column] = {**given, "points": _read_calibration_points(file)}
    return options.merge(ReadOptions(calibration=calibrations)) if calibrations else options


def _read_calibration_points(path: Path) -> dict[str, Any]:
    """Read calibration points from a file with the columns raw, value and optionally uncertainty."""
    sheet = read_sheet(path, ReadOptions())
    with _name_file_in_errors(path):
        if len(sheet.columns) < 2:
            raise RecordError("holds one column only; give the columns raw, value and uncertainty")
        columns = dict(zip(("raw", "value", "uncertainty"), sheet.columns, strict=False))
        points: dict[str, Any] = {
            name: require_numeric_values(sheet, name, column).tolist() for name, column in columns.items()
        }
    points["units"] = {name: column.unit for name, column in columns.items() if column.unit}
    return points


def read_sheet(path: Path, options: ReadOptions, file_format: FileFormat | None = None) -> Sheet:
    """Read the columns of a file; the suffix of the file's name selects a binary format."""
    ending = path.suffix.lower()
    read, max_bytes = file_format or (TEXT if ending in TEXT_ENDINGS else READERS.get(ending, TEXT))
    content = [read_bytes(path, max_bytes, RecordError)]
    with _name_file_in_errors(path):
        return read(content.pop(), options)  # popped, so that the reader can free the bytes


@contextlib.contextmanager
def _name_file_in_errors(path: Path) -> Iterator[None]:
    """Put the name of a file at the beginning of errors that the block raises."""
    try:
        yield
    except RecordError as error:
        raise RecordError(f"{sanitize(path)}: {error}") from None


# Text ------------------------------------------------------------------------------------------


def read_text_table(content: bytes, options: ReadOptions) -> Sheet:
    """Read the table of a text file in any encoding that is usual for instruments."""
    for suffix, beginning in _BEGINNINGS.items():
        if beginning.match(content):
            return READERS.find(suffix).read(content, options)
    text, encoding = _decode_text_and_detect_encoding(content)
    del content  # may be hundreds of megabytes
    count = 1 + max(text.count("\n"), text.count("\r"))
    if count > _MAX_LINES:
        raise RecordError(
            f"has {count} lines; the limit is {_MAX_LINES}: sample less often, or split the file"
        )
    if LABVIEW.match(text):
        sheet = read_labview(text, options)
    elif RIGOL.match(text):
        sheet = read_rigol(text)
    else:
        sheet = read_delimited(text, options.decimal, options.skip, 2 if options.rate is None else 1)
    if encoding not in ("utf-8", "utf-8-sig"):
        sheet.form += f", in {encoding}"
    return sheet


def _decode_text_and_detect_encoding(content: bytes) -> tuple[str, str]:
    """Decode bytes to text; return the text and its encoding."""
    marked = next((name for mark, name in _MARKS if content.startswith(mark)), None)
    if marked is None and b"\0" in content[:4096]:
        marked = _utf16_encoding(content)
    encoding = marked or "utf-8"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        if marked is not None:
            raise _not_a_text_error(str(error)) from None
        text, encoding = content.decode(_LEGACY, errors="replace"), _LEGACY
    if any(character in text[:65536] for character in "\0\x01\x02\x03\x04\x05\x06\x08"):
        raise _not_a_text_error("it holds control characters")
    return text, encoding


def _utf16_encoding(content: bytes) -> str | None:
    """Return the byte order of UTF-16 if it puts a zero in every other byte, as in Latin text; else None."""
    start = content[: min(len(content), 4096) // 2 * 2]
    even_bytes, odd_bytes = start[::2].count(0), start[1::2].count(0)
    if odd_bytes > 0.4 * len(start) / 2 and not even_bytes:
        return "utf-16-le"
    return "utf-16-be" if even_bytes > 0.4 * len(start) / 2 and not odd_bytes else None


def _not_a_text_error(reason: str) -> RecordError:
    return RecordError(
        f"cannot be read as text: {sanitize(reason)}; save it as CSV in UTF-8, or in a format with one "
        f"of these suffixes: {', '.join(READERS)}"
    )


TEXT = FileFormat(read_text_table)
TEXT_ENDINGS = frozenset((".csv", ".txt", ".dat", ".tsv"))
"""Suffixes of files that are always read as text; installed packages cannot add a format for them."""
PARQUET = FileFormat(read_parquet)
_WORKBOOK = FileFormat(read_workbook, MAX_WORKBOOK_BYTES)
READERS = Registry[FileFormat](
    "suffix of a record file",
    "granular.readers",
    {
        ".parquet": PARQUET,
        ".pq": PARQUET,
        ".xlsx": _WORKBOOK,
        ".xlsm": _WORKBOOK,
        ".xlsb": _WORKBOOK,
        ".ods": _WORKBOOK,
        ".tdms": FileFormat(read_tdms),
        ".mat": FileFormat(read_matlab),
        **dict.fromkeys((".uff", ".unv"), "granular.records.universal:UNIVERSAL"),
        **dict.fromkeys((".mf4", ".mdf"), "granular.records.mdf:MEASUREMENT"),
    },
    lambda ending, form: (
        isinstance(form, FileFormat) and ending == "." + ending[1:].lower() and ending not in TEXT_ENDINGS
    ),
    "a granular.records.formats.FileFormat for a suffix in lower case that is not a text suffix",
)
"""Formats by suffix; any other file is read as text."""


# A time and one other column -------------------------------------------------------------------


def read_times_and_values(path: Path, unit: str) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Read times [s] and the values of one other column, in SI, from a file."""
    sheet = read_sheet(path, ReadOptions())
    with _name_file_in_errors(path):
        time = find_time_column(sheet)
        value_column = _choose_value_column(sheet, time, unit)
        name = sanitize(value_column.name) or f"column {sheet.columns.index(value_column) + 1}"
        times, values = _column_in_si(sheet, TIME, time, "s"), _column_in_si(sheet, name, value_column, unit)
    complete, notes = np.isfinite(times) & np.isfinite(values), list(sheet.notes)
    if not complete.all():
        first = sheet.describe_row(int(np.argmin(complete)))
        notes.append(
            f"{(~complete).sum()} of {len(complete)} samples are incomplete and are dropped; the first of "
            f"them is {first}"
        )
    times = spread_rounded_times(times[complete], notes)
    if notes:
        warnings.warn(f"{sanitize(path)}: {'; '.join(notes)}", RecordWarning, stacklevel=2)
    return times, values[complete]


def _choose_value_column(sheet: Sheet, time: Column, unit: str) -> Column:
    """Choose the column of values: the only one, or by unit or name; the first if all are nameless."""
    others = [
        column for column in sheet.columns if column is not time and not is_row_number_column(sheet, column)
    ]
    choices: Sequence[list[Column]] = (
        others,
        [column for column in others if has_dimension_of_any(column.unit, unit)],
        [column for column in others if guess_column_role(column.name) == _ROLES.get(unit, "")],
        [] if any(column.name for column in others) else others[:1],
    )
    chosen = next((columns for columns in choices if len(columns) == 1), None)
    if chosen is None:
        names = ", ".join(quote(column.name) for column in others[:_MAX_SHOWN])
        raise RecordError(
            f"holds {len(others)} columns in addition to the time ({names}); keep one of them, or mark it by "
            f"a unit after its name, such as 'value [{unit}]'"
        )
    return chosen[0]


def _column_in_si(sheet: Sheet, name: str, column: Column, target_unit: str) -> Float[np.ndarray, "n"]:
    """Convert the numbers of a column to SI; numbers without a unit are taken as SI."""
    values = require_numeric_values(sheet, name, column)
    if column.unit is None or column.timestamp_kind:
        return values
    try:
        size, dimension = unit_size(normalize_unit(column.unit))
    except SceneError as error:
        raise RecordError(f"{name}: {error}") from None
    if dimension not in (unit_size(target_unit)[1], unit_size("1")[1]):
        raise RecordError(
            f"{name}: the unit {quote(column.unit)} does not fit; a unit like {target_unit} is needed: "
            "correct the unit, or convert the numbers"
        )
    return values * size
