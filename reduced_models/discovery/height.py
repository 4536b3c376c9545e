"""Equations for the motion z(t) itself, by symbolic regression."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.algebra import function_of
from granular.shared.errors import InputError
from reduced_models.discovery.elliptic_calls import freed
from reduced_models.discovery.julia import ELLIPTIC
from reduced_models.discovery.polishing import parametrised
from reduced_models.discovery.result import CandidateEquation, Discovery, pareto_front
from reduced_models.discovery.terms import complexity
from reduced_models.laws.height_map import HeightMap
from reduced_models.records.first_guesses import noise_level

if TYPE_CHECKING:
    import sympy

_FUNCTIONS = ("sin", "cos", "exp")
_MOST_POINTS = 500
_FLOOR = 1e-6
_EQUAL = 1e-6  # difference of criteria that rounding makes
_MOST_NUMBERS = 16


def height_equations(
    record: PistonRecord, method: str, height_map: HeightMap, effort: float, seed: int
) -> Discovery:
    """Expressions of z in t, from the record's start on; numbers fitted to all samples."""
    import sympy

    time = record.time - record.time[0]
    z = np.asarray(height_map.to_law(record.height))
    noise = max(
        noise_level(record.height, record.time) / abs(height_map.scale), _FLOOR * float(z.std())
    )
    rows = slice(None, None, max(1, math.ceil(len(time) / _MOST_POINTS)))
    inputs = {"t": time[rows]}
    if method == "operon":
        from reduced_models.discovery.symbolic import operon_expressions

        found = operon_expressions(inputs, z[rows], noise, _FUNCTIONS, effort, seed)
    else:
        from reduced_models.discovery.julia import pysr_expressions

        found = pysr_expressions(inputs, z[rows], noise, _FUNCTIONS, True, effort, seed)
    forms = [form for one in found for form in freed(sympy.expand_mul(one))]
    fitted = [_fitted(one, time, z, noise) for one in forms]
    if not found:
        raise InputError(f"{method!r} found no expression that is finite; try another method")
    excess = max(1.0, min(error for _, error in fitted)) ** 2
    candidates = [
        CandidateEquation(
            one,
            complexity(one),
            error,
            len(time) * error**2 / excess + len(one.atoms(sympy.Float)) * math.log(len(time)),
        )
        for one, error in fitted
    ]
    front = pareto_front(candidates)
    least = min(one.criterion for one in front)
    # The front begins with the simplest: of equal ones it is the first.
    chosen = next(k for k, one in enumerate(front) if one.criterion <= least + _EQUAL)
    return Discovery(f"{method}, z(t)", tuple(front), chosen, height_map)


def _fitted(
    expression: sympy.Expr,
    time: np.ndarray,
    z: np.ndarray,
    noise: float,
) -> tuple[sympy.Expr, float]:
    """An expression with its numbers fitted to all samples, and its error in noise levels."""
    import sympy
    from scipy.optimize import least_squares

    template, values = parametrised(expression)
    t = sympy.Symbol("t", real=True)
    symbols = [sympy.Symbol(name) for name in values]
    start = np.array(list(values.values()))
    elliptic = {name: function.value for name, function in ELLIPTIC.items()}
    function = function_of([t, *symbols], template, [elliptic, "numpy"])

    def residual(numbers: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            found = (function(time, *numbers) - z) / noise
        return np.where(np.isfinite(found), found, 1e6) * np.ones(len(time))

    if 0 < len(values) <= _MOST_NUMBERS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            start = least_squares(residual, start, x_scale="jac", max_nfev=50).x
    error = float(np.sqrt((residual(start) ** 2).mean()))
    numbers = dict(zip(symbols, map(sympy.Float, start), strict=True))
    return template.xreplace(numbers), error
