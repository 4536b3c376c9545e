"""Parse laws from text to syntax trees and expressions, and compile them to functions.

A law is a list of equations separated by semicolons. The left side shows the kind of an equation:

- A name alone on the left is an observed column of the record.
- A name with one prime on the left is a hidden state, and the equation gives its rate.
- Every other equation is an equation of motion for a coordinate, which has two primes.

Without an equation of motion the coordinate is a stroke that the record prescribes.

If the height is a linear function of the coordinate, ``height = shift + scale*z``, the law is converted
to a law of the height when it is read: in all later computations z is the height.
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
"""Maximum number of compiled laws in memory; each discovery creates many laws that are used only once."""

PROGRAMS = 16
"""Maximum number of JAX programs of each kind in memory; one program takes about 20 MB."""

_RATES = {"z'": "z_first", "z''": "z_second"}
TIME_OR_OBSERVATION = re.compile(rf"(?<![\w']){TIME}(?![\w'])|(?:^|;)\s*[^\W\d]\w*\s*=")
"""Pattern that matches the text of a law if the law contains the time or an observed column."""
_SHIFT, _SHIFT_POINTS = 0.25, 8  # shift and points at which equations are compared
_MAXIMUM_EQUATIONS = 12  # more could not be identified from any record


@dataclasses.dataclass(frozen=True)
class ParsedEquation:
    """A law as expressions, with the names that occur in it.

    Along a prescribed stroke the acceleration is None, and z, z' and z'' are inputs.
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
    def acceleration_and_hidden_rates(self) -> list[Any]:
        """The acceleration (if z is a state) and the rates of the hidden states."""
        return [*([] if self.acceleration is None else [self.acceleration]), *self.hidden.values()]

    @functools.cached_property
    def height_parameters(self) -> frozenset[str]:
        """Parameters that are heights: a shift of such a parameter and of z does not change the equations."""
        import sympy

        # By numbers: expanding the derivatives of a law with hidden states takes minutes.
        equations = [*self.acceleration_and_hidden_rates, *self.observations.values()]
        symbols = sorted(set().union(*(equation.free_symbols for equation in equations)), key=str)
        evaluate = algebra.compile_expressions(symbols, equations)
        points = np.random.default_rng(1).uniform(0.5, 1.5, (len(symbols), _SHIFT_POINTS))

        def changed(*shifted: Any) -> bool:
            moved = points + _SHIFT * np.array([[symbol in shifted] for symbol in symbols])
            with np.errstate(all="ignore"):
                before, after = (
                    np.array([np.broadcast_to(value, _SHIFT_POINTS) for value in evaluate(*at)], dtype=float)
                    for at in (points, moved)
                )
            return not np.allclose(before, after, rtol=1e-9, atol=1e-9, equal_nan=True)

        return frozenset(
            name
            for name in self.parameters
            if changed(sympy.Symbol(name)) and not changed(sympy.Symbol(name), self.symbol_z)
        )

    @property
    def argument_symbols(self) -> list[Any]:
        """Symbols of z and z' (if they are states), hidden states, inputs and parameters."""
        import sympy

        motion = [] if self.acceleration is None else [self.symbol_z, self.symbol_v]
        names = (*self.hidden, *(_RATES.get(name, name) for name in self.inputs), *self.parameters)
        return [*motion, *map(sympy.Symbol, names)]


class EquationTrees(NamedTuple):
    """Formulas of a law, grouped by kind of equation; the first coordinate is renamed to z."""

    motion: tuple[tuple[formulas.Node, formulas.Node], ...]  # sides of the equations of motion
    hidden: dict[str, formulas.Node]  # rates
    observations: dict[str, formulas.Node]
    coordinates: tuple[str, ...]  # z and others; none along a prescribed stroke
    all_trees: tuple[formulas.Node, ...]  # in the order of the text

    @property
    def names(self) -> tuple[str, ...]:
        """All names in the formulas, without primes, each once."""
        return tuple(dict.fromkeys(symbol.name for symbol in formulas.variable_names(*self.all_trees)))

    @property
    def stroke(self) -> tuple[str, ...]:
        """Names among z, z' and z'' that a prescribed stroke supplies as inputs; empty if z is a state."""
        if self.coordinates:
            return ()
        names = {item.text for item in formulas.variable_names(*self.all_trees)}
        return tuple(name for name in ("z", *_RATES) if name in names)


