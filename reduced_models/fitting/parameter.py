"""Values and bounds of a law's parameters that are known before a fit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from granular.schema.units import si_value
from granular.shared.array_types import Float
from granular.shared.errors import InputError, quote, unknown_word_message
from reduced_models.laws.law import Law
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.records.sensor import Sensor

Quantity = float | str


@dataclasses.dataclass(frozen=True)
class Parameter:
    """Value and bounds of a parameter of a law that are known before a fit.

    Numbers are in SI units. A string such as ``"2.5 N/m"`` contains a unit; it is allowed if the law
    defines the unit of the parameter.

    Parameters
    ----------
    value : float or str, or a sequence of them, optional
        Start value of the search, or the fixed value. A sequence gives one fixed value for each
        record, such as the length of each pendulum.
    low, high : float or str, optional
        Lower and upper bound; None means no bound. If ``low`` is 0 or more, the parameter is positive and the
        search varies its logarithm.
    fixed : bool
        Whether the parameter keeps its value.
    per_record : bool
        Whether each of several records has a separate value; otherwise they share one.

    Raises
    ------
    InputError
        If a value is not a number, the bounds are not in order, a value lies outside them, a fixed
        parameter has no value, or several values are not fixed.

    Examples
    --------
    >>> from reduced_models import Parameter
    >>> Parameter(2.0, low=0.0)
    Parameter(value=2.0, low=0.0, high=None, fixed=False, per_record=False)
    """

    value: Quantity | Sequence[Quantity] | None = None
    low: Quantity | None = None
    high: Quantity | None = None
    fixed: bool = False
    per_record: bool = False

    def __post_init__(self) -> None:
        if _is_list_of_values(self.value) and not self.fixed:
            raise InputError(
                "a list of values, one for each record, must be fixed; add fixed=True, or give one value"
            )
        if self.fixed and self.value is None:
            raise InputError("the parameter is fixed but has no value; give a value")
        _values_and_bounds(self, None)


Parameters = Mapping[str, Parameter | Quantity]


def parameters_by_name(given: Parameters | None) -> dict[str, Parameter]:
    """Return parameters by name; a value alone becomes a start value."""
    if not isinstance(given, Mapping | None):
        raise InputError(
            f"parameters = {quote(given)} is not a mapping; give one, as {{'k': Parameter(low=0)}}"
        )
    return {
        name: value if isinstance(value, Parameter) else Parameter(value)
        for name, value in (given or {}).items()
    }


def parse_si_number(quantity: str, given: object, unit: str | None) -> float:
    """Return a value in SI units; a string is converted to ``unit``, or becomes NaN if ``unit`` is None."""
    try:
        result = math.nan if isinstance(given, bool) else float(given)  # type: ignore[arg-type]  # tried
    except (TypeError, ValueError):
        result = math.nan
    if not math.isnan(result):
        return result
    if not isinstance(given, str):
        raise InputError(
            f"{quantity} = {quote(given)} is not a number; give a number, or a string such as '2.5 N/m'"
        )
    if unit is None:
        return math.nan
    if not unit:
        raise InputError(
            f"{quantity} = {quote(given)}, but the law defines no unit for it; give a number in SI units"
        )
    if unit == "rad/s" and "Hz" in given:
        raise InputError(
            f"{quantity} = {quote(given)} is a frequency; give the angular frequency, 2 pi times it, in rad/s"
        )
    return si_value(given, unit)


def _is_list_of_values(value: object) -> bool:
    return isinstance(value, Sequence | np.ndarray) and not isinstance(value, str)


def _values_and_bounds(known: Parameter, unit: str | None) -> tuple[list[float], float, float]:
    """Return the values, lower bound and upper bound of a parameter; ``unit`` as in `parse_si_number`."""
    low = -math.inf if known.low is None else parse_si_number("low", known.low, unit)
    high = math.inf if known.high is None else parse_si_number("high", known.high, unit)
    if low == high:
        raise InputError(f"low and high are both {low:g}; give value={low:g}, fixed=True")
    if low > high:
        raise InputError(f"low = {low:g} and high = {high:g}, but low must be less than high; change them")
    given: Any = (
        known.value if _is_list_of_values(known.value) else [] if known.value is None else [known.value]
    )
    values = [parse_si_number("value", item, unit) for item in given]
    for value in values:
        if value < low or value > high or math.isinf(value):
            raise InputError(
                f"value = {value:g} lies outside its bounds {low:g} to {high:g}; change value or bounds"
            )
    return values, low, high


def has_value_per_record(known: Parameter) -> bool:
    """Return whether each of several records has a separate value."""
    return known.per_record or _is_list_of_values(known.value)


class ParameterSettings(NamedTuple):
    """Values and bounds of parameters for a search, in SI units."""

    law: Law  # with its positive parameters
    bounds: dict[str, tuple[float, float]]  # equal for a fixed value
    start: dict[str, float]
    by_record: tuple[dict[str, float], ...]  # fixed values of each record
    per_record: tuple[str, ...]  # parameters with a separate value for each record


def parameter_settings(law: Law, parameters: Mapping[str, Parameter], records: int) -> ParameterSettings:
    """Check parameters against a law and the number of records; return values and bounds."""
    bounds, start, separate, positive = {}, {}, [], list(law.positive)
    by_record: tuple[dict[str, float], ...] = tuple({} for _ in range(records))
    check_parameter_names(parameters, law.parameters)
    for name, known in parameters.items():
        try:
            values, low, high = _values_and_bounds(known, law.units.get(name, ""))
            if low >= 0.0 and not known.fixed and name not in positive:
                positive.append(name)
            if name in positive and min([high, *values]) <= 0.0:
                raise InputError("its bounds or the law require a positive value; give a value above 0")
            if _is_list_of_values(known.value) and len(values) != records:
                raise InputError(
                    f"{len(values)} values for {records} records; give one value for each record"
                )
        except InputError as error:
            raise InputError(f"parameter {name}: {error}") from None
        if has_value_per_record(known):
            separate.append(name)
        if _is_list_of_values(known.value):
            for fixed, value in zip(by_record, values, strict=True):
                fixed[name] = value
        elif known.fixed:
            bounds[name] = (values[0], values[0])
        else:
            if values:
                start[name] = values[0]
            if low > (0.0 if name in positive else -math.inf) or high < math.inf:
                bounds[name] = (low, high)
    if sum(low == high for low, high in bounds.values()) + len(by_record[0]) == len(law.parameters):
        raise InputError("all parameters are fixed, so there is nothing to fit; let one vary")
    law = dataclasses.replace(law, positive=tuple(positive))
    return ParameterSettings(law, bounds, start, by_record, tuple(separate))


def check_parameter_names(names: Iterable[str], parameters: Sequence[str]) -> None:
    """Check that names are among the parameters of a law, or of several."""
    for name in names:
        if name not in parameters:
            raise InputError(unknown_word_message(str(name), parameters, "parameter"))


def fixed_height_map_parameters(model: FittedLaw) -> dict[str, Parameter]:
    """Return, as fixed parameters, the linear map from a discovered model's coordinate to the height."""
    line = model.law.parsed_equation.line or ()
    names = {symbol.name for item in line for symbol in item.free_symbols}
    return {
        name: Parameter(model.all_parameters[name], fixed=True)
        for name in sorted(names)
        if name in model.intervals and model.intervals[name][0] == model.intervals[name][1]
    }


