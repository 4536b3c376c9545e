"""The dataset of a run directory, whose chunks are read, and checked, on access."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray
from xarray.backends import BackendArray
from xarray.core.indexing import IndexingSupport, LazilyIndexedArray, explicit_indexing_adapter

from granular.run.checkpoint import Manifest
from granular.run.zarr_arrays import ZarrArray, ZarrMetadata


def open_lazy_dataset(path: Path, metadata: ZarrMetadata, manifest: Manifest) -> xarray.Dataset:
    """Open the complete part of a run's arrays, whose chunks are read on access."""
    variables = {}
    for name, plain in sorted(metadata.arrays.items()):
        array = ZarrArray(path, name, plain)
        variables[name] = (array.dims, LazilyIndexedArray(_LazyZarrArray(array, manifest)), array.attributes)
    return xarray.Dataset(variables)


class _LazyZarrArray(BackendArray):
    """The complete part of an array, for xarray."""

    def __init__(self, array: ZarrArray, manifest: Manifest) -> None:
        self._array, self._manifest = array, manifest
        self.shape = (manifest.lengths[array.dims[0]], *array.rest)
        self.dtype = array.dtype

    def __getitem__(self, key: Any) -> np.ndarray:
        values: np.ndarray = explicit_indexing_adapter(
            key, self.shape, IndexingSupport.OUTER, self._read_entries
        )
        return values

    def _read_entries(self, key: tuple[Any, ...]) -> np.ndarray:
        """Entries by an integer, a slice or integers for each dimension."""
        entries = np.arange(self.shape[0])[key[0]]
        rows = np.atleast_1d(entries)
        borders = np.flatnonzero(np.diff(rows // self._array.depth)) + 1
        parts = [self._entries_of_chunk(part, key[1:]) for part in np.split(rows, borders) if part.size]
        values = np.concatenate(parts) if parts else self._entries_of_chunk(rows, key[1:])
        return values if entries.ndim else values[0]

    def _entries_of_chunk(self, rows: np.ndarray, rest: tuple[Any, ...]) -> np.ndarray:
        """Entries of one chunk, with indices of their own dimensions."""
        if rows.size and 0 not in self.shape:
            index = int(rows[0]) // self._array.depth
            values = self._array.read_chunk(index, self._manifest)[rows - index * self._array.depth]
        else:
            values = np.empty((len(rows), *self.shape[1:]), dtype=self.dtype)
        for axis, chosen in reversed(list(enumerate(rest, start=1))):
            values = values[(slice(None),) * axis + (chosen,)]
        return values
