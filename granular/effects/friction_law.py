"""The kicks of `granular.effects.friction`, by either of its two schemes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from granular.compiled import Array, compiled
from granular.effects import drag
from granular.kernel_data.state import Bed, State
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


DragCoefficients = tuple[float, float, float, float, float]
"""The values of `granular.effects.drag.drag_flow_coefficients`."""


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
def _vector_length(x: float, y: float) -> float:
    """Length of a vector. `math.hypot`, which guards against overflow, took a third of a step."""
    return math.sqrt(x * x + y * y)


@compiled(inline=True)
def _kick_and_drag_grain(
    entry: int | None, flow: DragCoefficients, ax: float, ay: float, state: State, i: int, mass: float
) -> None:
    """Kick and drag of a grain under an acceleration [D/tau^2]."""
    decay, gain, a, b, c = flow
    vx, vy = state.vx[i], state.vy[i]
    state.vx[i] = decay * vx + gain * ax
    state.vy[i] = decay * vy + gain * ay
    lost = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
    drag.record_drag_loss(entry, state, mass * lost)


@compiled
def _start_sliding_if_forced(
    law: FrictionLaw,
    rate: float,
    dt: float,
    flow: DragCoefficients,
    state: State,
    i: int,
    mass: float,
    load: float,
) -> None:
    """Grain at rest: it stays, or starts to slide along the force on it."""
    force = _vector_length(state.fx[i], state.fy[i])
    if force <= law.static * load:
        return
    fraction = 1.0 - law.dynamic * load / force
    ax, ay = fraction * state.fx[i] / mass, fraction * state.fy[i] / mass
    _kick_and_drag_grain(law.drag, flow, ax, ay, state, i, mass)
    displacement = drag.displacement_under_drag(rate, dt, flow[1], 0.0, fraction * force / mass)
    state.ledger[law.entry] += law.dynamic * load * displacement


@compiled(inline=True)
def _kick_fast_grain(
    flow: DragCoefficients, loss: float, vx: float, vy: float, ax: float, ay: float, opens_step: bool
) -> tuple[float, float, float, float]:
    """Kick and drag, then friction, or in the reverse order in the kick that closes a step."""
    decay, gain, a, b, c = flow
    rubbed, left = 0.0, 1.0
    if not opens_step:
        speed = _vector_length(vx, vy)
        left = velocity_factor_after_friction(speed, loss)
        vx, vy = vx * left, vy * left
        rubbed = 0.5 * speed * speed * (1.0 - left * left)
    dragged = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
    vx, vy = decay * vx + gain * ax, decay * vy + gain * ay
    if opens_step:
        speed = _vector_length(vx, vy)
        left = velocity_factor_after_friction(speed, loss)
        vx, vy = vx * left, vy * left
        rubbed = 0.5 * speed * speed * (1.0 - left * left)
    return vx, vy, dragged, rubbed


@compiled
def _kick_creeping_grain(
    law: FrictionLaw,
    rate: float,
    dt: float,
    flow: DragCoefficients,
    state: State,
    i: int,
    mass: float,
    load: float,
) -> None:
    """Force, drag and friction together, friction against the mean direction of the motion."""
    decay, gain = flow[:2]
    ax, ay = state.fx[i] / mass, state.fy[i] / mass
    vx, vy = state.vx[i], state.vy[i]
    # Direction of v before plus v after. One after the other, as fast grains take them, force and friction
    # would give a creeping grain more energy in each step than it has.
    ux, uy = (1.0 + decay) * vx + gain * ax, (1.0 + decay) * vy + gain * ay
    length = _vector_length(ux, uy)
    # Motion before and after cancel: the grain turns within dt, so it stops on the way.
    if length == 0.0:
        _bring_grain_to_rest(law, rate, dt, state, i, mass, load)
        return
    ux, uy = ux / length, uy / length
    if vx * ux + vy * uy < 0.0:
        _bring_grain_to_rest(law, rate, dt, state, i, mass, load)
        return
    brake = law.dynamic * load / mass
    ax, ay = ax - brake * ux, ay - brake * uy
    wx, wy = decay * vx + gain * ax, decay * vy + gain * ay
    if wx * ux + wy * uy <= 0.0:
        _bring_grain_to_rest(law, rate, dt, state, i, mass, load)
        return
    _kick_and_drag_grain(law.drag, flow, ax, ay, state, i, mass)
    displacement = drag.displacement_under_drag(rate, dt, gain, vx * ux + vy * uy, ax * ux + ay * uy)
    state.ledger[law.entry] += law.dynamic * load * displacement


@compiled
def _bring_grain_to_rest(
    law: FrictionLaw, rate: float, dt: float, state: State, i: int, mass: float, load: float
) -> None:
    """Grain that comes to rest within ``dt``; the force may set it off for what is left."""
    speed = _vector_length(state.vx[i], state.vy[i])
    against = -(state.vx[i] * state.fx[i] + state.vy[i] * state.fy[i]) / speed
    spent = drag.stopping_time(rate, speed, (law.dynamic * load + against) / mass)
    _stop_grain(law, rate, state, i, mass, load)
    left = max(dt - spent, 0.0)
    _start_sliding_if_forced(law, rate, left, drag.drag_flow_coefficients(rate, left), state, i, mass, load)


@compiled
def _kick_with_friction(law: FrictionLaw, k: int, dt: float, bed: Bed, opens_step: bool) -> None:
    state, constants, rate = bed.state, bed.constants, law.rates.values[k]
    assert state.load is not None
    flow = drag.drag_flow_coefficients(rate, dt)
    # Apart from the ledger, where each sum would wait for the one before it.
    dragged, rubbed = 0.0, 0.0
    for i in range(constants.grains):
        if not drag.is_of_drag_kind(law.kind, i, k):
            continue
        mass = value_or_one(constants.masses, i)
        load = plate_normal_force(law, state.load, i)
        vx, vy, fx, fy = state.vx[i], state.vy[i], state.fx[i], state.fy[i]
        speed = _vector_length(vx, vy)
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
        elif speed == 0.0:
            _start_sliding_if_forced(law, rate, dt, flow, state, i, mass, load)
        elif _grain_sticks(law, dt, speed, state, i, mass, load):
            _stop_grain(law, rate, state, i, mass, load)
        else:
            _kick_creeping_grain(law, rate, dt, flow, state, i, mass, load)
    drag.record_drag_loss(law.drag, state, dragged)
    state.ledger[law.entry] += rubbed


@compiled(inline=True)
def _grain_sticks(
    law: FrictionLaw, dt: float, speed: float, state: State, i: int, mass: float, load: float
) -> bool:
    """Return whether force and friction stop the grain within ``dt``, and friction then holds it."""
    vx, vy, fx, fy = state.vx[i], state.vy[i], state.fx[i], state.fy[i]
    against = -(vx * fx + vy * fy)
    # It must not be carried through rest to the other side: dynamic friction would release it there, though
    # static friction holds it.
    if against <= 0.0 or _vector_length(fx, fy) > law.static * load:
        return False
    return speed * mass <= dt * (against / speed + law.dynamic * load)


@compiled
def _stop_grain(law: FrictionLaw, rate: float, state: State, i: int, mass: float, load: float) -> None:
    """Stop a grain; friction and drag take their parts, the rest becomes potential energy."""
    speed = _vector_length(state.vx[i], state.vy[i])
    against = -(state.vx[i] * state.fx[i] + state.vy[i] * state.fy[i]) / speed
    friction = law.dynamic * load
    displacement = drag.stopping_distance(rate, speed, (friction + against) / mass)
    state.ledger[law.entry] += friction * displacement
    drag.record_drag_loss(law.drag, state, 0.5 * mass * speed * speed - (friction + against) * displacement)
    state.vx[i] = state.vy[i] = 0.0


@compiled
def _kick_regularised(law: FrictionLaw, k: int, dt: float, bed: Bed, threshold: float) -> None:
    """De Paula's law: friction as one more force, from the velocity before the kick."""
    state, constants = bed.state, bed.constants
    assert state.load is not None
    flow = drag.drag_flow_coefficients(law.rates.values[k], dt)
    for i in range(constants.grains):
        if not drag.is_of_drag_kind(law.kind, i, k):
            continue
        mass = value_or_one(constants.masses, i)
        load = plate_normal_force(law, state.load, i)
        force = _vector_length(state.fx[i], state.fy[i])
        vx, vy = state.vx[i], state.vy[i]
        speed = _vector_length(vx, vy)
        if force <= law.static * load and speed < threshold:
            rx, ry = -state.fx[i], -state.fy[i]
        else:
            brake = law.dynamic * load / (speed + threshold)
            rx, ry = -brake * vx, -brake * vy
        ax, ay = (state.fx[i] + rx) / mass, (state.fy[i] + ry) / mass
        _kick_and_drag_grain(law.drag, flow, ax, ay, state, i, mass)
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
