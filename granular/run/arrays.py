"""The arrays of a run directory: one a variable, in chunks that end with their checksum."""

from __future__ import annotations

import contextlib
import json
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.run.directory import TRAJECTORY
from granular.run.manifest import METADATA, unchanged_bytes
from granular.run.variables import STAGE, Variable, run_variables
from granular.scene.scene import Scene
from granular.shared.errors import StoreError

if TYPE_CHECKING:
    import xarray

TIME_CHUNK = 4096
FRAME_CHUNK = 2**16  # numbers in a chunk of a grain field


def metadata_files(scene: Scene) -> tuple[str, ...]:
    """Names of the files of metadata in a run directory: of all arrays together, and of each."""
    names = ("", *(f"{one.name}/" for one in run_variables(scene)))
    return tuple(f"{TRAJECTORY}/{name}{METADATA}" for name in names)


def create_arrays(path: Path, scene: Scene) -> None:
    """Make the arrays of a run directory, without records and frames."""
    import zarr

    group = zarr.create_group(path / TRAJECTORY)
    count = scene.grains.count
    depth = max(1, FRAME_CHUNK // max(1, 2 * count))
    for one in run_variables(scene):
        rest = (count, 2)[: len(one.dims) - 1]
        chunks = (depth, max(1, count), 2)[: len(one.dims)] if rest else (TIME_CHUNK,)
        _create(group, one, (0, *rest), chunks)
    consolidate(path)


def _create(group: Any, variable: Variable, shape: Any, chunks: Any) -> None:
    from zarr.codecs import Crc32cCodec, ZstdCodec

    whole = variable is STAGE
    group.create_array(
        variable.name,
        shape=shape,
        chunks=chunks,
        dtype="int64" if whole else "float64",
        fill_value=0 if whole else np.nan,
        compressors=(ZstdCodec(level=0), Crc32cCodec()),
        dimension_names=variable.dims,
        attributes=variable.attributes(),
    )


def writable_arrays(path: Path, scene: Scene) -> Iterator[tuple[Variable, Any]]:
    """Every variable with its array, to append to."""
    import zarr

    group = zarr.open_group(path / TRAJECTORY, mode="r+", use_consolidated=False)
    for one in run_variables(scene):
        # A chunk of nothing but the fill value is written too: one that is not there was lost.
        array: Any = group[one.name]
        yield one, array.with_config({"write_empty_chunks": True})


def append(array: Any, start: int, values: np.ndarray) -> None:
    """Write values behind those that are there."""
    stop = start + len(values)
    if stop > array.shape[0]:
        resize(array, stop)
    array[start:stop] = values


def resize(array: Any, length: int) -> None:
    """Give an array another length."""
    if array.shape[0] != length:
        array.resize((length, *array.shape[1:]))


def consolidate(path: Path) -> None:
    """Let readers see the new sizes, all at once."""
    import zarr

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Zarr calls consolidated metadata new in its format 3
        zarr.consolidate_metadata(path / TRAJECTORY)


def open_data(
    path: Path, scene: Scene, manifest: Mapping[str, str], complete: Mapping[str, int]
) -> xarray.Dataset:
    """The arrays of a run directory as far as they are complete; a chunk is checked when read.

    Parameters
    ----------
    manifest : mapping
        Of the run.
    complete : mapping
        How many records and frames are complete, by dimension.

    Raises
    ------
    StoreError
        If an array is missing, or is not described as the run wrote it.
    """
    import xarray

    check_metadata(path, scene, manifest, complete)
    with _in_one_line(path):
        data = xarray.open_zarr(_chunks(path), consolidated=True, chunks=None)
        return data.isel({dim: slice(0, length) for dim, length in complete.items()})


def check_open_chunks(path: Path, scene: Scene, lengths: Mapping[str, int]) -> None:
    """Read the chunks that are appended to next, where part of them is there already.

    Raises
    ------
    StoreError
        If one is missing or damaged.
    """
    import zarr

    with _in_one_line(path):
        group = zarr.open_group(_chunks(path), mode="r", use_consolidated=False)
        for one in run_variables(scene):
            array, length = group[one.name], lengths[one.dims[0]]
            assert isinstance(array, zarr.Array)
            array[length // array.chunks[0] * array.chunks[0] : length]


def check_metadata(
    path: Path, scene: Scene, manifest: Mapping[str, str], complete: Mapping[str, int]
) -> None:
    """Whether every array is described as the run wrote it, and is as long as it must be.

    Raises
    ------
    StoreError
        If one is not; it names the file.
    """
    names = {one.name for one in run_variables(scene)}
    for file in metadata_files(scene):
        content = unchanged_bytes(path, file, manifest)
        try:
            plain = json.loads(content)
            together = "consolidated_metadata" in plain
            arrays = plain["consolidated_metadata"]["metadata"] if together else {"": plain}
            lengths = {(one["dimension_names"][0], one["shape"][0]) for one in arrays.values()}
            fit = all(length >= complete[dim] for dim, length in lengths)
            right = fit and len(lengths) <= len(complete) and (not together or names <= set(arrays))
        except (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError):
            right = False
        if not right:
            raise StoreError(
                f"{path / file} does not describe what the run wrote; restore it, or run the "
                "scene anew"
            )


def _chunks(path: Path) -> Any:
    from granular.run.chunks import CheckedChunks

    return CheckedChunks(path / TRAJECTORY, read_only=True)


@contextlib.contextmanager
def _in_one_line(path: Path) -> Iterator[None]:
    """What goes wrong while arrays are opened, as an error of the run directory."""
    try:
        yield
    except StoreError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        raise StoreError(f"{path / TRAJECTORY} cannot be read: {error}") from None
