"""Values and limits of the parameters of a law, as they are known before a fit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from granular.schema.units import si_value
from granular.shared.errors import InputError
from granular.shared.message_text import quote, unknown_word_message
from reduced_models.laws.law import Law
from reduced_models.models.fitted_law import FittedLaw

Quantity = float | str


@dataclasses.dataclass(frozen=True)
class Parameter:
    """Value and limits of a parameter of a law, as they are known before a fit.

    Numbers are in SI units; texts have units, as ``"2.5 N/m"``, where the law names the parameter's.

    Parameters
    ----------
    value : float or str, or a sequence of them, optional
        Value about which the parameter is looked for first, or the one that it keeps if it is fixed.
        Several are kept, one for each record, such as the lengths of pendulums.
    low, high : float or str, optional
        Least and greatest value; None for an open end. Where ``low`` is 0 or more the parameter is
        above zero, and is searched on the logarithmic scale.
    fixed : bool
        Whether the parameter keeps its value.
    per_record : bool
        Whether each of several records has a value for itself; otherwise they share one.

    Raises
    ------
    InputError
        If a number is none, the limits are not in order, a value lies outside them, one is lacking
        where it is fixed, or several are not fixed.

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
        if _is_list(self.value) and not self.fixed:
            raise InputError("several values are kept, one for each record; add fixed=True, or give one")
        if self.fixed and self.value is None:
            raise InputError("fixed, but without a value; give one")
        _numbers(self, None)


Parameters = Mapping[str, Parameter | Quantity]


def as_parameters(given: Parameters | None) -> dict[str, Parameter]:
    """Parameters by name; a value alone is one to begin from."""
    if not isinstance(given, Mapping | None):
        raise InputError(f"parameters = {quote(given)}; give a mapping, as {{'k': Parameter(low=0)}}")
    return {
        name: value if isinstance(value, Parameter) else Parameter(value)
        for name, value in (given or {}).items()
    }


def si_number(what: str, given: object, unit: str | None) -> float:
    """Return a number [unit]; a unit None is not known yet: texts are NaN in it. "" is one never named."""
    try:
        result = math.nan if isinstance(given, bool) else float(given)  # type: ignore[arg-type]  # tried
    except (TypeError, ValueError):
        result = math.nan
    if not math.isnan(result):
        return result
    if not isinstance(given, str):
        raise InputError(f"{what} = {quote(given)} is no number; give one, or a text such as '2.5 N/m'")
    if unit is None:
        return math.nan
    if not unit:
        raise InputError(f"{what} = {quote(given)}, and the law names no unit for it; give a number in SI")
    if unit == "rad/s" and "Hz" in given:
        raise InputError(f"{what} = {quote(given)} is a frequency; give 2 pi times it, in rad/s")
    return si_value(given, unit)


def _is_list(value: object) -> bool:
    return isinstance(value, Sequence | np.ndarray) and not isinstance(value, str)


def _numbers(known: Parameter, unit: str | None) -> tuple[list[float], float, float]:
    """Values, least and greatest value of a parameter, in an SI unit as of `si_number`."""
    low = -math.inf if known.low is None else si_number("low", known.low, unit)
    high = math.inf if known.high is None else si_number("high", known.high, unit)
    if low == high:
        raise InputError(f"low and high are both {low:g}; give value={low:g}, fixed=True")
    if low > high:
        raise InputError(f"low = {low:g} is above high = {high:g}; give them in order")
    given: Any = known.value if _is_list(known.value) else [] if known.value is None else [known.value]
    values = [si_number("value", item, unit) for item in given]
    for value in values:
        if value < low or value > high or math.isinf(value):
            raise InputError(f"value = {value:g} lies outside {low:g} to {high:g}; change one of them")
    return values, low, high


def is_per_record(known: Parameter) -> bool:
    """Return whether each of several records has a value for itself."""
    return known.per_record or _is_list(known.value)


class ParameterSettings(NamedTuple):
    """Values and limits of parameters as a search takes them, in SI units."""

    law: Law  # with the parameters that are above zero
    bounds: dict[str, tuple[float, float]]  # equal where one value is kept
    start: dict[str, float]
    by_record: tuple[dict[str, float], ...]  # values that are kept in each record
    own: tuple[str, ...]  # parameters that each record has for itself


def parameter_settings(law: Law, parameters: Mapping[str, Parameter], records: int) -> ParameterSettings:
    """Return values and limits of parameters, checked against a law and the number of records."""
    bounds, start, own, positive = {}, {}, [], list(law.positive)
    by_record: tuple[dict[str, float], ...] = tuple({} for _ in range(records))
    check_parameter_names(parameters, law.parameters)
    for name, known in parameters.items():
        try:
            values, low, high = _numbers(known, law.units.get(name, ""))
            if low >= 0.0 and not known.fixed and name not in positive:
                positive.append(name)
            if name in positive and min([high, *values]) <= 0.0:
                raise InputError("it is above 0, by its limits or by the law; give values above 0")
            if _is_list(known.value) and len(values) != records:
                raise InputError(f"{len(values)} values for {records} records; give one for each")
        except InputError as error:
            raise InputError(f"parameter {name}: {error}") from None
        if is_per_record(known):
            own.append(name)
        if _is_list(known.value):
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
        raise InputError("all parameters are fixed, so there is nothing to fit; leave one out")
    law = dataclasses.replace(law, positive=tuple(positive))
    return ParameterSettings(law, bounds, start, by_record, tuple(own))


def check_parameter_names(names: Iterable[str], parameters: Sequence[str]) -> None:
    """Check that names are among the parameters of a law, or of several."""
    for name in names:
        if name not in parameters:
            raise InputError(unknown_word_message(str(name), parameters, "parameter"))


def given_line_parameters(model: FittedLaw) -> dict[str, Parameter]:
    """Parameters of a model's line to the height that were given to its fit, as a discovery gives them."""
    line = model.law.parsed_equation.line or ()
    names = {symbol.name for item in line for symbol in item.free_symbols}
    return {
        name: Parameter(model.all_parameters[name], fixed=True)
        for name in sorted(names)
        if name in model.intervals and model.intervals[name][0] == model.intervals[name][1]
    }
