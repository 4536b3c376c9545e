"""Dry Coulomb friction of the grains on the glass plates.

The magnetic torque of the other grains tilts a grain until the plates hold it. The plates then press on it
with the normal force N_i = q_i sum_j q_j K_ij / r_ij^3 [D, eqs. 2.15, 4.11]:

    K_ij = (3/4) D_1 cos(th_i) sin(th_j) / (cos(ph_i + th_i) sqrt(D_i^2 + eps^2)),
    ph = atan(eps/D),   th = asin(E/sqrt(D^2 + eps^2)) - ph

where D and eps are the diameter and thickness of a grain, q the moment relative to the first species, and E
the distance between the plates. The "- ph" is missing in [D, eq. 4.10]; without it N would be about forty
times too large, and would not tend to the formula for equal grains. To second order in the torque [D, eq.
3.2], 2 cos(th_i) sin(th_j) becomes 2 cos(th_i) sin(th_j) + (2/3) sin(th_j).

N_i is an upper bound, because the sum adds magnitudes. For small tilts t, which are vectors in the plane, the
torque on a dipole is the sum of q_i q_j (t_i - t_j + 3 (t_j . e) e)/r^3, where e is the direction to the
neighbour j. If neighbours lie in all directions, the mean of (t_j . e) e is t_j/2. The torque is then
proportional to (3/2) t_j for ``aligned`` tilts, which are equal (t_i = t_j) as in [D]. For ``independent``
tilts, whose mean is zero, the torque is proportional to t_i. For discs the result
for aligned tilts is also exact; the result for independent tilts is accurate to 2 % beyond 1.2 D for discs
of 6 x 3 mm.

There are two schemes. ``velocity`` (default) solves kick and friction at fixed positions. For a fast grain
they are solved one after the other, each exactly; for a creeping grain they are solved together. A sliding
grain decelerates at mu_d N/m until it stops; a grain at rest stays exactly at rest while the force on it does
not exceed mu_s N. ``regularised`` is de Paula's force law [D, eq. 4.5]. If the speed is below a threshold and
the other forces are below mu_s N, friction cancels these forces; otherwise friction is mu_d N, opposite to
the velocity. This law does positive work below the threshold, and friction oscillates from step to step
unless the time step is very small.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects import drag
from granular.effects.drag import (
    Flow,
    drag_rates_and_ledger_index,
    exact_drag_step_factors,
    slide_under_drag_and_friction,
    vector_length,
    velocity_and_loss_under_drag,
)
from granular.effects.effect import (
    DissipativeEffect,
    Effect,
    EffectContext,
    RecordedVariable,
    recorded_energy_variable,
)
from granular.kernel_data.state import LOSSES, Bed, State
from granular.pairs.direct_sum import pad_values
from granular.pairs.grain_arrays import value_or_one
from granular.schema.apparatus import Grains, Piston
from granular.schema.cell import Cell
from granular.schema.field_kinds import FieldError
from granular.schema.sections import choice_field, quantity
from granular.shared.array_types import Float

SCHEMES = ("velocity", "regularised")


class Friction(DissipativeEffect):
    """Dry friction on the plates; default coefficients as in [D, Table 4.3].

    Attributes
    ----------
    static, dynamic : float
        Coefficients mu_s at rest and mu_d in motion.
    torque : str
        ``"first"`` or ``"second"`` order in the torque; ``"second"`` requires ``tilt = "bound"``.
    tilt : str
        Assumed tilt directions of the grains: ``"bound"`` (default, as in [D]), the directions in which the
        magnitudes of all torques on a grain add; ``"aligned"``, all grains in one direction;
        ``"independent"``, each grain in a random direction. If neighbours lie in all directions, the normal
        force is 1/2 of the bound for aligned tilts, and 1/3 for independent tilts.
    scheme : str
        ``"velocity"`` or ``"regularised"``.
    threshold : float
        Threshold speed of the regularised law [m/s]; de Paula's value of 1e-6 D/T is 1.5e-10 m/s for a
        compression that takes T = 39.6 s.
    load : float
        Constant normal force on every grain [N], in addition to the normal force due to the torque.
    """

    key = "friction"
    periodic = True
    dry = True
    damps = True
    solved_together_with = ("drag",)
    unwritten_defaults = ("tilt",)
    loss_record = recorded_energy_variable("friction_loss", "energy lost to dry friction")
    grain_records = (RecordedVariable("normal_load", "N", "normal force on the plates", "force"),)

    static: float = quantity("1", default=0.6, least=0.0)
    dynamic: float = quantity("1", default=0.45, least=0.0)
    torque: str = choice_field("first", "second", default="first")
    tilt: str = choice_field("bound", "aligned", "independent", default="bound")
    scheme: str = choice_field(*SCHEMES, default="velocity")
    threshold: float = quantity("m/s", default=1.5e-10, above=0.0)
    load: float = quantity("N", default=0.0, least=0.0)

    def validate(self) -> None:
        """Check that ``dynamic`` does not exceed ``static``, and that ``torque`` and ``tilt`` agree."""
        if self.dynamic > self.static:
            raise FieldError(
                f"{self.dynamic:g} exceeds the static coefficient, {self.static:g}; reduce it", "dynamic"
            )
        if self.torque == "second" and self.tilt != "bound":
            raise FieldError(
                f"'second' requires tilt = 'bound', but tilt is '{self.tilt}'; use 'first'", "torque"
            )

    def first_and_second_normal_force_factors(
        self, grains: Grains, cell: Cell
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the factors A_i (s,) and B_j (s,) of each species in q_i q_j K_ij = A_i B_j."""
        diameter = np.array([specy.diameter for specy in grains.species])
        thickness, gap = grains.species_values("thickness"), cell.separation
        if gap < thickness.max():
            raise FieldError(
                f"{gap:g} m is below the grains' thickness, {thickness.max():g} m; give a larger distance "
                "between the plates",
                "cell",
                "separation",
            )
        diagonal = np.hypot(diameter, thickness)
        if (diagonal <= gap).any():
            # D^2 + eps^2 = E^2: the diagonal fits upright between the plates.
            minimum = math.sqrt(gap**2 - thickness[diagonal <= gap][0] ** 2)
            raise FieldError(
                f"a diameter of {diameter[diagonal <= gap][0]:g} m is not above {minimum:.3g} m, and such a "
                "grain tips over between the plates; give a larger diameter or a smaller cell.separation",
                "grains",
                "species",
            )
        # [D, eqs. 2.15, 4.11], without the misprint of [D, eq. 4.10].
        moments = grains.moment_ratios()
        lean = np.arctan(thickness / diameter)
        tilt = np.arcsin(gap / diagonal) - lean
        # 1/3: half of the coefficient 2/3 of the additional second-order torque [D, eq. 3.2].
        arm = np.cos(tilt) + (1.0 / 3.0 if self.torque == "second" else 0.0)
        own = moments * 0.75 * diameter[0] * arm / (np.cos(lean + tilt) * diagonal)
        if self.tilt == "independent":
            return own * np.sin(tilt) / 3.0, moments
        return own * (0.5 if self.tilt == "aligned" else 1.0), moments * np.sin(tilt)

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check that the grains fit between the plates and can tilt without tipping over."""
        self.first_and_second_normal_force_factors(grains, cell)

    def make_kernel_law(self, context: EffectContext) -> FrictionLaw:
        """Make the law for the compiled loop, including viscous drag."""
        scales = context.scales
        kind, rates, drag_entry = drag_rates_and_ledger_index(context)
        own, _ = self.first_and_second_normal_force_factors(context.grains, context.cell)
        threshold = self.threshold / scales.velocity if self.scheme == "regularised" else None
        return FrictionLaw(
            static=self.static,
            dynamic=self.dynamic,
            threshold=threshold,
            load=self.load / scales.force,
            factor=pad_values(own[context.species] * context.grains.moment_spread_factors()),
            kind=kind,
            rates=rates,
            entry=LOSSES + context.indices["friction"],
            drag=drag_entry,
        )

    def normal_load_weights(self, context: EffectContext) -> Float[np.ndarray, "m"]:
        """Weights B_j of the grains in the sums over 1/r^3 that give the normal force."""
        weight = self.first_and_second_normal_force_factors(context.grains, context.cell)[1][context.species]
        return pad_values(weight * context.grains.moment_spread_factors())

    def grain_record_values(self, law: FrictionLaw, state: State) -> dict[str, np.ndarray]:
        """Return the normal force of the plates on each grain [F*]."""
        assert state.load is not None
        return {"normal_load": np.asarray(law.load + law.factor * state.load)}


class FrictionLaw(NamedTuple):
    """Friction in natural units, for the compiled loop."""

    static: float
    dynamic: float
    threshold: float | None  # [D/tau], for the regularised law; None: velocity scheme
    load: float  # constant normal force [F*]
    factor: Float[Array, "m"]  # N_i = load + factor_i sum_j weight_j / r_ij^3 [F* D^3]
    kind: Float[Array, "m"] | None  # of the drag that is solved together, as in `DragLaw`
    rates: drag.DragRateTable
    entry: int  # ledger index of the loss to friction
    drag: int | None  # ledger index of the loss to drag

    @staticmethod
    @compiled(inline=True)
    def kick(law: FrictionLaw, workspace: None, index: int, dt: float, bed: Bed, opens_step: bool) -> int:
        """Kick the grains by force, drag and friction together; dt [tau]."""
        for k in range(len(law.rates.values)):
            _kick_by_friction_scheme(law.threshold, law, k, dt, bed, opens_step)
        return 0


@compiled
def plate_normal_force(law: FrictionLaw, load: Float[Array, "m"], i: int) -> float:
    """Return the normal force of the plates on a grain [F*], computed from the grain's sum of 1/r^3."""
    return law.load + law.factor[i] * load[i]


