"""State of a run: plain padded arrays, in natural units."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from granular.kernel_data.constants import Constants
from granular.pairs.close_disc_corrections import CloseDiscList
from granular.pairs.mesh_far_field import FarFieldState
from granular.pairs.stripes import Stripes
from granular.pairs.verlet_list import VerletList

X, Y, VX, VY = range(4)
"""Rows of what is kept of the grains: positions and velocities together."""

HEIGHT, SPEED, HEIGHT_ROUNDING, SPEED_ROUNDING = range(4)
"""Entries of the piston."""

TIME, DENSITY, SQUARE, LEAST, SHORTEST, LONGEST, STEPS = range(7)
"""Entries of a state's clock: time in the stage; density of steps, and the square of the speed that
it heeds; density where nothing is near; shortest and longest step so far; steps made in the run."""

WORK, PISTON, LOSSES = range(3)
"""Entries of the ledger: work done from outside; what the piston loses; from there on, what each
effect takes, in the order of the laws."""


class StageSlopes(NamedTuple):
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
        Entries `TIME` to `STEPS`.
    wall_forces : float64 (4,)
        Force on each wall, in the order of `granular.effects.wall_side.SIDES`.
    label : int64 (m,)
        Index in the scene of the grain at each index here.
    load : float64 (m,) or None
        Sums behind the normal force of friction.
    stripes : Stripes or None
        Grains in stripes, and their partners, where pairs end at a distance.
    verlet_list : VerletList or None
        De Paula's list of pairs.
    far_forces : FarFieldState or None
        The far field, and its forces.
    close : CloseDiscList or None
        List of close pairs of discs.
    workspaces : tuple
        Scratch of each law, or None; arrays of it are zero behind the grains.
    host : HostWorkspace or None
        That of what carries the cell, which moves all the others.
    scratch : float64 (m,)
        For sums over the grains; zero behind them.
    buffers : float64 (parts, 5, m) or None
        Scratch of the pair sum.
    rounding : float64 (4, m) or None
        Rounding errors of x, y, vx and vy in compensated sums; None with plain sums.
    slopes : StageSlopes or None
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
    far_forces: FarFieldState | None
    close: CloseDiscList | None
    workspaces: tuple[Any, ...]
    host: Any
    scratch: np.ndarray
    buffers: np.ndarray | None
    rounding: np.ndarray | None
    slopes: StageSlopes | None


class Measurement(NamedTuple):
    """Scratch of a measuring pass.

    Attributes
    ----------
    stiffness : float64 (m,)
        Row sums that bound the stiffest mode.
    energy_and_closest : float64 (2,)
        Pair sums: see `granular.pairs.direct_sum`.
    against_piston : float64 (m,)
        Stiffness of each grain against the piston.
    """

    stiffness: np.ndarray
    energy_and_closest: np.ndarray
    against_piston: np.ndarray


class Bed(NamedTuple):
    """The bed as kernels take it, by reference: what a run changes, and what it does not."""

    state: State
    constants: Constants


PERSISTENT = ("x", "y", "vx", "vy", "fx", "fy", "piston", "ledger", "clock", "wall_forces", "label")
"""Fields that a checkpoint holds; the others are scratch."""
