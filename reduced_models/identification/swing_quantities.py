"""A fitted law in an engineer's words: frequency, damping, stiffness, and how they change.

All is of the small swing about rest but for what names an amplitude. Stiffness and damping are
those of a mass on a spring with a dashpot that swings alike, m z'' + c z' + k z = 0; where no mass
is known they are per kilogram, and of an angle over its moment of inertia.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from reduced_models.models.fitted_law import AtRest, EquivalentDamping
from reduced_models.models.model import ReducedModel

PARTS = ("fit", "step", "start", "calibration")
"""Parts of an error: half of the fit's interval; what another time step changes; Student's half-width
for another random start of the bed; what the sensor's calibration leaves open. All with 95 %."""
_SURE = 0.95
DAMPING_RATIO = "damping ratio"
_MOST_DIGITS = 8
_UNDERDAMPED = 0.999  # a damping ratio above which nothing swings
_STEP = 1e-4  # of a number, by which it is changed to see what follows from it


class QuantityWithError(NamedTuple):
    """A number with its total error."""

    name: str
    symbol: str
    unit: str
    value: float
    parts: Mapping[str, float]  # of its error, by the names in `PARTS`, in its unit

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
        if not error:  # a law or a map fixes it
            return self.text_without_error if self.value else f"0 {self.unit}".rstrip()
        if not math.isfinite(error):
            return f"{value}, open {self.unit}".rstrip()
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


@dataclasses.dataclass(frozen=True)
class EngineeringUnits:
    """Units in which the coordinate and its forces are shown."""

    length: str
    scale: float  # from SI
    stiffness: str
    damping: str
    friction: str
    inertia: float  # times the law's stiffness and damping


def engineering_units(angle: bool, mass: float | None) -> EngineeringUnits:
    """Units in which a coordinate and its forces are shown; mass [kg]."""
    if angle:
        return EngineeringUnits("°", 180.0 / math.pi, "1/s²", "1/s", "rad/s²", 1.0)
    if mass is None:
        return EngineeringUnits("mm", 1e3, "N/m per kg", "N s/m per kg", "m/s²", 1.0)
    return EngineeringUnits("mm", 1e3, "N/m", "N s/m", "N", mass)


def swing_quantities(model: ReducedModel, angle: bool, mass: float | None) -> tuple[QuantityWithError, ...]:
    """Figures of the small swing [mm or degrees, Hz, %]; none of a law without a level of rest; mass [kg]."""
    # k = m (2 pi/T)^2 and c = 4 pi m zeta/T of the linear oscillator (Inman 2014, Engineering Vibration, ch.
    # 1). A damping ratio that the record's own peaks contradict is not shown.
    rest = model.at_rest
    if rest is None:
        return ()
    units = engineering_units(angle, mass)
    inertia = units.inertia
    figures = [
        _quantity_with_propagated_errors(
            "level of rest", "z", units.length, rest, lambda height, *_: units.scale * height
        ),
        _quantity_with_propagated_errors(
            "natural frequency", "f", "Hz", rest, lambda _, period, __: 1.0 / period
        ),
    ]
    if rest.peaks is None and rest.equivalent is not None:
        figures += _damping_at_two_amplitudes(rest, rest.equivalent, units)
    elif rest.peaks is None:
        figures += _damping_of_small_swing(rest)
    figures.append(
        _quantity_with_propagated_errors(
            "stiffness", "k", units.stiffness, rest, lambda _, period, __: inertia * (math.tau / period) ** 2
        )
    )
    if any(figure.name == DAMPING_RATIO for figure in figures):
        figures.append(
            _quantity_with_propagated_errors(
                "damping",
                "c",
                units.damping,
                rest,
                lambda _, period, ratio: inertia * 2.0 * math.tau * ratio / period,
            )
        )
    return tuple(figures)


def _damping_of_small_swing(rest: AtRest) -> list[QuantityWithError]:
    ratio = rest.damping_ratio
    quantities = [_quantity_with_propagated_errors(DAMPING_RATIO, "ζ", "%", rest, lambda *at: 100.0 * at[2])]
    if 0.0 < ratio < _UNDERDAMPED:
        quantities += [
            _quantity_with_propagated_errors(
                "damped frequency", "f_d", "Hz", rest, lambda _, *at: damped_frequency(*at)
            ),
            _quantity_with_propagated_errors(
                "logarithmic decrement", "δ", "", rest, lambda *at: _logarithmic_decrement(at[2])
            ),
            _quantity_with_propagated_errors("quality factor", "Q", "", rest, lambda *at: 0.5 / at[2]),
        ]
    return quantities


