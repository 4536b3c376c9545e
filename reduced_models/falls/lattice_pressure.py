"""The hexagonal lattice of a scene's grains under pressure, dipoles or discs, by closed sums.

N grains of a lattice of the density rho that repel with F(r) have, by the virial, the pressure
p = (rho/4) sum r F(r) over the places of the lattice. For dipoles r F ~ r^-3 and the sum is
`hexagonal_lattice_sum` of 3: p = 1.6674 rho^2.5. Discs have b r^-5 more far away (`granular.pairs.disc_law`),
again a closed sum, and what is left falls with r^-7: it is added over the places within `SHELLS`
spacings. A mixture is taken at random: each place holds each species by its fraction.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.shared.errors import InputError

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

    from granular.pairs.disc_law import Disc
    from granular.schema.apparatus import Grains

__all__ = ["lattice_pressure"]

# Of the lattice's pressure, by the density, for dipoles: a grain's energy goes with r^-3 ~ rho^(3/2), and the
# pressure is rho^2 times its derivative.
POWER = 2.5
PRESSURE = 1.6674
"""Pressure of the hexagonal lattice of dipoles [F*/D] at rho = 1: see the module's first lines."""
SHELLS = 8.0
"""The rest beyond is 1e-6 of the pressure."""
_LEAST = 1e-9
"""Pressure below which discs are so far apart that they are dipoles [F*/D]."""
# Root of the logarithm of the density of touching discs over the thinnest in the table, e^-12 of it: dipoles.
_THINNEST = 3.5


class PressedLattice(NamedTuple):
    """A lattice under a pressure."""

    density: float  # [1/D^2]
    power: float  # d ln p/d ln rho

    @property
    def relative_shear_modulus(self) -> float:
        """Shear modulus over that of dipoles, both over the pressure, without unit."""
        # Central forces have B = 2 mu + 2 p in an isotropic lattice, and B = power p: mu/p = power/2 - 1, 1/4
        # for dipoles.
        return (self.power - 2.0) / (POWER - 2.0)


def lattice_under_pressure(grains: Grains, pressure: float) -> PressedLattice:
    """Compute the hexagonal lattice of grains that a pressure holds [1/D^2]; pressure [F*/D]."""
    # The virial's lattice sum solved for the density: p = 1.6674 rho^(5/2) times the squared mean moment for
    # dipoles, by Brent's method for discs.
    if grains.magnets == "dipoles" or pressure < _LEAST:
        moment = float(np.array(grains.species_fractions()) @ grains.moment_ratios())
        return PressedLattice((pressure / (PRESSURE * moment**2)) ** (1.0 / POWER), POWER)
    from scipy.optimize import brentq

    touching = touching_lattice_density(grains)
    logarithm = _tabulated_pressure(_discs_with_moment_fractions(grains), touching)
    greatest = math.exp(logarithm(0.0))
    if not pressure < greatest:
        raise InputError(
            f"the piston presses with {pressure / greatest:.3g} times what lets these discs touch; the "
            "law of a fall is known for magnets that repel: give less piston.mass, or stronger ones"
        )
    root = brentq(lambda x: logarithm(x) - math.log(pressure), 0.0, _THINNEST, xtol=1e-9)
    return PressedLattice(touching * math.exp(-(root**2)), -0.5 * float(logarithm(root, 1)) / root)


def touching_lattice_density(grains: Grains) -> float:
    """Density of the hexagonal lattice in which grains of the mean diameter touch [1/D^2]."""
    diameter = float(np.array(grains.species_fractions()) @ np.sqrt(grains.face_area_ratios()))
    return 1.0 / (math.sqrt(0.75) * diameter**2)


def lattice_pressure(grains: Grains, density: float) -> float:
    """Compute the pressure of the hexagonal lattice of grains, by a lattice sum.

    That of dipoles is 1.6674 (F*/D) rho^(5/2) times the square of their mean moment; its derivation
    is "The laws, derived" in the documentation.

    Parameters
    ----------
    grains : Grains
        Dipoles or discs; a mixture at random.
    density : float
        Number of grains an area, rho [1/D^2].

    Returns
    -------
    float
        Pressure, a force a length [F*/D].
    """
    if grains.magnets == "dipoles":
        moment = float(np.array(grains.species_fractions()) @ grains.moment_ratios())
        return PRESSURE * moment**2 * density**POWER
    return _disc_pressure(_discs_with_moment_fractions(grains), density)


def _discs_with_moment_fractions(grains: Grains) -> tuple[tuple[Disc, float], ...]:
    """Discs of each species, and what its moments have of a grain's mean moment."""
    from granular.effects.dipole import discs_unless_dipoles

    weights = np.array(grains.species_fractions()) * grains.moment_ratios()
    return tuple(zip(discs_unless_dipoles(grains, grains.species[0].diameter), weights.tolist(), strict=True))


def _disc_pressure(discs: tuple[tuple[Disc, float], ...], density: float) -> float:
    from granular.observables.moduli import hexagonal_lattice_sum

    spacing = math.sqrt(2.0 / (math.sqrt(3.0) * density))
    third, fifth = hexagonal_lattice_sum(3.0) / spacing**3, hexagonal_lattice_sum(5.0) / spacing**5
    total = 0.0
    for (first, weight), (second, other) in itertools.product(discs, repeat=2):
        shift, rest = _short_range_sum(first, second, spacing)
        total += weight * other * (3.0 * third + 7.5 * shift * fifth + rest)
    return density / 16.0 * total


@functools.cache
def _tabulated_pressure(discs: tuple[tuple[Disc, float], ...], touching: float) -> CubicSpline:
    """Logarithm of the pressure at the density touching exp(-x^2), by x."""
    # By x the pressure is smooth up to contact, where it is singular in the density.
    from scipy.interpolate import CubicSpline

    x = np.linspace(0.0, _THINNEST, 80)
    pressures = [_disc_pressure(discs, touching * math.exp(-value * value)) for value in x]
    return CubicSpline(x, np.log(pressures))


def _short_range_sum(first: Disc, second: Disc, spacing: float) -> tuple[float, float]:
    """Shift b of two discs, and the sum of r F(r) less 3 r^-3 + 7.5 b r^-5, over that scale of dipoles."""
    # Below contact the force continues with its slope, as in a run.
    from granular.pairs.disc_law import contact_distance, disc_energy_and_force, pair_squared_distance_shift
    from granular.pairs.disc_near_law import force_slope_at_contact

    r, counts = _lattice_distances()
    r = spacing * r
    shift, contact = pair_squared_distance_shift(first, second), contact_distance(first, second)
    force = disc_energy_and_force(np.maximum(r, contact), first, second)[1]
    if r[0] < contact:
        force += np.minimum(r - contact, 0.0) * force_slope_at_contact(first, second)
    return shift, float(counts @ (r * force - 3.0 * r**-3 - 7.5 * shift * r**-5))


@functools.cache
def _lattice_distances() -> tuple[np.ndarray, np.ndarray]:
    """Distances of the points of a lattice of spacing 1 from one of them, and the number at each."""
    i, j = np.mgrid[-10:11, -10:11]
    squares = i * i + i * j + j * j
    distances, counts = np.unique(squares[(squares > 0) & (squares <= SHELLS**2)], return_counts=True)
    return np.sqrt(distances), counts.astype(float)
