"""The piston: a wall that moves along a path, or a mass that the grains carry."""

from __future__ import annotations

import math

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import sum_of_hooks
from granular.effects import drag
from granular.effects.friction_law import velocity_factor_after_friction
from granular.effects.host_structure import PULL, PUSH, HostWorkspace
from granular.effects.wall_side import TOP
from granular.kernel_data.compensated_summation import compensated_sum
from granular.kernel_data.constants import Constants, PistonResistance
from granular.kernel_data.state import (
    HEIGHT,
    HEIGHT_ROUNDING,
    PISTON,
    SPEED,
    SPEED_ROUNDING,
    WORK,
    Bed,
    State,
)
from granular.protocol.piston_motion import TABLE, Motion, driven_height_and_velocity, outer_force_on_piston

upward_acceleration = sum_of_hooks("upward_acceleration", "time", 0.0)
"""Upward acceleration of all that has a mass, at a time [tau]."""

record_external_work = sum_of_hooks("record_external_work", "dt bed time")
"""Enter the work that forces which depend on time do in ``dt``, at a time [tau]."""


@compiled(inline=True)
def _inertial_force(workspace: HostWorkspace | None, constants: Constants) -> float:
    """Inertial force that a free piston lacks where a host accelerates the cell [F*]."""
    if workspace is None:
        return 0.0
    return constants.piston_mass * workspace.present[PUSH] - workspace.present[PULL]


@compiled
def _add_to_piston(rounding: Array | None, entry: int, error: int, by: float, piston: Array) -> None:
    """Add to height or speed; where they are compensated sums, with the entry of the rounding error."""
    if rounding is None:
        piston[entry] += by
    else:
        piston[entry], piston[error] = compensated_sum(piston[entry], piston[error], by)


@compiled(inline=True)
def _kick_against_resistance(
    resistance: PistonResistance | None, force: float, dt: float, mass: float, state: State, opens_step: bool
) -> None:
    if resistance is None:
        _add_to_piston(state.rounding, SPEED, SPEED_ROUNDING, dt * force / mass, state.piston)
    # One after the other, force and friction would stop a piston for good that is pushed on, and give a
    # creeping one more energy than it has.
    elif _stops_within_step(resistance, force, dt, mass, state):
        _slide_with_friction(resistance, force, dt, mass, state)
    elif opens_step:
        _accelerate_with_drag(resistance, force, dt, mass, state)
        _slow_by_friction(resistance, dt, mass, state)
    else:
        _slow_by_friction(resistance, dt, mass, state)
        _accelerate_with_drag(resistance, force, dt, mass, state)


@compiled
def _stops_within_step(
    resistance: PistonResistance, force: float, dt: float, mass: float, state: State
) -> bool:
    """Return whether the force and twice the friction would stop the piston within ``dt``."""
    v = state.piston[SPEED]
    against = max(-math.copysign(force, force * v), 0.0)
    return abs(v) * mass < dt * (against + 2.0 * resistance.force)


@compiled
def _accelerate_with_drag(
    resistance: PistonResistance, force: float, dt: float, mass: float, state: State
) -> None:
    """Force and drag, exactly."""
    decay, gain, a, b, c = drag.drag_flow_coefficients(resistance.rate, dt)
    v, push = state.piston[SPEED], force / mass
    state.piston[SPEED] = decay * v + gain * push
    state.ledger[PISTON] += mass * (a * v * v + b * v * push + c * push * push)


