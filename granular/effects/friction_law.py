"""The kicks of `granular.effects.friction`, by either of its two schemes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from granular.compiled import Array, compiled
from granular.effects import drag
from granular.effects.slide import Flow, drag_flow_coefficients, move_with_drag, slide, vector_length
from granular.kernel_data.state import Bed
from granular.pairs.grain_arrays import value_or_one

if TYPE_CHECKING:
    from jaxtyping import Float


class FrictionLaw(NamedTuple):
    """Friction as the kernels take it."""

    static: float
    dynamic: float
    threshold: float | None  # [D/tau], of the regularised law; None: the velocity scheme
    load: float  # constant normal force [F*]
    factor: Float[Array, "m"]  # N_i = load + factor_i sum_j weight_j / r_ij^3 [F* D^3]
    kind: Float[Array, "m"] | None  # of the drag that is solved along, as in `DragLaw`
    rates: drag.DragRateTable
    entry: int  # index in the ledger of the loss to friction
    drag: int | None  # index in the ledger of the loss to drag

    @staticmethod
    @compiled(inline=True)
    def kick(law: FrictionLaw, workspace: None, index: int, dt: float, bed: Bed, opens_step: bool) -> int:
        """Kick the grains by force, drag and friction together; see `granular.effects.friction`; dt [tau]."""
        for k in range(len(law.rates.values)):
            _kick_by_scheme(law.threshold, law, k, dt, bed, opens_step)
        return 0


@compiled
def plate_normal_force(law: FrictionLaw, load: Float[Array, "m"], i: int) -> float:
    """Return the normal force of the plates on a grain, from its sum over 1/r^3 [F*]."""
    return law.load + law.factor[i] * load[i]


@compiled
def velocity_factor_after_friction(speed: float, loss: float) -> float:
    """Factor that shortens a velocity which loses ``loss`` of its magnitude; speed, loss [D/tau]."""
    return 1.0 - loss / speed if speed > loss else 0.0


# Kicks: velocities after a time ``dt``, while all positions stand still. Force and drag are solved
# together, exactly, and friction exactly after or before them, in opposite order in the kick that
# opens a step and in the one that closes it. On grains that friction would stop within a few such
# kicks it acts together with force and drag, along one mean direction.


@compiled(inline=True)
def _kick_fast_grain(
    flow: Flow, loss: float, vx: float, vy: float, ax: float, ay: float, opens_step: bool
) -> tuple[float, float, float, float]:
    """Kick and drag, then friction, or in the reverse order in the kick that closes a step."""
    rubbed, left = 0.0, 1.0
    if not opens_step:
        speed = vector_length(vx, vy)
        left = velocity_factor_after_friction(speed, loss)
        vx, vy = vx * left, vy * left
        rubbed = 0.5 * speed * speed * (1.0 - left * left)
    vx, vy, dragged = move_with_drag(flow, vx, vy, ax, ay)
    if opens_step:
        speed = vector_length(vx, vy)
        left = velocity_factor_after_friction(speed, loss)
        vx, vy = vx * left, vy * left
        rubbed = 0.5 * speed * speed * (1.0 - left * left)
    return vx, vy, dragged, rubbed


@compiled
def _kick_with_friction(law: FrictionLaw, k: int, dt: float, bed: Bed, opens_step: bool) -> None:
    state, constants, rate = bed.state, bed.constants, law.rates.values[k]
    assert state.load is not None
    flow = drag_flow_coefficients(rate, dt)
    # Apart from the ledger, where each sum would wait for the one before it.
    dragged, rubbed = 0.0, 0.0
    for i in range(constants.grains):
        if not drag.is_of_drag_kind(law.kind, i, k):
            continue
        mass = value_or_one(constants.masses, i)
        load = plate_normal_force(law, state.load, i)
        vx, vy, fx, fy = state.vx[i], state.vy[i], state.fx[i], state.fy[i]
        speed = vector_length(vx, vy)
        against = max(-(vx * fx + vy * fy), 0.0)
        friction = law.dynamic * load
        if (speed * mass - 2.0 * dt * friction) * speed > dt * against:
            # The force and twice the friction would not stop it. (Else they must act together, or
            # a grain that is pushed on would be stopped for good by the greater static friction.)
            loss = friction * dt / mass
            state.vx[i], state.vy[i], by_drag, by_friction = _kick_fast_grain(
                flow, loss, vx, vy, fx / mass, fy / mass, opens_step
            )
            dragged += mass * by_drag
            rubbed += mass * by_friction
        else:
            state.vx[i], state.vy[i], by_drag, by_friction = slide(
                rate, dt, flow, mass, (vx, vy), (fx, fy), law.static, law.dynamic, load
            )
            dragged += by_drag
            rubbed += by_friction
    drag.record_drag_loss(law.drag, state, dragged)
    state.ledger[law.entry] += rubbed


@compiled
def _kick_regularised(law: FrictionLaw, k: int, dt: float, bed: Bed, threshold: float) -> None:
    """De Paula's law: friction as one more force, from the velocity before the kick."""
    state, constants = bed.state, bed.constants
    assert state.load is not None
    flow = drag_flow_coefficients(law.rates.values[k], dt)
    for i in range(constants.grains):
        if not drag.is_of_drag_kind(law.kind, i, k):
            continue
        mass = value_or_one(constants.masses, i)
        load = plate_normal_force(law, state.load, i)
        force = vector_length(state.fx[i], state.fy[i])
        vx, vy = state.vx[i], state.vy[i]
        speed = vector_length(vx, vy)
        if force <= law.static * load and speed < threshold:
            rx, ry = -state.fx[i], -state.fy[i]
        else:
            brake = law.dynamic * load / (speed + threshold)
            rx, ry = -brake * vx, -brake * vy
        ax, ay = (state.fx[i] + rx) / mass, (state.fy[i] + ry) / mass
        state.vx[i], state.vy[i], lost = move_with_drag(flow, vx, vy, ax, ay)
        drag.record_drag_loss(law.drag, state, mass * lost)
        middle_x, middle_y = 0.5 * (vx + state.vx[i]), 0.5 * (vy + state.vy[i])
        state.ledger[law.entry] -= dt * (rx * middle_x + ry * middle_y)


@compiled
def _kick_by_scheme(
    threshold: float | None, law: FrictionLaw, k: int, dt: float, bed: Bed, opens_step: bool
) -> None:
    if threshold is None:
        _kick_with_friction(law, k, dt, bed, opens_step)
    else:
        _kick_regularised(law, k, dt, bed, threshold)
