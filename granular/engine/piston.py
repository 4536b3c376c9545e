"""The piston: a wall that moves along a path, or a mass that the grains carry."""

from __future__ import annotations

import math

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import sum_of_hooks
from granular.effects.host_structure import PULL, PUSH, HostWorkspace
from granular.effects.slide import drag_flow_coefficients, slide
from granular.effects.wall_kernels import force_on_piston
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
    resistance: PistonResistance | None, force: float, dt: float, mass: float, state: State
) -> None:
    if resistance is None:
        _add_to_piston(state.rounding, SPEED, SPEED_ROUNDING, dt * force / mass, state.piston)
    else:
        rate, friction = resistance.rate, resistance.force
        flow, speed = drag_flow_coefficients(rate, dt), (0.0, state.piston[SPEED])
        _, state.piston[SPEED], dragged, rubbed = slide(
            rate, dt, flow, mass, speed, (0.0, force), 1.0, 1.0, friction
        )
        state.ledger[PISTON] += dragged + rubbed


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
            force_on_piston(bed) - constants.piston_weight + constants.piston_mass * swing + outer
        ) - _inertial_force(state.host, constants)
        before = state.piston[SPEED]
        _kick_against_resistance(constants.resistance, force, dt, constants.piston_mass, state)
        # Force times mean velocity: the ledger then has the method's order.
        state.ledger[WORK] += 0.5 * dt * outer * (before + state.piston[SPEED])
    else:
        state.ledger[WORK] -= dt * force_on_piston(bed) * prescribed_speed(motion, time, dt, opens_step)
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
