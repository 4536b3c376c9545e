"""Zarr arrays of a run directory, one per variable, written and read chunk by chunk.

Every chunk is compressed with a checksum, so any program that reads Zarr notices damage. A digest in the
manifest (`granular.run.run_directory`) verifies that a chunk was written by this run. The digest covers the
values up to the last checkpoint, because the last chunk of a killed run may hold further values.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granular.run.dataset import STAGE, DatasetVariable, all_run_variables
from granular.run.run_directory import (
    METADATA,
    REMEDY,
    TRAJECTORY,
    Manifest,
    read_checkpoint_and_manifest,
    read_run_file,
    replace_run_file,
)
from granular.scene.scene import Scene
from granular.shared.errors import StoreError

GROUP = f"{TRAJECTORY}/{METADATA}"
"""Name of the file that describes all arrays of a run directory."""

TIME_CHUNK = 4096
FRAME_CHUNK = 2**16  # numbers in a chunk of a grain field
_FORMAT = {"zarr_format": 3}
_LEVEL = 0  # of compression
_OVERHEAD = 2**10  # bytes, and a 256th, by which Zstandard may make a chunk longer (ZSTD_COMPRESSBOUND)
_CHECKSUM = {"name": "crc32c"}
"""Checksum of 4 bytes that older runs added to each chunk, because they did not use Zstandard's checksum."""


class ZarrGroupMetadata:
    """Zarr metadata of the arrays of a run directory."""

    def __init__(self, content: bytes) -> None:
        self._group = json.loads(content)
        self.arrays: dict[str, Any] = self._group["consolidated_metadata"]["metadata"]

    @classmethod
    def from_scene(cls, scene: Scene) -> ZarrGroupMetadata:
        """Make the metadata of a run that has no records or frames yet."""
        count = scene.grains.count
        depth = max(1, FRAME_CHUNK // max(1, 2 * count))
        arrays = {}
        for variable in all_run_variables(scene):
            rest = (count, 2)[: len(variable.dims) - 1]
            chunk = (depth if rest else TIME_CHUNK, *(max(1, size) for size in rest))
            arrays[variable.name] = _array_metadata(variable, (0, *rest), chunk)
        inside = {"kind": "inline", "must_understand": False, "metadata": arrays}
        group = {"node_type": "group", "attributes": {}, "consolidated_metadata": inside}
        return cls(json.dumps(_FORMAT | group).encode())

    def write(self, path: Path, lengths: Mapping[str, int]) -> None:
        """Write the metadata with the present lengths of all arrays, so that other programs can read them."""
        for name, plain in self.arrays.items():
            plain["shape"][0] = lengths[plain["dimension_names"][0]]
            _write_json(path / TRAJECTORY / name / METADATA, plain)
        _write_json(path / TRAJECTORY / METADATA, self._group)


def _array_metadata(
    variable: DatasetVariable, shape: tuple[int, ...], chunk: tuple[int, ...]
) -> dict[str, Any]:
    """Return an array's metadata in Zarr format 3 (https://zarr-specs.readthedocs.io/en/latest/v3/core)."""
    integer = variable is STAGE
    return _FORMAT | {
        "node_type": "array",
        "shape": shape,
        "data_type": "int64" if integer else "float64",
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunk}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0 if integer else "NaN",
        "codecs": [
            {"name": "bytes", "configuration": {"endian": "little"}},
            {"name": "zstd", "configuration": {"level": _LEVEL, "checksum": True}},
        ],
        "attributes": variable.attributes(),
        "dimension_names": variable.dims,
        "storage_transformers": [],
    }


def _write_json(file: Path, plain: object) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    replace_run_file(file, json.dumps(plain, indent=2).encode())


