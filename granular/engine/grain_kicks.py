"""Kicks: velocities after a time ``dt``, while all positions stand still.

A kick is the forces' change of the velocities, solved together with what an effect wants solved
with it (drag, dry friction), and then the flows of dissipative effects, each exactly, one after the
other: behind the kick that opens a step, and in opposite order before the one that closes it, so
that a step stays symmetric. What each effect takes is entered in the ledger.
"""

from __future__ import annotations

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import call_last_hook, sum_of_hooks
from granular.kernel_data.compensated_summation import add_to_velocity
from granular.kernel_data.state import Bed, State


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
