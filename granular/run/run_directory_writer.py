"""Writer of the run directory.

The files of the directory are ``scene.toml``, ``run.json`` (settings and versions), ``trajectory.zarr`` (for
``xarray.open_zarr``) and ``checkpoint.npz``. Each write ends with the
atomic replacement of the checkpoint, which gives the numbers of complete records and frames. After a crash at
any moment, all data up to these numbers are readable. Damage to the checkpoint is found by its checksums, and
damage to the other files by the digests in the checkpoint.
"""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granular.engine.state import EnergyLedger
from granular.engine.tick_loop import constant_arrays_per_grain
from granular.kernel_data.state import PERSISTENT, State
from granular.pairs.stripes import LISTED
from granular.protocol.stage import TimedStage
from granular.run.dataset import RecordBuffer
from granular.run.run_directory import (
    SCENE,
    SETTINGS,
    Manifest,
    create_and_lock_partial_directory,
    digest_files,
    lock_directory,
    move_to_final_path,
    read_checkpoint_and_manifest,
    read_verified_files,
    unlock_directory,
    write_checkpoint,
)
from granular.run.run_state import ARRANGE, RunProgress, RunState
from granular.run.zarr_arrays import GROUP, AppendableZarrArray, ZarrArray, ZarrGroupMetadata
from granular.scene.scene import Scene
from granular.shared.errors import StoreError


class RunDirectoryWriter:
    """Writer of a run directory."""

    def __init__(self, path: Path, scene: Scene) -> None:
        self.path, self.scene = path, scene
        self.lengths = {"time": 0, "frame": 0}
        self._files: dict[str, str] = {}
        self._arrays: dict[str, AppendableZarrArray] = {}
        self._held: int | None = None
        self._metadata: ZarrGroupMetadata

    @classmethod
    def create(
        cls, path: Path, scene: Scene, settings: dict[str, Any], checkpoint: Mapping[str, Any]
    ) -> RunDirectoryWriter:
        """Atomically make a run directory with its first checkpoint, and lock it."""
        part, held = create_and_lock_partial_directory(path)
        store = cls(part, scene)
        try:
            (part / SCENE).write_text(scene.to_toml(), encoding="utf-8")
            (part / SETTINGS).write_text(json.dumps(settings, indent=2), encoding="utf-8")
            store._metadata = ZarrGroupMetadata.from_scene(scene)
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
        """Lock the directory until `unlock` or the end of this process."""
        self._held = lock_directory(self.path)

    def unlock(self) -> None:
        """Unlock the directory for other processes."""
        unlock_directory(self._held)
        self._held = None

    def read_checkpoint_and_arrays(self) -> dict[str, np.ndarray]:
        """Read the last checkpoint, and open the arrays so that values can be appended."""
        checkpoint, manifest = read_checkpoint_and_manifest(self.path)
        self.lengths = {"time": int(checkpoint["rows"]), "frame": int(checkpoint["frames"])}
        self._files = manifest.files
        self._metadata = ZarrGroupMetadata(read_verified_files(self.path, manifest)[GROUP])
        # Data after the checkpoint will be written again.
        self._open_zarr_arrays(manifest)
        return checkpoint

    def append_records(self, recorder: RecordBuffer) -> None:
        """Append the buffered values to the arrays, and clear the buffer."""
        for variable, values in recorder.variables_in_si(self.scene):
            self._arrays[variable.name].append(values)
        rows, frames = recorder.record_and_frame_counts()
        self.lengths["time"] += rows
        self.lengths["frame"] += frames
        self._metadata.write(self.path, self.lengths)
        recorder.clear()

    def replace_checkpoint(self, mapping: Mapping[str, Any]) -> None:
        """Replace the checkpoint, so that all data written so far count as complete."""
        chunks = {name: array.digests() for name, array in self._arrays.items()}
        write_checkpoint(self.path, mapping, Manifest(self._files, self.lengths, chunks))


