"""The torque of two uniformly magnetised discs with equal tilts: the load on the plates is made of it.

Two dipoles tilted in the same sense by a small angle t, in the plane of their axes, tilt each other further
with the torque 3 t / r^3 (in units of mu0 m1 m2 / (4 pi)). Two discs turned by t about their centres are
level in a frame turned by t, one lifted by r t: the torque on the first is t r dT/dz of level discs, z the
height of the second above the first. Its face charges at the heights z1 = +-h1/2 give

    dT/dz = sum +-(z1 d2U/(dr dz) - d2W/dz2),   W(r, z) = integral of x1/distance over both faces

with U and its rings as in `granular.pairs.disc_law`, and x1 counted from the first disc's axis towards the
second: W has the first moment v S(v) of the overlap for its area A(v), S the segment of the second disc.

Far away the torque over the dipoles' is 1 + kappa/r^2 + ..., kappa = (15/2) b1 + (5/2) b2, b that of
`squared_distance_shift`: an octupole e/r^5 of the energy turns its own disc by 15 e and the other by 5 e,
where dipoles have 3. So with rho, s and c of `granular.pairs.disc_near_law` the load has for 1/r^3

    rho^2 (s + c s^2) + (6 b1 + b2) s + d s^2,

exact up to r^-5. Beyond the tables of the energy a fitted d keeps it within 1e-4 of the load at contact and
2e-3 of itself; nearer pairs have the difference tabulated. At contact the torque's slope is infinite, as
that of the root of r - R1 - R2.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from granular.pairs.disc_law import (
    Disc,
    Samples,
    contact_distance,
    disc_volumes,
    overlap_nodes,
    pair_squared_distance_shift,
    ring_integrals,
    squared_distance_shift,
)

LOAD_FIFTH = 10.0
"""Factor of r^-5 beside r^-3 in the load over b of one of two equal discs: kappa."""

_BEYOND = 40.0
"""Largest distance of the fit, over that of contact."""


def disc_torque_over_dipoles(r: Samples, first: Disc, second: Disc) -> Samples:
    """Torque on the first of two equally tilted discs over that of dipoles (n,); r (n,), from contact on."""
    v, below, weights, segments = overlap_nodes(first, second)
    across = r[:, None]
    apart = across - contact_distance(first, second) + below
    total = np.zeros(len(r))
    # The first disc's upper face with both of the second's; the lower face has the same again.
    for height, sign in ((second.height - first.height, 1.0), (-second.height - first.height, -1.0)):
        z = 0.5 * height
        inverse, cube, fifth = ring_integrals(across, v, apart, z)
        less, square = apart * (across + v) - z * z, across**2 + v**2 + z * z
        lifted = 1.5 * z * first.height * (less * fifth + cube)
        moment = (square + 3.0 * z * z) * cube - inverse - 3.0 * z * z * square * fifth
        total += sign * (lifted @ (segments.sum(axis=0) * v * weights) + moment @ (segments[1] * v * weights))
    return r**3 / 3.0 * total / disc_volumes(first, second)


def disc_load(r: Samples, first: Disc, second: Disc) -> Samples:
    """Value for 1/r^3 in the load on the first of two discs (n,), constant below contact; r (n,)."""
    r = np.maximum(r, contact_distance(first, second))
    # Thin discs turn tall ones back when they are close; the load is a magnitude.
    return np.abs(disc_torque_over_dipoles(r, first, second)) / r**3


def disc_load_law(r: Samples, first: Disc, second: Disc, c: float, term: float) -> Samples:
    """Value for 1/r^3 in the load on the first disc as the sum over all pairs has it (n,); r (n,)."""
    square = r * r - pair_squared_distance_shift(first, second)
    s = square**-2.5
    shift = 6.0 * squared_distance_shift(first) + squared_distance_shift(second)
    return np.asarray(square * (s + c * s * s) + shift * s + term * s * s)


def fit_load_term(pairs: Sequence[tuple[Disc, Disc]], begins: Sequence[float], c: float) -> float:
    """Fit d of the head of this file to pairs of discs, each from a distance on."""
    products, squares = 0.0, 0.0
    for pair, begin in zip(pairs, begins, strict=True):
        r = np.geomspace(begin, max(begin, _BEYOND * contact_distance(*pair)), 100)
        exact = disc_load(r, *pair)
        # By the area of a ring: what matters is the sum over neighbours.
        error, slope = ((disc_load_law(r, *pair, c, term) - exact) * r for term in (0.0, 1.0))
        slope = slope - error
        products, squares = products + float(error @ slope), squares + float(slope @ slope)
    return -products / squares
