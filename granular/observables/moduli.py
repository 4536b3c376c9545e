"""Elastic moduli in two dimensions, and those of the hexagonal crystal of dipoles at rest."""

from __future__ import annotations

import math
from typing import NamedTuple

from granular.shared.errors import InputError

BULK_OF_PRESSURE = 5.0 / 2.0
"""Of grains that repel with r^-3 as energy, p ~ rho^2.5, and B = rho dp/drho."""

SHEAR_OF_PRESSURE = 1.0 / 4.0
"""Of an isotropic arrangement of them that shears affinely."""


class Moduli(NamedTuple):
    """Pressure and moduli of a layer.

    The bulk modulus is rho dp/drho, and the shear modulus that of a shear at constant area under
    this pressure.

    Attributes
    ----------
    pressure, bulk, shear : float
        [N/m]
    """

    pressure: float
    bulk: float
    shear: float

    @property
    def young(self) -> float:
        """Young's modulus in two dimensions, 4 B mu/(B + mu) [N/m]."""
        return 4.0 * self.bulk * self.shear / (self.bulk + self.shear)


def hexagonal_sum() -> float:
    """Sum of r^-3 over the hexagonal lattice of spacing 1, 11.0342.

    A lattice sum of Dirichlet series, 6 zeta(3/2) L(3/2), with L of the character mod 3 (Borwein et
    al., Lattice Sums Then and Now, 2013, 1.4).
    """
    from scipy.special import zeta

    beyond = (zeta(1.5, 1.0 / 3.0) - zeta(1.5, 2.0 / 3.0)) / 3.0**1.5
    return float(6.0 * zeta(1.5) * beyond)


def dipole_strength(moment: float) -> float:
    """C of the energy C/r^3 of two dipoles at a right angle to their plane, mu0 m^2/(4 pi) [J m^3].

    Parameters
    ----------
    moment : float
        Magnetic moment of each [A m^2].
    """
    from granular.scene.scales import MAGNETIC_CONSTANT

    return MAGNETIC_CONSTANT * moment**2 / (4.0 * math.pi)


def crystal_moduli(density: float, strength: float) -> Moduli:
    """Pressure and moduli of the hexagonal crystal of dipoles at rest, by its lattice sum.

    With S = `hexagonal_sum` and the spacing a, a^2 = 2/(sqrt(3) rho),

        p = (3/4) rho C S/a^3,   B = (5/2) p,   mu = p/4,

    so that p ~ rho^2.5. In units of C (pi rho)^(3/2)/a^2 these moduli are 3.457 and 0.3457, and
    Young's modulus is 1.257: multiplied by Gamma they are the limit of the crystals of Zahn et al.,
    Phys. Rev. Lett. 90, 155506 (2003), and von Gruenberg et al., ibid. 93, 255703 (2004), at low
    temperature.

    Parameters
    ----------
    density : float
        Grains an area [1/m^2].
    strength : float
        C of the energy C/r^3 of a pair [J m^3]; see `dipole_strength`.

    Raises
    ------
    InputError
        If one of them is not above 0.
    """
    _check_above("density", density)
    _check_above("strength", strength)
    pressure = 0.75 * density * strength * hexagonal_sum() / lattice_spacing(density) ** 3
    return Moduli(pressure, BULK_OF_PRESSURE * pressure, SHEAR_OF_PRESSURE * pressure)


def lattice_spacing(density: float) -> float:
    """Spacing of the hexagonal lattice of a density [1/m^2], [m]."""
    _check_above("density", density)
    return math.sqrt(2.0 / (math.sqrt(3.0) * density))


def interaction_parameter(density: float, strength: float, temperature: float) -> float:
    """Gamma = C (pi rho)^(3/2)/T, the energy of neighbours over the temperature.

    Parameters
    ----------
    density, strength : float
        As of `crystal_moduli`.
    temperature : float
        k_B T [J].

    Raises
    ------
    InputError
        If one of them is not above 0.
    """
    _check_above("density", density)
    _check_above("strength", strength)
    _check_above("temperature", temperature)
    return strength * (math.pi * density) ** 1.5 / temperature


def theory_modulus(moduli: Moduli, density: float, temperature: float) -> float:
    """K = Y a^2/T of the theory of melting; where it has fallen to 16 pi dislocations unbind.

    (Nelson and Halperin, Phys. Rev. B 19, 2457, 1979.)

    Parameters
    ----------
    moduli : Moduli
    density : float
        [1/m^2]
    temperature : float
        k_B T [J].

    Raises
    ------
    InputError
        If density or temperature is not above 0.
    """
    _check_above("temperature", temperature)
    return moduli.young * lattice_spacing(density) ** 2 / temperature


def _check_above(name: str, value: float) -> None:
    if not 0.0 < value < math.inf:
        raise InputError(f"{name} {value:g} is not above 0; give a positive number")
