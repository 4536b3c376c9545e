"""Find parameter values that give the same law, and choose one canonical set.

An angle may change by a whole turn. Likewise k*sin(z - r) is unchanged if k changes sign and r changes by
half a turn. In the canonical set an angle lies in (-pi, pi], and a parameter of arbitrary sign is positive.
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

_POINT_COUNT = 12
_EQUALITY_TOLERANCE = 1e-9
_STATE_COUNT = 60  # states at which derivatives are compared
_SIMILARITY_TOLERANCE = 1e-6
_TURN = 2.0 * math.pi
_UNBOUNDED = (-math.inf, math.inf)


class ParameterSymmetries(NamedTuple):
    """Changes of parameters that leave a law unchanged."""

    turning: tuple[str, ...]  # parameters that are equivalent after a complete turn
    flipping: tuple[
        tuple[str, str | None], ...
    ]  # of arbitrary sign; the angle that moves half a turn with it


def find_parameter_symmetries(law: Law) -> ParameterSymmetries:
    """Find the symmetries of a law numerically, at random states and parameters."""
    return _find_parameter_symmetries_numerically(law.equation, law.inputs)


@functools.lru_cache(maxsize=COMPILED)
def _find_parameter_symmetries_numerically(equation: str, inputs: tuple[str, ...]) -> ParameterSymmetries:
    parsed = parse_equation(equation, inputs)
    arguments, parameters = parsed.argument_symbols, parsed.parameters
    field = algebra.compile_expressions(
        arguments, [*parsed.acceleration_and_hidden_rates, *parsed.observations.values()]
    )
    random = np.random.default_rng(0)
    state = random.uniform(0.3, 1.2, (len(arguments) - len(parameters), _POINT_COUNT))
    values = random.uniform(0.3, 1.2, (len(parameters), _POINT_COUNT))

    def rates_are_unchanged(factors: np.ndarray, shifts: np.ndarray) -> bool:
        changed = factors[:, None] * values + shifts[:, None]
        with np.errstate(all="ignore"):
            pairs = zip(field(*state, *values), field(*state, *changed), strict=True)
            return all(
                np.isfinite(item).all()
                and np.allclose(item, other, rtol=_EQUALITY_TOLERANCE, atol=_EQUALITY_TOLERANCE)
                for item, other in pairs
            )

    units, still = np.eye(len(parameters)), np.zeros(len(parameters))
    # A parameter without any effect is not an angle.
    turning = [
        k
        for k, moved in enumerate(units)
        if rates_are_unchanged(1.0 + still, _TURN * moved) and not rates_are_unchanged(1.0 + still, moved)
    ]
    flipping: list[tuple[str, str | None]] = []
    for k, name in enumerate(parameters):
        if rates_are_unchanged(1.0 - 2.0 * units[k], still):
            flipping.append((name, None))
            continue
        for other in turning:
            if other != k and rates_are_unchanged(1.0 - 2.0 * units[k], math.pi * units[other]):
                flipping.append((name, parameters[other]))
                break
    return ParameterSymmetries(tuple(parameters[k] for k in turning), tuple(flipping))


class CoordinateSimilarity(NamedTuple):
    """A shift or scaling of the coordinate that a change of parameters can compensate."""

    moving: tuple[str, ...]  # parameters that change with the coordinate; undetermined if it is undetermined
    level: str = ""  # the one of these parameters that only gives the origin of a shifted coordinate


def find_compensating_parameters(law: Law, change: Literal["shift", "scale"]) -> CoordinateSimilarity | None:
    """Find parameters that can compensate a shift or rescaling of the coordinate; None if they cannot."""
    return _find_compensating_parameters_numerically(
        law.equation, law.inputs, law.parameters, law.positive, change
    )


@functools.lru_cache(maxsize=COMPILED)
def _find_compensating_parameters_numerically(
    equation: str,
    inputs: tuple[str, ...],
    parameters: tuple[str, ...],
    positive: tuple[str, ...],
    change: str,
) -> CoordinateSimilarity | None:
    parsed_hidden = len(parse_equation(equation, inputs).hidden)
    states, now, by_state, by_value = _random_states_rates_and_derivatives(
        equation, inputs, parsed_hidden, len(parameters)
    )
    columns = list(np.moveaxis(by_value, 2, 0))  # (p, n, rates)
    if change == "shift":
        required = by_state[:, :, 0]
    else:
        required = (by_state[:, :, :2] * states[:, None, :2]).sum(axis=2)
        required[:, 0] -= now[:, 0]
        for k in range(parsed_hidden):  # each hidden state has a separate unit
            column = by_state[:, :, 2 + k] * states[:, None, 2 + k]
            column[:, 1 + k] -= now[:, 1 + k]
            columns.append(column)
    matrix = np.stack([column.ravel() for column in columns], axis=1)
    if not (np.isfinite(matrix).all() and np.isfinite(required).all()):
        return None
    solution = np.linalg.lstsq(matrix, required.ravel(), rcond=1e-10)[0]
    misfit = np.abs(matrix @ solution - required.ravel()).max()
    if misfit > _SIMILARITY_TOLERANCE * max(float(np.abs(required).max()), 1e-300):
        return None
    moving = [k for k in range(len(parameters)) if abs(solution[k]) > _SIMILARITY_TOLERANCE]
    constant = [k for k in moving if np.ptp(by_value[:, 0, k]) <= _SIMILARITY_TOLERANCE]
    levels = [*constant, *(k for k in moving if abs(solution[k] + 1.0) <= _SIMILARITY_TOLERANCE)]
    names = [parameters[k] for k in levels if parameters[k] not in positive]
    return CoordinateSimilarity(tuple(parameters[k] for k in moving), names[0] if names else "")


@functools.lru_cache(maxsize=COMPILED)
def _random_states_rates_and_derivatives(
    equation: str, inputs: tuple[str, ...], hidden: int, parameters: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Draw states (n, 2 + hidden); return states, rates, and derivatives by state and parameter."""
    from reduced_models.jax_setup import Compiled, jax

    field = compile_rates(equation, inputs)
    random = np.random.default_rng(1)
    values = random.uniform(0.3, 1.2, parameters)
    drive = random.uniform(0.3, 1.2, (_STATE_COUNT, len(inputs)))
    states = random.uniform(-1.2, 1.2, (_STATE_COUNT, 2 + hidden))
    states[:, 0] = np.abs(states[:, 0])  # many laws need heights above zero

    def rates(state: Any, given: Any, numbers: Any) -> Any:
        return jax.numpy.stack([jax.numpy.asarray(rate, float) for rate in field(*state, *given, *numbers)])

    def rates_and_derivatives(*arguments: Any) -> Any:
        return rates(*arguments), jax.jacfwd(rates, (0, 2))(*arguments)

    now, slopes = Compiled(jax.vmap(rates_and_derivatives, (0, 0, None)), (equation, inputs))(
        states, drive, values
    )
    return states, np.asarray(now), np.asarray(slopes[0]), np.asarray(slopes[1])


