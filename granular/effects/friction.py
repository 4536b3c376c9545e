"""Dry Coulomb friction of the grains on the glass plates.

A grain tilts between the plates until they hold it against the magnetic torque of the others, so
the plates bear on it with the normal force N_i = q_i sum_j q_j K_ij / r_ij^3 [D, eqs. 2.15, 4.11]:

    K_ij = (3/4) D_1 cos(th_i) sin(th_j) / (cos(ph_i + th_i) sqrt(D_i^2 + eps^2)),
    ph = atan(eps/D),   th = asin(E/sqrt(D^2 + eps^2)) - ph

with the thickness eps and the plates' distance E. [D, eq. 4.10] lacks the "- ph"; without it N is
some forty times too large, and the mono-disperse formula is not its limit. To second order in the
torque [D, eq. 3.2] 2 cos(th_i) sin(th_j) becomes 2 cos(th_i) sin(th_j) + (2/3) sin(th_j).

Two schemes. ``velocity`` (default) solves kick and friction while the positions stand still, each
exactly where the grain is fast, and together where it creeps: a sliding grain loses mu_d N/m of its
speed per time until it stops, a grain at rest stays at rest, to the last bit, while the force on it
is at most mu_s N.
``regularised`` is the source's law [D, eq. 4.5], a force: minus the other forces below a
threshold speed and mu_s N, otherwise mu_d N against the velocity. It does positive work below the
threshold, and chatters unless the step is very small.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects import drag
from granular.effects.effect import Effect, Record, Setting, in_joules
from granular.engine.constants import Constants
from granular.engine.state import LOSSES, State
from granular.pairs.direct import padded_values
from granular.scene.parts import Cell, Grains, Piston
from granular.scene.schema import FieldError, choice, quantity

SCHEMES = ("velocity", "regularised")


class Friction(Effect):
    """Dry friction. Coefficients as in [D, Table 4.3].

    Attributes
    ----------
    static, dynamic : float
        mu_s and mu_d.
    torque : str
        ``"first"`` or ``"second"`` order in the torque.
    scheme : str
        ``"velocity"`` or ``"regularised"``.
    threshold : float
        Threshold speed of the regularised law [m/s]; the source's 1e-6 D/T is 1.5e-10 m/s for its
        compression of 39.6 s.
    load : float
        A constant normal force on every grain, besides the torque's [N].
    """

    key = "friction"
    dry = True
    damps = True
    takes_along = ("drag",)
    loss_record = in_joules("friction_loss", "energy lost to dry friction")
    grain_records = (Record("normal_load", "N", "normal force on the plates", "force"),)

    static: float = quantity("1", default=0.6, least=0.0)
    dynamic: float = quantity("1", default=0.45, least=0.0)
    torque: str = choice("first", "second", default="first")
    scheme: str = choice(*SCHEMES, default="velocity")
    threshold: float = quantity("m/s", default=1.5e-10, above=0.0)
    load: float = quantity("N", default=0.0, least=0.0)

    def validate(self) -> None:
        if self.dynamic > self.static:
            raise FieldError(
                f"{self.dynamic:g} must be at most the static coefficient, {self.static:g}",
                "dynamic",
            )

    def factors(self, grains: Grains, cell: Cell) -> tuple[np.ndarray, np.ndarray]:
        """Per species, A_i and B_j of q_i q_j K_ij = A_i B_j, in units of D.

        Raises
        ------
        FieldError
            If the grains of a species do not fit between the plates, or fall over.
        """
        diameter = np.array([one.diameter for one in grains.species])
        thickness, gap = grains.of_species("thickness"), cell.separation
        if gap < thickness.max():
            raise FieldError(
                f"{gap:g} m must be at least the grains' thickness, {thickness.max():g} m",
                "cell",
                "separation",
            )
        diagonal = np.hypot(diameter, thickness)
        if (diagonal <= gap).any():
            least = math.sqrt(gap**2 - thickness[diagonal <= gap][0] ** 2)
            raise FieldError(
                f"{diameter[diagonal <= gap][0]:g} m must be above {least:.3g} m, or the grain "
                "falls over between the plates and has no angle of tilt",
                "grains",
                "species",
            )
        moments = grains.moment_ratios()
        lean = np.arctan(thickness / diameter)
        tilt = np.arcsin(gap / diagonal) - lean
        arm = np.cos(tilt) + (1.0 / 3.0 if self.torque == "second" else 0.0)
        own = moments * 0.75 * diameter[0] * arm / (np.cos(lean + tilt) * diagonal)
        return own, moments * np.sin(tilt)

    def check(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        self.factors(grains, cell)

    def law(self, setting: Setting) -> FrictionLaw:
        """The law in natural units; it takes the drag along."""
        scales, other = setting.scales, setting.effects.get("drag")
        own, _ = self.factors(setting.grains, setting.cell)
        threshold = self.threshold / scales.velocity if self.scheme == "regularised" else None
        return FrictionLaw(
            static=self.static,
            dynamic=self.dynamic,
            threshold=threshold,
            load=self.load / scales.force,
            factor=padded_values(own[setting.species] * setting.grains.spread_factors()),
            rate=None if other is None else other.decay_rate(scales),
            entry=LOSSES + setting.places["friction"],
            drag=None if other is None else LOSSES + setting.places["drag"],
        )

    def load_weight(self, setting: Setting) -> np.ndarray:
        weight = self.factors(setting.grains, setting.cell)[1][setting.species]
        return padded_values(weight * setting.grains.spread_factors())

    def grain_values(self, law: FrictionLaw, state: State) -> dict[str, np.ndarray]:
        """The normal force on the plates [F*]."""
        assert state.load is not None
        return {"normal_load": np.asarray(law.load + law.factor * state.load)}


class FrictionLaw(NamedTuple):
    """Friction as the kernels take it.

    Attributes
    ----------
    static, dynamic : float
    threshold : float or None
        Of the regularised law [D/tau]; None for the velocity scheme.
    load : float
        Constant normal force [F*].
    factor : float64 (m,)
        N_i = load + factor_i sum_j weight_j / r_ij^3.
    rate : float or None
        Decay rate of the drag that is solved with it [1/tau]; None without drag.
    entry : int
        Of the ledger, for what friction takes.
    drag : int or None
        The same for the drag.
    """

    static: float
    dynamic: float
    threshold: float | None
    load: float
    factor: Array
    rate: float | None
    entry: int
    drag: int | None

    @staticmethod
    @compiled(inline=True)
    def kick(
        law: FrictionLaw, room: None, place: int, span: float, state: State, constants: Constants,
        opening: bool,
    ) -> int:  # fmt: skip
        """Force, drag and friction; see the head of this file."""
        _dry_kick(law.threshold, law, _drag_rate(law.rate), span, state, constants, opening)
        return 0


Flow = tuple[float, float, float, float, float]
"""Of `granular.effects.drag.flow`."""


@compiled
def normal_force(law: FrictionLaw, load: Array, i: int) -> float:
    """Normal force [F*] on a grain, from its sum over 1/r^3."""
    return law.load + law.factor[i] * load[i]


@compiled
def sliding(speed: float, loss: float) -> float:
    """Factor that shortens a velocity which loses ``loss`` of its magnitude; 0 where it stops."""
    return 1.0 - loss / speed if speed > loss else 0.0


# Kicks: velocities after a span of time, while all positions stand still. Force and drag are solved
# together, exactly, and friction exactly after or before them, in opposite order in the kick that
# opens a step and in the one that closes it. On grains that friction would stop within a few such
# kicks it acts together with force and drag, along one mean direction.


@compiled
def _drag_rate(rate: float | None) -> float:
    return 0.0 if rate is None else rate


@compiled(inline=True)
def _enter_drag(entry: int | None, state: State, energy: float) -> None:
    """What the drag takes; without drag that is the rounding of zero."""
    if entry is not None:
        state.ledger[entry] += energy


@compiled(inline=True)
def _length(x: float, y: float) -> float:
    """Of a vector whose squares neither overflow nor matter where they vanish.

    ``hypot`` heeds both, and took a third of a step.
    """
    return math.sqrt(x * x + y * y)


@compiled(inline=True)
def _push_grain(
    entry: int | None, flow: Flow, share: float, state: State, i: int, mass: float
) -> None:
    """Kick and drag of one grain under a share of its force."""
    decay, gain, a, b, c = flow
    ax, ay = share * state.fx[i] / mass, share * state.fy[i] / mass
    vx, vy = state.vx[i], state.vy[i]
    state.vx[i] = decay * vx + gain * ax
    state.vy[i] = decay * vy + gain * ay
    lost = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
    _enter_drag(entry, state, mass * lost)


@compiled
def _start_grain(
    law: FrictionLaw, rate: float, span: float, flow: Flow, state: State, i: int, mass: float,
    load: float,
) -> None:  # fmt: skip
    """A grain at rest: it stays, or starts to slide along the force on it."""
    force = _length(state.fx[i], state.fy[i])
    if force <= law.static * load:
        return
    share = 1.0 - law.dynamic * load / force
    _push_grain(law.drag, flow, share, state, i, mass)
    way = drag.way(rate, span, flow[1], 0.0, share * force / mass)
    state.ledger[law.entry] += law.dynamic * load * way


@compiled(inline=True)
def _rub_grain(
    law: FrictionLaw, span: float, state: State, i: int, mass: float, load: float
) -> None:
    """A sliding grain loses speed, and stops where it has no more."""
    speed = _length(state.vx[i], state.vy[i])
    left = sliding(speed, law.dynamic * load * span / mass)
    state.vx[i] *= left
    state.vy[i] *= left
    state.ledger[law.entry] += 0.5 * mass * speed * speed * (1.0 - left * left)


@compiled
def _slide_grain(
    law: FrictionLaw, rate: float, span: float, flow: Flow, state: State, i: int, mass: float,
    load: float,
) -> None:  # fmt: skip
    """Force, drag and friction together, friction against the mean direction of the motion.

    One after the other, as fast grains take them, they would give a creeping grain more energy in
    each step than it has.
    """
    decay, gain, a, b, c = flow
    ax, ay = state.fx[i] / mass, state.fy[i] / mass
    vx, vy = state.vx[i], state.vy[i]
    ux, uy = (1.0 + decay) * vx + gain * ax, (1.0 + decay) * vy + gain * ay
    length = _length(ux, uy)
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
    _enter_drag(law.drag, state, mass * lost)
    way = drag.way(rate, span, gain, vx * ux + vy * uy, ax * ux + ay * uy)
    state.ledger[law.entry] += law.dynamic * load * way


@compiled
def _turn_grain(
    law: FrictionLaw, rate: float, span: float, state: State, i: int, mass: float, load: float
) -> None:
    """A grain that comes to rest within the span; the force may set it off for what is left."""
    speed = _length(state.vx[i], state.vy[i])
    against = -(state.vx[i] * state.fx[i] + state.vy[i] * state.fy[i]) / speed
    spent = drag.stopping_time(rate, speed, (law.dynamic * load + against) / mass)
    _stop_grain(law, rate, state, i, mass, load)
    left = max(span - spent, 0.0)
    _start_grain(law, rate, left, drag.flow(rate, left), state, i, mass, load)


@compiled
def _kick_with_friction(
    law: FrictionLaw, rate: float, span: float, state: State, constants: Constants,
    masses: Array | None, opening: bool,
) -> None:  # fmt: skip
    assert state.load is not None
    flow = drag.flow(rate, span)
    for i in range(constants.grains):
        mass = 1.0
        if masses is not None:
            mass = masses[i]
        load = normal_force(law, state.load, i)
        speed = _length(state.vx[i], state.vy[i])
        if speed == 0.0:
            _start_grain(law, rate, span, flow, state, i, mass, load)
        elif _sticks(law, span, speed, state, i, mass, load):
            _stop_grain(law, rate, state, i, mass, load)
        elif _slow(law, span, speed, state, i, mass, load):
            _slide_grain(law, rate, span, flow, state, i, mass, load)
        elif opening:
            _push_grain(law.drag, flow, 1.0, state, i, mass)
            _rub_grain(law, span, state, i, mass, load)
        else:
            _rub_grain(law, span, state, i, mass, load)
            _push_grain(law.drag, flow, 1.0, state, i, mass)


@compiled(inline=True)
def _sticks(
    law: FrictionLaw, span: float, speed: float, state: State, i: int, mass: float, load: float
) -> bool:
    """Whether the force, and friction with it, stop the grain in the span, and friction holds it.

    A grain must not be carried through rest to the other side, where dynamic friction would let go
    of what static friction holds.
    """
    vx, vy, fx, fy = state.vx[i], state.vy[i], state.fx[i], state.fy[i]
    against = -(vx * fx + vy * fy)
    if against <= 0.0 or _length(fx, fy) > law.static * load:
        return False
    return speed * mass <= span * (against / speed + law.dynamic * load)


@compiled
def _stop_grain(
    law: FrictionLaw, rate: float, state: State, i: int, mass: float, load: float
) -> None:
    """Stop a grain; friction and drag take their shares, the rest becomes potential energy."""
    speed = _length(state.vx[i], state.vy[i])
    against = -(state.vx[i] * state.fx[i] + state.vy[i] * state.fy[i]) / speed
    friction = law.dynamic * load
    way = drag.stopping_way(rate, speed, (friction + against) / mass)
    state.ledger[law.entry] += friction * way
    _enter_drag(law.drag, state, 0.5 * mass * speed * speed - (friction + against) * way)
    state.vx[i] = state.vy[i] = 0.0


@compiled(inline=True)
def _slow(
    law: FrictionLaw, span: float, speed: float, state: State, i: int, mass: float, load: float
) -> bool:
    """Whether the force and twice the friction would stop the grain in the span.

    Force and friction must then act together, or a grain that is pushed on would be stopped for
    good: the static friction that then holds it is greater.
    """
    vx, vy = state.vx[i], state.vy[i]
    against = max(-(vx * state.fx[i] + vy * state.fy[i]) / speed, 0.0)
    return speed * mass < span * (against + 2.0 * law.dynamic * load)


@compiled
def _kick_regularised(
    law: FrictionLaw, rate: float, span: float, state: State, constants: Constants,
    masses: Array | None, threshold: float,
) -> None:  # fmt: skip
    """The source's law: friction as one more force, from the velocity before the kick."""
    assert state.load is not None
    decay, gain, a, b, c = drag.flow(rate, span)
    for i in range(constants.grains):
        mass = 1.0
        if masses is not None:
            mass = masses[i]
        load = normal_force(law, state.load, i)
        force = _length(state.fx[i], state.fy[i])
        vx, vy = state.vx[i], state.vy[i]
        speed = _length(vx, vy)
        if force <= law.static * load and speed < threshold:
            rx, ry = -state.fx[i], -state.fy[i]
        else:
            brake = law.dynamic * load / (speed + threshold)
            rx, ry = -brake * vx, -brake * vy
        ax, ay = (state.fx[i] + rx) / mass, (state.fy[i] + ry) / mass
        state.vx[i] = decay * vx + gain * ax
        state.vy[i] = decay * vy + gain * ay
        lost = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
        _enter_drag(law.drag, state, mass * lost)
        middle_x, middle_y = 0.5 * (vx + state.vx[i]), 0.5 * (vy + state.vy[i])
        state.ledger[law.entry] -= span * (rx * middle_x + ry * middle_y)


@compiled
def _dry_kick(
    threshold: float | None, law: FrictionLaw, rate: float, span: float, state: State,
    constants: Constants, opening: bool,
) -> None:  # fmt: skip
    if threshold is None:
        _kick_with_friction(law, rate, span, state, constants, constants.masses, opening)
    else:
        _kick_regularised(law, rate, span, state, constants, constants.masses, threshold)
