"""Symbolic regression by pyoperon.

Genetic programming with fitted numbers (Burlacu, Kronberger & Kommenda 2020,
doi:10.1145/3377929.3398099).
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from granular.formulas import FUNCTIONS, FormulaError, FormulaFunction, parse, variable_names
from granular.formulas.algebra import sympy_expression
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import sympy

_ITERATIONS = 10  # of the least squares on the numbers of each new expression
_EVALUATIONS = 400_000
_POPULATION = 1000
_LENGTH = 30
_GENERATIONS = 10_000  # more than the evaluations last for


def is_operon_installed() -> bool:
    """Tell if pyoperon is installed, without importing it.

    Returns
    -------
    bool
        True where pyoperon is installed.
    """
    return importlib.util.find_spec("pyoperon") is not None


def search_expressions_with_operon(
    inputs: Mapping[str, np.ndarray],
    target: np.ndarray,
    noise: float,
    functions: Sequence[str] = (),
    effort: float = 1.0,
    seed: int = 0,
) -> list[sympy.Expr]:
    """Find expressions for a target by pyoperon's genetic programming.

    The front of error against length is searched, with numbers fitted by least squares (Burlacu,
    Kronberger & Kommenda 2020, doi:10.1145/3377929.3398099).

    Parameters
    ----------
    inputs : mapping of str to float64 (n,)
        Samples of each variable, in its own unit.
    target : float64 (n,)
        Samples to be explained, in any unit.
    noise : float
        Standard deviation of the target's noise, in the target's unit.
    functions : sequence of str
        Next to sums, differences and products; such as ``"sin"``.
    effort : float
        Times the usual number of expressions to try. It ends the search, and not the clock, so that a
        seed repeats it.
    seed : int
        Seed of the search.

    Returns
    -------
    list of sympy.Expr
        Expressions of the Pareto front, in real symbols of the variables' names and their units.

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
    samples = scale_samples(inputs, target)
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
    texts = [search.get_model_string(item["tree"], 12, names) for item in search.pareto_front_]
    return samples.parse_expressions(texts)


@dataclasses.dataclass(frozen=True, eq=False)
class ScaledSamples:
    """Samples as a search takes them: its numbers are drawn about 1.

    Attributes
    ----------
    matrix : float64 (n, inputs)
    target : float64 (n,)
    names : tuple of str
        Of the columns in the search, x0, x1 ...
    sizes : mapping of str to float
        Rms value of each variable under its own name, in the order of the columns.
    target_size : float
    """

    matrix: np.ndarray
    target: np.ndarray
    names: tuple[str, ...]
    sizes: Mapping[str, float]
    target_size: float

    def restore_units(self, expression: sympy.Expr) -> sympy.Expr:
        """Expression of a search in the variables' own names and units.

        Parameters
        ----------
        expression : sympy.Expr
            Scaled target in the symbols x0, x1 ... of the search.

        Returns
        -------
        sympy.Expr
            Target, in its unit, in real symbols of the variables' names.
        """
        import sympy

        back = {
            name: sympy.Symbol(own, real=True) / size
            for name, (own, size) in zip(self.names, self.sizes.items(), strict=True)
        }
        # By name, since searches differ in what they assume of their symbols.
        symbols = {
            free_symbol: back[free_symbol.name]
            for free_symbol in expression.free_symbols
            if free_symbol.name in back
        }
        return sympy.Float(self.target_size) * expression.xreplace(symbols)

    def parse_expressions(
        self, texts: Iterable[str], functions: Mapping[str, FormulaFunction] = MappingProxyType({})
    ) -> list[sympy.Expr]:
        """Expressions that a search wrote, in the variables' own names and units.

        ``functions`` are those that they may name next to the usual ones.

        Parameters
        ----------
        texts : iterable of str
            Formulas in x0, x1 ...
        functions : mapping of str to Function
            Functions that they may name next to the usual ones.

        Returns
        -------
        list of sympy.Expr
            One for each text that is a formula in these variables; others, such as one with a NaN, are
            left out.
        """
        expressions = []
        for text in texts:
            with contextlib.suppress(FormulaError):
                tree = parse(text, {**FUNCTIONS, **functions})
                if {item.name for item in variable_names(tree)} <= set(self.names):
                    expressions.append(self.restore_units(sympy_expression(tree)))
        return expressions


def scale_samples(inputs: Mapping[str, np.ndarray], target: np.ndarray) -> ScaledSamples:
    """Divide samples by their rms values, as a search takes them.

    Parameters
    ----------
    inputs : mapping of str to float64 (n,)
        Samples of each variable, in its own unit.
    target : float64 (n,)
        Samples of the target, in its unit.

    Returns
    -------
    ScaledSamples
        Columns and target without unit, each with an rms value of 1, and the rms values in the units
        they had.
    """
    sizes = {name: _typical_size(values) for name, values in inputs.items()}
    matrix = np.stack([values / sizes[name] for name, values in inputs.items()], axis=1)
    names = tuple(f"x{k}" for k in range(len(inputs)))
    return ScaledSamples(matrix, target / _typical_size(target), names, sizes, _typical_size(target))


def _typical_size(values: np.ndarray) -> float:
    return max(float(np.sqrt((values**2).mean())), 1e-300)
