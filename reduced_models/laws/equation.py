"""Equations of motion taken apart: from text to trees, to expressions, to functions."""

from __future__ import annotations

import dataclasses
import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular import formulas
from granular.formulas import algebra
from granular.shared.errors import InputError
from granular.shared.message_text import quote
from reduced_models.records.inputs import TIME

if TYPE_CHECKING:
    import sympy

COMPILED = 64
"""Functions of laws that are kept in memory; each discovery makes up laws that never come back."""

PROGRAMS = 16
"""Programs of JAX that are kept in memory, of each kind; one takes some 20 MB."""

_RATES = {"z'": "z_first", "z''": "z_second"}
TIME_WORD = re.compile(rf"(?<![\w']){TIME}(?![\w'])")
_MOST_HIDDEN = 8  # states: beyond what any record can tell apart


@dataclasses.dataclass(frozen=True)
class ParsedEquation:
    """An equation taken apart; ``hidden`` holds the rate of each hidden state."""

    left: Any
    right: Any
    acceleration: Any
    parameters: tuple[str, ...]
    symbol_z: Any
    symbol_v: Any
    symbol_a: Any
    hidden: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    inputs: tuple[str, ...] = ()

    @property
    def argument_symbols(self) -> list[Any]:
        """Symbols of z, z', hidden states, inputs and parameters, in this order."""
        import sympy

        names = (*self.hidden, *self.inputs, *self.parameters)
        return [self.symbol_z, self.symbol_v, *map(sympy.Symbol, names)]


class EquationTrees(NamedTuple):
    """The formulas of a law: two sides, and the rate of each hidden state."""

    # The coordinate is z in them, whatever the equation calls it.

    left: formulas.Node
    right: formulas.Node
    hidden: dict[str, formulas.Node]

    @property
    def all_trees(self) -> tuple[formulas.Node, ...]:
        return self.left, self.right, *self.hidden.values()

    @property
    def names(self) -> tuple[str, ...]:
        """Names as they are written, without primes, each once."""
        return tuple(dict.fromkeys(symbol.name for symbol in formulas.variable_names(*self.all_trees)))


@functools.lru_cache(maxsize=COMPILED)
def parse_equation(equation: str, inputs: tuple[str, ...] = ()) -> ParsedEquation:
    """Take an equation of motion apart."""
    import sympy

    law = f"the law {quote(equation)}"
    trees = parse_law_formulas(equation)
    if TIME in trees.names and TIME not in (*inputs, *trees.hidden):
        inputs = (*inputs, TIME)
    for name in inputs:
        if name not in trees.names:
            raise InputError(f"{law} does not name its input {quote(name)}")
        if name == "z" or name in trees.hidden:
            raise InputError(f"{law} has the input {name!r}, which it reckons itself; rename it")
    a, v, z = (sympy.Symbol(name) for name in ("z_second", "z_first", "z"))
    symbols = {"z": z, "z'": v, "z''": a}
    try:
        left, right, *rates = (algebra.sympy_expression(tree, symbols) for tree in trees.all_trees)
    except formulas.FormulaError as error:
        raise InputError(f"{law} cannot be read: {error}") from None
    # Powers of z - rest are not expanded: their terms cancel, by 1e8 times the rounding in fifth order.
    factor = (left - right).diff(a)
    if factor.has(a):
        factor = sympy.expand(factor)
    if factor == 0 or factor.has(a):
        raise InputError(f"{law} must be linear in z''; write it as z'' = ..., or with m*z''")
    acceleration = -(left - right).subs(a, 0) / factor
    try:
        for value in (acceleration, *rates):
            algebra.check_finite_numbers(value)
    except formulas.FormulaError as error:
        raise InputError(f"{law} cannot be computed with: {error}") from None
    known = {"z", *trees.hidden, *inputs, TIME}
    parameters = tuple(name for name in trees.names if name not in known)
    return ParsedEquation(
        left, right, acceleration, parameters, z, v, a, dict(zip(trees.hidden, rates, strict=True)), inputs
    )


def parse_law_formulas(equation: str) -> EquationTrees:
    """Read the formulas of a law, and check the names and primes in each of them."""
    law = f"the law {quote(equation)}"
    if len(equation) > formulas.MAX_CHARACTERS:
        raise InputError(f"{law} has {len(equation)} characters; at most {formulas.MAX_CHARACTERS} are read")
    first, *others = equation.split(";")
    if len(others) > _MOST_HIDDEN:
        raise InputError(f"{law} has {len(others)} hidden states; at most {_MOST_HIDDEN} are read")
    sides = first.split("=")
    if len(sides) != 2:
        raise InputError(f"{law} must have one equals sign")
    try:
        left, right = map(formulas.parse, sides)
        hidden = [_parse_hidden_state(law, text) for text in others]
    except formulas.FormulaError as error:
        raise InputError(f"{law} cannot be read: {error}") from None
    coordinate = _coordinate_name(law, left, right)
    if coordinate != "z":
        left, right = (_rename_coordinate(tree, coordinate) for tree in (left, right))
        hidden = [(name, _rename_coordinate(tree, coordinate)) for name, tree in hidden]
    trees = EquationTrees(left, right, dict(hidden))
    if coordinate in (name for name, _ in hidden):
        raise InputError(f"{law} has an equation for the rate of its coordinate; drop it")
    if len(trees.hidden) < len(hidden):
        raise InputError(f"{law} has two equations for one hidden state; write one")
    for position, tree in enumerate(trees.all_trees):
        for item in formulas.variable_names(tree):
            if item.primes > (2 if position < 2 else 1) or (item.primes and item.name != "z"):
                raise InputError(
                    f"{law} has a prime that does not follow {coordinate}, {item.text}; write "
                    f"{coordinate}, {coordinate}' and {coordinate}'', and a hidden state's rate in "
                    "an equation of its own"
                )
            if item.name in _RATES.values():
                raise InputError(f"{law} names {item.name}; write z' or z'', or take another name")
    return trees


