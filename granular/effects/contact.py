"""Contact of two grains: Hertz's law with a dashpot, for distances below the sum of the radii.

With the overlap d, the force is k d^(3/2), k = (4/3) E* sqrt(R*), R* = R1 R2/(R1 + R2), and the
energy (2/5) k d^(5/2) (Johnson, Contact Mechanics, 1985). The dashpot
eta = alpha sqrt(m* k) d^(1/4) acts on the normal velocity;
alpha = -sqrt(5) ln e / sqrt(ln(e)^2 + pi^2) gives the restitution e at every speed of impact
(Antypov and Elliott 2011, doi:10.1209/0295-5075/94/50004).

The dashpots are solved pair by pair, each exactly, with the positions standing still; the second
half of a step takes them in the opposite order, so that the step stays symmetric.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.scene.parts import Grains
from granular.scene.scales import Scales
from granular.scene.schema import Section, quantity


class Contact(Section):
    """Hertzian contact between grains; off unless named.

    Attributes
    ----------
    modulus : float
        E*, the effective modulus of the pair [Pa]. Real magnets have some 1e11; a softer contact
        allows longer steps.
    restitution : float
        e, relative speed after an impact over that before.
    """

    modulus: float = quantity("Pa", above=0.0)
    restitution: float = quantity("1", default=0.5, above=0.0, most=1.0)

    def kernel(self, grains: Grains, scales: Scales, species: np.ndarray) -> ContactLaw:
        """The law in natural units."""
        diameters = np.array([one.diameter for one in grains.species]) / scales.length
        radius = 0.5 * diameters[species]
        logarithm = math.log(self.restitution)
        alpha = -math.sqrt(5.0) * logarithm / math.hypot(logarithm, math.pi)
        return ContactLaw(
            modulus=4.0 / 3.0 * self.modulus * scales.length**2 / scales.force,
            alpha=alpha,
            radius=radius,
            widest=float(diameters.max()),
            narrowest=float(diameters.min()),
        )


class ContactLaw(NamedTuple):
    """Contact as the kernels take it.

    Attributes
    ----------
    modulus : float
        (4/3) E* [F*/D^2]
    alpha : float
        Of the dashpot.
    radius : float64 (n,)
        [D]
    widest, narrowest : float
        Largest and smallest diameter [D].
    """

    modulus: float
    alpha: float
    radius: Array
    widest: float
    narrowest: float


@compiled
def spring(law: ContactLaw, first: float, second: float) -> float:
    """Spring constant k of two grains with these radii [F*/D^(3/2)]."""
    return law.modulus * math.sqrt(first * second / (first + second))


@compiled
def force(k: float, overlap: float) -> float:
    """Repulsion [F*] at an overlap [D]."""
    return k * overlap * math.sqrt(overlap)


@compiled
def energy(k: float, overlap: float) -> float:
    """Energy [F* D] at an overlap [D]."""
    return 0.4 * k * overlap * overlap * math.sqrt(overlap)


@compiled
def stiffness(k: float, overlap: float) -> float:
    """d(force)/d(overlap) [F*/D]."""
    return 1.5 * k * math.sqrt(overlap)


@compiled
def decay(law: ContactLaw, k: float, overlap: float, mass: float, span: float) -> float:
    """Share of the normal velocity that the dashpot leaves after ``span``, for a reduced mass."""
    rate = law.alpha * math.sqrt(k / mass) * math.sqrt(math.sqrt(overlap))
    return math.exp(-rate * span)


@compiled
def impact_stiffness(law: ContactLaw, speed: float, mass: float, barrier: float) -> float:
    """Square of the highest angular frequency in a head-on impact of two alike grains.

    Both come at ``speed``; their energy above the magnetic ``barrier`` at touch fixes the overlap.
    """
    reduced = 0.5 * mass
    left = 2.0 * reduced * speed * speed - barrier
    if left <= 0.0:
        return 0.0
    k = spring(law, 0.5 * law.widest, 0.5 * law.widest)
    return stiffness(k, (2.5 * left / k) ** 0.4) / reduced
