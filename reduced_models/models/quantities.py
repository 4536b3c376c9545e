"""Quantities with their errors, and numbers with the digits that these are worth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

PARTS = ("fit", "step", "start", "calibration")
"""Parts of an error: half of the fit's interval; what another time step changes; Student's half-width
for another random start of the bed; what the sensor's calibration leaves open. All with 95 %."""
ERROR_SOURCES = {
    "fit": "fit",
    "step": "time step",
    "start": "random packing",
    "calibration": "sensor calibration",
}
"""The same parts as they are printed."""
_SURE = 0.95
DAMPING_RATIO = "damping ratio"
LEVEL = "level of rest"
EQUIVALENT_FRICTION = "Feq"
_LABELS = {LEVEL: "equilibrium", "friction": "dry friction", EQUIVALENT_FRICTION: "equivalent friction"}
_MOST_DIGITS = 8


class QuantityWithError(NamedTuple):
    """A number with its total error."""

    name: str
    symbol: str
    unit: str
    value: float
    parts: Mapping[str, float]  # of its error, by the names in `PARTS`, in its unit

    @property
    def label(self) -> str:
        """Name as it is printed, without an amplitude; ``name`` is a key of the plain data."""
        return _LABELS.get(self.symbol) or _LABELS.get(self.name, self.name.partition(" at ")[0])

    @property
    def total_error(self) -> float:
        """Root of the sum of the squared parts, in the quantity's unit; infinite where it is left open."""
        return math.hypot(*self.parts.values())

    @property
    def decimals(self) -> int:
        """Number of decimals that the error is worth: those of its first two digits."""
        return decimal_places_of_interval(
            self.value, self.value - self.total_error, self.value + self.total_error
        )

    @property
    def text_without_error(self) -> str:
        """Text of the value and its unit, with the decimals that the error is worth."""
        return f"{format_fixed(self.value, self.decimals)} {self.unit}".rstrip()

    @property
    def text_with_error(self) -> str:
        """Text of the value, its total error and its unit, with the decimals that the error is worth."""
        value, error = format_fixed(self.value, self.decimals), self.total_error
        if error < 0.5 * 10.0**-self.decimals:  # of a law, or of a record without noise
            return f"{self.value:.6g} {self.unit}".rstrip()
        if not math.isfinite(error):
            return f"{value} {self.unit}".rstrip() + " (not determined)"
        width = f"{error:.2g}" if "e" in value else f"{round(error, self.decimals):.{max(0, self.decimals)}f}"
        return f"{value} ± {width} {self.unit}".rstrip()

    @property
    def table_cell(self) -> str:
        """Text of the value and its total error, for a table with the unit elsewhere."""
        return self.text_with_error.removesuffix(f" {self.unit}")

    def to_plain(self) -> dict[str, Any]:
        """Value, unit, total error and its parts as plain data; null for what is not known."""
        return {
            "value": self.value,
            "unit": self.unit,
            "total_error": self.total_error if math.isfinite(self.total_error) else None,
            "parts": {name: self.parts.get(name) for name in PARTS},
        }


def decimal_places_of_interval(value: float, low: float, high: float) -> int:
    """Count the decimals of a value that has an interval; negative ones are zeros before the point."""
    half = 0.5 * (high - low)
    size = abs(value) or 1.0
    finest = _MOST_DIGITS - 1 - math.floor(math.log10(size))
    if not math.isfinite(half):
        return 3 - math.floor(math.log10(size))
    if half <= 0.0:
        return finest
    return min(1 - math.floor(math.log10(half) + 1e-9), finest)


def format_fixed(value: float, digits: int) -> str:
    """Return the number with so many decimals, in powers of ten where it is very large or small."""
    digits = digits if value else min(digits, _MOST_DIGITS)
    size = abs(value)
    if value and not 1e-4 <= size < 1e7:
        return f"{value:.{max(0, digits + math.floor(math.log10(size)))}e}"
    return f"{round(value, digits):.{max(0, digits)}f}"


def format_interval(low: float, high: float, digits: int) -> str:
    """Interval with so many decimals, rounded outwards: what is in it is in the printed one."""
    last = 10.0**-digits
    slack = 1e-6 * last  # of numbers that are short in decimals
    if round(low, digits) > low + slack:
        low = round(low, digits) - last
    if round(high, digits) < high - slack:
        high = round(high, digits) + last
    return f"{format_fixed(low, digits)} to {format_fixed(high, digits)}"


def add_step_and_start_errors(
    figures: Sequence[QuantityWithError],
    step: Sequence[float] | None,
    *starts: Sequence[QuantityWithError] | None,
) -> tuple[QuantityWithError, ...]:
    """Add to figures the errors of the time step, and those that other random starts show."""
    scattered = [other for other in starts if other is not None]
    checked = []
    for k, figure in enumerate(figures):
        parts = dict(figure.parts)
        if step is not None:
            parts["step"] = step[k]
        if scattered:
            parts["start"] = student_half_width([figure.value, *(other[k].value for other in scattered)])
        checked.append(figure._replace(parts=parts))
    return tuple(checked)


def student_half_width(values: Sequence[float]) -> float:
    """Half-width of the interval in which a further value lies with 95 %, by Student's t (two or more)."""
    # Student's t times the standard deviation (Student 1908, doi:10.1093/biomet/6.1.1).
    from scipy.stats import t

    # Few values tell their scatter badly, and another one may well lie outside of it.
    return float(t.ppf(0.5 + 0.5 * _SURE, len(values) - 1) * np.std(values, ddof=1))
