"""MATLAB files: vectors, matrices and structures of vectors."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from granular.readers.column_headers import TIME, guess_column_role, parse_header
from granular.readers.limited_process import read_within_limits
from granular.readers.read_options import ReadOptions
from granular.readers.sheet import Column, Sheet, report_parsing_errors
from granular.shared.errors import RecordError
from granular.shared.message_text import quote

_MAX_NUMBERS = 50_000_000
"""As of a Parquet file."""

Vectors = dict[str, Any]
"""Arrays of numbers, and structures of such, by name; a text for anything else."""


def read_matlab(content: bytes, options: ReadOptions) -> Sheet:
    """Read the vectors of one length in a MATLAB file of version 4 to 7."""
    every: Vectors = read_within_limits(list_variables, content)
    variables = dict(options.select_table(every, "variable"))
    vectors = _numeric_vectors(variables)
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
        columns.insert(0, _sampling_times(variables, length))
    if len(columns) < 2:
        raise RecordError(
            f"holds no two vectors of one length; found: "
            f"{', '.join(map(quote, variables)) or 'nothing'}; save time and height as vectors"
        )
    return Sheet(columns, None, any(column.name for column in columns), "MATLAB file")


def list_variables(content: bytes) -> Vectors:
    """Variables of a file that hold numbers, and the names of the others."""
    import scipy.io

    with report_parsing_errors("a MATLAB file"):
        try:
            loaded = scipy.io.loadmat(io.BytesIO(content), squeeze_me=True, simplify_cells=True)
        except NotImplementedError:
            raise RecordError(
                "is of MATLAB's version 7.3, which is not read; save it with save(..., '-v7')"
            ) from None
        variables = {name: _numbers_in(value) for name, value in loaded.items() if not name.startswith("__")}
    count = _count_numbers(variables)
    if count > _MAX_NUMBERS:
        raise RecordError(
            f"holds {count} numbers; at most {_MAX_NUMBERS} are read: save time and height alone, or sample "
            "less often"
        )
    return variables


def _count_numbers(value: Any) -> int:
    if isinstance(value, dict):
        return sum(map(_count_numbers, value.values()))
    return value.size if isinstance(value, np.ndarray) else 0


def _numbers_in(value: Any) -> Any:
    if isinstance(value, dict):  # a structure
        return {name: _numbers_in(item) for name, item in value.items()}
    if isinstance(value, np.ndarray):
        return value if value.dtype.kind in "iufc" else f"of the type {value.dtype}"
    return np.asarray(value) if isinstance(value, int | float | complex) else str(value)


def _sampling_times(variables: Mapping[str, Any], length: int) -> Column:
    """Return times by PicoScope's start and interval."""
    first, step = (
        value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value
        for value in (variables.get("Tstart", 0.0), variables["Tinterval"])
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


def _numeric_vectors(variables: dict[str, Any]) -> dict[str, np.ndarray]:
    vectors: dict[str, np.ndarray] = {}
    for name, value in variables.items():
        if isinstance(value, dict):  # a structure
            vectors |= _numeric_vectors(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and value.size > 1:
            if value.ndim == 1:
                vectors[name] = value
            elif value.ndim == 2 and value.shape[1] <= 64 < value.shape[0]:
                vectors |= {f"{name} {k + 1}": value[:, k] for k in range(value.shape[1])}
    return vectors
