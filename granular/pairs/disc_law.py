"""The law of two uniformly magnetised discs whose axes are normal to the plates.

Each face bears the charge that its magnetisation ends on, so the energy is a sum over pairs of
faces, E = (mu0 M1 M2 / 4 pi) sum +-U(r, z), z the height of the one face above the other and

    U(r, z) = integral of 1/distance over both faces
            = integral over v of A(v) v 4 K(m) / a,   m = 4 r v / a^2,   a^2 = (r + v)^2 + z^2

with A(v) the area in which discs of both radii overlap at the distance v of their centres, and K
the complete elliptic integral: two discs are as many pairs of points as their overlap is large, and
those of one displacement v in all directions make a ring. It is the same as the Fourier-Bessel form
2 pi mu0 M^2 R^2 int J0(kr) J1(kR)^2 (1 - exp(-kh)) / k^2 dk, without its oscillations.

Far away it is the dipoles' energy times 1 + (3/2) b / r^2 + ..., and b is the sum of what each disc
brings, `squared_distance_shift`. As (1 - b/r^2)^(-3/2) begins in the same manner, dipoles at the distance
rho = sqrt(r^2 - b) are much closer to discs than dipoles at r: that, with one term more, is what is
summed over all pairs, and a table over the close ones makes up for the rest (`granular.pairs.disc_near_law`).

Where both faces are in one plane, the force is singular at contact as x^(3/2), x = r - R1 - R2;
else as the real part of (x + iz)^(3/2): `contact_force_singularity`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Disc", "disc_energy_and_force"]

Samples = NDArray[np.float64]

_NODES, _EXTENT = 60, 3.4
"""Nodes on each side of the middle, and where they end, of the double-exponential quadrature
(Takahasi and Mori 1974, doi:10.2977/prims/1195192451), which ends in singularities do not harm."""


class Disc(NamedTuple):
    """A disc.

    Attributes
    ----------
    radius, height : float
        Both in one unit of length.
    """

    radius: float
    height: float


def squared_distance_shift(disc: Disc) -> float:
    """Contribution of a disc to b = r^2 - rho^2, with level mid-planes: (3/4) (R^2 - h^2/3)."""
    return 0.75 * (disc.radius**2 - disc.height**2 / 3.0)


def pair_squared_distance_shift(first: Disc, second: Disc) -> float:
    """Shift b of the squared distance at which two dipoles repel as two discs do far away."""
    return squared_distance_shift(first) + squared_distance_shift(second)


def contact_distance(first: Disc, second: Disc) -> float:
    """Distance of the axes at which two discs touch: the sum of their radii."""
    return first.radius + second.radius


def disc_energy_and_force(r: Samples, first: Disc, second: Disc) -> tuple[Samples, Samples]:
    """Energy and repulsion of two discs over those scales for which dipoles have 1/r^3 and 3/r^4.

    Parameters
    ----------
    r : float (n,)
        Distances of the axes, from contact on; in the unit of the discs.
    first, second : Disc
        The two discs, whose mid-planes are level.

    Returns
    -------
    tuple of float64 (n,)
        Energy over mu0 m1 m2 / (4 pi), and force over the same.
    """
    energy, force = np.zeros((2, len(r)))
    for z, sign in (
        (0.5 * abs(first.height - second.height), 2.0),
        (0.5 * (first.height + second.height), -2.0),
    ):
        of_faces, slope = _face_pair_energy(np.asarray(r, dtype=np.float64), z, first, second)
        energy += sign * of_faces
        force -= sign * slope
    return energy / disc_volumes(first, second), force / disc_volumes(first, second)


def contact_force_singularity(first: Disc, second: Disc) -> tuple[float, float]:
    """Singular part of the force at contact: factor and height z of factor Re (x + iz)^(3/2)."""
    reduced = first.radius * second.radius / (first.radius + second.radius)
    # In the units of `disc_energy_and_force`. The two pairs of nearest faces alone: others are smooth at
    # contact.
    factor = 2.0 * 8.0 * np.pi / 3.0 * np.sqrt(2.0 * reduced)
    return float(factor / disc_volumes(first, second)), 0.5 * abs(first.height - second.height)


def disc_volumes(first: Disc, second: Disc) -> float:
    """Product of the volumes of two discs."""
    return float(np.pi**2 * (first.radius * second.radius) ** 2 * first.height * second.height)


def _tanh_sinh_nodes() -> tuple[Samples, Samples, Samples]:
    """Nodes on (0, 1), what lies between them and 1, and their weights."""
    k = np.linspace(-_EXTENT, _EXTENT, 2 * _NODES + 1)
    u = 0.5 * np.pi * np.sinh(k)
    weight = 0.25 * np.pi * (k[1] - k[0]) * np.cosh(k) / np.cosh(u) ** 2
    return 1.0 / (1.0 + np.exp(-2.0 * u)), 1.0 / (1.0 + np.exp(2.0 * u)), weight


def overlap_nodes(first: Disc, second: Disc) -> tuple[Samples, Samples, Samples, Samples]:
    """Displacements v, contact less v, weights, and both discs' segments of the overlap (2, n) at v."""
    low, high = abs(first.radius - second.radius), contact_distance(first, second)
    left, right, weight = _tanh_sinh_nodes()
    ends = np.array([0.0, low, high] if low > 0.0 else [low, high])[:, None]
    width = np.diff(ends, axis=0)
    v, below = (ends[:-1] + width * left).ravel(), (high - ends[1:] + width * right).ravel()
    s = np.sqrt(below * np.maximum(v - low, 0.0) * (v + low) * (v + high))
    squares = np.array([[first.radius**2], [second.radius**2]])
    angles = 2.0 * np.arctan2(s, v**2 + squares - squares[::-1])
    return v, below, (width * weight).ravel(), 0.5 * squares * _angle_less_sine(angles)


def _angle_less_sine(x: Samples) -> Samples:
    """Difference x - sin(x), also of small angles."""
    square = x * x
    series = x * square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0)))
    return np.where(x < 0.1, series, x - np.sin(x))


def ring_integrals(r: Samples, v: Samples, apart: Samples, z: float) -> tuple[Samples, Samples, Samples]:
    """Integrals over a ring of 1/d, 1/d^3 and 1/d^5, d the distance of a point at r and the height z."""
    from scipy.special import ellipe, ellipkm1

    a2, b2 = (r + v) ** 2 + z * z, apart**2 + z * z
    ratio = b2 / a2
    first, second, scale = ellipkm1(ratio), ellipe(1.0 - ratio), 4.0 / np.sqrt(a2)
    fifth = (2.0 * (1.0 + ratio) * second - ratio * first) / (3.0 * b2 * b2)
    return scale * first, scale * second / b2, scale * fifth


def _face_pair_energy(r: Samples, z: float, first: Disc, second: Disc) -> tuple[Samples, Samples]:
    """U of the head of this file, and its derivative by r."""
    v, below, weights, segments = overlap_nodes(first, second)
    across = r[:, None]
    # By the distances from contact: v itself is rounded.
    apart = across - contact_distance(first, second) + below
    inverse, cube, _ = ring_integrals(across, v, apart, z)
    slope = -0.5 / across * (inverse + (apart * (across + v) - z * z) * cube)
    amounts = segments.sum(axis=0) * v * weights
    return inverse @ amounts, slope @ amounts
