"""The motion of piston, cell and further bodies, and of the grains with them.

Let V be the velocity of the cell over the base, and v_i those of grains and other bodies seen from the cell,
which has the acceleration A, so that every mass in it feels the force -m A. In the momenta over the base, the
energy is the kinetic energy of each, and a potential of relative positions and springs: a separable one. So
the steps of a symplectic method stay kicks and drifts. A kick leaves all positions as they are, and changes V
by A dt with

    M A = (outer forces and those of links to the base) - (forces on all that the cell carries),

and the v_i by (F_i/m_i - A) dt; a drift moves all at their velocities. This is the exact flow of either
part, hence symplectic, of the method's order, and the momentum of the whole changes by outer forces alone.

Drag and friction act on the velocities in the cell, and what they take of the momentum goes to the cell. Its
mean acceleration A must be known before what dissipates is solved with it: an equation for one number, whose
residual is nearly linear in it, and linear for drag and for grains that stick. The secant rule solves it, so
the kick is made three times, from the same velocities. The momentum of the whole then gives V to rounding.
Dashpots act at the mean velocities of the kick, within the same equation, and so do the guides of bodies.

The base is the reference: where it moves, all masses feel minus its acceleration, and the energy is that
of the motion over the base.

A piston that is driven along a path z(t) is pushed off the cell, so that (M + m) A = F - m z'' with
its mass m: the momentum M V + m (V + z') is what a kick changes. In a drift it stays as it is, and
so do the velocities of all others over the base; z', V and the v_i take their means over the drift
for its duration, and thereafter the values at its end.
"""

from __future__ import annotations

import math

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import call_last_hook, sum_of_hooks
from granular.effects.drag import drag_flow_coefficients, slide
from granular.effects.excitation import evaluate_excitation, excitation_during_kick
from granular.effects.host_structure import BodyLaw, BodyScratch, bed_momentum, link_force
from granular.effects.wall_laws import force_on_body
from granular.kernel_data.state import (
    CELL,
    HEIGHT,
    HEIGHT_ROUNDING,
    PISTON,
    PISTON_LOSS,
    SPEED,
    SPEED_ROUNDING,
    WORK,
    Bed,
    BodyResistance,
    State,
    add_to_velocity,
    compensated_sum,
)
from granular.pairs.grain_arrays import value_or_one
from granular.protocol.piston_motion import TABLE, Motion, driven_height_and_velocity, outer_force_on_piston
from granular.shared.array_types import Float


@compiled(inline=True)
def _kick_by_forces(
    rounding: Array | None, dt: float, state: State, count: int, masses: Array | None
) -> None:
    if masses is None:
        for i in range(count):
            add_to_velocity(rounding, state, i, dt * state.fx[i], dt * state.fy[i])
    else:
        for i in range(count):
            gain = dt / masses[i]
            add_to_velocity(rounding, state, i, gain * state.fx[i], gain * state.fy[i])


@compiled(inline=True)
def _kick_without_effects(dt: float, bed: Bed, opens_step: bool) -> int:
    state, constants = bed.state, bed.constants
    _kick_by_forces(state.rounding, dt, state, constants.grains, constants.masses)
    return 0


_kick = call_last_hook("kick", "dt bed opens_step", _kick_without_effects)
_flow = sum_of_hooks("damp_velocities", "dt bed opens_step")
_flow_back = sum_of_hooks("damp_velocities", "dt bed opens_step", backward=True)


@compiled(inline=True)
def kick_grains(dt: float, bed: Bed, opens_step: bool) -> None:
    """Change the velocities of the grains by ``dt`` [tau] under the present forces."""
    state, constants = bed.state, bed.constants
    laws = constants.acting.laws
    if opens_step:
        _kick(laws, state.workspaces, dt, bed, opens_step)
        _flow(laws, state.workspaces, dt, bed, opens_step)
    else:
        _flow_back(laws, state.workspaces, dt, bed, opens_step)
        _kick(laws, state.workspaces, dt, bed, opens_step)


upward_acceleration = sum_of_hooks("upward_acceleration", "time", 0.0)
"""Upward acceleration of all that has a mass, at a time [tau]."""

record_external_work = sum_of_hooks("record_external_work", "dt bed time")
"""Enter the work that forces which depend on time do in ``dt``, at a time [tau]."""


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


