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
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.direct import padded_values
from granular.scene.parts import Cell, Grains
from granular.scene.scales import Scales
from granular.scene.schema import FieldError, Section, choice, quantity

SCHEMES = ("velocity", "regularised")


class Friction(Section):
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
        thickness, gap = grains.thickness, cell.separation
        if gap < thickness:
            raise FieldError(
                f"{gap:g} m must be at least the grains' thickness, {thickness:g} m",
                "cell",
                "separation",
            )
        diagonal = np.hypot(diameter, thickness)
        if (diagonal <= gap).any():
            least = math.sqrt(gap**2 - thickness**2)
            raise FieldError(
                f"{diameter[diagonal <= gap][0]:g} m must be above {least:.3g} m, or the grain "
                "falls over between the plates and has no angle of tilt",
                "grains",
                "species",
            )
        moments = (diameter / diameter[0]) ** 2
        lean = np.arctan(thickness / diameter)
        tilt = np.arcsin(gap / diagonal) - lean
        arm = np.cos(tilt) + (1.0 / 3.0 if self.torque == "second" else 0.0)
        own = moments * 0.75 * diameter[0] * arm / (np.cos(lean + tilt) * diagonal)
        return own, moments * np.sin(tilt)

    def kernel(
        self, grains: Grains, cell: Cell, scales: Scales, species: np.ndarray
    ) -> FrictionLaw:
        """The law in natural units."""
        own, weight = self.factors(grains, cell)
        threshold = self.threshold / scales.velocity if self.scheme == "regularised" else None
        return FrictionLaw(
            static=self.static,
            dynamic=self.dynamic,
            threshold=threshold,
            load=self.load / scales.force,
            factor=padded_values(own[species]),
            weight=padded_values(weight[species]),
        )


class FrictionLaw(NamedTuple):
    """Friction as the kernels take it.

    Attributes
    ----------
    static, dynamic : float
    threshold : float or None
        Of the regularised law [D/tau]; None for the velocity scheme.
    load : float
        Constant normal force [F*].
    factor, weight : float64 (m,)
        N_i = load + factor_i sum_j weight_j / r_ij^3.
    """

    static: float
    dynamic: float
    threshold: float | None
    load: float
    factor: Array
    weight: Array


@compiled
def normal_force(law: FrictionLaw, load: Array, i: int) -> float:
    """Normal force [F*] on a grain, from its sum over 1/r^3."""
    return law.load + law.factor[i] * load[i]


@compiled
def sliding(speed: float, loss: float) -> float:
    """Factor that shortens a velocity which loses ``loss`` of its magnitude; 0 where it stops."""
    return 1.0 - loss / speed if speed > loss else 0.0
