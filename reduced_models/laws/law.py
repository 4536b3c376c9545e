"""Laws of motion, declared as an equation that a person can write."""

from __future__ import annotations

import dataclasses
import functools
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.shared import algebra, grammar
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from reduced_models.records.inputs import TIME

if TYPE_CHECKING:
    import sympy

    from reduced_models.records.first_guesses import FirstGuesses

Starts = Callable[["FirstGuesses", np.random.Generator, int], dict[str, np.ndarray]]
SwingStarts = Callable[
    [np.ndarray, np.ndarray, "FirstGuesses", np.random.Generator, int], dict[str, np.ndarray] | None
]

COMPILED = 64
"""Functions of laws that are kept in memory; each discovery makes up laws that never come back."""

PROGRAMS = 16
"""Programs of JAX that are kept in memory, of each kind; one takes some 20 MB."""

_RATES = {"z'": "z_first", "z''": "z_second"}
_TIME_WORD = re.compile(rf"(?<![\w']){TIME}(?![\w'])")
_MOST_HIDDEN = 8  # states: beyond what any record can tell apart


@dataclasses.dataclass(frozen=True)
class Law:
    """A law z'' = f(z, z', hidden states, inputs) with parameters.

    Attributes
    ----------
    name : str
    equation : str
        Such as ``"z'' + 2*lam*z' + omega**2*z = g0"``: linear in ``z''``. A law with memory has
        hidden states, which start at zero, each with an equation of its own behind a semicolon:
        ``"z'' + k*z + f*w = 0; w' = r*z' - r*Abs(z')*w"``.
    start : callable or None
        ``start(guesses, random, count)`` gives random start values, an array of ``count`` for
        each parameter. None where the accelerations in the record are to tell them.
    positive : tuple of str
        Parameters that are above zero; they are searched for on a logarithmic scale.
    units : mapping of str to str
        SI units of the parameters.
    mapped : bool
        The law does not keep its form when the height is shifted or scaled, so it holds for
        z = (height - shift)/scale with a map of its own. Its z is a pure number and its time unit
        is fixed at 1 s.
    swing_form : SwingForm, optional
        Of a mapped law: the same law without a map, for the swing about the level of rest.
    source : str
    inputs : tuple of str
        Names in the equation that stand for columns of the record, such as the motion of a base or
        a force: known functions of time, in the units that the columns have. ``t``, the time since
        the start, is one wherever it is named.
    resolution : int
        How many times more steps a period a solution needs than one of a smooth law.
    """

    name: str
    equation: str
    start: Starts | None = None
    positive: tuple[str, ...] = ()
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    mapped: bool = False
    swing_form: SwingForm | None = None
    source: str = ""
    inputs: tuple[str, ...] = ()
    resolution: int = 1

    def __post_init__(self) -> None:
        # A law that names the time has it as an input that every record knows.
        if TIME not in self.inputs and _TIME_WORD.search(self.equation):
            trees = _trees(self.equation)
            if TIME in trees.names and TIME not in trees.hidden:
                object.__setattr__(self, "inputs", (*self.inputs, TIME))

    @property
    def parsed(self) -> Parsed:
        """The equation taken apart."""
        return parse(self.equation, self.inputs)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, in the order in which the equation names them."""
        return self.parsed.parameters

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of the hidden states."""
        return tuple(self.parsed.hidden)

    @property
    def acceleration(self) -> sympy.Expr:
        """Z'' as an expression in the symbols z, z_first, hidden states, inputs and parameters."""
        return self.parsed.acceleration

    def sympy_equation(self, values: Mapping[str, float] | None = None) -> sympy.Eq:
        """The equation in z(t), with numbers where ``values`` gives them.

        Hidden states stay symbols; `sympy_hidden` has their equations.
        """
        import sympy

        parsed = self.parsed
        t = sympy.Symbol("t")
        z = sympy.Function("z")(t)
        numbers = {sympy.Symbol(name): number for name, number in (values or {}).items()}
        sides = [
            side.subs(numbers).subs(
                {parsed.symbol_a: z.diff(t, 2), parsed.symbol_v: z.diff(t), parsed.symbol_z: z}
            )
            for side in (parsed.left, parsed.right)
        ]
        return sympy.Eq(*sides, evaluate=False)

    def sympy_hidden(self, values: Mapping[str, float] | None = None) -> dict[str, sympy.Expr]:
        """The rate of each hidden state, in z(t) and z'(t)."""
        import sympy

        parsed, t = self.parsed, sympy.Symbol("t")
        z = sympy.Function("z")(t)
        numbers = {sympy.Symbol(name): number for name, number in (values or {}).items()}
        motion = {parsed.symbol_v: z.diff(t), parsed.symbol_z: z}
        return {name: rate.subs(numbers).subs(motion) for name, rate in parsed.hidden.items()}


