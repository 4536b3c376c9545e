"""Time-reversible variable steps: the density of steps follows the state by its rate.

Hairer and Soderlind, SIAM J. Sci. Comput. 26 (2005) 1838: with a control Q the step is eps/rho, and
rho_{n+1/2} = rho_{n-1/2} + eps G(q_n, v_n), G = -d ln Q/dt; the step is symmetric with the density
that it is made with. Here 1/Q = `step_density`, a smooth bound of the highest frequency.

Only differentiable functions of the positions serve a reversible control of the step, so each pair
and each wall enters the sum with the same law, whatever the scene's wall law is; a power mean of
them is close to the largest.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from granular.compiled import Array, compiled, entry
from granular.compiled.by_reference import by_reference
from granular.compiled.hook_calls import sum_of_hooks
from granular.kernel_data.constants import Constants, relative_moments
from granular.kernel_data.state import DENSITY, LEAST, SQUARE, Bed, State

if TYPE_CHECKING:
    from jaxtyping import Float

_POWER = 4
"""Power of the mean: with 4, a thousand equal terms raise the frequency by (1000)^(1/8) = 2.4."""


@compiled
def _fourth_power_and_rate(gap: float, rate: float, fraction: float, square: float) -> tuple[float, float]:
    """kappa^4 and its rate, for kappa = share/gap^5 + square/gap^2 and d gap/dt = rate."""
    inverse = 1.0 / gap
    near, far = fraction * inverse**5, square * inverse**2
    kappa = near + far
    cube = kappa * kappa * kappa
    return cube * kappa, -_POWER * cube * (5.0 * near + 2.0 * far) * inverse * rate


@compiled
def step_density(
    x: Float[Array, "m"],
    y: Float[Array, "m"],
    vx: Float[Array, "m"],
    vy: Float[Array, "m"],
    count: int,
    moments: Float[Array, "m"] | None,
    square: float,
    least: float,
    walls: Float[Array, "sides 4"],
    pairs: bool,
) -> tuple[float, float]:
    """Smooth frequency, its logarithmic rate [1/tau]; x [D], vx [D/tau], square [D^2/tau^2]."""
    # omega^8 = sum of kappa^4 + least^8, with kappa a squared frequency, over all pairs and walls.
    total, rate = least**8, 0.0
    for i in range(count):
        qi = 1.0 if moments is None else moments[i]
        if pairs:
            for j in range(i):
                qj = 1.0 if moments is None else moments[j]
                dx, dy = x[i] - x[j], y[i] - y[j]
                r = math.sqrt(dx * dx + dy * dy)
                closing = (dx * (vx[i] - vx[j]) + dy * (vy[i] - vy[j])) / r
                value, change = _fourth_power_and_rate(r, closing, 3.0 * (qi + qj), 4.0 * square)
                total += value
                rate += change
        for k in range(len(walls)):
            nx, ny, offset, lift = walls[k]
            gap = nx * x[i] + (ny * y[i] - offset)
            if gap < math.inf:
                speed = nx * vx[i] + ny * (vy[i] - lift)
                value, change = _fourth_power_and_rate(gap, speed, 1.75, square)
                total += value
                rate += change
    return total**0.125, 0.125 * rate / total


_fill_wall = sum_of_hooks("fill_wall", "bed walls")


@compiled
def _bed_step_density(bed: Bed) -> tuple[float, float]:
    state, constants = bed.state, bed.constants
    walls = np.empty((state.wall_forces.size, 4))
    _fill_wall(constants.acting.sides, constants.acting.sides, bed, walls)
    return step_density(
        state.x,
        state.y,
        state.vx,
        state.vy,
        constants.grains,
        relative_moments(constants),
        state.clock[SQUARE],
        state.clock[LEAST],
        walls,
        constants.acting.dipole is not None,
    )


@entry
def initialise_step_density(
    speed: float, longest: float, fraction: float, state: State, constants: Constants
) -> None:
    """Set the density half a step before the present state; speed [D/tau], longest [tau]."""
    bed = by_reference(Bed(state, constants))
    state.clock[SQUARE] = speed * speed
    state.clock[LEAST] = fraction / longest
    density, rate = _bed_step_density(bed)
    state.clock[DENSITY] = max(density - 0.5 * fraction * rate, state.clock[LEAST])


@compiled
def advance_step_density(fraction: float, bed: Bed) -> float:
    """Advance the density of steps by one step [tau]."""
    state = bed.state
    _, rate = _bed_step_density(bed)
    # rho_{n+1/2} = rho_{n-1/2} + eps d ln(omega)/dt; half the least: a fast retreat must not make it
    # negative.
    state.clock[DENSITY] = max(state.clock[DENSITY] + fraction * rate, 0.5 * state.clock[LEAST])
    return fraction / state.clock[DENSITY]
