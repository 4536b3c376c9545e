"""What a user asks of a fit, checked before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeGuard

import numpy as np

from granular.run.record import PistonRecord
from granular.schema.sections import unknown
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from reduced_models.laws.height_map import HeightMap
from reduced_models.laws.law import Law
from reduced_models.least_squares.residuals import LOSSES
from reduced_models.records.inputs import INTERPOLATIONS

STARTS = 16
HOLDOUT = 0.3
MOST_STARTS = 10_000
"""Ten times a thousand, with which a short record takes minutes."""

Bounds = Mapping[str, tuple[float | None, float | None]]
Fixed = Mapping[str, float | Sequence[float]]
Initial = (
    Literal["free", "rest"] | Mapping[str, float | str] | PistonRecord | Sequence[PistonRecord]
)
INTERVALS = ("linear", "bootstrap", "profile")


def records_of(record: Any) -> list[PistonRecord]:
    """One record, or a sequence of them, as a list.

    Raises
    ------
    InputError
        If it is neither.
    """
    if isinstance(record, PistonRecord):
        return [record]
    if isinstance(record, Sequence) and not isinstance(record, str):
        found = list(record)
        if not found:
            raise InputError("there is no record to fit; give at least one")
        if all(isinstance(one, PistonRecord) for one in found):
            return found
    kind = type(record).__name__
    raise InputError(
        f"a {kind} is no record; give a PistonRecord, such as "
        "PistonRecord.from_columns({'time': ..., 'height': ...})"
    )


def check_options(
    starts: int = STARTS,
    holdout: float = HOLDOUT,
    confidence: float = 0.95,
    height_map: object = "auto",
    intervals: str = "linear",
    loss: str = "linear",
    interpolation: str | None = None,
) -> None:
    """Raise `InputError` unless the options of `fit` are in their ranges."""
    if not isinstance(starts, int) or isinstance(starts, bool) or not 1 <= starts <= MOST_STARTS:
        raise InputError(f"starts = {quoted(starts)}; give a whole number from 1 to {MOST_STARTS}")
    if not 0.0 <= holdout <= 0.9:
        raise InputError(f"holdout = {quoted(holdout)}; give a fraction from 0 to 0.9")
    if not 0.0 < confidence < 1.0:
        raise InputError(f"confidence = {quoted(confidence)}; give a fraction between 0 and 1")
    if not isinstance(height_map, HeightMap) and height_map not in ("auto", "fitted"):
        raise InputError(f"map = {quoted(height_map)}; give 'auto', 'fitted' or a HeightMap")
    for name, value, known in (
        ("intervals", intervals, INTERVALS),
        ("loss", loss, LOSSES),
        ("input_interpolation", interpolation or "spline", INTERPOLATIONS),
    ):
        if value not in known:
            raise InputError(f"{name} = {quoted(value)}; give {_listed(known)}")


def _listed(names: Sequence[str]) -> str:
    return ", ".join(map(repr, names[:-1])) + f" or {names[-1]!r}"


def fixed_values(fix: Fixed, records: int) -> tuple[dict[str, float], tuple[dict[str, float], ...]]:
    """Values that parameters keep in all records, and those that they keep in each one.

    Raises
    ------
    InputError
        If a value is no number, or a list is not as long as there are records.
    """
    shared: dict[str, float] = {}
    each: tuple[dict[str, float], ...] = tuple({} for _ in range(records))
    for name, value in fix.items():
        if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str):
            if len(value) != records:
                raise InputError(
                    f"fix of {name}: {len(value)} values for {records} records; give one for each"
                )
            for own, one in zip(each, value, strict=True):
                own[name] = _number(f"fix of {name}", one)
        else:
            shared[name] = _number(f"fix of {name}", value)
    return shared, each


def pairs_of(
    law: Law,
    bounds: Bounds,
    fix: Mapping[str, float],
    each: Sequence[Mapping[str, float]] = ({},),
) -> dict[str, tuple[float, float]]:
    """Least and greatest values of parameters; equal ones where a value is given.

    Raises
    ------
    InputError
        If a name is none of the law's, or a pair is out of order.
    """
    found = {}
    for name, pair in bounds.items():
        _check_name(law, name)
        if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
            raise InputError(
                f"bounds of {name}: {quoted(pair)} is no pair; give (least, greatest), None for "
                "an open end"
            )
        low = -math.inf if pair[0] is None else _number(f"bounds of {name}", pair[0])
        high = math.inf if pair[1] is None else _number(f"bounds of {name}", pair[1])
        if low == high:
            raise InputError(f"bounds of {name}: both are {low:g}; write fix={{{name!r}: {low:g}}}")
        if not low < high:
            raise InputError(f"bounds of {name}: {low:g} is not below {high:g}; give them in order")
        if name in law.positive and high <= 0.0:
            raise InputError(
                f"bounds of {name}: up to {high:g}, and the law holds for values above 0; raise it"
            )
        found[name] = (low, high)
    for name, value in (*fix.items(), *(pair for own in each for pair in own.items())):
        _check_name(law, name)
        if name in law.positive and value <= 0.0:
            raise InputError(f"fix of {name}: {value:g}, and the law holds for values above 0")
        low, high = found.get(name, (-math.inf, math.inf))
        if not low <= value <= high:
            raise InputError(
                f"fix of {name}: {value:g} lies outside its bounds; change one of them"
            )
        if name in fix:
            found[name] = (value, value)
    if len({*fix, *each[0]}) >= len(law.parameters):
        raise InputError("all parameters are fixed, so there is nothing to fit; leave one out")
    return found


def starts_of(law: Law, start: Mapping[str, float]) -> dict[str, float]:
    """Start values of parameters, as numbers.

    Raises
    ------
    InputError
        If a name is none of the law's, or a value does not suit.
    """
    found = {}
    for name, value in start.items():
        _check_name(law, name)
        found[name] = _number(f"start of {name}", value)
        if name in law.positive and found[name] <= 0.0:
            raise InputError(f"start of {name}: {found[name]:g}; give a value above 0")
    return found


def initial_of(law: Law, initial: Initial | None) -> dict[str, float]:
    """What is given of height, velocity and hidden states at the start; the rest is free.

    Raises
    ------
    InputError
        If it is none of what is known.
    """
    if initial is None:
        return dict.fromkeys(law.hidden, 0.0)
    if initial == "free":
        return {}
    if initial == "rest":
        return {"velocity": 0.0, **dict.fromkeys(law.hidden, 0.0)}
    if is_history(initial):
        return {}
    names = ("height", "velocity", *law.hidden)
    if not isinstance(initial, Mapping):
        raise InputError(
            f"initial = {quoted(initial)}; give 'rest', 'free' or numbers by name, for "
            f"{', '.join(names)}, or the motion before"
        )
    found = dict.fromkeys(law.hidden, 0.0)
    for name, value in initial.items():
        if name not in names:
            raise InputError(unknown(str(name), names, "state at the start"))
        if value == "free":
            found.pop(name, None)
        else:
            found[name] = _number(f"initial {name}", value)
    return found


def is_history(
    initial: Initial | None,
) -> TypeGuard[PistonRecord | Sequence[PistonRecord]]:
    """Whether the start of a motion is told by the motion before it."""
    if isinstance(initial, Sequence) and not isinstance(initial, str) and initial:
        return all(isinstance(one, PistonRecord) for one in initial)
    return isinstance(initial, PistonRecord)


def weights_of(
    records: Sequence[PistonRecord], weights: Any, noise: Any
) -> list[tuple[np.ndarray | None, float | None]]:
    """Weights (n,) of each record's residuals, and the noise [m] of one with the weight 1.

    Raises
    ------
    InputError
        If they are no positive numbers, one a sample.
    """
    if weights is not None and noise is not None and np.ndim(noise) > 0:
        raise InputError("noise of each sample gives their weights; leave weights out")
    several = len(records) > 1
    found: list[tuple[np.ndarray | None, float | None]] = []
    for k, record in enumerate(records):
        own_weights = _of_record("weights", weights, k, record, several=several)
        own_noise = _of_record("noise", noise, k, record, several=several)
        if own_noise is None or own_noise.ndim == 0:
            level = None if own_noise is None else float(own_noise)
            found.append((own_weights, level))
        else:
            level = float(1.0 / np.sqrt((own_noise**-2.0).mean()))
            found.append((level / own_noise, level))
    return found


def _of_record(
    what: str, given: Any, k: int, record: PistonRecord, *, several: bool
) -> np.ndarray | None:
    if given is None:
        return None
    try:
        own = np.asarray(given[k] if several and np.ndim(given) != 0 else given, dtype=np.float64)
    except (TypeError, ValueError, IndexError):
        own = np.array(np.nan)
    shapes = [record.time.shape] if what == "weights" else [(), record.time.shape]
    if own.shape not in shapes or not np.isfinite(own).all() or not (own > 0.0).all():
        raise InputError(
            f"{what}: give positive numbers, one a sample ({len(record)})"
            + (", or one for all" if what == "noise" else "")
            + (", for each record" if several else "")
        )
    return own


def check_names(law: Law, names: Sequence[str]) -> None:
    """Raise `InputError` unless all are parameters of the law."""
    for name in names:
        _check_name(law, name)


def _check_name(law: Law, name: str) -> None:
    if name not in law.parameters:
        raise InputError(unknown(str(name), law.parameters, "parameter"))


def _number(what: str, value: Any) -> float:
    try:
        found = math.nan if isinstance(value, bool | str) else float(value)
    except (TypeError, ValueError):
        found = math.nan
    if math.isnan(found):
        raise InputError(f"{what}: {quoted(value)} is no number; give one")
    return found