@compiled
def _slide_with_friction(
    resistance: PistonResistance, force: float, dt: float, mass: float, state: State
) -> None:
    """Force, drag and friction together, where friction alone could stop the piston."""
    v, rate, friction = state.piston[SPEED], resistance.rate, resistance.force
    if v != 0.0:
        sign = math.copysign(1.0, v)
        net = force - sign * friction
        decay, gain, _, _, _ = drag.drag_flow_coefficients(rate, dt)
        if sign * (decay * v + gain * net / mass) > 0.0:
            displacement = drag.displacement_under_drag(rate, dt, gain, abs(v), sign * net / mass)
            state.ledger[PISTON] += friction * displacement
            _accelerate_with_drag(resistance, net, dt, mass, state)
            return
        brake = -sign * net / mass
        displacement = drag.stopping_distance(rate, abs(v), brake)
        state.ledger[PISTON] += 0.5 * mass * v * v + sign * force * displacement
        state.piston[SPEED] = 0.0
        dt = max(dt - drag.stopping_time(rate, abs(v), brake), 0.0)
    if abs(force) > friction:
        net = force - math.copysign(friction, force)
        _, gain, _, _, _ = drag.drag_flow_coefficients(rate, dt)
        state.ledger[PISTON] += friction * drag.displacement_under_drag(rate, dt, gain, 0.0, abs(net) / mass)
        _accelerate_with_drag(resistance, net, dt, mass, state)


@compiled
def _slow_by_friction(resistance: PistonResistance, dt: float, mass: float, state: State) -> None:
    """Sliding piston loses speed, and stops where it has no more."""
    speed = abs(state.piston[SPEED])
    if speed > 0.0:
        left = velocity_factor_after_friction(speed, resistance.force * dt / mass)
        state.piston[SPEED] *= left
        state.ledger[PISTON] += 0.5 * mass * speed * speed * (1.0 - left * left)


@compiled
def prescribed_speed(motion: Motion, time: float, dt: float, opens_step: bool) -> float:
    """Speed on the path [D/tau]; dt, time [tau]."""
    if motion.kind == TABLE:
        # A table's speed jumps from row to row: the mean over the half step that the kick stands for.
        before = time if opens_step else time - dt
        return (
            driven_height_and_velocity(motion, before + dt)[0] - driven_height_and_velocity(motion, before)[0]
        ) / dt
    return driven_height_and_velocity(motion, time)[1]


@compiled(inline=True)
def kick_piston(dt: float, bed: Bed, motion: Motion, time: float, start: float, opens_step: bool) -> None:
    """Change the piston's velocity by its forces; enter the work from outside; dt, time, start [tau]."""
    state, constants = bed.state, bed.constants
    if motion.free:
        swing = upward_acceleration(constants.acting.laws, state.workspaces, start + time)
        outer = outer_force_on_piston(motion, time)
        force = (
            state.wall_forces[TOP] - constants.piston_weight + constants.piston_mass * swing + outer
        ) - _inertial_force(state.host, constants)
        before = state.piston[SPEED]
        _kick_against_resistance(constants.resistance, force, dt, constants.piston_mass, state, opens_step)
        # Force times mean velocity: the ledger then has the method's order.
        state.ledger[WORK] += 0.5 * dt * outer * (before + state.piston[SPEED])
    else:
        state.ledger[WORK] -= dt * state.wall_forces[TOP] * prescribed_speed(motion, time, dt, opens_step)
    record_external_work(constants.acting.laws, state.workspaces, dt, bed, start + time)


@compiled(inline=True)
def drift_piston(dt: float, bed: Bed, motion: Motion, time: float, start: float) -> None:
    """Move the piston: a free one at its velocity, a driven one along its path; dt, time, start [tau]."""
    state = bed.state
    if motion.free:
        _add_to_piston(state.rounding, HEIGHT, HEIGHT_ROUNDING, dt * state.piston[SPEED], state.piston)
    else:
        before = piston_energy(bed, start + time)
        height, velocity = driven_height_and_velocity(motion, time)
        state.piston[HEIGHT] = height
        state.piston[SPEED] = velocity
        state.ledger[WORK] += piston_energy(bed, start + time) - before


@compiled(inline=True)
def piston_energy(bed: Bed, time: float) -> float:
    """Kinetic and potential energy of the piston [F* D]; time [tau]."""
    state, constants = bed.state, bed.constants
    if not constants.piston_mass < math.inf:
        return 0.0
    swing = upward_acceleration(constants.acting.laws, state.workspaces, time)
    height, velocity = state.piston[HEIGHT], state.piston[SPEED]
    return (
        0.5 * constants.piston_mass * velocity * velocity
        + (constants.piston_weight - constants.piston_mass * swing) * height
    )
