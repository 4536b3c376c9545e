"""What a run must keep to go on from where it stands."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from granular.kernel_data.state import KEPT, State
from granular.pairs.stripes import LISTED, Stripes
from granular.pairs.verlet_list import VerletList


@dataclasses.dataclass
class Progress:
    """Where a run stands: what a checkpoint needs besides the state's arrays.

    Attributes
    ----------
    stage, ticks : int
        Present stage (its index), and ticks made in it.
    begun : bool
        Whether the present stage has been set up.
    start, last : float
        Start of the stage, and time of the last record [tau].
    height : float
        Piston height at the stage's start [m].
    pace : list or None
        Fields of its `Pace`.
    stiffest : float
        Greatest product of step and highest angular frequency so far.
    closest : float
        Least distance of two grains so far [D].
    results : list of dict
        Fields of the `StageResult` of each finished stage.
    """

    stage: int = 0
    ticks: int = 0
    begun: bool = False
    start: float = 0.0
    last: float = 0.0
    height: float = 0.0
    pace: list[Any] | None = None
    stiffest: float = 0.0
    closest: float = math.inf
    results: list[dict[str, Any]] = dataclasses.field(default_factory=list)


def _kept(state: State) -> dict[str, np.ndarray]:
    """The arrays that a state cannot be made again from, by their names in a checkpoint."""
    names = [*KEPT, "rounding"] if state.rounding is not None else KEPT
    kept = {name: getattr(state, name) for name in names}
    for place, room in enumerate(state.rooms):
        if hasattr(room, "kept"):
            kept[f"room_{place}"] = room.kept
    far = state.far_forces
    if far is not None and far.held is not None:
        kept["far_held"] = far.held
    if far is not None and far.met is not None:
        kept["far_moment"] = far.moment
    return kept


def kept_arrays(state: State) -> dict[str, Any]:
    """Copies of the arrays that a state cannot be made again from."""
    kept = {name: array.copy() for name, array in _kept(state).items()}
    return kept | kept_lists(state.stripes or state.verlet_list)


def put_arrays(state: State, kept: dict[str, np.ndarray]) -> None:
    """Put kept arrays back."""
    for name, array in _kept(state).items():
        array[:] = kept[name]
    put_lists(state.stripes or state.verlet_list, kept)


def kept_lists(lists: Stripes | VerletList | None) -> dict[str, np.ndarray]:
    """What a checkpoint holds of the lists of partners: the places that they were made at."""
    if lists is None:
        return {}
    return {"near_built": lists.built.copy(), "near_memory": lists.memory.copy()}


def put_lists(lists: Stripes | VerletList | None, kept: dict[str, np.ndarray]) -> None:
    """Let the lists be made again at the places that a checkpoint holds."""
    if lists is not None and "near_built" in kept:
        lists.built[:], lists.memory[:] = kept["near_built"], kept["near_memory"]
        lists.memory[LISTED] = 0.0
