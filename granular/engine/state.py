"""What a run changes: plain padded arrays, in natural units."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.methods import Method
from granular.pairs.cells import ClosePairs, close_pairs_room
from granular.pairs.direct import padded_coordinates, part_buffers
from granular.pairs.far_field import FarForces, far_forces_room
from granular.pairs.stripes import LISTED, Stripes, stripes_room
from granular.pairs.verlet_list import VerletList, verlet_list_room

if TYPE_CHECKING:
    from granular.engine.system import Acting

WORK, DRAG, FRICTION, CONTACT, PISTON = range(5)
"""Entries of the ledger: work done from outside, and the losses."""


class Rungs(NamedTuple):
    """Slopes at the stages of a Runge-Kutta step, and behind them the values it starts from.

    Attributes
    ----------
    grains : float64 (s + 1, 4, m)
    piston : float64 (s + 1, 2)
    """

    grains: np.ndarray
    piston: np.ndarray


class State(NamedTuple):
    """The state of bed and piston, and the scratch arrays of the loop.

    Attributes
    ----------
    x, y, vx, vy, fx, fy : float64 (m,)
        Positions, velocities and forces (magnetic, weight, contact, inertia), padded.
    piston : float64 (4,)
        Height and velocity of the piston, and what compensated sums keep of each.
    ledger : float64 (5,)
        Work done on grains and piston from outside, and energy lost to drag, to friction, in
        contacts, and by the piston.
    clock : float64 (7,)
        See `granular.engine.variable`.
    totals : float64 (4,)
        Force on each wall, in the order of `granular.effects.walls.SIDES`.
    label : int64 (m,)
        Which grain of the scene stands in each place.
    load : float64 (m,) or None
        Sums behind the normal force of friction.
    near : Stripes or None
        Grains in stripes, where pairs end at a distance.
    known : VerletList or None
        The source's list of pairs.
    far : FarForces or None
        The far field.
    close : ClosePairs or None
        Grains in contact.
    push, shove : float64 (m,), the second None without slabs
        Scratch of the walls and of sums.
    buffers : float64 (parts, 5, m) or None
        Scratch of the pair sum.
    low : float64 (4, m) or None
        What compensated sums keep of x, y, vx and vy; None with plain sums.
    rungs : Rungs or None
        Scratch of a Runge-Kutta method.
    """

    x: np.ndarray
    y: np.ndarray
    vx: np.ndarray
    vy: np.ndarray
    fx: np.ndarray
    fy: np.ndarray
    piston: np.ndarray
    ledger: np.ndarray
    clock: np.ndarray
    totals: np.ndarray
    label: np.ndarray
    load: np.ndarray | None
    near: Stripes | None
    known: VerletList | None
    far: FarForces | None
    close: ClosePairs | None
    push: np.ndarray
    shove: np.ndarray | None
    buffers: np.ndarray | None
    low: np.ndarray | None
    rungs: Rungs | None


class Measurement(NamedTuple):
    """Scratch of a measuring pass.

    Attributes
    ----------
    stiffness : float64 (m,)
        Row sums that bound the stiffest mode.
    extremes : float64 (2,)
        Pair sums: see `granular.pairs.direct`.
    slopes : float64 (m,)
        Stiffness of each grain against the piston.
    """

    stiffness: np.ndarray
    extremes: np.ndarray
    slopes: np.ndarray


KEPT = ("x", "y", "vx", "vy", "fx", "fy", "piston", "ledger", "clock", "totals", "label")
"""Fields that a checkpoint holds; the others are scratch."""


def new_state(
    positions: np.ndarray, velocities: np.ndarray, height: float, acting: Acting, method: Method
) -> State:
    """A state from positions [D], velocities [D/tau] and the piston's height [D].

    Arrays are made only for the effects that act.
    """
    count = len(positions)
    x, y = padded_coordinates(positions)
    vx, vy = np.zeros_like(x), np.zeros_like(x)
    vx[:count], vy[:count] = velocities[:, 0], velocities[:, 1]
    slabs = any(law is not None and law.slab is not None for law in acting.walls)
    return State(
        x=x,
        y=y,
        vx=vx,
        vy=vy,
        fx=np.zeros_like(x),
        fy=np.zeros_like(x),
        piston=np.array([height, 0.0, 0.0, 0.0]),
        ledger=np.zeros(5),
        clock=np.array([0.0, 0.0, 0.0, 0.0, np.inf, 0.0, 0.0]),
        totals=np.zeros(4),
        label=np.arange(x.size),
        load=None if acting.friction is None else np.zeros_like(x),
        near=_stripes(x.size, acting),
        known=None if acting.listing is None else verlet_list_room(x.size),
        far=_far_forces(x.size, acting),
        close=None if acting.contact is None else close_pairs_room(count),
        push=np.zeros_like(x),
        shove=np.zeros_like(x) if slabs else None,
        buffers=part_buffers(x.size) if acting.cut is None and acting.listing is None else None,
        low=np.zeros((4, x.size)) if method.compensated else None,
        rungs=None if method.tableau is None else _rungs(len(method.tableau), x.size),
    )


def _stripes(size: int, acting: Acting) -> Stripes | None:
    if acting.cut is None:
        return None
    return stripes_room(size, charged=acting.cut.charged, loaded=acting.friction is not None)


def _far_forces(size: int, acting: Acting) -> FarForces | None:
    if acting.far is None:
        return None
    return far_forces_room(acting.far, size, loaded=acting.friction is not None)


def kept_lists(near: Stripes | VerletList | None) -> dict[str, np.ndarray]:
    """What a checkpoint holds of the lists of partners: where they were made, not what they say."""
    if near is None:
        return {}
    return {"near_built": near.built.copy(), "near_memory": near.memory.copy()}


def put_lists(near: Stripes | VerletList | None, kept: dict[str, np.ndarray]) -> None:
    """Let the lists be made again, as they were."""
    if near is not None:
        near.built[:], near.memory[:] = kept["near_built"], kept["near_memory"]
        near.memory[LISTED] = 0.0


def _rungs(rows: int, size: int) -> Rungs:
    return Rungs(np.zeros((rows, 4, size)), np.zeros((rows, 2)))


def new_measurement(state: State) -> Measurement:
    return Measurement(np.zeros_like(state.x), np.zeros(2), np.zeros_like(state.x))
