"""Effects and wall laws given by formulas of their energy, from which all functions are derived.

The text of a formula is parsed by `granular.formulas`, never executed. A formula contains variables, which
depend on the kind of formula, and parameters, whose values are given with units next to the formula. The
result must be in joules. Force, stiffness and time derivative are derived symbolically from the energy, so
the force is exactly minus the gradient of the energy.

Fields act on every grain:
``effects.field = [{ energy = "k*y**2/2 + a*sin(x/l)", k = "10 N/m", a = "1 uJ", l = "3 mm" }]``.
The variables are the position ``x``, ``y``, the time ``t``, and the grain's ``mass`` and magnetic
``moment``. If the formula contains ``t``, the external work is derived as well.

Pair laws are formulas of the distance: ``effects.pair_law = [{ energy = "a*exp(-r/l)", a = "1 mJ", l = "2 mm"
}]``. Pair laws act in addition to the dipole forces if the scene has ``effects.dipole``. The variables are
the distance ``r`` of the centres and the moments ``q1`` and ``q2`` relative to the first species. The formula
must be symmetric in the two grains. If the energy decreases as 1/r^3 at large distances, give the coefficient
as ``tail``: ``{ energy = "c*q1*q2/r**3*(1 + (l/r)**4)", tail = "c*q1*q2", ... }``.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from granular.effects.custom import CustomPart
from granular.effects.custom_law import CustomDefinition, CustomEffectLaw, CustomWallLaw, Functions
from granular.effects.effect import Effect, EffectContext, ForceEffect, recorded_energy_variable
from granular.effects.pair_law import PairFunctions, PairLawEffect, Species
from granular.formulas import parse, variable_names
from granular.formulas.algebra import LENGTH, MASS, MOMENT, NONE, TIME, Dimension
from granular.pairs.direct_sum import pad_values
from granular.schema.apparatus import Grains, Piston
from granular.schema.cell import Cell
from granular.schema.field_kinds import FieldError, FieldKind, SectionListKind, add_key_to_errors
from granular.schema.natural_units import Scales
from granular.schema.sections import SectionWithFormula, quantity, section_field, text_field
from granular.shared.errors import InputError, quote, unknown_word_message

_FORM = "2"
"""Version of the derived functions, part of the digest; increase it whenever they change."""


class EnergyFormula(SectionWithFormula, CustomPart):
    """An energy given by a formula.

    Attributes
    ----------
    energy : str
        Formula of the energy [J].
    arguments : tuple of str, or of tuples of str
        Arguments that the derived functions take after the parameters: variables or tuples of variables.
    function_names : tuple of str
        Names of the derived functions; a time-dependent formula also has ``power``.
    """

    formula_key: ClassVar[str] = "energy"
    unit: ClassVar[str] = "J"
    arguments: ClassVar[tuple[Any, ...]] = ()
    function_names: ClassVar[tuple[str, ...]] = ("energy", "force", "stiffness")

    energy: str = text_field()

    @staticmethod
    def derive_functions(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Derive the SymPy expressions of the functions, by name, from the energy."""
        raise NotImplementedError

    @property
    def definition(self) -> CustomDefinition:
        """Functions derived from the formula; formulas with equal texts share cached functions."""
        kind: Any = type(self)
        return _make_definition(kind, self.energy, tuple(name for name, _ in self.values))

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digest (hash) of the derived functions, to identify a run."""
        return (self.definition.digest,)


@functools.cache
def _make_definition(kind: type[EnergyFormula], energy: str, parameters: tuple[str, ...]) -> CustomDefinition:
    key = kind.__name__.lower()
    content = repr((_FORM, key, energy, parameters))
    digest = hashlib.sha256(content.encode()).hexdigest()[:24]
    depends = "t" in kind.variables and any(name.text == "t" for name in variable_names(parse(energy)))
    names = (*kind.function_names, *(("power",) if depends else ()))
    given = tuple(f"parameter{number}" for number in range(len(parameters)))
    make = functools.partial(_derive_functions, kind, energy, parameters, names)
    return CustomDefinition("effect", key, f"{key}_{digest}", given, names, make, kind.law_base)


def _derive_functions(
    kind: type[EnergyFormula], energy: str, parameters: tuple[str, ...], names: tuple[str, ...]
) -> Functions:
    from granular.formulas.algebra import compile_formula

    assert kind.law_base is not None
    # In a class's functions, ``p`` is the law with all its fields.
    p = (*parameters, *(f"law.{name}" for name in kind.law_base.extra_fields))
    made = compile_formula(energy, parameters, (p, *kind.arguments), kind.derive_functions)
    return {name: made[name] for name in names}


class FormulaList(ForceEffect):
    """Base class of effects that a scene gives as one table or as a list of tables."""

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
        """Formulas as a list of tables, which `from_plain` turns back into an equal effect."""
        return [part.to_plain() for part in self.component_effects]

    @property
    def component_effects(self) -> tuple[Effect, ...]:
        """Return the formulas; each is an effect with a separate law."""
        return self.fields

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check each formula; see `Effect.check_compatibility`."""
        for part in self.component_effects:
            part.check_compatibility(grains, cell, piston, others)


@dataclasses.dataclass(frozen=True)
class _SpeciesFactors(FieldKind):
    """Type of a scene key that gives a factor for each listed species; the factor of other species is 1."""

    def parse(self, value: Any, diameter: float | None) -> tuple[tuple[str, float], ...]:
        if not isinstance(value, Mapping | tuple):
            raise FieldError(f"{quote(value)} is not a table; give a table of species and numbers")
        try:
            result = {str(name): float(number) for name, number in dict(value).items()}
            return tuple(sorted(result.items()))
        except (TypeError, ValueError):
            raise FieldError(f"{quote(value)} contains a value that is not a number; give numbers") from None

    def to_plain(self, value: Any) -> Any:
        return dict(value)


