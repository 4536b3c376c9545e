"""A fitted law in an engineer's words: frequency, damping, stiffness, and how they change.

All is of the small swing about rest but for what names an amplitude. Stiffness and damping are
those of a mass on a spring with a dashpot that swings alike, m z'' + c z' + k z = 0; where no mass
is known they are per kilogram, and of an angle per unit of the moment of inertia.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from granular.shared.errors import GranularError
from granular.shared.html import format_number
from reduced_models.models.fitted_law import AtRest, EquivalentDamping
from reduced_models.models.model import ReducedModel
from reduced_models.models.response import HarmonicCycle

FRACTIONS = (1.0, 0.5, 0.25, 0.1)
"""Amplitudes that are looked at, over the greatest one of the record."""
DAMPING_RATIO = "damping ratio"
_MOST_DIGITS = 8
_UNDERDAMPED = 0.999  # a damping ratio above which nothing swings
_NO_CHANGE = 5e-3  # per cent of a change that is none
_BY_RATIO = ("ζ", "δ", "Q", "F")  # symbols of what is as uncertain as the damping ratio


class Quantity(NamedTuple):
    """A number with its interval.

    Attributes
    ----------
    name, symbol, unit : str
    value, low, high : float
        In that unit.
    """

    name: str
    symbol: str
    unit: str
    value: float
    low: float
    high: float

    @property
    def digits(self) -> int:
        """Decimals that the interval is worth: its half-width has two of them."""
        return decimal_places(self.value, self.low, self.high)

    @property
    def text(self) -> str:
        """The number and its unit."""
        return f"{format_fixed(self.value, self.digits)} {self.unit}".rstrip()

    @property
    def interval(self) -> str:
        """The interval, without the unit."""
        if not (math.isfinite(self.low) and math.isfinite(self.high)):
            return "open"
        return format_interval(self.low, self.high, self.digits)


def decimal_places(value: float, low: float, high: float) -> int:
    """Decimals of a number that has an interval; negative ones are zeros before the point."""
    half = 0.5 * (high - low)
    size = abs(value) or 1.0
    finest = _MOST_DIGITS - 1 - math.floor(math.log10(size))
    if not math.isfinite(half):
        return 3 - math.floor(math.log10(size))
    if half <= 0.0:
        return finest
    return min(1 - math.floor(math.log10(half)), finest)


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
class Units:
    """Units in which the coordinate and its forces are shown.

    Attributes
    ----------
    length : str
    scale : float
        Of a coordinate in SI, into that.
    stiffness, damping, friction : str
    inertia : float
        Times the law's stiffness and damping.
    """

    length: str
    scale: float
    stiffness: str
    damping: str
    friction: str
    inertia: float


def engineering_units(angle: bool, mass: float | None) -> Units:
    """Those of a height or an angle, for a mass [kg] (or moment of inertia) that may be known."""
    if angle:
        return Units("°", 180.0 / math.pi, "N m/rad per kg m²", "N m s/rad per kg m²", "rad/s²", 1.0)
    if mass is None:
        return Units("mm", 1e3, "N/m per kg", "N s/m per kg", "m/s²", 1.0)
    return Units("mm", 1e3, "N/m", "N s/m", "N", mass)


def engineering_quantities(model: ReducedModel, angle: bool, mass: float | None) -> tuple[Quantity, ...]:
    """Figures of the swing about rest; none where the law has no level of rest.

    A damping ratio that the record's own peaks contradict gives way to theirs, and what follows
    from it is left out.
    """
    rest = model.at_rest
    if rest is None:
        return ()
    units = engineering_units(angle, mass)
    shortest, longest = rest.intervals["period"]
    fraction = 0.5 * (longest - shortest) / rest.period  # of the frequency, half its interval
    stiffness = units.inertia * (2.0 * math.pi / rest.period) ** 2
    if (seen := rest.peaks) is not None:
        damping = [_ratio(" by the record's peaks", seen.mean, (seen.low, seen.high))]
    elif rest.equivalent is not None:
        damping = _two_amplitude_figures(rest, rest.equivalent, units)
    else:
        damping = _small_swing_figures(rest, fraction)
    quantities = [
        Quantity(
            "level of rest",
            "z",
            units.length,
            *(units.scale * value for value in (rest.height, *rest.intervals["height"])),
        ),
        Quantity("natural frequency", "f", "Hz", *_inverse(rest.period, shortest, longest)),
        *damping,
        _symmetric(stiffness, 2.0 * fraction, "stiffness", "k", units.stiffness),
    ]
    if damping[0].name == DAMPING_RATIO:
        ratio, (least, most) = rest.damping_ratio, rest.intervals["damping_ratio"]
        wide = 0.5 * (most - least) / abs(ratio) if ratio else math.inf
        value = units.inertia * 4.0 * math.pi * ratio / rest.period
        quantities.append(_symmetric(value, math.hypot(fraction, wide), "damping", "c", units.damping))
    return tuple(quantities)


def _small_swing_figures(rest: AtRest, fraction: float) -> list[Quantity]:
    ratio, (least, most) = rest.damping_ratio, rest.intervals["damping_ratio"]
    quantities = [_ratio("", ratio, (least, most))]
    if 0.0 < ratio < _UNDERDAMPED:
        quantities += [
            _symmetric(damped_frequency(rest.period, ratio), fraction, "damped frequency", "f_d", "Hz"),
            _by_ratio(_decrement, ratio, least, most, "logarithmic decrement", "δ", ""),
            _by_ratio(lambda ratio_: 0.5 / ratio_, ratio, most, least, "quality factor", "Q", ""),
        ]
    return quantities


def _two_amplitude_figures(
    rest: AtRest, equivalent_damping: EquivalentDamping, units: Units
) -> list[Quantity]:
    wide, narrow = (
        f" at {units.scale * size:.3g} {units.length}"
        for size in (equivalent_damping.amplitude, equivalent_damping.tenth)
    )
    quantities = [
        _ratio(wide, rest.damping_ratio, rest.intervals["damping_ratio"]),
        _ratio(narrow, equivalent_damping.tenth_ratio, equivalent_damping.intervals["tenth_ratio"]),
    ]
    if equivalent_damping.friction > 0.0:
        friction = (
            units.inertia * value
            for value in (equivalent_damping.friction, *equivalent_damping.intervals["friction"])
        )
        quantities.append(Quantity("friction", "F", units.friction, *friction))
    return quantities


def _ratio(where: str, value: float, ends: tuple[float, float]) -> Quantity:
    return Quantity(f"{DAMPING_RATIO}{where}", "ζ", "%", *(100.0 * entry for entry in (value, *ends)))


def small_swing_sentence(model: ReducedModel) -> str:
    """Swing that a model's figures are of."""
    rest = model.at_rest
    return "small swing" if rest is None or rest.equivalent is None else "swing"