@dataclasses.dataclass(frozen=True)
class SwingForm:
    """A mapped law as one of the swing u about the level of rest, in amplitudes.

    A search is quick where no map bends its valleys.

    Attributes
    ----------
    law : Law
        In u.
    start : callable
        ``start(time, swing, guesses, random, count)`` gives random start values of that law; None
        where the record does not tell.
    mapped : callable
        From its parameters, arrays (s,), to those of the mapped law with ``shift`` and ``scale`` of
        the map from the level of rest, in amplitudes.
    """

    law: Law
    start: SwingStarts
    mapped: Callable[[Mapping[str, np.ndarray]], dict[str, np.ndarray]]


@dataclasses.dataclass(frozen=True)
class Parsed:
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
    def arguments(self) -> list[Any]:
        """Symbols of z, z', hidden states, inputs and parameters, in this order."""
        import sympy

        names = (*self.hidden, *self.inputs, *self.parameters)
        return [self.symbol_z, self.symbol_v, *map(sympy.Symbol, names)]


class _Trees(NamedTuple):
    """The formulas of a law: two sides, and the rate of each hidden state.

    Whatever the coordinate is called, it is z in them.
    """

    left: grammar.Node
    right: grammar.Node
    hidden: dict[str, grammar.Node]

    @property
    def all(self) -> tuple[grammar.Node, ...]:
        return self.left, self.right, *self.hidden.values()

    @property
    def names(self) -> tuple[str, ...]:
        """As they are written, without primes, each once."""
        return tuple(dict.fromkeys(one.name for one in grammar.names(*self.all)))


@functools.lru_cache(maxsize=COMPILED)
def parse(equation: str, inputs: tuple[str, ...] = ()) -> Parsed:
    """Take an equation of motion apart.

    Raises
    ------
    InputError
        If the text is no equation, is not linear in z'', or names something unknown.
    """
    import sympy

    law = f"the law {quoted(equation)}"
    trees = _trees(equation)
    if TIME in trees.names and TIME not in (*inputs, *trees.hidden):
        inputs = (*inputs, TIME)
    for name in inputs:
        if name not in trees.names:
            raise InputError(f"{law} does not name its input {quoted(name)}")
        if name == "z" or name in trees.hidden:
            raise InputError(f"{law} has the input {name!r}, which it reckons itself; rename it")
    a, v, z = (sympy.Symbol(name) for name in ("z_second", "z_first", "z"))
    symbols = {"z": z, "z'": v, "z''": a}
    try:
        left, right, *rates = (algebra.expression(tree, symbols) for tree in trees.all)
        difference = sympy.expand(left - right)
    except grammar.FormulaError as error:
        raise InputError(f"{law} cannot be read: {error}") from None
    factor = difference.coeff(a, 1)
    rest = sympy.expand(difference - factor * a)
    if factor == 0 or rest.has(a) or factor.has(a):
        raise InputError(f"{law} must be linear in z''; write it as z'' = ..., or with m*z''")
    acceleration = -rest / factor
    try:
        for each in (acceleration, *rates):
            algebra.check_numbers(each)
    except grammar.FormulaError as error:
        raise InputError(f"{law} cannot be reckoned with: {error}") from None
    known = {"z", *trees.hidden, *inputs, TIME}
    parameters = tuple(name for name in trees.names if name not in known)
    return Parsed(
        left, right, acceleration, parameters, z, v, a,
        dict(zip(trees.hidden, rates, strict=True)), inputs,
    )  # fmt: skip


