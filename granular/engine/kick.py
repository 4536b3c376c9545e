"""Kicks: velocities after a span of time, while all positions stand still.

Force and drag are solved together, exactly; dry friction and the dashpots of contacts each exactly,
one after the other, in opposite order in the kick that opens a step and in the one that closes it,
so that a step stays symmetric. On grains that friction would stop within a few such kicks it acts
together with force and drag, along one mean direction. What each part takes is entered in the
ledger.
"""

from __future__ import annotations

import math

from granular.compiled import Array, compiled
from granular.effects import contact, drag
from granular.effects.contact import ContactLaw
from granular.effects.friction import FrictionLaw, normal_force, sliding
from granular.engine.compensation import compensated_sum
from granular.engine.state import CONTACT, DRAG, FRICTION, VX, VY, State
from granular.engine.system import Constants
from granular.pairs.cells import ClosePairs
from granular.pairs.vector import lane_sum


@compiled
def speed_up(rounding: Array | None, state: State, i: int, by_x: float, by_y: float) -> None:
    """Add to the velocity of a grain, as a compensated sum where what rounding takes is kept."""
    if rounding is None:
        state.vx[i] += by_x
        state.vy[i] += by_y
    else:
        state.vx[i], rounding[VX, i] = compensated_sum(state.vx[i], rounding[VX, i], by_x)
        state.vy[i], rounding[VY, i] = compensated_sum(state.vy[i], rounding[VY, i], by_y)


@compiled(inline=True)
def _kick_freely(
    rounding: Array | None, span: float, state: State, count: int, masses: Array | None
) -> None:
    if masses is None:
        for i in range(count):
            speed_up(rounding, state, i, span * state.fx[i], span * state.fy[i])
    else:
        for i in range(count):
            gain = span / masses[i]
            speed_up(rounding, state, i, gain * state.fx[i], gain * state.fy[i])


@compiled(inline=True)
def _kick_with_drag(
    rounding: Array | None, rate: float, span: float, state: State, count: int, masses: Array | None
) -> None:
    decay, gain, a, b, c = drag.flow(rate, span)
    loss = math.expm1(-rate * span)
    for i in range(count):
        mass = 1.0
        if masses is not None:
            mass = masses[i]
        ax, ay = state.fx[i] / mass, state.fy[i] / mass
        vx, vy = state.vx[i], state.vy[i]
        if rounding is None:
            state.vx[i] = decay * vx + gain * ax
            state.vy[i] = decay * vy + gain * ay
        else:
            speed_up(rounding, state, i, loss * vx + gain * ax, loss * vy + gain * ay)
        lost = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
        state.scratch[i] = mass * lost
    state.ledger[DRAG] += lane_sum(state.scratch)


@compiled
def _push_grain(rate: float, span: float, share: float, state: State, i: int, mass: float) -> None:
    """Kick and drag of one grain under a share of its force."""
    decay, gain, a, b, c = drag.flow(rate, span)
    ax, ay = share * state.fx[i] / mass, share * state.fy[i] / mass
    vx, vy = state.vx[i], state.vy[i]
    state.vx[i] = decay * vx + gain * ax
    state.vy[i] = decay * vy + gain * ay
    lost = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
    state.ledger[DRAG] += mass * lost


@compiled
def _start_grain(
    law: FrictionLaw, rate: float, span: float, state: State, i: int, mass: float, load: float
) -> None:
    """A grain at rest: it stays, or starts to slide along the force on it."""
    force = math.hypot(state.fx[i], state.fy[i])
    if force <= law.static * load:
        return
    share = 1.0 - law.dynamic * load / force
    _push_grain(rate, span, share, state, i, mass)
    _, gain, _, _, _ = drag.flow(rate, span)
    way = drag.way(rate, span, gain, 0.0, share * force / mass)
    state.ledger[FRICTION] += law.dynamic * load * way


@compiled
def _rub_grain(
    law: FrictionLaw, span: float, state: State, i: int, mass: float, load: float
) -> None:
    """A sliding grain loses speed, and stops where it has no more."""
    speed = math.hypot(state.vx[i], state.vy[i])
    left = sliding(speed, law.dynamic * load * span / mass)
    state.vx[i] *= left
    state.vy[i] *= left
    state.ledger[FRICTION] += 0.5 * mass * speed * speed * (1.0 - left * left)


