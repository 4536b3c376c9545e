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

from granular.run.checkpoint import (
    Manifest,
    digest_files,
    read_checkpoint,
    read_verified_files,
    write_checkpoint,
)
from granular.run.record_buffer import RecordBuffer
from granular.run.run_directory import (
    SCENE,
    SETTINGS,
    create_partial_directory,
    lock_directory,
    move_to_final_path,
    unlock_directory,
)
from granular.run.zarr_arrays import GROUP, AppendableZarrArray, ZarrArray, ZarrMetadata
from granular.scene.scene import Scene
from granular.shared.errors import StoreError


class RunDirectoryWriter:
    """A run directory that is being written."""

    def __init__(self, path: Path, scene: Scene) -> None:
        self.path, self.scene = path, scene
        self.lengths = {"time": 0, "frame": 0}
        self._files: dict[str, str] = {}
        self._arrays: dict[str, AppendableZarrArray] = {}
        self._held: int | None = None
        self._metadata: ZarrMetadata

    @classmethod
    def create(
        cls, path: Path, scene: Scene, settings: dict[str, Any], checkpoint: Mapping[str, Any]
    ) -> RunDirectoryWriter:
        """Make a run directory with its first checkpoint, in one step, and lock it."""
        part, held = create_partial_directory(path)
        store = cls(part, scene)
        try:
            (part / SCENE).write_text(scene.to_toml(), encoding="utf-8")
            (part / SETTINGS).write_text(json.dumps(settings, indent=2), encoding="utf-8")
            store._metadata = ZarrMetadata.from_scene(scene)
            store._metadata.write(part, store.lengths)
            store._files = digest_files(part)
            store.replace_checkpoint(checkpoint)
            move_to_final_path(part, path)
        except BaseException as error:
            shutil.rmtree(part, ignore_errors=True)
            unlock_directory(held)
            if isinstance(error, OSError):
                raise StoreError(f"{path} cannot be made: {error.strerror}") from None
            raise
        store.path, store._held = path, held
        store._open_zarr_arrays()
        return store

    def _open_zarr_arrays(self, manifest: Manifest | None = None) -> None:
        for name, plain in self._metadata.arrays.items():
            array = ZarrArray(self.path, name, plain)
            self._arrays[name] = AppendableZarrArray(array, self.lengths[array.dims[0]], manifest)

    def lock(self) -> None:
        """Lock the directory until `unlock`, or the end of this process."""
        self._held = lock_directory(self.path)

    def unlock(self) -> None:
        """Let other processes write to the directory."""
        unlock_directory(self._held)
        self._held = None

    def read_checkpoint_and_arrays(self) -> dict[str, np.ndarray]:
        """Read the last checkpoint, and open the arrays to go on from it."""
        checkpoint, manifest = read_checkpoint(self.path)
        self.lengths = {"time": int(checkpoint["rows"]), "frame": int(checkpoint["frames"])}
        self._files = manifest.files
        self._metadata = ZarrMetadata(read_verified_files(self.path, manifest)[GROUP])
        # What was written behind the checkpoint will be written again.
        self._open_zarr_arrays(manifest)
        return checkpoint

    def append_records(self, recorder: RecordBuffer) -> None:
        """Append what a buffer holds to the arrays, and clear the buffer."""
        for variable, values in recorder.variables_in_si(self.scene):
            self._arrays[variable.name].append(values)
        rows, frames = recorder.record_and_frame_counts()
        self.lengths["time"] += rows
        self.lengths["frame"] += frames
        self._metadata.write(self.path, self.lengths)
        recorder.clear()

    def replace_checkpoint(self, mapping: Mapping[str, Any]) -> None:
        """Replace the checkpoint: all that was written counts as complete."""
        chunks = {name: array.digests() for name, array in self._arrays.items()}
        write_checkpoint(self.path, mapping, Manifest(self._files, self.lengths, chunks))
