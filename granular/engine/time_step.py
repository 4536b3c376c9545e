"""One time step, by the tables of a method: a composition of kicks and drifts, or Runge-Kutta."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import call_last_hook
from granular.engine.bodies import close_drift_of_bodies, kick_bodies, open_drift_of_bodies
from granular.engine.forces import compute_and_measure_forces, compute_forces
from granular.engine.runge_kutta import runge_kutta_step
from granular.engine.step_size import StepRequest
from granular.kernel_data.compensated_summation import compensated_sum
from granular.kernel_data.state import Bed, Measurement, State, X, Y
from granular.methods import Method
from granular.pairs.mesh_far_field import FarFieldSettings
from granular.protocol.piston_motion import Motion

if TYPE_CHECKING:
    from jaxtyping import Float


class StepPlan(NamedTuple):
    """The tables of a method; see `granular.methods`."""

    kicks: np.ndarray  # fractions of the step (s + 1,)
    drifts: np.ndarray  # fractions of the step (s,)
    tableau: Float[np.ndarray, "s+1 s"] | None  # weights in the last row; None: a composition
    fraction: float | None  # of variable steps: step times frequency; None: equal steps
    far_every: int | None  # steps from impulse to impulse; None: none


def make_step_plan(method: Method, step: StepRequest, far: FarFieldSettings | None) -> StepPlan:
    """Make the tables of a method that the loop takes."""
    tableau = None if method.tableau is None else np.array(method.tableau)
    fraction = step.step_times_frequency if method.variable else None
    every = None if far is None else far.every
    return StepPlan(np.array(method.kicks), np.array(method.drifts), tableau, fraction, every)


@compiled(inline=True)
def drift_grains(rounding: Float[Array, "4 m"] | None, dt: float, state: State, count: int) -> None:
    """Move the grains at their present velocities; dt [tau], state [D]."""
    if rounding is None:
        for i in range(count):
            state.x[i] += dt * state.vx[i]
            state.y[i] += dt * state.vy[i]
    else:
        for i in range(count):
            by_x, by_y = dt * state.vx[i], dt * state.vy[i]
            state.x[i], rounding[X, i] = compensated_sum(state.x[i], rounding[X, i], by_x)
            state.y[i], rounding[Y, i] = compensated_sum(state.y[i], rounding[Y, i], by_y)


@compiled(inline=True)
def _drift_without_effects(dt: float, bed: Bed) -> int:
    state, constants = bed.state, bed.constants
    drift_grains(state.rounding, dt, state, constants.grains)
    return 0


_drift_all = call_last_hook("drift", "dt bed", _drift_without_effects)


# One function, though long: each level of calls is optimised anew and costs seconds to compile.
@compiled(inline=True)
def advance_one_step(
    tableau: Float[Array, "s+1 s"] | None,
    plan: StepPlan,
    h: float,
    time: float,
    start: float,
    bed: Bed,
    motion: Motion,
    measurement: Measurement,
    measuring: bool,
) -> int:
    """Make one step by the method's tables; h, time, start [tau]."""
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
                    kick_bodies(constants.acting.host, state.host, dt, bed, motion, stage, start, opens_step)
            if k < stages:
                dt = drifts[k] * h
                stage += dt
                open_drift_of_bodies(constants.acting.host, dt, bed, motion, stage)
                _drift_all(constants.acting.laws, state.workspaces, dt, bed)
                close_drift_of_bodies(constants.acting.host, dt, bed, motion, stage, start)
                last = k == stages - 1
                if last and measuring:
                    outside += compute_and_measure_forces(bed, start + stage, measurement)
                elif not last or kicks[stages] != 0.0 or kicks[0] != 0.0:
                    outside += compute_forces(bed, start + stage)
    return outside