def damped_frequency(period: float, ratio: float) -> float:
    """Frequency [Hz] of a damped swing with that undamped period [s] and damping ratio."""
    return math.sqrt(1.0 - ratio**2) / period


def _decrement(ratio: float) -> float:
    """Logarithm of two amplitudes a period apart."""
    return 2.0 * math.pi * ratio / math.sqrt(1.0 - ratio**2)


def _inverse(value: float, low: float, high: float) -> tuple[float, float, float]:
    return 1.0 / value, 1.0 / high if high else math.inf, 1.0 / low if low > 0.0 else math.inf


def _symmetric(value: float, fraction: float, name: str, symbol: str, unit: str) -> Quantity:
    half = abs(value) * fraction if math.isfinite(fraction) else math.inf
    return Quantity(name, symbol, unit, value, value - half, value + half)


def _by_ratio(
    function: Callable[[float], float],
    ratio: float,
    low: float,
    high: float,
    name: str,
    symbol: str,
    unit: str,
) -> Quantity:
    """Quantity that grows with the damping ratio; or falls, where its ends change places."""
    ends = [function(value) if 0.0 < value < _UNDERDAMPED else math.inf for value in (low, high)]
    return Quantity(name, symbol, unit, function(ratio), *ends)


def cycles_at_amplitudes(model: ReducedModel, heights: np.ndarray) -> list[HarmonicCycle]:
    """Cycles about rest, from the greatest amplitude of some heights down to a tenth of it."""
    if model.at_rest is None or model.law.inputs:
        return []
    farthest = float(np.abs(heights - model.at_rest.height).max())
    cycles = []
    for fraction in FRACTIONS:
        try:
            cycle = model.cycle(fraction * farthest)
        except GranularError:
            continue
        if cycle.stiffness > 0.0:
            cycles.append(cycle)
    return cycles


@dataclasses.dataclass(frozen=True)
class Figure:
    """A number with all its uncertainties.

    Attributes
    ----------
    value : float
    interval : (float, float)
        Confidence interval of the fit.
    step_error : float or None
        Estimated error of the simulation's time step, from a run with another step and the same fit
        of the same law; see `reduced_models.identification.checks.scene_with_other_step`.
    seed_spread : float or None
        Standard deviation over random starts of the bed.
    """

    value: float
    interval: tuple[float, float]
    step_error: float | None = None
    seed_spread: float | None = None

    @property
    def checked(self) -> bool:
        """True where a further run says something of it."""
        return self.step_error is not None or self.seed_spread is not None


