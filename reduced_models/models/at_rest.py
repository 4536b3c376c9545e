"""Small oscillations of a law about its equilibrium, in engineering units.

Stiffness and damping belong to the equivalent oscillator m z'' + c z' + k z = 0. They are per
kilogram if the mass is unknown, and divided by the moment of inertia if the coordinate is an angle.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

from granular.records.headings import CoordinateUnit
from reduced_models.models.plain_data import Interval, Size, SizeOrInfinity, SizeOrUnknown
from reduced_models.models.quantities import (
    DAMPING_RATIO,
    EQUIVALENT_FRICTION,
    LEVEL,
    QuantityWithError,
    quantity_lines,
)
from reduced_models.records.envelope import PeakDampingRatios

if TYPE_CHECKING:
    import pandas


_UNDERDAMPED = 0.999  # maximum damping ratio for figures of a damped oscillation
_STEP = 1e-4  # relative step for derivatives


@dataclasses.dataclass(frozen=True)
class EquivalentDamping:
    """Equivalent damping at finite amplitudes, from the energy loss of harmonic cycles."""

    amplitude: Size  # [m]
    tenth_ratio: float  # fraction of critical damping at a tenth of the maximum amplitude
    friction: float  # [m/s^2]
    intervals: Mapping[str, Interval]
    own: bool = False  # True if the friction is the coefficient of sign(z') in the law

    @property
    def tenth_of_maximum_amplitude(self) -> float:
        """A tenth of the maximum amplitude [m]."""
        return 0.2 * self.amplitude


@dataclasses.dataclass(frozen=True)
class AtRest:
    """Small oscillations of a law about its equilibrium, with intervals.

    Attributes
    ----------
    height, period, damping_ratio : float
        Equilibrium height [m], period of undamped small oscillations [s], and fraction of critical
        damping. With dry friction, for example, the damping of small oscillations differs strongly from
        the damping in the record. In such cases the damping ratio is an equivalent one: the energy loss
        of a harmonic cycle of amplitude ``equivalent.amplitude``, divided by 4 pi times its energy.
    intervals : mapping of str to (float, float)
        Confidence intervals of the three quantities.
    equivalent : EquivalentDamping or None
        Damping at finite amplitudes; None if the damping ratio belongs to small oscillations.
    peaks : PeakDampingRatios or None
        Damping ratios from the decrease of the record's peaks if they contradict the law; they are
        then printed instead of the law's damping ratio.
    calibration : mapping of str to float
        Part of each interval's half-width due to the sensor's calibration; empty without calibration errors.
    coordinate_unit : "m" or "rad"
        Unit of the height.
    """

    height: float
    period: Size
    damping_ratio: float
    intervals: Mapping[str, Interval]
    equivalent: EquivalentDamping | None = None
    peaks: PeakDampingRatios | None = None
    calibration: Mapping[str, SizeOrInfinity] = dataclasses.field(default_factory=dict)
    coordinate_unit: CoordinateUnit = "m"

    def to_series(self) -> pandas.Series[float]:
        """Return height, period and damping ratio, with the half-widths of their intervals as errors.

        Returns
        -------
        pandas.Series
            ``height`` [m] (for an angle [rad]), ``period`` [s], ``damping_ratio``, and their errors
            ``height_error``, ``period_error``, ``damping_ratio_error``.
        """
        import pandas

        names = ("height", "period", "damping_ratio")
        errors = {f"{name}_error": 0.5 * (high - low) for name, (low, high) in self.intervals.items()}
        return pandas.Series({name: getattr(self, name) for name in names} | errors)

    def __str__(self) -> str:
        lines = quantity_lines(small_oscillation_quantities(self, None))
        return "\n".join(line.strip() for line in [*lines, *self.peak_texts])

    @property
    def peak_texts(self) -> tuple[str, ...]:
        """Sentence on the damping ratio of the record's peaks; empty if the ratio agrees with the law."""
        if self.peaks is None:
            return ()
        return (
            f"the record's peaks show a damping ratio of {100.0 * self.peaks.mean:.3g} %, which contradicts "
            f"the {100.0 * self.damping_ratio:.3g} % of the model",
        )


@dataclasses.dataclass(frozen=True)
class EngineeringUnits:
    """Units of the coordinate and of its forces in print-outs."""

    length: str
    scale: float  # factor from SI units
    stiffness: str
    damping: str
    friction: str
    inertia: float  # factor of the law's stiffness and damping


def engineering_units(coordinate_unit: str, mass: float | None) -> EngineeringUnits:
    """Return the units of a coordinate and of its forces in print-outs; ``mass`` is in kg."""
    if coordinate_unit == "rad":
        return EngineeringUnits("°", 180.0 / math.pi, "1/s²", "1/s", "rad/s²", 1.0)
    if mass is None:
        return EngineeringUnits("mm", 1e3, "N/m per kg", "N s/m per kg", "m/s²", 1.0)
    return EngineeringUnits("mm", 1e3, "N/m", "N s/m", "N", mass)


def signal_units(measured: str, coordinate_unit: str) -> EngineeringUnits:
    """Return the units in print-outs of a measured height, velocity, acceleration or force."""
    units = engineering_units(coordinate_unit, None)
    if measured == "force":
        return dataclasses.replace(units, length="N", scale=1.0)
    if measured == "acceleration":
        length, scale = ("°/s²", units.scale) if coordinate_unit == "rad" else ("m/s²", 1.0)
        return dataclasses.replace(units, length=length, scale=scale)
    return dataclasses.replace(units, length=f"{units.length}/s") if measured == "velocity" else units


