"""One time step by the tables of a method: a composition of kicks and drifts, or Runge-Kutta.

Runge-Kutta methods are not symplectic, and serve for comparison with symplectic methods. They support only
conservative forces: `granular.run.time_steps` rejects dissipative effects and structures that carry the cell.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import make_last_hook_kernel
from granular.effects.wall_laws import upward_force_of_grains_on_body
from granular.engine.bodies import (
    kick_grains_and_bodies,
    move_bodies,
    piston_energy,
    record_external_work,
    set_mean_speed_of_driven_piston,
    upward_acceleration,
)
from granular.engine.forces import compute_and_measure_forces, compute_forces
from granular.engine.step_size import StepRequest
from granular.kernel_data.state import (
    HEIGHT,
    PISTON,
    SPEED,
    VX,
    VY,
    WORK,
    Bed,
    MeasurementScratchArrays,
    RungeKuttaStageSlopes,
    State,
    X,
    Y,
    compensated_sum_and_rounding_error,
)
from granular.methods import Method
from granular.pairs.far_field import FarFieldSettings
from granular.pairs.grain_arrays import value_or_one
from granular.protocol.piston_motion import PistonMotion, driven_height_and_velocity, outer_force_on_piston
from granular.shared.array_types import Float


@compiled
def _fill_time_derivatives_of_grains(slopes: Array, bed: Bed) -> None:
    """Fill in the rates of change of positions and velocities."""
    state, constants = bed.state, bed.constants
    for i in range(constants.grains):
        mass = value_or_one(constants.masses, i)
        slopes[X, i] = state.vx[i]
        slopes[Y, i] = state.vy[i]
        slopes[VX, i] = state.fx[i] / mass
        slopes[VY, i] = state.fy[i] / mass


@compiled
def _fill_time_derivatives_of_piston(
    slopes: Array, dt: float, time: float, start: float, bed: Bed, motion: PistonMotion
) -> None:
    state, constants = bed.state, bed.constants
    if motion.free:
        frame = upward_acceleration(constants.acting.laws, state.workspaces, start + time)
        outer = outer_force_on_piston(motion, time)
        force = upward_force_of_grains_on_body(bed, PISTON) - constants.piston_weight + outer
        slopes[HEIGHT] = state.piston[SPEED]
        slopes[SPEED] = force / constants.piston_mass + frame
        state.ledger[WORK] += dt * outer * state.piston[SPEED]
    else:
        state.ledger[WORK] -= (
            dt * upward_force_of_grains_on_body(bed, PISTON) * driven_height_and_velocity(motion, time)[1]
        )
    record_external_work(constants.acting.laws, state.workspaces, dt, bed, start + time)


@compiled
def _store_state_at_step_start(state: State, slopes: RungeKuttaStageSlopes, count: int) -> None:
    base = slopes.grains[-1]
    for i in range(count):
        base[X, i] = state.x[i]
        base[Y, i] = state.y[i]
        base[VX, i] = state.vx[i]
        base[VY, i] = state.vy[i]
    slopes.piston[-1, HEIGHT] = state.piston[HEIGHT]
    slopes.piston[-1, SPEED] = state.piston[SPEED]


@compiled
def _set_state_at_runge_kutta_stage(
    weights: Array,
    slopes: RungeKuttaStageSlopes,
    h: float,
    time: float,
    state: State,
    count: int,
    motion: PistonMotion,
) -> None:
    """Set the state to the initial state of the step plus h times the weighted slopes of earlier stages."""
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
    slopes: RungeKuttaStageSlopes,
    h: float,
    time: float,
    start: float,
    bed: Bed,
    motion: PistonMotion,
    measurement: MeasurementScratchArrays,
    measuring: bool,
) -> int:
    """Make one explicit Runge-Kutta step of length ``h`` (Hairer, Norsett and Wanner 1993, II.1)."""
    state, constants = bed.state, bed.constants
    stages = tableau.shape[1]
    count = constants.grains
    outside = 0
    _store_state_at_step_start(state, slopes, count)
    before = piston_energy(bed, start + time)
    for k in range(stages):
        instant = time + h * tableau[k].sum()
        if k > 0:
            _set_state_at_runge_kutta_stage(tableau[k, :k], slopes, h, instant, state, count, motion)
            outside += compute_forces(bed, start + instant)
        # Work is integrated with the weights of the last row, like the positions.
        dt = h * tableau[stages, k]
        _fill_time_derivatives_of_grains(slopes.grains[k], bed)
        _fill_time_derivatives_of_piston(slopes.piston[k], dt, instant, start, bed, motion)
    end = time + h
    _set_state_at_runge_kutta_stage(tableau[stages], slopes, h, end, state, count, motion)
    if not motion.free:
        state.ledger[WORK] += piston_energy(bed, start + end) - before
    if measuring:
        outside += compute_and_measure_forces(bed, start + end, measurement)
    else:
        outside += compute_forces(bed, start + end)
    return outside


class MethodTables(NamedTuple):
    """Coefficients of a method (`granular.methods`) and interval of the far field, for the loop."""

    kicks: np.ndarray  # fractions of the step (s + 1,)
    drifts: np.ndarray  # fractions of the step (s,)
    tableau: Float[np.ndarray, "s+1 s"] | None  # weights in the last row; None: a composition
    fraction: float | None  # step times frequency for variable steps; None: equal steps
    far_every: int | None  # steps from impulse to impulse; None: no impulses


def make_method_tables(method: Method, step: StepRequest, far: FarFieldSettings | None) -> MethodTables:
    """Return the coefficients of a method as arrays for the loop."""
    tableau = None if method.tableau is None else np.array(method.tableau)
    fraction = step.step_times_frequency if method.variable else None
    every = None if far is None else far.every
    return MethodTables(np.array(method.kicks), np.array(method.drifts), tableau, fraction, every)


@compiled(inline=True)
def drift_grains(rounding: Float[Array, "4 m"] | None, dt: float, state: State, count: int) -> None:
    """Move the grains at their present velocities for a time ``dt``."""
    if rounding is None:
        for i in range(count):
            state.x[i] += dt * state.vx[i]
            state.y[i] += dt * state.vy[i]
    else:
        for i in range(count):
            by_x, by_y = dt * state.vx[i], dt * state.vy[i]
            state.x[i], rounding[X, i] = compensated_sum_and_rounding_error(state.x[i], rounding[X, i], by_x)
            state.y[i], rounding[Y, i] = compensated_sum_and_rounding_error(state.y[i], rounding[Y, i], by_y)


@compiled(inline=True)
def _drift_without_effects(dt: float, bed: Bed) -> int:
    state, constants = bed.state, bed.constants
    drift_grains(state.rounding, dt, state, constants.grains)
    return 0


_drift_all = make_last_hook_kernel("drift", "dt bed", _drift_without_effects)


# One long function: each level of calls is optimised separately and costs seconds to compile.
@compiled(inline=True)
def advance_one_step(
    tableau: Float[Array, "s+1 s"] | None,
    plan: MethodTables,
    h: float,
    time: float,
    start: float,
    bed: Bed,
    motion: PistonMotion,
    measurement: MeasurementScratchArrays,
    measuring: bool,
) -> int:
    """Make one step of length ``h`` with the tables of the method."""
    state, constants = bed.state, bed.constants
    outside = 0
    if tableau is not None:
        assert state.slopes is not None
        outside = runge_kutta_step(tableau, state.slopes, h, time, start, bed, motion, measurement, measuring)
    else:
        stage = time
        kicks, drifts = plan.kicks, plan.drifts
        stages = drifts.size
        for k in range(stages + 1):
            # A kick in the middle closes one half of the step and opens the other.
            parts = 2 if 2 * k == stages else 1
            for part in range(parts):
                if kicks[k] != 0.0:
                    opens_step = 2 * k + part < stages + parts - 1
                    dt = kicks[k] * h / parts
                    kick_grains_and_bodies(
                        constants.acting.host, state.host, dt, bed, motion, stage, start, opens_step
                    )
            if k < stages:
                dt = drifts[k] * h
                stage += dt
                set_mean_speed_of_driven_piston(constants.acting.host, dt, bed, motion, stage)
                _drift_all(constants.acting.laws, state.workspaces, dt, bed)
                move_bodies(constants.acting.host, dt, bed, motion, stage, start)
                last = k == stages - 1
                if last and measuring:
                    outside += compute_and_measure_forces(bed, start + stage, measurement)
                elif not last or kicks[stages] != 0.0 or kicks[0] != 0.0:
                    outside += compute_forces(bed, start + stage)
    return outside