@compiled
def _add_to_body(rounding: Array | None, entry: int, error: int, by: float, body: Array) -> None:
    """Add to height or speed; where they are compensated sums, with the entry of the rounding error."""
    if rounding is None:
        body[entry] += by
    else:
        body[entry], body[error] = compensated_sum(body[entry], body[error], by)


@compiled(inline=True)
def _kick_body(
    resistance: BodyResistance | None, force: float, dt: float, mass: float, state: State, body: Array
) -> float:
    """Change the speed of a body by a force [F*] and its guide; what the guide takes [F* D]."""
    if resistance is None:
        _add_to_body(state.rounding, SPEED, SPEED_ROUNDING, dt * force / mass, body)
        return 0.0
    rate, friction = resistance.rate, resistance.force
    flow, speed = drag_flow_coefficients(rate, dt), (0.0, body[SPEED])
    _, body[SPEED], dragged, rubbed = slide(rate, dt, flow, mass, speed, (0.0, force), 1.0, 1.0, friction)
    return dragged + rubbed


@compiled(inline=True)
def kick_bodies(
    law: BodyLaw | None,
    scratch: BodyScratch | None,
    dt: float,
    bed: Bed,
    motion: Motion,
    time: float,
    start: float,
    opens_step: bool,
) -> None:
    """Change all velocities by ``dt`` under the present forces; enter the work; dt, time, start [tau]."""
    if law is not None and scratch is not None:
        if not motion.free:  # a table's slope jumps between a kick that closes a step and one that opens it
            _change_driven_speed(law, bed, prescribed_speed(motion, time, dt, opens_step))
        _kick_with_links(law, scratch, dt, bed, motion, time, start, opens_step)
    else:
        kick_grains(dt, bed, opens_step)
        _kick_lone_piston(dt, bed, motion, time, start, opens_step)
    record_external_work(bed.constants.acting.laws, bed.state.workspaces, dt, bed, start + time)


@compiled(inline=True)
def _kick_lone_piston(
    dt: float, bed: Bed, motion: Motion, time: float, start: float, opens_step: bool
) -> None:
    state, constants = bed.state, bed.constants
    if motion.free:
        mass, before = constants.piston_mass, state.piston[SPEED]
        swing = upward_acceleration(constants.acting.laws, state.workspaces, start + time)
        outer = outer_force_on_piston(motion, time)
        force = force_on_body(bed, PISTON) - constants.piston_weight + mass * swing + outer
        state.ledger[PISTON_LOSS] += _kick_body(constants.resistance, force, dt, mass, state, state.piston)
        # Force times mean velocity: the ledger then has the method's order.
        state.ledger[WORK] += 0.5 * dt * outer * (before + state.piston[SPEED])
    else:
        state.ledger[WORK] -= dt * force_on_body(bed, PISTON) * prescribed_speed(motion, time, dt, opens_step)


@compiled(inline=True)
def open_drift_of_bodies(law: BodyLaw | None, dt: float, bed: Bed, motion: Motion, time: float) -> None:
    """Give a driven piston its mean speed in a drift that ends at ``time``; dt, time [tau]."""
    if law is not None and not motion.free:
        change = driven_height_and_velocity(motion, time)[0] - bed.state.piston[HEIGHT]
        _change_driven_speed(law, bed, change / dt)


@compiled(inline=True)
def close_drift_of_bodies(
    law: BodyLaw | None, dt: float, bed: Bed, motion: Motion, time: float, start: float
) -> None:
    """Move all bodies, a driven piston along its path; dt, time, start [tau]."""
    state = bed.state
    if law is not None:
        for b in range(state.bodies.shape[0]):
            if b != PISTON:
                state.bodies[b, HEIGHT] += dt * state.bodies[b, SPEED]
    if motion.free:
        _add_to_body(state.rounding, HEIGHT, HEIGHT_ROUNDING, dt * state.piston[SPEED], state.piston)
        return
    height, velocity = driven_height_and_velocity(motion, time)
    if law is not None:
        _change_driven_speed(law, bed, velocity)
    before = piston_energy(bed, start + time)
    state.piston[HEIGHT] = height
    state.piston[SPEED] = velocity
    state.ledger[WORK] += piston_energy(bed, start + time) - before


