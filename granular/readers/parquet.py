"""Parquet files as sheets, and columns to Parquet."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granular.readers.column_headers import name_and_unit
from granular.readers.read_options import ReadOptions
from granular.readers.sheet import Column, Sheet, report_parsing_errors
from granular.shared.errors import RecordError
from granular.shared.files import write_atomically

_MAX_NUMBERS = 50_000_000
"""Five columns of ten million, in whatever few bytes: reading takes 1.5 GB."""


def read_parquet(content: bytes, _options: ReadOptions) -> Sheet:
    """Read the columns of a Parquet file, with units in their names or in the fields' metadata."""
    with report_parsing_errors("Parquet", "pyarrow", "parquet"):
        import pyarrow.parquet

        source = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(content))
        schema, rows = source.schema_arrow, source.metadata.num_rows
        # Texts may be many times as large as the file, and no number.
        numeric = [field.name for field in schema if _is_numeric_type(field.type)]
        _check_table_size(rows, len(numeric))
        table = source.read(columns=numeric)
    notes: list[str] = []
    named = [name_and_unit(field.name, _metadata_unit(field), notes) for field in schema]
    read: dict[str, list[Any]] = {}  # of one name there may be several
    for field, column in zip(table.schema, table.columns, strict=True):
        read.setdefault(field.name, []).append(column)
    columns = [
        _make_column(name, unit, read[field.name].pop(0) if field.name in numeric else field.type)
        for field, (name, unit) in zip(schema, named, strict=True)
    ]
    for column, heading in zip(columns, schema.names, strict=True):
        column.heading = heading
    return Sheet(columns, None, True, "Parquet", notes)


def _make_column(name: str, unit: str | None, column: Any) -> Column:
    import pyarrow

    kind = getattr(column, "type", column)
    if not _is_numeric_type(kind):
        return Column(name, unit, None, (0, f"of the type {kind}"))
    values = column.cast(pyarrow.float64(), safe=False).to_numpy()
    return Column(name, unit, np.asarray(values, dtype=np.float64))


def _check_table_size(rows: int, columns: int) -> None:
    if rows * columns > _MAX_NUMBERS:
        raise RecordError(
            f"holds {rows} rows of {columns} columns of numbers; at most "
            f"{_MAX_NUMBERS} numbers are read: drop columns, or sample less often"
        )


def write_parquet(path: Path, columns: Mapping[str, np.ndarray], units: Mapping[str, str]) -> None:
    """Write columns to a Parquet file, with units in the metadata of the fields."""
    with report_parsing_errors("Parquet", "pyarrow", "parquet"):
        import pyarrow.parquet

    fields = [
        pyarrow.field(
            name,
            pyarrow.float64(),
            nullable=False,
            metadata={"units": units[name]} if name in units else None,
        )
        for name in columns
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
