"""Print equations of motion as LaTeX and MathML, with dots for time derivatives and z'' first."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import sympy

_DOT = "&#x2d9;"
_MARKS = {"zddot": ("\\ddot{z}", "&#xa8;"), "zdot": ("\\dot{z}", _DOT)}


_GREEK = {
    "alpha": "α",
    "beta": "β",
    "gamma": "γ",
    "delta": "δ",
    "epsilon": "ε",
    "zeta": "ζ",
    "eta": "η",
    "theta": "θ",
    "kappa": "κ",
    "lam": "λ",
    "lambda": "λ",
    "mu": "μ",
    "nu": "ν",
    "xi": "ξ",
    "rho": "ρ",
    "sigma": "σ",
    "tau": "τ",
    "phi": "φ",
    "chi": "χ",
    "psi": "ψ",
    "omega": "ω",
    "Gamma": "Γ",
    "Delta": "Δ",
    "Theta": "Θ",
    "Lambda": "Λ",
    "Sigma": "Σ",
    "Phi": "Φ",
    "Psi": "Ψ",
    "Omega": "Ω",
}
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_NAME = re.compile(r"([A-Za-z]+?)_?(\d*)")


def parameter_symbol(name: str) -> str:
    """Return the symbol of a parameter: Greek letters by name, and a trailing number as a subscript."""
    match = _NAME.fullmatch(name)
    if match is None:
        return name
    return _GREEK.get(match[1], match[1]) + match[2].translate(_SUBSCRIPTS)


def round_significant(value: float, digits: int) -> float:
    """Round a number to ``digits`` significant digits."""
    return float(f"{value:.{digits}g}")


def round_equation(equation: sympy.Eq, digits: int) -> sympy.Eq:
    """Round all numbers of an equation to a number of significant digits, without simplification."""
    import sympy

    sides = (round_expression(side, digits) for side in (equation.lhs, equation.rhs))
    return sympy.Eq(*sides, evaluate=False)


def round_expression(expression: sympy.Expr, digits: int) -> sympy.Expr:
    """Round all numbers of an expression to a number of significant digits."""
    import sympy

    result = expression.atoms(sympy.Float)
    return expression.xreplace({item: sympy.Float(round_significant(float(item), digits)) for item in result})


def _terms_by_derivative(side: Any) -> list[Any]:
    """Return the terms of one side of an equation, the highest derivative first."""
    import sympy

    t = sympy.Symbol("t")
    z = sympy.Function("z")(t)
    dotted = {z.diff(t, 2): sympy.Symbol("zddot"), z.diff(t): sympy.Symbol("zdot")}
    dotted |= {z: sympy.Symbol("z"), sympy.Symbol("lam"): sympy.Symbol("lambda")}
    plain = side.subs(dotted)
    order = [sympy.Symbol("zddot"), sympy.Symbol("zdot"), sympy.Symbol("z")]

    def rank(term: Any) -> tuple[int, str]:
        for position, symbol in enumerate(order):
            if term.has(symbol):
                return position, str(term)
        return len(order), str(term)

    return sorted(sympy.Add.make_args(plain), key=rank)


def equation_as_latex(equation: sympy.Eq) -> str:
    """Return an equation in z(t) as LaTeX."""
    import sympy

    def side(expression: Any) -> str:
        text = ""
        for term in _terms_by_derivative(expression):
            negative = term.could_extract_minus_sign()
            sign = " - " if negative else " + "
            text_of_term = sympy.latex(-term if negative else term)
            text += (sign if text else ("-" if negative else "")) + text_of_term
        for name, (mark, _) in _MARKS.items():
            text = text.replace(name, mark)
        return text

    return f"{side(equation.lhs)} = {side(equation.rhs)}"


# Invisible times has no width: without a space "friction tanh" would read as one name.
_TIMES, _WORD = "<mo>&InvisibleTimes;</mo>", r"<mi>[^\W\d_]{2,}</mi>"
_WORD_TIMES = re.compile(rf"{_WORD}{_TIMES}|{_TIMES}(?=(?:<mrow>)*{_WORD})")
_THIN_SPACE = '<mspace width="0.17em"/>'


def equation_as_mathml(equation: sympy.Eq) -> str:
    """Return an equation in z(t) as MathML, one formula per term so that lines break between terms."""
    return _mathml_equation(_signed_terms(equation.lhs), _signed_terms(equation.rhs))


def hidden_rate_as_mathml(name: str, rate: sympy.Expr) -> str:
    """Return the equation of a hidden state as MathML; the rate is an expression in z(t)."""
    return _mathml_equation([f"<mover><mi>{name}</mi><mo>{_DOT}</mo></mover>"], _signed_terms(rate))


def _mathml_equation(left: list[str], right: list[str]) -> str:
    first, *others = right
    terms = [*left, f"<mo>=</mo>{first}", *others]
    return " ".join(f'<math displaystyle="true"><mrow>{term}</mrow></math>' for term in terms)


def _signed_terms(expression: Any) -> list[str]:
    """Return the terms of one side of an equation, with their signs."""
    from sympy.printing.mathml import MathMLPresentationPrinter

    printer = MathMLPresentationPrinter()
    result: list[str] = []
    for term in _terms_by_derivative(expression):
        negative = term.could_extract_minus_sign()
        text = ""
        if result or negative:
            form = "infix" if result else "prefix"  # each term is a separate formula, beginning with its sign
            text += f'<mo form="{form}">{"&#x2212;" if negative else "+"}</mo>'
        text += printer.doprint(-term if negative else term)
        for name, (_, mark) in _MARKS.items():
            text = text.replace(f"<mi>{name}</mi>", f"<mover><mi>z</mi><mo>{mark}</mo></mover>")
        result.append(_WORD_TIMES.sub(r"\g<0>" + _THIN_SPACE, text))
    return result