@compiled
def _change_driven_speed(law: BodyLaw, bed: Bed, speed: float) -> None:
    """Change the speed of a driven piston; the cell recoils, and all others keep theirs over the base."""
    state = bed.state
    before = state.piston[SPEED]
    if speed == before:
        return
    mass = law.rows.masses[PISTON]
    state.ledger[WORK] += 0.5 * mass * (1.0 - law.recoil) * (speed * speed - before * before)
    let_cell_recoil(law, bed, SPEED, speed - before)
    state.piston[SPEED] = speed


@compiled
def let_cell_recoil(law: BodyLaw, bed: Bed, entry: int, change: float) -> None:
    """Move the cell against a jump of the driven piston's height or speed; all others stay over the base."""
    state, by = bed.state, law.recoil * change
    if by == 0.0:
        return
    state.bodies[CELL, entry] -= by
    for b in range(PISTON + 1, state.bodies.shape[0]):
        state.bodies[b, entry] += by
    values = state.y if entry == HEIGHT else state.vy
    for i in range(bed.constants.grains):
        values[i] += by


@compiled
def _over_base(row: int, fraction: float, entry: int, bodies: Array) -> float:
    """Height or speed of a body, with a fraction of the cell's; of the cell its own."""
    return bodies[CELL, entry] if row <= CELL else bodies[row, entry] + fraction * bodies[CELL, entry]


@compiled
def record_bodies(law: BodyLaw | None, state: State, time: float, values: Float[Array, "k"]) -> None:
    """Enter displacements and velocities of bodies, and what shakes them; time [tau]."""
    if law is not None:
        rows, bodies = law.recorded.rows, state.bodies
        for k in range(rows.size):
            # A further piston is seen from the cell, a body of the machine from the base.
            over = law.recorded.over_base[k]
            values[2 * k] = _over_base(rows[k], over, HEIGHT, bodies) - law.rows.start[rows[k]]
            values[2 * k + 1] = _over_base(rows[k], over, SPEED, bodies)
        if law.is_driven:
            values[2 * rows.size] = evaluate_excitation(law.drive, time)


@compiled
def _fill_forces(law: BodyLaw, scratch: BodyScratch, bed: Bed, outer: float, force: float) -> float:
    """Fill in the forces on all bodies in the cell, without inertia; those on the whole from outside [F*]."""
    forces, signs = scratch.forces, law.links.signs
    for b in range(PISTON, forces.size):
        forces[b] = force_on_body(bed, b) - law.rows.weights[b]
    forces[PISTON] += outer
    external = outer + force
    if law.excited > CELL:
        forces[law.excited] += force
    for link in range(signs.shape[0]):
        push = link_force(law, bed.state, link)
        external += signs[link, CELL] * push
        for b in range(PISTON, forces.size):
            forces[b] += signs[link, b] * push
    return external


@compiled
def _solve_dashpots(
    law: BodyLaw, scratch: BodyScratch, dt: float, state: State, free: bool, base: float, push: float
) -> float:
    """Fill in the mean forces of dashpots in a cell of the acceleration ``push``; that on the whole [F*]."""
    changes, drags, matrix, links = scratch.changes, scratch.drags, scratch.matrix, law.links
    for b in range(drags.size):
        drags[b] = 0.0
    if not law.has_dashpots:
        return 0.0
    own = dt * (push - base) if law.moves_cell else 0.0
    for b in range(changes.size):
        changes[b] = 0.0
        for other in range(changes.size):
            matrix[b, other] = 0.0
    for b in range(PISTON, changes.size):
        matrix[b, b] = 1.0
        if b > PISTON or free:
            mass = law.rows.masses[b]
            matrix[b, b] = mass
            changes[b] = dt * (scratch.forces[b] + scratch.guides[b] - mass * push)
    frame, signs = state.bodies[CELL, SPEED] + 0.5 * own, links.signs
    for link in range(links.damping.size):
        half = 0.5 * dt * links.damping[link]
        rate = _stretch_rate(signs[link], frame, scratch.before)
        for b in range(PISTON + (not free), changes.size):
            changes[b] -= 2.0 * half * rate * signs[link, b]
            for other in range(PISTON + (not free), changes.size):
                matrix[b, other] += half * signs[link, b] * signs[link, other]
    _solve_in_place(matrix, changes)
    external = 0.0
    for link in range(links.damping.size):
        rate = _stretch_rate(signs[link], frame, scratch.before)
        drag = links.damping[link] * (rate + 0.5 * _stretch_rate(signs[link], 0.0, changes))
        external -= signs[link, CELL] * drag
        for b in range(PISTON, changes.size):
            drags[b] -= signs[link, b] * drag
    return external


