"""Options of a fit, checked before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import Any, Literal, get_args

import numpy as np

from granular.schema.field_kinds import unknown_word_message
from granular.shared.errors import InputError
from granular.shared.message_text import quote
from reduced_models.fitting.problem import Intervals
from reduced_models.laws.height_map import HeightMap
from reduced_models.laws.law import Law
from reduced_models.least_squares.residuals import LOSSES
from reduced_models.records.inputs import INTERPOLATIONS

STARTS = 16
TEST_FRACTION = 0.3
MOST_STARTS = 10_000
"""Ten times a thousand, with which a short record takes minutes."""

Bounds = Mapping[str, tuple[float | None, float | None]]
Fixed = Mapping[str, float | Sequence[float]]
Initial = Literal["free", "rest"] | Mapping[str, float | str]


def check_fit_options(
    starts: int = STARTS,
    test_fraction: float = TEST_FRACTION,
    confidence: float = 0.95,
    height_map: object = "auto",
    intervals: str = "linear",
    loss: str = "linear",
    interpolation: str | None = None,
    seed: int = 0,
) -> None:
    """Check that the options of `fit` are in their ranges."""
    if not isinstance(starts, int) or isinstance(starts, bool) or not 1 <= starts <= MOST_STARTS:
        raise InputError(f"starts = {quote(starts)}; give an integer from 1 to {MOST_STARTS}")
    if not isinstance(test_fraction, Real) or not 0.0 <= float(test_fraction) <= 0.9:
        raise InputError(f"test_fraction = {quote(test_fraction)}; give a fraction from 0 to 0.9")
    if not isinstance(confidence, Real) or not 0.0 < float(confidence) < 1.0:
        raise InputError(f"confidence = {quote(confidence)}; give a fraction between 0 and 1")
    if not isinstance(seed, Integral) or seed < 0:
        raise InputError(f"seed = {quote(seed)}; give an integer from 0 on")
    if not isinstance(height_map, HeightMap) and height_map not in ("auto", "fitted"):
        raise InputError(f"map = {quote(height_map)}; give 'auto', 'fitted' or a HeightMap")
    for name, value, known in (
        ("intervals", intervals, get_args(Intervals)),
        ("loss", loss, LOSSES),
        ("input_interpolation", interpolation or "spline", INTERPOLATIONS),
    ):
        if value not in known:
            raise InputError(f"{name} = {quote(value)}; give {_names_text(known)}")


def _names_text(names: Sequence[str]) -> str:
    return ", ".join(map(repr, names[:-1])) + f" or {names[-1]!r}"


def fixed_values(fix: Fixed, records: int) -> tuple[dict[str, float], tuple[dict[str, float], ...]]:
    """Values that parameters keep in all records, and those that they keep in each one."""
    shared: dict[str, float] = {}
    entry: tuple[dict[str, float], ...] = tuple({} for _ in range(records))
    for name, value in fix.items():
        if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str):
            if len(value) != records:
                raise InputError(
                    f"fix of {name}: {len(value)} values for {records} records; give one for each"
                )
            for own, item in zip(entry, value, strict=True):
                own[name] = _check_finite_number(f"fix of {name}", item)
        else:
            shared[name] = _check_finite_number(f"fix of {name}", value)
    return shared, entry


def parameter_bounds(
    law: Law, bounds: Bounds, fix: Mapping[str, float], by_record: Sequence[Mapping[str, float]] = ({},)
) -> dict[str, tuple[float, float]]:
    """Least and greatest values of parameters; equal ones where a value is given."""
    result = {}
    for name, pair in bounds.items():
        _check_parameter_name(law, name)
        if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
            raise InputError(
                f"bounds of {name}: {quote(pair)} is no pair; give (least, greatest), None for an open end"
            )
        low = -math.inf if pair[0] is None else _check_finite_number(f"bounds of {name}", pair[0])
        high = math.inf if pair[1] is None else _check_finite_number(f"bounds of {name}", pair[1])
        if low == high:
            raise InputError(f"bounds of {name}: both are {low:g}; write fix={{{name!r}: {low:g}}}")
        if not low < high:
            raise InputError(f"bounds of {name}: {low:g} is not below {high:g}; give them in order")
        if name in law.positive and high <= 0.0:
            raise InputError(
                f"bounds of {name}: up to {high:g}, and the law holds for values above 0; raise it"
            )
        result[name] = (low, high)
    for name, value in (*fix.items(), *(pair for own in by_record for pair in own.items())):
        _check_parameter_name(law, name)
        _check_finite_number(f"fix of {name}", value)
        if name in law.positive and value <= 0.0:
            raise InputError(f"fix of {name}: {value:g}, and the law holds for values above 0")
        low, high = result.get(name, (-math.inf, math.inf))
        if not low <= value <= high:
            raise InputError(f"fix of {name}: {value:g} lies outside its bounds; change one of them")
        if name in fix:
            result[name] = (value, value)
    if len({*fix, *by_record[0]}) >= len(law.parameters):
        raise InputError("all parameters are fixed, so there is nothing to fit; leave one out")
    return result


def parameter_starts(law: Law, start: Mapping[str, float]) -> dict[str, float]:
    """Start values of parameters, as numbers in SI units."""
    result = {}
    for name, value in start.items():
        _check_parameter_name(law, name)
        result[name] = _check_finite_number(f"start of {name}", value)
        if name in law.positive and result[name] <= 0.0:
            raise InputError(f"start of {name}: {result[name]:g}; give a value above 0")
    return result


def prescribed_initial_state(law: Law, initial: object) -> dict[str, float]:
    """Given height, velocity and hidden states at the start by name; the rest is free [m, m/s]."""
    if initial is None:
        return dict.fromkeys(law.hidden, 0.0)
    if initial == "free":
        return {}
    if initial == "rest":
        return {"velocity": 0.0, **dict.fromkeys(law.hidden, 0.0)}
    names = ("height", "velocity", *law.hidden)
    if not isinstance(initial, Mapping):
        raise InputError(
            f"initial = {quote(initial)}; give 'rest', 'free' or numbers by name, for "
            f"{', '.join(names)}, or the motion before"
        )
    result = dict.fromkeys(law.hidden, 0.0)
    for name, value in initial.items():
        if name not in names:
            raise InputError(unknown_word_message(str(name), names, "state at the start"))
        if value == "free":
            result.pop(name, None)
        else:
            result[name] = _check_finite_number(f"initial {name}", value)
    return result


def check_parameter_names(law: Law, names: Sequence[str]) -> None:
    """Check that all names are parameters of a law."""
    for name in names:
        _check_parameter_name(law, name)


def _check_parameter_name(law: Law, name: str) -> None:
    if name not in law.parameters:
        raise InputError(unknown_word_message(str(name), law.parameters, "parameter"))


def _check_finite_number(what: str, value: Any) -> float:
    try:
        result = math.nan if isinstance(value, bool | str) else float(value)
    except (TypeError, ValueError):
        result = math.nan
    if math.isnan(result):
        raise InputError(f"{what}: {quote(value)} is no number; give one")
    return result
