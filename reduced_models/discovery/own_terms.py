"""Terms that users write, such as sin(z), max(0, z) or z**-2.5: what is no product of powers."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from granular import formulas
from granular.formulas import algebra
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from reduced_models.discovery.symbols import INPUT, symbols, text_of

if TYPE_CHECKING:
    import sympy

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclasses.dataclass(frozen=True)
class OwnTerm:
    """A function of z, z' and the input.

    Attributes
    ----------
    expression : Expr
        In the symbols of `symbols`; exact, without floating-point numbers.
    """

    expression: sympy.Expr

    @functools.cached_property
    def text(self) -> str:
        """As a law writes it."""
        return text_of(self.expression)

    @property
    def driven(self) -> bool:
        """Whether it holds the input."""
        return bool(self.expression.has(symbols()[2]))

    @property
    def still(self) -> bool:
        """Whether it is one of z (and the input) alone."""
        return not self.expression.has(symbols()[1])

    @property
    def moving(self) -> bool:
        """Whether it changes with the speed."""
        return not self.still

    @property
    def total(self) -> bool:
        """Whether it is the rate of a function of z."""
        return self._factor is not None

    @functools.cached_property
    def _factor(self) -> sympy.Expr | None:
        """G'(z), where the term is G'(z) z'; else None."""
        import sympy

        _, v, u = symbols()
        factor = sympy.cancel(self.expression / v)
        return None if self.still or factor.has(v) or factor.has(u) else factor

    def values(self, z: np.ndarray, v: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """Of samples (n,)."""
        return _values(self.expression, z, v, u)

    def primitive(self, z: np.ndarray) -> np.ndarray:
        """G(z), of whose rate a total term is, from the least of the samples on.

        By quadrature: many a G has no formula, or one that takes minutes to find.
        """
        order = np.argsort(z)
        steps = np.diff(z[order], prepend=z[order[:1]])
        places = z[order, None] + steps[:, None] * (_NODES - 1.0) / 2.0
        areas = steps * (self.by_primitive(places) @ _WEIGHTS) / 2.0
        found = np.empty(len(z))
        found[order] = np.cumsum(areas)
        return found

    def by_primitive(self, z: np.ndarray) -> np.ndarray:
        """G'(z)."""
        return _values(self._factor, z, z, None)

    def by_height(self, z: np.ndarray, v: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """Its derivative by z."""
        return _values(_slope(self.expression, 0), z, v, u)

    def by_speed(self, z: np.ndarray, v: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """Its derivative by z'."""
        return _values(_slope(self.expression, 1), z, v, u)


def own_term(expression: sympy.Expr) -> OwnTerm:
    """A term of an exact expression in the symbols of `symbols`; max(z, 0) is max(0, z)."""
    return OwnTerm(expression.replace(_is_extreme, _in_order))


def _is_extreme(expression: sympy.Basic) -> bool:
    return type(expression).__name__ in ("max", "min")


def _in_order(extreme: sympy.Expr) -> sympy.Expr:
    """A maximum or minimum, each of its operands once, in one order."""
    from sympy import default_sort_key

    pair = type(extreme)
    operands, open_ones = set(), list(extreme.args)
    while open_ones:
        one = open_ones.pop()
        if type(one) is pair:
            open_ones += one.args
        else:
            operands.add(one)
    return functools.reduce(pair, sorted(operands, key=default_sort_key))


def read_terms(texts: Sequence[str], column: str | None = None) -> list[sympy.Expr]:
    """Expressions of terms as users write them, in z, z' and the input's column.

    Parameters
    ----------
    texts : sequence of str
        Such as ``"sin(z)"``, ``"max(0, z)"``, ``"z'**3"``, ``"z**-2.5"``, ``"u*z"``. Numbers in
        them stay as they are, but for one before a term.
    column : str, optional
        Name of the input, beside ``u``.

    Raises
    ------
    InputError
        If a text is no formula, names anything else, or is constant zero.
    """
    return [_read(text, column) for text in texts]


def _read(text: str, column: str | None) -> sympy.Expr:
    import sympy

    if not isinstance(text, str):
        raise InputError(f"the term {quoted(text)} is no text; write it as 'sin(z)'")
    z, v, u = symbols()
    named = {"z": z, "z'": v}
    if column is not None:
        named |= {INPUT: u, column: u}
    term = f"the term {quoted(text)}"
    try:
        tree = formulas.parse(text)
        strange = [one.text for one in formulas.names(tree) if one.text not in named]
        if strange:
            known = "z, z' and the input's column" if column is None else f"z, z', u and {column}"
            more = "; name the input's column with input=" if column is None else ""
            raise InputError(f"{term} names {strange[0]}; terms are of {known}{more}")
        found = algebra.expression(tree, named)
    except formulas.FormulaError as error:
        raise InputError(f"{term} cannot be read: {error}") from None
    exact = found.xreplace({one: sympy.Rational(str(one)) for one in found.atoms(sympy.Float)})
    if exact == 0:
        raise InputError(f"{term} is zero; leave it out")
    return exact


def _slope(expression: sympy.Expr, place: int) -> sympy.Expr:
    """Derivative by z (0) or z' (1); that of a jump is left out."""
    import sympy

    return sympy.diff(expression, symbols()[place]).replace(
        sympy.DiracDelta, lambda *_: sympy.Integer(0)
    )


@functools.lru_cache(maxsize=256)
def _function(expression: sympy.Expr) -> Callable[..., Any]:
    return algebra.function_of(symbols(), expression)


def _values(
    expression: sympy.Expr, z: np.ndarray, v: np.ndarray, u: np.ndarray | None
) -> np.ndarray:
    with np.errstate(all="ignore"):
        found = _function(expression)(z, v, 0.0 if u is None else u)
    return np.broadcast_to(np.asarray(found, dtype=np.float64), z.shape)