@compiled
def velocity_factor_after_friction(speed: float, loss: float) -> float:
    """Return (speed - loss)/speed, or 0 if friction stops the grain; both arguments in D/tau."""
    return 1.0 - loss / speed if speed > loss else 0.0


# Kicks give the velocities after a time ``dt`` at fixed positions. Force and drag are solved together,
# exactly; friction is solved exactly after them in the kick that opens a step, and before them in the kick
# that closes it. For grains that friction would stop within a few kicks, all three are solved together,
# along one mean direction.


@compiled(inline=True)
def _velocity_after_kick_and_losses(
    flow: Flow, loss: float, vx: float, vy: float, ax: float, ay: float, opens_step: bool
) -> tuple[float, float, float, float]:
    """Apply kick and drag, then friction, if the kick opens a step; otherwise apply friction first."""
    rubbed = 0.0
    if not opens_step:
        vx, vy, rubbed = _velocity_and_loss_after_friction(vx, vy, loss)
    vx, vy, dragged = velocity_and_loss_under_drag(flow, vx, vy, ax, ay)
    if opens_step:
        vx, vy, rubbed = _velocity_and_loss_after_friction(vx, vy, loss)
    return vx, vy, dragged, rubbed


@compiled(inline=True)
def _velocity_and_loss_after_friction(vx: float, vy: float, loss: float) -> tuple[float, float, float]:
    """Return the velocity after friction, and the energy lost per unit mass."""
    speed = vector_length(vx, vy)
    factor = velocity_factor_after_friction(speed, loss)
    return vx * factor, vy * factor, 0.5 * speed * speed * (1.0 - factor * factor)


