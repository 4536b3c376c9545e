"""Fields: forces on every grain from energies that are written as formulas.

``effects.field = [{ energy = "k*y**2/2 + a*sin(x/l)", k = "10 N/m", a = "1 uJ", l = "3 mm" }]``.
The variables are the position ``x``, ``y``, the time ``t``, and a grain's ``mass`` and magnetic
``moment``; see `granular.effects.formula`. Where ``t`` is in it, the work from outside is derived
too.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from granular.effects.custom_functions import CustomLawKind, Grain
from granular.effects.custom_law import CustomLaw
from granular.effects.effect import Effect, EffectContext, energy_variable
from granular.effects.force_effect import ForceEffect
from granular.effects.formula import EnergyFormula, FormulaList, Functions
from granular.formulas import parse, variable_names
from granular.formulas.dimensions import LENGTH, MASS, MOMENT, TIME, Dimension
from granular.pairs.direct_sum import pad_values
from granular.schema.apparatus import Cell, Grains, Piston
from granular.schema.field_kinds import FieldError, FieldKind, SectionListKind, unknown_word_message
from granular.schema.natural_units import Scales
from granular.schema.sections import quantity, section_field
from granular.shared.message_text import quote


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

    factor: tuple[tuple[str, float], ...] = section_field(_SpeciesFactors(), default=())
    frequency: float = quantity("Hz", default=0.0, least=0.0)

    @classmethod
    def kernel_function_names(cls, energy: str) -> tuple[str, ...]:
        """Names of the functions that kernels get from the formula."""
        depends = any(name.text == "t" for name in variable_names(parse(energy)))
        return ("energy", "force", "stiffness", *(("power",) if depends else ()))

    @staticmethod
    def derivative_expressions(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Derive force and stiffness from the energy."""
        import sympy

        x, y, t = (symbols[name] for name in "xyt")
        return {
            "energy": energy,
            "force": sympy.Tuple(-energy.diff(x), -energy.diff(y)),
            "slopes": sympy.Tuple(energy.diff(x, 2), energy.diff(x, y), energy.diff(y, 2)),
            "power": energy.diff(t),
        }

    @staticmethod
    def make_kernel_functions(compiled: Functions) -> Functions:
        """Make the functions that kernels call."""
        energy_of, force_of, slopes_of, power_of = (
            compiled[name] for name in ("energy", "force", "slopes", "power")
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

    def make_kernel_law(self, context: EffectContext) -> CustomLaw:
        """Law in natural units."""
        factor = None
        if self.factor:
            numbers = dict(self.factor)
            value = [numbers.get(specy.name, 1.0) for specy in context.grains.species]
            factor = pad_values(np.array(value)[context.species])
        kind = CustomLawKind(self.definition.digest)
        return CustomLaw(kind, self.parameters_in_natural_units(context.scales), math.inf, factor)


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