def _coordinate_name(law: str, *trees: formulas.Node) -> str:
    """Name that has two primes; z where there is none."""
    result = tuple(dict.fromkeys(item.name for item in formulas.variable_names(*trees) if item.primes == 2))
    if not result or result == ("z",):
        return "z"
    if len(result) > 1:
        raise InputError(
            f"{law} has two coordinates, {' and '.join(result[:2])}; a law has one: write the "
            "other as a column of the record, or as a hidden state"
        )
    if "z" in (item.name for item in formulas.variable_names(*trees)):
        raise InputError(f"{law} names z next to its coordinate {result[0]}; take another name for z")
    if result[0] == TIME:
        raise InputError(f"{law} has t as its coordinate, which is the time; take another name")
    return result[0]


def _rename_coordinate(tree: formulas.Node, coordinate: str) -> formulas.Node:
    """Return the formula with z for its coordinate."""
    if isinstance(tree, formulas.Name) and tree.name == coordinate:
        return formulas.Name("z", tree.primes)
    if isinstance(tree, formulas.Operation):
        operands = tuple(_rename_coordinate(operand, coordinate) for operand in tree.operands)
        return formulas.Operation(tree.head, operands)
    return tree


def _parse_hidden_state(law: str, text: str) -> tuple[str, formulas.Node]:
    """Name and rate of a hidden state."""
    left, _, right = text.partition("=")
    item = formulas.parse(left) if left.strip() and right.strip() and "=" not in right else None
    if not isinstance(item, formulas.Name) or item.primes != 1 or item.name in ("z", "t"):
        raise InputError(
            f"{law}: {quote(text.strip())} must have one equals sign behind the rate of a hidden "
            "state, such as w' = z' - w"
        )
    return item.name, formulas.parse(right)


@functools.lru_cache(maxsize=COMPILED)
def compile_rates(equation: str, inputs: tuple[str, ...] = (), modules: str = "jax") -> Callable[..., Any]:
    """Compile the acceleration z'' and the rates of the hidden states as a function."""
    parsed = parse_equation(equation, inputs)
    rates = [parsed.acceleration, *parsed.hidden.values()]
    return algebra.compile_function(parsed.argument_symbols, rates, modules)


@functools.lru_cache(maxsize=COMPILED)
def compile_jacobian(equation: str, inputs: tuple[str, ...] = ()) -> Callable[..., np.ndarray]:
    """Compile the derivatives (rates, states) of z'' and of the hidden states' rates by the state."""
    # All of it is NaN at a jump, as of dry friction at z' = 0.
    import sympy

    parsed = parse_equation(equation, inputs)
    # Of real numbers, or the derivative of a modulus would be one of complex numbers.
    real = {symbol: sympy.Symbol(symbol.name, real=True) for symbol in parsed.argument_symbols}
    rates = [rate.xreplace(real) for rate in (parsed.acceleration, *parsed.hidden.values())]
    states = list(real.values())[: 2 + len(parsed.hidden)]
    return jacobian_function(rates, states, list(real.values()))


def jacobian_function(
    rates: Sequence[sympy.Expr], by: Sequence[sympy.Symbol], arguments: Sequence[sympy.Symbol]
) -> Callable[..., np.ndarray]:
    """Compile the derivatives (rates, by) of rates as a function of real symbols; NaN at a jump."""
    # The derivative of a sign is an impulse.
    names = [{"DiracDelta": lambda position: math.nan if position == 0.0 else 0.0}, "numpy"]
    function = algebra.compile_function(arguments, rate_derivatives(rates, by), names)

    def matrix(*values: float) -> np.ndarray:
        # NumPy's numbers overflow to infinity and have no roots below zero; Python's have.
        with np.errstate(all="ignore"):
            slopes = np.array(function(*map(np.float64, values))).reshape(len(rates), len(by))
        # The derivative of a power of a negative number holds its logarithm.
        if np.iscomplexobj(slopes) or np.isnan(slopes).any():
            return np.full(slopes.shape, math.nan)
        return slopes.astype(np.float64)

    return matrix


def rate_derivatives(rates: Sequence[sympy.Expr], by: Sequence[sympy.Symbol]) -> list[sympy.Expr]:
    """Return the derivatives of each rate by each real symbol, one rate after the other."""
    import sympy

    def step(inner: sympy.Expr) -> sympy.Expr:
        return 2 * sympy.Heaviside(inner) - 1

    # Of what SymPy cannot know to be real, as asin(z), these have derivatives of complex numbers.
    for kind, instead in ((sympy.sign, step), (sympy.Abs, lambda inner: inner * step(inner))):
        rates = [
            rate.replace(
                lambda part, kind=kind: part.func is kind and not part.args[0].is_extended_real,
                lambda part, instead=instead: instead(part.args[0]),
            )
            for rate in rates
        ]
    return [rate.diff(item) for rate in rates for item in by]
