"""MATLAB files of version 7.3: variables in an HDF5 file, read by h5py."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from granular.records.sheet import convert_parsing_errors

_NUMERIC = frozenset(
    ("double", "single", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))
)
"""MATLAB classes of numeric arrays. HDF5 also stores logical values, characters, tables and strings as
integers.
"""


def load_hdf5(content: bytes, check_count: Callable[[int], None]) -> dict[str, Any]:
    """Load the variables like `scipy.io.loadmat`: structures become dicts, axes of length 1 are dropped."""
    count = 0

    def load_group(group: Mapping[str, Any], outer: tuple[Any, ...] = ()) -> dict[str, Any]:
        """Load a structure, or the file; names with # belong to internal references and are omitted."""
        groups = (*outer, group)
        return {name: load_item(groups, name) for name in group if not name.startswith("#")}

    def load_item(groups: tuple[Any, ...], name: str) -> Any:
        """Load a numeric array or a structure; for any other variable return a description."""
        if not isinstance(groups[-1].get(name, getlink=True), h5py.HardLink):
            return "in another file"
        nonlocal count
        item = groups[-1][name]
        kind = _matlab_class(item)
        if isinstance(item, h5py.Group):
            if item in groups:
                return "a structure that contains itself"
            return f"of the type sparse {kind}" if "MATLAB_sparse" in item.attrs else load_group(item, groups)
        if not isinstance(item, h5py.Dataset) or item.shape is None:
            return "not readable"
        if kind not in _NUMERIC or item.attrs.get("MATLAB_empty") or item.external or item.is_virtual:
            return f"of the type {kind}"
        count += item.size
        check_count(count)
        values = item[()]
        if values.dtype.names == ("real", "imag"):
            values = values["real"] + 1j * values["imag"]
        return np.squeeze(values.T)  # MATLAB stores columns first

    with convert_parsing_errors("a MATLAB file of version 7.3", "h5py", "matlab73"):
        import h5py

        with h5py.File(io.BytesIO(content)) as file:
            return load_group(file["/"])  # a link to the root is equal to this group, but not to the file


def _matlab_class(item: Any) -> str:
    """Return the MATLAB class of a variable; arrays of other programs, without a class, are "double"."""
    kind = item.attrs.get("MATLAB_class")
    if kind is not None:
        return kind.decode(errors="replace") if isinstance(kind, bytes) else str(kind)
    dtype = getattr(item, "dtype", None)
    if dtype is not None and dtype.kind == "b":
        return "logical"
    return "double" if dtype is not None and dtype.kind in "iuf" else "cell"
