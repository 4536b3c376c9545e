"""Motion of piston, cell, further bodies and grains.

Let V and A be the velocity and acceleration of the cell relative to the base. Let v_i be the velocities of
grains and other bodies in the frame of the cell. Every mass m in this frame is subject to the inertial force
-m A. In terms of the momenta relative to the base, the energy is a sum of kinetic energies, which depend only
on momenta, and a potential, which depends only on positions. A symplectic method therefore still consists of
kicks and drifts. A kick keeps all positions and changes V by A dt with

    M A = (outer forces + forces of links to the base) - (forces on all masses that the cell carries),

and the v_i by (F_i/m_i - A) dt; a drift moves all masses at their velocities. Kick and
drift are exact solutions, so the scheme is symplectic and of the method's order. Only outer forces change
the total momentum.

Drag and friction act on the velocities in the cell, and transfer momentum to the cell. They depend on the
mean acceleration A during a kick, which depends on them in turn. A is therefore the solution of an equation
whose residual is nearly linear in A, and exactly linear for drag and for sticking grains. The equation is
solved by the secant rule, with three repetitions of the kick from the same velocities. The total momentum
then gives V to rounding error. The equation also includes the dashpots, at the mean velocities of the kick,
and the resistance in the guides of bodies.

The base is the reference frame: if it moves, every mass m is subject to the inertial force -m times the
acceleration of the base, and energies refer to the motion relative to the base.

If a piston of mass m is driven along a path z(t) in a cell of mass M, the drive acts between piston and cell,
and (M + m) A = F - m z''. A kick changes the momentum M V + m (V + z'). A drift conserves this momentum and
the velocities of all other masses relative to the base. During a drift, z', V and the v_i have their mean
values over the drift; after it, their final values.
"""

from __future__ import annotations

import math

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import make_hook_sum_kernel, make_last_hook_kernel
from granular.effects.drag import exact_drag_step_factors, slide_under_drag_and_friction
from granular.effects.excitation import excitation_during_kick, excitation_force_or_acceleration
from granular.effects.host_structure import (
    BodiesAndLinksLaw,
    BodyKickScratch,
    link_force,
    vertical_momentum_of_grains,
)
from granular.effects.wall_laws import upward_force_of_grains_on_body
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
    compensated_sum_and_rounding_error,
)
from granular.pairs.grain_arrays import value_or_one
from granular.protocol.piston_motion import (
    TABLE,
    PistonMotion,
    driven_height_and_velocity,
    outer_force_on_piston,
)
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


_kick = make_last_hook_kernel("kick", "dt bed opens_step", _kick_without_effects)
_flow = make_hook_sum_kernel("damp_velocities", "dt bed opens_step")
_flow_back = make_hook_sum_kernel("damp_velocities", "dt bed opens_step", backward=True)


@compiled(inline=True)
def kick_grains(dt: float, bed: Bed, opens_step: bool) -> None:
    """Change the velocities of the grains by the present forces and the damping, acting for a time ``dt``."""
    state, constants = bed.state, bed.constants
    laws = constants.acting.laws
    if opens_step:
        _kick(laws, state.workspaces, dt, bed, opens_step)
        _flow(laws, state.workspaces, dt, bed, opens_step)
    else:
        _flow_back(laws, state.workspaces, dt, bed, opens_step)
        _kick(laws, state.workspaces, dt, bed, opens_step)


upward_acceleration = make_hook_sum_kernel("upward_acceleration", "time", 0.0)
"""Kernel that returns the upward acceleration of every mass at a given time, summed over the effects."""

record_external_work = make_hook_sum_kernel("record_external_work", "dt bed time")
"""Kernel that adds the work of time-dependent forces during ``dt`` to the energy balance."""


@compiled
def prescribed_piston_speed(motion: PistonMotion, time: float, dt: float, opens_step: bool) -> float:
    """Return the speed of a driven piston; if its path is a table, the mean speed during the kick."""
    if motion.kind == TABLE:
        # The speed of a table jumps from row to row: take the mean during the half step of the kick.
        before = time if opens_step else time - dt
        return (
            driven_height_and_velocity(motion, before + dt)[0] - driven_height_and_velocity(motion, before)[0]
        ) / dt
    return driven_height_and_velocity(motion, time)[1]