@functools.lru_cache(maxsize=COMPILED)
def parse_equation(equation: str, inputs: tuple[str, ...] = ()) -> ParsedEquation:
    """Parse a law into expressions."""
    import sympy

    law = f"the law {quote(equation)}"
    trees = parse_law_formulas(equation)
    states = {*trees.coordinates, *trees.hidden}
    given = (*trees.stroke, *([TIME] if TIME in trees.names and TIME not in states else []))
    inputs = tuple(dict.fromkeys((*inputs, *given)))
    for name in inputs:
        if name not in (*trees.names, *trees.stroke):
            raise InputError(
                f"{law} does not contain the input {quote(name)}; remove the input or use it in the equation"
            )
        if name in states:
            raise InputError(f"{law} has {name!r} as an input and as a state; rename one of them")
    a, v, z = (sympy.Symbol(name) for name in ("z_second", "z_first", "z"))
    symbols = {"z": z, "z'": v, "z''": a}
    symbols |= {f"{name}'": sympy.Symbol(f"{name}_first") for name in trees.hidden}
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
    rates = _hidden_rates_without_other_rates(law, hidden)
    motion = [[side.xreplace(rates) for side in sides] for sides in motion]
    hidden = {name: rates[symbols[f"{name}'"]] for name in hidden}
    observations = {name: value.xreplace(rates) for name, value in observations.items()}
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
        raise InputError(f"{law} cannot be evaluated: {error}") from None
    first = accelerations[0] if accelerations else None
    left, right = motion[0] if motion else (None, None)
    names = {"z", *hidden, *inputs, TIME}
    parameters = tuple(name for name in trees.names if name not in names)
    line = _height_intercept_and_slope(observations.get("height"), parameters) if motion else None
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


def _hidden_rates_without_other_rates(law: str, hidden: Mapping[str, Any]) -> dict[Any, Any]:
    """Return the rates of hidden states by symbol; rates on a right side are replaced by their formulas."""
    import sympy

    waiting = {sympy.Symbol(f"{name}_first"): rate for name, rate in hidden.items()}
    rates: dict[Any, Any] = {}
    while waiting:
        ready = {symbol: rate for symbol, rate in waiting.items() if not rate.has(*waiting)}
        if not ready:
            raise InputError(
                f"in {law} the rate of a hidden state depends on itself; solve the equation for the rate"
            )
        rates |= ready
        waiting = {symbol: rate.xreplace(rates) for symbol, rate in waiting.items() if symbol not in ready}
    return rates


def _height_intercept_and_slope(height: Any, parameters: Collection[str]) -> tuple[Any, Any] | None:
    """Return the height at z = 0 and its slope in z; None if the height is z itself or not linear in z."""
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
    """Solve equations of motion for the accelerations; each is given as its left minus its right side."""
    import sympy

    # Powers of z - rest are not expanded: their terms would cancel, with 1e8 times the rounding at fifth
    # order.
    factors = [[difference.diff(second) for second in seconds] for difference in differences]
    factors = [[sympy.expand(item) if item.has(*seconds) else item for item in row] for row in factors]
    matrix = sympy.Matrix(factors)
    if seconds and (matrix.has(*seconds) or matrix.det() == 0):
        names = " and ".join(str(second).replace("_second", "''") for second in seconds)
        raise InputError(
            f"{law} must be linear in {names}; write the law as z'' = ..., or with a factor as in m*z''"
        )
    still = dict.fromkeys(seconds, 0)
    rest = [-difference.subs(still) for difference in differences]
    return (
        [rest[0] / factors[0][0]]
        if len(rest) == 1
        else list(matrix.LUsolve(sympy.Matrix(rest)) if rest else ())
    )


def parse_law_formulas(equation: str) -> EquationTrees:
    """Parse the formulas of a law, and check the names and primes in them."""
    law = f"the law {quote(equation)}"
    if len(equation) > formulas.MAX_CHARACTERS:
        raise InputError(
            f"{law} has {len(equation)} characters, but the maximum is {formulas.MAX_CHARACTERS}; shorten it"
        )
    parts = equation.split(";")
    if len(parts) > _MAXIMUM_EQUATIONS:
        raise InputError(
            f"{law} has {len(parts)} equations, but the maximum is {_MAXIMUM_EQUATIONS}; use fewer"
        )
    sides = [_parse_sides(law, part) for part in parts]
    coordinates = _coordinate_names(law, sides)
    if coordinates[0] != "z":
        sides = [tuple(_rename_coordinate_to_z(side, coordinates[0]) for side in pair) for pair in sides]  # type: ignore[misc]  # a pair again
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
            raise InputError(
                f"{law} has an equation for the velocity of its coordinate; remove this equation"
            )
        if left.name in (*hidden, *observations):
            raise InputError(f"{law} has two equations for {left.name}; remove one")
        kind[left.name] = right
    used = ("z", *coordinates[1:]) if motion else ()
    trees = EquationTrees(tuple(motion), hidden, observations, used, tuple(every))
    _check_equation_names(law, trees, coordinates)
    return trees


