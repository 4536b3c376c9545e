"""Quantities with units: ``"5.63 mm/s"`` becomes 0.00563 after a check of the dimension.

Numbers without a unit are in SI. The unit ``D`` is the diameter of the scene's first species.
"""

from __future__ import annotations

import math
import re
from decimal import Decimal

from granular.shared.errors import SceneError, quote, sanitize

Dimension = tuple[int, int, int, int]  # powers of metre, kilogram, second, ampere

_NONE: Dimension = (0, 0, 0, 0)
_BASE: dict[str, tuple[float, Dimension]] = {
    "m": (1.0, (1, 0, 0, 0)),
    "g": (1e-3, (0, 1, 0, 0)),
    "s": (1.0, (0, 0, 1, 0)),
    "A": (1.0, (0, 0, 0, 1)),
    "N": (1.0, (1, 1, -2, 0)),
    "J": (1.0, (2, 1, -2, 0)),
    "W": (1.0, (2, 1, -3, 0)),
    "T": (1.0, (0, 1, -2, -1)),
    "Pa": (1.0, (-1, 1, -2, 0)),
    "Hz": (1.0, (0, 0, -1, 0)),
    "S": (1.0, (-2, -1, 3, 2)),
    "V": (1.0, (2, 1, -3, -1)),
}
_PREFIX = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6, "G": 1e9}
_PLAIN: dict[str, tuple[float, Dimension]] = {
    "1": (1.0, _NONE),
    "10": (10.0, _NONE),  # with a power, as in 10^-3 m
    "%": (0.01, _NONE),
    "rad": (1.0, _NONE),
    "deg": (math.pi / 180.0, _NONE),
    "in": (0.0254, (1, 0, 0, 0)),
    "ft": (0.3048, (1, 0, 0, 0)),
    "lbf": (4.4482216152605, (1, 1, -2, 0)),  # 0.45359237 kg times 9.80665 m/s^2
    "kgf": (9.80665, (1, 1, -2, 0)),
    "lb": (0.45359237, (0, 1, 0, 0)),
    "kip": (4448.2216152605, (1, 1, -2, 0)),
    "psi": (6894.757293168361, (-1, 1, -2, 0)),  # lbf divided by the square of 0.0254 m
    "mil": (2.54e-5, (1, 0, 0, 0)),
    "mrad": (1e-3, _NONE),
    "min": (60.0, (0, 0, 1, 0)),
    "h": (3600.0, (0, 0, 1, 0)),
    "d": (86400.0, (0, 0, 1, 0)),
}
_QUANTITY = re.compile(r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)\s*(.*?)\s*")
_MAXIMUM_POWER = 9
_MINIMUM_SIZE, _MAXIMUM_SIZE = 1e-100, 1e100  # of a unit; far from overflow, and beyond every use
_FACTOR = re.compile(r"([A-Za-zµ%]+|10(?=\^|\*\*)|1)(?:(?:\^|\*\*)?(-?[0-9]+))?")


def _size_and_dimension_of_unit_symbol(name: str, diameter: float | None) -> tuple[float, Dimension]:
    if name == "D":
        if diameter is None:
            raise SceneError(
                "the unit D (diameter of a grain) is not defined here; give the length in metres"
            )
        return diameter, (1, 0, 0, 0)
    if (known := _PLAIN.get(name) or _BASE.get(name)) is not None:
        return known
    if len(name) > 1 and name[0] in _PREFIX and name[1:] in _BASE:
        size, dimension = _BASE[name[1:]]
        return _PREFIX[name[0]] * size, dimension
    raise SceneError(
        f"unknown unit {quote(name)}; use m, mm, kg, s, N, T, Pa, Hz, deg, D or products of these"
    )


def unit_size(unit: str, diameter: float | None = None) -> tuple[float, Dimension]:
    """Return the size in SI and the dimension of a unit such as ``"mm/s"`` or ``"kg m^2"``.

    Parameters
    ----------
    unit : str
        Unit as text.
    diameter : float, optional
        Value of the unit D [m].

    Returns
    -------
    tuple of float and Dimension
        Size in SI, and exponents of the base units.

    Raises
    ------
    SceneError
        If the unit is unknown or cannot be read.

    Examples
    --------
    >>> from granular.schema import unit_size
    >>> unit_size("mm")[0]
    0.001
    """
    size, total = 1.0, [0, 0, 0, 0]
    for position, text in enumerate(unit.replace("·", " ").split("/")):
        part = text.strip()
        if position and part.startswith("(") and part.endswith(")"):  # as in 1/(m s)
            part = part[1:-1].strip()
        for factor in re.split(r"\s+|(?<!\*)\*(?!\*)", part):
            match = _FACTOR.fullmatch(factor)
            if match is None:
                raise SceneError(f"the unit {quote(unit)} cannot be read; write for instance 'mm/s'")
            base, dimension = _size_and_dimension_of_unit_symbol(match[1], diameter)
            power = _exponent_of_unit(match[2], unit) * (-1 if position else 1)
            size *= base**power
            total = [have + power * more for have, more in zip(total, dimension, strict=True)]
    if not _MINIMUM_SIZE <= size <= _MAXIMUM_SIZE:
        raise SceneError(
            f"the unit {quote(unit)} is {size:.1e} SI units, but only {_MINIMUM_SIZE:g} to "
            f"{_MAXIMUM_SIZE:g} are allowed; write a smaller power"
        )
    return size, (total[0], total[1], total[2], total[3])


def _exponent_of_unit(digits: str | None, unit: str) -> int:
    if digits is None:
        return 1
    # The length is checked first: int rejects numbers of thousands of digits.
    if len(digits.lstrip("-")) > 2 or abs(int(digits)) > _MAXIMUM_POWER:
        raise SceneError(f"a power in the unit {quote(unit)} exceeds {_MAXIMUM_POWER}; write a smaller power")
    return int(digits)


def si_value(text: str, unit: str, diameter: float | None = None) -> float:
    """Return the SI value of a quantity written as text.

    Parameters
    ----------
    text : str
        Number with or without a unit: ``"5 mm"``, ``"20 D"``, ``"1e-3"``.
    unit : str
        Required SI unit; the dimension is checked.
    diameter : float, optional
        Value of the unit D [m].

    Returns
    -------
    float
        Value in the SI unit.

    Raises
    ------
    SceneError
        If the text is not a quantity, or has another dimension than ``unit``.

    Examples
    --------
    >>> from granular.schema import si_value
    >>> si_value("8.33 mm/s", "m/s"), si_value("20 D", "m", diameter=0.006)
    (0.00833, 0.12)
    """
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise SceneError(f"{quote(text)} is not a quantity; write a number and a unit, such as '5 mm'")
    number, written = float(match[1]), match[2]
    if not written:
        return number
    size, dimension = unit_size(written, diameter)
    if dimension != unit_size(unit)[1]:
        right = "a pure number or a fraction in %" if unit == "1" else f"a quantity in {unit}"
        raise SceneError(f"{quote(text)} has the unit {sanitize(written)}; {right} is wanted")
    if not 0.0 < abs(number) < math.inf:
        return number
    # In decimal arithmetic "0.2 D" of 6 mm is 0.0012 m, not 0.0012000000000000001 m.
    return float(Decimal(match[1]) * Decimal(repr(size)))
