"""Handwritten time steps, without any code of absent effects.

Reference for the engine's claim that an absent effect costs nothing: kick, drift, pair sum and wall loops
called directly. They record the same quantities of active effects as the engine: the force on every wall, and
the energy dissipated by drag.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np

from granular.effects import drag
from granular.effects.wall_laws import ExperimentalWall
from granular.pairs.direct_sum import direct_sum, reproducible_sum
from granular.pairs.grain_arrays import GrainArrays

_force = ExperimentalWall.force
_ABSENT = (None,) * 7

_by_hand = numba.njit(error_model="numpy", nogil=True)


class Bed(NamedTuple):
    """A bed under a fixed piston, in natural units.

    Attributes
    ----------
    x, y, vx, vy, fx, fy, push : float64 (m,)
        Padded arrays.
    totals : float64 (5,)
        Force on the left, right, bottom and top wall [F*]; energy lost to drag [F* D].
    grains : int
    width, height : float
        Size of the cell [D].
    """

    x: np.ndarray
    y: np.ndarray
    vx: np.ndarray
    vy: np.ndarray
    fx: np.ndarray
    fy: np.ndarray
    push: np.ndarray
    totals: np.ndarray
    grains: int
    width: float
    height: float


@_by_hand
def _pairs(bed: Bed) -> None:
    arrays = GrainArrays(bed.x, bed.y, bed.fx, bed.fy, *_ABSENT)
    direct_sum(arrays, None, None, None)


@_by_hand
def _walls(bed: Bed) -> None:
    push = bed.push
    for i in range(bed.grains):
        push[i] = _force(None, bed.x[i])
        bed.fx[i] += push[i]
    bed.totals[0] = reproducible_sum(push)
    for i in range(bed.grains):
        push[i] = _force(None, bed.width - bed.x[i])
        bed.fx[i] -= push[i]
    bed.totals[1] = reproducible_sum(push)
    for i in range(bed.grains):
        push[i] = _force(None, bed.y[i])
        bed.fy[i] += push[i]
    bed.totals[2] = reproducible_sum(push)
    for i in range(bed.grains):
        push[i] = _force(None, bed.height - bed.y[i])
        bed.fy[i] -= push[i]
    bed.totals[3] = reproducible_sum(push)


@_by_hand
def _drift(bed: Bed, h: float) -> None:
    for i in range(bed.grains):
        bed.x[i] += h * bed.vx[i]
        bed.y[i] += h * bed.vy[i]


@_by_hand
def _kick(bed: Bed, total_duration: float) -> None:
    for i in range(bed.grains):
        bed.vx[i] += total_duration * bed.fx[i]
        bed.vy[i] += total_duration * bed.fy[i]


@_by_hand
def _kick_with_drag(bed: Bed, rate: float, total_duration: float) -> None:
    decay, gain, a, b, c = drag.exact_drag_step_factors(rate, total_duration)
    for i in range(bed.grains):
        ax, ay, vx, vy = bed.fx[i], bed.fy[i], bed.vx[i], bed.vy[i]
        bed.vx[i] = decay * vx + gain * ax
        bed.vy[i] = decay * vy + gain * ay
        bed.push[i] = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
    bed.totals[4] += reproducible_sum(bed.push)


@_by_hand
def pairs_and_walls(bed: Bed, gravity: float, rate: float, h: float, steps: int) -> None:
    """Make steps with dipoles and walls only."""
    for _ in range(steps):
        _kick(bed, 0.5 * h)
        _drift(bed, h)
        _pairs(bed)
        _walls(bed)
        _kick(bed, 0.5 * h)


@_by_hand
def with_gravity(bed: Bed, gravity: float, rate: float, h: float, steps: int) -> None:
    """Make steps with dipoles, walls and gravity."""
    for _ in range(steps):
        _kick(bed, 0.5 * h)
        _drift(bed, h)
        _pairs(bed)
        for i in range(bed.grains):
            bed.fy[i] -= gravity
        _walls(bed)
        _kick(bed, 0.5 * h)


@_by_hand
def with_gravity_and_drag(bed: Bed, gravity: float, rate: float, h: float, steps: int) -> None:
    """Make steps with dipoles, walls, gravity and drag."""
    for _ in range(steps):
        _kick_with_drag(bed, rate, 0.5 * h)
        _drift(bed, h)
        _pairs(bed)
        for i in range(bed.grains):
            bed.fy[i] -= gravity
        _walls(bed)
        _kick_with_drag(bed, rate, 0.5 * h)


KERNELS: dict[str, tuple[Any, dict[str, Any]]] = {
    "dipole, walls": (pairs_and_walls, {"effects.gravity": None, "effects.drag": None}),
    "dipole, walls, gravity": (with_gravity, {"effects.drag": None}),
    "dipole, walls, gravity, drag": (with_gravity_and_drag, {}),
}
"""Each handwritten kernel, with the keys of the packaged bed that give the same scene."""
