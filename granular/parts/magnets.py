"""Magnets: catalogue grades, and the moment of a disc in a bed.

The moment is computed from catalogue or measured data. A coating is not magnetic. The core, of volume V, has
the magnetisation M = Br/mu0 + chi H, where chi is the recoil permeability minus 1. H is the demagnetising
field -N M, with the demagnetising factor N, plus the field of the neighbours. The mean field of the
neighbours in a triangular lattice of dipoles with spacing a is -S m/(4 pi a^3), where S = 11.0342 is the
lattice sum of r^-3. The moment is then

    m = (Br V/mu0) / (1 + chi (N + S V/(4 pi a^3))).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from granular.shared.errors import InputError, quote

# Lowest and highest remanence [T] at 20 degrees Celsius.
_REMANENCE = {
    "N35": (1.17, 1.22),
    "N38": (1.22, 1.25),
    "N40": (1.25, 1.28),
    "N42": (1.28, 1.32),
    "N45": (1.32, 1.37),
    "N48": (1.37, 1.42),
    "N50": (1.39, 1.44),
    "N52": (1.42, 1.46),
}
# Maximum temperature [deg C] by the letter after the number, for magnets 0.7 times as thick as wide: flatter
# magnets lose moment permanently at lower temperatures.
_HIGHEST = {"": 80.0, "M": 100.0}
REMANENCE_SLOPE = -1.2e-3
"""Relative change of the remanence with temperature [1/K], for all grades in the table."""
RECOIL_PERMEABILITY = 1.05
"""Relative recoil permeability of all grades in the table."""
REFERENCE_TEMPERATURE = 20.0
"""Temperature at which the remanence of a grade is given [deg C]."""


class Grade(NamedTuple):
    """A grade of magnets."""

    name: str
    lowest: float  # remanence [T]
    highest: float
    highest_temperature: float  # [deg C]

    @property
    def remanence(self) -> float:
        """Remanence in the middle of the grade's range [T]."""
        return 0.5 * (self.lowest + self.highest)


GRADES = {
    number + letter: Grade(number + letter, *remanence, hottest)
    for letter, hottest in _HIGHEST.items()
    for number, remanence in _REMANENCE.items()
}


def find_grade(name: str) -> Grade:
    """Return the magnet grade of the given name."""
    if name not in GRADES:
        raise InputError(
            f"unknown grade {quote(name)}; use one of {', '.join(GRADES)}, or give the remanence"
        )
    return GRADES[name]


MAGNETIC_CONSTANT = 4e-7 * math.pi
"""Permeability of free space [H/m], the value of [D, Table 4.3]."""
LATTICE_SUM = 11.034175
"""Sum of r^-3 over the triangular lattice of spacing 1 (Topping 1927, doi:10.1098/rspa.1927.0025)."""


class Magnet(NamedTuple):
    """A magnetic disc: size, remanence and the data that reduce its moment."""

    diameter: float  # of the core [m]
    thickness: float
    remanence: float  # at its temperature [T]
    demagnetisation: float  # chi N
    neighbours: float  # chi S V/(4 pi a^3)

    @property
    def volume(self) -> float:
        """Volume of the core [m^3]."""
        return math.pi * self.thickness * self.diameter**2 / 4.0

    @property
    def moment(self) -> float:
        """Moment of the disc in the mean field of its neighbours [A m^2]."""
        weakening = 1.0 + self.demagnetisation + self.neighbours
        return self.remanence * self.volume / MAGNETIC_CONSTANT / weakening


def make_magnet(
    diameter: float,
    thickness: float,
    remanence: float,
    *,
    coating: float = 0.0,
    permeability: float = 1.0,
    spacing: float = math.inf,
    temperature: float = REFERENCE_TEMPERATURE,
) -> Magnet:
    """Return the magnet inside a coated disc; lengths in m, remanence at 20 deg C in T, temperature in C."""
    diameter, thickness, chi = diameter - 2.0 * coating, thickness - 2.0 * coating, permeability - 1.0
    remanence *= 1.0 + REMANENCE_SLOPE * (temperature - REFERENCE_TEMPERATURE)
    magnet = Magnet(diameter, thickness, remanence, 0.0, 0.0)
    if chi == 0.0:  # importing elliptic integrals takes long
        return magnet
    neighbours = LATTICE_SUM * magnet.volume / (4.0 * math.pi * spacing**3)
    factor = demagnetising_factor(diameter, thickness)
    return magnet._replace(demagnetisation=chi * factor, neighbours=chi * neighbours)


def remanence_of_moment(moment: float, magnet: Magnet) -> float:
    """Remanence [T] at which a lone disc has the given moment [A m^2], both at 20 deg C."""
    return moment * MAGNETIC_CONSTANT / magnet.volume * (1.0 + magnet.demagnetisation)


def demagnetising_factor(diameter: float, height: float) -> float:
    """Demagnetising factor of a cylinder along its axis, averaged over its volume."""
    # The mean field of a uniformly magnetised cylinder equals the mean field of a solenoid of its shape,
    # mu0 M times Nagaoka's coefficient (Joseph 1966, doi:10.1063/1.1703091).
    from scipy.special import ellipe, ellipk

    square = diameter**2 / (diameter**2 + height**2)
    rest, k = 1.0 - square, math.sqrt(square)
    first, second = float(ellipk(square)), float(ellipe(square))
    nagaoka = 4.0 / (3.0 * math.pi * math.sqrt(rest)) * (rest / square * (first - second) + second - k)
    return 1.0 - nagaoka