def take_snapshot(run: RunState) -> dict[str, Any]:
    """Copy all data that a run needs to continue from its present state."""
    arrays = _persistent_arrays_by_name(run.state) | {"band": run.band, "seen": run.seen}
    saved: dict[str, Any] = {name: array.copy() for name, array in arrays.items()}
    memory = {
        "progress": dataclasses.asdict(run.progress),
        "ledger": None if run.ledger is None else dataclasses.asdict(run.ledger),
        "grains": run.grain_constants.grains,
    }
    return saved | {"memory": np.array(json.dumps(memory))}


def restore_snapshot(run: RunState, saved: dict[str, np.ndarray]) -> None:
    """Restore a run from a snapshot."""
    state = run.state
    missing = set(_persistent_arrays_by_name(state)) - set(saved)
    if missing:
        raise StoreError(
            f"the checkpoint lacks {min(missing)!r}, so another version wrote it; run the scene again"
        )
    restore_persistent_arrays(state, saved)
    run.band[:], run.seen[:] = saved["band"], saved["seen"]
    memory = json.loads(str(saved["memory"]))
    run.progress = RunProgress(**memory["progress"])
    run.ledger = None if memory["ledger"] is None else EnergyLedger(**memory["ledger"])
    for values in constant_arrays_per_grain(run.grain_constants):
        values[:] = values[state.label[: len(values)]]
    run.grain_constants = run.grain_constants._replace(grains=memory["grains"])
    if run.progress.started:
        height, scales = run.progress.height, run.system.scales
        run.motion = run.stage.piston_motion(height, scales)
    # Other arrays follow from the positions. Stored arrays are then restored once more: they keep the bits of
    # the pass that computed them, which may have been a measuring pass.
    run.present_record(ARRANGE)
    restore_persistent_arrays(state, saved)
    _refuse_unreachable_end(run)


def _refuse_unreachable_end(run: RunState) -> None:
    """Raise an error if the run can no longer end at ``t_end``."""
    now, end = run.present_time * run.system.scales.time, run.t_end * run.system.scales.time
    if run.present_time > run.t_end * (1.0 + 1e-9):
        raise StoreError(
            f"the run has already reached {now:g} s, after t_end = {end:g} s; give a later t_end"
        )
    last = run.scene.protocol[-1]
    longer = isinstance(last, TimedStage) and last.until is None and math.isfinite(run.t_end)
    if run.is_protocol_finished and longer and run.present_time < run.t_end * (1.0 - 1e-9):
        raise StoreError(
            f"the protocol ended at {now:g} s, before t_end = {end:g} s; start a new run with this t_end"
        )
    if not run.is_protocol_finished and run.progress.started and run.remaining_stage_time(0) < 0.0:
        raise StoreError(
            f"the run has reached {now:g} s, after the end of stage {run.stage.name!r}; give a later t_end"
        )


def _persistent_arrays_by_name(state: State) -> dict[str, np.ndarray]:
    """Return the arrays of a state that a checkpoint must hold, by their names in the checkpoint."""
    names = [*PERSISTENT, "rounding"] if state.rounding is not None else PERSISTENT
    saved = {name: getattr(state, name) for name in names}
    if state.host is not None:
        saved["bodies"] = state.bodies
    for index, workspace in enumerate(state.workspaces):
        if hasattr(workspace, "persistent"):
            saved[f"room_{index}"] = workspace.persistent
    far = state.far_forces
    if far is not None and far.held_forces is not None:
        saved["far_held"] = far.held_forces
    if far is not None and far.evaluated_at is not None:
        saved["far_moment"] = far.timing
    lists = state.stripes or state.verlet_list
    if lists is not None:
        saved |= {"near_built": lists.built, "near_memory": lists.memory}
    return saved


def restore_persistent_arrays(state: State, saved: dict[str, np.ndarray]) -> None:
    """Restore the stored arrays of a state; rebuild neighbour lists from the positions stored for them."""
    for name, array in _persistent_arrays_by_name(state).items():
        array[:] = saved[name]
    lists = state.stripes or state.verlet_list
    if lists is not None:
        lists.memory[LISTED] = 0.0