Pairs = Mapping[str, tuple[float, float]]
"""Lower and upper bounds of parameters, by name."""

# Width of the prior: for a logarithm, a factor of e^3 = 20 either way. The prior keeps undetermined
# directions from diverging. It has the information of one sample, so it hardly shifts quantities that a
# record determines.
_PRIOR_SPREAD = 3.0


@dataclasses.dataclass(frozen=True)
class SearchUnknowns:
    """A law, and the scales of the entries of its search vector."""

    # The search vector holds the parameters (logarithms of positive ones; others in multiples of `units`),
    # then initial displacement from equilibrium, velocity and hidden states, then a sensor's gain and offset,
    # if fitted, and the state of its filter. Heights are in units of the amplitude.

    law: Law
    units: tuple[float, ...]  # units of the parameters that are not logarithms; 1 for the others
    rest: float  # [m]
    amplitude: float  # [m]
    speed: float  # amplitude times angular frequency [m/s]
    sensor: Sensor | None = None
    signal: float = 1.0  # amplitude of the compared signal, in its unit
    observation: str = ""  # compared observation of the law; empty for the height or a sensor's signal of it
    hidden_sizes: tuple[float, ...] = ()  # sizes of hidden states along a stroke; 1 if not given

    @property
    def compares_heights(self) -> bool:
        """True if heights are compared, not a signal."""
        return self.sensor is None and not self.observation

    @property
    def residual_unit(self) -> float:
        """Unit of the residuals: amplitude of the motion [m], or of the signal if a signal is compared."""
        return self.amplitude if self.compares_heights else self.signal

    @property
    def scales(self) -> np.ndarray:
        """Scale arguments of the compiled residual: equilibrium, amplitude, speed, units, sensor."""
        numbers = [self.rest, self.amplitude, self.speed, *self.units]
        if not self.compares_heights:
            sensor = self.sensor or Sensor(gain=1.0, offset=0.0)
            numbers += [
                self.signal,
                sensor.derivative_sign_in_signal * sensor.nominal_gain,
                sensor.nominal_offset,
            ]
        return np.array(numbers)

    @property
    def gain_and_offset_are_entries(self) -> tuple[bool, bool]:
        """Two flags: True if the sensor's gain, or its offset, is an entry of the search vector."""
        if self.sensor is None:
            return False, False
        gain, offset = self.sensor.gain, self.sensor.offset
        return not isinstance(gain, int | float), not isinstance(offset, int | float)

    @property
    def sensor_entry_count(self) -> int:
        """Number of the sensor's entries in a search vector: gain, offset, state of the filter."""
        return sum(self.gain_and_offset_are_entries) + (
            0 if self.sensor is None else self.sensor.filter_order
        )

    @property
    def parameters_are_logarithmic(self) -> tuple[bool, ...]:
        """True for each parameter whose logarithm is varied in the search."""
        return tuple(name in self.law.positive for name in self.law.parameters)

    @property
    def prior_precisions(self) -> np.ndarray:
        """Prior precision of each entry of the search vector, in units of the information of one sample."""
        # The initial height and velocity need none: the first samples determine them.
        hidden = [(_PRIOR_SPREAD * size) ** -2 for size in self.hidden_sizes or (1.0,) * len(self.law.hidden)]
        sensor = [_PRIOR_SPREAD**-2] * self.sensor_entry_count
        return np.array([_PRIOR_SPREAD**-2] * len(self.law.parameters) + [0.0, 0.0] + hidden + sensor)

    def physical_values(self, theta: Float[np.ndarray, "p"]) -> Any:
        """Return parameters, initial height [m], initial velocity [m/s] and hidden states."""
        motion = theta[: len(theta) - self.sensor_entry_count]
        return physical_values(motion, self.scales, self.parameters_are_logarithmic, np)

    def gain_and_offset(self, theta: Float[np.ndarray, "p"]) -> tuple[float, float]:
        """Return gain and offset of the sensor, from a search vector (p,)."""
        gain, offset, _ = gain_offset_and_filter_state(
            theta[len(theta) - self.sensor_entry_count :], self.scales, self.gain_and_offset_are_entries
        )
        assert self.sensor is not None
        return float(gain) * self.sensor.derivative_sign_in_signal, float(offset)


