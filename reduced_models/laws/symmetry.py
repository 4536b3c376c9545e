"""Parameters that mean the same at other values, and their canonical form.

An angle means the same a whole turn further on, and k*sin(z - r) the same with -k half a turn on.
In the canonical form an angle lies in (-pi, pi], and what may change its sign is positive.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

import numpy as np

from reduced_models.laws.equation import COMPILED, compile_rates
from reduced_models.laws.law import Law

_POINTS = 12
_CLOSE = 1e-9
_TURN = 2.0 * math.pi
_OPEN = (-math.inf, math.inf)


class Symmetries(NamedTuple):
    """Changes of parameters that a law does not notice.

    Attributes
    ----------
    turning : tuple of str
        Parameters that mean the same a whole turn on.
    flipping : tuple of (str, str or None)
        Parameters that mean the same with the other sign; where a second one is named, if that
        moves by half a turn.
    """

    turning: tuple[str, ...]
    flipping: tuple[tuple[str, str | None], ...]


def symmetries(law: Law) -> Symmetries:
    """Symmetries of a law, by trial."""
    return _symmetries(law.equation, law.inputs, law.parameters, len(law.hidden))


@functools.lru_cache(maxsize=COMPILED)
def _symmetries(
    equation: str, inputs: tuple[str, ...], parameters: tuple[str, ...], hidden: int
) -> Symmetries:
    field = compile_rates(equation, inputs, "numpy")
    random = np.random.default_rng(0)
    state = random.uniform(0.3, 1.2, (2 + hidden + len(inputs), _POINTS))
    values = random.uniform(0.3, 1.2, (len(parameters), _POINTS))

    def same(change: Callable[[np.ndarray], np.ndarray]) -> bool:
        with np.errstate(all="ignore"):
            pairs = zip(field(*state, *values), field(*state, *change(values)), strict=True)
            return all(
                np.isfinite(item).all() and np.allclose(item, other, rtol=_CLOSE, atol=_CLOSE)
                for item, other in pairs
            )

    def moved(k: int, by: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda given: given + by * (np.arange(len(given)) == k)[:, None]

    def flipped(k: int) -> Callable[[np.ndarray], np.ndarray]:
        return lambda given: np.where((np.arange(len(given)) == k)[:, None], -given, given)

    def both(k: int, other: int) -> Callable[[np.ndarray], np.ndarray]:
        return lambda given: moved(other, math.pi)(flipped(k)(given))

    turning = [k for k in range(len(parameters)) if same(moved(k, _TURN))]
    # What means the same anywhere is no angle.
    turning = [k for k in turning if not same(moved(k, 1.0))]
    flipping: list[tuple[str, str | None]] = []
    for k, name in enumerate(parameters):
        if same(flipped(k)):
            flipping.append((name, None))
            continue
        for other in turning:
            if other != k and same(both(k, other)):
                flipping.append((name, parameters[other]))
                break
    return Symmetries(tuple(parameters[k] for k in turning), tuple(flipping))


def canonical_values(
    law: Law,
    values: Mapping[str, np.ndarray],
    collection: Collection[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> dict[str, np.ndarray]:
    """Values (...) of parameters in their canonical form, or as near to it as bounds let them.

    Those that are ``kept``, or that bounds hold at one value, stay.
    """
    result = {name: np.asarray(value, dtype=np.float64) for name, value in values.items()}
    known, edges = symmetries(law), bounds or {}
    collection = {
        *collection,
        *law.positive,
        *(name for name, (low, high) in edges.items() if low == high),
    }
    for name, other in known.flipping:
        if name in collection or other in collection:
            continue
        low, high = edges.get(name, _OPEN)
        outside = (result[name] < low) | (result[name] > high)
        turned = -result[name]
        flipped = ((turned > 0.0) | outside) & (turned >= low) & (turned <= high)
        result[name] = np.where(flipped, turned, result[name])
        if other is not None:
            result[other] = result[other] + math.pi * flipped
    for name in known.turning:
        if name in collection:
            continue
        low, high = edges.get(name, _OPEN)
        home = result[name] - _TURN * np.ceil((result[name] - math.pi) / _TURN)
        home = home + _TURN * np.ceil(np.maximum(low - home, 0.0) / _TURN)
        result[name] = home - _TURN * np.ceil(np.maximum(home - high, 0.0) / _TURN)
    return result
