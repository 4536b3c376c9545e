"""Laws taken apart: from text to trees, to expressions, to functions.

A law is equations with semicolons between them. A name alone on the left is observed, and is a column
of the record; one with a prime is a hidden state with its rate; every other equation is one of motion,
of a coordinate with two primes. Without any, the coordinate is a stroke that the record prescribes.

Where the height is a straight line in the coordinate, ``height = shift + scale*z``, the law is turned
into one of the height as it is read: all that computes with a law has heights for its z.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular import formulas
from granular.formulas import algebra
from granular.shared.errors import InputError, quote
from reduced_models.records.inputs import TIME

if TYPE_CHECKING:
    import sympy

COMPILED = 64
"""Functions of laws that are kept in memory; each discovery makes up laws that never come back."""

PROGRAMS = 16
"""Programs of JAX that are kept in memory, of each kind; one takes some 20 MB."""

_RATES = {"z'": "z_first", "z''": "z_second"}
TIME_OR_OBSERVATION = re.compile(rf"(?<![\w']){TIME}(?![\w'])|(?:^|;)\s*[^\W\d]\w*\s*=")
"""Sign of a law that has inputs beside those that are columns of the record."""
_MOST_EQUATIONS = 12  # more are beyond what any record can tell apart


@dataclasses.dataclass(frozen=True)
class ParsedEquation:
    """A law taken apart into expressions, and the names in it.

    Of a prescribed stroke there is no acceleration: z, z' and z'' are inputs then.
    """

    left: Any
    right: Any
    acceleration: Any  # None along a prescribed stroke
    parameters: tuple[str, ...]
    symbol_z: Any
    symbol_v: Any
    symbol_a: Any
    hidden: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # rate of each hidden state
    inputs: tuple[str, ...] = ()
    observations: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    line: tuple[Any, Any] | None = None  # height at the text's z = 0, and per unit of it; None if it is z
    written: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # hidden rates in the text's z

    @property
    def rates(self) -> list[Any]:
        """Rates of all states but z: the acceleration, if there is one, and of hidden states."""
        return [*([] if self.acceleration is None else [self.acceleration]), *self.hidden.values()]

    @property
    def argument_symbols(self) -> list[Any]:
        """Symbols of z, z' (where they are states), hidden states, inputs and parameters."""
        import sympy

        motion = [] if self.acceleration is None else [self.symbol_z, self.symbol_v]
        names = (*self.hidden, *(_RATES.get(name, name) for name in self.inputs), *self.parameters)
        return [*motion, *map(sympy.Symbol, names)]


class EquationTrees(NamedTuple):
    """The formulas of a law by what stands on their left; the first coordinate is z in them."""

    motion: tuple[tuple[formulas.Node, formulas.Node], ...]  # sides of the equations of motion
    hidden: dict[str, formulas.Node]  # rates
    observations: dict[str, formulas.Node]
    coordinates: tuple[str, ...]  # z and others; none along a prescribed stroke
    all_trees: tuple[formulas.Node, ...]  # in the order of the text

    @property
    def names(self) -> tuple[str, ...]:
        """Names as they are written, without primes, each once."""
        return tuple(dict.fromkeys(symbol.name for symbol in formulas.variable_names(*self.all_trees)))

    @property
    def stroke(self) -> tuple[str, ...]:
        """Columns of a prescribed stroke that the law names: z, z', z''; empty where z is a state."""
        if self.coordinates:
            return ()
        names = {item.text for item in formulas.variable_names(*self.all_trees)}
        return tuple(name for name in ("z", *_RATES) if name in names)


@functools.lru_cache(maxsize=COMPILED)
def parse_equation(equation: str, inputs: tuple[str, ...] = ()) -> ParsedEquation:
    """Take a law apart."""
    import sympy

    law = f"the law {quote(equation)}"
    trees = parse_law_formulas(equation)
    states = {*trees.coordinates, *trees.hidden}
    given = (*trees.stroke, *([TIME] if TIME in trees.names and TIME not in states else []))
    inputs = tuple(dict.fromkeys((*inputs, *given)))
    for name in inputs:
        if name not in (*trees.names, *trees.stroke):
            raise InputError(f"{law} does not name its input {quote(name)}")
        if name in states:
            raise InputError(f"{law} has the input {name!r}, which it reckons itself; rename it")
    a, v, z = (sympy.Symbol(name) for name in ("z_second", "z_first", "z"))
    symbols = {"z": z, "z'": v, "z''": a}
    for name in trees.coordinates[1:]:
        symbols |= {f"{name}'": sympy.Symbol(f"{name}_first"), f"{name}''": sympy.Symbol(f"{name}_second")}
    try:
        motion = [[algebra.sympy_expression(side, symbols) for side in sides] for sides in trees.motion]
        hidden, observations = (
            {name: algebra.sympy_expression(tree, symbols) for name, tree in part.items()}
            for part in (trees.hidden, trees.observations)
        )
    except formulas.FormulaError as error:
        raise InputError(f"{law} cannot be read: {error}") from None
    seconds = [symbols[f"{name}''"] for name in trees.coordinates]
    accelerations = _solve_for_accelerations(law, [left - right for left, right in motion], seconds)
    for name, rate in zip(trees.coordinates[1:], accelerations[1:], strict=True):
        hidden |= {name: symbols[f"{name}'"], f"{name}_first": rate}
    known = dict(zip(seconds, accelerations, strict=True))
    observations = {name: value.xreplace(known) for name, value in observations.items()}
    try:
        for value in (*accelerations, *hidden.values(), *observations.values()):
            algebra.check_finite_numbers(value)
    except formulas.FormulaError as error:
        raise InputError(f"{law} cannot be computed with: {error}") from None
    first = accelerations[0] if accelerations else None
    left, right = motion[0] if motion else (None, None)
    names = {"z", *hidden, *inputs, TIME}
    parameters = tuple(name for name in trees.names if name not in names)
    line = _height_line(observations.get("height"), parameters) if motion else None
    written = hidden
    if line is not None:
        shift, scale = line
        inverse = {z: (z - shift) / scale, v: v / scale}
        first = scale * accelerations[0].xreplace(inverse)
        hidden, observations = (
            {name: value.xreplace(inverse) for name, value in part.items()} for part in (hidden, observations)
        )
        observations["height"] = z
    return ParsedEquation(
        left, right, first, parameters, z, v, a, hidden, inputs, observations, line, written
    )


