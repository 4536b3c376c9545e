"""Tables of numbers in CSV and Parquet files: named columns with units."""

from __future__ import annotations

import collections
import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.shared.errors import RecordError
from granular.shared.files import read_text, reading, replacing
from granular.shared.messages import quoted, visible

if TYPE_CHECKING:
    from types import ModuleType

PARQUET = (".parquet", ".pq")
"""Endings of the names of Parquet files."""
_HEADER = re.compile(r"\s*([^\[\(]*?)\s*(?:[\[\(]\s*([^\]\)]*?)\s*[\]\)])?\s*")
_MOST_BYTES = 256 * 2**20
"""Of a CSV file, some six million samples: reading takes ten times as much memory."""
_MOST_NUMBERS = 2**27
"""In a Parquet file: a gigabyte, whatever little place they take on the disk."""


class Table(NamedTuple):
    """What a file holds.

    Attributes
    ----------
    names : tuple of str
        Of all columns that have one, in lower case.
    columns : dict of str to float64 (n,)
        Those that hold numbers, as they are in the file.
    units : dict of str to str
        Of the columns that say theirs.
    remedy : str
        What to do where a column is missing.
    """

    names: tuple[str, ...]
    columns: dict[str, np.ndarray]
    units: dict[str, str]
    remedy: str


# CSV -------------------------------------------------------------------------------------------


def read_csv(path: Path, needed: Sequence[str]) -> Table:
    """The table in a CSV file; columns in ``needed`` must hold numbers where they are there.

    Raises
    ------
    RecordError
        If the file cannot be read as such; the message names line and column.
    """
    text = read_text(path, _MOST_BYTES, RecordError)
    lines = [line for line in text.splitlines() if line.strip()]
    lines = [line for line in lines if not line.startswith("#")]
    if not lines:
        raise RecordError(f"{visible(path)}: is empty; a header and samples are wanted")
    try:
        delimiter = max(",;\t", key=lambda mark: len(_rows(lines[:1], mark)[0]))
        header, *rows = _rows(lines, delimiter)
    except csv.Error as error:
        raise RecordError(f"{visible(path)}: cannot be read as CSV: {error}") from None
    named = _named(path, header)
    for index, cells in enumerate(rows):
        if len(cells) != len(named):
            raise RecordError(
                f"{visible(path)}: sample {index} has {len(cells)} values for {len(named)} "
                "columns; separate all lines like the first"
            )
    columns = {
        name: numbers
        for k, (name, _) in enumerate(named)
        if name and (numbers := _numbers(path, name, [row[k] for row in rows], needed)) is not None
    }
    return _table(
        named, columns, "name the columns in the first line, such as 'time [s], height [mm]'"
    )


def _rows(lines: list[str], delimiter: str) -> list[list[str]]:
    return list(csv.reader(lines, delimiter=delimiter, skipinitialspace=True))


def _named(path: Path, header: Iterable[str]) -> list[tuple[str, str | None]]:
    """Name and unit of each column; the names differ, but for empty ones."""
    found = [_name_and_unit(cell) for cell in header]
    counts = collections.Counter(name for name, _ in found if name)
    for name, count in counts.items():
        if count > 1:
            raise RecordError(
                f"{visible(path)}: the column {quoted(name)} is there twice; names must differ"
            )
    return found


def _name_and_unit(cell: str) -> tuple[str, str | None]:
    """Name and unit of a column; a header that is not ``name [unit]`` is a name as a whole."""
    match = _HEADER.fullmatch(cell)
    return (match[1].lower(), match[2] or None) if match else (cell.strip().lower(), None)


def _table(
    named: Sequence[tuple[str, str | None]], columns: dict[str, np.ndarray], remedy: str
) -> Table:
    names = tuple(name for name, _ in named if name)
    return Table(names, columns, {name: unit for name, unit in named if name and unit}, remedy)


def _numbers(path: Path, name: str, cells: list[str], needed: Sequence[str]) -> np.ndarray | None:
    """The values of a column; None for one that is not needed and holds something else."""
    values = np.empty(len(cells))
    for index, cell in enumerate(cells):
        try:
            # Python reads 1_0.5 as 10.5, and the digits of all scripts.
            if "_" in cell or not cell.isascii():
                raise ValueError
            values[index] = float(cell)
        except ValueError:
            if name not in needed:
                return None
            raise RecordError(
                f"{visible(path)}: {name} of sample {index} is {quoted(cell)}, not a number; "
                "correct or drop it"
            ) from None
    return values if name in needed or np.isfinite(values).all() else None


