"""Parquet files as sheets, and columns to Parquet."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.readers.names import name_and_unit
from granular.readers.reading import Reading
from granular.readers.sheet import Column, Sheet
from granular.shared.errors import RecordError
from granular.shared.files import reading, replacing
from granular.shared.messages import quoted, visible

if TYPE_CHECKING:
    from types import ModuleType

_MOST_BYTES = 256 * 2**20
_MOST_NUMBERS = 50_000_000
"""Five columns of ten million, in whatever few bytes: reading takes 1.5 GB."""


def read_parquet(path: Path, said: Reading) -> Sheet:
    """The columns of a Parquet file.

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
            # Texts may be many times as large as the file, and no number.
            wanted = [field.name for field in schema if _is_numeric(field.type)]
            _check_count(path, rows, len(wanted))
            found = source.read(columns=wanted)
    except RecordError:
        raise
    except Exception as error:  # pyarrow raises its own kinds, which its versions name differently
        raise _no_parquet(path, error) from None
    named = _with_metadata(path, [name_and_unit(name) for name in schema.names], schema)
    read: dict[str, list[Any]] = {}  # of one name there may be several
    for field, column in zip(found.schema, found.columns, strict=True):
        read.setdefault(field.name, []).append(column)
    columns = [
        _column(name, unit, read[field.name].pop(0) if field.name in wanted else field.type)
        for field, (name, unit) in zip(schema, named, strict=True)
    ]
    return Sheet(columns, None, True, "Parquet")


def _column(name: str, unit: str | None, column: Any) -> Column:
    import pyarrow

    kind = getattr(column, "type", column)
    if not _is_numeric(kind):
        return Column(name, unit, None, (0, f"of the type {kind}"))
    values = column.cast(pyarrow.float64(), safe=False).to_numpy()
    return Column(name, unit, np.asarray(values, dtype=np.float64))


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
    path: Path, named: list[tuple[str, str | None]], schema: Any
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