def _parse_sides(law: str, text: str) -> tuple[formulas.Node, formulas.Node]:
    """Parse both sides of one equation of a law."""
    sides = text.split("=")
    if len(sides) != 2 or not all(side.strip() for side in sides):
        raise InputError(f"{law}: {quote(text.strip())} must have one equals sign, as in w' = z' - w")
    try:
        left, right = map(formulas.parse, sides)
    except formulas.FormulaError as error:
        raise InputError(f"{law} cannot be read: {error}") from None
    return left, right


def _coordinate_names(law: str, sides: Sequence[tuple[formulas.Node, formulas.Node]]) -> tuple[str, ...]:
    """Return the names of the coordinates, first the one observed as height; z if no name has primes."""
    motion = [pair for pair in sides if not isinstance(pair[0], formulas.Name) or pair[0].primes > 1]
    rates = {left.name for left, _ in sides if isinstance(left, formulas.Name) and left.primes == 1}
    trees = [side for pair in motion or sides for side in pair]
    primes = 2 if motion else 1
    names = [item.name for item in formulas.variable_names(*trees) if item.primes >= primes]
    names = [name for name in dict.fromkeys(names) if motion or name not in rates]
    if motion and len(names) != len(motion):
        raise InputError(
            f"{law} has {len(motion)} equations of motion for "
            f"{' and '.join(names) or 'no coordinate'}; write one equation for each coordinate, "
            "which contains its acceleration, such as z''"
        )
    if not motion and len(names) > 1:
        raise InputError(f"{law} has two prescribed strokes, {names[0]} and {names[1]}; a law can have one")
    for left, right in sides:
        if isinstance(left, formulas.Name) and left.text == "height":
            observed = {item.name for item in formulas.variable_names(right)}
            names = [
                *(name for name in names if name in observed),
                *(name for name in names if name not in observed),
            ]
    if TIME in names:
        raise InputError(
            f"{law} has t as its coordinate, but t is the time; use another name for the coordinate"
        )
    every = (item.name for item in formulas.variable_names(*(side for pair in sides for side in pair)))
    if names and names[0] != "z" and "z" in every:
        if "z" not in names:
            raise InputError(
                f"{law} contains z in addition to its coordinate {names[0]}; use another name for z"
            )
        names.sort(key=lambda name: name != "z")
    return tuple(names) or ("z",)


def _check_equation_names(law: str, trees: EquationTrees, coordinates: tuple[str, ...]) -> None:
    """Raise an error for names with two meanings, or for primes that do not follow a coordinate."""
    motion = dict.fromkeys(trees.coordinates or ("z",), 2) | dict.fromkeys(trees.hidden, 1)
    for name in trees.observations:
        if name in (*trees.names, *trees.hidden, *coordinates, TIME):
            raise InputError(
                f"{law} has {name} on both sides, but a name alone on the left is an observed column, which "
                "cannot occur elsewhere; rename one of them"
            )
    if not trees.motion and not trees.observations:
        raise InputError(f"{law} has no coordinate; mark one variable with two primes, as in z'' = ...")
    for item in formulas.variable_names(*trees.all_trees):
        if item.primes > motion.get(item.name, 0):
            first = coordinates[0]
            raise InputError(
                f"{law} contains {item.text}, but primes can follow only {first} (up to two) and a "
                f"hidden state (one); write {first}, {first}' and {first}'', or add an "
                "equation such as w' = ... for the hidden state"
            )
        if item.name in _RATES.values():
            raise InputError(
                f"{law} contains the reserved name {item.name}; write z' or z'', or use another name"
            )
    for rate in trees.hidden.values():
        if any(item.primes > 1 for item in formulas.variable_names(rate)):
            raise InputError(
                f"in {law} the rate of a hidden state contains the acceleration; replace the acceleration by "
                "the equation of motion"
            )


