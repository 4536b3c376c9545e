"""Elliptic functions in a discovered z(t): each call with a rate, a phase and a modulus of its own.

A search finds jacobi_cn(t, 0.392) where jacobi_cn(1.1*t, 0.6) is true, since it costs fewer nodes.
Least squares finds the rest, once there are numbers to change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import sympy

NAMES = ("jacobi_sn", "jacobi_cn", "jacobi_dn")


def freed(expression: sympy.Expr) -> list[sympy.Expr]:
    """The expression as it stands, with a rate in each elliptic call, and with a phase beside it.

    The numbers that are new change nothing yet: a rate of 1, a phase of 0. An expression without an
    elliptic function of t is given back alone.
    """
    import sympy

    t = sympy.Symbol("t", real=True)
    found = [expression]
    for phased in (False, True):
        changed: dict[sympy.Expr, sympy.Expr] = {}
        for place, call in enumerate(sorted(_calls(expression), key=str)):
            argument, modulus = call.args
            inner = sympy.Poly(argument, t) if argument.is_polynomial(t) else None
            if inner is None or inner.degree() != 1 or not modulus.is_number:
                continue
            rate, shift = (float(number) for number in inner.all_coeffs())
            # Numbers that are equal would be one number: each is moved by a little of its own.
            apart = 1e-9 * (place + 1)
            new = sympy.Float(rate * (1.0 + apart)) * t
            if phased or shift:
                new += sympy.Float(shift + apart)
            changed[call] = call.func(new, sympy.Float(float(modulus) * (1.0 - apart)))
        if changed:
            found.append(expression.xreplace(changed))
    return found


def _calls(expression: sympy.Expr) -> list[sympy.Expr]:
    import sympy

    return [one for one in expression.atoms(sympy.Function) if type(one).__name__ in NAMES]
