"""Repulsion of two magnetic dipoles whose moments are normal to the plane.

Force on i from j: (3/4) q_i q_j / r^4 along the line of centres; energy q_i q_j / (4 r^3), in
natural units, with q the moment over that of the first species [D, eq. 2.7; Yung, Landecker and
Villani 1998, doi:10.1155/1998/79537]. The formula printed as [D, eq. 2.6] has 1/r; it is 1/r^4.
"""

from __future__ import annotations

from granular.compiled import entry
from granular.effects.effect import Effect, in_joules

STRENGTH = 0.75
ENERGY = STRENGTH / 3.0


class Dipole(Effect):
    """Dipole repulsion between all grains. It has no parameters: the grains' moments fix it."""

    key = "dipole"
    periodic = True
    energy_record = in_joules("pair_energy", "energy of the magnetic pairs")


@entry
def pair_force(r: float) -> float:
    """Repulsion [F*] of two grains of the first species at the distance r [D]."""
    return STRENGTH / (r * r * r * r)


@entry
def pair_energy(r: float) -> float:
    """Energy [F* D] of two grains of the first species at the distance r [D]."""
    return ENERGY / (r * r * r)


@entry
def head_on_stiffness(speed: float, mass: float, moment: float) -> float:
    """Square of the angular frequency [1/tau^2] at the closest approach of two alike grains.

    Both come at ``speed`` [D/tau]; mass m and moment q are over those of the first species. From
    q^2/(4 r^3) = m v^2 and 6 q^2/(m r^5).
    """
    # The quotient first: it is exactly 1 where all grains are of one material.
    strength = moment * (moment / mass)
    square = 4.0 * speed * speed
    return 6.0 * strength / (strength / square) ** (5.0 / 3.0) if square > 0.0 else 0.0
