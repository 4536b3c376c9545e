"""What a run changes: plain padded arrays, in natural units."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from granular.engine.constants import Acting
from granular.methods import Method
from granular.pairs.direct import padded_coordinates, part_buffers
from granular.pairs.far_field import FarForces, far_forces_room
from granular.pairs.stripes import LISTED, Stripes, stripes_room
from granular.pairs.verlet_list import VerletList, verlet_list_room

X, Y, VX, VY = range(4)
"""Rows of what is kept of the grains' places and velocities together."""

HEIGHT, SPEED, HEIGHT_ROUNDING, SPEED_ROUNDING = range(4)
"""Entries of the piston."""

TIME, DENSITY, SQUARE, LEAST, SHORTEST, LONGEST, STEPS = range(7)
"""Entries of a state's clock: time in the stage; density of steps, and the square of the speed that
it heeds; density where nothing is near; shortest and longest step so far; steps made in the run."""

WORK, PISTON, LOSSES = range(3)
"""Entries of the ledger: work done from outside; what the piston loses; from there on, what each
effect takes, in the order of the laws."""


class Slopes(NamedTuple):
    """Rates of change at the stages of a Runge-Kutta step; behind them, where the step starts.

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
        Height and velocity of the piston, and what rounding took from each.
    ledger : float64 (2 + laws,)
        Work done on grains and piston from outside, and energy lost by the piston and to effects.
    clock : float64 (7,)
        Its entries are named above.
    wall_forces : float64 (4,)
        Force on each wall, in the order of `granular.effects.wall_side.SIDES`.
    label : int64 (m,)
        Which grain of the scene stands in each place.
    load : float64 (m,) or None
        Sums behind the normal force of friction.
    stripes : Stripes or None
        Grains in stripes, and their partners, where pairs end at a distance.
    verlet_list : VerletList or None
        De Paula's list of pairs.
    far_forces : FarForces or None
        The far field, and its forces.
    rooms : tuple
        Scratch of each law, or None; arrays of it are zero behind the grains.
    scratch : float64 (m,)
        For sums over the grains; zero behind them.
    buffers : float64 (parts, 5, m) or None
        Scratch of the pair sum.
    rounding : float64 (4, m) or None
        What rounding took from x, y, vx and vy in compensated sums; None with plain sums.
    slopes : Slopes or None
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
    wall_forces: np.ndarray
    label: np.ndarray
    load: np.ndarray | None
    stripes: Stripes | None
    verlet_list: VerletList | None
    far_forces: FarForces | None
    rooms: tuple[Any, ...]
    scratch: np.ndarray
    buffers: np.ndarray | None
    rounding: np.ndarray | None
    slopes: Slopes | None


class Measurement(NamedTuple):
    """Scratch of a measuring pass.

    Attributes
    ----------
    stiffness : float64 (m,)
        Row sums that bound the stiffest mode.
    extremes : float64 (2,)
        Pair sums: see `granular.pairs.direct`.
    against_piston : float64 (m,)
        Stiffness of each grain against the piston.
    """

    stiffness: np.ndarray
    extremes: np.ndarray
    against_piston: np.ndarray


KEPT = ("x", "y", "vx", "vy", "fx", "fy", "piston", "ledger", "clock", "wall_forces", "label")
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
    return State(
        x=x,
        y=y,
        vx=vx,
        vy=vy,
        fx=np.zeros_like(x),
        fy=np.zeros_like(x),
        piston=np.array([height, 0.0, 0.0, 0.0]),
        ledger=np.zeros(LOSSES + len(acting.laws)),
        clock=np.array([0.0, 0.0, 0.0, 0.0, np.inf, 0.0, 0.0]),
        wall_forces=np.zeros(4),
        label=np.arange(x.size),
        load=None if acting.weight is None else np.zeros_like(x),
        stripes=_stripes(x.size, acting),
        verlet_list=None
        if acting.listing is None
        else verlet_list_room(x.size, acting.listing.radius),
        far_forces=_far_forces(x.size, acting),
        rooms=tuple(_room(law, x.size, count) for law in acting.laws),
        scratch=np.zeros_like(x),
        buffers=part_buffers(x.size) if acting.cut is None and acting.listing is None else None,
        rounding=np.zeros((4, x.size)) if method.compensated else None,
        slopes=None if method.tableau is None else _slopes(len(method.tableau), x.size),
    )


def _room(law: Any, size: int, count: int) -> Any:
    return law.room(size, count) if hasattr(law, "room") else None


def _stripes(size: int, acting: Acting) -> Stripes | None:
    if acting.cut is None:
        return None
    cut = acting.cut
    return stripes_room(
        size, moments=cut.moments, loaded=acting.weight is not None, periods=cut.periods
    )


def _far_forces(size: int, acting: Acting) -> FarForces | None:
    if acting.far is None:
        return None
    return far_forces_room(acting.far, size, loaded=acting.weight is not None)


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


def _slopes(rows: int, size: int) -> Slopes:
    return Slopes(np.zeros((rows, 4, size)), np.zeros((rows, 2)))


def new_measurement(state: State) -> Measurement:
    return Measurement(np.zeros_like(state.x), np.zeros(2), np.zeros_like(state.x))
