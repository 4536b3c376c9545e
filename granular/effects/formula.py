"""Energies that are written as formulas, and what is derived from them.

A text is read by `granular.shared.grammar`, never run. Its names are variables, which the kind of
formula fixes, and parameters, which stand beside it with their units; the units must make joules.
Force, stiffness and the rate of change in time are derived from it, so that the force is minus the
gradient of the energy.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numba

from granular.compiled.dispatch import OPTIONS
from granular.effects.dimensions import Dimension, dimension_of, unit_text
from granular.effects.own_definition import DEFINITIONS, Definition
from granular.scene.scales import Scales
from granular.scene.schema import FieldError, Kind, Section, declare, text, unknown
from granular.scene.units import si_value, unit_size
from granular.shared.errors import InputError, SceneError
from granular.shared.grammar import names, parse
from granular.shared.messages import quoted

if TYPE_CHECKING:
    import sympy

Functions = dict[str, Callable[..., Any]]

LENGTH, TIME, MASS, MOMENT, ENERGY, FORCE = (
    tuple(map(Fraction, powers))
    for powers in (
        (1, 0, 0, 0), (0, 0, 1, 0), (0, 1, 0, 0), (2, 0, 0, 1), (2, 1, -2, 0), (1, 1, -2, 0),
    )
)  # fmt: skip
"""Dimensions: powers of metre, kilogram, second and ampere."""

_UNIT = re.compile(r"\s*[-+0-9.eE]+\s*(.*?)\s*")
_FORM = "1"
"""In the digest: to be raised with any change of what is derived from a text."""


@dataclasses.dataclass(frozen=True)
class Values(Kind):
    """Parameters by their names, each as a number and its SI unit: ``10.0 kg s^-2``."""

    def parse(self, value: Any, diameter: float | None) -> tuple[tuple[str, str], ...]:
        found = {}
        for name, given in dict(value).items():
            try:
                found[name] = _in_si(given, diameter)
            except SceneError as error:
                raise FieldError(str(error), name) from None
        return tuple(sorted(found.items()))


def value_and_dimension(text: str) -> tuple[float, Dimension]:
    """Value in SI and dimension of a parameter as `Values` has it."""
    number, unit = text.split(" ", 1)
    return float(number), tuple(map(Fraction, unit_size(unit)[1]))


def _in_si(given: Any, diameter: float | None) -> str:
    if isinstance(given, bool) or not isinstance(given, int | float | str):
        raise FieldError(f"{quoted(given)} is no quantity; write a number and a unit, as '5 mm'")
    match = _UNIT.fullmatch(str(given))
    unit = match[1] if match is not None else ""
    si = unit_text(tuple(map(Fraction, unit_size(unit or "1", diameter)[1])))
    return f"{si_value(str(given), si, diameter)!r} {si}"


class Formula(Section):
    """An energy as a formula.

    Attributes
    ----------
    energy : str
        [J]
    values : pairs of str
        The parameters, each with its number and SI unit.
    """

    variables: ClassVar[Mapping[str, Dimension]] = {}

    energy: str = text()
    values: tuple[tuple[str, str], ...] = declare(Values(), default=())

    @staticmethod
    def derived(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """SymPy's expressions of the energy's derivatives, by names of `functions_of`."""
        raise NotImplementedError

    @staticmethod
    def functions_of(made: Functions) -> Functions:
        """The functions that kernels call, from compiled ones of all variables and parameters."""
        raise NotImplementedError

    @classmethod
    def names_given(cls, energy: str) -> tuple[str, ...]:
        """Names of the functions that there are."""
        raise NotImplementedError

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Self:
        if isinstance(plain, Mapping) and "values" not in plain:
            known = {name: plain[name] for name in plain if name in cls.key_names()}
            plain = known | {"values": {name: plain[name] for name in plain if name not in known}}
        return super().from_plain(plain, diameter)

    def to_plain(self) -> dict[str, Any]:
        plain = super().to_plain()
        del plain["values"]
        return plain | dict(self.values)

    def validate(self) -> None:
        try:
            self._check_energy()
        except FieldError:
            raise
        except InputError as error:
            raise FieldError(str(error), "energy") from None

    def _check_energy(self) -> None:
        tree, given = parse(self.energy), dict(self.values)
        written = [name.text for name in names(tree)]
        for name in written:
            if name not in self.variables and name not in given:
                known = (*self.variables, *given)
                raise InputError(f"{unknown(name, known, 'name')}; or give it: {name} = ...")
        for name in given:
            if name in self.variables:
                raise FieldError("is a variable; give the parameter another name", name)
            if name not in written:
                raise FieldError(f"the energy has no {quoted(name)}; take it out", name)
        dimensions = {name: self._value(name)[1] for name in given}
        found = dimension_of(tree, dict(self.variables) | dimensions)
        if found != ENERGY:
            raise InputError(f"it is in {unit_text(found)}, not in J; check the units")

    def _value(self, name: str) -> tuple[float, Dimension]:
        """Value in SI and dimension of a parameter."""
        return value_and_dimension(dict(self.values)[name])

    def natural(self, scales: Scales) -> tuple[float, ...]:
        """The parameters in natural units, in the order of `values`."""
        units = (scales.length, scales.mass, scales.time, scales.current)
        found = []
        for name, _ in self.values:
            value, dimension = self._value(name)
            for unit, power in zip(units, dimension, strict=True):
                value /= unit ** float(power)
            found.append(value)
        return tuple(found)

    @property
    def definition(self) -> Definition:
        """What kernels know it by."""
        kind: Any = type(self)
        found: Definition = _definition(kind, self.energy, tuple(name for name, _ in self.values))
        DEFINITIONS[found.digest] = found
        return found

    @property
    def sources(self) -> tuple[str, ...]:
        """Digest of what is derived, for the run's settings."""
        return (self.definition.digest,)