class ZarrArray:
    """Array in a run directory, divided into chunks along the first dimension."""

    def __init__(self, path: Path, name: str, plain: Mapping[str, Any]) -> None:
        self.path, self.name = path, name
        self.dims: tuple[str, ...] = tuple(plain["dimension_names"])
        self.attributes: dict[str, Any] = plain["attributes"]
        self.depth = int(plain["chunk_grid"]["configuration"]["chunk_shape"][0])
        self.rest: tuple[int, ...] = tuple(plain["shape"][1:])
        self.dtype = np.dtype(plain["data_type"]).newbyteorder("<")
        self._tail = 4 if _CHECKSUM in plain["codecs"] else 0

    def unwritten_chunk(self) -> np.ndarray:
        """Return a chunk (depth, ...) filled with NaN, or with 0 for integers."""
        fill = np.nan if self.dtype.kind == "f" else 0
        return np.full((self.depth, *self.rest), fill, dtype=self.dtype)

    def write(self, index: int, values: np.ndarray) -> None:
        """Replace a chunk atomically."""
        from numcodecs.zstd import Zstd

        packed = Zstd(level=_LEVEL, checksum=True).encode(values)
        if self._tail:
            from google_crc32c import value  # comes with Zarr

            packed += value(packed).to_bytes(self._tail, "little")
        file = self._chunk_file(index)
        file.parent.mkdir(parents=True, exist_ok=True)
        replace_run_file(file, packed)

    def read_chunk(self, index: int, manifest: Manifest) -> np.ndarray:
        """Read a chunk, and verify its values up to the length of the array in the manifest."""
        from numcodecs.zstd import Zstd

        values, file = self.unwritten_chunk(), self._chunk_file(index)
        content = read_run_file(file, values.nbytes + values.nbytes // 256 + _OVERHEAD)
        try:
            Zstd().decode(content[: len(content) - self._tail], out=values)
        except (RuntimeError, ValueError) as error:
            raise StoreError(f"{file} is damaged ({error}); {REMEDY}") from None
        if not self._matches_digest(index, values, manifest):
            # A continuing run may have rewritten the values after its last whole tick.
            latest = read_checkpoint_and_manifest(self.path)[1]
            if latest.files != manifest.files or not self._matches_digest(index, values, latest):
                raise StoreError(
                    f"{file} is damaged, or has changed since it was written (the digests differ); {REMEDY}"
                )
        return values

    def _matches_digest(self, index: int, values: np.ndarray, manifest: Manifest) -> bool:
        digests = manifest.chunks.get(self.name, [])
        complete = values[: max(0, manifest.lengths[self.dims[0]] - index * self.depth)]
        return index < len(digests) and _digest_of_values(complete) == digests[index]

    def _chunk_file(self, index: int) -> Path:
        return self.path.joinpath(TRAJECTORY, self.name, "c", str(index), *"0" * len(self.rest))


class AppendableZarrArray:
    """Array to which values can be appended; the last chunk and digests of all chunks are in memory."""

    def __init__(self, array: ZarrArray, length: int = 0, manifest: Manifest | None = None) -> None:
        """Open the first ``length`` entries of an array of a run."""
        self.array = array
        total, self._filled = divmod(length, array.depth)
        self._chunk = array.unwritten_chunk()
        self._finished: list[str] = []
        if manifest is not None and self._chunk.size:
            self._finished = manifest.chunks.get(array.name, [])[:total]
            if self._filled:
                self._chunk[: self._filled] = array.read_chunk(total, manifest)[: self._filled]

    def append(self, values: np.ndarray) -> None:
        """Append values, chunk by chunk."""
        while values.size:
            part = values[: self.array.depth - self._filled]
            self._chunk[self._filled : self._filled + len(part)] = part
            self._filled += len(part)
            self.array.write(len(self._finished), self._chunk)
            if self._filled == self.array.depth:
                self._finished.append(_digest_of_values(self._chunk))
                self._chunk, self._filled = self.array.unwritten_chunk(), 0
            values = values[len(part) :]

    def digests(self) -> list[str]:
        """Digests of all chunks; the digest of the last chunk covers only its filled part."""
        last = [_digest_of_values(self._chunk[: self._filled])] if self._filled and self._chunk.size else []
        return [*self._finished, *last]


def _digest_of_values(values: np.ndarray) -> str:
    return hashlib.blake2b(values.tobytes(), digest_size=16).hexdigest()
