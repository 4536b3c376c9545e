"""Compensated sums: what a sum loses to rounding is kept and enters the next one.

Kahan, Commun. ACM 8 (1965) 40; for integrators Hairer, Lubich and Wanner, Geometric Numerical
Integration (2006), VIII.5.
"""

from __future__ import annotations

from granular.compiled import Array, compiled
from granular.kernel_data.state import VX, VY, State


@compiled
def compensated_sum(total: float, rounding: float, increment: float) -> tuple[float, float]:
    """Sum of a total and an increment, and what rounding took from it.

    Kahan, Commun. ACM 8 (1965) 40.

    Parameters
    ----------
    total : float
        Sum so far.
    rounding : float
        Amount that rounding took so far.
    increment : float
        Number to add; all in the same unit.

    Returns
    -------
    total, rounding : float
        New sum, and what rounding took, in that unit.
    """
    wanted = increment + rounding
    new = total + wanted
    return new, wanted - (new - total)


@compiled
def add_to_velocity(rounding: Array | None, state: State, i: int, by_x: float, by_y: float) -> None:
    """Add to the velocity of a grain, as a compensated sum where what rounding takes is kept.

    Parameters
    ----------
    rounding : float64 (4, m) or None
        Rounding errors of compensated sums; None with plain sums.
    state : State
        State of the run, whose velocities change.
    i : int
        Index of the grain.
    by_x : float
        Change of vx [D/tau].
    by_y : float
        Change of vy [D/tau].
    """
    if rounding is None:
        state.vx[i] += by_x
        state.vy[i] += by_y
    else:
        state.vx[i], rounding[VX, i] = compensated_sum(state.vx[i], rounding[VX, i], by_x)
        state.vy[i], rounding[VY, i] = compensated_sum(state.vy[i], rounding[VY, i], by_y)
