"""Energies that are written as formulas: each writes an own part, with the functions derived from it.

A text is read by `granular.formulas`, never run. Its names are variables, which the kind of
formula fixes, and parameters, which stand next to it with their units; the units must make joules.
Force, stiffness and the rate of change in time are derived from it, so that the force is minus the
gradient of the energy.

Fields act on every grain:
``effects.field = [{ energy = "k*y**2/2 + a*sin(x/l)", k = "10 N/m", a = "1 uJ", l = "3 mm" }]``.
Their variables are the position ``x``, ``y``, the time ``t``, and a grain's ``mass`` and magnetic
``moment``. Where ``t`` is in it, the work from outside is derived too.

Pair laws whose energies are written as formulas of the distance.

``effects.pair_law = [{ energy = "a*exp(-r/l)", a = "1 mJ", l = "2 mm" }]``. It acts along with the
dipoles, or instead of them where the scene names none. The variables are the distance ``r`` of the
centres and the grains' moments ``q1`` and ``q2`` over that of the first species; see
`granular.effects.formula`. Both grains must be treated alike. A law that falls off as 1/r^3 says with
which coefficient: ``{ energy = "c*q1*q2/r**3*(1 + (l/r)**4)", tail = "c*q1*q2", ... }``.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from granular.effects.custom import OwnPart
from granular.effects.custom_law import Definition, Functions, OwnEffectLaw, OwnWallLaw
from granular.effects.effect import Effect, EffectContext, ForceEffect, energy_variable
from granular.effects.pair_law import PairFunctions, PairLawEffect, Species
from granular.formulas import parse, variable_names
from granular.formulas.algebra import LENGTH, MASS, MOMENT, NONE, TIME, Dimension
from granular.pairs.direct_sum import pad_values
from granular.schema.apparatus import Grains, Piston
from granular.schema.cell import Cell
from granular.schema.field_kinds import FieldError, FieldKind, SectionListKind, at_key
from granular.schema.natural_units import Scales
from granular.schema.sections import SectionWithFormula, quantity, section_field, text_field
from granular.shared.errors import InputError, quote, unknown_word_message

_FORM = "2"
"""Part of the digest, to be raised with any change of what is derived from a text."""


class EnergyFormula(SectionWithFormula, OwnPart):
    """An energy as a formula.

    Attributes
    ----------
    energy : str
        [J]
    arguments : tuple of str, or of tuples of str
        Arguments of the derived functions behind the parameters: variables, and tuples of them.
    function_names : tuple of str
        Names of the derived functions; one of the time has the ``power`` besides.
    """

    formula_key: ClassVar[str] = "energy"
    unit: ClassVar[str] = "J"
    arguments: ClassVar[tuple[Any, ...]] = ()
    function_names: ClassVar[tuple[str, ...]] = ("energy", "force", "stiffness")

    energy: str = text_field()

    @staticmethod
    def derive_functions(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Derive SymPy's expressions of the functions, by their names, from the energy's."""
        raise NotImplementedError

    @property
    def definition(self) -> Definition:
        """The derived functions; the same ones for the same text."""
        kind: Any = type(self)
        return _make_definition(kind, self.energy, tuple(name for name, _ in self.values))

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digest of what is derived, for the run's settings."""
        return (self.definition.digest,)


@functools.cache
def _make_definition(kind: type[EnergyFormula], energy: str, parameters: tuple[str, ...]) -> Definition:
    key = kind.__name__.lower()
    content = repr((_FORM, key, energy, parameters))
    digest = hashlib.sha256(content.encode()).hexdigest()[:24]
    depends = "t" in kind.variables and any(name.text == "t" for name in variable_names(parse(energy)))
    names = (*kind.function_names, *(("power",) if depends else ()))
    given = tuple(f"parameter{number}" for number in range(len(parameters)))
    make = functools.partial(_derive_functions, kind, energy, parameters, names)
    return Definition("effect", key, f"{key}_{digest}", given, names, make, kind.law_base)


def _derive_functions(
    kind: type[EnergyFormula], energy: str, parameters: tuple[str, ...], names: tuple[str, ...]
) -> Functions:
    from granular.formulas.algebra import compile_formula

    assert kind.law_base is not None
    # In the functions of a class ``p`` is the law, with all its fields.
    p = (*parameters, *(f"law.{name}" for name in kind.law_base.extra_fields))
    made = compile_formula(energy, parameters, (p, *kind.arguments), kind.derive_functions)
    return {name: made[name] for name in names}


