"""Constants and functions that formulas may name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

CONSTANTS = {"pi": math.pi, "π": math.pi, "e": math.e}


class FormulaFunction(NamedTuple):
    """A function that a formula may name: of how many operands, and its value for numbers."""

    value: Callable[..., float]
    least: int = 1
    most: int = 1


def _sign(x: float) -> float:
    return float((x > 0.0) - (x < 0.0))


FUNCTIONS: Mapping[str, FormulaFunction] = {
    "exp": FormulaFunction(math.exp),
    "log": FormulaFunction(math.log),
    "sqrt": FormulaFunction(math.sqrt),
    "sin": FormulaFunction(math.sin),
    "cos": FormulaFunction(math.cos),
    "tan": FormulaFunction(math.tan),
    "asin": FormulaFunction(math.asin),
    "acos": FormulaFunction(math.acos),
    "atan": FormulaFunction(math.atan),
    "sinh": FormulaFunction(math.sinh),
    "cosh": FormulaFunction(math.cosh),
    "tanh": FormulaFunction(math.tanh),
    "abs": FormulaFunction(abs),
    "sign": FormulaFunction(_sign),
    "heaviside": FormulaFunction(lambda x: 0.5 + 0.5 * _sign(x)),
    "max": FormulaFunction(max, 2, 8),
    "min": FormulaFunction(min, 2, 8),
}
"""Functions by name; give `parse` a longer table where there are more."""

ALIASES = {"Abs": "abs", "Max": "max", "Min": "min", "Heaviside": "heaviside", "ln": "log"}
"""Names that SymPy prints for some of them, so that a printed equation can be read again."""