def canonical_parameters(
    law: Law,
    values: Mapping[str, np.ndarray],
    unchanged: Collection[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> dict[str, np.ndarray]:
    """Bring parameters (...) to their canonical values, or as near to these as bounds allow."""
    result = {name: np.asarray(value, dtype=np.float64) for name, value in values.items()}
    known, edges = find_parameter_symmetries(law), bounds or {}
    unchanged = {*unchanged, *law.positive, *(name for name, (low, high) in edges.items() if low == high)}
    for name, other in known.flipping:
        if name in unchanged or other in unchanged:
            continue
        low, high = edges.get(name, _UNBOUNDED)
        outside = (result[name] < low) | (result[name] > high)
        reversed_value = -result[name]
        flipped = ((reversed_value > 0.0) | outside) & (reversed_value >= low) & (reversed_value <= high)
        result[name] = np.where(flipped, reversed_value, result[name])
        if other is not None:
            result[other] = result[other] + math.pi * flipped
    for name in known.turning:
        if name in unchanged:
            continue
        low, high = edges.get(name, _UNBOUNDED)
        reduced = result[name] - _TURN * np.ceil((result[name] - math.pi) / _TURN)
        reduced = reduced + _TURN * np.ceil(np.maximum(low - reduced, 0.0) / _TURN)
        result[name] = reduced - _TURN * np.ceil(np.maximum(reduced - high, 0.0) / _TURN)
    return result