@compiled
def _stretch_rate(signs: Float[Array, "b"], frame: float, speeds: Float[Array, "b"]) -> float:
    """Speed at which the ends of a link move apart, in a cell of the velocity ``frame`` [D/tau]."""
    rate = signs[CELL] * frame
    for b in range(PISTON, signs.size):
        rate += signs[b] * speeds[b]
    return rate


@compiled
def _solve_in_place(matrix: Float[Array, "b b"], values: Float[Array, "b"]) -> None:
    """Solve for the bodies behind the cell by Gauss's elimination; the matrix is positive definite."""
    for k in range(PISTON, values.size):
        for row in range(k + 1, values.size):
            factor = matrix[row, k] / matrix[k, k]
            for column in range(k, values.size):
                matrix[row, column] -= factor * matrix[k, column]
            values[row] -= factor * values[k]
    for k in range(values.size - 1, CELL, -1):
        for column in range(k + 1, values.size):
            values[k] -= matrix[k, column] * values[column]
        values[k] /= matrix[k, k]


@compiled
def _kick_grains_in_cell(scratch: BodyScratch, push: float, dt: float, bed: Bed, opens_step: bool) -> None:
    state, constants = bed.state, bed.constants
    for i in range(constants.grains):
        state.fy[i] = scratch.push[i] - value_or_one(constants.masses, i) * push
    kick_grains(dt, bed, opens_step)
    for i in range(constants.grains):
        state.fy[i] = scratch.push[i]


@compiled
def _kick_in_cell(
    law: BodyLaw, scratch: BodyScratch, push: float, dt: float, bed: Bed, free: bool, opens_step: bool
) -> None:
    """Kick grains and bodies in a cell of the acceleration ``push``; fill in the forces of guides."""
    _kick_grains_in_cell(scratch, push, dt, bed, opens_step)
    state, rows = bed.state, law.rows
    for b in range(PISTON, rows.masses.size):
        if b == PISTON and not free:
            continue
        mass, body = rows.masses[b], state.bodies[b]
        force = scratch.forces[b] + scratch.drags[b] - mass * push
        if rows.rates[b] == 0.0 and rows.frictions[b] == 0.0:
            _kick_body(None, force, dt, mass, state, body)
        else:
            resistance = BodyResistance(rows.rates[b], rows.frictions[b])
            lost = _kick_body(resistance, force, dt, mass, state, body)
            state.ledger[PISTON_LOSS if b == PISTON else law.entry] += lost
            scratch.guides[b] = mass * (body[SPEED] - scratch.before[b]) / dt - force


@compiled
def _secant_factor(first: float, second: float) -> float:
    """Factor of the second correction that makes the third vanish (secant rule)."""
    if first == second:
        return 1.0
    # Grains that stop or start bend the residual: a steeper secant would overshoot.
    return min(max(first / (first - second), 0.0), 2.0)


@compiled
def _store_velocities(scratch: BodyScratch, bed: Bed) -> None:
    state, constants = bed.state, bed.constants
    for b in range(scratch.before.size):
        scratch.before[b], scratch.guides[b] = state.bodies[b, SPEED], 0.0
    for k in range(state.ledger.size):
        scratch.ledger[k] = state.ledger[k]
    for i in range(constants.grains):
        scratch.push[i] = state.fy[i]
        scratch.speeds[0, i], scratch.speeds[1, i] = state.vx[i], state.vy[i]


@compiled
def _restore_velocities(scratch: BodyScratch, bed: Bed) -> None:
    state, constants = bed.state, bed.constants
    for b in range(scratch.before.size):
        state.bodies[b, SPEED] = scratch.before[b]
    for k in range(state.ledger.size):
        state.ledger[k] = scratch.ledger[k]
    for i in range(constants.grains):
        state.vx[i], state.vy[i] = scratch.speeds[0, i], scratch.speeds[1, i]


