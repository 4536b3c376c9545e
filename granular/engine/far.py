"""The far field in the engine: a part of every force, or impulses that come every so many steps."""

from __future__ import annotations

from granular.compiled import Array, compiled
from granular.engine.compensation import speed_up
from granular.engine.constants import Constants, moments_of
from granular.engine.state import State
from granular.pairs.far_field import FarForces, find_far_forces, has_changed


@compiled(inline=True)
def find_far_field(far: FarForces | None, state: State, constants: Constants) -> int:
    """Find the far field at the present places; 1 where its mesh has no room for them."""
    if far is None:
        return 0
    assert state.stripes is not None
    return find_far_forces(
        far, constants.threaded, constants.grains, state.x, state.y, moments_of(constants),
        constants.acting.weight, state.stripes.order,
    )  # fmt: skip


@compiled(inline=True)
def refresh_far_field(far: FarForces | None, state: State, constants: Constants) -> int:
    """Find the far field where it is a part of every force; where it acts in impulses, it stays.

    It also stays where grains rub and none has moved by more than
    `granular.pairs.far_field.STILL`: grains at rest feel the same force to the last bit.
    """
    if far is None:
        return 0
    return _refresh(far.held, far, state, constants)


@compiled(inline=True)
def _refresh(held: Array | None, far: FarForces, state: State, constants: Constants) -> int:
    if held is None:
        return _refresh_rubbing(far.met, far, state, constants)
    return 0


@compiled(inline=True)
def _refresh_rubbing(met: Array | None, far: FarForces, state: State, constants: Constants) -> int:
    if met is None:
        return find_far_field(far, state, constants)
    if has_changed(met, state.x, state.y, constants.grains):
        return find_far_field(far, state, constants)
    return 0


@compiled(inline=True)
def add_far_field(far: FarForces | None, state: State, count: int) -> None:
    """Add the far field to forces and loads; where it acts in impulses, the held one."""
    if far is not None:
        _add(far.held, far, state.load, state, count)


@compiled
def _add(held: Array | None, far: FarForces, load: Array | None, state: State, count: int) -> None:
    if held is None:
        for i in range(count):
            state.fx[i] += far.fx[i]
            state.fy[i] += far.fy[i]
        if load is not None and far.load is not None:
            for i in range(count):
                load[i] += far.load[i]
    else:
        for i in range(count):
            state.fx[i] += held[0, i]
            state.fy[i] += held[1, i]


@compiled
def far_energy(far: FarForces | None) -> float:
    """Energy of the far field [F* D] at the places where it was last found; 0 without one."""
    return 0.0 if far is None else far.energy[0]


@compiled
def kick_by_far_field(
    far: FarForces | None, span: float, state: State, constants: Constants
) -> None:
    """Give the impulse over ``span`` [tau] by which the far field differs from the held one."""
    if far is not None:
        _kick(state.rounding, far.held, far, span, state, constants.masses, constants.grains)


@compiled
def _kick(
    rounding: Array | None, held: Array | None, far: FarForces, span: float, state: State,
    masses: Array | None, count: int,
) -> None:  # fmt: skip
    if held is not None:
        for i in range(count):
            gain = span
            if masses is not None:
                gain /= masses[i]
            by_x, by_y = far.fx[i] - held[0, i], far.fy[i] - held[1, i]
            speed_up(rounding, state, i, gain * by_x, gain * by_y)


def hold_far_field(state: State) -> None:
    """Hold the present far field from now on, where it acts in impulses.

    The energy does not change, but what a symplectic step conserves does, a little: not to be done
    often in a run that dissipates nothing.
    """
    far = state.far_forces
    if far is not None and far.held is not None:
        state.fx[:] += far.fx - far.held[0]
        state.fy[:] += far.fy - far.held[1]
        far.held[0], far.held[1] = far.fx, far.fy


def total_force(state: State) -> tuple[Array, Array]:
    """Force on the grains [F*], with all of a far field that acts in impulses."""
    far = state.far_forces
    if far is None or far.held is None:
        return state.fx, state.fy
    return state.fx + far.fx - far.held[0], state.fy + far.fy - far.held[1]
