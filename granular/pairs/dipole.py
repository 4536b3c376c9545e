"""The law of two dipoles as kernels take it; see `granular.effects.dipole`."""

from __future__ import annotations

from granular.compiled import entry

STRENGTH = 0.75
ENERGY = STRENGTH / 3.0


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
