"""Time-reversible variable steps: the density of steps follows the state by its rate.

Hairer and Soderlind, SIAM J. Sci. Comput. 26 (2005) 1838: with a control Q the step is eps/rho, and
rho_{n+1/2} = rho_{n-1/2} + eps G(q_n, v_n), G = -d ln Q/dt; the step is symmetric with the density
that it is made with. Here 1/Q = `granular.pairs.density.step_density`.
"""

from __future__ import annotations

import math
from typing import Any

from granular.compiled import compiled, entry
from granular.compiled.reference import by_reference
from granular.effects.wall_side import BOTTOM, LEFT, RIGHT, TOP
from granular.kernel_data.constants import Constants, moments_of
from granular.kernel_data.state import DENSITY, HEIGHT, LEAST, SPEED, SQUARE, State
from granular.pairs.density import step_density


@compiled
def _place(here: bool, value: float, away: float) -> float:
    return value if here else away


@compiled
def _sides(
    walls: tuple[Any, ...], width: float, height: float
) -> tuple[float, float, float, float]:
    return (
        _place(walls[LEFT] is not None, 0.0, -math.inf),
        _place(walls[RIGHT] is not None, width, math.inf),
        _place(walls[BOTTOM] is not None, 0.0, -math.inf),
        _place(walls[TOP] is not None, height, math.inf),
    )


@compiled
def _density(state: State, constants: Constants) -> tuple[float, float]:
    return step_density(
        state.x, state.y, state.vx, state.vy, constants.grains, moments_of(constants),
        state.clock[SQUARE], state.clock[LEAST],
        _sides(constants.acting.walls, constants.width, state.piston[HEIGHT]),
        state.piston[SPEED], constants.acting.dipole is not None,
    )  # fmt: skip


@entry
def open_density(
    speed: float, longest: float, fraction: float, state: State, constants: Constants
) -> None:
    """Set the density half a step before the present state, for grains of that speed [D/tau].

    Parameters
    ----------
    longest : float
        Longest step [tau].
    """
    state, constants = by_reference(state), by_reference(constants)
    state.clock[SQUARE] = speed * speed
    state.clock[LEAST] = fraction / longest
    density, rate = _density(state, constants)
    state.clock[DENSITY] = max(density - 0.5 * fraction * rate, state.clock[LEAST])


@compiled
def next_step(fraction: float, state: State, constants: Constants) -> float:
    """Advance the density by one step; the step [tau]."""
    _, rate = _density(state, constants)
    state.clock[DENSITY] = max(state.clock[DENSITY] + fraction * rate, 0.5 * state.clock[LEAST])
    return fraction / state.clock[DENSITY]