@compiled(inline=True)
def piston_energy(bed: Bed, time: float) -> float:
    """Sum of kinetic and potential energy of the piston; 0 if its mass is infinite."""
    state, constants = bed.state, bed.constants
    if not constants.piston_mass < math.inf:
        return 0.0
    frame = upward_acceleration(constants.acting.laws, state.workspaces, time)
    height, velocity = state.piston[HEIGHT], state.piston[SPEED]
    return (
        0.5 * constants.piston_mass * velocity * velocity
        + (constants.piston_weight - constants.piston_mass * frame) * height
    )


@compiled
def _add_to_height_or_speed(rounding: Array | None, entry: int, error: int, by: float, body: Array) -> None:
    """Add ``by`` to a body's height or speed, with a compensated sum if rounding errors are stored."""
    if rounding is None:
        body[entry] += by
    else:
        body[entry], body[error] = compensated_sum_and_rounding_error(body[entry], body[error], by)


@compiled(inline=True)
def _kick_body_and_return_guide_loss(
    resistance: BodyResistance | None, force: float, dt: float, mass: float, state: State, body: Array
) -> float:
    """Change a body's speed under a force and the guide's resistance; return the energy lost to the guide."""
    if resistance is None:
        _add_to_height_or_speed(state.rounding, SPEED, SPEED_ROUNDING, dt * force / mass, body)
        return 0.0
    rate, friction = resistance.rate, resistance.force
    flow, speed = exact_drag_step_factors(rate, dt), (0.0, body[SPEED])
    _, body[SPEED], dragged, rubbed = slide_under_drag_and_friction(
        rate, dt, flow, mass, speed, (0.0, force), 1.0, 1.0, friction
    )
    return dragged + rubbed


@compiled(inline=True)
def kick_grains_and_bodies(
    law: BodiesAndLinksLaw | None,
    scratch: BodyKickScratch | None,
    dt: float,
    bed: Bed,
    motion: PistonMotion,
    time: float,
    start: float,
    opens_step: bool,
) -> None:
    """Change all velocities by the present forces acting for ``dt``; add their work to the energy balance."""
    if law is not None and scratch is not None:
        if not motion.free:  # a table's slope jumps between a kick that closes a step and one that opens it
            _set_driven_piston_speed_with_recoil(
                law, bed, prescribed_piston_speed(motion, time, dt, opens_step)
            )
        _kick_grains_and_linked_bodies(law, scratch, dt, bed, motion, time, start, opens_step)
    else:
        kick_grains(dt, bed, opens_step)
        _kick_lone_piston(dt, bed, motion, time, start, opens_step)
    record_external_work(bed.constants.acting.laws, bed.state.workspaces, dt, bed, start + time)


@compiled(inline=True)
def _kick_lone_piston(
    dt: float, bed: Bed, motion: PistonMotion, time: float, start: float, opens_step: bool
) -> None:
    state, constants = bed.state, bed.constants
    if motion.free:
        mass, before = constants.piston_mass, state.piston[SPEED]
        frame = upward_acceleration(constants.acting.laws, state.workspaces, start + time)
        outer = outer_force_on_piston(motion, time)
        force = upward_force_of_grains_on_body(bed, PISTON) - constants.piston_weight + mass * frame + outer
        state.ledger[PISTON_LOSS] += _kick_body_and_return_guide_loss(
            constants.resistance, force, dt, mass, state, state.piston
        )
        # With force times mean velocity, the ledger has the method's order.
        state.ledger[WORK] += 0.5 * dt * outer * (before + state.piston[SPEED])
    else:
        state.ledger[WORK] -= (
            dt
            * upward_force_of_grains_on_body(bed, PISTON)
            * prescribed_piston_speed(motion, time, dt, opens_step)
        )


@compiled(inline=True)
def set_mean_speed_of_driven_piston(
    law: BodiesAndLinksLaw | None, dt: float, bed: Bed, motion: PistonMotion, time: float
) -> None:
    """Set a driven piston's speed to its mean over the drift of length ``dt`` that ends at ``time``."""
    if law is not None and not motion.free:
        change = driven_height_and_velocity(motion, time)[0] - bed.state.piston[HEIGHT]
        _set_driven_piston_speed_with_recoil(law, bed, change / dt)


