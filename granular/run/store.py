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
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

try:
    import fcntl
except ImportError:  # where there is none, nothing keeps two processes apart
    fcntl = None  # type: ignore[assignment]

from granular.engine.system import System
from granular.run.recorder import Recorder
from granular.run.variables import (
    FRAME_HEIGHT,
    FRAME_TIME,
    STAGE,
    TIME,
    Variable,
    frame_variables,
    scalar_variables,
)
from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from granular.shared.errors import StoreError

TIME_CHUNK = 4096
FRAME_CHUNK = 2**16  # numbers in a chunk of a grain field
CHECKPOINT = "checkpoint.npz"
CHECKPOINT_PART = CHECKPOINT + ".part.npz"
TRAJECTORY = "trajectory.zarr"
SCENE = "scene.toml"
SETTINGS = "run.json"


def _empty_part(path: Path) -> Path:
    """An empty directory beside the run's, which becomes it when it is complete."""
    path = path.absolute()
    if not path.name:
        raise StoreError(f"{path} is no place for a run; give a directory that is yours")
    part = path.with_name(f".{path.name}.part")
    try:
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise StoreError(f"{path} is not empty; resume the run in it, or give a new directory")
        path.parent.mkdir(parents=True, exist_ok=True)
        if part.exists():  # left by a run that was killed while it began
            _remove_part(part)
        part.mkdir()
    except OSError as error:
        raise StoreError(f"{path} cannot be made: {error.strerror}") from None
    return part


def _remove_part(part: Path) -> None:
    known = {SCENE, SETTINGS, TRAJECTORY, CHECKPOINT, CHECKPOINT_PART}
    strange = sorted(one.name for one in part.iterdir() if one.name not in known)
    if strange:
        raise StoreError(f"{part} holds {strange[0]!r}, which is no part of a run; move it away")
    shutil.rmtree(part)


class Store:
    """A run directory that is being written."""

    def __init__(self, path: Path, scene: Scene, system: System) -> None:
        self.path, self.scene, self.system = path, scene, system
        self.rows = self.frames = 0
        self._held: int | None = None
        self.scalars = scalar_variables(scene)
        self.fields = frame_variables(scene)

    @classmethod
    def create(
        cls,
        path: Path,
        scene: Scene,
        system: System,
        settings: dict[str, Any],
        checkpoint: Mapping[str, Any],
    ) -> Store:
        """Start a run directory with its first checkpoint, in one step.

        Raises
        ------
        StoreError
            If the directory holds something already, or cannot be made.
        """
        import zarr

        part = _empty_part(path)
        store = cls(part, scene, system)
        scene.save(part / SCENE)
        (part / SETTINGS).write_text(json.dumps(settings, indent=2), encoding="utf-8")
        group = zarr.create_group(part / TRAJECTORY)
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
        store._consolidate()
        store.commit(checkpoint)
        os.replace(part, path)
        store.path = path
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

    def hold(self) -> None:
        """Keep other processes from writing here, until `release` or the end of this one.

        Raises
        ------
        StoreError
            If another one writes here.
        """
        if fcntl is None:
            return
        self._held = os.open(self.path, os.O_RDONLY)
        try:
            fcntl.flock(self._held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise StoreError(
                f"another process is running in {self.path}; wait for it, or stop it"
            ) from None

    def release(self) -> None:
        """Let others write here."""
        if self._held is not None:
            os.close(self._held)
            self._held = None

    def resume(self) -> dict[str, np.ndarray]:
        """The last checkpoint; what was written behind it will be written again."""
        import zarr

        checkpoint = read_checkpoint(self.path)
        # A write that was cut off may have left some arrays longer than others.
        try:
            group = zarr.open_group(self.path / TRAJECTORY, mode="r+", use_consolidated=False)
        except FileNotFoundError:
            raise StoreError(
                f"{self.path / TRAJECTORY} is missing; restore it, or run the scene anew"
            ) from None
        for one in (TIME, *self.scalars, STAGE, FRAME_TIME, FRAME_HEIGHT, *self.fields):
            frames = one.dims[0] == "frame"
            length = int(checkpoint["readable_frames" if frames else "readable_rows"])
            array = group[one.name]
            assert isinstance(array, zarr.Array)
            if array.shape[0] != length:
                array.resize((length, *array.shape[1:]))
        self.rows, self.frames = int(checkpoint["rows"]), int(checkpoint["frames"])
        return checkpoint

    def write(self, recorder: Recorder) -> None:
        """Append what the recorder holds, and clear it."""
        import zarr

        group = zarr.open_group(self.path / TRAJECTORY, mode="r+", use_consolidated=False)
        starts = {"time": self.rows, "frame": self.frames}
        for one, values in recorder.in_si(self.scene, self.system.scales):
            if len(values):
                _append(group[one.name], starts[one.dims[0]], values)
        rows, frames = recorder.counts()
        self.rows += rows
        self.frames += frames
        self._consolidate()
        recorder.clear()

    def _consolidate(self) -> None:
        """Let readers see the new sizes, all at once."""
        import zarr

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Zarr calls consolidated metadata new in its format 3
            zarr.consolidate_metadata(self.path / TRAJECTORY)

    def commit(self, kept: Mapping[str, Any]) -> None:
        """Replace the checkpoint."""
        part = self.path / CHECKPOINT_PART
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
    except (FileNotFoundError, NotADirectoryError):
        raise StoreError(f"{path} holds no run; give the directory that a run wrote") from None
    except (OSError, EOFError, ValueError, zipfile.BadZipFile) as error:
        raise StoreError(
            f"{path / CHECKPOINT} is damaged ({error}); restore it, or run the scene anew"
        ) from None


def read_settings(path: Path) -> tuple[Scene, dict[str, Any]]:
    """Scene and settings of a run directory."""
    try:
        settings = json.loads((path / SETTINGS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise StoreError(f"{path} holds no run; give the directory that a run wrote") from None
    missing = [name for name in ("scene_digest", "dt", "method") if name not in settings]
    if missing:
        raise StoreError(f"{path / SETTINGS} lacks {missing[0]!r}; it is not what a run wrote")
    return load_scene(path / SCENE), settings


def is_run(path: Path) -> bool:
    """Whether the directory holds a run that can be loaded or resumed."""
    try:
        return (path / CHECKPOINT).is_file()
    except OSError:
        return False
