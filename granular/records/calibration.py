"""Calibration of a sensor: height = scale (raw - zero); ``raw`` is the number in the sensor's column.

A scale is written with the units of height and column, ``2.4894 mm/V`` or ``360 deg/2048 counts``. The zero
is written in the unit of the column, ``2.513 V``. A standard uncertainty may follow a number, as in
``2.4894 +- 0.003 mm/V`` or ``2.4894 +- 0.1 % mm/V``. Instead of scale and zero, the coefficients of a
polynomial may be given, or calibration points to which a polynomial is fitted.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from granular.records.headings import ANGLE_UNITS, HEIGHT, SI, normalize_unit, role_unit_size_and_dimension
from granular.schema.units import unit_size
from granular.shared.array_types import Float
from granular.shared.errors import RecordError, SceneError, quote, unknown_word_message

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_VALUE = rf"\s*({_NUMBER})\s*(?:(?:\+-|±|\+/-)\s*({_NUMBER})\s*(%(?=\s))?)?\s*"
_SCALE = re.compile(rf"{_VALUE}([^/\s\d]\S*?(?:/s(?:\^2|2|²)?)?)\s*/\s*({_NUMBER})?\s*([^\s/]+)\s*")
_ZERO = re.compile(rf"{_VALUE}(\S+)?\s*")
_POWER = re.compile(r"(.+)/(.*?)(\^\d)?")
_MAX_CHARACTERS = 100
"""Maximum length of a calibration's text."""
FORMS = {"scale": "zero", "coefficients": "", "points": "degree"}
"""Forms of a calibration, each with the one further key that it allows."""
KEYS = ("scale", "zero", "coefficients", "points", "degree")
"""All keys of a calibration."""
_MAX_DEGREE = 5
_MIN_DEGREES_OF_FREEDOM = 2
"""If the points outnumber the coefficients by this many or more, their scatter gives the uncertainty."""


class Calibration(NamedTuple):
    """Polynomial that converts the readings of a sensor to SI, with the uncertainty of its coefficients."""

    coefficients: Float[np.ndarray, "k"]  # of the powers 0, 1, ... [SI unit per power of the column's unit]
    deviations: Float[
        np.ndarray, "m k"
    ]  # independent deviations of the coefficients, one standard uncertainty each
    raw_unit: str | None  # unit of the column, such as V; None: not given
    unit: str  # SI unit of the result; m or rad for the height
    raw_range: tuple[float, float] = (-math.inf, math.inf)  # range of the calibration points

    def apply(
        self, raw: Float[np.ndarray, "n"], unit: str | None
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "m n"]]:
        """Convert readings (n,) to SI; also return the change (m, n) caused by each of m ``deviations``."""
        unit_missing = None in (unit, self.raw_unit)
        ratio = 1.0 if unit_missing else _unit_ratio_to_target(str(unit), str(self.raw_unit), "heading")
        powers = np.vander(raw * ratio, len(self.coefficients), increasing=True).T
        return self.coefficients @ powers, self.deviations @ powers


def parse_calibration(role: str, given: Mapping[str, Any]) -> Calibration:
    """Make a calibration from the keys that are given for the column of ``role``."""
    for key in given:
        if key not in KEYS:
            raise RecordError(unknown_word_message(str(key), KEYS, "key of a calibration"))
    forms = [key for key in FORMS if given.get(key) is not None]
    if not forms and "zero" in given:
        raise RecordError(
            f"zero of {quote(role)} is given without scale; give both, such as scale = '2.4894 mm/V'"
        )
    if len(forms) != 1:
        raise RecordError(
            f"the calibration of {quote(role)} has "
            f"{' and '.join(forms) or 'no scale, coefficients or points'}; give exactly one of scale (with "
            "an optional zero), coefficients or points"
        )
    for form, companion in FORMS.items():
        if companion in given and form not in forms:
            raise RecordError(
                f"{companion} belongs to {form} and cannot be combined with {forms[0]}; remove one of them"
            )
    if forms == ["scale"]:
        return _calibration_from_scale(role, given["scale"], given.get("zero"))
    if forms == ["coefficients"]:
        return _calibration_from_coefficients(role, given["coefficients"])
    return _calibration_from_points(role, given["points"], given.get("degree", 1))


# Scale and zero --------------------------------------------------------------------------------


