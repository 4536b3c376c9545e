"""The terms of a physical library: powers of z times powers of the speed, with or without sign.

Every product of z, z', |z'| and sign(z') is one such term, and only one: z^a |z'|^n, times
sign(z') or not. So two expressions have the same structure where they have the same terms.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    import sympy

INPUT = "u"


class Term(NamedTuple):
    """z^power |z'|^speed, times sign(z') where ``odd``, times the input where ``driven``."""

    power: int
    speed: int = 0
    odd: bool = False
    driven: bool = False

    @property
    def still(self) -> bool:
        """Whether the term is one of z (and the input) alone."""
        return self.speed == 0 and not self.odd

    @property
    def total(self) -> bool:
        """Whether the term is z^a z', the rate of z^(a+1)/(a+1)."""
        return self.speed == 1 and self.odd and not self.driven

    @property
    def text(self) -> str:
        """As a law writes it, ``"z**2*z'"``."""
        return text_of(self.expression)

    @property
    def expression(self) -> sympy.Expr:
        """In the symbols of `symbols`."""
        import sympy

        z, v, u = symbols()
        if self.odd:
            motion = sympy.sign(v) if self.speed == 0 else v * sympy.Abs(v) ** (self.speed - 1)
        else:
            motion = sympy.Abs(v) ** self.speed
        return z**self.power * motion * (u if self.driven else 1)

    def values(self, z: np.ndarray, v: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """Of samples (n,)."""
        found = z**self.power * np.abs(v) ** self.speed
        if self.odd:
            found = found * np.sign(v)
        return found * u if self.driven and u is not None else found


def symbols() -> tuple[sympy.Symbol, sympy.Symbol, sympy.Symbol]:
    """The real symbols z, v (for z') and u (for the input)."""
    import sympy

    z, v, u = (sympy.Symbol(name, real=True) for name in ("z", "v", INPUT))
    return z, v, u


def text_of(expression: sympy.Expr) -> str:
    """An expression as a law writes it, with z' for v."""
    import re

    return re.sub(r"\bv\b", "z'", str(expression))


@functools.cache
def library(degree: int, driven: bool = False) -> tuple[Term, ...]:
    """The physical library: powers of z up to ``degree``, times 1, z', |z'| z' and sign(z').

    Springs, dampings that depend on the height, drag and dry friction; and the input where there
    is one.
    """
    factors = ((0, False), (1, True), (2, True), (0, True))
    terms = tuple(Term(power, *factor) for factor in factors for power in range(degree + 1))
    return (*terms, Term(0, driven=True)) if driven else terms


def terms_of(expression: sympy.Expr) -> dict[Term, float] | None:
    """The terms of an expression with their coefficients; None where it holds anything else."""
    import sympy

    z, v, u = symbols()
    modulus, sign = sympy.Symbol("modulus"), sympy.Symbol("sign")
    plain = expression.subs({sympy.Abs(v): modulus, sympy.sign(v): sign})
    try:
        polynomial = sympy.Poly(sympy.expand(plain), z, v, modulus, sign, u)
    except sympy.PolynomialError:
        return None
    found: dict[Term, float] = {}
    for (power, first, second, signs, driven), coefficient in polynomial.terms():
        if not coefficient.is_number or driven > 1:
            return None
        odd = (first + signs) % 2 == 1
        # sign(z')^2 is 1 wherever the piston moves.
        term = Term(power, first + second, odd, bool(driven))
        found[term] = found.get(term, 0.0) + float(coefficient)
    return {term: value for term, value in found.items() if value != 0.0}


def sum_of(terms: Sequence[Term], coefficients: Sequence[float]) -> sympy.Expr:
    """The expression of a linear combination of terms."""
    import sympy

    pairs = zip(terms, coefficients, strict=True)
    return sympy.Add(*(sympy.Float(value) * term.expression for term, value in pairs))


def complexity(expression: sympy.Expr) -> int:
    """Numbers, symbols and operations of an expression: the nodes of its tree."""
    import sympy

    return sum(1 for _ in sympy.preorder_traversal(expression))


def columns(
    terms: Sequence[Term], z: np.ndarray, v: np.ndarray, u: np.ndarray | None
) -> np.ndarray:
    """Values (n, p) of terms at samples."""
    return np.stack([term.values(z, v, u) for term in terms], axis=1)