def _trees(equation: str) -> _Trees:
    """The formulas of a law; names and primes mean something in each of them."""
    law = f"the law {quoted(equation)}"
    if len(equation) > grammar.MOST_SIGNS:
        raise InputError(
            f"{law} has {len(equation)} characters; at most {grammar.MOST_SIGNS} are read"
        )
    first, *others = equation.split(";")
    if len(others) > _MOST_HIDDEN:
        raise InputError(f"{law} has {len(others)} hidden states; at most {_MOST_HIDDEN} are read")
    sides = first.split("=")
    if len(sides) != 2:
        raise InputError(f"{law} must have one equals sign")
    try:
        left, right = map(grammar.parse, sides)
        hidden = [_hidden(law, text) for text in others]
    except grammar.FormulaError as error:
        raise InputError(f"{law} cannot be read: {error}") from None
    coordinate = _coordinate(law, left, right)
    if coordinate != "z":
        left, right = (_renamed(tree, coordinate) for tree in (left, right))
        hidden = [(name, _renamed(tree, coordinate)) for name, tree in hidden]
    found = _Trees(left, right, dict(hidden))
    if coordinate in (name for name, _ in hidden):
        raise InputError(f"{law} has an equation for the rate of its coordinate; drop it")
    if len(found.hidden) < len(hidden):
        raise InputError(f"{law} has two equations for one hidden state; write one")
    for place, tree in enumerate(found.all):
        for one in grammar.names(tree):
            if one.primes > (2 if place < 2 else 1) or (one.primes and one.name != "z"):
                raise InputError(
                    f"{law} has a prime that does not follow {coordinate}, {one.text}; write "
                    f"{coordinate}, {coordinate}' and {coordinate}'', and a hidden state's rate in "
                    "an equation of its own"
                )
            if one.name in _RATES.values():
                raise InputError(f"{law} names {one.name}; write z' or z'', or take another name")
    return found


def _coordinate(law: str, *trees: grammar.Node) -> str:
    """The name that has two primes; z where there is none."""
    found = tuple(dict.fromkeys(one.name for one in grammar.names(*trees) if one.primes == 2))
    if not found or found == ("z",):
        return "z"
    if len(found) > 1:
        raise InputError(
            f"{law} has two coordinates, {' and '.join(found[:2])}; a law has one: write the other "
            "as a column of the record, or as a hidden state"
        )
    if "z" in (one.name for one in grammar.names(*trees)):
        raise InputError(f"{law} names z beside its coordinate {found[0]}; take another name for z")
    if found[0] == TIME:
        raise InputError(f"{law} has t as its coordinate, which is the time; take another name")
    return found[0]


def _renamed(tree: grammar.Node, coordinate: str) -> grammar.Node:
    """A formula with z for its coordinate."""
    if isinstance(tree, grammar.Name) and tree.name == coordinate:
        return grammar.Name("z", tree.primes)
    if isinstance(tree, grammar.Applied):
        operands = tuple(_renamed(each, coordinate) for each in tree.operands)
        return grammar.Applied(tree.head, operands)
    return tree


def _hidden(law: str, text: str) -> tuple[str, grammar.Node]:
    """Name and rate of a hidden state."""
    left, _, right = text.partition("=")
    one = grammar.parse(left) if left.strip() and right.strip() and "=" not in right else None
    if not isinstance(one, grammar.Name) or one.primes != 1 or one.name in ("z", "t"):
        raise InputError(
            f"{law}: {quoted(text.strip())} must have one equals sign behind the rate of a hidden "
            "state, such as w' = z' - w"
        )
    return one.name, grammar.parse(right)


@functools.lru_cache(maxsize=COMPILED)
def compiled_field(
    equation: str, inputs: tuple[str, ...] = (), modules: str = "jax"
) -> Callable[..., Any]:
    """[z'', rates of the hidden states], of z, z', hidden states, inputs and parameters."""
    parsed = parse(equation, inputs)
    rates = [parsed.acceleration, *parsed.hidden.values()]
    return algebra.function_of(parsed.arguments, rates, modules)


