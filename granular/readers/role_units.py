"""Units of the columns that have a meaning: what they are converted to, and how large a unit is."""

from __future__ import annotations

from granular.readers.column_headers import (
    ACCELERATION,
    BASE_ACCELERATION,
    BASE_HEIGHT,
    FORCE,
    HEIGHT,
    TIME,
    VELOCITY,
)
from granular.schema.units import Dimension, unit_size

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

_ANGULAR = {
    HEIGHT: "rad",
    VELOCITY: "rad/s",
    ACCELERATION: "rad/s^2",
    BASE_HEIGHT: "rad",
    BASE_ACCELERATION: "rad/s^2",
}
ANGLE_UNITS = ("deg", "rad", "mrad")

_SPECIAL = {
    **dict.fromkeys(((ACCELERATION, "g"), (BASE_ACCELERATION, "g")), "9.80665 m/s^2"),
    **dict.fromkeys(((ACCELERATION, "mg"), (BASE_ACCELERATION, "mg")), "9.80665e-3 m/s^2"),
    (FORCE, "lb"): "4.4482216152605 N",
    (FORCE, "kg"): "9.80665 N",
    (FORCE, "g"): "9.80665e-3 N",
}
"""Units that mean another thing in a role: the acceleration of gravity, and forces as masses."""


def si_unit_of_role(role: str, *, angle: bool = False) -> str:
    """SI unit that a role's column is converted to."""
    return _ANGULAR.get(role, SI.get(role, "")) if angle else SI.get(role, "")


def role_unit_size(role: str, unit: str) -> tuple[float, Dimension]:
    """SI size and dimension of a unit in a role's column."""
    special = _SPECIAL.get((role, unit))
    if special is None:
        return unit_size(unit)
    number, plain = special.split(" ", 1)
    return float(number), unit_size(plain)[1]
