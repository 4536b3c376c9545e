"""Sheets: columns of numbers with names and units, from a file or a table in memory."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal
from numbers import Real
from typing import Any

import numpy as np

from granular.records.headings import name_and_unit, unit_size_of_quantity
from granular.shared.array_types import Float, Int
from granular.shared.errors import RecordError, quote, sanitize

__all__ = ["sheet_from_table"]

IN_MEMORY = ("xarray", "DataFrame", "columns")
"""Values of `Sheet.form` for tables in memory."""


@dataclasses.dataclass(eq=False)
class Column:
    """A column of a sheet."""

    name: str  # name in the file; empty if it has none
    unit: str | None  # as in the file
    values: Float[np.ndarray, "n"] | None  # NaN for missing samples; None if some are not numbers
    first_invalid: tuple[int, str] | None = None  # first row, from 0, that is not a number, and its text
    timestamp_kind: str = ""  # "date" or "clock", converted to seconds; empty: plain numbers
    is_channel: bool = False  # the name is the label of an instrument's input
    heading: str = ""  # heading in the file, with the unit; empty if it is the name

    def has_name(self, words: str) -> bool:
        """Return True if ``words`` is the name of the column, or its heading in the file."""
        requested = words.lower().split()
        return requested in [name.lower().split() for name in (self.name, self.heading) if name]

    @property
    def finite_values(self) -> Float[np.ndarray, "m"]:
        """Return the finite numbers of the column; the array is empty if the column is not numeric."""
        return np.empty(0) if self.values is None else self.values[np.isfinite(self.values)]


@dataclasses.dataclass(eq=False)
class Sheet:
    """A table that was read from a file or from memory."""

    columns: list[Column]
    lines: Int[np.ndarray, "n"] | None  # line number of each row in the file; None: not a text file
    header: bool  # True if the columns have names
    form: str  # description of the format
    notes: list[str] = dataclasses.field(default_factory=list)  # guesses and changes made on reading

    def describe_row(self, row: int) -> str:
        """Describe a row by its number, and by its line in the file."""
        return f"sample {row}" + ("" if self.lines is None else f" (line {int(self.lines[row])})")


@contextlib.contextmanager
def convert_parsing_errors(kind: str, package: str = "", extra: str = "") -> Iterator[None]:
    """Convert any error that a library raises within the block to a one-line `RecordError`."""
    try:
        yield
    except (RecordError, MemoryError):  # a MemoryError ends the reading process
        raise
    except ImportError:
        raise RecordError(
            f"{kind} needs {package}, which is not installed; run pip install "
            f"'granular-damper[{extra}]', or save the data as CSV"
        ) from None
    except Exception as error:  # types of errors differ between libraries and their versions
        words = sanitize(" ".join(str(error).split()))
        raise RecordError(f"cannot be read as {kind}: {words}; save the data again, or as CSV") from None


# Cells -------------------------------------------------------------------------------------------

MISSING = (
    "", "nan", "NaN", "NAN", "na", "NA", "n/a", "N/A", "#N/A", "null", "NULL", "None", "-", "--", "---", "?",
)  # fmt: skip
"""Spellings of a missing sample in files of various programs."""

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?inf(inity)?", re.ASCII | re.I)
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?(Z|[+-]\d\d:?\d\d)?", re.ASCII)
_CLOCK = re.compile(
    r"(?:\d{1,4}[./-]\d{1,2}[./-]\d{1,4},?[ ])?"  # a date in any order, used only to detect midnights
    r"(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:[.,]\d+)?)(?: ?([AP])M)?",
    re.ASCII | re.I,
)
_GROUPED = re.compile(r"[+-]?\d{1,3}(\.\d{3})+,\d+", re.ASCII)
"""A number with a decimal comma and points between groups of thousands."""
_DAY = 86400.0


def is_timestamp(cell: str) -> bool:
    """Return True for a date with a time (ISO 8601), or a time of day."""
    return ":" in cell and (_DATE.fullmatch(cell) or _CLOCK.fullmatch(cell)) is not None


def is_number_or_timestamp(cell: str, decimal: str) -> bool:
    """Return True for a number, a date with a time, or a time of day."""
    if decimal == ",":
        if "." in cell:
            return _GROUPED.fullmatch(cell) is not None or is_timestamp(cell)
        cell = cell.replace(",", ".", 1)
    return _NUMBER.fullmatch(cell) is not None or is_timestamp(cell)


def parse_number(cell: str, decimal: str) -> float:
    """Return the value of a cell that holds a number."""
    return float(cell.replace(".", "").replace(",", ".") if decimal == "," else cell)


def parse_timestamps_and_kind(cells: Sequence[str]) -> tuple[np.ndarray, str] | None:
    """Convert dates or times of day to seconds since the first, and return their kind; None for others."""
    present = [cell for cell in cells if cell not in MISSING]
    for kind, form, parse in (("date", _DATE, _parse_dates), ("clock", _CLOCK, _parse_clock_times)):
        if present and all(map(form.fullmatch, present)):
            seconds = np.full(len(cells), np.nan)
            seconds[[cell not in MISSING for cell in cells]] = parse(present)
            return seconds, kind
    return None


def _parse_dates(cells: Sequence[str]) -> np.ndarray | float:
    import pandas

    try:
        stamps = pandas.to_datetime([cell.replace(",", ".") for cell in cells], utc=True, format="ISO8601")
    except ValueError:  # for example month 13
        return float("nan")
    nanoseconds = stamps.tz_convert(None).to_numpy().astype("datetime64[ns]").astype(np.int64)
    return np.asarray((nanoseconds - nanoseconds[0]) * 1e-9)


def _parse_clock_times(cells: Sequence[str]) -> np.ndarray:
    values = []
    for match in map(_CLOCK.fullmatch, cells):
        assert match is not None
        hours, minutes, seconds, half = match.groups()
        hour = float(hours or 0.0)
        if half:  # 12 AM is midnight
            hour = hour % 12.0 + (12.0 if half in "Pp" else 0.0)
        values.append(3600.0 * hour + 60.0 * float(minutes) + float(seconds.replace(",", ".")))
    times = np.array(values)
    # If the time of day decreases by more than half a day, midnight has passed.
    midnights = np.cumsum(np.diff(times, prepend=times[0]) < -0.5 * _DAY)
    return np.asarray(times + _DAY * midnights - times[0])


# Tables in memory --------------------------------------------------------------------------------


def sheet_from_table(table: Any) -> Sheet:
    """Convert a table in memory to a sheet.

    Parameters
    ----------
    table : DataFrame, Series, xarray object or mapping
        Columns (n,) by name, with units as in ``height [mm]``.

    Returns
    -------
    Sheet
        The columns with their units.

    Raises
    ------
    RecordError
        If ``table`` is not a table, or its columns have different lengths.
    """
    if hasattr(table, "to_frame") and not hasattr(table, "columns") and hasattr(table, "iloc"):
        table = table.to_frame(table.name or "height")  # a Series
    if hasattr(table, "to_dataset") and hasattr(table, "dims"):  # a DataArray
        table = table.to_dataset(name=table.name or "height")
    form = "columns"
    if hasattr(table, "data_vars"):
        form = "xarray"
        given = {
            name: (variable.values, variable.attrs.get("units"))
            for name, variable in table.variables.items()
            if variable.ndim == 1
        }
    elif hasattr(table, "iloc") and hasattr(table, "columns"):
        form = "DataFrame"
        if table.index.name is not None:
            table = table.reset_index()
        elif table.index.dtype.kind in "mMf":  # an unnamed index of times
            table = table.rename_axis("time").reset_index()
        given = {name: split_quantity_into_numbers_and_unit(table[name].to_numpy()) for name in table.columns}
    else:
        given = {name: split_quantity_into_numbers_and_unit(table[name]) for name in _column_names(table)}
    lengths = {len(values) for values, _ in given.values()}
    if len(lengths) > 1:
        raise RecordError(f"columns have the lengths {sorted(lengths)}; give columns of equal length")
    notes: list[str] = []
    columns = [_make_column(str(heading), *column, notes) for heading, column in given.items()]
    return Sheet(columns, None, True, form, notes)


def _column_names(table: Any) -> list[str]:
    """List the columns' names of a mapping, a polars or pyarrow table, or a structured array."""
    if isinstance(table, Mapping):
        return list(table)
    names = getattr(table, "column_names", getattr(table, "columns", None))
    names = getattr(getattr(table, "dtype", None), "names", None) if names is None else names
    if names is None:
        raise RecordError(
            f"{quote(type(table).__name__)} is not a table; give a DataFrame, an xarray object or a "
            "mapping of names to arrays"
        )
    return list(names)


