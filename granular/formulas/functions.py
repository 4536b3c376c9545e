"""Constants and functions that formulas may name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

CONSTANTS = {"pi": math.pi, "π": math.pi, "e": math.e}


class Function(NamedTuple):
    """A function that a formula may name: of how many operands, and its value for numbers."""

    value: Callable[..., float]
    least: int = 1
    most: int = 1


def _sign(x: float) -> float:
    return float((x > 0.0) - (x < 0.0))


FUNCTIONS: Mapping[str, Function] = {
    "exp": Function(math.exp),
    "log": Function(math.log),
    "sqrt": Function(math.sqrt),
    "sin": Function(math.sin),
    "cos": Function(math.cos),
    "tan": Function(math.tan),
    "asin": Function(math.asin),
    "acos": Function(math.acos),
    "atan": Function(math.atan),
    "sinh": Function(math.sinh),
    "cosh": Function(math.cosh),
    "tanh": Function(math.tanh),
    "abs": Function(abs),
    "sign": Function(_sign),
    "heaviside": Function(lambda x: 0.5 + 0.5 * _sign(x)),
    "max": Function(max, 2, 8),
    "min": Function(min, 2, 8),
}
"""Functions by name; give `parse` a longer table where there are more."""

ALIASES = {"Abs": "abs", "Max": "max", "Min": "min", "Heaviside": "heaviside", "ln": "log"}
"""How SymPy prints some of them, so that a printed equation can be read again."""
