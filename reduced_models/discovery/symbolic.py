"""Symbolic regression by pyoperon, genetic programming with fitted numbers (Burlacu, Kronberger &
Kommenda 2020, doi:10.1145/3377929.3398099).
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from granular.shared.errors import InputError
from reduced_models.discovery.scaled import scaled

if TYPE_CHECKING:
    import sympy

_ITERATIONS = 10  # of the least squares on the numbers of each new expression
_EVALUATIONS = 400_000
_POPULATION = 1000
_LENGTH = 30
_GENERATIONS = 10_000  # more than the evaluations last for


def has_operon() -> bool:
    """Whether pyoperon is installed."""
    return importlib.util.find_spec("pyoperon") is not None


def operon_expressions(
    inputs: Mapping[str, np.ndarray],
    target: np.ndarray,
    noise: float,
    functions: Sequence[str] = (),
    effort: float = 1.0,
    seed: int = 0,
) -> list[sympy.Expr]:
    """Expressions of the Pareto front of error and length.

    Parameters
    ----------
    inputs : mapping of str to float64 (n,)
        Samples of each variable.
    target : float64 (n,)
    noise : float
        Standard deviation of the target's noise.
    functions : sequence of str
        Beside sums, differences and products; such as ``"sin"``.
    effort : float
        Times the usual number of expressions to try. It ends the search, and not the clock, so that
        a seed repeats it.
    seed : int

    Raises
    ------
    InputError
        If pyoperon is not installed.
    """
    try:
        from pyoperon.sklearn import SymbolicRegressor
    except ImportError:
        raise InputError(
            "method 'operon' needs pyoperon, which is not installed; install it with: "
            "pip install 'granular-damper[discover]'"
        ) from None
    samples = scaled(inputs, target)
    search = SymbolicRegressor(
        allowed_symbols=",".join(("add", "sub", "mul", "constant", "variable", *functions)),
        objectives=["r2", "length"],
        optimizer_iterations=_ITERATIONS,
        max_evaluations=round(effort * _EVALUATIONS),
        generations=_GENERATIONS,
        population_size=_POPULATION,
        max_length=_LENGTH,
        uncertainty=[noise / samples.target_size],
        n_threads=1,
        random_state=seed + 1,  # it takes 0 for no seed
    ).fit(samples.matrix, samples.target)
    names = list(samples.names)
    texts = [search.get_model_string(one["tree"], 12, names) for one in search.pareto_front_]
    return samples.read(texts)
