"""The terms of a sum: powers of z times powers of the speed, with or without sign, or own ones.

Every product of z, z', |z'| and sign(z') is one such term, and only one: z^a |z'|^n, times
sign(z') or not. So two expressions have the same structure where they have the same terms. What is
no such product, as sin(z), is an `OwnTerm` of its own.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from reduced_models.discovery.own_terms import OwnTerm, own_term
from reduced_models.discovery.symbols import symbols, text_of

if TYPE_CHECKING:
    import sympy


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
    def moving(self) -> bool:
        """Whether it changes with the speed other than by its sign."""
        return self.speed > 0

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

    def primitive(self, z: np.ndarray) -> np.ndarray:
        """G(z), of whose rate a total term is."""
        return z ** (self.power + 1) / (self.power + 1)

    def by_primitive(self, z: np.ndarray) -> np.ndarray:
        """G'(z)."""
        return np.asarray(z**self.power)

    def by_height(self, z: np.ndarray, v: np.ndarray, u: np.ndarray | None) -> np.ndarray | float:
        """Its derivative by z."""
        if not self.power:
            return 0.0
        return self.power * self._replace(power=self.power - 1).values(z, v, u)

    def by_speed(self, z: np.ndarray, v: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """Its derivative by z'."""
        sign = 1.0 if self.odd else np.sign(v)
        found = z**self.power * self.speed * np.abs(v) ** (self.speed - 1) * sign
        return found * u if self.driven and u is not None else found


AnyTerm = Term | OwnTerm


def in_order(terms: Iterable[AnyTerm]) -> list[AnyTerm]:
    """Sorted, powers before own terms."""
    return sorted(terms, key=_place)


def _place(term: AnyTerm) -> tuple[Any, ...]:
    return (1, term.text) if isinstance(term, OwnTerm) else (0, *term)


@functools.cache
def library(degree: int, driven: bool = False) -> tuple[Term, ...]:
    """The physical library: powers of z up to ``degree``, times 1, z', |z'| z' and sign(z').

    Springs, dampings that depend on the height, drag and dry friction; and the input where there
    is one.
    """
    factors = ((0, False), (1, True), (2, True), (0, True))
    terms = tuple(Term(power, *factor) for factor in factors for power in range(degree + 1))
    return (*terms, Term(0, driven=True)) if driven else terms


def terms_of(expression: sympy.Expr) -> dict[AnyTerm, float] | None:
    """The terms of an expression with their coefficients.

    None where it is no sum of terms with numbers before them: where a number stands within a
    function, or as an exponent.
    """
    import sympy

    found: dict[AnyTerm, float] = {}
    for part in sympy.Add.make_args(sympy.expand(expression)):
        terms = _powers_of(part)
        if terms is None:
            coefficient, rest = part.as_independent(*symbols(), as_Add=False)
            if not coefficient.is_number or rest.atoms(sympy.Float):
                return None
            if rest.free_symbols - set(symbols()):
                return None
            terms = {own_term(rest): float(coefficient)}
        for term, value in terms.items():
            found[term] = found.get(term, 0.0) + value
    return {term: value for term, value in found.items() if value != 0.0}


def _powers_of(expression: sympy.Expr) -> dict[AnyTerm, float] | None:
    """The products of powers in an expression; None where it holds anything else."""
    import sympy

    z, v, u = symbols()
    modulus, sign = sympy.Symbol("modulus"), sympy.Symbol("sign")
    plain = expression.subs({sympy.Abs(v): modulus, sympy.sign(v): sign})
    try:
        polynomial = sympy.Poly(sympy.expand(plain), z, v, modulus, sign, u)
    except sympy.PolynomialError:
        return None
    found: dict[AnyTerm, float] = {}
    for (power, first, second, signs, driven), coefficient in polynomial.terms():
        if not coefficient.is_number or driven > 1:
            return None
        odd = (first + signs) % 2 == 1
        # sign(z')^2 is 1 wherever the piston moves.
        term = Term(power, first + second, odd, bool(driven))
        found[term] = found.get(term, 0.0) + float(coefficient)
    return found


def sum_of(terms: Sequence[AnyTerm], coefficients: Sequence[float]) -> sympy.Expr:
    """The expression of a linear combination of terms."""
    import sympy

    pairs = zip(terms, coefficients, strict=True)
    return sympy.Add(*(sympy.Float(value) * term.expression for term, value in pairs))


def sum_text(terms: Sequence[AnyTerm]) -> str:
    """A structure in words, with a number before each term: "a*z' + b*sin(z)"."""
    parts = zip("abcdefghijklmnopqrstuvwxyz", terms, strict=False)
    return " + ".join(name if term.text == "1" else f"{name}*{term.text}" for name, term in parts)


def complexity(expression: sympy.Expr) -> int:
    """Numbers, symbols and operations of an expression: the nodes of its tree."""
    import sympy

    return sum(1 for _ in sympy.preorder_traversal(expression))


def columns(
    terms: Sequence[AnyTerm], z: np.ndarray, v: np.ndarray, u: np.ndarray | None
) -> np.ndarray:
    """Values (n, p) of terms at samples."""
    return np.stack([term.values(z, v, u) for term in terms], axis=1)
