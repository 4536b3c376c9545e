"""Fields: forces on every grain from energies that are written as formulas.

``effects.field = [{ energy = "k*y**2/2 + a*sin(x/l)", k = "10 N/m", a = "1 uJ", l = "3 mm" }]``.
Names are the place ``x``, ``y``, the time ``t``, a grain's ``mass`` and magnetic ``moment``, and
parameters, which the table gives with their units. The text is read, never run; the force, the
stiffness and, where ``t`` is in it, the work done from outside are derived from it, so that the
force is minus the gradient of the energy.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from fractions import Fraction
from typing import Any, ClassVar, Self

import numba
import numpy as np

from granular.compiled.dispatch import OPTIONS
from granular.effects.dimensions import Dimension, dimension_of, unit_text
from granular.effects.effect import Effect, Setting, in_joules
from granular.effects.own_definition import DEFINITIONS, Definition, Grain, Kind
from granular.effects.own_law import OwnLaw
from granular.pairs.direct import padded_values
from granular.scene.parts import Cell, Grains, Piston
from granular.scene.scales import Scales
from granular.scene.schema import (
    FieldError,
    Many,
    declare,
    quantity,
    text,
    unknown,
)
from granular.scene.schema import (
    Kind as FieldKind,
)
from granular.scene.units import si_value, unit_size
from granular.shared.errors import InputError, SceneError
from granular.shared.grammar import FormulaError, names, parse
from granular.shared.messages import quoted

VARIABLES = ("x", "y", "t", "mass", "moment")
_DIMENSIONS: dict[str, Dimension] = {
    name: tuple(map(Fraction, powers))
    for name, powers in {
        "x": (1, 0, 0, 0), "y": (1, 0, 0, 0), "t": (0, 0, 1, 0), "mass": (0, 1, 0, 0),
        "moment": (2, 0, 0, 1),
    }.items()
}  # fmt: skip
_ENERGY: Dimension = tuple(map(Fraction, (2, 1, -2, 0)))
_UNIT = re.compile(r"\s*[-+0-9.eE]+\s*(.*?)\s*")
_FORM = "1"
"""In the digest: to be raised with any change of what is derived from a text."""


@dataclasses.dataclass(frozen=True)
class _Values(FieldKind):
    """Parameters by their names, each as a number and its SI unit: ``10.0 kg s^-2``."""

    def parse(self, value: Any, diameter: float | None) -> tuple[tuple[str, str], ...]:
        found = {}
        for name, given in dict(value).items():
            try:
                found[name] = _in_si(given, diameter)
            except SceneError as error:
                raise FieldError(str(error), name) from None
        return tuple(sorted(found.items()))


def _in_si(given: Any, diameter: float | None) -> str:
    if isinstance(given, bool) or not isinstance(given, int | float | str):
        raise FieldError(f"{quoted(given)} is no quantity; write a number and a unit, as '5 mm'")
    words = str(given)
    match = _UNIT.fullmatch(words)
    unit = match[1] if match is not None else ""
    size = unit_size(unit or "1", diameter)[1]
    si = unit_text(tuple(map(Fraction, size)))
    return f"{si_value(words, si, diameter)!r} {si}"


@dataclasses.dataclass(frozen=True)
class _Factors(FieldKind):
    """A number for each species that has another one than 1, by their names."""

    def parse(self, value: Any, diameter: float | None) -> tuple[tuple[str, float], ...]:
        if not isinstance(value, Mapping | tuple):
            raise FieldError(f"{quoted(value)} must be a table of numbers by species")
        try:
            found = {str(name): float(number) for name, number in dict(value).items()}
            return tuple(sorted(found.items()))
        except (TypeError, ValueError):
            raise FieldError(f"{quoted(value)} holds something that is not a number") from None


class FieldText(Effect):
    """One field.

    Attributes
    ----------
    energy : str
        Of a grain; see the head of this file.
    factor : pairs of str and float
        Species, and what its energy is multiplied by; 1 for those that are not named.
    frequency : float
        Highest frequency at which it changes in time [Hz], for the step.
    values : pairs of str
        The parameters, each with its number and SI unit.
    """

    rank = 1
    energy_record = in_joules("field_energy", "energy of the fields")

    energy: str = text()
    factor: tuple[tuple[str, float], ...] = declare(_Factors(), default=())
    frequency: float = quantity("Hz", default=0.0, least=0.0)
    values: tuple[tuple[str, str], ...] = declare(_Values(), default=())

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Self:
        if isinstance(plain, Mapping):
            own = {name: plain[name] for name in plain if name not in cls.key_names()}
            known = {
                name: plain[name] for name in plain if name in ("energy", "factor", "frequency")
            }
            plain = known | {"values": own}
        return super().from_plain(plain, diameter)

    def to_plain(self) -> dict[str, Any]:
        plain: dict[str, Any] = {"energy": self.energy} | dict(self.values)
        if self.factor:
            plain["factor"] = dict(self.factor)
        return plain | ({"frequency": self.frequency} if self.frequency else {})

    def validate(self) -> None:
        try:
            tree = parse(self.energy)
            given = dict(self.values)
            written = [name.text for name in names(tree)]
            for name in written:
                if name not in VARIABLES and name not in given:
                    known = (*VARIABLES, *given)
                    raise FormulaError(f"{unknown(name, known, 'name')}; give it as {name} = ...")
            for name, _ in self.values:
                if name not in written:
                    raise FieldError(f"the energy has no {quoted(name)}; take it out", name)
            dimensions = {name: self._value(name)[1] for name in given}
            found = dimension_of(tree, _DIMENSIONS | dimensions)
            if found != _ENERGY:
                raise InputError(f"it is in {unit_text(found)}, not in J; check the units")
        except FieldError:
            raise
        except InputError as error:
            raise FieldError(str(error), "energy") from None

    def _value(self, name: str) -> tuple[float, Dimension]:
        """Value in SI and dimension of a parameter."""
        number, unit = dict(self.values)[name].split(" ", 1)
        return float(number), tuple(map(Fraction, unit_size(unit)[1]))

    def check(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        known = tuple(one.name for one in grains.species)
        for name, _ in self.factor:
            if name not in known:
                raise FieldError(unknown(name, known, "species"), "effects", "field", "factor")

    @property
    def sources(self) -> tuple[str, ...]:
        return (self._definition.digest,)

    @property
    def _definition(self) -> Definition:
        return _definition(self.energy, tuple(name for name, _ in self.values))

    def drive_frequency(self, scales: Scales) -> float:
        return 2.0 * float(np.pi) * self.frequency * scales.time

    def law(self, setting: Setting) -> OwnLaw:
        """The law in natural units."""
        definition, scales = self._definition, setting.scales
        DEFINITIONS[definition.digest] = definition
        units = (scales.length, scales.mass, scales.time, scales.current)
        values = []
        for name, _ in self.values:
            value, dimension = self._value(name)
            for unit, power in zip(units, dimension, strict=True):
                value /= unit ** float(power)
            values.append(value)
        factor = None
        if self.factor:
            by_species = [dict(self.factor).get(one.name, 1.0) for one in setting.grains.species]
            factor = padded_values(np.array(by_species)[setting.species])
        return OwnLaw(Kind(definition.digest), tuple(values), np.inf, factor)


class Field(Effect):
    """Fields of force from their energies; see the head of this file.

    Attributes
    ----------
    fields : tuple of FieldText
    """

    key = "field"
    example: ClassVar[Any] = [
        {"energy": "k*(y - h)**2/2*(1 + sin(w*t)/4)", "k": "1 N/m", "h": "3 D", "w": "60 1/s"},
        {"energy": "a*mass*sin(x/l)", "a": "0.1 m^2/s^2", "l": "1 D"},
    ]

    fields: tuple[FieldText, ...] = declare(Many(section=FieldText, least=1))

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Self:
        if isinstance(plain, Mapping):
            plain = plain["fields"] if set(plain) == {"fields"} else [plain]
        try:
            return super().from_plain({"fields": plain}, diameter)
        except FieldError as error:
            raise FieldError(error.reason, *error.path[1:]) from None

    def to_plain(self) -> Any:
        return [one.to_plain() for one in self.fields]

    @property
    def parts(self) -> tuple[Effect, ...]:
        return self.fields

    def check(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        for one in self.fields:
            one.check(grains, cell, piston, others)


@functools.cache
def _definition(energy: str, parameters: tuple[str, ...]) -> Definition:
    digest = hashlib.sha256(repr((_FORM, energy, parameters)).encode()).hexdigest()[:24]
    named = {f"p{place}": name for place, name in enumerate(parameters)}
    functions = _Derived(energy, named)
    return Definition(
        "field", f"field_{digest}", _as_given, functions, _Compiled(functions),
    )  # fmt: skip


def _as_given(*values: float) -> tuple[float, ...]:
    return values


if not numba.config.DISABLE_JIT:
    _as_given = numba.njit(**OPTIONS)(_as_given)


class _Derived(Mapping[str, Callable[..., Any]]):
    """The functions of a field, derived when one of them is asked for first.

    Where the compiled code is there already none is, and SymPy need not be imported.
    """

    def __init__(self, energy: str, parameters: Mapping[str, str]) -> None:
        self.energy, self.parameters = energy, parameters
        depends = any(name.text == "t" for name in names(parse(energy)))
        self.known = ("energy", "force", "stiffness", *(("power",) if depends else ()))

    def __iter__(self) -> Iterator[str]:
        return iter(self.known)

    def __len__(self) -> int:
        return len(self.known)

    def __getitem__(self, name: str) -> Callable[..., Any]:
        if name not in self.known:
            raise KeyError(name)
        return self._functions[name]

    @functools.cached_property
    def _functions(self) -> dict[str, Callable[..., Any]]:
        import sympy

        from granular.shared.algebra import expression, function_of

        symbols = {name: sympy.Symbol(name, real=True) for name in VARIABLES}
        given = {
            name: sympy.Symbol(f"parameter{place}", real=True)
            for place, name in enumerate(self.parameters.values())
        }
        tree = expression(parse(self.energy), symbols | given)
        x, y, t = symbols["x"], symbols["y"], symbols["t"]
        slopes = [tree.diff(x, 2), tree.diff(x, y), tree.diff(y, 2)]
        arguments = [*symbols.values(), *given.values()]
        forms = {
            "energy": tree, "force": sympy.Tuple(-tree.diff(x), -tree.diff(y)),
            "slopes": sympy.Tuple(*slopes), "power": tree.diff(t),
        }  # fmt: skip
        if forms["force"].has(sympy.DiracDelta) or forms["power"].has(sympy.DiracDelta):
            raise InputError(f"effects.field: {quoted(self.energy)} jumps; write an energy that is "
                             "continuous")  # fmt: skip
        forms["slopes"] = forms["slopes"].replace(sympy.DiracDelta, lambda *_: sympy.Integer(0))
        made = {name: function_of(arguments, form) for name, form in forms.items()}
        return _of_grain(made, len(given))


class _Compiled(Mapping[str, Callable[..., Any]]):
    """The same, to be called by kernels."""

    def __init__(self, functions: _Derived) -> None:
        self.functions = functions

    def __iter__(self) -> Iterator[str]:
        return iter(self.functions)

    def __len__(self) -> int:
        return len(self.functions)

    def __getitem__(self, name: str) -> Callable[..., Any]:
        return numba.njit(**OPTIONS)(self.functions[name])  # type: ignore[no-any-return]


def _of_grain(made: dict[str, Callable[..., Any]], count: int) -> dict[str, Callable[..., Any]]:
    """Functions of the variables and parameters as functions of a grain."""
    if not numba.config.DISABLE_JIT:
        made = {name: numba.njit(**OPTIONS)(one) for name, one in made.items()}
    energy_of, force_of, slopes_of, power_of = (
        made[name] for name in ("energy", "force", "slopes", "power")
    )

    def energy(p: Any, grain: Grain, time: float) -> Any:
        return energy_of(grain.x, grain.y, time, grain.mass, grain.moment, *p)

    def force(p: Any, grain: Grain, time: float) -> Any:
        return force_of(grain.x, grain.y, time, grain.mass, grain.moment, *p)

    def stiffness(p: Any, grain: Grain, time: float) -> Any:
        xx, xy, yy = slopes_of(grain.x, grain.y, time, grain.mass, grain.moment, *p)
        return max(abs(xx), abs(yy)) + abs(xy)

    def power(p: Any, grain: Grain, time: float) -> Any:
        return power_of(grain.x, grain.y, time, grain.mass, grain.moment, *p)

    return {"energy": energy, "force": force, "stiffness": stiffness, "power": power}