def split_quantity_into_numbers_and_unit(values: Any) -> tuple[np.ndarray, str | None]:
    """Split a pint or astropy quantity into its numbers and its unit; a plain array has no unit."""
    if hasattr(values, "magnitude") and hasattr(values, "units"):
        return np.asarray(values.magnitude), f"{values.units:~}"
    if hasattr(values, "value") and hasattr(values, "unit"):
        return np.asarray(values.value), str(values.unit)
    array = np.asarray(values)
    if array.dtype.kind == "O" and array.size and hasattr(array.flat[0], "magnitude"):  # of pint-pandas
        unit = array.flat[0].units
        return np.array([item.to(unit).magnitude for item in array.flat]), f"{unit:~}"
    return array, None


def numbers_in_si(name: str, values: Any) -> np.ndarray:
    """Copy a column in double precision and SI; raise an error for booleans, strings and complex numbers."""
    try:
        given, unit = split_quantity_into_numbers_and_unit(values)
        if given.dtype.kind not in "iufO" or np.ma.is_masked(values):
            raise TypeError
        if given.dtype.kind == "O" and not all(isinstance(number, Real | Decimal) for number in given.flat):
            raise TypeError
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise RecordError(
            f"{sanitize(name)}: holds a value that is not a number; give finite real numbers"
        ) from None
    return array * unit_size_of_quantity(name, unit) if unit else array


def _make_column(heading: str, values: np.ndarray, label: str | None, notes: list[str]) -> Column:
    name, unit = name_and_unit(heading, label, notes)
    if values.dtype.kind in "iuf":
        return Column(name, unit, values.astype(np.float64), heading=heading)
    if values.dtype.kind in "mM":
        seconds = (values - values[0]) / np.timedelta64(1, "ns") * 1e-9
        return Column(
            name, "s", np.asarray(seconds, dtype=np.float64), timestamp_kind="date", heading=heading
        )
    with contextlib.suppress(TypeError, ValueError):
        if values.dtype.kind == "O" and not any(isinstance(value, str | bool) for value in values):
            return Column(name, unit, np.array(values, dtype=np.float64), heading=heading)
    return column_of_texts(name, unit, [str(value) for value in values], heading)


def column_of_texts(
    name: str,
    unit: str | None,
    texts: Sequence[str],
    heading: str,
    first_invalid: tuple[int, str] | None = None,
) -> Column:
    """Make a column of dates or times of day, or else a non-numeric column with its first invalid row."""
    stamps = parse_timestamps_and_kind(texts)
    if stamps is not None:
        return Column(name, "s", stamps[0], timestamp_kind=stamps[1], heading=heading)
    return Column(name, unit, None, first_invalid or (0, texts[0] if texts else ""), heading=heading)
