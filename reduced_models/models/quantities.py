"""Quantities with their errors, and numbers with the digits that these are worth."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np

from reduced_models.models.plain_data import Interval, Probability, Size, SizeOrInfinity, TextForm

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


SURE = 1e-4
"""Probability below which residuals are not taken for white noise."""
_ANYTHING = 7.0  # of a logarithm: a factor of a thousand


@dataclasses.dataclass(frozen=True)
class ParameterDirection:
    """A direction in which the parameters can move without the data noticing."""

    powers: Mapping[str, float]  # joint change of the parameters: each as t to this power
    spread: Size  # standard deviation of log t that the data leave

    @property
    def is_undetermined(self) -> bool:
        """True if the data determine nothing along it."""
        return self.spread >= _ANYTHING

    def __str__(self) -> str:
        *most, last = self.powers
        names = f"{', '.join(most)} and {last}" if most else last
        together = "can be rescaled together" if most else "can be rescaled"
        if self.is_undetermined:
            words = f"not identifiable from this record: {names} {together}"
            return f"{words} without changing the fit"
        factor = f"{math.exp(self.spread):.2g}"
        return f"hardly identifiable from this record: {names} {together} by a factor of {factor}"


@dataclasses.dataclass(frozen=True)
class Quality:
    """Quality of a model's fit to the data.

    Attributes
    ----------
    residual : float
        Root mean square of height minus model over the record [m].
    relative : float
        The same over the rms swing of the record.
    test_error : float or None
        Rms error of the simulation over the test swings by a model that has not seen them, over the
        rms swing of the whole record; infinite where that model diverges. To be compared with
        ``test_error_at_rest``.
    test_swings : sequence of (float, float)
        Start and end of these swings, since the record's start [s]; one is the motion's end, where
        there are too few swings to spread them.
    starts, converged : int
        Random starts, and how many of them led to the best fit.
    samples : int
    solver_error : float
        Greatest difference of the solution that was fitted and an adaptive one at a tolerance of
        1e-10, over the amplitude.
    test_error_at_rest : float or None
        The same error of a piston that stays at the level of rest of the other samples: what a
        prediction has to beat.
    test_standard_error : float or None
        Standard error of ``test_error``, from how it differs between the swings; None for one.
    shifts : mapping of str to float
        How far period and damping ratio of the small swing at rest move, over themselves, where the
        test swings are left out of the fit: how much it matters what a law misses.
    noise : float
        Standard deviation of white noise in the record, from its third differences [m].
    correlation : float
        Integrated autocorrelation time of the residuals, in samples.
    collocation : str
        Result of a fit to accelerations in the record, which solves nothing: ``"same"`` fit,
        ``"worse"``, ``"better"`` (which is then this fit), or ``"none"`` where there is no such.
    whiteness, signs : float
        Probabilities that white noise is correlated as much as the residuals, and that its sign
        changes as seldom, or as often (tests of Dalla, Giraitis & Phillips, and of Wald & Wolfowitz).
    lag : float
        Time by which the solution comes late [s].
    slow, swinging : float
        Fraction of the residuals' power that is slower than the swing, and that is about as fast.
    drift : float
        Their slow power, over what white noise of the same power has there.
    """

    residual: Size
    relative: Size
    test_error: SizeOrInfinity | None
    test_swings: Sequence[Interval]
    starts: int
    converged: int
    samples: int
    solver_error: Size
    test_error_at_rest: Size | None = None
    test_standard_error: Size | None = None
    shifts: Mapping[str, Size] = dataclasses.field(default_factory=dict)
    noise: Size = 0.0
    correlation: Size = 1.0
    collocation: Annotated[str, TextForm(choices=("none", "same", "worse", "better"))] = "none"
    whiteness: Probability = 1.0
    signs: Probability = 1.0
    lag: float = 0.0
    slow: Size = 0.0
    swinging: Size = 0.0
    drift: Size = 1.0
    rounded: bool = False  # no residual exceeds the steps of a sensor that rounds
    zero_drift: Size = 0.0  # range of a fitted drift of the record's zero [m]

    @property
    def has_structured_residuals(self) -> bool:
        """True if the residuals are surely not white noise, so that the law is not right."""
        return not self.rounded and min(self.whiteness, self.signs) < SURE

    @property
    def test_swings_text(self) -> str:
        """Test samples that a law is judged on, in words."""
        if len(self.test_swings) > 1:
            return f"{len(self.test_swings)} swings"
        return "the end of the motion (too few swings to spread)"

    @property
    def figure_shifts_text(self) -> str:
        """Shifts of the figures without the test swings, in words; empty where none is known."""
        if not self.shifts:
            return ""
        moves = (f"{name.replace('_', ' ')} by {100.0 * by:.1g} %" for name, by in self.shifts.items())
        return f"; without {self.test_swings_text} the fit moves its {' and its '.join(moves)}"
