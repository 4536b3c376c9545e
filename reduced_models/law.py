"""Laws of motion, declared as an equation that a person can write."""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Callable, Mapping
from tokenize import TokenError
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.errors import InputError

if TYPE_CHECKING:
    import sympy

    from reduced_models.estimates import Estimates

Starts = Callable[["Estimates", np.random.Generator, int], dict[str, np.ndarray]]
MappedStarts = Callable[
    [np.ndarray, np.ndarray, "Estimates", np.random.Generator, int], dict[str, np.ndarray] | None
]

_ALLOWED = re.compile(r"[A-Za-z0-9_+\-*/().,'= ]+")
_FUNCTIONS = ("exp", "log", "sqrt", "sin", "cos", "tanh", "sign", "Abs")


@dataclasses.dataclass(frozen=True)
class Law:
    """A law z'' = f(z, z') with parameters.

    Attributes
    ----------
    name : str
    equation : str
        Such as ``"z'' + 2*lam*z' + omega**2*z = g0"``: linear in ``z''``.
    start : callable or None
        ``start(estimates, random, count)`` gives random start values, an array of ``count`` for
        each parameter. None for a law that was read from a file: it predicts, but cannot be fitted.
    positive : tuple of str
        Parameters that are above zero; they are searched for on a logarithmic scale.
    units : mapping of str to str
        SI units of the parameters.
    mapped : bool
        The law does not keep its form when the height is shifted or scaled, so it holds for
        z = (height - shift)/scale with a map of its own. Its z is a pure number and its time unit
        is fixed at 1 s.
    mapped_start : callable, optional
        For a mapped law: ``mapped_start(time, swing, estimates, random, count)`` gives random start
        values also of ``shift`` and ``scale``, for a swing about the level of rest in amplitudes;
        None where the record does not tell.
    source : str
    """

    name: str
    equation: str
    start: Starts | None = None
    positive: tuple[str, ...] = ()
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    mapped: bool = False
    mapped_start: MappedStarts | None = None
    source: str = ""

    def starts(
        self, estimates: Estimates, random: np.random.Generator, count: int
    ) -> dict[str, np.ndarray]:
        """Random start values, an array of ``count`` for each parameter.

        Raises
        ------
        InputError
            If the law does not say where to start.
        """
        if self.start is None:
            raise InputError(
                f"the law {self.name!r} does not say where to start a fit; give it a start function"
            )
        return self.start(estimates, random, count)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, in the order in which the equation names them."""
        return parse(self.equation).parameters

    @property
    def acceleration(self) -> sympy.Expr:
        """Z'' as an expression in the symbols z, v and the parameters."""
        return parse(self.equation).acceleration

    def sympy_equation(self, values: Mapping[str, float] | None = None) -> sympy.Eq:
        """The equation in z(t), with numbers where ``values`` gives them."""
        import sympy

        parsed = parse(self.equation)
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


@dataclasses.dataclass(frozen=True)
class Parsed:
    """An equation taken apart."""

    left: Any
    right: Any
    acceleration: Any
    parameters: tuple[str, ...]
    symbol_z: Any
    symbol_v: Any
    symbol_a: Any


@functools.cache
def parse(equation: str) -> Parsed:
    """Take an equation of motion apart.

    Raises
    ------
    InputError
        If the text is no equation, is not linear in z'', or names something unknown.
    """
    import sympy

    if not _ALLOWED.fullmatch(equation) or "__" in equation:
        raise InputError(f"the law {equation!r} holds characters that no formula has")
    if equation.count("=") != 1:
        raise InputError(f"the law {equation!r} must have one equals sign")
    text = re.sub(r"\bz''", "z_second", equation)
    text = re.sub(r"\bz'", "z_first", text)
    if "'" in text:
        raise InputError(f"the law {equation!r} has a prime that does not follow z")
    names = dict.fromkeys(re.findall(r"(?<![\w.])[A-Za-z_]\w*", text))
    local: dict[str, Any] = {name: getattr(sympy, name) for name in _FUNCTIONS}
    local |= {name: sympy.Symbol(name) for name in names if name not in local}
    try:
        left, right = (
            sympy.parse_expr(side, local_dict=local, evaluate=True) for side in text.split("=")
        )
    except (SyntaxError, TypeError, ValueError, AttributeError, TokenError) as error:
        raise InputError(f"the law {equation!r} cannot be read: {error}") from None
    a, v, z = (sympy.Symbol(name) for name in ("z_second", "z_first", "z"))
    difference = sympy.expand(left - right)
    factor = difference.coeff(a, 1)
    if factor == 0 or difference.has(a**2) or factor.has(a):
        raise InputError(f"the law {equation!r} must be linear in z''")
    acceleration = -(difference - factor * a) / factor
    known = {"z", "z_first", "z_second", *_FUNCTIONS}
    parameters = tuple(name for name in names if name not in known)
    return Parsed(left, right, acceleration, parameters, z, v, a)


@functools.cache
def compiled_rate(equation: str, modules: str = "jax") -> Callable[..., Any]:
    """Z'' as a function of z, v and the parameters, in their order, for JAX or NumPy."""
    import sympy

    return sympy.lambdify(_arguments(equation), parse(equation).acceleration, modules, cse=True)


@functools.cache
def compiled_slopes(equation: str) -> Callable[..., Any]:
    """Derivatives of z'' by z and by v, as a NumPy function of the same arguments."""
    import sympy

    parsed = parse(equation)
    # Of real numbers, or the derivative of a modulus would be one of complex numbers.
    real = {symbol: sympy.Symbol(symbol.name, real=True) for symbol in _arguments(equation)}
    acceleration = parsed.acceleration.subs(real)
    slopes = [acceleration.diff(real[by]) for by in (parsed.symbol_z, parsed.symbol_v)]
    return sympy.lambdify(list(real.values()), slopes, "numpy", cse=True)


def _arguments(equation: str) -> list[Any]:
    import sympy

    parsed = parse(equation)
    return [parsed.symbol_z, parsed.symbol_v, *map(sympy.Symbol, parsed.parameters)]
