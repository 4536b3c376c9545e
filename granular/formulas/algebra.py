"""SymPy expressions from parsed formulas, compiled functions, and dimensions of formulas.

Formulas are converted to code only in this file: SymPy writes Python code in which every symbol has a
generated name, never a name from a user.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from granular.formulas import FUNCTIONS, FormulaError, Name, Node, Number, Operation, parse
from granular.shared.errors import InputError, quote

if TYPE_CHECKING:
    import sympy


_LEAST, _GREATEST = sys.float_info.min, sys.float_info.max


def sympy_expression(tree: Node, symbols: Mapping[str, sympy.Symbol] | None = None) -> sympy.Expr:
    """Convert a formula to a SymPy expression."""
    import sympy

    result = _build_expression(tree, symbols or {})
    if result.has(sympy.zoo, sympy.nan, sympy.oo, sympy.S.NegativeInfinity, sympy.I):
        raise FormulaError("the formula divides by zero, or is not a real number; write another formula")
    return result


def check_finite_numbers(expression: sympy.Expr) -> None:
    """Check that the numbers of an expanded expression are within the range of double precision."""
    import sympy

    for part in sympy.preorder_traversal(expression):
        if part.is_number and part != 0:
            size = abs(part.evalf())
            if size.is_Number and not _LEAST <= size <= _GREATEST:
                raise FormulaError(
                    f"the expanded formula contains {size.evalf(3)}, but numbers must be from 1e-308 to "
                    "1e308; write other numbers"
                )


@functools.cache
def _sympy_functions() -> dict[str, Callable[..., Any]]:
    import sympy

    named = {name: getattr(sympy, name) for name in FUNCTIONS if hasattr(sympy, name)}
    return named | {
        "abs": sympy.Abs,
        "heaviside": sympy.Heaviside,
        "max": _left_fold(_make_min_or_max("max")),
        "min": _left_fold(_make_min_or_max("min")),
        "+": sympy.Add,
        "*": sympy.Mul,
        "-": lambda operand: -operand,
        "/": lambda left, right: left / right,
        "**": sympy.Pow,
    }


def _left_fold(pair: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """Extend a function of two operands to any number of operands."""
    return lambda *operands: functools.reduce(pair, operands)


@functools.cache
def _make_min_or_max(name: str) -> Any:
    """Make a function that returns the maximum or minimum of two SymPy expressions."""
    import sympy

    sign = 1 if name == "max" else -1
    array_name = {"max": "maximum", "min": "minimum"}[name]

    # SymPy's `Max` compares all pairs of operands symbolically, and so do its derivatives, which takes half
    # a minute for eight operands.
    class Extreme(sympy.Function):  # type: ignore[misc]  # SymPy is not typed
        nargs = 2

        def fdiff(self, index: int = 1) -> sympy.Expr:
            here, other = self.args if index == 1 else reversed(self.args)
            return sympy.Heaviside(sign * (here - other))

        def _eval_is_extended_real(self) -> bool | None:
            return all(arg.is_extended_real for arg in self.args) or None

        def _numpycode(self, printer: Any) -> str:
            return self._code(printer, "numpy")

        def _jaxcode(self, printer: Any) -> str:
            return self._code(printer, "jax.numpy")

        def _code(self, printer: Any, module: str) -> str:
            operands = ", ".join(map(printer._print, self.args))
            return f"{printer._module_format(f'{module}.{array_name}')}({operands})"

    Extreme.__name__ = name
    return Extreme


def _build_expression(tree: Node, symbols: Mapping[str, sympy.Symbol]) -> Any:
    import sympy

    if isinstance(tree, Name):
        return symbols.get(tree.text) or sympy.Symbol(tree.text)
    if isinstance(tree, Number):
        if tree.text in ("pi", "π", "e"):
            return sympy.E if tree.text == "e" else sympy.pi
        return sympy.Integer(tree.text) if tree.text.isdecimal() else sympy.Float(tree.text)
    operands = [_build_expression(operand, symbols) for operand in tree.operands]
    function = _sympy_functions().get(tree.head) or sympy.Function(tree.head)
    return function(*operands)


def maximum(first: sympy.Expr, second: sympy.Expr) -> sympy.Expr:
    """Return the maximum of two expressions."""
    return _make_min_or_max("max")(first, second)


def magnitude(expression: sympy.Expr) -> sympy.Expr:
    """Return the absolute value in a form that SymPy simplifies faster than its `Abs`."""
    return maximum(expression, -expression)


def compile_formula(
    text: str,
    parameters: Sequence[str],
    arguments: Sequence[Any],
    derive: Callable[[sympy.Expr, Mapping[str, sympy.Symbol]], dict[str, sympy.Expr]],
) -> dict[str, Callable[..., Any]]:
    """Compile the functions that ``derive`` makes from a formula; arguments are names, or tuples of names.

    The second of these functions must be the first derivative of the formula. It must not have jumps.
    """
    import sympy

    given = {name: sympy.Symbol(f"parameter{number}", real=True) for number, name in enumerate(parameters)}
    symbols = {name: sympy.Symbol(name, real=True) for name in sympy.flatten(arguments)} | given
    forms = derive(sympy_expression(parse(text), symbols), symbols)
    # SymPy leaves the derivative of sign(u/a) unevaluated, since a may be zero.
    if list(forms.values())[1].has(sympy.DiracDelta, sympy.Derivative):
        raise FormulaError(f"{quote(text)} has a jump; write a formula without jumps")
    taken = [
        [symbols[part] for part in name] if isinstance(name, tuple) else symbols[name] for name in arguments
    ]
    return {name: compile_expressions(taken, _remove_delta_of_kink(form)) for name, form in forms.items()}


def _remove_delta_of_kink(form: sympy.Expr) -> sympy.Expr:
    """Remove the delta functions (infinite stiffnesses) that arise when a kink is differentiated."""
    import sympy

    for infinite in (sympy.DiracDelta, sympy.Derivative):
        form = form.replace(infinite, lambda *_: sympy.Integer(0))
    return form.replace(sympy.Heaviside, lambda x, *_: (1 + sympy.sign(x)) / 2)


def compile_expressions(
    arguments: Sequence[sympy.Symbol | Sequence[sympy.Symbol]],
    expressions: sympy.Expr | Sequence[sympy.Expr],
    modules: str | Sequence[Any] = "numpy",
) -> Callable[..., Any]:
    """Compile one expression, or a list of expressions, to a function of symbols or tuples of symbols."""
    import sympy

    # Sorted by the original names, since SymPy orders sums and products by name, also relative to its
    # generated x0, x1 ...: the last bits are then the same as without renaming.
    order = sorted(sympy.flatten(arguments), key=lambda symbol: symbol.name)
    safe = {
        symbol: sympy.Symbol(f"{'a' if symbol.name < 'x' else 'y'}{number:04d}", real=symbol.is_real)
        for number, symbol in enumerate(order)
    }
    names = [
        safe[item] if isinstance(item, sympy.Basic) else [safe[symbol] for symbol in item]
        for item in arguments
    ]
    if isinstance(expressions, sympy.Basic):
        return sympy.lambdify(names, expressions.xreplace(safe), modules, cse=True)
    renamed = [expression.xreplace(safe) for expression in expressions]
    return sympy.lambdify(names, renamed, modules, cse=True)


Dimension = tuple[Fraction, ...]

BASE = ("m", "kg", "s", "A")
NONE: Dimension = (Fraction(0),) * len(BASE)
LENGTH, TIME, MASS, MOMENT = (
    tuple(map(Fraction, powers)) for powers in ((1, 0, 0, 0), (0, 0, 1, 0), (0, 1, 0, 0), (2, 0, 0, 1))
)
_SAME = {"+", "-", "max", "min", "abs"}


def unit_text_of_dimension(dimension: Dimension) -> str:
    """Write a dimension as a unit, such as ``kg s^-2``; ``1`` if dimensionless."""
    parts = [
        name if power == 1 else f"{name}^{power}"
        for name, power in zip(BASE, dimension, strict=True)
        if power
    ]
    return " ".join(parts) or "1"


def infer_dimension(tree: Node, known: Mapping[str, Dimension]) -> Dimension:
    """Infer the dimension of a formula from the dimensions of its names."""
    if isinstance(tree, Name):
        return known[tree.text]
    if isinstance(tree, Number):
        return NONE
    parts = [infer_dimension(operand, known) for operand in tree.operands]
    if tree.head in _SAME:
        return _dimension_of_equal_terms(tree, parts)
    if tree.head == "*":
        return tuple(sum(powers, Fraction(0)) for powers in zip(*parts, strict=True))
    if tree.head == "/":
        return tuple(above - below for above, below in zip(*parts, strict=True))
    if tree.head == "sqrt":
        return tuple(power / 2 for power in parts[0])
    if tree.head == "**":
        return _dimension_of_power(tree, parts)
    if tree.head not in ("sign", "heaviside") and any(part != NONE for part in parts):
        unit = unit_text_of_dimension(next(part for part in parts if part != NONE))
        raise InputError(
            f"{tree.head}() has an argument in {unit}, but needs a dimensionless argument; divide it by a "
            f"quantity in {unit}"
        )
    return NONE


def _dimension_of_equal_terms(tree: Operation, parts: list[Dimension]) -> Dimension:
    # Zero is compatible with every unit.
    result = [
        part for part, operand in zip(parts, tree.operands, strict=True) if _constant_value(operand) != 0
    ]
    for part in result[1:]:
        if part != result[0]:
            raise InputError(
                f"{unit_text_of_dimension(result[0])} and {unit_text_of_dimension(part)} "
                "are added or compared; check the units of the parameters"
            )
    return result[0] if result else NONE


def _dimension_of_power(tree: Operation, parts: list[Dimension]) -> Dimension:
    base, power = parts
    if power != NONE:
        raise InputError(f"an exponent has the unit {unit_text_of_dimension(power)}; make it dimensionless")
    if base == NONE:
        return NONE
    number = _constant_value(tree.operands[1])
    if number is None:
        raise InputError(
            f"{unit_text_of_dimension(base)} has an exponent that is not a plain number; write a number"
        )
    return tuple(exponent * number for exponent in base)


def _constant_value(tree: Node) -> Fraction | None:
    """Return the value of a tree that contains only numbers; None for any other tree."""
    if isinstance(tree, Number):
        try:
            return Fraction(tree.text)
        except ValueError:
            return None
    if isinstance(tree, Operation):
        parts = [_constant_value(operand) for operand in tree.operands]
        known = [part for part in parts if part is not None]
        if len(known) == len(parts):
            if tree.head == "-":
                return -known[0]
            if tree.head == "/" and known[1]:
                return known[0] / known[1]
    return None