class FormulaList(ForceEffect):
    """Base of an effect that a scene gives as a list of tables, or as one table."""

    if TYPE_CHECKING:
        fields: tuple[Any, ...]

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Self:
        """Read a list of tables, or one table; diameter [m]."""
        tables = [plain] if isinstance(plain, Mapping) else plain
        try:
            return super().from_plain({"fields": tables}, diameter)
        except FieldError as error:
            raise FieldError(error.reason, *error.path[1:]) from None

    def to_plain(self) -> Any:
        """Formulas as a list of tables; `from_plain` makes an equal effect of it."""
        return [part.to_plain() for part in self.component_effects]

    @property
    def component_effects(self) -> tuple[Effect, ...]:
        """The formulas, each an effect with a law of its own, (k,)."""
        return self.fields

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check each formula; see `Effect.check_compatibility`."""
        for part in self.component_effects:
            part.check_compatibility(grains, cell, piston, others)


@dataclasses.dataclass(frozen=True)
class _SpeciesFactors(FieldKind):
    """A number for each species that has another one than 1, by their names."""

    def parse(self, value: Any, diameter: float | None) -> tuple[tuple[str, float], ...]:
        if not isinstance(value, Mapping | tuple):
            raise FieldError(f"{quote(value)} must be a table of numbers by species")
        try:
            result = {str(name): float(number) for name, number in dict(value).items()}
            return tuple(sorted(result.items()))
        except (TypeError, ValueError):
            raise FieldError(f"{quote(value)} holds something that is not a number") from None

    def to_plain(self, value: Any) -> Any:
        return dict(value)


class FieldFormula(EnergyFormula, ForceEffect):
    """One field.

    Attributes
    ----------
    factor : pairs of str and float
        Species, and what its energy is multiplied by; 1 for those that are not named.
    frequency : float
        Highest frequency at which it changes in time [Hz], for the step.
    """

    rank = 1
    energy_record = energy_variable("field_energy", "energy of the fields")
    variables: ClassVar[Mapping[str, Dimension]] = {
        "x": LENGTH,
        "y": LENGTH,
        "t": TIME,
        "mass": MASS,
        "moment": MOMENT,
    }
    arguments = (("x", "y", "mass", "moment"), "t")
    law_base = OwnEffectLaw

    factor: tuple[tuple[str, float], ...] = section_field(_SpeciesFactors(), default=())
    frequency: float = quantity("Hz", default=0.0, least=0.0)

    @staticmethod
    def derive_functions(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Derive the functions; the stiffness is the row sum of the second derivatives."""
        import sympy

        from granular.formulas.algebra import magnitude, maximum

        x, y, t = (symbols[name] for name in "xyt")
        xx, xy, yy = (magnitude(energy.diff(*by)) for by in ((x, x), (x, y), (y, y)))
        return {
            "energy": energy,
            "force": sympy.Tuple(-energy.diff(x), -energy.diff(y)),
            "stiffness": maximum(xx, yy) + xy,
            "power": energy.diff(t),
        }

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check that ``factor`` names species of the scene."""
        known = tuple(specy.name for specy in grains.species)
        for name, _ in self.factor:
            if name not in known:
                raise FieldError(unknown_word_message(name, known, "species"), "effects", "field", "factor")

    def drive_angular_frequency(self, scales: Scales) -> float:
        """Highest angular frequency at which the field changes in time [1/tau]."""
        return 2.0 * math.pi * self.frequency * scales.time

    def make_kernel_law(self, context: EffectContext) -> Any:
        """Law in natural units."""
        law, numbers = self.natural_law(context.scales), dict(self.factor)
        if not numbers:
            return law
        value = [numbers.get(specy.name, 1.0) for specy in context.grains.species]
        return law._replace(species_factor=pad_values(np.array(value)[context.species]))


class ForceFields(FormulaList):
    """Fields of force from their energies; see the head of this file.

    Attributes
    ----------
    fields : tuple of FieldFormula
    """

    key = "field"
    example: ClassVar[Any] = [
        {"energy": "k*(y - h)**2/2*(1 + sin(w*t)/4)", "k": "1 N/m", "h": "3 D", "w": "60 1/s"},
        {"energy": "a*mass*sin(x/l)", "a": "0.1 m^2/s^2", "l": "1 D"},
    ]

    fields: tuple[FieldFormula, ...] = section_field(SectionListKind(section=FieldFormula, least=1))


class WallFormula(EnergyFormula):
    """A law of a wall as a formula of the distance ``w``."""

    variables: ClassVar[Mapping[str, Dimension]] = {"w": LENGTH}
    arguments = ("w",)
    law_base = OwnWallLaw

    @staticmethod
    def derive_functions(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Derive force and stiffness from the energy."""
        w = symbols["w"]
        return {"energy": energy, "force": -energy.diff(w), "stiffness": energy.diff(w, 2)}

    def make_kernel_law(self, scales: Scales) -> Any:
        """Law in natural units."""
        return self.natural_law(scales)


