"""The piston: a wall that moves along a path, or a mass that the grains carry."""

from __future__ import annotations

import math

from granular.compiled import Array, compiled
from granular.effects import drag
from granular.effects.friction import sliding
from granular.effects.shaking import (
    Swing,
    acceleration,
    acceleration_rate,
    mass_moment,
)
from granular.engine.compensation import sum_with_low_part
from granular.engine.motion import TABLE, Motion, outer_force, path
from granular.engine.state import PISTON, WORK, State
from granular.engine.system import Constants, Resistance


@compiled
def _raise_speed(low: Array | None, by: float, state: State) -> None:
    if low is None:
        state.piston[1] += by
    else:
        state.piston[1], state.piston[3] = sum_with_low_part(state.piston[1], state.piston[3], by)


@compiled
def _raise_height(low: Array | None, by: float, state: State) -> None:
    if low is None:
        state.piston[0] += by
    else:
        state.piston[0], state.piston[2] = sum_with_low_part(state.piston[0], state.piston[2], by)


@compiled(inline=True)
def _free_kick(
    resistance: Resistance | None, force: float, span: float, mass: float, state: State,
    opening: bool,
) -> None:  # fmt: skip
    if resistance is None:
        _raise_speed(state.low, span * force / mass, state)
    elif _slow(resistance, force, span, mass, state):
        _slide(resistance, force, span, mass, state)
    elif opening:
        _push(resistance, force, span, mass, state)
        _rub(resistance, span, mass, state)
    else:
        _rub(resistance, span, mass, state)
        _push(resistance, force, span, mass, state)


@compiled
def _slow(resistance: Resistance, force: float, span: float, mass: float, state: State) -> bool:
    """Whether the force and twice the friction would stop the piston in the span."""
    v = state.piston[1]
    against = max(-math.copysign(force, force * v), 0.0)
    return abs(v) * mass < span * (against + 2.0 * resistance.force)


@compiled
def _push(resistance: Resistance, force: float, span: float, mass: float, state: State) -> None:
    """Force and drag, exactly."""
    decay, gain, a, b, c = drag.flow(resistance.rate, span)
    v, push = state.piston[1], force / mass
    state.piston[1] = decay * v + gain * push
    state.ledger[PISTON] += mass * (a * v * v + b * v * push + c * push * push)


@compiled
def _slide(resistance: Resistance, force: float, span: float, mass: float, state: State) -> None:
    """Force, drag and friction together, where friction alone could stop the piston.

    As for grains: one after the other, they would stop for good a piston that is pushed on, and
    give a creeping one more energy than it has.
    """
    v, rate, friction = state.piston[1], resistance.rate, resistance.force
    if v != 0.0:
        sign = math.copysign(1.0, v)
        net = force - sign * friction
        decay, gain, _, _, _ = drag.flow(rate, span)
        if sign * (decay * v + gain * net / mass) > 0.0:
            way = drag.way(rate, span, gain, abs(v), sign * net / mass)
            state.ledger[PISTON] += friction * way
            _push(resistance, net, span, mass, state)
            return
        brake = -sign * net / mass
        way = drag.stopping_way(rate, abs(v), brake)
        state.ledger[PISTON] += 0.5 * mass * v * v + sign * force * way
        state.piston[1] = 0.0
        span = max(span - drag.stopping_time(rate, abs(v), brake), 0.0)
    if abs(force) > friction:
        net = force - math.copysign(friction, force)
        _, gain, _, _, _ = drag.flow(rate, span)
        state.ledger[PISTON] += friction * drag.way(rate, span, gain, 0.0, abs(net) / mass)
        _push(resistance, net, span, mass, state)


@compiled
def _rub(resistance: Resistance, span: float, mass: float, state: State) -> None:
    """A sliding piston loses speed, and stops where it has no more."""
    speed = abs(state.piston[1])
    if speed > 0.0:
        left = sliding(speed, resistance.force * span / mass)
        state.piston[1] *= left
        state.ledger[PISTON] += 0.5 * mass * speed * speed * (1.0 - left * left)


@compiled
def _path_speed(motion: Motion, time: float, span: float, opening: bool) -> float:
    """Speed on the path; across the corners of a table the mean one, on the step's side."""
    if motion.kind == TABLE:
        before = time if opening else time - span
        return (path(motion, before + span)[0] - path(motion, before)[0]) / span
    return path(motion, time)[1]


@compiled(inline=True)
def kick_piston(
    span: float, state: State, constants: Constants, motion: Motion, time: float, start: float,
    opening: bool,
) -> None:  # fmt: skip
    """The piston's velocity after ``span``, and the work done from outside meanwhile.

    Work is the conjugate of what depends on time (the path, an outer force, the shaking), so that
    the ledger has the method's order.
    """
    if motion.free:
        _, swing = acceleration(constants.acting.shaking, start + time)
        outer = outer_force(motion, time)
        force = state.totals[3] - constants.weight + constants.mass * swing + outer
        before = state.piston[1]
        _free_kick(constants.resistance, force, span, constants.mass, state, opening)
        state.ledger[WORK] += 0.5 * span * outer * (before + state.piston[1])
    else:
        state.ledger[WORK] -= span * state.totals[3] * _path_speed(motion, time, span, opening)
    add_shaking_work(constants.acting.shaking, span, state, constants, start + time)


@compiled(inline=True)
def add_shaking_work(
    swing: Swing | None, span: float, state: State, constants: Constants, time: float
) -> None:
    """Enter the work that the shaking does on grains and piston in ``span``, at a time [tau]."""
    if swing is not None:
        rx, ry = acceleration_rate(swing, time)
        mx, my = mass_moment(constants.grains, constants.charge, state.x, state.y)
        state.ledger[WORK] -= span * (rx * mx + ry * my)
        if constants.mass < math.inf:
            state.ledger[WORK] -= span * ry * constants.mass * state.piston[0]


@compiled(inline=True)
def drift_piston(
    span: float, state: State, constants: Constants, motion: Motion, time: float, start: float
) -> None:
    """The piston's height after ``span``, which ends at ``time`` in the stage."""
    if motion.free:
        _raise_height(state.low, span * state.piston[1], state)
    else:
        before = piston_energy(state, constants, start + time)
        height, velocity = path(motion, time)
        state.piston[0] = height
        state.piston[1] = velocity
        state.ledger[WORK] += piston_energy(state, constants, start + time) - before


@compiled(inline=True)
def piston_energy(state: State, constants: Constants, time: float) -> float:
    """Kinetic and potential energy of the piston [F* D]; zero where it has no mass."""
    if not constants.mass < math.inf:
        return 0.0
    _, swing = acceleration(constants.acting.shaking, time)
    height, velocity = state.piston[0], state.piston[1]
    return (
        0.5 * constants.mass * velocity * velocity
        + (constants.weight - constants.mass * swing) * height
    )
