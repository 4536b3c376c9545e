"""Dry Coulomb friction of the grains on the glass plates.

A grain tilts between the plates until they hold it against the magnetic torque of the others, so
the plates bear on it with the normal force N_i = q_i sum_j q_j K_ij / r_ij^3 [D, eqs. 2.15, 4.11]:

    K_ij = (3/4) D_1 cos(th_i) sin(th_j) / (cos(ph_i + th_i) sqrt(D_i^2 + eps^2)),
    ph = atan(eps/D),   th = asin(E/sqrt(D^2 + eps^2)) - ph

with the thickness eps and the plates' distance E. [D, eq. 4.10] lacks the "- ph"; without it N is
some forty times too large, and the mono-disperse formula is not its limit. To second order in the
torque [D, eq. 3.2] 2 cos(th_i) sin(th_j) becomes 2 cos(th_i) sin(th_j) + (2/3) sin(th_j).

The sum adds magnitudes: it is an upper bound. With small tilts t, vectors in the plane, the torque on a
dipole is sum q_i q_j (t_i - t_j + 3 (t_j . e) e)/r^3, e the direction to the neighbour. All round, e e is
1/2 in the mean: (3/2) t_j for ``aligned`` tilts, t_i - t_j being zero as in the source, and t_i for
``independent`` ones, whose t_j is zero in the mean. Of discs the first is exact too; the second is within
2 % from 1.2 D on for 6 x 3 mm.

Two schemes. ``velocity`` (default) solves kick and friction while the positions stand still, each
exactly where the grain is fast, and together where it creeps: a sliding grain loses mu_d N/m of its
speed per time until it stops, a grain at rest stays at rest, to the last bit, while the force on it
is at most mu_s N.
``regularised`` is de Paula's law [D, eq. 4.5], a force: minus the other forces below a
threshold speed and mu_s N, otherwise mu_d N against the velocity. It does positive work below the
threshold, and chatters unless the step is very small.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.effects.dissipative_effect import DissipativeEffect
from granular.effects.drag import drag_taken_along
from granular.effects.effect import Effect, EffectContext, RecordedVariable, energy_variable
from granular.effects.friction_law import FrictionLaw
from granular.kernel_data.state import LOSSES, State
from granular.pairs.direct_sum import pad_values
from granular.schema.apparatus import Grains, Piston
from granular.schema.cell import Cell
from granular.schema.field_kinds import FieldError
from granular.schema.sections import choice_field, quantity

if TYPE_CHECKING:
    from jaxtyping import Float

SCHEMES = ("velocity", "regularised")


class Friction(DissipativeEffect):
    """Dry friction. Coefficients as in [D, Table 4.3].

    Attributes
    ----------
    static, dynamic : float
        mu_s and mu_d.
    torque : str
        ``"first"`` or ``"second"`` order in the torque; the second adds one magnitude more to the bound.
    tilt : str
        Directions in which the grains are taken to tilt: ``"bound"`` (default, the source's), each pair
        in the plane of its axes, so that the magnitudes of torques add up; ``"aligned"``, all grains in
        one direction; ``"independent"``, each grain in its own. With neighbours all round, the load is
        1/2 of the bound for aligned tilts, and 1/3 for independent ones.
    scheme : str
        ``"velocity"`` or ``"regularised"``.
    threshold : float
        Threshold speed of the regularised law [m/s]; de Paula's 1e-6 D/T is 1.5e-10 m/s for its
        compression of 39.6 s.
    load : float
        A constant normal force on every grain, besides the torque's [N].
    """

    key = "friction"
    periodic = True
    dry = True
    damps = True
    takes_along = ("drag",)
    loss_record = energy_variable("friction_loss", "energy lost to dry friction")
    grain_records = (RecordedVariable("normal_load", "N", "normal force on the plates", "force"),)

    static: float = quantity("1", default=0.6, least=0.0)
    dynamic: float = quantity("1", default=0.45, least=0.0)
    torque: str = choice_field("first", "second", default="first")
    tilt: str = choice_field("bound", "aligned", "independent", default="bound")
    scheme: str = choice_field(*SCHEMES, default="velocity")
    threshold: float = quantity("m/s", default=1.5e-10, above=0.0)
    load: float = quantity("N", default=0.0, least=0.0)

    def validate(self) -> None:
        """Check that the dynamic coefficient is at most the static one, and that torque and tilt fit."""
        if self.dynamic > self.static:
            raise FieldError(
                f"{self.dynamic:g} must be at most the static coefficient, {self.static:g}", "dynamic"
            )
        if self.torque == "second" and self.tilt != "bound":
            raise FieldError(
                f"'second' is an order of the bound, not of tilt = '{self.tilt}'; take 'first'", "torque"
            )

    def to_plain(self) -> dict[str, Any]:
        """Plain data as of `Section.to_plain`; the key ``tilt`` is written where it is not the source's."""
        plain: dict[str, Any] = super().to_plain()
        if self.tilt == "bound":
            del plain["tilt"]
        return plain

    def normal_force_factors(self, grains: Grains, cell: Cell) -> tuple[np.ndarray, np.ndarray]:
        """Per species, A_i (s,) and B_j (s,) of the normal force, with q_i q_j K_ij = A_i B_j."""
        diameter = np.array([specy.diameter for specy in grains.species])
        thickness, gap = grains.species_values("thickness"), cell.separation
        if gap < thickness.max():
            raise FieldError(
                f"{gap:g} m must be at least the grains' thickness, {thickness.max():g} m",
                "cell",
                "separation",
            )
        diagonal = np.hypot(diameter, thickness)
        if (diagonal <= gap).any():
            # D^2 + eps^2 = E^2: the diagonal fits upright between the plates.
            least = math.sqrt(gap**2 - thickness[diagonal <= gap][0] ** 2)
            raise FieldError(
                f"{diameter[diagonal <= gap][0]:g} m must be above {least:.3g} m, or the grain "
                "falls over between the plates and has no angle of tilt",
                "grains",
                "species",
            )
        # [D, eqs. 2.15, 4.11], without the misprint of [D, eq. 4.10]: the head of this file.
        moments = grains.moment_ratios()
        lean = np.arctan(thickness / diameter)
        tilt = np.arcsin(gap / diagonal) - lean
        # (1/3) of sin(th_j): half of the (2/3) by which the second-order torque [D, eq. 3.2] exceeds the
        # first.
        arm = np.cos(tilt) + (1.0 / 3.0 if self.torque == "second" else 0.0)
        own = moments * 0.75 * diameter[0] * arm / (np.cos(lean + tilt) * diagonal)
        if self.tilt == "independent":
            return own * np.sin(tilt) / 3.0, moments
        return own * (0.5 if self.tilt == "aligned" else 1.0), moments * np.sin(tilt)

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check that the grains fit between the plates, and tilt there."""
        self.normal_force_factors(grains, cell)

    def make_kernel_law(self, context: EffectContext) -> FrictionLaw:
        """Make the law that the compiled loop takes; it takes the drag along."""
        scales = context.scales
        kind, rates, drag_entry = drag_taken_along(context)
        own, _ = self.normal_force_factors(context.grains, context.cell)
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
        """Weights B_j of the grains in the sums of the normal force over 1/r^3."""
        weight = self.normal_force_factors(context.grains, context.cell)[1][context.species]
        return pad_values(weight * context.grains.moment_spread_factors())

    def grain_record_values(self, law: FrictionLaw, state: State) -> dict[str, np.ndarray]:
        """Return the normal force of the plates on each grain [F*]."""
        assert state.load is not None
        return {"normal_load": np.asarray(law.load + law.factor * state.load)}
