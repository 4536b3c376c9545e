"""Bow of the plates: long strips between the side walls, under a load that is spread evenly."""

from __future__ import annotations

from typing import NamedTuple

GLASS_MODULUS, GLASS_RATIO = 70e9, 0.22
"""Young's modulus [Pa] and Poisson's ratio of float glass (EN 572-1: 70 GPa, 0.2 to 0.23)."""


class Bow(NamedTuple):
    """Deflection of the middle of a plate [m]: edges clamped, and edges that can turn; others lie between."""

    clamped: float
    supported: float


def bow_of_plate(load: float, width: float, height: float, thickness: float) -> Bow:
    """Return how far a plate of glass bows under a load [N] on width times height [m]."""
    # Timoshenko and Woinowsky-Krieger 1959, sections 1 and 2: q b^4/(384 D) and 5 q b^4/(384 D) of a strip.
    stiffness = GLASS_MODULUS * thickness**3 / (12.0 * (1.0 - GLASS_RATIO**2))
    clamped = load / (width * height) * width**4 / (384.0 * stiffness)
    return Bow(clamped, 5.0 * clamped)
