"""The motion of a host and of the cell on it (`granular.effects.host_structure`).

All motion is given in the frame of the cell, as without a host; the frame has the acceleration A,
so that every mass in it feels the force -m A. Let V be the velocity of the frame, v_i those of the
grains in it, and Q = M V + sum m_i (V + v_i) + ... the momentum of the whole, all over the base. In
the momenta of grains, piston and bodies over the base, the energy is the kinetic energy of each,
and a potential of relative positions and springs: a separable one, though the velocities v_i in the
frame are not. So the steps of a symplectic method stay kicks and drifts. A kick leaves all
positions as they are, and changes V by A dt with

    M A = (spring and outer force on the body) - (force of the body on grains and piston),

and the v_i by (F_i/m_i - A) dt; a drift moves the bodies at their velocities, and what is in the
cell at those in the cell. This is the exact flow of either part, hence symplectic, of the method's
order, and the momentum of the whole changes by outer forces alone.

Drag and friction act on the velocities in the frame, and what they take of the momentum of grains
and piston goes to the frame. Its mean acceleration A must be known before what dissipates is solved
with it: an equation for one number, whose residual is nearly linear in it, and linear for drag and
for grains that stick. The secant rule solves it, so the kick is made three times, from the same
velocities. The momentum of the whole then gives V to rounding. Dashpots act at the mean velocities
of the kick, within the same equation; on a chain that carries the piston of a free cell they are a
part of their own, on the inner side of the kicks.

The base is the reference: where it moves, all masses feel minus its acceleration, and the
energy is that of the motion over the base. Weights are held by the springs' rest lengths.

Seen from a free cell (``mount = "piston"``), the piston is one body with the chain's last one.

A piston that is driven along a path z(t) is pushed off the cell, so that (M + m) A = F - m z'' with
its mass m: the momentum M V + m (V + z') is what a kick changes. In a drift it stays as it is, and
so do the velocities of the grains over the base; z', V and the v_i take their means over the drift
for its duration, and thereafter the values at its end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from granular.compiled import Array, compiled
from granular.effects.excitation import evaluate_excitation, excitation_during_kick
from granular.effects.host_structure import (
    CARRIED,
    FIXED,
    PISTON_MOUNT,
    PULL,
    PUSH,
    HostChain,
    HostLaw,
    HostWorkspace,
    bed_momentum,
    last_body_velocity,
)
from granular.effects.wall_kernels import force_on_piston
from granular.engine.grain_kicks import kick_grains
from granular.engine.piston import kick_piston, prescribed_speed
from granular.kernel_data.state import HEIGHT, SPEED, WORK, Bed, State
from granular.pairs.grain_arrays import value_or_one
from granular.protocol.piston_motion import Motion, driven_height_and_velocity, outer_force_on_piston

if TYPE_CHECKING:
    from jaxtyping import Float


@compiled(inline=True)
def kick_host(
    law: HostLaw,
    workspace: HostWorkspace,
    dt: float,
    bed: Bed,
    motion: Motion,
    time: float,
    start: float,
    opens_step: bool,
) -> None:
    """Kick host, grains and piston together; see the head of this file; dt, time, start [tau]."""
    state = bed.state
    apart = law.mount == PISTON_MOUNT and motion.free
    if not motion.free:  # a table's slope jumps between a kick that closes a step and one that opens it
        _change_driven_speed(law, workspace, bed, prescribed_speed(motion, time, dt, opens_step))
    if apart and not opens_step:
        _apply_chain_dashpots(law, workspace, dt, state)
    _kick_chain(law, workspace, dt, bed, motion, time, start, opens_step)
    if apart and opens_step:
        _apply_chain_dashpots(law, workspace, dt, state)


@compiled(inline=True)
def open_drift_of_host(
    law: HostLaw | None, workspace: HostWorkspace | None, dt: float, bed: Bed, motion: Motion, time: float
) -> None:
    """Give a driven piston its mean speed in a drift that ends at ``time``; dt, time [tau]."""
    if law is not None and workspace is not None and not motion.free:
        change = driven_height_and_velocity(motion, time)[0] - bed.state.piston[HEIGHT]
        _change_driven_speed(law, workspace, bed, change / dt)


@compiled
def _change_driven_speed(law: HostLaw, workspace: HostWorkspace, bed: Bed, speed: float) -> None:
    """Change the speed of a driven piston; the cell recoils, and the grains keep theirs over the base."""
    state = bed.state
    before = state.piston[SPEED]
    if speed == before:
        return
    state.piston[SPEED] = speed
    state.ledger[WORK] += 0.5 * law.piston_mass * (1.0 - law.recoil) * (speed * speed - before * before)
    change = law.recoil * (speed - before)
    workspace.persistent[1, workspace.persistent.shape[1] - 1] -= change
    for i in range(bed.constants.grains):
        state.vy[i] += change


@compiled(inline=True)
def close_drift_of_host(
    law: HostLaw | None, workspace: HostWorkspace | None, dt: float, bed: Bed, motion: Motion, time: float
) -> None:
    """Move the bodies at their velocities, and give a driven piston its speed at the end; dt, time [tau]."""
    if law is not None and workspace is not None:
        state, last = bed.state, law.chain.masses.size - 1
        for k in range(last):
            workspace.persistent[0, k] += dt * workspace.persistent[1, k]
        if last >= 0:
            workspace.persistent[0, last] += dt * last_body_velocity(law, workspace, state)
        if not motion.free:
            _change_driven_speed(law, workspace, bed, driven_height_and_velocity(motion, time)[1])


@compiled
def record_host_motion(
    law: HostLaw | None, workspace: HostWorkspace | None, state: State, time: float, values: Float[Array, "k"]
) -> None:
    """Enter displacements, velocity and drive of a host, where there is one; time [tau]."""
    if law is not None and workspace is not None:
        last, at = law.chain.masses.size - 1, 0
        if last >= 0:
            values[at] = workspace.persistent[0, last]
            values[at + 1] = last_body_velocity(law, workspace, state)
            at += 2
        for k in range(last):
            values[at] = workspace.persistent[0, k]
            at += 1
        if law.driven:
            values[at] = evaluate_excitation(law.drive, time)


@compiled
def _total_momentum(law: HostLaw, workspace: HostWorkspace, grains: float, speed: float) -> float:
    """Momentum of the whole over the base; ``grains`` is that of the grains in the frame."""
    last = law.chain.masses.size - 1
    total = grains + law.piston_mass * speed
    for k in range(last):
        total += law.chain.masses[k] * workspace.persistent[1, k]
    if law.mount != FIXED:
        total += (law.frame_mass + law.bed_mass + law.piston_mass) * workspace.persistent[1, last]
    return total


@compiled
def _excited_body_velocity(law: HostLaw, workspace: HostWorkspace, state: State) -> float:
    """Velocity of what the outer force acts on."""
    last = law.chain.masses.size - 1
    total = 0.0
    for k in range(last):
        total += law.chain.fraction[k] * workspace.persistent[1, k]
    if last >= 0:
        total += law.chain.fraction[last] * last_body_velocity(law, workspace, state)
    return total


@compiled
def _kick_in_frame(
    push: float,
    workspace: HostWorkspace,
    dt: float,
    bed: Bed,
    motion: Motion,
    time: float,
    start: float,
    opens_step: bool,
) -> None:
    """Kick grains and piston in a frame of the acceleration ``push``."""
    state, constants = bed.state, bed.constants
    workspace.present[PUSH] = push
    for i in range(constants.grains):
        state.fy[i] = workspace.push[i] - value_or_one(constants.masses, i) * push
    kick_grains(dt, bed, opens_step)
    kick_piston(dt, bed, motion, time, start, opens_step)
    for i in range(constants.grains):
        state.fy[i] = workspace.push[i]


@compiled
def _secant_factor(first: float, second: float) -> float:
    """Factor of the second correction that makes the third vanish (secant rule)."""
    if first == second:
        return 1.0
    # Grains that stop or start bend the residual: a steeper secant would overshoot.
    return min(max(first / (first - second), 0.0), 2.0)


@compiled
def _store_velocities(workspace: HostWorkspace, bed: Bed) -> None:
    state, constants = bed.state, bed.constants
    for i in range(constants.grains):
        workspace.speeds[0, i], workspace.speeds[1, i] = state.vx[i], state.vy[i]
    for k in range(state.ledger.size):
        workspace.ledger[k] = state.ledger[k]


@compiled
def _restore_velocities(workspace: HostWorkspace, bed: Bed, speed: float) -> None:
    state, constants = bed.state, bed.constants
    for i in range(constants.grains):
        state.vx[i], state.vy[i] = workspace.speeds[0, i], workspace.speeds[1, i]
    for k in range(state.ledger.size):
        state.ledger[k] = workspace.ledger[k]
    state.piston[SPEED] = speed


@compiled
def _kick_chain(  # noqa: PLR0915 (each level of calls costs seconds to compile)
    law: HostLaw,
    workspace: HostWorkspace,
    dt: float,
    bed: Bed,
    motion: Motion,
    time: float,
    start: float,
    opens_step: bool,
) -> None:
    state, constants = bed.state, bed.constants
    shake = excitation_during_kick(law.drive, start + time, dt, opens_step)
    base = shake if law.drive.base else 0.0
    force = 0.0 if law.drive.base else shake
    free, last = motion.free, law.chain.masses.size - 1
    chain = _fill_chain_forces(law.chain, workspace, force)
    outer, top = 0.0, 0.0
    if free:
        outer = outer_force_on_piston(motion, time)
        top = force_on_piston(bed) - constants.piston_weight
    weight, bed_force = law.frame_mass, 0.0
    for i in range(constants.grains):
        workspace.push[i] = state.fy[i]
        bed_force += state.fy[i]
    workspace.present[PULL] = 0.0
    if law.mount == FIXED:
        push = base
    elif free:
        if law.mount == PISTON_MOUNT:
            workspace.present[PULL] = chain
            push = -(bed_force + top) / weight
        else:
            push = (chain - bed_force - top) / weight
    else:
        weight += law.piston_mass
        push = (chain - bed_force) / weight
    grains, speed = bed_momentum(bed), state.piston[SPEED]
    power, total = (
        _excited_body_velocity(law, workspace, state),
        # The drive holds a driven piston against the acceleration of the base.
        _total_momentum(law, workspace, grains, speed if free else 0.0),
    )
    workspace.present[CARRIED] = speed if law.mount == PISTON_MOUNT and not free else 0.0
    frame = workspace.persistent[1, max(last, 0)]
    # What the passes but the last one are for is how much of the momentum is taken.
    passes = 3 if law.reacts and law.mount != FIXED else 1
    dashpots, held = not (law.mount == PISTON_MOUNT and free), 0.0
    if passes > 1:
        _store_velocities(workspace, bed)
    before, first = push, 0.0
    for attempt in range(passes):
        held = _solve_body_velocity_changes(law.chain, workspace, dt, base, dt * (push - base), dashpots)
        _kick_in_frame(push, workspace, dt, bed, motion, time, start, opens_step)
        if attempt == passes - 1:
            break
        gain = dt * (bed_force - law.bed_mass * push) - (bed_momentum(bed) - grains)
        if free:
            pull = top + outer + workspace.present[PULL] - law.piston_mass * push
            gain += dt * pull - law.piston_mass * (state.piston[SPEED] - speed)
        missing = before + (held + gain / dt) / weight - push
        if attempt == 0:
            first = missing
            push += missing
        else:
            push += missing * _secant_factor(first, missing)
        _restore_velocities(workspace, bed, speed)
    if law.mount != FIXED:
        taken = bed_momentum(bed) - grains
        if free:
            taken += law.piston_mass * (state.piston[SPEED] - speed)
        mass = law.frame_mass + law.piston_mass + law.bed_mass
        change = (dt * (chain + held + outer) - taken) / mass - dt * base
        workspace.changes[last] = change
        if dashpots:
            _record_dashpot_loss(law, workspace, dt, state)
        for k in range(last + 1):
            workspace.persistent[1, k] += workspace.changes[k]
        state.ledger[WORK] += dt * outer * 0.5 * (frame + workspace.persistent[1, last])
        if not free:
            drawn = law.piston_mass * change
            if law.mount == PISTON_MOUNT:
                drawn -= dt * (chain + held)
            state.ledger[WORK] += drawn * prescribed_speed(motion, time, dt, opens_step)
    power += _excited_body_velocity(law, workspace, state)
    total += _total_momentum(law, workspace, bed_momentum(bed), state.piston[SPEED] if free else 0.0)
    state.ledger[WORK] += 0.5 * dt * (force * power - base * total)


@compiled
def _apply_chain_dashpots(law: HostLaw, workspace: HostWorkspace, dt: float, state: State) -> None:
    """Dashpots alone over ``dt``, of a chain that carries the piston of a free cell."""
    chain, count = law.chain, law.chain.masses.size
    half = 0.5 * dt
    for k in range(count):
        mass = chain.masses[k] if k < count - 1 else law.piston_mass
        above = chain.damping[k + 1] if k + 1 < count else 0.0
        drag = -chain.damping[k] * (
            _body_velocity(law, workspace, state, k) - _body_velocity(law, workspace, state, k - 1)
        )
        if k + 1 < count:
            drag += above * (
                _body_velocity(law, workspace, state, k + 1) - _body_velocity(law, workspace, state, k)
            )
        workspace.diagonal[k] = mass + half * (chain.damping[k] + above)
        workspace.changes[k] = dt * drag
        if k > 0:
            ratio = half * chain.damping[k] / workspace.diagonal[k - 1]
            workspace.diagonal[k] -= ratio * half * chain.damping[k]
            workspace.changes[k] += ratio * workspace.changes[k - 1]
    for back in range(count):
        k = count - 1 - back
        if k + 1 < count:
            workspace.changes[k] += half * chain.damping[k + 1] * workspace.changes[k + 1]
        workspace.changes[k] /= workspace.diagonal[k]
    below = 0.0
    for k in range(count):
        mean = _body_velocity(law, workspace, state, k) + 0.5 * workspace.changes[k]
        state.ledger[law.entry] += dt * chain.damping[k] * (mean - below) * (mean - below)
        below = mean
    for k in range(count - 1):
        workspace.persistent[1, k] += workspace.changes[k]
    state.piston[SPEED] += workspace.changes[count - 1]


@compiled
def _body_velocity(law: HostLaw, workspace: HostWorkspace, state: State, k: int) -> float:
    """Velocity of a body over the base; 0 of the base."""
    if k < 0:
        return 0.0
    if k == law.chain.masses.size - 1:
        return last_body_velocity(law, workspace, state)
    return workspace.persistent[1, k]


@compiled
def _fill_chain_forces(chain: HostChain, workspace: HostWorkspace, force: float) -> float:
    """Fill in the force of springs and from outside on each body; that on the last one."""
    count = chain.masses.size
    tension, result = 0.0, 0.0
    for back in range(count):
        k = count - 1 - back
        below = workspace.persistent[0, k - 1] if k > 0 else 0.0
        own = chain.stiffness[k] * (workspace.persistent[0, k] - below)
        workspace.forces[k] = tension - own + chain.fraction[k] * force
        tension = own
    if count > 0:
        result = workspace.forces[count - 1]
    return result


@compiled
def _solve_body_velocity_changes(
    chain: HostChain, workspace: HostWorkspace, dt: float, base: float, change: float, dashpots: bool
) -> float:
    """Fill in the velocity changes of the chain, from the base upwards; force of the last dashpot [F*]."""
    last, half = chain.masses.size - 1, 0.5 * dt
    for k in range(last):
        own, above = chain.damping[k], chain.damping[k + 1]
        if not dashpots:
            own, above = 0.0, 0.0
        speed, below = workspace.persistent[1, k], workspace.persistent[1, k - 1] if k > 0 else 0.0
        upper = workspace.persistent[1, k + 1] + (workspace.present[CARRIED] if k == last - 1 else 0.0)
        drag = above * (upper - speed) - own * (speed - below)
        gain = dt * (workspace.forces[k] - chain.masses[k] * base + drag)
        if k == last - 1:
            gain += half * above * change
        workspace.diagonal[k] = chain.masses[k] + half * (own + above)
        if k > 0:
            ratio = half * own / workspace.diagonal[k - 1]
            workspace.diagonal[k] -= ratio * half * own
            gain += ratio * workspace.changes[k - 1]
        workspace.changes[k] = gain
    for back in range(last):
        k = last - 1 - back
        if k < last - 1 and dashpots:
            workspace.changes[k] += half * chain.damping[k + 1] * workspace.changes[k + 1]
        workspace.changes[k] /= workspace.diagonal[k]
    if last < 0 or not dashpots:
        return 0.0
    workspace.changes[last] = change
    below = workspace.persistent[1, last - 1] + 0.5 * workspace.changes[last - 1] if last > 0 else 0.0
    upper = workspace.persistent[1, last] + workspace.present[CARRIED]
    return -chain.damping[last] * (upper + 0.5 * change - below)


@compiled
def _record_dashpot_loss(law: HostLaw, workspace: HostWorkspace, dt: float, state: State) -> None:
    """Enter what the dashpots take at the mean velocities of a kick."""
    below = 0.0
    for k in range(law.chain.masses.size):
        mean = workspace.persistent[1, k] + 0.5 * workspace.changes[k]
        if k == law.chain.masses.size - 1:
            mean += workspace.present[CARRIED]
        state.ledger[law.entry] += dt * law.chain.damping[k] * (mean - below) * (mean - below)
        below = mean
