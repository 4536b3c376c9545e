"""Estimate the sizes of a law's parameters and hidden states from the dimensions in its equations.

Terms of a sum have the same dimension, and arguments of functions are dimensionless. This gives linear
equations for the dimensions of all symbols. The size of a symbol is then a product of powers of known sizes:
the sizes of displacement, velocity, measured signal and inputs in the record.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from reduced_models.laws.equation import ParsedEquation
from reduced_models.records.inputs import TIME

_CONSISTENT = 1e-9
_LENGTH, _TIME, _SIGNAL = range(3)


class _DimensionEquations:
    """Linear equations for the dimensions of symbols; each row holds the coefficients, then the constants."""

    def __init__(self, names: Mapping[str, int], count: int) -> None:
        self.names, self.count = names, count
        self.rows: list[np.ndarray] = []

    def dimension_of(self, expression: Any) -> np.ndarray:
        """Return the dimension of an expression; add the equations that its parts must satisfy."""
        zero = np.zeros(len(self.names) + self.count)
        if expression.is_Symbol:
            result = zero.copy()
            result[self.names[expression.name]] = 1.0
            return result
        if expression.is_number:
            return zero
        if expression.is_Pow:
            base, exponent = (self.dimension_of(item) for item in expression.args)
            if expression.exp.is_number:
                return np.asarray(float(expression.exp) * base)
            self.rows += [base, exponent]
            return zero
        parts = [self.dimension_of(item) for item in expression.args]
        if expression.is_Mul:
            return np.asarray(np.sum(parts, axis=0))
        name = type(expression).__name__
        if name == "Abs":
            return parts[0]
        if expression.is_Add or name.lower() in ("max", "min", "maximum", "minimum"):
            self.rows += [part - parts[0] for part in parts[1:]]
            return parts[0]
        if name.lower() not in ("sign", "heaviside"):
            self.rows += parts
        return zero


def natural_sizes(
    parsed: ParsedEquation, amplitude: float, speed: float, signals: Mapping[str, float]
) -> dict[str, float]:
    """Estimate sizes of parameters and hidden states; ``signals``: sizes of inputs and measured columns."""
    seconds = amplitude / speed
    known = {"z": (1.0, 0.0), "z_first": (1.0, -1.0), "z_second": (1.0, -2.0), TIME: (0.0, 1.0)}
    open_names = [*parsed.hidden, *parsed.parameters]
    columns = [name for name in signals if name not in (*known, *open_names)]
    names = {name: k for k, name in enumerate([*open_names, *known, *columns])}
    count = 2 + len(columns)
    equations = _DimensionEquations(names, count)

    def unit_dimension_row(powers: Mapping[int, float]) -> np.ndarray:
        row = np.zeros(len(names) + count)
        for k, power in powers.items():
            row[len(names) + k] = power
        return row

    def symbol_dimension_row(name: str) -> np.ndarray:
        row = np.zeros(len(names) + count)
        row[names[name]] = 1.0
        return row

    for name, (length, time) in known.items():
        equations.rows.append(symbol_dimension_row(name) - unit_dimension_row({_LENGTH: length, _TIME: time}))
    for k, name in enumerate(columns):
        equations.rows.append(symbol_dimension_row(name) - unit_dimension_row({_SIGNAL + k: 1.0}))
    if parsed.acceleration is not None:
        equations.rows.append(equations.dimension_of(parsed.acceleration) - symbol_dimension_row("z_second"))
    for name, expression in parsed.observations.items():
        if name in names:
            equations.rows.append(equations.dimension_of(expression) - symbol_dimension_row(name))
    for name, rate in parsed.hidden.items():
        equations.rows.append(
            equations.dimension_of(rate) - symbol_dimension_row(name) + unit_dimension_row({_TIME: 1.0})
        )
    rows = np.array(equations.rows)
    # A hidden state whose unit the equations leave open is regarded as dimensionless.
    for name in parsed.hidden:
        trial = np.vstack([rows, symbol_dimension_row(name)])
        if _minimum_norm_powers_and_error(trial, len(names))[1] < _CONSISTENT:
            rows = trial
    powers = _minimum_norm_powers_and_error(rows, len(names))[0]
    sizes = np.array([amplitude, seconds, *(signals[name] for name in columns)])
    return {name: float(math.prod(sizes ** powers[names[name]])) for name in open_names}


def _minimum_norm_powers_and_error(rows: np.ndarray, count: int) -> tuple[np.ndarray, float]:
    """Return the powers (symbols, units) of minimum norm, and the maximum error of the equations."""
    matrix, constants = rows[:, :count], -rows[:, count:]
    powers = np.linalg.lstsq(matrix, constants, rcond=1e-9)[0]
    return powers, float(np.abs(matrix @ powers - constants).max())
