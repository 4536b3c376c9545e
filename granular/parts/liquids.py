"""Liquids by name: viscosity and density over temperature."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import NamedTuple

from granular.shared.errors import InputError
from granular.shared.message_text import quote

KNOWN = "'silicone oil 350 cSt' (100 to 100000), 'glycerol 80 %' (by mass), 'water' or 'air'"
_KELVIN = 273.15
_NUMBER = r"([0-9]{1,6}(?:\.[0-9]{0,6})?)"


class Liquid(NamedTuple):
    """A liquid at a temperature."""

    viscosity: float  # [Pa s]
    density: float  # [kg/m^3]
    uncertainty: float  # relative, of the viscosity of what is bought under this name


def find_liquid(name: str, celsius: float) -> Liquid:
    """Return the liquid of that name at a temperature [deg C]."""
    for pattern, (low, high), least, most, make in _LIQUIDS:
        match = re.fullmatch(pattern, name)
        if match is None:
            continue
        number = float(match[1]) if match.groups() else 0.0
        if not least <= number <= most:
            raise InputError(
                f"{quote(name)} must have a number from {least:g} to {most:g}, or give the viscosity"
            )
        if not low <= celsius <= high:
            raise InputError(
                f"{quote(name)} at {celsius:g} °C: its viscosity is known from {low:g} to {high:g} °C; "
                "give the viscosity"
            )
        return make(number, celsius)
    raise InputError(f"unknown liquid {quote(name)}; take {KNOWN}, or give the viscosity")


def silicone_oil_viscosity_ratio(celsius: float) -> float:
    """Kinematic viscosity of a silicone oil over that at 25 degrees Celsius; celsius [deg C]."""
    # log nu = 763.1/(273 + T) - 2.559 + log nu_25 from 100 mm^2/s on (Shin-Etsu, Silicone Fluid KF-96,
    # Performance Test Results); its 2.559 is 763.1/298.15.
    return float(10.0 ** (763.1 * (1.0 / (celsius + _KELVIN) - 1.0 / (25.0 + _KELVIN))))


def _silicone_oil(number: float, celsius: float) -> Liquid:
    # Specific gravity 0.965 to 0.975 at 25 degrees, expansion 0.00095/K, viscosity within 5 % (KF-96).
    density = 970.0 / (1.0 + 9.5e-4 * (celsius - 25.0))
    return Liquid(1e-6 * number * silicone_oil_viscosity_ratio(celsius) * density, density, 0.05)


def _glycerol_and_water(percent: float, celsius: float) -> Liquid:
    """Mixture by mass (Cheng 2008, doi:10.1021/ie071349z)."""
    t, c = celsius, percent / 100.0
    water = 1.790e-3 * math.exp((-1230.0 - t) * t / (36100.0 + 360.0 * t))
    glycerol = 12.100 * math.exp((-1233.0 + t) * t / (9900.0 + 70.0 * t))
    a = 0.705 - 0.0017 * t
    b = (4.9 + 0.036 * t) * a**2.5
    alpha = 1.0 - c + a * b * c * (1.0 - c) / (a * c + b * (1.0 - c))
    density = c * (1277.0 - 0.654 * t) + (1.0 - c) * _water_density(t)
    return Liquid(water**alpha * glycerol ** (1.0 - alpha), density, 0.05)


def _water(_: float, celsius: float) -> Liquid:
    """Water at 1 bar (Pátek and others 2009, doi:10.1063/1.3043575)."""
    ratio = (celsius + _KELVIN) / 300.0
    terms = ((280.68, 1.9), (511.45, 7.7), (61.131, 19.6), (0.45903, 40.0))
    viscosity = 1e-6 * sum(factor * ratio**-power for factor, power in terms)
    return Liquid(viscosity, _water_density(celsius), 0.01)


def _water_density(celsius: float) -> float:
    return 1000.0 * (1.0 - abs((celsius - 4.0) / 622.0) ** 1.7)  # Cheng 2008


def _air(_: float, celsius: float) -> Liquid:
    """Dry air at 1 atm, by Sutherland's formula (White 2006, Viscous Fluid Flow, table 1-2)."""
    kelvin = celsius + _KELVIN
    viscosity = 1.716e-5 * (kelvin / 273.0) ** 1.5 * (273.0 + 111.0) / (kelvin + 111.0)
    return Liquid(viscosity, 101325.0 / (287.05 * kelvin), 0.02)


# Pattern, lowest and highest temperature [deg C], bounds of the number.
_LIQUIDS: tuple[tuple[str, tuple[float, float], float, float, Callable[[float, float], Liquid]], ...] = (
    (rf"silicone oil {_NUMBER} ?(?:cSt|mm\^?2/s)", (-25.0, 250.0), 100.0, 1e5, _silicone_oil),
    (rf"glycerol {_NUMBER} ?%", (0.0, 100.0), 0.0, 100.0, _glycerol_and_water),
    (r"water", (0.0, 100.0), 0.0, 0.0, _water),
    (r"air", (-50.0, 250.0), 0.0, 0.0, _air),
)
