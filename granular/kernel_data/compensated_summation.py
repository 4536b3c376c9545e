"""Compensated sums: what a sum loses to rounding is kept and enters the next one.

Kahan, Commun. ACM 8 (1965) 40; for integrators Hairer, Lubich and Wanner, Geometric Numerical
Integration (2006), VIII.5.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from granular.compiled import Array, compiled
from granular.kernel_data.state import VX, VY, State

if TYPE_CHECKING:
    from jaxtyping import Float


@compiled
def compensated_sum(total: float, rounding: float, increment: float) -> tuple[float, float]:
    """Sum of a total and an increment, and what rounding took from it (Kahan 1965)."""
    wanted = increment + rounding
    new = total + wanted
    return new, wanted - (new - total)


@compiled
def add_to_velocity(
    rounding: Float[Array, "4 m"] | None, state: State, i: int, by_x: float, by_y: float
) -> None:
    """Add to a velocity [D/tau], as a compensated sum where what rounding takes is kept."""
    if rounding is None:
        state.vx[i] += by_x
        state.vy[i] += by_y
    else:
        state.vx[i], rounding[VX, i] = compensated_sum(state.vx[i], rounding[VX, i], by_x)
        state.vy[i], rounding[VY, i] = compensated_sum(state.vy[i], rounding[VY, i], by_y)