def _rename_coordinate_to_z(tree: formulas.Node, coordinate: str) -> formulas.Node:
    """Return a formula with the coordinate renamed to z."""
    if isinstance(tree, formulas.Name) and tree.name == coordinate:
        return formulas.Name("z", tree.primes)
    if isinstance(tree, formulas.Operation):
        operands = tuple(_rename_coordinate_to_z(operand, coordinate) for operand in tree.operands)
        return formulas.Operation(tree.head, operands)
    return tree


@functools.lru_cache(maxsize=COMPILED)
def compile_rates(equation: str, inputs: tuple[str, ...] = (), modules: str = "jax") -> Callable[..., Any]:
    """Compile the acceleration (unless the motion is prescribed) and the rates of the hidden states."""
    parsed = parse_equation(equation, inputs)
    return algebra.compile_expressions(parsed.argument_symbols, parsed.acceleration_and_hidden_rates, modules)


@functools.lru_cache(maxsize=COMPILED)
def compile_observation(
    equation: str, inputs: tuple[str, ...], name: str, modules: str = "jax"
) -> Callable[..., Any]:
    """Compile an observation as a function of the arguments of `compile_rates`."""
    parsed = parse_equation(equation, inputs)
    return algebra.compile_expressions(parsed.argument_symbols, parsed.observations[name], modules)


@functools.lru_cache(maxsize=COMPILED)
def compile_jacobian(equation: str, inputs: tuple[str, ...] = ()) -> Callable[..., np.ndarray]:
    """Compile the derivatives (rates, states) of z'' and the hidden rates with respect to the state."""
    # All entries are NaN at a jump, as of dry friction at z' = 0.
    import sympy

    parsed = parse_equation(equation, inputs)
    # With real symbols, since the derivative of a modulus is different for complex ones.
    real = {symbol: sympy.Symbol(symbol.name, real=True) for symbol in parsed.argument_symbols}
    rates = [rate.xreplace(real) for rate in parsed.acceleration_and_hidden_rates]
    count = len(parsed.acceleration_and_hidden_rates) + (parsed.acceleration is not None)
    states = list(real.values())[:count]
    return compile_derivative_matrix(rates, states, list(real.values()))


def compile_derivative_matrix(
    rates: Sequence[sympy.Expr], by: Sequence[sympy.Symbol], arguments: Sequence[sympy.Symbol]
) -> Callable[..., np.ndarray]:
    """Compile the derivatives (rates, symbols) of rates with respect to real symbols; NaN at a jump."""
    # The derivative of a sign is a delta function.
    names = [{"DiracDelta": lambda position: math.nan if position == 0.0 else 0.0}, "numpy"]
    function = algebra.compile_expressions(arguments, rate_derivatives(rates, by), names)

    def evaluate_derivative_matrix(*values: float) -> np.ndarray:
        # NumPy floats overflow to infinity and have NaN for roots of negative numbers; Python floats do not.
        with np.errstate(all="ignore"):
            slopes = np.array(function(*map(np.float64, values))).reshape(len(rates), len(by))
        # The derivative of a power of a negative number contains its logarithm, which is complex.
        if np.iscomplexobj(slopes) or np.isnan(slopes).any():
            return np.full(slopes.shape, math.nan)
        return slopes.astype(np.float64)

    return evaluate_derivative_matrix


def rate_derivatives(rates: Sequence[sympy.Expr], by: Sequence[sympy.Symbol]) -> list[sympy.Expr]:
    """Return the derivatives of each rate with respect to each real symbol, one rate after another."""
    import sympy

    def sign_by_heaviside(inner: sympy.Expr) -> sympy.Expr:
        return 2 * sympy.Heaviside(inner) - 1

    # For arguments that SymPy cannot recognise as real, such as asin(z), it gives the complex derivatives of
    # these functions.
    for kind, instead in (
        (sympy.sign, sign_by_heaviside),
        (sympy.Abs, lambda inner: inner * sign_by_heaviside(inner)),
    ):
        rates = [
            rate.replace(
                lambda part, kind=kind: part.func is kind and not part.args[0].is_extended_real,
                lambda part, instead=instead: instead(part.args[0]),
            )
            for rate in rates
        ]
    return [rate.diff(item) for rate in rates for item in by]
