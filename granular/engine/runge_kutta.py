"""A step of an explicit Runge-Kutta method: not symplectic, the control of those that are.

It takes forces alone: `granular.run.time_steps` refuses what dissipates, and a host.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from granular.compiled import Array, compiled
from granular.effects.wall_kernels import force_on_body
from granular.engine.bodies import piston_energy, record_external_work, upward_acceleration
from granular.engine.forces import compute_and_measure_forces, compute_forces
from granular.kernel_data.state import (
    HEIGHT,
    PISTON,
    SPEED,
    VX,
    VY,
    WORK,
    Bed,
    Measurement,
    StageSlopes,
    State,
    X,
    Y,
)
from granular.pairs.grain_arrays import value_or_one
from granular.protocol.piston_motion import Motion, driven_height_and_velocity, outer_force_on_piston

if TYPE_CHECKING:
    from jaxtyping import Float


@compiled
def _fill_grain_slopes(slopes: Array, bed: Bed) -> None:
    """Slopes of positions and velocities."""
    state, constants = bed.state, bed.constants
    for i in range(constants.grains):
        mass = value_or_one(constants.masses, i)
        slopes[X, i] = state.vx[i]
        slopes[Y, i] = state.vy[i]
        slopes[VX, i] = state.fx[i] / mass
        slopes[VY, i] = state.fy[i] / mass


@compiled
def _fill_piston_slopes(
    slopes: Array, dt: float, time: float, start: float, bed: Bed, motion: Motion
) -> None:
    state, constants = bed.state, bed.constants
    if motion.free:
        frame = upward_acceleration(constants.acting.laws, state.workspaces, start + time)
        outer = outer_force_on_piston(motion, time)
        force = force_on_body(bed, PISTON) - constants.piston_weight + outer
        slopes[HEIGHT] = state.piston[SPEED]
        slopes[SPEED] = force / constants.piston_mass + frame
        state.ledger[WORK] += dt * outer * state.piston[SPEED]
    else:
        state.ledger[WORK] -= dt * force_on_body(bed, PISTON) * driven_height_and_velocity(motion, time)[1]
    record_external_work(constants.acting.laws, state.workspaces, dt, bed, start + time)


@compiled
def _store_step_start(state: State, slopes: StageSlopes, count: int) -> None:
    base = slopes.grains[-1]
    for i in range(count):
        base[X, i] = state.x[i]
        base[Y, i] = state.y[i]
        base[VX, i] = state.vx[i]
        base[VY, i] = state.vy[i]
    slopes.piston[-1, HEIGHT] = state.piston[HEIGHT]
    slopes.piston[-1, SPEED] = state.piston[SPEED]


@compiled
def _move_to_stage(
    weights: Array, slopes: StageSlopes, h: float, time: float, state: State, count: int, motion: Motion
) -> None:
    """State at a stage: the base and the weighted slopes so far."""
    base = slopes.grains[-1]
    for i in range(count):
        x, y, vx, vy = base[X, i], base[Y, i], base[VX, i], base[VY, i]
        for j in range(weights.size):
            x += h * weights[j] * slopes.grains[j, X, i]
            y += h * weights[j] * slopes.grains[j, Y, i]
            vx += h * weights[j] * slopes.grains[j, VX, i]
            vy += h * weights[j] * slopes.grains[j, VY, i]
        state.x[i], state.y[i], state.vx[i], state.vy[i] = x, y, vx, vy
    if motion.free:
        height, speed = slopes.piston[-1, HEIGHT], slopes.piston[-1, SPEED]
        for j in range(weights.size):
            height += h * weights[j] * slopes.piston[j, HEIGHT]
            speed += h * weights[j] * slopes.piston[j, SPEED]
        state.piston[HEIGHT], state.piston[SPEED] = height, speed
    else:
        state.piston[HEIGHT], state.piston[SPEED] = driven_height_and_velocity(motion, time)


@compiled
def runge_kutta_step(
    tableau: Float[Array, "s+1 s"],
    slopes: StageSlopes,
    h: float,
    time: float,
    start: float,
    bed: Bed,
    motion: Motion,
    measurement: Measurement,
    measuring: bool,
) -> int:
    """Make one explicit Runge-Kutta step (Hairer, Norsett and Wanner 1993, II.1); h, time, start [tau]."""
    state, constants = bed.state, bed.constants
    stages = tableau.shape[1]
    count = constants.grains
    outside = 0
    _store_step_start(state, slopes, count)
    before = piston_energy(bed, start + time)
    for k in range(stages):
        instant = time + h * tableau[k].sum()
        if k > 0:
            _move_to_stage(tableau[k, :k], slopes, h, instant, state, count, motion)
            outside += compute_forces(bed, start + instant)
        # Work is integrated with the weights of the last row, as the positions are.
        dt = h * tableau[stages, k]
        _fill_grain_slopes(slopes.grains[k], bed)
        _fill_piston_slopes(slopes.piston[k], dt, instant, start, bed, motion)
    end = time + h
    _move_to_stage(tableau[stages], slopes, h, end, state, count, motion)
    if not motion.free:
        state.ledger[WORK] += piston_energy(bed, start + end) - before
    if measuring:
        outside += compute_and_measure_forces(bed, start + end, measurement)
    else:
        outside += compute_forces(bed, start + end)
    return outside
