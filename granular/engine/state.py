"""What a run changes: plain padded arrays, in natural units."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.pairs.direct import padded_coordinates, part_buffers


class State(NamedTuple):
    """The state of bed and piston, and the scratch arrays of the loop.

    Attributes
    ----------
    x, y, vx, vy, fx, fy : float64 (m,)
        Positions, velocities and forces (magnetic and weight), padded.
    piston : float64 (2,)
        Height and velocity of the piston.
    ledger : float64 (2,)
        Energy lost to drag; work done on the grains and the piston from outside.
    totals : float64 (4,)
        Force on each wall, in the order of `granular.effects.walls.SIDES`.
    push : float64 (m,)
        Scratch of the walls and of sums.
    buffers : float64 (parts, 5, m) or None
        Scratch of the pair sum.
    """

    x: np.ndarray
    y: np.ndarray
    vx: np.ndarray
    vy: np.ndarray
    fx: np.ndarray
    fy: np.ndarray
    piston: np.ndarray
    ledger: np.ndarray
    totals: np.ndarray
    push: np.ndarray
    buffers: np.ndarray | None


class Measurement(NamedTuple):
    """Scratch of a measuring pass.

    Attributes
    ----------
    stiffness : float64 (m,)
        Row sums that bound the stiffest mode.
    extremes : float64 (2,)
        Pair sums: see `granular.pairs.direct`.
    """

    stiffness: np.ndarray
    extremes: np.ndarray


KEPT = ("x", "y", "vx", "vy", "fx", "fy", "piston", "ledger", "totals")
"""Fields that a checkpoint holds; the others are scratch."""


def new_state(positions: np.ndarray, velocities: np.ndarray, height: float) -> State:
    """A state from positions [D], velocities [D/tau] and the piston's height [D]."""
    x, y = padded_coordinates(positions)
    vx, vy = np.zeros_like(x), np.zeros_like(x)
    vx[: len(velocities)], vy[: len(velocities)] = velocities[:, 0], velocities[:, 1]
    return State(
        x=x,
        y=y,
        vx=vx,
        vy=vy,
        fx=np.zeros_like(x),
        fy=np.zeros_like(x),
        piston=np.array([height, 0.0]),
        ledger=np.zeros(2),
        totals=np.zeros(4),
        push=np.zeros_like(x),
        buffers=part_buffers(x.size),
    )


def new_measurement(state: State) -> Measurement:
    return Measurement(np.zeros_like(state.x), np.zeros(2))