def rest_figures(model: ReducedModel) -> dict[str, Figure]:
    """Return rest height, period and damping ratio of a model; none where it has no rest."""
    if model.at_rest is None:
        return {}
    values = dataclasses.asdict(model.at_rest)
    return {name: Figure(values[name], pair) for name, pair in model.at_rest.intervals.items()}


def propagate_error(quantity: Quantity, figures: Mapping[str, Figure], which: str) -> str:
    """Error of a quantity that follows from rest, period and damping ratio, by a check.

    ``which`` is ``"step_error"`` or ``"seed_spread"``; empty where that is not known.
    """
    known = {name: getattr(figure, which) for name, figure in figures.items()}
    if any(known.get(name) is None for name in ("height", "period", "damping_ratio")):
        return ""
    if quantity.name == "level of rest":
        rest = figures["height"]
        return format_number(abs(quantity.value * known["height"] / rest.value), 2) if rest.value else ""
    period = known["period"] / figures["period"].value
    ratio = known["damping_ratio"] / abs(figures["damping_ratio"].value or math.inf)
    if quantity.symbol in _BY_RATIO:
        relative = ratio
    elif quantity.name == "stiffness":
        relative = 2.0 * period
    else:
        relative = math.hypot(period, ratio) if quantity.name == "damping" else period
    return format_number(abs(quantity.value) * relative, 2)


def swing_text(
    quantities: Sequence[Quantity], figures: Mapping[str, Figure], angle: bool, mass: float | None
) -> str:
    """Rest, frequency, damping and stiffness of the swing in a sentence or two."""
    known = {quantity.name: widen(quantity, figures) for quantity in quantities}
    rest, frequency = (known[name].text for name in ("level of rest", "natural frequency"))
    words = (
        f"{'The angle' if angle else 'The piston'} comes to rest at {rest}, and small swings about "
        f"that have {frequency}{_damping_text(known)}."
    )
    if mass is not None and "damping" in known:
        words += (
            f" A mass of {mass:.4g} kg on a spring of {known['stiffness'].text} with a dashpot of "
            f"{known['damping'].text} does the same."
        )
    return words


def widen(quantity: Quantity, figures: Mapping[str, Figure]) -> Quantity:
    """Quantity whose interval is no narrower than its step error and scatter."""
    errors = [propagate_error(quantity, figures, name) for name in ("step_error", "seed_spread")]
    wide = max([0.5 * (quantity.high - quantity.low), *(float(error) for error in errors if error)])
    return quantity._replace(low=quantity.value - wide, high=quantity.value + wide)


def _damping_text(known: Mapping[str, Quantity]) -> str:
    """Damping, behind the frequency of small swings."""
    if DAMPING_RATIO in known:
        words = f" and a damping ratio of {known[DAMPING_RATIO].text}"
        if "logarithmic decrement" in known:
            left = math.exp(-known["logarithmic decrement"].value)
            words += f": each swing is {100 * left:.3g} % as wide as the one before"
        return words
    ratios = [
        f"{figure.text}{name.removeprefix(DAMPING_RATIO)}"
        for name, figure in known.items()
        if name.startswith(DAMPING_RATIO)
    ]
    words = f". The damping ratio is {' and '.join(ratios)}"
    return words + (f"; friction is {known['friction'].text}" if "friction" in known else "")


def amplitude_text(cycles: Sequence[HarmonicCycle], units: Units) -> str:
    """Change of frequency and damping from the narrowest cycle to the widest; empty without two."""
    if len(cycles) < 2:
        return ""
    wide, narrow = cycles[0], cycles[-1]
    frequency = 100.0 * (wide.frequency / narrow.frequency - 1.0)
    damping = 100.0 * (wide.damping / narrow.damping - 1.0) if narrow.damping else math.inf
    return (
        f" At an amplitude of {units.scale * wide.amplitude:.3g} {units.length} the frequency is "
        f"{_change_text(frequency)} and the damping {_change_text(damping)} than at "
        f"{units.scale * narrow.amplitude:.3g} {units.length}."
    )


def _change_text(per_cent: float) -> str:
    if not math.isfinite(per_cent):
        return "other"
    if abs(per_cent) < _NO_CHANGE:
        return "no other"
    return f"{abs(per_cent):.2g} % {'higher' if per_cent > 0.0 else 'lower'}"
