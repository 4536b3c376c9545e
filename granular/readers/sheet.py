"""Sheets: columns of numbers with their names and units, of a file or of a table in memory."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping
from decimal import Decimal
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.readers.column_headers import name_and_unit
from granular.readers.role_units import size_of_quantity
from granular.readers.table_cells import LOST, parse_timestamps
from granular.shared.errors import RecordError
from granular.shared.message_text import quote, sanitize

if TYPE_CHECKING:
    from jaxtyping import Float, Int


IN_MEMORY = ("xarray", "DataFrame", "columns")
"""Forms of a sheet that is no file's."""


@dataclasses.dataclass(eq=False)
class Column:
    """A column of a sheet."""

    name: str  # as in the file; empty: none
    unit: str | None  # as in the file
    values: Float[np.ndarray, "n"] | None  # NaN for lost samples; None: not all numbers
    wrong: tuple[int, str] | None = None  # first row, from 0, that is no number, and its text
    clock: str = ""  # read as seconds: date or clock; empty: numbers
    channel: bool = False  # the name is that of an instrument's input
    heading: str = ""  # as in the file, the unit included; empty: the name

    def is_called(self, words: str) -> bool:
        """Return True for the column's name, or its heading as it stands in the file."""
        wanted = " ".join(words.lower().split())
        return wanted in (" ".join(name.lower().split()) for name in (self.name, self.heading) if name)


@dataclasses.dataclass(eq=False)
class Sheet:
    """A table of a file."""

    columns: list[Column]
    lines: Int[np.ndarray, "n"] | None  # line of the file of each row; None: no lines
    header: bool  # the file names its columns
    form: str  # what the file is, in words
    notes: list[str] = dataclasses.field(default_factory=list)  # what was done to it

    def describe_row(self, row: int) -> str:
        """Name a row in words, with its line in the file."""
        if self.lines is None:
            return f"sample {row}"
        return f"sample {row} (line {int(self.lines[row])})"


@contextlib.contextmanager
def report_parsing_errors(kind: str, package: str = "", extra: str = "") -> Iterator[None]:
    """Turn errors of any kind, from a library that reads a file, into one line."""
    try:
        yield
    except (RecordError, MemoryError):  # the latter ends the process that reads
        raise
    except ImportError:
        raise RecordError(
            f"{kind} needs {package}, which is not installed; pip install "
            f"'granular-damper[{extra}]', or save it as CSV"
        ) from None
    except Exception as error:  # each library has its own kinds, and its versions others
        words = sanitize(" ".join(str(error).split()))
        raise RecordError(f"cannot be read as {kind}: {words}; save it anew, or as CSV") from None


def sheet_from_table(table: Any) -> Sheet:
    """Make a sheet of a DataFrame or Series, an xarray object, or a mapping of names to arrays."""
    if hasattr(table, "to_frame") and not hasattr(table, "columns") and hasattr(table, "iloc"):
        table = table.to_frame(table.name or "height")  # a Series
    if hasattr(table, "to_dataset") and hasattr(table, "dims"):  # a DataArray
        table = table.to_dataset(name=table.name or "height")
    if hasattr(table, "data_vars"):
        columns = {
            name: (variable.values, variable.attrs.get("units"))
            for name, variable in table.variables.items()
            if variable.ndim == 1
        }
        form = "xarray"
    elif hasattr(table, "iloc") and hasattr(table, "columns"):
        if table.index.name is not None:
            table = table.reset_index()
        elif table.index.dtype.kind in "mMf":  # times, without a name
            table = table.rename_axis("time").reset_index()
        columns = {name: split_quantity(table[name].to_numpy()) for name in table.columns}
        form = "DataFrame"
    else:
        columns = {name: split_quantity(table[name]) for name in _column_names(table)}
        form = "columns"
    lengths = {len(values) for values, _ in columns.values()}
    if len(lengths) > 1:
        raise RecordError(f"columns have the lengths {sorted(lengths)}; give columns of one length")
    notes: list[str] = []
    sheet_columns = [_make_column(str(name), *column, notes) for name, column in columns.items()]
    for column, heading in zip(sheet_columns, columns, strict=True):
        column.heading = str(heading)
    return Sheet(sheet_columns, None, True, form, notes)


def _column_names(table: Any) -> list[str]:
    """Names of the columns of a mapping, of a table of polars or pyarrow, or of a structured array."""
    if isinstance(table, Mapping):
        return list(table)
    names = getattr(table, "column_names", getattr(table, "columns", None))
    names = getattr(getattr(table, "dtype", None), "names", None) if names is None else names
    if names is None:
        raise RecordError(
            f"{quote(type(table).__name__)} is no table; give a DataFrame, an xarray object or a "
            "mapping of names to arrays"
        )
    return list(names)


def split_quantity(values: Any) -> tuple[np.ndarray, str | None]:
    """Numbers of an array, and the unit that a quantity of pint or astropy carries with them."""
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
    """Copy of a column in double precision and SI: neither truth values, texts nor complex numbers."""
    try:
        given, unit = split_quantity(values)
        if given.dtype.kind not in "iufO" or np.ma.is_masked(values):
            raise TypeError
        if given.dtype.kind == "O" and not all(isinstance(number, Real | Decimal) for number in given.flat):
            raise TypeError
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise RecordError(
            f"{sanitize(name)}: holds something that is not a number; give finite real numbers"
        ) from None
    return array * size_of_quantity(name, unit) if unit else array


def _make_column(header: str, values: np.ndarray, label: str | None, notes: list[str]) -> Column:
    name, unit = name_and_unit(header, label, notes)
    if values.dtype.kind in "iuf":
        return Column(name, unit, values.astype(np.float64))
    if values.dtype.kind in "mM":
        seconds = (values - values[0]) / np.timedelta64(1, "ns") * 1e-9
        return Column(name, "s", np.asarray(seconds, dtype=np.float64), clock="date")
    try:
        if values.dtype.kind == "O" and not any(isinstance(value, str | bool) for value in values):
            return Column(name, unit, np.array(values, dtype=np.float64))
    except (TypeError, ValueError):
        pass
    texts = [str(value) for value in values]
    stamps = parse_timestamps(texts, LOST)
    if stamps is not None:
        return Column(name, "s", stamps[0], clock=stamps[1])
    return Column(name, unit, None, (0, texts[0] if texts else ""))
