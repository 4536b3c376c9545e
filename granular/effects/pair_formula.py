"""Pair laws whose energies are written as formulas of the distance.

``effects.pair_law = [{ energy = "a*exp(-r/l)", a = "1 mJ", l = "2 mm" }]``. It acts along with the
dipoles, or instead of them where the scene names none. The variables are the distance ``r`` of the
centres and the grains' moments ``q1`` and ``q2`` over that of the first species; see
`granular.effects.formula`. Both grains must be treated alike. A law that falls off as 1/r^3 says with
which coefficient: ``{ energy = "c*q1*q2/r**3*(1 + (l/r)**4)", tail = "c*q1*q2", ... }``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from granular.effects.custom_law import OwnEffectLaw
from granular.effects.effect import EffectContext, energy_variable
from granular.effects.formula import EnergyFormula, FormulaList
from granular.effects.pair_law import PairFunctions, PairLawEffect, Species
from granular.formulas import parse, variable_names
from granular.formulas.dimensions import LENGTH, NONE, Dimension
from granular.schema.field_kinds import SectionListKind, at_key
from granular.schema.sections import quantity, section_field, text_field
from granular.shared.errors import InputError
from granular.shared.message_text import quote, unknown_word_message


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
