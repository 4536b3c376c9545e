"""Units of the columns that have a meaning: what they are converted to, and how large a unit is."""

from __future__ import annotations

import re
from typing import Literal

from granular.readers.column_headers import (
    ACCELERATION,
    BASE_ACCELERATION,
    BASE_HEIGHT,
    FORCE,
    HEIGHT,
    TIME,
    VELOCITY,
    normalize_unit,
)
from granular.schema.units import Dimension, unit_size
from granular.shared.errors import RecordError, SceneError
from granular.shared.message_text import quote, sanitize

SI = {
    TIME: "s",
    HEIGHT: "m",
    VELOCITY: "m/s",
    FORCE: "N",
    ACCELERATION: "m/s^2",
    BASE_HEIGHT: "m",
    BASE_ACCELERATION: "m/s^2",
}
"""Units by roles, where the coordinate is a height."""

_LEVEL = re.compile(r"dB(\W.*|[a-zA-Zµ]{0,3})")
CoordinateUnit = Literal["m", "rad"]
COORDINATES: dict[CoordinateUnit, str] = {"m": "height", "rad": "angle"}
"""Names of the coordinate by its unit in SI."""
ANGLE_UNITS = ("deg", "rad", "mrad")

_SPECIAL = {
    **dict.fromkeys(((ACCELERATION, "g"), (BASE_ACCELERATION, "g")), "9.80665 m/s^2"),
    **dict.fromkeys(((ACCELERATION, "mg"), (BASE_ACCELERATION, "mg")), "9.80665e-3 m/s^2"),
    (FORCE, "lb"): "4.4482216152605 N",
    (FORCE, "kg"): "9.80665 N",
    (FORCE, "g"): "9.80665e-3 N",
}
"""Units that mean another thing in a role: the acceleration of gravity, and forces as masses."""


_EXAMPLES = {HEIGHT: "mm", BASE_HEIGHT: "mm"}
"""Units to name in a remedy, where they are others than those of SI."""


def example_unit(role: str) -> str:
    """Return a unit to name in a remedy for a role's column."""
    return _EXAMPLES.get(role, SI.get(role, "V"))


def is_level(unit: str) -> bool:
    """Tell a logarithmic unit, as dB and dBm."""
    return _LEVEL.fullmatch(unit) is not None


def si_unit_of_role(role: str, coordinate_unit: CoordinateUnit = "m") -> str:
    """SI unit that a role's column is converted to."""
    return SI.get(role, "").replace("m", coordinate_unit)


def role_unit_size(role: str, unit: str) -> tuple[float, Dimension]:
    """SI size and dimension of a unit in a role's column."""
    special = _SPECIAL.get((role, unit))
    if special is None:
        return unit_size(unit)
    number, plain = special.split(" ", 1)
    return float(number), unit_size(plain)[1]


def size_of_quantity(role: str, text: str) -> float:
    """SI size of the unit that a quantity of pint or astropy carries, in a role or a further column."""
    unit = normalize_unit(text)
    try:
        size, dimension = role_unit_size(role, unit)
    except SceneError as error:
        raise RecordError(f"{sanitize(role)}: {error}; convert the quantity") from None
    wanted = [unit_size(si_unit_of_role(role, unit))[1] for unit in COORDINATES if role in SI]
    if wanted and dimension not in wanted:
        raise RecordError(
            f"{role}: the unit {quote(text)} does not fit; one of {SI[role]} is wanted: convert the quantity"
        )
    return size