class PairFormula(EnergyFormula, PairLawEffect):
    """One pair law.

    Attributes
    ----------
    reach : float or None
        Distance from which on it does nothing [m], but for its tail; if not given, where the energy has
        ended. The energy counts from its value there.
    tail : str or None
        Coefficient of 1/r^3 far away [J m^3], as a formula of ``q1``, ``q2`` and the parameters of the
        energy; it is summed over all pairs as that of the dipoles is. None if not given.
    """

    energy_record = energy_variable("pair_law_energy", "energy of the pair laws")
    variables: ClassVar[Mapping[str, Dimension]] = {"r": LENGTH, "q1": NONE, "q2": NONE}
    arguments = ("r", ("first.mass", "q1", "first.diameter"), ("second.mass", "q2", "second.diameter"))
    function_names = ("pair_energy",)
    law_base = OwnEffectLaw

    reach: float | None = quantity("m", above=0.0, default=None, optional=True)
    tail: str | None = text_field(default=None, optional=True)

    def validate(self) -> None:
        """Check the formulas of energy and tail."""
        super().validate()
        if self.tail is None:
            return
        known = ("q1", "q2", *(name for name, _ in self.values))
        with at_key("tail", errors=InputError):
            tree = parse(self.tail)
            for name in variable_names(tree):
                if name.text not in known:
                    raise InputError(unknown_word_message(name.text, known, "name"))
            self.check_unit(tree, "J m^3")

    @staticmethod
    def derive_functions(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Take the energy; its slope is looked at alone, for jumps."""
        return {"pair_energy": energy, "slope": energy.diff(symbols["r"])}

    def pair_functions(self, context: EffectContext) -> PairFunctions:
        """Return the formula's functions, with the parameters in natural units."""
        law, energy = self.natural_law(context.scales), self.definition.functions["pair_energy"]
        return PairFunctions(
            key=(self.definition.digest, tuple(law), self.tail),
            reach=math.inf if self.reach is None else self.reach / context.scales.length,
            name=f"the pair law {quote(self.energy)}",
            energy=lambda r, first, second: float(energy(law, r, first, second)),
            tail=None if self.tail is None else self._tail_function(law, self.tail),
        )

    def _tail_function(self, law: Any, tail: str) -> Callable[[Species, Species], float]:
        import sympy

        from granular.formulas.algebra import compile_function, sympy_expression

        names = ["q1", "q2", *(name for name, _ in self.values)]
        symbols = {name: sympy.Symbol(name, real=True) for name in names}
        compiled = compile_function(list(symbols.values()), sympy_expression(parse(tail), symbols))
        values = tuple(law)[: len(self.values)]
        return lambda first, second: float(compiled(first.moment, second.moment, *values))


class PairLaws(FormulaList):
    """Forces between grains from their energies; see the head of this file.

    Attributes
    ----------
    fields : tuple of PairFormula
    """

    key = "pair_law"
    periodic = True
    example: ClassVar[Any] = [
        {"energy": "a*q1*q2*exp(-r/l)", "a": "1 mJ", "l": "2 mm"},
        {"energy": "k*max(end - r, 0)**4/end**2", "k": "1 N/m", "end": "2 D", "reach": "2 D"},
    ]

    fields: tuple[PairFormula, ...] = section_field(SectionListKind(section=PairFormula, least=1))