@compiled(inline=True)
def move_bodies(
    law: BodiesAndLinksLaw | None, dt: float, bed: Bed, motion: PistonMotion, time: float, start: float
) -> None:
    """Move all bodies for a time ``dt``; a driven piston moves along its path."""
    state = bed.state
    if law is not None:
        for b in range(state.bodies.shape[0]):
            if b != PISTON:
                state.bodies[b, HEIGHT] += dt * state.bodies[b, SPEED]
    if motion.free:
        _add_to_height_or_speed(
            state.rounding, HEIGHT, HEIGHT_ROUNDING, dt * state.piston[SPEED], state.piston
        )
        return
    height, velocity = driven_height_and_velocity(motion, time)
    if law is not None:
        _set_driven_piston_speed_with_recoil(law, bed, velocity)
    before = piston_energy(bed, start + time)
    state.piston[HEIGHT] = height
    state.piston[SPEED] = velocity
    state.ledger[WORK] += piston_energy(bed, start + time) - before


@compiled
def _set_driven_piston_speed_with_recoil(law: BodiesAndLinksLaw, bed: Bed, speed: float) -> None:
    """Set the speed of a driven piston; the cell recoils, but all other masses keep their velocity."""
    state = bed.state
    before = state.piston[SPEED]
    if speed == before:
        return
    mass = law.rows.masses[PISTON]
    state.ledger[WORK] += 0.5 * mass * (1.0 - law.recoil) * (speed * speed - before * before)
    let_cell_recoil(law, bed, SPEED, speed - before)
    state.piston[SPEED] = speed


@compiled
def let_cell_recoil(law: BodiesAndLinksLaw, bed: Bed, entry: int, change: float) -> None:
    """Let the cell recoil from a jump of the driven piston; nothing else moves relative to the base."""
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
def _height_or_speed_plus_part_of_cell(row: int, fraction: float, entry: int, bodies: Array) -> float:
    """Return a body's height or speed plus ``fraction`` times the cell's; return the cell's unchanged."""
    return bodies[CELL, entry] if row <= CELL else bodies[row, entry] + fraction * bodies[CELL, entry]


@compiled
def fill_body_records(
    law: BodiesAndLinksLaw | None, state: State, time: float, values: Float[Array, "k"]
) -> None:
    """Write displacement and velocity of each recorded body, and then the excitation, to a record."""
    if law is not None:
        rows, bodies = law.recorded.rows, state.bodies
        for k in range(rows.size):
            # Relative to the cell for a further piston, to the base for a body of the machine.
            over = law.recorded.over_base[k]
            values[2 * k] = (
                _height_or_speed_plus_part_of_cell(rows[k], over, HEIGHT, bodies) - law.rows.start[rows[k]]
            )
            values[2 * k + 1] = _height_or_speed_plus_part_of_cell(rows[k], over, SPEED, bodies)
        if law.is_driven:
            values[2 * rows.size] = excitation_force_or_acceleration(law.drive, time)


@compiled
def _fill_body_forces_and_external_force(
    law: BodiesAndLinksLaw, scratch: BodyKickScratch, bed: Bed, outer: float, force: float
) -> float:
    """Compute the non-inertial forces on bodies in the cell; return the force from outside the cell."""
    forces, signs = scratch.forces, law.links.signs
    for b in range(PISTON, forces.size):
        forces[b] = upward_force_of_grains_on_body(bed, b) - law.rows.weights[b]
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
def _solve_for_mean_dashpot_forces(
    law: BodiesAndLinksLaw,
    scratch: BodyKickScratch,
    dt: float,
    state: State,
    free: bool,
    base: float,
    push: float,
) -> float:
    """Compute mean dashpot forces for a cell acceleration ``push``; return the outside force on the cell."""
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
        rate = _stretch_rate_of_link(signs[link], frame, scratch.before)
        for b in range(PISTON + (not free), changes.size):
            changes[b] -= 2.0 * half * rate * signs[link, b]
            for other in range(PISTON + (not free), changes.size):
                matrix[b, other] += half * signs[link, b] * signs[link, other]
    _solve_for_bodies_in_place(matrix, changes)
    external = 0.0
    for link in range(links.damping.size):
        rate = _stretch_rate_of_link(signs[link], frame, scratch.before)
        drag = links.damping[link] * (rate + 0.5 * _stretch_rate_of_link(signs[link], 0.0, changes))
        external -= signs[link, CELL] * drag
        for b in range(PISTON, changes.size):
            drags[b] -= signs[link, b] * drag
    return external