@compiled
def _kick_with_friction(law: FrictionLaw, k: int, dt: float, bed: Bed, opens_step: bool) -> None:
    state, constants, rate = bed.state, bed.constants, law.rates.values[k]
    assert state.load is not None
    flow = exact_drag_step_factors(rate, dt)
    # Local sums: in the ledger, each addition would have to wait for the previous one.
    dragged, rubbed = 0.0, 0.0
    for i in range(constants.grains):
        if not drag.has_drag_rate_index(law.kind, i, k):
            continue
        mass = value_or_one(constants.masses, i)
        load = plate_normal_force(law, state.load, i)
        vx, vy, fx, fy = state.vx[i], state.vy[i], state.fx[i], state.fy[i]
        speed = vector_length(vx, vy)
        against = max(-(vx * fx + vy * fy), 0.0)
        friction = law.dynamic * load
        if (speed * mass - 2.0 * dt * friction) * speed > dt * against:
            # The force and twice the friction would not stop it. (Otherwise they must act together, or the
            # larger static friction would permanently stop a grain that the force pushes on.)
            loss = friction * dt / mass
            state.vx[i], state.vy[i], by_drag, by_friction = _velocity_after_kick_and_losses(
                flow, loss, vx, vy, fx / mass, fy / mass, opens_step
            )
            dragged += mass * by_drag
            rubbed += mass * by_friction
        else:
            state.vx[i], state.vy[i], by_drag, by_friction = slide_under_drag_and_friction(
                rate, dt, flow, mass, (vx, vy), (fx, fy), law.static, law.dynamic, load
            )
            dragged += by_drag
            rubbed += by_friction
    drag.add_drag_loss_to_ledger(law.drag, state, dragged)
    state.ledger[law.entry] += rubbed


@compiled
def _kick_with_regularised_friction(law: FrictionLaw, k: int, dt: float, bed: Bed, threshold: float) -> None:
    """Kick by de Paula's law, with friction as a force evaluated at the velocity before the kick."""
    state, constants = bed.state, bed.constants
    assert state.load is not None
    flow = exact_drag_step_factors(law.rates.values[k], dt)
    for i in range(constants.grains):
        if not drag.has_drag_rate_index(law.kind, i, k):
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
        state.vx[i], state.vy[i], lost = velocity_and_loss_under_drag(flow, vx, vy, ax, ay)
        drag.add_drag_loss_to_ledger(law.drag, state, mass * lost)
        middle_x, middle_y = 0.5 * (vx + state.vx[i]), 0.5 * (vy + state.vy[i])
        state.ledger[law.entry] -= dt * (rx * middle_x + ry * middle_y)


@compiled
def _kick_by_friction_scheme(
    threshold: float | None, law: FrictionLaw, k: int, dt: float, bed: Bed, opens_step: bool
) -> None:
    if threshold is None:
        _kick_with_friction(law, k, dt, bed, opens_step)
    else:
        _kick_with_regularised_friction(law, k, dt, bed, threshold)
