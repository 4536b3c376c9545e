"""Quantities with errors and printed digits, and the blocks of all print-outs.

`identify`, `fit`, `discover`, `compare` and `design` use these blocks, so that all print-outs use the
same terms, for example natural frequency f0, damping ratio zeta and equilibrium z0.
"""

from __future__ import annotations

import dataclasses
import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

from granular.shared.blocks import COLUMNS, align_columns, format_number
from granular.studies.packing_spread import NO_TABLE, ExpectedSpread, PackingSpread
from reduced_models.models.plain_data import Interval, Probability, Size, SizeOrInfinity, TextForm

PARTS = ("fit", "step", "start", "calibration")
"""Parts of an error at 95 %: half-width of the fit's interval, change with another time step, half-width of
the interval over random packings, and uncertainty of the sensor's calibration."""
ERROR_SOURCES = {
    "fit": "fit",
    "step": "time step",
    "start": "random packing",
    "calibration": "sensor calibration",
}
"""Printed names of these parts."""
DAMPING_RATIO = "damping ratio"
LEVEL = "level of rest"
EQUIVALENT_FRICTION = "Feq"
_LABELS = {LEVEL: "equilibrium", "friction": "dry friction", EQUIVALENT_FRICTION: "equivalent friction"}
_MOST_DIGITS = 8


class QuantityWithError(NamedTuple):
    """A number with its error."""

    name: str
    symbol: str
    unit: str
    value: float
    parts: Mapping[str, float]  # parts of the error by the names in `PARTS`, in the quantity's unit
    packings: str = ""  # origin of the part "start": number of packings, and of packings in a table

    @property
    def label(self) -> str:
        """Printed name; the key in plain data, ``name``, may also contain an amplitude."""
        return _LABELS.get(self.symbol) or _LABELS.get(self.name, self.name.partition(" at ")[0])

    @property
    def total_error(self) -> float:
        """Parts added in quadrature, in the quantity's unit; infinite if undetermined."""
        return math.hypot(*self.parts.values())

    @property
    def decimals(self) -> int:
        """Number of decimals at which the error has two digits."""
        return decimal_places_of_interval(
            self.value, self.value - self.total_error, self.value + self.total_error
        )

    @property
    def text_without_error(self) -> str:
        """Text of the value and its unit; the error determines the number of decimals."""
        return f"{format_fixed(self.value, self.decimals)} {self.unit}".rstrip()

    @property
    def text_with_error(self) -> str:
        """Text of the value, its total error and its unit; the error determines the number of decimals."""
        value, error = format_fixed(self.value, self.decimals), self.total_error
        if error < 0.5 * 10.0**-self.decimals:  # for a law, or a record without noise
            return f"{self.value:.6g} {self.unit}".rstrip()
        if not math.isfinite(error):
            return f"{value} {self.unit}".rstrip() + " (not determined)"
        width = f"{error:.2g}" if "e" in value else f"{round(error, self.decimals):.{max(0, self.decimals)}f}"
        return f"{value} ± {width} {self.unit}".rstrip()

    @property
    def table_cell(self) -> str:
        """Text of the value and its total error without the unit, for a table."""
        return self.text_with_error.removesuffix(f" {self.unit}")

    def to_plain(self) -> dict[str, Any]:
        """Return value, unit, total error and its parts as plain data, with None for unknown numbers."""
        return {
            "value": self.value,
            "unit": self.unit,
            "total_error": self.total_error if math.isfinite(self.total_error) else None,
            "parts": {name: self.parts.get(name) for name in PARTS},
            "packings": self.packings or None,
        }


def decimal_places_of_interval(value: float, low: float, high: float) -> int:
    """Return the number of decimals of a value with an interval; -1 means rounding to tens."""
    half = 0.5 * (high - low)
    size = abs(value) or 1.0
    finest = _MOST_DIGITS - 1 - math.floor(math.log10(size))
    if not math.isfinite(half):
        return 3 - math.floor(math.log10(size))
    if half <= 0.0:
        return finest
    return min(1 - math.floor(math.log10(half) + 1e-9), finest)


def format_fixed(value: float, digits: int) -> str:
    """Return a number as text with ``digits`` decimals; very large or small numbers have an exponent."""
    digits = digits if value else min(digits, _MOST_DIGITS)
    size = abs(value)
    if value and not 1e-4 <= size < 1e7:
        return f"{value:.{max(0, digits + math.floor(math.log10(size)))}e}"
    return f"{round(value, digits):.{max(0, digits)}f}"