@functools.cache
def _definition(kind: type[Formula], energy: str, parameters: tuple[str, ...]) -> Definition:
    key = kind.__name__.lower()
    content = repr((_FORM, key, energy, parameters))
    digest = hashlib.sha256(content.encode()).hexdigest()[:24]
    functions = _Derived(kind, energy, parameters)
    return Definition(key, f"{key}_{digest}", _as_given, functions, _Compiled(functions))


def _as_given(*values: float) -> tuple[float, ...]:
    return values


if not numba.config.DISABLE_JIT:
    _as_given = numba.njit(**OPTIONS)(_as_given)


class _Derived(Mapping[str, Callable[..., Any]]):
    """The functions of a formula, derived when one of them is asked for first.

    Where the compiled code is there already none is, and SymPy need not be imported.
    """

    def __init__(self, kind: type[Formula], energy: str, parameters: Sequence[str]) -> None:
        self.kind, self.energy, self.parameters = kind, energy, parameters
        self.known = kind.names_given(energy)

    def __iter__(self) -> Iterator[str]:
        return iter(self.known)

    def __len__(self) -> int:
        return len(self.known)

    def __getitem__(self, name: str) -> Callable[..., Any]:
        if name not in self.known:
            raise KeyError(name)
        return self._functions[name]

    @functools.cached_property
    def _functions(self) -> Functions:
        import sympy

        from granular.shared.algebra import expression, function_of

        symbols = {name: sympy.Symbol(name, real=True) for name in self.kind.variables}
        given = {
            name: sympy.Symbol(f"parameter{place}", real=True)
            for place, name in enumerate(self.parameters)
        }
        tree = expression(parse(self.energy), symbols | given)
        forms = self.kind.derived(tree, symbols)
        if forms["force"].has(sympy.DiracDelta):
            raise InputError(f"the energy {quoted(self.energy)} jumps; write one without jumps")
        arguments = [*symbols.values(), *given.values()]
        made = {name: function_of(arguments, _smooth(form)) for name, form in forms.items()}
        if not numba.config.DISABLE_JIT:
            made = {name: numba.njit(**OPTIONS)(one) for name, one in made.items()}
        return self.kind.functions_of(made)


def _smooth(form: sympy.Expr) -> sympy.Expr:
    """Without the infinite stiffness of a kink, at the one place where it is."""
    import sympy

    return form.replace(sympy.DiracDelta, lambda *_: sympy.Integer(0))


class _Compiled(Mapping[str, Callable[..., Any]]):
    """The same, to be called by kernels."""

    def __init__(self, functions: _Derived) -> None:
        self.functions = functions

    def __iter__(self) -> Iterator[str]:
        return iter(self.functions)

    def __len__(self) -> int:
        return len(self.functions)

    def __getitem__(self, name: str) -> Callable[..., Any]:
        return numba.njit(**OPTIONS)(self.functions[name])