def _calibration_from_scale(role: str, scale: Any, zero: Any) -> Calibration:
    match = _match_calibration_text(_SCALE, scale)
    if match is None:
        raise RecordError(
            f"scale = {quote(scale)} cannot be read; write a number, the unit of the height and the unit of "
            "the column, such as '2.4894 mm/V' or '360 deg/2048 counts'"
        )
    value, spread = _parse_number_and_uncertainty(match)
    steps, raw_unit = float(match[5] or 1.0), normalize_unit(match[6])
    size, unit = _calibrated_unit_size_and_si_unit(role, match[4], f"scale = {quote(scale)}")
    if value == 0.0 or steps == 0.0:
        raise RecordError(f"scale = {quote(scale)} is 0 or infinite; give another number")
    factor = value * size / steps
    offset, uncertainty = (0.0, 0.0) if zero is None else _parse_zero_and_uncertainty(zero, raw_unit)
    deviations = [np.array([-offset, 1.0]) * factor * spread / value, np.array([-factor * uncertainty, 0.0])]
    known = [row for row, given in zip(deviations, (spread, uncertainty), strict=True) if given]
    return Calibration(np.array([-factor * offset, factor]), np.reshape(known, (-1, 2)), raw_unit, unit)


def _parse_zero_and_uncertainty(text: Any, raw_unit: str) -> tuple[float, float]:
    """Return the zero and its standard uncertainty, both in the unit of the sensor's column."""
    match = _match_calibration_text(_ZERO, text)
    if match is None:
        raise RecordError(f"zero = {quote(text)} cannot be read; write number and unit, such as '2.513 V'")
    ratio = _unit_ratio_to_target(
        raw_unit if match[4] is None else normalize_unit(match[4]), raw_unit, "zero"
    )
    value, spread = _parse_number_and_uncertainty(match)
    return value * ratio, spread * ratio


def _match_calibration_text(form: re.Pattern[str], text: Any) -> re.Match[str] | None:
    return form.fullmatch(text) if isinstance(text, str) and len(text) <= _MAX_CHARACTERS else None


def _parse_number_and_uncertainty(match: re.Match[str]) -> tuple[float, float]:
    """Return a number from the text of a calibration, and its standard uncertainty."""
    value, spread = float(match[1]), abs(float(match[2] or 0.0))
    return value, abs(value) * spread / 100.0 if match[3] else spread


def _calibrated_unit_size_and_si_unit(role: str, text: str, subject: str) -> tuple[float, str]:
    """Return the size in SI of the unit to which a calibration converts, and the SI unit."""
    unit = normalize_unit(text)
    try:
        size, dimension = role_unit_size_and_dimension(role, unit)
    except SceneError as error:
        raise RecordError(f"{subject}: {error}") from None
    if role == HEIGHT and unit in ANGLE_UNITS:
        return size, "rad"
    target_unit = SI.get(role, "")
    if target_unit and dimension != unit_size(target_unit)[1]:
        kind = "neither a length nor an angle" if role == HEIGHT else f"not a unit of {role}"
        raise RecordError(f"{subject}: {quote(text)} is {kind}; write for example '{target_unit}/V'")
    return size, target_unit


def _unit_ratio_to_target(unit: str, target_unit: str, subject: str) -> float:
    """Return the ratio of a unit to the unit that the calibration expects in the column."""
    names = [name.lower().removesuffix("s") if len(name) > 2 else name for name in (unit, target_unit)]
    if names[0] == names[1]:
        return 1.0
    try:
        (size, dimension), (other, expected) = unit_size(unit), unit_size(target_unit)
    except SceneError:
        size, other, dimension, expected = 1.0, 1.0, (1, 0, 0, 0), (0, 0, 0, 0)
    if dimension != expected or not {unit, target_unit}.isdisjoint(("1", "%")):
        raise RecordError(
            f"the {subject} is in {quote(unit)}, but the scale is per {quote(target_unit)}; write both with "
            "the unit of the column"
        )
    return size / other


# Polynomials -----------------------------------------------------------------------------------