@functools.lru_cache(maxsize=COMPILED)
def compiled_jacobian(equation: str, inputs: tuple[str, ...] = ()) -> Callable[..., np.ndarray]:
    """Derivatives of z'' and the rates of the hidden states, as a function of the same numbers.

    An array (1 + hidden, 2 + hidden): by z, z' and the hidden states. All of it is NaN where one
    jumps, as dry friction does at z' = 0.
    """
    import sympy

    parsed = parse(equation, inputs)
    # Of real numbers, or the derivative of a modulus would be one of complex numbers.
    real = {symbol: sympy.Symbol(symbol.name, real=True) for symbol in parsed.arguments}
    rates = [rate.xreplace(real) for rate in (parsed.acceleration, *parsed.hidden.values())]
    states = list(real.values())[: 2 + len(parsed.hidden)]
    return jacobian_of(rates, states, list(real.values()))


def jacobian_of(
    rates: Sequence[sympy.Expr], by: Sequence[sympy.Symbol], arguments: Sequence[sympy.Symbol]
) -> Callable[..., np.ndarray]:
    """Derivatives of rates as a function of real symbols; see `compiled_jacobian`."""
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
    # The derivative of a sign is an impulse.
    names = [{"DiracDelta": lambda place: math.nan if place == 0.0 else 0.0}, "numpy"]
    found = algebra.function_of(arguments, [rate.diff(one) for rate in rates for one in by], names)

    def matrix(*values: float) -> np.ndarray:
        # NumPy's numbers overflow to infinity and have no roots below zero; Python's have.
        with np.errstate(all="ignore"):
            slopes = np.array(found(*map(np.float64, values))).reshape(len(rates), len(by))
        # The derivative of a power of a negative number holds its logarithm.
        if np.iscomplexobj(slopes) or np.isnan(slopes).any():
            return np.full(slopes.shape, math.nan)
        return slopes.astype(np.float64)

    return matrix


def law_from_text(
    equation: str, columns: Collection[str] = (), declared: Collection[str] = ()
) -> Law:
    """A law from its equation alone; names that are columns of the record are its inputs.

    All other names are parameters. One that looks like a column or a constant, and is none, is
    refused unless it is among the ``declared`` parameters.

    Raises
    ------
    InputError
        If the text is no equation, has no parameter, or a name that looks like something else.
    """
    trees = _trees(equation)
    law = f"the law {quoted(equation)}"
    for name in grammar.constants(*trees.all):
        if name in columns:
            raise InputError(
                f"{law} names {name}, a number, and the record has a column of that name; rename "
                "the column"
            )
    inputs = tuple(name for name in trees.names if name in columns and name != "z")
    found = Law(name=" ".join(equation.split()), equation=equation, inputs=inputs)
    for name in found.parameters:
        if name not in declared:
            _ask_about(law, name, columns)
    if not found.parameters:
        raise InputError(f"{law} has no parameter, so there is nothing to fit")
    return found


_MOTION = {
    "height": "z", "displacement": "z", "velocity": "z'", "speed": "z'", "acceleration": "z''",
    "time": "t",
}  # fmt: skip
_COLUMNS = ("force", "input", "drive", "load", "excitation", "voltage", "current", "temperature",
            "pressure", "torque")  # fmt: skip
_NUMBERS = ("pi", "e", "inf", "nan", "infinity")


def _ask_about(law: str, name: str, columns: Collection[str]) -> None:
    """Refuse a parameter whose name says that it is something else."""
    lower, near = name.lower(), {each.lower(): each for each in columns}
    declare = f"or declare the parameter, start={{{name!r}: ...}}"
    if lower in near:
        raise InputError(
            f"{law} names {name}, and the record has a column {near[lower]!r}; write that, "
            f"{declare}"
        )
    if name in _MOTION:
        raise InputError(f"{law} names {name}; write {_MOTION[name]} for it, {declare}")
    if lower in _COLUMNS:
        there = ", ".join(map(repr, columns)) or "none"
        raise InputError(
            f"{law} names {name}, which looks like a column, and the record has: {there}; add the "
            f"column, {declare}"
        )
    if lower in _NUMBERS and len(name) > 1:
        raise InputError(
            f"{law} names {name}, which looks like a number; write pi or e for those, {declare}"
        )