def _height_line(height: Any, parameters: Collection[str]) -> tuple[Any, Any] | None:
    """Height at z = 0, and per unit of z, of an observed height; None if it is z, or no straight line."""
    import sympy

    z = sympy.Symbol("z")
    if height is None or height == z or not height.has(z):
        return None
    line = height.subs(z, 0), height.diff(z)
    known = {sympy.Symbol(name) for name in parameters}
    straight = line[1] != 0 and all(item.free_symbols <= known for item in line)
    return line if straight else None


def _solve_for_accelerations(
    law: str, differences: Sequence[sympy.Expr], seconds: Sequence[sympy.Symbol]
) -> list[sympy.Expr]:
    """Solve equations of motion, left side less right side, for their accelerations."""
    import sympy

    # Powers of z - rest are not expanded: their terms cancel, by 1e8 times the rounding in fifth order.
    factors = [[difference.diff(second) for second in seconds] for difference in differences]
    factors = [[sympy.expand(item) if item.has(*seconds) else item for item in row] for row in factors]
    matrix = sympy.Matrix(factors)
    if seconds and (matrix.has(*seconds) or matrix.det() == 0):
        names = " and ".join(str(second).replace("_second", "''") for second in seconds)
        raise InputError(f"{law} must be linear in {names}; write it as z'' = ..., or with m*z''")
    still = dict.fromkeys(seconds, 0)
    rest = [-difference.subs(still) for difference in differences]
    return (
        [rest[0] / factors[0][0]]
        if len(rest) == 1
        else list(matrix.LUsolve(sympy.Matrix(rest)) if rest else ())
    )


def parse_law_formulas(equation: str) -> EquationTrees:
    """Read the formulas of a law, and check the names and primes in each of them."""
    law = f"the law {quote(equation)}"
    if len(equation) > formulas.MAX_CHARACTERS:
        raise InputError(f"{law} has {len(equation)} characters; at most {formulas.MAX_CHARACTERS} are read")
    parts = equation.split(";")
    if len(parts) > _MOST_EQUATIONS:
        raise InputError(f"{law} has {len(parts)} equations; at most {_MOST_EQUATIONS} are read")
    sides = [_parse_sides(law, part) for part in parts]
    coordinates = _coordinate_names(law, sides)
    if coordinates[0] != "z":
        sides = [tuple(_rename_coordinate(side, coordinates[0]) for side in pair) for pair in sides]  # type: ignore[misc]  # a pair again
    motion, hidden, observations = [], dict[str, formulas.Node](), dict[str, formulas.Node]()
    every = list[formulas.Node]()
    for left, right in sides:
        if not isinstance(left, formulas.Name) or left.primes > 1:
            motion.append((left, right))
            every += [left, right]
            continue
        every.append(right)
        kind = hidden if left.primes else observations
        if left.primes and left.name in ("z", *coordinates):
            raise InputError(f"{law} has an equation for the rate of its coordinate; drop it")
        if left.name in (*hidden, *observations):
            raise InputError(f"{law} has two equations for {left.name}; write one")
        kind[left.name] = right
    used = ("z", *coordinates[1:]) if motion else ()
    trees = EquationTrees(tuple(motion), hidden, observations, used, tuple(every))
    _check_equation_names(law, trees, coordinates)
    return trees


def _parse_sides(law: str, text: str) -> tuple[formulas.Node, formulas.Node]:
    """Both sides of one of the equations of a law."""
    sides = text.split("=")
    if len(sides) != 2 or not all(side.strip() for side in sides):
        raise InputError(f"{law}: {quote(text.strip())} must have one equals sign, as in w' = z' - w")
    try:
        left, right = map(formulas.parse, sides)
    except formulas.FormulaError as error:
        raise InputError(f"{law} cannot be read: {error}") from None
    return left, right