@compiled
def _slide_grain(
    law: FrictionLaw, rate: float, span: float, state: State, i: int, mass: float, load: float
) -> None:
    """Force, drag and friction together, friction against the mean direction of the motion.

    One after the other, as fast grains take them, they would give a creeping grain more energy in
    each step than it has.
    """
    decay, gain, a, b, c = drag.flow(rate, span)
    ax, ay = state.fx[i] / mass, state.fy[i] / mass
    vx, vy = state.vx[i], state.vy[i]
    ux, uy = (1.0 + decay) * vx + gain * ax, (1.0 + decay) * vy + gain * ay
    length = math.hypot(ux, uy)
    if length == 0.0:
        _turn_grain(law, rate, span, state, i, mass, load)
        return
    ux, uy = ux / length, uy / length
    if vx * ux + vy * uy < 0.0:
        _turn_grain(law, rate, span, state, i, mass, load)
        return
    brake = law.dynamic * load / mass
    ax, ay = ax - brake * ux, ay - brake * uy
    wx, wy = decay * vx + gain * ax, decay * vy + gain * ay
    if wx * ux + wy * uy <= 0.0:
        _turn_grain(law, rate, span, state, i, mass, load)
        return
    state.vx[i], state.vy[i] = wx, wy
    lost = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
    state.ledger[DRAG] += mass * lost
    way = drag.way(rate, span, gain, vx * ux + vy * uy, ax * ux + ay * uy)
    state.ledger[FRICTION] += law.dynamic * load * way


@compiled
def _turn_grain(
    law: FrictionLaw, rate: float, span: float, state: State, i: int, mass: float, load: float
) -> None:
    """A grain that comes to rest within the span; the force may set it off for what is left."""
    speed = math.hypot(state.vx[i], state.vy[i])
    against = -(state.vx[i] * state.fx[i] + state.vy[i] * state.fy[i]) / speed
    spent = drag.stopping_time(rate, speed, (law.dynamic * load + against) / mass)
    _stop_grain(law, rate, state, i, mass, load)
    _start_grain(law, rate, max(span - spent, 0.0), state, i, mass, load)


@compiled
def _kick_with_friction(
    law: FrictionLaw, rate: float, span: float, state: State, constants: Constants,
    masses: Array | None, opening: bool,
) -> None:  # fmt: skip
    assert state.load is not None
    for i in range(constants.grains):
        mass = 1.0
        if masses is not None:
            mass = masses[i]
        load = normal_force(law, state.load, i)
        if state.vx[i] == 0.0 and state.vy[i] == 0.0:
            _start_grain(law, rate, span, state, i, mass, load)
        elif _sticks(law, span, state, i, mass, load):
            _stop_grain(law, rate, state, i, mass, load)
        elif _slow(law, span, state, i, mass, load):
            _slide_grain(law, rate, span, state, i, mass, load)
        elif opening:
            _push_grain(rate, span, 1.0, state, i, mass)
            _rub_grain(law, span, state, i, mass, load)
        else:
            _rub_grain(law, span, state, i, mass, load)
            _push_grain(rate, span, 1.0, state, i, mass)


@compiled
def _sticks(law: FrictionLaw, span: float, state: State, i: int, mass: float, load: float) -> bool:
    """Whether the force, and friction with it, stop the grain in the span, and friction holds it.

    A grain must not be carried through rest to the other side, where dynamic friction would let go
    of what static friction holds.
    """
    vx, vy, fx, fy = state.vx[i], state.vy[i], state.fx[i], state.fy[i]
    against = -(vx * fx + vy * fy)
    if against <= 0.0 or math.hypot(fx, fy) > law.static * load:
        return False
    speed = math.hypot(vx, vy)
    return speed * mass <= span * (against / speed + law.dynamic * load)


@compiled
def _stop_grain(
    law: FrictionLaw, rate: float, state: State, i: int, mass: float, load: float
) -> None:
    """Stop a grain; friction and drag take their shares, the rest becomes potential energy."""
    speed = math.hypot(state.vx[i], state.vy[i])
    against = -(state.vx[i] * state.fx[i] + state.vy[i] * state.fy[i]) / speed
    friction = law.dynamic * load
    way = drag.stopping_way(rate, speed, (friction + against) / mass)
    state.ledger[FRICTION] += friction * way
    state.ledger[DRAG] += 0.5 * mass * speed * speed - (friction + against) * way
    state.vx[i] = state.vy[i] = 0.0


@compiled
def _slow(law: FrictionLaw, span: float, state: State, i: int, mass: float, load: float) -> bool:
    """Whether the force and twice the friction would stop the grain in the span.

    Force and friction must then act together, or a grain that is pushed on would be stopped for
    good: the static friction that then holds it is greater.
    """
    vx, vy = state.vx[i], state.vy[i]
    speed = math.hypot(vx, vy)
    against = max(-(vx * state.fx[i] + vy * state.fy[i]) / speed, 0.0)
    return speed * mass < span * (against + 2.0 * law.dynamic * load)