@compiled
def _momentum_in_cell(law: BodyLaw, state: State, grains: float, free: bool) -> float:
    """Momentum of grains, which is given, and bodies that move freely in the cell [m D/tau]."""
    total = grains
    for b in range(PISTON, law.rows.masses.size):
        if b > PISTON or free:
            total += law.rows.masses[b] * state.bodies[b, SPEED]
    return total


@compiled
def _kick_with_links(
    law: BodyLaw,
    scratch: BodyScratch,
    dt: float,
    bed: Bed,
    motion: Motion,
    time: float,
    start: float,
    opens_step: bool,
) -> None:
    state, constants, masses, free = bed.state, bed.constants, law.rows.masses, motion.free
    shake = excitation_during_kick(law.drive, start + time, dt, opens_step)
    base, force = (shake, 0.0) if law.drive.moves_base else (0.0, shake)
    outer = outer_force_on_piston(motion, time) if free else 0.0
    _store_velocities(scratch, bed)
    external = _fill_forces(law, scratch, bed, outer, force)
    carrier = masses[CELL] if free else masses[CELL] + masses[PISTON]
    carried, mass = 0.0, carrier + law.bed_mass
    for i in range(constants.grains):
        carried += state.fy[i]
    for b in range(PISTON, masses.size):
        if b > PISTON or free:
            carried += scratch.forces[b]
            mass += masses[b]
    push = (external - carried) / carrier if law.moves_cell else base
    frame, power = state.bodies[CELL, SPEED], _over_base(law.excited, 1.0, SPEED, state.bodies)
    momentum = _momentum_in_cell(law, state, bed_momentum(bed), free)
    dashed, before, first = 0.0, push, 0.0
    for attempt in range(law.pass_count):
        dashed = _solve_dashpots(law, scratch, dt, state, free, base, push)
        _kick_in_cell(law, scratch, push, dt, bed, free, opens_step)
        if attempt == law.pass_count - 1:
            break
        if law.moves_cell:
            # The momentum that forces in the cell give and its content lacks is the cell's.
            given = dt * (carried - (mass - carrier) * push)
            gained = _momentum_in_cell(law, state, bed_momentum(bed), free) - momentum
            missing = before + (dashed + (given - gained) / dt) / carrier - push
            if attempt == 0:
                first = missing
                push += missing
            else:
                push += missing * _secant_factor(first, missing)
        _restore_velocities(scratch, bed)
    after = _momentum_in_cell(law, state, bed_momentum(bed), free)
    change = 0.0
    if law.moves_cell:
        change = (dt * (external + dashed) - (after - momentum)) / mass - dt * base
        state.bodies[CELL, SPEED] += change
    _enter_dashpot_losses(law, scratch, dt, state)
    sum_of_frames = frame + state.bodies[CELL, SPEED]
    if free:
        piston = scratch.before[PISTON] + state.piston[SPEED]
        state.ledger[WORK] += 0.5 * dt * outer * (sum_of_frames + piston)
    else:
        drawn = dt * (scratch.forces[PISTON] + law.rows.weights[PISTON] + scratch.drags[PISTON])
        speed = prescribed_speed(motion, time, dt, opens_step)
        state.ledger[WORK] += ((masses[PISTON] * change if law.moves_cell else 0.0) - drawn) * speed
    power += _over_base(law.excited, 1.0, SPEED, state.bodies)
    # The drive holds a driven piston against the acceleration of the base.
    total = momentum + after + (mass * sum_of_frames if law.moves_cell else 0.0)
    state.ledger[WORK] += 0.5 * dt * (force * power - base * total)


@compiled
def _enter_dashpot_losses(law: BodyLaw, scratch: BodyScratch, dt: float, state: State) -> None:
    """Enter what the dashpots take at the mean velocities of a kick."""
    signs, bodies = law.links.signs, state.bodies
    for link in range(signs.shape[0]):
        rate = _stretch_rate(signs[link], scratch.before[CELL], scratch.before)
        rate = 0.5 * (rate + _stretch_rate(signs[link], bodies[CELL, SPEED], bodies[:, SPEED]))
        state.ledger[law.entry] += dt * law.links.damping[link] * rate * rate