def lower_and_upper_search_bounds(
    unknowns: SearchUnknowns, bounds: Pairs, initial: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return both bounds (p,) of a search vector, equal for held entries; ``initial`` is in m and m/s."""
    edges = np.full((2, len(unknowns.prior_precisions)), [[-np.inf], [np.inf]])
    for k, name in enumerate(unknowns.law.parameters):
        if name not in bounds:
            continue
        for end, value in enumerate(bounds[name]):
            if name in unknowns.law.positive:
                edges[end, k] = math.log(value) if value > 0.0 else -np.inf
            else:
                edges[end, k] = value / unknowns.units[k]
    names = ("height", "velocity", *unknowns.law.hidden)
    count = len(unknowns.law.parameters)
    if unknowns.law.prescribed:  # the stroke is not a state
        edges[:, count : count + 2] = 0.0
    for k, name in enumerate(names, count):
        if name in initial:
            value = initial[name]
            if name == "height":
                value = (value - unknowns.rest) / unknowns.amplitude
            elif name == "velocity":
                value = value / unknowns.speed
            edges[:, k] = value
    if unknowns.sensor is not None:
        _set_sensor_bounds(unknowns, unknowns.sensor, edges)
    return edges[0], edges[1]


def _set_sensor_bounds(unknowns: SearchUnknowns, sensor: Sensor, edges: np.ndarray) -> None:
    """Set the bounds (2, p) of a sensor's gain or offset, if the sensor gives a pair of limits for it."""
    k = edges.shape[1] - unknowns.sensor_entry_count
    settings = (
        (sensor.gain, 0.0, sensor.nominal_gain),
        (sensor.offset, sensor.nominal_offset, unknowns.signal),
    )
    for (setting, middle, unit), is_open in zip(settings, unknowns.gain_and_offset_are_entries, strict=True):
        if isinstance(setting, tuple):
            edges[:, k] = sorted((value - middle) / unit for value in setting)
        k += is_open


def physical_values(theta: Any, scales: Any, logarithmic: tuple[bool, ...], np_: Any) -> Any:
    """Return parameters, initial height [m], velocity [m/s] and hidden states of search vectors (p, ...)."""
    rest, amplitude, speed = (scales[k] for k in range(3))
    count = len(logarithmic)
    values = tuple(
        np_.exp(theta[k]) if log else scales[3 + k] * theta[k] for k, log in enumerate(logarithmic)
    )
    return values, rest + amplitude * theta[count], speed * theta[count + 1], tuple(theta[count + 2 :])


def gain_offset_and_filter_state(
    entries: Any, scales: Any, is_open: tuple[bool, bool]
) -> tuple[Any, Any, Any]:
    """Return signed gain, offset and initial filter state from the sensor's entries."""
    signal, gain, offset = scales[-3], scales[-2], scales[-1]
    if is_open[0]:
        gain, entries = gain * entries[0], entries[1:]
    if is_open[1]:
        offset, entries = offset + signal * entries[0], entries[1:]
    return gain, offset, entries * (signal / scales[-2])
