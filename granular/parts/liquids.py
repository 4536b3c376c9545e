"""Viscosity and density of liquids as functions of temperature, and drag in thin liquid films.

The drag is computed for discs, and for the blade and the guide of the piston. The shear rate in a thin film
is uniform, so a face of area A at distance h from a fixed wall has the drag coefficient eta A/h, with the
viscosity eta. All formulas hold for slow motion, with rho v h^2/(eta l) << 1 at the density rho and the speed
v, and for films much thinner than their width l.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import NamedTuple

from granular.shared.errors import InputError, quote

KNOWN = "'silicone oil 350 cSt' (100 to 100000 cSt), 'glycerol 80 %' (by mass), 'water' or 'air'"
_KELVIN = 273.15
_NUMBER = r"([0-9]{1,6}(?:\.[0-9]{0,6})?)"


class Liquid(NamedTuple):
    """A liquid at a temperature."""

    viscosity: float  # [Pa s]
    density: float  # [kg/m^3]
    uncertainty: float  # relative uncertainty of the viscosity of commercial liquids of this name


def find_liquid(name: str, celsius: float) -> Liquid:
    """Return the named liquid at a temperature [deg C]."""
    for pattern, (low, high), smallest, largest, make in _LIQUIDS:
        match = re.fullmatch(pattern, name)
        if match is None:
            continue
        number = float(match[1]) if match.groups() else 0.0
        if not smallest <= number <= largest:
            raise InputError(
                f"the number in {quote(name)} is outside {smallest:g} to {largest:g}; change it, or give "
                "the viscosity"
            )
        if not low <= celsius <= high:
            raise InputError(
                f"the viscosity of {quote(name)} is known from {low:g} to {high:g} °C, "
                f"not at {celsius:g} °C; "
                "give the viscosity"
            )
        return make(number, celsius)
    raise InputError(f"unknown liquid {quote(name)}; use {KNOWN}, or give the viscosity")


def silicone_oil_viscosity_ratio(celsius: float) -> float:
    """Kinematic viscosity of silicone oil at a temperature [deg C], divided by the viscosity at 25 deg C."""
    # log nu = 763.1/(273 + T) - 2.559 + log nu_25 from 100 mm^2/s on (Shin-Etsu, Silicone Fluid KF-96,
    # Performance Test Results); its 2.559 is 763.1/298.15.
    return float(10.0 ** (763.1 * (1.0 / (celsius + _KELVIN) - 1.0 / (25.0 + _KELVIN))))


def _silicone_oil_at_temperature(number: float, celsius: float) -> Liquid:
    # Specific gravity 0.965 to 0.975 at 25 degrees, expansion 0.00095/K, viscosity within 5 % (KF-96).
    density = 970.0 / (1.0 + 9.5e-4 * (celsius - 25.0))
    return Liquid(1e-6 * number * silicone_oil_viscosity_ratio(celsius) * density, density, 0.05)


def _glycerol_and_water(percent: float, celsius: float) -> Liquid:
    """Mixture of glycerol and water; ``percent`` is glycerol by mass (Cheng 2008, doi:10.1021/ie071349z)."""
    t, c = celsius, percent / 100.0
    water = 1.790e-3 * math.exp((-1230.0 - t) * t / (36100.0 + 360.0 * t))
    glycerol = 12.100 * math.exp((-1233.0 + t) * t / (9900.0 + 70.0 * t))
    a = 0.705 - 0.0017 * t
    b = (4.9 + 0.036 * t) * a**2.5
    alpha = 1.0 - c + a * b * c * (1.0 - c) / (a * c + b * (1.0 - c))
    density = c * (1277.0 - 0.654 * t) + (1.0 - c) * _water_density(t)
    return Liquid(water**alpha * glycerol ** (1.0 - alpha), density, 0.05)


def _water_at_temperature(_: float, celsius: float) -> Liquid:
    """Water at 1 bar (Pátek and others 2009, doi:10.1063/1.3043575)."""
    ratio = (celsius + _KELVIN) / 300.0
    terms = ((280.68, 1.9), (511.45, 7.7), (61.131, 19.6), (0.45903, 40.0))
    viscosity = 1e-6 * sum(factor * ratio**-power for factor, power in terms)
    return Liquid(viscosity, _water_density(celsius), 0.01)


def _water_density(celsius: float) -> float:
    return 1000.0 * (1.0 - abs((celsius - 4.0) / 622.0) ** 1.7)  # Cheng 2008


def _air_at_temperature(_: float, celsius: float) -> Liquid:
    """Dry air at 1 atm, by Sutherland's formula (White 2006, Viscous Fluid Flow, table 1-2)."""
    kelvin = celsius + _KELVIN
    viscosity = 1.716e-5 * (kelvin / 273.0) ** 1.5 * (273.0 + 111.0) / (kelvin + 111.0)
    return Liquid(viscosity, 101325.0 / (287.05 * kelvin), 0.02)


