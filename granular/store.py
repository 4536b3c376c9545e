"""The run directory: the scene, the trajectory as a Zarr store, and a checkpoint.

``scene.toml``, ``run.json`` (settings and versions), ``trajectory.zarr`` (opens with
``xarray.open_zarr``) and ``checkpoint.npz``. Each write ends with the atomic replacement of the
checkpoint, which says how many records and frames are complete: a crash at any moment leaves
everything up to there readable.
"""

from __future__ import annotations

import json
import os
import shutil
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granular.engine.system import System
from granular.errors import StoreError
from granular.recorder import Recorder
from granular.scene import Scene, load_scene
from granular.variables import (
    FRAME_HEIGHT,
    FRAME_TIME,
    STAGE,
    TIME,
    Variable,
    frame_variables,
    scalar_variables,
    si_column,
)

TIME_CHUNK = 4096
FRAME_CHUNK = 2**16  # numbers in a chunk of a grain field
CHECKPOINT = "checkpoint.npz"
TRAJECTORY = "trajectory.zarr"


def write_atomically(path: Path, data: bytes) -> None:
    """Replace a file in one step."""
    part = path.with_name(path.name + ".part")
    part.write_bytes(data)
    os.replace(part, path)


class Store:
    """A run directory that is being written."""

    def __init__(self, path: Path, scene: Scene, system: System) -> None:
        self.path, self.scene, self.system = path, scene, system
        self.rows = self.frames = 0
        self.scalars = scalar_variables(scene)
        self.fields = frame_variables(scene)

    @classmethod
    def create(cls, path: Path, scene: Scene, system: System, settings: dict[str, Any]) -> Store:
        """Start a run directory.

        Raises
        ------
        StoreError
            If the directory holds something already, or cannot be made.
        """
        import zarr

        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise StoreError(f"{path} is not empty; resume the run in it, or give a new directory")
        store = cls(path, scene, system)
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"{path} cannot be made: {error.strerror}") from None
        scene.save(path / "scene.toml")
        write_atomically(path / "run.json", json.dumps(settings, indent=2).encode())
        group = zarr.create_group(path / TRAJECTORY)
        count = scene.grains.count
        for one in (TIME, *store.scalars):
            store._create(group, one, (0,), (TIME_CHUNK,))
        store._create(group, STAGE, (0,), (TIME_CHUNK,), dtype="int64")
        store._create(group, FRAME_TIME, (0,), (TIME_CHUNK,))
        store._create(group, FRAME_HEIGHT, (0,), (TIME_CHUNK,))
        depth = max(1, FRAME_CHUNK // max(1, 2 * count))
        for one in store.fields:
            rest = (count, 2)[: len(one.dims) - 1]
            chunks = (depth, max(1, count), 2)[: len(one.dims)]
            store._create(group, one, (0, *rest), chunks)
        return store

    @staticmethod
    def _create(
        group: Any, variable: Variable, shape: Any, chunks: Any, dtype: str = "float64"
    ) -> None:
        group.create_array(
            variable.name,
            shape=shape,
            chunks=chunks,
            dtype=dtype,
            fill_value=np.nan if dtype == "float64" else 0,
            dimension_names=variable.dims,
            attributes=variable.attributes(),
        )

    def resume(self) -> dict[str, np.ndarray]:
        """The last checkpoint; what was written behind it will be written again."""
        checkpoint = read_checkpoint(self.path)
        self.rows, self.frames = int(checkpoint["rows"]), int(checkpoint["frames"])
        return checkpoint

    def write(self, recorder: Recorder) -> None:
        """Append what the recorder holds, and clear it."""
        import zarr

        group = zarr.open_group(self.path / TRAJECTORY, mode="r+")
        scales = self.system.scales
        rows, stages = recorder.table()
        if len(rows):
            for one in (TIME, *self.scalars):
                _append(group[one.name], self.rows, si_column(one, rows, scales))
            _append(group[STAGE.name], self.rows, stages)
            self.rows += len(rows)
        if recorder.frames:
            for one in (FRAME_TIME, FRAME_HEIGHT, *self.fields):
                values = recorder.stacked(one.name, one.dims) * getattr(scales, one.scale)
                _append(group[one.name], self.frames, values)
            self.frames += len(recorder.frames)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Zarr calls consolidated metadata new in its format 3
            zarr.consolidate_metadata(self.path / TRAJECTORY)
        recorder.clear()

    def commit(self, kept: Mapping[str, Any]) -> None:
        """Replace the checkpoint."""
        part = self.path / (CHECKPOINT + ".part.npz")
        np.savez(part, **kept)
        os.replace(part, self.path / CHECKPOINT)


def _append(array: Any, start: int, values: np.ndarray) -> None:
    stop = start + len(values)
    if stop > array.shape[0]:
        array.resize((stop, *array.shape[1:]))
    array[start:stop] = values


def read_checkpoint(path: Path) -> dict[str, np.ndarray]:
    """The checkpoint of a run directory.

    Raises
    ------
    StoreError
        If there is none, or it cannot be read.
    """
    try:
        with np.load(path / CHECKPOINT, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise StoreError(f"{path} holds no run; give the directory that a run wrote") from None
    except (OSError, ValueError) as error:
        raise StoreError(f"{path / CHECKPOINT} cannot be read: {error}") from None


def read_settings(path: Path) -> tuple[Scene, dict[str, Any]]:
    """Scene and settings of a run directory."""
    try:
        settings = json.loads((path / "run.json").read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError):
        raise StoreError(f"{path} holds no run; give the directory that a run wrote") from None
    return load_scene(path / "scene.toml"), settings


def is_run(path: Path) -> bool:
    """Whether the directory holds a run that can be loaded or resumed."""
    return (path / CHECKPOINT).is_file()


def clear_unstarted(path: Path) -> None:
    """Remove a run directory that was interrupted before its first checkpoint."""
    if path.is_dir() and not is_run(path) and (path / "run.json").is_file():
        shutil.rmtree(path)
