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
    """Rates of change at the stages of a Runge-Kutta step; behind them, where the step starts."""

    grains: np.ndarray
    piston: np.ndarray


class State(NamedTuple):
    """The state of bed and piston, and the scratch arrays of the loop."""

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
    """Scratch of a measuring pass."""

    stiffness: np.ndarray
    energy_and_closest: np.ndarray
    against_piston: np.ndarray


class Bed(NamedTuple):
    """The bed as kernels take it, by reference: what a run changes, and what it does not."""

    state: State
    constants: Constants


PERSISTENT = ("x", "y", "vx", "vy", "fx", "fy", "piston", "ledger", "clock", "wall_forces", "label")
"""Fields that a checkpoint holds; the others are scratch."""