# Pattern, lowest and highest temperature [deg C], bounds of the number.
_LIQUIDS: tuple[tuple[str, tuple[float, float], float, float, Callable[[float, float], Liquid]], ...] = (
    (rf"silicone oil {_NUMBER} ?(?:cSt|mm\^?2/s)", (-25.0, 250.0), 100.0, 1e5, _silicone_oil_at_temperature),
    (rf"glycerol {_NUMBER} ?%", (0.0, 100.0), 0.0, 100.0, _glycerol_and_water),
    (r"water", (0.0, 100.0), 0.0, 0.0, _water_at_temperature),
    (r"air", (-50.0, 250.0), 0.0, 0.0, _air_at_temperature),
)


def disc_drag_coefficient(viscosity: float, area: float, films: tuple[float, float]) -> float:
    """Drag coefficient [kg/s] of a disc between plates; viscosity in Pa s, face area in m^2, films in m."""
    return viscosity * area * (1.0 / films[0] + 1.0 / films[1])


def counter_flow_factor(packing: float, thickness: float, films: tuple[float, float]) -> float:
    """Factor by which counter-flow increases the drag of discs that move together; lengths in m.

    Discs with the area fraction ``packing`` and thickness h move at speed v between plates at a distance E.
    They drag along a volume of liquid equal to half the volume of the films. To replace the discs and this
    liquid, liquid flows back between the discs at u = v packing (E + h)/(2 (1 - packing) E). This flow
    dissipates 12 eta u^2/E^2 per unit volume.
    """
    gap = thickness + films[0] + films[1]
    back = 3.0 * packing / (1.0 - packing) * (gap + thickness) ** 2 / gap**3
    return 1.0 + back / (1.0 / films[0] + 1.0 / films[1])


def blade_drag_coefficient(viscosity: float, width: float, depth: float, film: float) -> float:
    """Drag coefficient of an immersed blade with a liquid film on each face [kg/s]; lengths in m."""
    return 2.0 * viscosity * width * depth / film


def blade_displacement_drag_coefficient(
    viscosity: float, width: float, depth: float, thickness: float, film: float
) -> float:
    """Drag coefficient of a blade if all displaced liquid flows through the films [kg/s]; lengths in m."""
    # The flow width*thickness*v through two films needs the gradient 12 eta (thickness v/(2 film))/film^2.
    return 6.0 * viscosity * width * depth * thickness**2 / film**3


def guide_drag_coefficient(
    viscosity: float, diameter: float, length: float, clearance: float, eccentricity: float = 0.0
) -> float:
    """Drag coefficient [kg/s] of a rod in a bush; lengths in m, eccentricity relative to the clearance."""
    # Shear between two parallel cylinders with axes e apart has the same resistance per length as two
    # such conductors: 2 pi eta/arcosh((r1^2 + r2^2 - e^2)/(2 r1 r2)).
    inner, outer = 0.5 * diameter, 0.5 * diameter + clearance
    x = clearance**2 * (1.0 - eccentricity**2) / (2.0 * inner * outer)
    return 2.0 * math.pi * viscosity * length / math.log1p(x + math.sqrt(x * (2.0 + x)))


GLASS_MODULUS, GLASS_RATIO = 70e9, 0.22
"""Young's modulus [Pa] and Poisson's ratio of float glass (EN 572-1: 70 GPa, 0.2 to 0.23)."""


class Bow(NamedTuple):
    """Deflection [m] of the middle of a plate in two limiting cases: clamped or simply supported edges."""

    clamped: float
    supported: float


def bow_of_plate(load: float, width: float, height: float, thickness: float) -> Bow:
    """Return the deflection of a glass plate under a uniformly distributed load [N]; lengths in m."""
    # Timoshenko and Woinowsky-Krieger 1959, sections 1 and 2: q b^4/(384 D) and 5 q b^4/(384 D) for a strip.
    stiffness = GLASS_MODULUS * thickness**3 / (12.0 * (1.0 - GLASS_RATIO**2))
    clamped = load / (width * height) * width**4 / (384.0 * stiffness)
    return Bow(clamped, 5.0 * clamped)