class FieldFormula(EnergyFormula, ForceEffect):
    """A force field given by a formula of its energy.

    Attributes
    ----------
    factor : pairs of str and float
        Names of species, each with a factor that multiplies the energy; the factor of other species is 1.
    frequency : float
        Highest frequency of the field's time dependence [Hz], which the time step must resolve.
    """

    rank = 1
    energy_record = recorded_energy_variable("field_energy", "energy of the fields")
    variables: ClassVar[Mapping[str, Dimension]] = {
        "x": LENGTH,
        "y": LENGTH,
        "t": TIME,
        "mass": MASS,
        "moment": MOMENT,
    }
    arguments = (("x", "y", "mass", "moment"), "t")
    law_base = CustomEffectLaw

    factor: tuple[tuple[str, float], ...] = section_field(_SpeciesFactors(), default=())
    frequency: float = quantity("Hz", default=0.0, least=0.0)

    @staticmethod
    def derive_functions(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Derive the functions; the stiffness bound is the maximum row sum of absolute second derivatives."""
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
        """Check that all keys of ``factor`` are species of the scene."""
        known = tuple(specy.name for specy in grains.species)
        for name, _ in self.factor:
            if name not in known:
                raise FieldError(unknown_word_message(name, known, "species"), "effects", "field", "factor")

    def drive_angular_frequency(self, scales: Scales) -> float:
        """Highest angular frequency of the field's time dependence [1/tau]."""
        return 2.0 * math.pi * self.frequency * scales.time

    def make_kernel_law(self, context: EffectContext) -> Any:
        """Make the law for the compiled loop, in natural units."""
        law, numbers = self.parameters_in_natural_units(context.scales), dict(self.factor)
        if not numbers:
            return law
        value = [numbers.get(specy.name, 1.0) for specy in context.grains.species]
        return law._replace(species_factor=pad_values(np.array(value)[context.species]))


class ForceFields(FormulaList):
    """Force fields given by formulas of their energy.

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
    """A wall law given by a formula of its energy as a function of the distance ``w``."""

    variables: ClassVar[Mapping[str, Dimension]] = {"w": LENGTH}
    arguments = ("w",)
    law_base = CustomWallLaw

    @staticmethod
    def derive_functions(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Derive force and stiffness from the energy."""
        w = symbols["w"]
        return {"energy": energy, "force": -energy.diff(w), "stiffness": energy.diff(w, 2)}

    def make_kernel_law(self, scales: Scales) -> Any:
        """Make the law for the compiled loop, in natural units."""
        return self.parameters_in_natural_units(scales)


class PairFormula(EnergyFormula, PairLawEffect):
    """A pair law given by a formula of its energy.

    Attributes
    ----------
    reach : float or None
        Cut-off distance [m], beyond which only the tail acts. Default: the distance beyond which the energy
        is negligible. The energy is shifted to zero at the cut-off.
    tail : str or None
        Coefficient of 1/r^3 in the energy at large distances [J m^3], as a formula of ``q1``, ``q2`` and the
        parameters of the energy. The tail is summed over all pairs, like the dipole forces.
    """

    energy_record = recorded_energy_variable("pair_law_energy", "energy of the pair laws")
    variables: ClassVar[Mapping[str, Dimension]] = {"r": LENGTH, "q1": NONE, "q2": NONE}
    arguments = ("r", ("first.mass", "q1", "first.diameter"), ("second.mass", "q2", "second.diameter"))
    function_names = ("pair_energy",)
    law_base = CustomEffectLaw

    reach: float | None = quantity("m", above=0.0, default=None, optional=True)
    tail: str | None = text_field(default=None, optional=True)

    def validate(self) -> None:
        """Check the formulas of energy and tail."""
        super().validate()
        if self.tail is None:
            return
        known = ("q1", "q2", *(name for name, _ in self.values))
        with add_key_to_errors("tail", errors=InputError):
            tree = parse(self.tail)
            for name in variable_names(tree):
                if name.text not in known:
                    raise InputError(unknown_word_message(name.text, known, "name"))
            self.check_unit(tree, "J m^3")

    @staticmethod
    def derive_functions(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Return the energy and its derivative, which is used only to check for jumps."""
        return {"pair_energy": energy, "slope": energy.diff(symbols["r"])}

    def pair_functions(self, context: EffectContext) -> PairFunctions:
        """Return the formula's functions, with the parameters in natural units."""
        law, energy = (
            self.parameters_in_natural_units(context.scales),
            self.definition.functions["pair_energy"],
        )
        return PairFunctions(
            key=(self.definition.digest, tuple(law), self.tail),
            reach=math.inf if self.reach is None else self.reach / context.scales.length,
            name=f"the pair law {quote(self.energy)}",
            energy=lambda r, first, second: float(energy(law, r, first, second)),
            tail=None if self.tail is None else self._make_tail_function(law, self.tail),
        )

    def _make_tail_function(self, law: Any, tail: str) -> Callable[[Species, Species], float]:
        import sympy

        from granular.formulas.algebra import compile_expressions, sympy_expression

        names = ["q1", "q2", *(name for name, _ in self.values)]
        symbols = {name: sympy.Symbol(name, real=True) for name in names}
        compiled = compile_expressions(list(symbols.values()), sympy_expression(parse(tail), symbols))
        values = tuple(law)[: len(self.values)]
        return lambda first, second: float(compiled(first.moment, second.moment, *values))


class PairLaws(FormulaList):
    """Pair forces given by formulas of the pair energy.

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
