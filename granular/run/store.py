"""The run directory: the scene, the trajectory as a Zarr store, and a checkpoint.

``scene.toml``, ``run.json`` (settings and versions), ``trajectory.zarr`` (opens with
``xarray.open_zarr``) and ``checkpoint.npz``. Each write ends with the atomic replacement of the
checkpoint, which says how many records and frames are complete: a crash at any moment leaves
everything up to there readable. Its manifest holds the digests of files and chunks, and it has its
own.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granular.run.arrays import GROUP, GrowingArray, Metadata, StoredArray
from granular.run.checkpoint import Manifest, file_digests, read_checkpoint, read_files, write_checkpoint
from granular.run.directory import (
    SCENE,
    SETTINGS,
    create_partial_directory,
    lock_directory,
    move_into_place,
    unlock_directory,
)
from granular.run.recorder import Recorder
from granular.scene.scene import Scene
from granular.scene.system import SceneInNaturalUnits
from granular.shared.errors import StoreError


class Store:
    """A run directory that is being written.

    Attributes
    ----------
    path : Path
    rows, frames : int
        Records and frames that it holds.
    """

    def __init__(self, path: Path, scene: Scene, system: SceneInNaturalUnits) -> None:
        self.path, self.scene, self.system = path, scene, system
        self.rows = self.frames = 0
        self._files: dict[str, str] = {}
        self._arrays: dict[str, GrowingArray] = {}
        self._held: int | None = None
        self._metadata: Metadata

    @classmethod
    def create(
        cls,
        path: Path,
        scene: Scene,
        system: SceneInNaturalUnits,
        settings: dict[str, Any],
        checkpoint: Mapping[str, Any],
    ) -> Store:
        """Start a run directory with its first checkpoint, in one step, and `hold` it.

        Raises
        ------
        StoreError
            If the directory holds something already, or cannot be made.
        """
        part, held = create_partial_directory(path)
        store = cls(part, scene, system)
        try:
            (part / SCENE).write_text(scene.to_toml(), encoding="utf-8")
            (part / SETTINGS).write_text(json.dumps(settings, indent=2), encoding="utf-8")
            store._metadata = Metadata.of_scene(scene)
            store._metadata.write(part, store._lengths())
            store._files = file_digests(part)
            store.commit(checkpoint)
            move_into_place(part, path)
        except BaseException as error:
            shutil.rmtree(part, ignore_errors=True)
            unlock_directory(held)
            if isinstance(error, OSError):
                raise StoreError(f"{path} cannot be made: {error.strerror}") from None
            raise
        store.path, store._held = path, held
        store._open_arrays()
        return store

    def _open_arrays(self, manifest: Manifest | None = None) -> None:
        lengths = self._lengths()
        for name, plain in self._metadata.arrays.items():
            array = StoredArray(self.path, name, plain)
            self._arrays[name] = GrowingArray(array, lengths[array.dims[0]], manifest)

    def _lengths(self) -> dict[str, int]:
        return {"time": self.rows, "frame": self.frames}

    def hold(self) -> None:
        """Keep other processes from writing here, until `release` or the end of this one.

        Raises
        ------
        StoreError
            If another one writes here.
        """
        self._held = lock_directory(self.path)

    def release(self) -> None:
        """Let others write here."""
        unlock_directory(self._held)
        self._held = None

    def resume(self) -> dict[str, np.ndarray]:
        """Last checkpoint; what was written behind it will be written again.

        Raises
        ------
        StoreError
            If something that the run goes on from is missing or damaged.
        """
        checkpoint, manifest = read_checkpoint(self.path)
        self.rows, self.frames = int(checkpoint["rows"]), int(checkpoint["frames"])
        self._files = manifest.files
        self._metadata = Metadata(read_files(self.path, manifest)[GROUP])
        self._open_arrays(manifest)
        return checkpoint

    def write(self, recorder: Recorder) -> None:
        """Append what the recorder holds, and clear it."""
        for variable, values in recorder.in_si(self.scene, self.system.scales):
            self._arrays[variable.name].append(values)
        rows, frames = recorder.counts()
        self.rows += rows
        self.frames += frames
        self._metadata.write(self.path, self._lengths())
        recorder.clear()

    def commit(self, mapping: Mapping[str, Any]) -> None:
        """Replace the checkpoint: all that was written is complete."""
        chunks = {name: array.digests() for name, array in self._arrays.items()}
        write_checkpoint(self.path, mapping, Manifest(self._files, self._lengths(), chunks))