# Parquet ---------------------------------------------------------------------------------------


def read_parquet(path: Path, needed: Sequence[str]) -> Table:
    """The table in a Parquet file; columns in ``needed`` must hold numbers where they are there.

    Raises
    ------
    RecordError
        If the file cannot be read as such, or pyarrow is not there.
    """
    parquet = _parquet()
    try:
        with reading(path, _MOST_BYTES, RecordError), path.open("rb") as file:
            source = parquet.ParquetFile(file)
            schema, rows = source.schema_arrow, source.metadata.num_rows
            named = _with_metadata(path, _named(path, schema.names), schema)
            # Texts may be many times as large as the file, and no number.
            wanted = [field.name for field in schema if _is_numeric(field.type)]
            _check_count(path, rows, len(wanted))
            found = source.read(columns=wanted)
    except RecordError:
        raise
    except Exception as error:  # pyarrow raises its own kinds, which its versions name differently
        raise _no_parquet(path, error) from None
    columns = {}
    for field, (name, _) in zip(schema, named, strict=True):
        column = found.column(field.name) if field.name in wanted else None
        if name and column is None and name in needed:
            raise RecordError(
                f"{visible(path)}: {name} holds {visible(field.type)}, not numbers; write it as "
                "numbers"
            )
        numbers = None if column is None else _arrow_numbers(path, name, column, needed)
        if name and numbers is not None:
            columns[name] = numbers
    return _table(named, columns, "rename the columns to time, height")


def _check_count(path: Path, rows: int, columns: int) -> None:
    if rows * columns > _MOST_NUMBERS:
        raise RecordError(
            f"{visible(path)}: holds {rows} rows of {columns} columns of numbers; at most "
            f"{_MOST_NUMBERS} numbers are read: drop columns, or sample less often"
        )


def write_parquet(path: Path, columns: Mapping[str, np.ndarray], units: Mapping[str, str]) -> None:
    """Write columns (n,) to a Parquet file, units in the metadata of the fields.

    Raises
    ------
    RecordError
        If pyarrow is not there.
    InputError
        If it cannot be written; what was there before still stands.
    """
    parquet = _parquet()
    import pyarrow

    fields = [
        pyarrow.field(name, pyarrow.float64(), nullable=False,
                      metadata={"units": units[name]} if name in units else None)
        for name in columns
    ]  # fmt: skip
    arrays = [pyarrow.array(values) for values in columns.values()]
    table = pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields))
    with replacing(path, overwrite=True) as part:
        parquet.write_table(table, part)


def _parquet() -> ModuleType:
    try:
        import pyarrow.parquet
    except ImportError:
        raise RecordError(
            "Parquet files need pyarrow, which is not installed; pip install "
            "'granular-damper[parquet]', or use CSV"
        ) from None
    module: ModuleType = pyarrow.parquet
    return module


def _no_parquet(path: Path, error: Exception) -> RecordError:
    words = " ".join(str(error).split())
    return RecordError(
        f"{visible(path)}: cannot be read as Parquet: {visible(words)}; write it anew, or use CSV"
    )


def _with_metadata(
    path: Path, named: Sequence[tuple[str, str | None]], schema: Any
) -> list[tuple[str, str | None]]:
    """Units from the metadata of the fields too; they may not contradict those in the names."""
    found = []
    for (name, unit), field in zip(named, schema, strict=True):
        metadata = field.metadata or {}
        raw = metadata.get(b"units", metadata.get(b"unit"))
        said = None if raw is None else raw.decode(errors="replace").strip() or None
        if unit and said and unit != said:
            raise RecordError(
                f"{visible(path)}: the column {quoted(name)} has the unit {quoted(unit)} in its "
                f"name and {quoted(said)} in its metadata; correct one of them"
            )
        found.append((name, unit or said))
    return found


def _is_numeric(kind: Any) -> bool:
    import pyarrow

    types = pyarrow.types
    return any(test(kind) for test in (types.is_integer, types.is_floating, types.is_decimal))


def _arrow_numbers(path: Path, name: str, column: Any, needed: Sequence[str]) -> np.ndarray | None:
    """The values of a column; None for one that is not needed and holds something else."""
    import pyarrow

    if column.null_count:
        if name not in needed:
            return None
        sample = column.is_null().to_pylist().index(True)
        raise RecordError(f"{visible(path)}: {name} of sample {sample} is missing; fill or drop it")
    values = np.asarray(column.cast(pyarrow.float64(), safe=False).to_numpy(), dtype=np.float64)
    return values if name in needed or np.isfinite(values).all() else None