def format_interval(low: float, high: float, digits: int) -> str:
    """Return an interval as text with ``digits`` decimals, rounded outwards to contain the exact interval."""
    last = 10.0**-digits
    slack = 1e-6 * last  # keeps numbers with few decimals from being rounded outwards
    if round(low, digits) > low + slack:
        low = round(low, digits) - last
    if round(high, digits) < high - slack:
        high = round(high, digits) + last
    return f"{format_fixed(low, digits)} to {format_fixed(high, digits)}"


def add_step_and_packing_errors(
    figures: Sequence[QuantityWithError],
    step: Sequence[float] | None,
    *starts: Sequence[QuantityWithError] | None,
    spread: PackingSpread | None = None,
    seconds: float | None = None,
) -> tuple[QuantityWithError, ...]:
    """Add to quantities the error of the time step and the spread over random packings.

    ``step`` has the error of each quantity due to the time step; ``starts`` are the quantities of other
    packings. Their spread is pooled with the predicted ``spread``, taken from a table of beds, unless
    the two contradict each other. ``seconds`` is the computing time of one packing, for the print-out.
    """
    scattered = [other for other in starts if other is not None]
    checked = []
    for k, figure in enumerate(figures):
        parts = dict(figure.parts)
        if step is not None:
            parts["step"] = step[k]
        values = [figure.value, *(other[k].value for other in scattered)]
        expected, origin = expected_spread_of_quantity(figure, spread), figure.packings
        if expected.is_contradicted_by(values):
            expected = NO_TABLE
        if scattered or expected.degrees_of_freedom:
            parts["start"] = expected.pool_with_values(values).half_width()
            origin = packings_text(len(values), spread if expected.degrees_of_freedom else None, seconds)
        checked.append(figure._replace(parts=parts, packings=origin))
    return tuple(checked)


def expected_spread_of_quantity(figure: QuantityWithError, spread: PackingSpread | None) -> ExpectedSpread:
    """Return a quantity's tabulated spread over packings, in its unit; `NO_TABLE` if none is tabulated."""
    if spread is None:
        return NO_TABLE
    if figure.symbol == figure.name:  # a parameter of a law, with any meaning
        return NO_TABLE
    name = figure.name.partition(" at ")[0]
    frequency, ratio = spread.frequency, spread.damping_ratio
    both = ExpectedSpread(
        math.hypot(frequency.deviation, ratio.deviation),
        min(frequency.degrees_of_freedom, ratio.degrees_of_freedom),
    )
    relative = {
        LEVEL: spread.height,
        "natural frequency": frequency,
        "damped frequency": frequency,
        "frequency": frequency,
        "stiffness": frequency._replace(deviation=2.0 * frequency.deviation),
        DAMPING_RATIO: ratio,
        "logarithmic decrement": ratio,
        "quality factor": ratio,
        "damping": both,
    }.get(name, NO_TABLE)
    return relative._replace(deviation=abs(figure.value) * relative.deviation)


def packings_text(packings: int, spread: PackingSpread | None = None, seconds: float | None = None) -> str:
    """Describe the packings that determine a spread; a further packing takes ``seconds`` to compute."""
    own = f"{packings} packing{'s' * (packings > 1)}"
    if spread is not None:
        return f"{own} and a table of {spread.packings}"
    return own if seconds is None else f"{own}; --packings: {format_number(seconds, 2)} s for each more"


SURE = 1e-4
"""Residuals are not white noise if the p-value is below this."""
_ANYTHING = 7.0  # standard deviation of a logarithm: a factor of a thousand


