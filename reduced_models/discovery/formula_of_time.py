"""Equations for the motion z(t) itself, by symbolic regression."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING

import numpy as np

from granular.formulas.algebra import compile_function
from granular.shared.errors import InputError
from reduced_models.discovery.polishing import replace_numbers_by_symbols
from reduced_models.discovery.pysr_search import ELLIPTIC
from reduced_models.discovery.result import CandidateEquation, Discovery, pareto_front
from reduced_models.discovery.structure_proposals import SymbolicSearch
from reduced_models.discovery.terms import complexity
from reduced_models.laws.height_map import HeightMap
from reduced_models.records.derivatives import noise_level

if TYPE_CHECKING:
    import sympy
    from jaxtyping import Float

_FUNCTIONS = ("sin", "cos", "exp")
_MOST_POINTS = 500
_FLOOR = 1e-6
_EQUAL = 1e-6  # difference of criteria that rounding makes
_MOST_NUMBERS = 16


def discover_height_formulas(
    time: Float[np.ndarray, "n"],
    height: Float[np.ndarray, "n"],
    search: SymbolicSearch,
    height_map: HeightMap,
) -> Discovery:
    """Discover formulas of z in the time t by symbolic regression; time [s], height [m]."""
    # Of all formulas, numbers fitted to all samples, that of the least Bayesian information criterion
    # (Schwarz 1978, doi:10.1214/aos/1176344136).
    import sympy

    z = np.asarray(height_map.to_law(height))
    level = noise_level(height, time) / abs(height_map.scale)
    noise = max(level, _FLOOR * float(z.std()))
    time = time - time[0]
    rows = slice(None, None, max(1, math.ceil(len(time) / _MOST_POINTS)))
    search = search._replace(functions=_FUNCTIONS)
    expressions = search.find_expressions({"t": time[rows]}, z[rows], noise, elliptic=True)
    forms = [
        form
        for expression in expressions
        for form in elliptic_function_variants(sympy.expand_mul(expression))
    ]
    fitted = [_fit_constants(form, time, z, noise) for form in forms]
    if not expressions:
        raise InputError(f"{search.method!r} found no expression that is finite; try another method")
    excess = max(1.0, min(error for _, error in fitted)) ** 2
    candidates = [
        CandidateEquation(
            item,
            complexity(item),
            error,
            len(time) * error**2 / excess + len(item.atoms(sympy.Float)) * math.log(len(time)),
        )
        for item, error in fitted
    ]
    front = pareto_front(candidates)
    least = min(candidate.criterion for candidate in front)
    # The front begins with the simplest: of equal ones it is the first.
    chosen = next(k for k, candidate in enumerate(front) if candidate.criterion <= least + _EQUAL)
    return Discovery(f"{search.method}, z(t)", tuple(front), chosen, height_map)


def _fit_constants(
    expression: sympy.Expr, time: np.ndarray, z: np.ndarray, noise: float
) -> tuple[sympy.Expr, float]:
    """Expression with its numbers fitted to all samples, and its error in noise levels."""
    import sympy
    from scipy.optimize import least_squares

    template, values = replace_numbers_by_symbols(expression)
    t = sympy.Symbol("t", real=True)
    symbols = [sympy.Symbol(name) for name in values]
    start = np.array(list(values.values()))
    elliptic = {name: function.value for name, function in ELLIPTIC.items()}
    function = compile_function([t, *symbols], template, [elliptic, "numpy"])

    def residual(numbers: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            difference = (function(time, *numbers) - z) / noise
        return np.where(np.isfinite(difference), difference, 1e6) * np.ones(len(time))

    if 0 < len(values) <= _MOST_NUMBERS:
        with warnings.catch_warnings(action="ignore"):
            start = least_squares(residual, start, x_scale="jac", max_nfev=50).x
    error = float(np.sqrt((residual(start) ** 2).mean()))
    numbers = dict(zip(symbols, map(sympy.Float, start), strict=True))
    return template.xreplace(numbers), error


def elliptic_function_variants(expression: sympy.Expr) -> list[sympy.Expr]:
    """Expression unchanged, with a rate in each elliptic call, and with a phase next to it."""
    # A search finds jacobi_cn(t, 0.392) for jacobi_cn(1.1*t, 0.6), since it has fewer nodes; with a rate of 1
    # and a phase of 0 put in, least squares finds the rest.
    import sympy

    t = sympy.Symbol("t", real=True)
    variants = [expression]
    for phased in (False, True):
        changed: dict[sympy.Expr, sympy.Expr] = {}
        for k, call in enumerate(sorted(_elliptic_function_calls(expression), key=str)):
            argument, modulus = call.args
            inner = sympy.Poly(argument, t) if argument.is_polynomial(t) else None
            if inner is None or inner.degree() != 1 or not modulus.is_number:
                continue
            rate, shift = (float(number) for number in inner.all_coeffs())
            # Numbers that are equal would be one number: each is moved by a little of its own.
            apart = 1e-9 * (k + 1)
            new = sympy.Float(rate * (1.0 + apart)) * t
            if phased or shift:
                new += sympy.Float(shift + apart)
            changed[call] = call.func(new, sympy.Float(float(modulus) * (1.0 - apart)))
        if changed:
            variants.append(expression.xreplace(changed))
    return variants


def _elliptic_function_calls(expression: sympy.Expr) -> list[sympy.Expr]:
    import sympy

    return [atom for atom in expression.atoms(sympy.Function) if type(atom).__name__ in ELLIPTIC]