@compiled
def _stretch_rate_of_link(signs: Float[Array, "b"], frame: float, speeds: Float[Array, "b"]) -> float:
    """Return the rate at which a spring or dashpot lengthens if the cell has the velocity ``frame``."""
    rate = signs[CELL] * frame
    for b in range(PISTON, signs.size):
        rate += signs[b] * speeds[b]
    return rate


@compiled
def _solve_for_bodies_in_place(matrix: Float[Array, "b b"], values: Float[Array, "b"]) -> None:
    """Solve a positive definite system for all bodies except the cell by Gaussian elimination, in place."""
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
def _kick_grains_in_cell(
    scratch: BodyKickScratch, push: float, dt: float, bed: Bed, opens_step: bool
) -> None:
    state, constants = bed.state, bed.constants
    for i in range(constants.grains):
        state.fy[i] = scratch.push[i] - value_or_one(constants.masses, i) * push
    kick_grains(dt, bed, opens_step)
    for i in range(constants.grains):
        state.fy[i] = scratch.push[i]


@compiled
def _kick_grains_and_bodies_in_cell(
    law: BodiesAndLinksLaw,
    scratch: BodyKickScratch,
    push: float,
    dt: float,
    bed: Bed,
    free: bool,
    opens_step: bool,
) -> None:
    """Kick grains and bodies in a cell with the acceleration ``push``; store the guides' forces."""
    _kick_grains_in_cell(scratch, push, dt, bed, opens_step)
    state, rows = bed.state, law.rows
    for b in range(PISTON, rows.masses.size):
        if b == PISTON and not free:
            continue
        mass, body = rows.masses[b], state.bodies[b]
        force = scratch.forces[b] + scratch.drags[b] - mass * push
        if rows.rates[b] == 0.0 and rows.frictions[b] == 0.0:
            _kick_body_and_return_guide_loss(None, force, dt, mass, state, body)
        else:
            resistance = BodyResistance(rows.rates[b], rows.frictions[b])
            lost = _kick_body_and_return_guide_loss(resistance, force, dt, mass, state, body)
            state.ledger[PISTON_LOSS if b == PISTON else law.entry] += lost
            scratch.guides[b] = mass * (body[SPEED] - scratch.before[b]) / dt - force


@compiled
def _secant_correction_factor(first: float, second: float) -> float:
    """Return the factor by which the secant rule multiplies the second residual to correct the unknown."""
    if first == second:
        return 1.0
    # Grains that stop or start make the residual nonlinear: a steeper secant would overshoot.
    return min(max(first / (first - second), 0.0), 2.0)


@compiled
def _store_velocities(scratch: BodyKickScratch, bed: Bed) -> None:
    state, constants = bed.state, bed.constants
    for b in range(scratch.before.size):
        scratch.before[b], scratch.guides[b] = state.bodies[b, SPEED], 0.0
    for k in range(state.ledger.size):
        scratch.ledger[k] = state.ledger[k]
    for i in range(constants.grains):
        scratch.push[i] = state.fy[i]
        scratch.speeds[0, i], scratch.speeds[1, i] = state.vx[i], state.vy[i]


@compiled
def _restore_velocities(scratch: BodyKickScratch, bed: Bed) -> None:
    state, constants = bed.state, bed.constants
    for b in range(scratch.before.size):
        state.bodies[b, SPEED] = scratch.before[b]
    for k in range(state.ledger.size):
        state.ledger[k] = scratch.ledger[k]
    for i in range(constants.grains):
        state.vx[i], state.vy[i] = scratch.speeds[0, i], scratch.speeds[1, i]


