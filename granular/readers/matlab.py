"""MATLAB files: vectors, matrices and structures of vectors."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from granular.readers.names import TIME, name_and_unit
from granular.readers.reading import Reading
from granular.readers.sheet import Column, Sheet
from granular.readers.text import read_bytes
from granular.shared.errors import RecordError
from granular.shared.messages import quoted, visible

_MOST_BYTES = 256 * 2**20


def read_matlab(path: Path, reading: Reading) -> Sheet:
    """The vectors of one length in a MATLAB file of version 4 to 7.

    Times are a vector, or follow from the numbers ``Tstart`` and ``Tinterval`` of PicoScope.

    Parameters
    ----------
    path : Path
    reading : Reading
        ``sheet`` names a structure, or a matrix, whose columns are taken.

    Raises
    ------
    RecordError
        If it cannot be read as such, or holds no vectors of one length.
    """
    import scipy.io

    content = read_bytes(path, _MOST_BYTES)
    try:
        found = scipy.io.loadmat(io.BytesIO(content), squeeze_me=True, simplify_cells=True)
    except NotImplementedError:
        raise RecordError(
            f"{visible(path)}: is of MATLAB's version 7.3, which is not read; save it with "
            "save(..., '-v7')"
        ) from None
    except Exception as error:  # scipy raises what its parser meets
        raise RecordError(
            f"{visible(path)}: cannot be read as a MATLAB file: {visible(error)}; save it anew, or "
            "as CSV"
        ) from None
    variables = {name: value for name, value in found.items() if not name.startswith("__")}
    if reading.sheet is not None:
        if reading.sheet not in variables:
            raise RecordError(
                f"{visible(path)}: no variable {quoted(reading.sheet)}; found: "
                f"{', '.join(map(quoted, variables))}"
            )
        variables = {reading.sheet: variables[reading.sheet]}
    vectors = _vectors(variables)
    lengths = [len(values) for values in vectors.values()]
    length = max(lengths, key=lengths.count, default=0)
    columns = [
        Column(*name_and_unit(name), np.asarray(values, dtype=np.float64))
        for name, values in vectors.items()
        if len(values) == length
    ]
    step = variables.get("Tinterval")
    if isinstance(step, int | float) and columns:  # PicoScope: a start and an interval
        first = variables.get("Tstart", 0.0)
        times = float(first) + float(step) * np.arange(length)
        columns.insert(0, Column(TIME, "s", times))
    if len(columns) < 2:
        raise RecordError(
            f"{visible(path)}: holds no two vectors of one length; found: "
            f"{', '.join(map(quoted, variables)) or 'nothing'}; save time and height as vectors"
        )
    return Sheet(columns, None, any(one.name for one in columns), "MATLAB file")


def _vectors(variables: dict[str, Any]) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}
    for name, value in variables.items():
        if isinstance(value, dict):  # a structure
            found |= _vectors(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and value.size > 1:
            if value.ndim == 1:
                found[name] = value
            elif value.ndim == 2 and value.shape[1] <= 64 < value.shape[0]:
                found |= {f"{name} {k + 1}": value[:, k] for k in range(value.shape[1])}
    return found
