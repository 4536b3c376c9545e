"""State that a run needs to go on from, and its restoration."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np

from granular.engine.energy_ledger import EnergyLedger
from granular.engine.outflow import constants_per_grain
from granular.kernel_data.state import PERSISTENT, State
from granular.pairs.stripes import LISTED
from granular.protocol.stage import TimedStage
from granular.run.run_state import ARRANGE, RunProgress, RunState
from granular.shared.errors import StoreError


def take_snapshot(run: RunState) -> dict[str, Any]:
    """Copy all that a run needs to go on from here."""
    saved = copy_persistent_arrays(run.state) | {"band": run.band.copy(), "seen": run.seen.copy()}
    memory = {
        "progress": dataclasses.asdict(run.progress),
        "ledger": None if run.ledger is None else dataclasses.asdict(run.ledger),
        "grains": run.constants.grains,
    }
    return saved | {"memory": np.array(json.dumps(memory))}


def restore_snapshot(run: RunState, saved: dict[str, np.ndarray]) -> None:
    """Set a run back to a snapshot."""
    state = run.state
    missing = set(_persistent_arrays_by_name(state)) - set(saved)
    if missing:
        raise StoreError(f"the checkpoint lacks {min(missing)!r}: another version made it; run it anew")
    restore_persistent_arrays(state, saved)
    run.band[:], run.seen[:] = saved["band"], saved["seen"]
    memory = json.loads(str(saved["memory"]))
    run.progress = RunProgress(**memory["progress"])
    run.ledger = None if memory["ledger"] is None else EnergyLedger(**memory["ledger"])
    for values in constants_per_grain(run.constants):
        values[:] = values[state.label[: len(values)]]
    run.constants = run.constants._replace(grains=memory["grains"])
    if run.progress.started:
        height, scales = run.progress.height, run.system.scales
        run.motion = run.stage.motion(height, scales)
    # What is not kept follows from the positions; what is kept has the bits of the pass that
    # made it, which may have been a measuring one.
    run.present_record(ARRANGE)
    restore_persistent_arrays(state, saved)
    _refuse_unreachable_end(run)


def _refuse_unreachable_end(run: RunState) -> None:
    """Refuse an end that the run cannot reach any more."""
    now, end = run.present_time * run.system.scales.time, run.t_end * run.system.scales.time
    if run.present_time > run.t_end * (1.0 + 1e-9):
        raise StoreError(f"the run has reached {now:g} s already, after t_end = {end:g} s; give a later one")
    last = run.scene.protocol[-1]
    longer = isinstance(last, TimedStage) and last.until is None and math.isfinite(run.t_end)
    if run.is_protocol_finished and longer and run.present_time < run.t_end * (1.0 - 1e-9):
        raise StoreError(f"the protocol has ended, at {now:g} s; t_end = {end:g} s needs a new run")
    if not run.is_protocol_finished and run.progress.started and run.remaining_stage_time(0) < 0.0:
        raise StoreError(
            f"the run has reached {now:g} s, behind the end of stage {run.stage.name!r}; give a later t_end"
        )


def _persistent_arrays_by_name(state: State) -> dict[str, np.ndarray]:
    """Arrays that a state cannot be made again from, by their names in a checkpoint."""
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


def copy_persistent_arrays(state: State) -> dict[str, Any]:
    """Copy the arrays that a state cannot be made again from."""
    return {name: array.copy() for name, array in _persistent_arrays_by_name(state).items()}


def restore_persistent_arrays(state: State, saved: dict[str, np.ndarray]) -> None:
    """Put kept arrays back into a state, whose neighbour lists are made again at their former positions."""
    for name, array in _persistent_arrays_by_name(state).items():
        array[:] = saved[name]
    lists = state.stripes or state.verlet_list
    if lists is not None:
        lists.memory[LISTED] = 0.0