def _damping_at_two_amplitudes(
    rest: AtRest, equivalent: EquivalentDamping, units: EngineeringUnits
) -> list[QuantityWithError]:
    """Damping ratios at two amplitudes, as far as it swings with them, and friction."""
    wide, narrow = (
        f"{DAMPING_RATIO} at {units.scale * size:.3g} {units.length}"
        for size in (equivalent.amplitude, equivalent.tenth_of_greatest_swing)
    )

    def quantity(
        name: str, symbol: str, unit: str, scale: float, value: float, key: str
    ) -> QuantityWithError:
        low, high = equivalent.intervals[key]
        return QuantityWithError(name, symbol, unit, scale * value, {"fit": 0.5 * scale * (high - low)})

    quantities = [_quantity_with_propagated_errors(wide, "ζ", "%", rest, lambda *at: 100.0 * at[2])]
    quantities.append(quantity(narrow, "ζ", "%", 100.0, equivalent.tenth_ratio, "tenth_ratio"))
    quantities = [figure for figure in quantities if figure.value < 100.0 * _UNDERDAMPED]
    if equivalent.friction > 0.0:
        quantities.append(
            quantity("friction", "F", units.friction, units.inertia, equivalent.friction, "friction")
        )
    return quantities


def _quantity_with_propagated_errors(
    name: str, symbol: str, unit: str, rest: AtRest, function: Callable[[float, float, float], float]
) -> QuantityWithError:
    """Quantity that follows from height, period and damping ratio, with the errors of these."""
    names = ("height", "period", "damping_ratio")
    at = [float(getattr(rest, key)) for key in names]
    parts: dict[str, float] = {}
    for k, key in enumerate(names):
        low, high = rest.intervals[key]
        step = _STEP * max(abs(at[k]), _STEP)
        ends = ([*at[:k], at[k] + side * step, *at[k + 1 :]] for side in (1.0, -1.0))
        above, below = (function(*end) for end in ends)
        if slope := abs(above - below) / (2.0 * step):
            calibration = rest.calibration.get(key, 0.0)
            of_fit = math.sqrt(max((0.5 * (high - low)) ** 2 - calibration**2, 0.0))
            parts["fit"] = math.hypot(parts.get("fit", 0.0), slope * of_fit)
            if calibration:
                parts["calibration"] = math.hypot(parts.get("calibration", 0.0), slope * calibration)
    return QuantityWithError(name, symbol, unit, function(*at), parts)


def add_step_and_start_errors(
    figures: Sequence[QuantityWithError],
    factor: float,
    step: Sequence[QuantityWithError] | None,
    *starts: Sequence[QuantityWithError] | None,
) -> tuple[QuantityWithError, ...]:
    """Add to figures the errors that another time step and other random starts show."""
    # Student's t times the standard deviation (Student 1908, doi:10.1093/biomet/6.1.1).
    from scipy.stats import t

    scattered = [other for other in starts if other is not None]
    # Few starts tell their scatter badly, and another one may well lie outside of it.
    student = float(t.ppf(0.5 + 0.5 * _SURE, max(1, len(scattered))))
    checked = []
    for k, figure in enumerate(figures):
        parts = dict(figure.parts)
        if step is not None:
            parts["step"] = factor * abs(step[k].value - figure.value)
        if scattered:
            values = [figure.value, *(other[k].value for other in scattered)]
            parts["start"] = student * float(np.std(values, ddof=1))
        checked.append(figure._replace(parts=parts))
    return tuple(checked)


def swing_noun(model: ReducedModel) -> str:
    """Noun for the swing that a model's figures are of."""
    rest = model.at_rest
    return "small swing" if rest is None or rest.equivalent is None else "swing"


def damped_frequency(period: float, ratio: float) -> float:
    """Frequency [Hz] of a damped linear motion, sqrt(1 - zeta^2)/T (Inman 2014, ch. 1); period [s]."""
    return math.sqrt(1.0 - ratio**2) / period


def _logarithmic_decrement(ratio: float) -> float:
    """Logarithm of two amplitudes a period apart."""
    return 2.0 * math.pi * ratio / math.sqrt(1.0 - ratio**2)


def swing_sentences(quantities: Sequence[QuantityWithError], subject: str, mass: float | None) -> str:
    """Rest, frequency, damping and stiffness of the swing in a sentence or two; mass [kg]."""
    known = {quantity.name: quantity.text_with_error for quantity in quantities}
    words = (
        f"{subject} comes to rest at {known['level of rest']}, and swings about that with a natural "
        f"frequency of {known['natural frequency']}"
    )
    ratios = [
        f"{known[name]}{name.removeprefix(DAMPING_RATIO)}" for name in known if name.startswith(DAMPING_RATIO)
    ]
    if ratios:
        words += f" and a damping ratio of {' and '.join(ratios)}"
    if "friction" in known:
        words += f"; dry friction is {known['friction']}"
    words += "."
    if mass is not None and "damping" in known:
        words += (
            f" A mass of {mass:.4g} kg on a spring of {known['stiffness']} with a dashpot of "
            f"{known['damping']} does the same."
        )
    return words
