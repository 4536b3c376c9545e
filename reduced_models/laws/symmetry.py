"""Parameters that mean the same at other values, and their canonical form.

An angle means the same a whole turn further on, and k*sin(z - r) the same with -k half a turn on.
In the canonical form an angle lies in (-pi, pi], and what may change its sign is positive.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from granular.formulas import algebra
from reduced_models.laws.equation import COMPILED, compile_rates, parse_equation
from reduced_models.laws.law import Law

_POINTS = 12
_CLOSE = 1e-9
_TRIALS = 60  # states at which derivatives are compared
_SIMILAR = 1e-6
_TURN = 2.0 * math.pi
_OPEN = (-math.inf, math.inf)


class Symmetries(NamedTuple):
    """Changes of parameters that a law does not notice."""

    turning: tuple[str, ...]  # mean the same a whole turn on
    flipping: tuple[tuple[str, str | None], ...]


def find_symmetries(law: Law) -> Symmetries:
    """Symmetries of a law, by trial."""
    return _symmetries(law.equation, law.inputs)


@functools.lru_cache(maxsize=COMPILED)
def _symmetries(equation: str, inputs: tuple[str, ...]) -> Symmetries:
    parsed = parse_equation(equation, inputs)
    arguments, parameters = parsed.argument_symbols, parsed.parameters
    field = algebra.compile_function(arguments, [*parsed.rates, *parsed.observations.values()])
    random = np.random.default_rng(0)
    state = random.uniform(0.3, 1.2, (len(arguments) - len(parameters), _POINTS))
    values = random.uniform(0.3, 1.2, (len(parameters), _POINTS))

    def same(factors: np.ndarray, shifts: np.ndarray) -> bool:
        changed = factors[:, None] * values + shifts[:, None]
        with np.errstate(all="ignore"):
            pairs = zip(field(*state, *values), field(*state, *changed), strict=True)
            return all(
                np.isfinite(item).all() and np.allclose(item, other, rtol=_CLOSE, atol=_CLOSE)
                for item, other in pairs
            )

    units, still = np.eye(len(parameters)), np.zeros(len(parameters))
    # What means the same anywhere is no angle.
    turning = [
        k
        for k, moved in enumerate(units)
        if same(1.0 + still, _TURN * moved) and not same(1.0 + still, moved)
    ]
    flipping: list[tuple[str, str | None]] = []
    for k, name in enumerate(parameters):
        if same(1.0 - 2.0 * units[k], still):
            flipping.append((name, None))
            continue
        for other in turning:
            if other != k and same(1.0 - 2.0 * units[k], math.pi * units[other]):
                flipping.append((name, parameters[other]))
                break
    return Symmetries(tuple(parameters[k] for k in turning), tuple(flipping))


class Similarity(NamedTuple):
    """A change of the coordinate under which a law keeps its form."""

    moving: tuple[str, ...]  # change with the coordinate: what does not tell it does not tell them
    level: str = ""  # of these, the one that only says where a shifted coordinate counts from


def find_similarity(law: Law, change: Literal["shift", "scale"]) -> Similarity | None:
    """Parameters that take up a shift or another unit of the coordinate; None where none can."""
    return _similarity(law.equation, law.inputs, law.parameters, law.positive, change)


@functools.lru_cache(maxsize=COMPILED)
def _similarity(
    equation: str,
    inputs: tuple[str, ...],
    parameters: tuple[str, ...],
    positive: tuple[str, ...],
    change: str,
) -> Similarity | None:
    parsed_hidden = len(parse_equation(equation, inputs).hidden)
    states, now, by_state, by_value = _rates_and_slopes(equation, inputs, parsed_hidden, len(parameters))
    columns = list(np.moveaxis(by_value, 2, 0))  # (p, n, rates)
    if change == "shift":
        wanted = by_state[:, :, 0]
    else:
        wanted = (by_state[:, :, :2] * states[:, None, :2]).sum(axis=2)
        wanted[:, 0] -= now[:, 0]
        for k in range(parsed_hidden):  # hidden states have units of their own
            column = by_state[:, :, 2 + k] * states[:, None, 2 + k]
            column[:, 1 + k] -= now[:, 1 + k]
            columns.append(column)
    matrix = np.stack([column.ravel() for column in columns], axis=1)
    if not (np.isfinite(matrix).all() and np.isfinite(wanted).all()):
        return None
    solution = np.linalg.lstsq(matrix, wanted.ravel(), rcond=1e-10)[0]
    left = np.abs(matrix @ solution - wanted.ravel()).max()
    if left > _SIMILAR * max(float(np.abs(wanted).max()), 1e-300):
        return None
    moving = [k for k in range(len(parameters)) if abs(solution[k]) > _SIMILAR]
    constant = [k for k in moving if np.ptp(by_value[:, 0, k]) <= _SIMILAR]
    levels = [*constant, *(k for k in moving if abs(solution[k] + 1.0) <= _SIMILAR)]
    names = [parameters[k] for k in levels if parameters[k] not in positive]
    return Similarity(tuple(parameters[k] for k in moving), names[0] if names else "")


@functools.lru_cache(maxsize=COMPILED)
def _rates_and_slopes(
    equation: str, inputs: tuple[str, ...], hidden: int, parameters: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Random states (n, 2 + hidden), rates (n, 1 + hidden), their slopes by state and by parameter."""
    from reduced_models.jax_setup import Compiled, jax

    field = compile_rates(equation, inputs)
    random = np.random.default_rng(1)
    values = random.uniform(0.3, 1.2, parameters)
    drive = random.uniform(0.3, 1.2, (_TRIALS, len(inputs)))
    states = random.uniform(-1.2, 1.2, (_TRIALS, 2 + hidden))
    states[:, 0] = np.abs(states[:, 0])  # many laws are of heights above zero

    def rates(state: Any, given: Any, numbers: Any) -> Any:
        return jax.numpy.stack([jax.numpy.asarray(rate, float) for rate in field(*state, *given, *numbers)])

    def both(*arguments: Any) -> Any:
        return rates(*arguments), jax.jacfwd(rates, (0, 2))(*arguments)

    now, slopes = Compiled(jax.vmap(both, (0, 0, None)), (equation, inputs))(states, drive, values)
    return states, np.asarray(now), np.asarray(slopes[0]), np.asarray(slopes[1])


def canonical_parameters(
    law: Law,
    values: Mapping[str, np.ndarray],
    unchanged: Collection[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> dict[str, np.ndarray]:
    """Values (...) of parameters in their canonical form, or as near to it as bounds let them."""
    result = {name: np.asarray(value, dtype=np.float64) for name, value in values.items()}
    known, edges = find_symmetries(law), bounds or {}
    unchanged = {*unchanged, *law.positive, *(name for name, (low, high) in edges.items() if low == high)}
    for name, other in known.flipping:
        if name in unchanged or other in unchanged:
            continue
        low, high = edges.get(name, _OPEN)
        outside = (result[name] < low) | (result[name] > high)
        turned = -result[name]
        flipped = ((turned > 0.0) | outside) & (turned >= low) & (turned <= high)
        result[name] = np.where(flipped, turned, result[name])
        if other is not None:
            result[other] = result[other] + math.pi * flipped
    for name in known.turning:
        if name in unchanged:
            continue
        low, high = edges.get(name, _OPEN)
        home = result[name] - _TURN * np.ceil((result[name] - math.pi) / _TURN)
        home = home + _TURN * np.ceil(np.maximum(low - home, 0.0) / _TURN)
        result[name] = home - _TURN * np.ceil(np.maximum(home - high, 0.0) / _TURN)
    return result
