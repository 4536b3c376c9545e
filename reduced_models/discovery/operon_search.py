"""Symbolic regression by pyoperon.

Genetic programming with fitted numbers (Burlacu, Kronberger & Kommenda 2020,
doi:10.1145/3377929.3398099).
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from granular.formulas import FormulaError, parse, variable_names
from granular.formulas.algebra import sympy_expression
from granular.shared.errors import import_extra

if TYPE_CHECKING:
    import sympy
    from jaxtyping import Float

_ITERATIONS = 10  # of the least squares on the numbers of each new expression
# A search ends by their number: one that ends by time cannot be repeated.
_EVALUATIONS = 400_000
_POPULATION = 1000
_LENGTH = 30
_GENERATIONS = 10_000  # more than the evaluations last for


def is_operon_installed() -> bool:
    """Tell if pyoperon is installed, without importing it."""
    return importlib.util.find_spec("pyoperon") is not None


def search_expressions_with_operon(
    inputs: Mapping[str, np.ndarray],
    target: Float[np.ndarray, "n"],
    noise: float,
    functions: Sequence[str] = (),
    effort: float = 1.0,
    seed: int = 0,
) -> list[sympy.Expr]:
    """Find expressions for a target by pyoperon's genetic programming."""
    # The front of error against length, numbers by least squares (Burlacu, Kronberger & Kommenda 2020,
    # doi:10.1145/3377929.3398099). Its default noise of 1 would pick too short expressions.
    sklearn = import_extra("pyoperon.sklearn", "method 'operon'", "discover")
    samples = scale_samples(inputs, target)
    search = sklearn.SymbolicRegressor(
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
    """Samples as a search takes them: its numbers are drawn about 1."""

    matrix: Float[np.ndarray, "n inputs"]
    target: Float[np.ndarray, "n"]
    names: tuple[str, ...]
    sizes: Mapping[str, float]  # rms of each variable, in the order of the columns
    target_size: float

    def parse_expressions(self, texts: Iterable[str]) -> list[sympy.Expr]:
        """Expressions that a search wrote, in the variables' own names and units."""
        import sympy

        own = {
            name: sympy.Symbol(variable, real=True) / size
            for name, (variable, size) in zip(self.names, self.sizes.items(), strict=True)
        }
        expressions = []
        for text in texts:
            with contextlib.suppress(FormulaError):
                tree = parse(text)
                if {item.name for item in variable_names(tree)} <= set(self.names):
                    # By name, since searches differ in what they assume of their symbols.
                    expression = sympy_expression(tree)
                    symbols = {symbol: own[symbol.name] for symbol in expression.free_symbols}
                    expressions.append(sympy.Float(self.target_size) * expression.xreplace(symbols))
        return expressions


def scale_samples(inputs: Mapping[str, np.ndarray], target: Float[np.ndarray, "n"]) -> ScaledSamples:
    """Divide samples by their rms values, as a search takes them."""
    sizes = {name: _typical_size(values) for name, values in inputs.items()}
    matrix = np.stack([values / sizes[name] for name, values in inputs.items()], axis=1)
    names = tuple(f"x{k}" for k in range(len(inputs)))
    return ScaledSamples(matrix, target / _typical_size(target), names, sizes, _typical_size(target))


def _typical_size(values: np.ndarray) -> float:
    return max(float(np.sqrt((values**2).mean())), 1e-300)