def _calibration_from_coefficients(role: str, texts: Any) -> Calibration:
    """Make a polynomial from coefficients such as ``0.1 mm``, ``2.49 mm/V`` and ``0.01 mm/V^2``."""
    if isinstance(texts, str) or not isinstance(texts, Sequence) or not texts:
        raise RecordError(
            f"coefficients = {quote(texts)} is not a list of coefficients; give one that begins with the "
            "constant, such as ['0.1 mm', '2.49 mm/V']"
        )
    if len(texts) > _MAX_DEGREE + 1:
        raise RecordError(
            f"{len(texts)} coefficients are too many; the maximum is {_MAX_DEGREE + 1}: fit a lower degree"
        )
    values, spreads, units = [], [], set()
    for power, text in enumerate(texts):
        match = _match_calibration_text(_ZERO, text)
        written = "" if match is None else match[4] or ""
        quotient = _POWER.fullmatch(written) if power else None
        exponent = f"^{power}" if power > 1 else ""
        if match is None or not written or (power and (quotient is None or (quotient[3] or "") != exponent)):
            over = f"/V{exponent}" if power else ""
            raise RecordError(
                f"coefficients: {quote(text)} cannot be read as the coefficient of power {power} of the "
                f"sensor's reading; write a number and a unit, such as '0.1 mm{over}'"
            )
        top, below = (written, None) if quotient is None else (quotient[1], normalize_unit(quotient[2]))
        size, unit = _calibrated_unit_size_and_si_unit(role, top, f"coefficients: {quote(text)}")
        value, spread = _parse_number_and_uncertainty(match)
        values.append(value * size)
        spreads.append(spread * size)
        units.add((unit, below))
    outcomes, raw_units = {unit for unit, _ in units}, {below for _, below in units if below is not None}
    if len(outcomes) > 1 or len(raw_units) > 1:
        raise RecordError(
            "the coefficients have different units; write all with one unit of the result and one "
            "unit of the sensor's reading"
        )
    deviations = np.diag(spreads)[np.array(spreads) > 0.0]
    return Calibration(np.array(values), deviations, next(iter(raw_units), None), outcomes.pop())


def _calibration_from_points(role: str, points: Any, degree: Any) -> Calibration:
    """Fit a polynomial to calibration points by least squares, with its uncertainty."""
    if isinstance(degree, bool) or not isinstance(degree, int) or not 1 <= degree <= _MAX_DEGREE:
        raise RecordError(
            f"degree = {quote(degree)} is outside the limits; give an integer from 1 to {_MAX_DEGREE}"
        )
    if not isinstance(points, Mapping) or not {"raw", "value"} <= set(points):
        raise RecordError(
            f"points = {quote(points)} are not calibration points; give a file with the columns raw, value "
            "and uncertainty"
        )
    units = points.get("units", {})
    size, unit = _calibrated_unit_size_and_si_unit(
        role, units.get("value") or SI.get(role, "1"), "points: value"
    )
    try:
        raw, value = (np.asarray(points[name], dtype=np.float64) for name in ("raw", "value"))
        given = points.get("uncertainty")
        spread = None if given is None else np.asarray(given, dtype=np.float64) * size
    except (TypeError, ValueError):
        raise RecordError("the calibration points hold an entry that is not a number; correct it") from None
    complete = np.isfinite(raw) & np.isfinite(value)
    raw, value = raw[complete], value[complete] * size
    needed = degree + 1 + (_MIN_DEGREES_OF_FREEDOM if spread is None else 0)
    if len(np.unique(raw)) < degree + 1 or len(raw) < needed:
        raise RecordError(
            f"{len(raw)} points are too few for a polynomial of degree {degree}; give {needed} or more"
            + (", or give the uncertainty of the points" if spread is None else "")
        )
    if spread is not None and not (np.isfinite(spread[complete]) & (spread[complete] > 0.0)).all():
        raise RecordError("points: an uncertainty is not a number above 0; correct it")
    # centred on the points and scaled by their extent, so that least squares are well conditioned
    middle, extent = float(raw.mean()), float(np.ptp(raw)) / 2.0
    terms = np.vander((raw - middle) / extent, degree + 1, increasing=True)
    weight = np.ones(len(raw)) if spread is None else 1.0 / spread[complete]
    fitted, *_ = np.linalg.lstsq(terms * weight[:, None], value * weight, rcond=None)
    scatter = float((((value - terms @ fitted) * weight) ** 2).sum()) / max(1, len(raw) - degree - 1)
    # scatter beyond the stated uncertainty widens the result (Birge ratio)
    variance = scatter if spread is None else max(1.0, scatter)
    inverse = np.linalg.pinv(terms * weight[:, None]) * math.sqrt(variance)
    strengths, directions = np.linalg.eigh(inverse @ inverse.T)
    deviations = (np.sqrt(np.maximum(strengths, 0.0)) * directions).T
    powers = [(Polynomial([-middle / extent, 1.0 / extent]) ** power).coef for power in range(degree + 1)]
    shifted = np.array([np.pad(power, (0, degree + 1 - len(power))) for power in powers]).T
    raw_unit = None if units.get("raw") is None else normalize_unit(units["raw"])
    raw_range = (float(raw.min()), float(raw.max()))
    return Calibration(shifted @ fitted, deviations @ shifted.T, raw_unit, unit, raw_range)