@dataclasses.dataclass(frozen=True)
class ParameterDirection:
    """A joint change of parameters that hardly changes the fit."""

    powers: Mapping[str, float]  # joint change: each parameter is multiplied by t to this power
    spread: Size  # standard deviation of log t allowed by the data

    @property
    def is_undetermined(self) -> bool:
        """True if the data allow any change of the parameters along this direction."""
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
        Root mean square [m] of the difference between record and model.
    relative : float
        ``residual`` divided by the rms displacement of the record.
    test_error : float or None
        Rms prediction error over the held-out cycles, from a fit without these cycles. It is relative to
        the rms displacement of the complete record, and infinite if the simulation diverges. Compare it with
        ``test_error_at_rest``.
    test_swings : sequence of (float, float)
        Start and end time of each held-out part, from the record's start [s]. If the motion has few
        cycles, the single entry is the end of the motion.
    starts, converged : int
        Number of random starts, and number of starts that led to the best fit.
    independent : int or None
        Number of independent starts that led to the best fit. Starts that differ only slightly, such as
        starts near a given value, count as one. None in files of earlier versions.
    samples : int
        Number of samples of the record.
    solver_error : float
        Maximum difference between the fitted solution and an adaptive one at a tolerance of 1e-10,
        relative to the amplitude.
    test_error_at_rest : float or None
        ``test_error`` for a motionless piston, for comparison. The height of this piston is the mean of the
        last third of the samples outside the held-out cycles.
    test_standard_error : float or None
        Standard error of ``test_error``, from the scatter between held-out cycles; None for one cycle.
    shifts : mapping of str to float
        Relative changes of period and damping ratio of small oscillations if the held-out cycles are
        excluded from the fit. They show the effect of the law's misfit.
    noise : float
        Standard deviation of white noise in the record, from its third differences [m].
    correlation : float
        Integrated autocorrelation time of the residuals, in samples.
    collocation : str
        Comparison of the first fit with a second fit, which starts from the record's accelerations: the
        second fit is the ``"same"``, ``"worse"``, or ``"better"`` (and is then used). ``"none"`` if there was
        no second fit, or if it started from known parameters instead.
    whiteness : float
        Probability that white noise is at least as strongly correlated as the residuals (test of Dalla,
        Giraitis & Phillips).
    signs : float
        Probability that white noise changes sign as rarely, or as often, as the residuals (test of Wald
        & Wolfowitz).
    lag : float
        Time by which the solution lags behind the record [s].
    slow, swinging : float
        Fractions of the residuals' power below the oscillation frequency, and near it.
    drift : float
        Low-frequency power of the residuals relative to white noise of the same power.
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
    independent: int | None = None

    @property
    def has_structured_residuals(self) -> bool:
        """True if residuals above rounding differ significantly from white noise, a sign of a wrong law."""
        return not self.rounded and min(self.whiteness, self.signs) < SURE

    @property
    def search_text(self) -> str:
        """Text on the number of starts that led to the best fit, and whether they are independent."""
        text = f"{self.converged} of {self.starts} starts end here"
        if self.independent is None or self.independent >= self.converged:
            return text
        if self.independent == 1:
            return f"{text} (all near one estimate)"
        return f"{text} ({self.independent} independent)"

    @property
    def held_out_part_text(self) -> str:
        """Held-out part of the record, in words."""
        if len(self.test_swings) > 1:
            return f"{len(self.test_swings)} held-out cycles"
        return "the end of the motion (too few cycles to distribute)"

    @property
    def period_and_damping_shifts_text(self) -> str:
        """Text on the changes of period and damping in a fit without the held-out cycles; may be empty."""
        changes = {name.replace("_", " "): f"{100.0 * by:.1g}" for name, by in self.shifts.items()}
        words = [f"{name} by {size} %" for name, size in changes.items() if float(size) > 0.0]
        if not words:
            return ""
        return f"; a fit without {self.held_out_part_text} changes {' and '.join(words)}"


_SKEW = 0.2  # distance between an interval's middle and the value, over the half-width
_EXACT = 1e-6  # relative error: smaller ones are due to rounding
_JOIN = "\N{NO-BREAK SPACE}"  # keeps a parameter and its error on one line


def record_title_and_property_lines(texts: Sequence[str]) -> list[str]:
    """Return lines with the title of a record and, indented below, the properties of its samples."""
    return [line for k, text in enumerate(texts) for line in wrap_words(text, "  " * (k > 0))]


def quantity_rows(figures: Sequence[QuantityWithError], mass: float | None = None) -> list[list[str]]:
    """Return label, symbol, value with error, and remark of each quantity; ``mass`` is in kg."""
    known = {figure.name: figure for figure in figures}
    ratios = [name for name in known if name.startswith(DAMPING_RATIO)]
    remarks = {name: _damping_ratio_text(known[name]) for name in ratios}
    if (damping := known.get("damping")) is not None:
        of_mass = "" if mass is None else f" (for {mass:.4g} kg)"
        remarks["stiffness"] = f"damping c {damping.text_with_error}{of_mass}"
    if (damped := known.get("damped frequency")) is not None:
        remarks["natural frequency"] = f"damped {_derived_value_text(damped)} Hz"
    rows = [
        [known[name].label, known[name].symbol, known[name].text_with_error, remarks.get(name, "")]
        for name in ("natural frequency", *ratios, "friction", "stiffness", LEVEL)
        if name in known
    ]
    # A motion over two wells is described by other quantities.
    return rows or [[item.name, item.symbol, item.text_with_error, ""] for item in figures]


