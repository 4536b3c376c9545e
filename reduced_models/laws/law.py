"""Laws of motion, declared as an equation that a person can write."""

from __future__ import annotations

import dataclasses
import functools
import math
import re
from collections.abc import Callable, Collection, Mapping
from tokenize import TokenError
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.shared.errors import InputError

if TYPE_CHECKING:
    import sympy

    from reduced_models.records.first_guesses import FirstGuesses

Starts = Callable[["FirstGuesses", np.random.Generator, int], dict[str, np.ndarray]]
SwingStarts = Callable[
    [np.ndarray, np.ndarray, "FirstGuesses", np.random.Generator, int], dict[str, np.ndarray] | None
]

_ALLOWED = re.compile(r"[A-Za-z0-9_+\-*/().,'=; ]+")
_HIDDEN = re.compile(r"\s*([A-Za-z_]\w*)'\s*")
_FUNCTIONS = ("exp", "log", "sqrt", "sin", "cos", "tanh", "sign", "Abs")


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
        a force: known functions of time, in the units that the columns have.
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


@functools.cache
def parse(equation: str, inputs: tuple[str, ...] = ()) -> Parsed:
    """Take an equation of motion apart.

    Raises
    ------
    InputError
        If the text is no equation, is not linear in z'', or names something unknown.
    """
    import sympy

    if not _ALLOWED.fullmatch(equation) or "__" in equation:
        raise InputError(f"the law {equation!r} holds characters that no formula has")
    first, *others = equation.split(";")
    hidden = dict(_hidden_texts(equation, others))
    text = re.sub(r"\bz''", "z_second", first)
    texts = [re.sub(r"\bz'", "z_first", each) for each in (text, *hidden.values())]
    if any("'" in each for each in texts) or any("z_second" in each for each in texts[1:]):
        raise InputError(f"the law {equation!r} has a prime that does not follow z")
    names = dict.fromkeys(re.findall(r"(?<![\w.])[A-Za-z_]\w*", " ".join(texts)))
    local: dict[str, Any] = {name: getattr(sympy, name) for name in _FUNCTIONS}
    local |= {name: sympy.Symbol(name) for name in names if name not in local}
    sides = texts[0].split("=")
    if len(sides) != 2:
        raise InputError(f"the law {equation!r} must have one equals sign")
    left, right, *rates = (_expression(equation, each, local) for each in (*sides, *texts[1:]))
    a, v, z = (sympy.Symbol(name) for name in ("z_second", "z_first", "z"))
    difference = sympy.expand(left - right)
    factor = difference.coeff(a, 1)
    rest = sympy.expand(difference - factor * a)
    if factor == 0 or rest.has(a) or factor.has(a):
        raise InputError(f"the law {equation!r} must be linear in z''")
    acceleration = -rest / factor
    for name in inputs:
        if name not in names:
            raise InputError(f"the law {equation!r} does not name its input {name!r}")
    known = {"z", "z_first", "z_second", *_FUNCTIONS, *hidden, *inputs}
    parameters = tuple(name for name in names if name not in known)
    return Parsed(
        left, right, acceleration, parameters, z, v, a,
        dict(zip(hidden, rates, strict=True)), inputs,
    )  # fmt: skip


def _hidden_texts(equation: str, texts: list[str]) -> list[tuple[str, str]]:
    """Name and right-hand side of each further equation."""
    found = []
    for text in texts:
        left, equals, right = text.partition("=")
        match = _HIDDEN.fullmatch(left)
        if match is None or not equals or "=" in right or match[1] in ("z", *_FUNCTIONS):
            raise InputError(
                f"the law {equation!r}: {text.strip()!r} must have one equals sign behind the rate "
                "of a hidden state, such as w' = z' - w"
            )
        found.append((match[1], right))
    return found


def _expression(equation: str, text: str, local: dict[str, Any]) -> Any:
    import sympy

    try:
        found = sympy.parse_expr(text, local_dict=local, evaluate=True)
    except (SyntaxError, TypeError, ValueError, AttributeError, TokenError) as error:
        raise InputError(f"the law {equation!r} cannot be read: {error}") from None
    if not isinstance(found, sympy.Expr):
        raise InputError(f"the law {equation!r} cannot be read: {text.strip()!r} is no formula")
    return found


@functools.cache
def compiled_field(
    equation: str, inputs: tuple[str, ...] = (), modules: str = "jax"
) -> Callable[..., Any]:
    """[z'', rates of the hidden states], of z, z', hidden states, inputs and parameters."""
    import sympy

    parsed = parse(equation, inputs)
    rates = [parsed.acceleration, *parsed.hidden.values()]
    return sympy.lambdify(parsed.arguments, rates, modules, cse=True)


@functools.cache
def compiled_slopes(
    equation: str, inputs: tuple[str, ...] = ()
) -> Callable[..., tuple[float, float]]:
    """Derivatives of z'' by z and by z', as a function of the same numbers.

    Where z'' jumps, as dry friction does at z' = 0, there are none: both are NaN.
    """
    import sympy

    parsed = parse(equation, inputs)
    # Of real numbers, or the derivative of a modulus would be one of complex numbers.
    real = {symbol: sympy.Symbol(symbol.name, real=True) for symbol in parsed.arguments}
    acceleration = parsed.acceleration.subs(real)
    slopes = [acceleration.diff(real[by]) for by in (parsed.symbol_z, parsed.symbol_v)]
    # The derivative of a sign is an impulse.
    names = [{"DiracDelta": lambda place: math.nan if place == 0.0 else 0.0}, "numpy"]
    found = sympy.lambdify(list(real.values()), slopes, names, cse=True)

    def both(*values: float) -> tuple[float, float]:
        by_height, by_speed = found(*values)
        if math.isnan(by_height + by_speed):
            return math.nan, math.nan
        return float(by_height), float(by_speed)

    return both


def law_from_text(equation: str, columns: Collection[str] = ()) -> Law:
    """A law from its equation alone; names that are columns of the record are its inputs.

    Raises
    ------
    InputError
        If the text is no equation, or has no parameter.
    """
    names = dict.fromkeys(re.findall(r"(?<![\w.])[A-Za-z_]\w*", equation))
    inputs = tuple(name for name in names if name in columns and name != "z")
    law = Law(name=" ".join(equation.split()), equation=equation, inputs=inputs)
    if not law.parameters:
        raise InputError(f"the law {equation!r} has no parameter, so there is nothing to fit")
    return law
