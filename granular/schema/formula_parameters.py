"""Parameters of a formula, each with its number and unit."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from fractions import Fraction
from typing import Any, ClassVar, Self

from granular.formulas import parse, variable_names
from granular.formulas.dimensions import Dimension, infer_dimension, unit_text
from granular.formulas.tree import Node
from granular.schema.field_kinds import FieldError, FieldKind, at_key
from granular.schema.sections import Section, section_field
from granular.schema.units import si_value, unit_size
from granular.shared.errors import InputError, SceneError
from granular.shared.message_text import quote, unknown_word_message

_UNIT = re.compile(r"\s*[-+0-9.eE]+\s*(.*?)\s*")


@dataclasses.dataclass(frozen=True)
class ParameterValuesKind(FieldKind):
    """Parameters by their names, each as a number and its SI unit: ``10.0 kg s^-2``."""

    def parse(self, value: Any, diameter: float | None) -> tuple[tuple[str, str], ...]:
        """Read parameters, each a number with a unit; diameter [m]."""
        result = {}
        for name, given in dict(value).items():
            with at_key(name, errors=SceneError):
                result[name] = _text_in_si(given, diameter)
        return tuple(sorted(result.items()))


def _text_in_si(given: Any, diameter: float | None) -> str:
    if isinstance(given, bool) or not isinstance(given, int | float | str):
        raise FieldError(f"{quote(given)} is no quantity; write a number and a unit, as '5 mm'")
    match = _UNIT.fullmatch(str(given))
    unit = match[1] if match is not None else ""
    si = unit_text(_dimension_of_unit(unit or "1", diameter))
    return f"{si_value(str(given), si, diameter)!r} {si}"


def _dimension_of_unit(unit: str, diameter: float | None = None) -> Dimension:
    return tuple(map(Fraction, unit_size(unit, diameter)[1]))


class SectionWithFormula(Section):
    """A section with a formula, whose parameters stand next to it.

    Attributes
    ----------
    variables : mapping of str to Dimension
        Variables of the formula that need no value.
    formula_key : str
        The key of the formula.
    unit : str
        SI unit of its value.
    values : pairs of str
        The parameters, each with its number and SI unit; in a scene they stand next to the formula.
    """

    variables: ClassVar[Mapping[str, Dimension]] = {}
    formula_key: ClassVar[str] = ""
    unit: ClassVar[str] = "1"

    values: tuple[tuple[str, str], ...] = section_field(ParameterValuesKind(), default=())

    @property
    def formula(self) -> str:
        """The formula's text."""
        formula: str = getattr(self, self.formula_key)
        return formula

    @property
    def parameters(self) -> list[tuple[float, str]]:
        """Numbers of the parameters and their SI units, in the order of `values`."""
        split = (given.split(" ", 1) for _, given in self.values)
        return [(float(number), unit) for number, unit in split]

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Self:
        """Read a table whose further keys are parameters of the formula; diameter [m]."""
        if isinstance(plain, Mapping) and "values" not in plain:
            known = {name: plain[name] for name in plain if name in cls.key_names()}
            plain = known | {"values": {name: plain[name] for name in plain if name not in known}}
        return super().from_plain(plain, diameter)

    def to_plain(self) -> dict[str, Any]:
        """Section as a table with its parameters; `from_plain` makes an equal section of it."""
        plain = super().to_plain()
        del plain["values"]
        return plain | dict(self.values)

    def validate(self) -> None:
        """Check that the formula can be read, has its parameters, and makes the unit."""
        given = dict(self.values)
        try:
            tree = parse(self.formula)
            written = [name.text for name in variable_names(tree)]
            for name in written:
                if name not in self.variables and name not in given:
                    names = (*self.variables, *given)
                    raise InputError(f"{unknown_word_message(name, names, 'name')}; or give it: {name} = ...")
            for name in given:
                if name in self.variables:
                    raise FieldError("is a variable; give the parameter another name", name)
                if name not in written:
                    raise FieldError(f"the {self.formula_key} has no {quote(name)}; take it out", name)
            self.check_unit(tree, self.unit)
        except FieldError:
            raise
        except InputError as error:
            raise FieldError(str(error), self.formula_key) from None

    def check_unit(self, tree: Node, unit: str) -> None:
        """Check the unit of a formula of the variables and parameters."""
        units = {name: given.split(" ", 1)[1] for name, given in self.values}
        known = dict(self.variables) | {name: _dimension_of_unit(unit) for name, unit in units.items()}
        dimension = infer_dimension(tree, known)
        if dimension != _dimension_of_unit(unit):
            raise InputError(f"it is in {unit_text(dimension)}, not in {unit}; check the units")