@compiled
def _kick_regularised(
    law: FrictionLaw, rate: float, span: float, state: State, constants: Constants,
    masses: Array | None, threshold: float,
) -> None:  # fmt: skip
    """The source's law: friction as one more force, from the velocity before the kick."""
    assert state.load is not None
    for i in range(constants.grains):
        mass = 1.0
        if masses is not None:
            mass = masses[i]
        load = normal_force(law, state.load, i)
        force = math.hypot(state.fx[i], state.fy[i])
        vx, vy = state.vx[i], state.vy[i]
        speed = math.hypot(vx, vy)
        if force <= law.static * load and speed < threshold:
            rx, ry = -state.fx[i], -state.fy[i]
        else:
            brake = law.dynamic * load / (speed + threshold)
            rx, ry = -brake * vx, -brake * vy
        decay, gain, a, b, c = drag.flow(rate, span)
        ax, ay = (state.fx[i] + rx) / mass, (state.fy[i] + ry) / mass
        state.vx[i] = decay * vx + gain * ax
        state.vy[i] = decay * vy + gain * ay
        lost = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
        state.ledger[DRAG] += mass * lost
        middle_x, middle_y = 0.5 * (vx + state.vx[i]), 0.5 * (vy + state.vy[i])
        state.ledger[FRICTION] -= span * (rx * middle_x + ry * middle_y)


@compiled
def _dry_kick(
    threshold: float | None, law: FrictionLaw, rate: float, span: float, state: State,
    constants: Constants, opening: bool,
) -> None:  # fmt: skip
    if threshold is None:
        _kick_with_friction(law, rate, span, state, constants, constants.masses, opening)
    else:
        _kick_regularised(law, rate, span, state, constants, constants.masses, threshold)


@compiled(inline=True)
def _smooth_kick(rate: float | None, span: float, state: State, constants: Constants) -> None:
    if rate is None:
        _kick_freely(state.rounding, span, state, constants.grains, constants.masses)
    else:
        _kick_with_drag(state.rounding, rate, span, state, constants.grains, constants.masses)


@compiled
def _drag_rate(rate: float | None) -> float:
    return 0.0 if rate is None else rate


@compiled(inline=True)
def _grain_kick(
    friction: FrictionLaw | None, span: float, state: State, constants: Constants, opening: bool
) -> None:
    if friction is None:
        _smooth_kick(constants.acting.drag, span, state, constants)
    else:
        rate = _drag_rate(constants.acting.drag)
        _dry_kick(friction.threshold, friction, rate, span, state, constants, opening)


@compiled
def _dampen(
    law: ContactLaw | None, close_pairs: ClosePairs | None, span: float, state: State,
    masses: Array | None, opening: bool,
) -> None:  # fmt: skip
    """Take the dashpots' share of the normal velocities of grains in contact."""
    if law is not None and close_pairs is not None:
        for place in range(close_pairs.filled[0]):
            p = place if opening else close_pairs.filled[0] - 1 - place
            i, j = close_pairs.first[p], close_pairs.second[p]
            dx, dy = state.x[i] - state.x[j], state.y[i] - state.y[j]
            r = math.sqrt(dx * dx + dy * dy)
            overlap = law.radius[i] + law.radius[j] - r
            if overlap > 0.0:
                first = 1.0 if masses is None else masses[i]
                second = 1.0 if masses is None else masses[j]
                mass = first * second / (first + second)
                k = contact.spring(law, law.radius[i], law.radius[j])
                nx, ny = dx / r, dy / r
                speed = (state.vx[i] - state.vx[j]) * nx + (state.vy[i] - state.vy[j]) * ny
                left = contact.decay(law, k, overlap, mass, span)
                impulse = mass * (left - 1.0) * speed
                state.vx[i] += impulse / first * nx
                state.vy[i] += impulse / first * ny
                state.vx[j] -= impulse / second * nx
                state.vy[j] -= impulse / second * ny
                state.ledger[CONTACT] += 0.5 * mass * speed * speed * (1.0 - left * left)


@compiled(inline=True)
def kick_grains(span: float, state: State, constants: Constants, opening: bool) -> None:
    """Change the velocities of the grains by ``span`` [tau] under the present forces.

    Parameters
    ----------
    opening : bool
        Whether the kick opens a step: the parts are then taken in one order, else in the other.
    """
    acting = constants.acting
    if opening:
        _grain_kick(acting.friction, span, state, constants, opening)
        _dampen(acting.contact, state.close_pairs, span, state, constants.masses, opening)
    else:
        _dampen(acting.contact, state.close_pairs, span, state, constants.masses, opening)
        _grain_kick(acting.friction, span, state, constants, opening)
