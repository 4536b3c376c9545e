"""The run directory: the scene, the trajectory as a Zarr store, and a checkpoint.

``scene.toml``, ``run.json`` (settings and versions), ``trajectory.zarr`` (opens with
``xarray.open_zarr``) and ``checkpoint.npz``. Each write ends with the atomic replacement of the
checkpoint, which says how many records and frames are complete: a crash at any moment leaves
everything up to there readable. Files that stay as they are have their digests in the checkpoint
(see `granular.run.manifest`), which has its own, and every chunk of an array its checksum.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granular.run.arrays import (
    append,
    check_metadata,
    check_open_chunks,
    consolidate,
    create_arrays,
    metadata_files,
    resize,
    writable_arrays,
)
from granular.run.checkpoint import read_checkpoint, write_checkpoint
from granular.run.directory import (
    SCENE,
    SETTINGS,
    empty_part,
    lock,
    take_place,
    unlock,
)
from granular.run.manifest import MANIFEST, manifest_of, new_manifest, unchanged_bytes
from granular.run.recorder import Recorder
from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from granular.scene.system import System
from granular.shared.errors import StoreError


class Store:
    """A run directory that is being written."""

    def __init__(self, path: Path, scene: Scene, system: System) -> None:
        self.path, self.scene, self.system = path, scene, system
        self.rows = self.frames = 0
        self.manifest: Mapping[str, str] = {}
        self._held: int | None = None

    @classmethod
    def create(
        cls,
        path: Path,
        scene: Scene,
        system: System,
        settings: dict[str, Any],
        checkpoint: Mapping[str, Any],
    ) -> Store:
        """Start a run directory with its first checkpoint, in one step, and `hold` it.

        Raises
        ------
        StoreError
            If the directory holds something already, or cannot be made.
        """
        part, held = empty_part(path)
        store = cls(part, scene, system)
        try:
            (part / SCENE).write_text(scene.to_toml(), encoding="utf-8")
            (part / SETTINGS).write_text(json.dumps(settings, indent=2), encoding="utf-8")
            create_arrays(part, scene)
            store.manifest = new_manifest(part, (SCENE, SETTINGS, *metadata_files(scene)))
            store.commit(checkpoint)
            take_place(part, path)
        except BaseException as error:
            shutil.rmtree(part, ignore_errors=True)
            unlock(held)
            if isinstance(error, OSError):
                raise StoreError(f"{path} cannot be made: {error.strerror}") from None
            raise
        store.path, store._held = path, held
        return store

    def hold(self) -> None:
        """Keep other processes from writing here, until `release` or the end of this one.

        Raises
        ------
        StoreError
            If another one writes here.
        """
        self._held = lock(self.path)

    def release(self) -> None:
        """Let others write here."""
        unlock(self._held)
        self._held = None

    def resume(self) -> dict[str, np.ndarray]:
        """The last checkpoint; what was written behind it will be written again.

        Raises
        ------
        StoreError
            If something that the run goes on from is missing or damaged.
        """
        checkpoint = read_checkpoint(self.path)
        self.manifest, complete = manifest_of(checkpoint), complete_lengths(checkpoint)
        self.rows, self.frames = int(checkpoint["rows"]), int(checkpoint["frames"])
        check_metadata(self.path, self.scene, self.manifest, complete)
        written = {"time": self.rows, "frame": self.frames}
        check_open_chunks(self.path, self.scene, written)
        # A write that was cut off may have left some arrays longer than others.
        for one, array in writable_arrays(self.path, self.scene):
            resize(array, complete[one.dims[0]])
        return checkpoint

    def write(self, recorder: Recorder) -> None:
        """Append what the recorder holds, and clear it."""
        starts = {"time": self.rows, "frame": self.frames}
        recorded = {
            one.name: values for one, values in recorder.in_si(self.scene, self.system.scales)
        }
        for one, array in writable_arrays(self.path, self.scene):
            if len(recorded[one.name]):
                append(array, starts[one.dims[0]], recorded[one.name])
        rows, frames = recorder.counts()
        self.rows += rows
        self.frames += frames
        consolidate(self.path)
        recorder.clear()

    def commit(self, kept: Mapping[str, Any]) -> None:
        """Replace the checkpoint."""
        write_checkpoint(self.path, {**kept, MANIFEST: np.array(json.dumps(self.manifest))})


def complete_lengths(checkpoint: Mapping[str, np.ndarray]) -> dict[str, int]:
    """How many records and frames of a run are complete, by dimension."""
    return {"time": int(checkpoint["readable_rows"]), "frame": int(checkpoint["readable_frames"])}


def read_settings(path: Path, manifest: Mapping[str, str]) -> tuple[Scene, dict[str, Any]]:
    """Scene and settings of a run directory.

    Raises
    ------
    StoreError
        If one is missing, or is not what the run wrote.
    """
    settings = json.loads(unchanged_bytes(path, SETTINGS, manifest))
    unchanged_bytes(path, SCENE, manifest)
    return load_scene(path / SCENE), settings