def _coordinate_names(law: str, sides: Sequence[tuple[formulas.Node, formulas.Node]]) -> tuple[str, ...]:
    """Names of the coordinates, that which is observed as the height first; z where none has primes."""
    motion = [pair for pair in sides if not isinstance(pair[0], formulas.Name) or pair[0].primes > 1]
    rates = {left.name for left, _ in sides if isinstance(left, formulas.Name) and left.primes == 1}
    trees = [side for pair in motion or sides for side in pair]
    primes = 2 if motion else 1
    names = [item.name for item in formulas.variable_names(*trees) if item.primes >= primes]
    names = [name for name in dict.fromkeys(names) if motion or name not in rates]
    if motion and len(names) != len(motion):
        raise InputError(
            f"{law} has {len(motion)} equations of motion for {' and '.join(names) or 'no coordinate'}; "
            "write one with two primes, as in z'', for each coordinate"
        )
    if not motion and len(names) > 1:
        raise InputError(f"{law} has two prescribed strokes, {names[0]} and {names[1]}; a law has one")
    for left, right in sides:
        if isinstance(left, formulas.Name) and left.text == "height":
            observed = {item.name for item in formulas.variable_names(right)}
            names = [
                *(name for name in names if name in observed),
                *(name for name in names if name not in observed),
            ]
    if TIME in names:
        raise InputError(f"{law} has t as its coordinate, which is the time; take another name")
    every = (item.name for item in formulas.variable_names(*(side for pair in sides for side in pair)))
    if names and names[0] != "z" and "z" in every:
        if "z" not in names:
            raise InputError(f"{law} names z next to its coordinate {names[0]}; take another name for z")
        names.sort(key=lambda name: name != "z")
    return tuple(names) or ("z",)


def _check_equation_names(law: str, trees: EquationTrees, coordinates: tuple[str, ...]) -> None:
    """Refuse names that stand for two things, and primes that do not follow a coordinate."""
    motion = dict.fromkeys(trees.coordinates or ("z",), 2)
    for name in trees.observations:
        if name in (*trees.names, *trees.hidden, *coordinates, TIME):
            raise InputError(
                f"{law} has {name} on both sides; on the left alone it is observed, on the right it is a "
                "column of the record or a parameter"
            )
    if not trees.motion and not trees.observations:
        raise InputError(f"{law} has no coordinate: no name in it has two primes; write z'' = ...")
    for item in formulas.variable_names(*trees.all_trees):
        if item.primes > motion.get(item.name, 0):
            first = coordinates[0]
            raise InputError(
                f"{law} has a prime that does not follow {first}, {item.text}; write {first}, {first}' and "
                f"{first}'', and a hidden state's rate in an equation of its own"
            )
        if item.name in _RATES.values():
            raise InputError(f"{law} names {item.name}; write z' or z'', or take another name")
    for rate in trees.hidden.values():
        if any(item.primes > 1 for item in formulas.variable_names(rate)):
            raise InputError(
                f"{law} has an acceleration in the rate of a hidden state; put its equation there"
            )


def _rename_coordinate(tree: formulas.Node, coordinate: str) -> formulas.Node:
    """Return the formula with z for its coordinate."""
    if isinstance(tree, formulas.Name) and tree.name == coordinate:
        return formulas.Name("z", tree.primes)
    if isinstance(tree, formulas.Operation):
        operands = tuple(_rename_coordinate(operand, coordinate) for operand in tree.operands)
        return formulas.Operation(tree.head, operands)
    return tree


@functools.lru_cache(maxsize=COMPILED)
def compile_rates(equation: str, inputs: tuple[str, ...] = (), modules: str = "jax") -> Callable[..., Any]:
    """Compile the rates of all states but z: the acceleration, if there is one, and of hidden states."""
    parsed = parse_equation(equation, inputs)
    return algebra.compile_function(parsed.argument_symbols, parsed.rates, modules)


@functools.lru_cache(maxsize=COMPILED)
def compile_observation(
    equation: str, inputs: tuple[str, ...], name: str, modules: str = "jax"
) -> Callable[..., Any]:
    """Compile an observation as a function of the arguments of `compile_rates`."""
    parsed = parse_equation(equation, inputs)
    return algebra.compile_function(parsed.argument_symbols, parsed.observations[name], modules)


@functools.lru_cache(maxsize=COMPILED)
def compile_jacobian(equation: str, inputs: tuple[str, ...] = ()) -> Callable[..., np.ndarray]:
    """Compile the derivatives (rates, states) of z'' and of the hidden states' rates by the state."""
    # All of it is NaN at a jump, as of dry friction at z' = 0.
    import sympy

    parsed = parse_equation(equation, inputs)
    # Of real numbers, or the derivative of a modulus would be one of complex numbers.
    real = {symbol: sympy.Symbol(symbol.name, real=True) for symbol in parsed.argument_symbols}
    rates = [rate.xreplace(real) for rate in parsed.rates]
    count = len(parsed.rates) + (parsed.acceleration is not None)
    states = list(real.values())[:count]
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
