"""Pair laws: forces between the grains from energies that are written as formulas of the distance.

``effects.pair_law = [{ energy = "a*exp(-r/l)", a = "1 mJ", l = "2 mm", reach = "3 D" }]``. It acts
along with the dipoles, or instead of them where the scene names none. The variables are the
distance ``r`` of the centres and the grains' moments ``q1`` and ``q2`` over that of the first
species; see `granular.effects.formula`. Both grains must be treated alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from granular.effects.effect import EffectContext, energy_variable
from granular.effects.force_effect import ForceEffect
from granular.effects.formula import EnergyFormula, FormulaList
from granular.effects.own_checks import check_effect_functions
from granular.effects.own_law import OwnEffectLaw
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

    arguments = (
        "r",
        ("first.x", "first.y", "first.mass", "q1"),
        ("second.x", "second.y", "second.mass", "q2"),
    )
    function_names = ("pair_energy", "pair_force", "pair_stiffness")
    law_base = OwnEffectLaw

    reach: float | None = quantity("m", above=0.0, default=None, optional=True)

    @staticmethod
    def derive_functions(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        """Derive force and stiffness from the energy."""
        from granular.formulas.algebra import magnitude, maximum

        r = symbols["r"]
        push, slope = energy.diff(r), energy.diff(r, 2)
        return {
            "pair_energy": energy,
            "pair_force": -push,
            "pair_stiffness": maximum(magnitude(slope), magnitude(push) / r),
        }

    def make_kernel_law(self, context: EffectContext) -> Any:
        """Law in natural units."""
        law = self.natural_law(context.scales)
        if any(name.text in ("q1", "q2") for name in variable_names(parse(self.energy))):
            check_effect_functions(self.definition, law, context)  # that both are treated alike
        return law if self.reach is None else law._replace(pair_reach=self.reach / context.scales.length)


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
