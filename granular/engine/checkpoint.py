"""What a run must keep to go on from where it stands."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from granular.engine.state import KEPT, State, kept_lists, put_lists


@dataclasses.dataclass
class Progress:
    """Where a run stands; with the state's arrays, all that a checkpoint needs.

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


def kept_arrays(state: State) -> dict[str, Any]:
    """Copies of the arrays that a state cannot be made again from."""
    kept = {name: getattr(state, name).copy() for name in KEPT}
    if state.low is not None:
        kept["low"] = state.low.copy()
    if state.far is not None and state.far.held is not None:
        kept["far_held"] = state.far.held.copy()
    return kept | kept_lists(state.near or state.known)


def put_arrays(state: State, kept: dict[str, np.ndarray]) -> None:
    """Put kept arrays back."""
    for name in KEPT:
        getattr(state, name)[:] = kept[name]
    if state.low is not None:
        state.low[:] = kept["low"]
    if state.far is not None and state.far.held is not None:
        state.far.held[:] = kept["far_held"]
    put_lists(state.near or state.known, kept)