@compiled
def _momentum_of_grains_and_bodies_in_cell(
    law: BodiesAndLinksLaw, state: State, grains: float, free: bool
) -> float:
    """Return ``grains``, the momentum of the grains, plus the momenta of bodies that are free in the cell."""
    total = grains
    for b in range(PISTON, law.rows.masses.size):
        if b > PISTON or free:
            total += law.rows.masses[b] * state.bodies[b, SPEED]
    return total


@compiled
def _kick_grains_and_linked_bodies(
    law: BodiesAndLinksLaw,
    scratch: BodyKickScratch,
    dt: float,
    bed: Bed,
    motion: PistonMotion,
    time: float,
    start: float,
    opens_step: bool,
) -> None:
    state, constants, masses, free = bed.state, bed.constants, law.rows.masses, motion.free
    shake = excitation_during_kick(law.drive, start + time, dt, opens_step)
    base, force = (shake, 0.0) if law.drive.moves_base else (0.0, shake)
    outer = outer_force_on_piston(motion, time) if free else 0.0
    _store_velocities(scratch, bed)
    external = _fill_body_forces_and_external_force(law, scratch, bed, outer, force)
    carrier = masses[CELL] if free else masses[CELL] + masses[PISTON]
    carried, mass = 0.0, carrier + law.bed_mass
    for i in range(constants.grains):
        carried += state.fy[i]
    for b in range(PISTON, masses.size):
        if b > PISTON or free:
            carried += scratch.forces[b]
            mass += masses[b]
    push = (external - carried) / carrier if law.moves_cell else base
    frame, power = (
        state.bodies[CELL, SPEED],
        _height_or_speed_plus_part_of_cell(law.excited, 1.0, SPEED, state.bodies),
    )
    momentum = _momentum_of_grains_and_bodies_in_cell(law, state, vertical_momentum_of_grains(bed), free)
    dashed, before, first = 0.0, push, 0.0
    for attempt in range(law.pass_count):
        dashed = _solve_for_mean_dashpot_forces(law, scratch, dt, state, free, base, push)
        _kick_grains_and_bodies_in_cell(law, scratch, push, dt, bed, free, opens_step)
        if attempt == law.pass_count - 1:
            break
        if law.moves_cell:
            # The cell gains the momentum that forces in the cell give and its content does not gain.
            given = dt * (carried - (mass - carrier) * push)
            gained = (
                _momentum_of_grains_and_bodies_in_cell(law, state, vertical_momentum_of_grains(bed), free)
                - momentum
            )
            missing = before + (dashed + (given - gained) / dt) / carrier - push
            if attempt == 0:
                first = missing
                push += missing
            else:
                push += missing * _secant_correction_factor(first, missing)
        _restore_velocities(scratch, bed)
    after = _momentum_of_grains_and_bodies_in_cell(law, state, vertical_momentum_of_grains(bed), free)
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
        speed = prescribed_piston_speed(motion, time, dt, opens_step)
        state.ledger[WORK] += ((masses[PISTON] * change if law.moves_cell else 0.0) - drawn) * speed
    power += _height_or_speed_plus_part_of_cell(law.excited, 1.0, SPEED, state.bodies)
    # The drive holds the driven piston against the base's acceleration.
    total = momentum + after + (mass * sum_of_frames if law.moves_cell else 0.0)
    state.ledger[WORK] += 0.5 * dt * (force * power - base * total)


@compiled
def _enter_dashpot_losses(law: BodiesAndLinksLaw, scratch: BodyKickScratch, dt: float, state: State) -> None:
    """Add the energy that dashpots dissipate at the mean velocities of a kick to the energy balance."""
    signs, bodies = law.links.signs, state.bodies
    for link in range(signs.shape[0]):
        rate = _stretch_rate_of_link(signs[link], scratch.before[CELL], scratch.before)
        rate = 0.5 * (rate + _stretch_rate_of_link(signs[link], bodies[CELL, SPEED], bodies[:, SPEED]))
        state.ledger[law.entry] += dt * law.links.damping[link] * rate * rate
