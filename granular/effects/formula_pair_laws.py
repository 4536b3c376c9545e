"""Pair laws: forces between the grains from energies that are written as formulas of the distance.

``effects.pair_law = [{ energy = "a*exp(-r/l)", a = "1 mJ", l = "2 mm", reach = "3 D" }]``. It acts
along with the dipoles, or instead of them where the scene names none. The variables are the
distance ``r`` of the centres and the grains' moments ``q1`` and ``q2`` over that of the first
species; see `granular.effects.formula`. Both grains must be treated alike.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from granular.effects.custom_function_checks import check_effect_functions
from granular.effects.custom_functions import CustomLawKind, Grain
from granular.effects.custom_law import CustomLaw
from granular.effects.effect import EffectContext, energy_variable
from granular.effects.force_effect import ForceEffect
from granular.effects.formula import EnergyFormula, FormulaList, Functions
from granular.formulas import parse, variable_names
from granular.formulas.dimensions import LENGTH, NONE, Dimension
from granular.schema.field_kinds import SectionListKind
from granular.schema.sections import quantity, section_field


class PairFormula(EnergyFormula, ForceEffect):
    """One pair law.

    Attributes
    ----------
    reach : float or None
        Distance from which on it does nothing [m]; all pairs count if not given. Energy and force
        should be nearly zero there.
    """

    rank = 1
    energy_record = energy_variable("pair_law_energy", "energy of the pair laws")
    variables: ClassVar[Mapping[str, Dimension]] = {"r": LENGTH, "q1": NONE, "q2": NONE}

    reach: float | None = quantity("m", above=0.0, default=None, optional=True)

    @classmethod
    def kernel_function_names(cls, energy: str) -> tuple[str, ...]:
        """Names of the functions that kernels get from the formula."""
        return ("pair_energy", "pair_force", "pair_stiffness")

    @staticmethod
    def derivative_expressions(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Derive force and stiffness from the energy."""
        r = symbols["r"]
        return {"energy": energy, "force": -energy.diff(r), "slope": energy.diff(r, 2)}

    @staticmethod
    def make_kernel_functions(compiled: Functions) -> Functions:
        """Make the functions that kernels call."""
        energy_of, force_of, slope_of = (compiled[name] for name in ("energy", "force", "slope"))

        def energy(p: Any, r: float, first: Grain, second: Grain) -> Any:
            return energy_of(r, first.moment, second.moment, *p)

        def force(p: Any, r: float, first: Grain, second: Grain) -> Any:
            return force_of(r, first.moment, second.moment, *p)

        def stiffness(p: Any, r: float, first: Grain, second: Grain) -> Any:
            slope, push = (
                slope_of(r, first.moment, second.moment, *p),
                force_of(r, first.moment, second.moment, *p),
            )
            return max(abs(slope), abs(push) / r)

        return {"pair_energy": energy, "pair_force": force, "pair_stiffness": stiffness}

    def make_kernel_law(self, context: EffectContext) -> CustomLaw:
        """Law in natural units."""
        definition, values = self.definition, self.parameters_in_natural_units(context.scales)
        if any(name.text in ("q1", "q2") for name in variable_names(parse(self.energy))):
            check_effect_functions(definition, values, context)  # that both are treated alike
        reach = math.inf if self.reach is None else self.reach / context.scales.length
        return CustomLaw(CustomLawKind(definition.digest), values, reach, None)


class PairLaws(FormulaList):
    """Forces between grains from their energies; see the head of this file.

    Attributes
    ----------
    fields : tuple of PairFormula
    """

    key = "pair_law"
    example: ClassVar[Any] = [
        {"energy": "a*q1*q2*exp(-r/l)", "a": "1 mJ", "l": "2 mm"},
        {"energy": "k*max(end - r, 0)**4/end**2", "k": "1 N/m", "end": "2 D", "reach": "2 D"},
    ]

    fields: tuple[PairFormula, ...] = section_field(SectionListKind(section=PairFormula, least=1))
