"""Calibration of a sensor: from the number in a column to a height, height = scale (raw - zero).

A scale is written with both units, ``2.4894 mm/V`` or ``360 deg/2048 counts``, and the zero in the
unit of the column, ``2.513 V``. An uncertainty may stand behind a number, ``2.4894 +- 0.003 mm/V``.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from granular.readers.headers import normalize_unit
from granular.schema.units import unit_size
from granular.shared.errors import RecordError, SceneError
from granular.shared.messages import quote

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_SCALE = re.compile(
    rf"\s*({_NUMBER})\s*(?:(?:\+-|±|\+/-)\s*({_NUMBER}))?\s*([^/\s\d]\S*?)\s*/\s*"
    rf"({_NUMBER})?\s*(\S+)\s*"
)
_ZERO = re.compile(rf"\s*({_NUMBER})\s*(\S+)?\s*")
_LONGEST = 100
"""Characters of a calibration."""


class Scale(NamedTuple):
    """A sensor's scale.

    Attributes
    ----------
    factor : float
        Metres, or radians, over the unit of the column.
    uncertainty : float
        Standard uncertainty of the factor over the factor; 0 where none is given.
    angle : bool
        Whether the coordinate is an angle.
    unit : str
        Unit of the column, such as ``V`` or ``counts``.
    """

    factor: float
    uncertainty: float
    angle: bool
    unit: str


def parse_scale(text: str) -> Scale:
    """Parse a scale such as ``2.4894 mm/V``, ``2.4894 +- 0.003 mm/V`` or ``360 deg/2048 counts``.

    Parameters
    ----------
    text : str
        Number, unit of the height or angle, and unit of the column.

    Returns
    -------
    Scale
        In metres or radians over the unit of the column.

    Raises
    ------
    RecordError
        If it is no such text, or its first unit is neither a length nor an angle.
    """
    match = _SCALE.fullmatch(text) if len(text) <= _LONGEST else None
    if match is None:
        raise RecordError(
            f"scale = {quote(text)}; write a number, the unit of the height and that of the "
            "column, such as '2.4894 mm/V' or '360 deg/2048 counts'"
        )
    value, spread = float(match[1]), float(match[2] or 0.0)
    steps = float(match[4] or 1.0)
    unit = normalize_unit(match[3])
    try:
        size, dimension = unit_size(unit)
    except SceneError as error:
        raise RecordError(f"scale = {quote(text)}: {error}") from None
    angle = unit in ("deg", "rad", "mrad")
    if not angle and dimension != unit_size("m")[1]:
        raise RecordError(
            f"scale = {quote(text)}: {quote(match[3])} is neither a length nor an angle; write "
            "such as 'mm/V' or 'deg/counts'"
        )
    if value == 0.0 or steps == 0.0:
        raise RecordError(f"scale = {quote(text)} is 0 or infinite; give another number")
    return Scale(value * size / steps, abs(spread / value), angle, normalize_unit(match[5]))


def calibrate_column(
    values: np.ndarray, unit: str | None, scale: Scale, zero: str | None
) -> np.ndarray:
    """Return the heights or angles of a column's numbers.

    Parameters
    ----------
    values : float64 (n,)
        Numbers of the column.
    unit : str or None
        Unit of the column, where its heading names one.
    scale : Scale
        Scale of the sensor.
    zero : str, optional
        Number of the column at the height 0, with its unit; 0 without.

    Returns
    -------
    float64 (n,)
        Heights [m], or angles [rad].

    Raises
    ------
    RecordError
        If the units of heading, scale and zero contradict each other.
    """
    ratio = 1.0 if unit is None else _ratio(unit, scale.unit, "heading")
    level = 0.0
    if zero is not None:
        match = _ZERO.fullmatch(zero) if len(zero) <= _LONGEST else None
        if match is None:
            raise RecordError(f"zero = {quote(zero)}; write a number and a unit, such as '2.513 V'")
        own = unit or scale.unit if match[2] is None else normalize_unit(match[2])
        level = float(match[1]) * _ratio(own, scale.unit, "zero")
    return scale.factor * (values * ratio - level)


def _ratio(unit: str, wanted: str, what: str) -> float:
    """Size of a unit over that of the scale's column."""
    if _singular(unit) == _singular(wanted):
        return 1.0
    try:
        (size, dimension), (other, expected) = unit_size(unit), unit_size(wanted)
    except SceneError:
        dimension, expected, size, other = (1, 0, 0, 0), (0, 0, 0, 0), 1.0, 1.0
    if dimension != expected or unit in ("1", "%") or wanted in ("1", "%"):
        raise RecordError(
            f"the {what} is in {quote(unit)}, and the scale is over {quote(wanted)}; write both in "
            "the unit of the column"
        )
    return size / other


def _singular(unit: str) -> str:
    return unit.lower().removesuffix("s") if len(unit) > 2 else unit
