"""Variables of unit size for symbolic regressions, and the way back."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from granular.formulas import FUNCTIONS, FormulaError, Function, names, parse
from granular.formulas.algebra import expression

if TYPE_CHECKING:
    import sympy


@dataclasses.dataclass(frozen=True, eq=False)
class Scaled:
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

    def restored(self, expression: sympy.Expr) -> sympy.Expr:
        """An expression of the search in the real symbols and units of the variables."""
        import sympy

        back = {
            name: sympy.Symbol(own, real=True) / size
            for name, (own, size) in zip(self.names, self.sizes.items(), strict=True)
        }
        # By name, since searches differ in what they assume of their symbols.
        symbols = {one: back[one.name] for one in expression.free_symbols if one.name in back}
        return sympy.Float(self.target_size) * expression.xreplace(symbols)

    def read(
        self, texts: Iterable[str], functions: Mapping[str, Function] = MappingProxyType({})
    ) -> list[sympy.Expr]:
        """The expressions that a search wrote, restored; those that hold a NaN, say, are left out.

        ``functions`` are those that they may name beside the usual ones.
        """
        found = []
        for text in texts:
            with contextlib.suppress(FormulaError):
                tree = parse(text, {**FUNCTIONS, **functions})
                if {one.name for one in names(tree)} <= set(self.names):
                    found.append(self.restored(expression(tree)))
        return found


def scaled(inputs: Mapping[str, np.ndarray], target: np.ndarray) -> Scaled:
    """Samples (n,) of each variable and of the target, divided by their sizes."""
    sizes = {name: _size(values) for name, values in inputs.items()}
    matrix = np.stack([values / sizes[name] for name, values in inputs.items()], axis=1)
    names = tuple(f"x{k}" for k in range(len(inputs)))
    return Scaled(matrix, target / _size(target), names, sizes, _size(target))


def _size(values: np.ndarray) -> float:
    return max(float(np.sqrt((values**2).mean())), 1e-300)
