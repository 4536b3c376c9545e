"""The symbols of a discovered equation, and how it is written."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import sympy

INPUT = "u"


def symbols() -> tuple[sympy.Symbol, sympy.Symbol, sympy.Symbol]:
    """The real symbols z, v (for z') and u (for the input)."""
    import sympy

    z, v, u = (sympy.Symbol(name, real=True) for name in ("z", "v", INPUT))
    return z, v, u


def text_of(expression: sympy.Expr) -> str:
    """An expression as a law writes it, with z' for v."""
    return re.sub(r"\bv\b", "z'", str(expression))
