"""MATLAB files: vectors, matrices and structures of vectors."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from granular.readers.column_headers import TIME, guess_column_role, parse_header
from granular.readers.read_options import ReadOptions
from granular.readers.sheet import Column, Sheet, report_parsing_errors
from granular.shared.errors import RecordError
from granular.shared.message_text import quote

_MAX_UNPACKED = 512 * 2**20
_MAX_ELEMENTS, _MAX_DEPTH = 100_000, 50
"""Limits of a variable: parts of structures and cells, and their depth within each other."""
_HEAD, _COMPRESSED, _MATRIX = 128, 15, 14
"""Bytes before the first variable of a file of version 5 to 7, and types of its elements."""


def read_matlab(content: bytes, options: ReadOptions) -> Sheet:
    """Read the vectors of one length in a MATLAB file of version 4 to 7."""
    import scipy.io

    with report_parsing_errors("a MATLAB file"):
        _check_unpacked_size(content)
        try:
            loaded = scipy.io.loadmat(io.BytesIO(content), squeeze_me=True, simplify_cells=True)
        except NotImplementedError:
            raise RecordError(
                "is of MATLAB's version 7.3, which is not read; save it with save(..., '-v7')"
            ) from None
    variables = {name: value for name, value in loaded.items() if not name.startswith("__")}
    variables = dict(options.select_table(variables, "variable"))
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


def _check_unpacked_size(content: bytes) -> None:
    """Refuse what unpacks to far more; a file of version 4 is as long as what it holds."""
    order = {b"IM": "<", b"MI": ">"}.get(content[_HEAD - 2 : _HEAD])
    if order is None:
        return
    offset, unpacked = _HEAD, 0
    while offset + 8 <= len(content):
        kind, size = struct.unpack_from(f"{order}II", content, offset)
        element = content[offset : offset + 8 + size]
        if kind == _COMPRESSED:
            element = zlib.decompressobj().decompress(element[8:], _MAX_UNPACKED - unpacked + 1)
        unpacked += len(element)
        if unpacked > _MAX_UNPACKED:
            raise RecordError(
                f"unpacks to more than {_MAX_UNPACKED // 2**20} MB, the limit; "
                "save time and height alone, or sample less often"
            )
        if _is_nested_too_deeply(element, order):
            raise RecordError(
                f"a structure or cell array in it has more than {_MAX_ELEMENTS} "
                f"parts, or they are more than {_MAX_DEPTH} deep; save time and height as vectors"
            )
        offset += 8 + size


def _is_nested_too_deeply(content: bytes, order: str) -> bool:
    """Return True for an element with too many others in it, or nested too deeply."""
    count, stack = 0, [(0, len(content))]
    while stack:
        offset, end = stack.pop()
        while offset + 8 <= end:
            kind, size = struct.unpack_from(f"{order}II", content, offset)
            count += 1
            if count > _MAX_ELEMENTS or len(stack) > _MAX_DEPTH:
                return True
            first, small = (offset + 8, kind >> 16)  # of a small element the content stands in its tag
            offset = first if small else first + -(-size // 8) * 8
            if kind == _MATRIX:
                stack.append((offset, end))
                offset, end = first, min(end, first + size)
    return False


def _sampling_times(variables: Mapping[str, Any], length: int) -> Column:
    """Return times by PicoScope's start and interval."""
    first, step = variables.get("Tstart", 0.0), variables["Tinterval"]
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