def error_sources_text(figures: Sequence[QuantityWithError], confidence: float) -> str:
    """Return a text on the confidence level of the intervals and the sources of the errors."""
    parts = [part for part in PARTS if any(part in figure.parts for figure in figures)]
    names = ERROR_SOURCES.copy()
    packings = next((figure.packings for figure in figures if figure.packings), "")
    if packings:
        names["start"] += f" ({packings})"
    sources = ", ".join(names[part] for part in parts)
    if "start" in parts:  # simulated figures do not include errors of the force laws
        sources += "; force laws and parts taken as exact"
    return f"these ± are {100.0 * confidence:g} % intervals: {sources}"


def quantity_lines(
    figures: Sequence[QuantityWithError],
    mass: float | None = None,
    confidence: float = 0.95,
    amplitude: str = "",
) -> list[str]:
    """Return the lines of the printed quantities, with the amplitudes and the sources of errors."""
    rows = quantity_rows(figures, mass)
    if not rows:
        return []
    margin = sum(max(len(row[k]) for row in rows) for k in (0, 1)) + 6
    lines = [f"  {line}" for line in align_columns(rows).splitlines()]
    if amplitude:
        lines += wrap_words(amplitude, "  amplitude".ljust(margin), " " * margin)
    if any(figure.total_error for figure in figures):
        lines += wrap_words(error_sources_text(figures, confidence), "  ", "  ")
    return lines


def _damping_ratio_text(ratio: QuantityWithError) -> str:
    """Return a remark on a damping ratio [%]: amplitude, logarithmic decrement and quality factor."""
    at_amplitude = ratio.name.removeprefix(DAMPING_RATIO).strip()
    words = f"of critical{' ' * bool(at_amplitude)}{at_amplitude}"
    value = ratio.value / 100.0
    if not 0.0 < value < 1.0:
        return words
    relative = ratio.total_error / ratio.value
    decrement, quality = (
        _derived_value_text(ratio._replace(value=size, parts={"fit": relative * size}))
        for size in (math.tau * value / math.sqrt(1.0 - value**2), 0.5 / value)
    )
    return f"{words}; log decrement {decrement}, Q {quality}"


def _derived_value_text(item: QuantityWithError) -> str:
    """Return the text of a derived value without its error, to at most four digits."""
    maximum_decimals = 3 - math.floor(math.log10(abs(item.value)))
    return format_fixed(item.value, min(item.decimals, maximum_decimals))


def equation_lines(
    equation: str, parameters: Sequence[QuantityWithError], intervals: Mapping[str, tuple[float, float]]
) -> list[str]:
    """Return the equation, and parameters with errors, or with their intervals if these are asymmetric."""
    values = (parameter_text(item, intervals.get(item.name)) for item in parameters)
    return [*wrap_words(equation), *wrap_words(", ".join(value.replace(" ", _JOIN) for value in values))]


def parameter_text(item: QuantityWithError, interval: tuple[float, float] | None) -> str:
    """Return the text of a parameter with its error, or with its interval if this is asymmetric."""
    if interval is not None and set(item.parts) == {"fit"} and math.isfinite(item.total_error):
        low, high = interval
        if abs(low + high - 2.0 * item.value) > _SKEW * (high - low):
            ends = format_interval(low, high, item.decimals)
            return f"{item.name} {item.text_without_error} ({ends})"
    return f"{item.name} {item.text_with_error}"


def caution_lines(cautions: Sequence[str], most: int | None = None) -> list[str]:
    """Return lines of cautions in their order, without the cautions that exceed ``most`` lines."""
    lines: list[str] = []
    for count, words in enumerate(dict.fromkeys(cautions)):
        new = wrap_words(f"caution: {words}", "", "  ")
        remaining = len(dict.fromkeys(cautions)) - count
        if most is not None and lines and len(lines) + len(new) + (remaining > 1) > most:
            return [*lines, f"{remaining} more: --verbose, or the report"]
        lines += new
    return lines


def wrap_words(words: str, indent: str = "  ", later: str = "    ") -> list[str]:
    """Break a text at spaces into lines of at most 100 columns."""
    lines = textwrap.wrap(
        words, COLUMNS, initial_indent=indent, subsequent_indent=later, break_on_hyphens=False
    )
    return [line.replace(_JOIN, " ") for line in lines]


def format_percent(fraction: float, standard_error: float = 0.0) -> str:
    """Return an error in per cent, with its standard error if not zero, or "diverges" if infinite."""
    if math.isinf(fraction):
        return "diverges"
    if 0.0 < fraction < _EXACT:
        return f"< {100.0 * _EXACT:.4f} %"
    spread = f" ± {format_number(100.0 * standard_error, 2)}" if standard_error else ""
    percent = f"{100.0 * fraction:.3g}" if fraction < 10.0 else f"{100.0 * fraction:.0f}"
    return f"{percent}{spread} %"
