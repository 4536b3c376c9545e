"""The interaction of two dipoles, for compiled loops; see `granular.effects.dipole`.

The law is split smoothly into a far part, and a near part that is zero beyond a radius r_c. Beyond r_c the
far part is the law itself; within r_c it is the Taylor polynomial of the law in r^2 about r_c. With t =
(r/r_c)^2 - 1 and for r < r_c

    r^-3  ->  r_c^-3 (1 - (3/2) t + (15/8) t^2 - (35/16) t^3),
    r^-5  ->  r_c^-5 (1 - (5/2) t + (35/8) t^2),

where the second polynomial follows from the first as the force does from the energy. The near and the far
part are three times differentiable and add up to the law exactly, so energy is conserved for any method of
summing each part. This split is the even-power softening of multilevel summation (Skeel, Tezcan and Hardy
2002, doi:10.1002/jcc.10072).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from granular.compiled import entry
from granular.shared.array_types import Float

# 3 mu0 m^2/(4 pi r^4) (Jackson, Classical Electrodynamics, 5.6), in units of F* = mu0 m^2/(pi D^4).
STRENGTH = 0.75
ENERGY = STRENGTH / 3.0


@entry
def pair_force(r: float) -> float:
    """Return the repulsion [F*] of two dipoles of the first species, normal to their plane, at r [D]."""
    return STRENGTH / (r * r * r * r)


@entry
def pair_energy(r: float) -> float:
    """Return the energy [F* D] of two dipoles of the first species, normal to their plane, at r [D]."""
    return ENERGY / (r * r * r)


@entry
def squared_dipole_impact_frequency(speed: float, mass: float, moment: float) -> float:
    """Return stiffness over reduced mass [1/tau^2] at the turning point of a symmetric head-on collision."""
    # The quotient comes first: it is exactly 1 if all grains are of one material.
    strength = moment * (moment / mass)
    square = 4.0 * speed * speed
    # Both grains approach at speed v: q^2/(4 r^3) = m v^2 at the closest approach, where the stiffness
    # gives 6 q^2/(m r^5).
    return 6.0 * strength / (strength / square) ** (5.0 / 3.0) if square > 0.0 else 0.0


# The polynomials in t of the module's docstring, expanded.
CUBE = (6.5625, -11.8125, 8.4375, -2.1875)
"""Coefficients of the far part of r^-3 as a polynomial in (r/r_c)^2, in units of r_c^-3."""

FIFTH = (7.875, -11.25, 4.375)
"""Coefficients of the far part of r^-5, in units of r_c^-5."""

# Likewise 1 - (5/2) t + (35/8) t^2 - (105/16) t^3 for the energy, one order higher than in a force.
FIFTH_ENERGY = (14.4375, -30.9375, 24.0625, -6.5625)
"""Coefficients of the far part of r^-5 in the energy of discs, in units of r_c^-5."""

SEVENTH = tuple(-2.0 / 3.0 * k * FIFTH_ENERGY[k] for k in (1, 2, 3))
"""Coefficients of the far part of r^-7 in the force of discs (the derivative), in units of r_c^-7."""


def _far_part_of_inverse_power(
    u: NDArray[np.float64], numbers: tuple[float, ...], power: float
) -> NDArray[np.float64]:
    inside = np.polynomial.polynomial.polyval(u, numbers)
    return np.where(u < 1.0, inside, np.maximum(u, 1.0) ** power)


def far_part_of_inverse_cube(
    square: Float[NDArray[np.float64], "..."], radius: float, fifth: float = 0.0
) -> Float[NDArray[np.float64], "..."]:
    """Return the far part of r^-3 + ``fifth`` r^-5 at squared distances r^2; smooth within ``radius``."""
    u = np.asarray(square, dtype=np.float64) / radius**2
    result = _far_part_of_inverse_power(u, CUBE, -1.5) / radius**3
    return result + _far_part_of_inverse_power(u, FIFTH_ENERGY, -2.5) * fifth / radius**5 if fifth else result


def far_part_of_inverse_fifth(
    square: Float[NDArray[np.float64], "..."], radius: float, fifth: float = 0.0
) -> Float[NDArray[np.float64], "..."]:
    """Return the far part of r^-5 + (5/3) ``fifth`` r^-7, as needed for forces, at squared distances r^2."""
    u = np.asarray(square, dtype=np.float64) / radius**2
    result = _far_part_of_inverse_power(u, FIFTH, -2.5) / radius**5
    more = _far_part_of_inverse_power(u, SEVENTH, -3.5)
    return result + np.where(u < 1.0, more, 5.0 / 3.0 * more) * fifth / radius**7 if fifth else result
