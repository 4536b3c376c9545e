"""State of a run: plain padded arrays, in natural units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.kernel_data.constants import Constants
from granular.pairs.close_disc_corrections import CloseDiscList
from granular.pairs.mesh_far_field import FarFieldState
from granular.pairs.stripes import Stripes
from granular.pairs.verlet_list import VerletList

if TYPE_CHECKING:
    from jaxtyping import Float, Int

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

    grains: Float[np.ndarray, "s+1 4 m"]
    piston: Float[np.ndarray, "s+1 2"]


class State(NamedTuple):
    """The state of bed and piston, and the scratch arrays of the loop."""

    x: Float[np.ndarray, "m"]
    y: Float[np.ndarray, "m"]
    vx: Float[np.ndarray, "m"]
    vy: Float[np.ndarray, "m"]
    fx: Float[np.ndarray, "m"]
    fy: Float[np.ndarray, "m"]
    piston: Float[np.ndarray, "4"]
    ledger: Float[np.ndarray, "2+laws"]
    clock: Float[np.ndarray, "7"]
    wall_forces: Float[np.ndarray, "4"]
    label: Int[np.ndarray, "m"]
    load: Float[np.ndarray, "m"] | None
    stripes: Stripes | None
    verlet_list: VerletList | None
    far_forces: FarFieldState | None
    close: CloseDiscList | None
    workspaces: tuple[Any, ...]
    host: Any
    scratch: Float[np.ndarray, "m"]
    buffers: Float[np.ndarray, "parts 5 m"] | None
    rounding: Float[np.ndarray, "4 m"] | None
    slopes: StageSlopes | None


class Measurement(NamedTuple):
    """Scratch of a measuring pass."""

    stiffness: Float[np.ndarray, "m"]
    energy_and_closest: Float[np.ndarray, "2"]
    against_piston: Float[np.ndarray, "m"]


class Bed(NamedTuple):
    """The bed as kernels take it, by reference: what a run changes, and what it does not."""

    state: State
    constants: Constants


PERSISTENT = ("x", "y", "vx", "vy", "fx", "fy", "piston", "ledger", "clock", "wall_forces", "label")
"""Fields that a checkpoint holds; the others are scratch."""