def small_oscillation_quantities(rest: AtRest, mass: float | None) -> tuple[QuantityWithError, ...]:
    """Return equilibrium, frequency, damping ratio, stiffness and damping to print; ``mass`` is in kg."""
    units = engineering_units(rest.coordinate_unit, mass)
    inertia, quantity = units.inertia, functools.partial(_quantity_with_propagated_errors, rest)
    figures = [
        quantity(LEVEL, "z0", units.length, lambda height, *_: units.scale * height),
        quantity("natural frequency", "f0", "Hz", lambda _, period, __: 1.0 / period),
    ]
    if rest.peaks is None and rest.equivalent is not None:
        figures += _damping_at_two_amplitudes(rest, rest.equivalent, units)
    elif rest.peaks is None:
        figures += _damping_of_small_oscillations(rest)
    figures.append(
        quantity("stiffness", "k", units.stiffness, lambda _, period, __: inertia * (math.tau / period) ** 2)
    )
    if any(figure.name == DAMPING_RATIO for figure in figures):
        rate = 2.0 * math.tau * inertia
        figures.append(quantity("damping", "c", units.damping, lambda _, period, zeta: rate * zeta / period))
    return tuple(figures)


def _damping_of_small_oscillations(rest: AtRest) -> list[QuantityWithError]:
    quantity = functools.partial(_quantity_with_propagated_errors, rest)
    quantities = [quantity(DAMPING_RATIO, "zeta", "%", lambda *at: 100.0 * at[2])]
    if 0.0 < rest.damping_ratio < _UNDERDAMPED:
        quantities += [
            # sqrt(1 - zeta^2)/T and 2 pi zeta/sqrt(1 - zeta^2) (Inman 2014, ch. 1)
            quantity(
                "damped frequency", "fd", "Hz", lambda *at: _damped_to_natural_frequency_ratio(at[2]) / at[1]
            ),
            quantity(
                "logarithmic decrement",
                "delta",
                "",
                lambda *at: math.tau * at[2] / _damped_to_natural_frequency_ratio(at[2]),
            ),
            quantity("quality factor", "Q", "", lambda *at: 0.5 / at[2]),
        ]
    return quantities


def _damping_at_two_amplitudes(
    rest: AtRest, equivalent: EquivalentDamping, units: EngineeringUnits
) -> list[QuantityWithError]:
    """Return the damping ratios (if below 1) at two amplitudes, and the friction (if above 0)."""
    wide, narrow = (
        f"{DAMPING_RATIO} at {units.scale * size:.3g} {units.length}"
        for size in (equivalent.amplitude, equivalent.tenth_of_maximum_amplitude)
    )

    def quantity(name: str, symbol: str, unit: str, scale: float, key: str) -> QuantityWithError:
        low, high = equivalent.intervals[key]
        value = scale * getattr(equivalent, key)
        return QuantityWithError(name, symbol, unit, value, {"fit": 0.5 * scale * (high - low)})

    quantities = [
        _quantity_with_propagated_errors(rest, wide, "zeta", "%", lambda *at: 100.0 * at[2]),
        quantity(narrow, "zeta", "%", 100.0, "tenth_ratio"),
    ]
    quantities = [figure for figure in quantities if figure.value < 100.0 * _UNDERDAMPED]
    if equivalent.friction > 0.0:
        symbol = "F" if equivalent.own else EQUIVALENT_FRICTION
        quantities.append(quantity("friction", symbol, units.friction, units.inertia, "friction"))
    return quantities


def _quantity_with_propagated_errors(
    rest: AtRest, name: str, symbol: str, unit: str, function: Callable[[float, float, float], float]
) -> QuantityWithError:
    """Return the value, with propagated errors, of a function of height, period and damping ratio."""
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


def _damped_to_natural_frequency_ratio(ratio: float) -> float:
    """Return the damped frequency divided by the natural frequency, for a damping ratio."""
    return math.sqrt(1.0 - ratio**2)


class HarmonicCycle(NamedTuple):
    """A harmonic cycle; its forces are per kilogram for a motion, in newtons for a prescribed stroke.

    Attributes
    ----------
    amplitude, frequency, centre : float
        Amplitude [m], angular frequency [rad/s] and centre [m].
    stiffness, damping, energy : float
        Stiffness and damping of the first harmonic, and energy loss of the cycle: in 1/s^2, 1/s and
        J/kg for a motion; in N/m, N s/m and J for a force on a prescribed stroke.
    errors : (float, float, float)
        Half-widths of the intervals of stiffness, damping and energy; zero if unknown.
    measured : int
        Number of measured cycles that were averaged; 0 for the cycle of a law.
    """

    amplitude: float
    frequency: float
    centre: float
    stiffness: float
    damping: float
    energy: float
    errors: tuple[SizeOrUnknown, ...] = (0.0, 0.0, 0.0)
    measured: int = 0

    @property
    def damping_ratio(self) -> float:
        """Fraction of critical damping."""
        return self.damping / (2.0 * math.sqrt(self.stiffness))
