"""Sections of a scene: frozen dataclasses with checked fields, which can be converted to plain data and back.

The fields of a section are declared by the functions in this file (`quantity`, `integer_field`, ...). Each
function makes a field of one kind (`granular.schema.field_kinds`), which reads, checks and writes the value.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from fractions import Fraction
from typing import Any, ClassVar, Self, dataclass_transform

from granular.formulas import parse, variable_names
from granular.formulas.algebra import Dimension, infer_dimension, unit_text_of_dimension
from granular.formulas.parser import Node
from granular.schema.field_kinds import (
    ChoiceKind,
    FieldError,
    FieldKind,
    FlagKind,
    IntegerKind,
    NestedSectionKind,
    QuantityKind,
    QuantityListKind,
    SectionListKind,
    TemperatureKind,
    TextKind,
    add_key_to_errors,
)
from granular.schema.units import si_value, unit_size
from granular.shared.errors import InputError, SceneError, quote, unknown_word_message


def section_field(kind: FieldKind, default: Any = dataclasses.MISSING) -> Any:
    """Declare a field of a section."""
    return dataclasses.field(default=default, metadata={"kind": kind})


def quantity(
    unit: str,
    *,
    default: Any = dataclasses.MISSING,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    optional: bool = False,
) -> Any:
    """Declare a number with an SI unit; in scenes it may be a string with any unit of the same dimension.

    The default is not checked here; `FieldError` is raised if a value or default in a scene is invalid.

    Parameters
    ----------
    unit : str
        SI unit of the number, such as ``"N/m"``; ``"1"`` for a pure number.
    default : float or str or None, optional
        Default, as a number in that unit or as text; without a default the key is required.
    above, least, below, most : float, optional
        Bounds in that unit: ``above`` and ``below`` are exclusive, ``least`` and ``most`` inclusive.
    optional : bool
        Allow None.

    Returns
    -------
    field
        Field of a section, with its checks; its value is the number in SI.

    Examples
    --------
    >>> from granular import effect, quantity
    >>> @effect
    ... class Wind:
    ...     strength: float = quantity("N/kg", above=0.0)
    ...     @staticmethod
    ...     def energy(p, grain, time):
    ...         return -p.strength * grain.mass * grain.x
    ...     @staticmethod
    ...     def force(p, grain, time):
    ...         return p.strength * grain.mass, 0.0
    >>> Wind.__name__
    'Wind'
    """
    kind = QuantityKind(optional, unit=unit, above=above, least=least, below=below, most=most)
    return section_field(kind, default)


def temperature_field() -> Any:
    """Declare an optional temperature of a section [deg C]."""
    # The maximum for NdFeB magnets and for the data of the liquids.
    return section_field(TemperatureKind(True, above=-273.15, most=250.0), None)


def integer_field(
    *, default: Any = dataclasses.MISSING, least: int = 0, most: int = 2**63 - 1, optional: bool = False
) -> Any:
    """Declare an integer of a section."""
    return section_field(IntegerKind(optional, least=least, most=most), default)


def flag_field(*, default: Any = dataclasses.MISSING, optional: bool = False) -> Any:
    """Declare a field of a section that is true or false."""
    return section_field(FlagKind(optional), default)


def choice_field(*names: str, default: Any = dataclasses.MISSING, optional: bool = False) -> Any:
    """Declare a choice among several words in a section."""
    return section_field(ChoiceKind(optional, names=names), default)


def text_field(*, default: Any = dataclasses.MISSING, optional: bool = False) -> Any:
    """Declare one line of text of a section."""
    return section_field(TextKind(optional), default)


def quantity_list_field(
    unit: str, *, default: Any = dataclasses.MISSING, above: float | None = None, least: float | None = None
) -> Any:
    """Declare a list of quantities of a section."""
    return section_field(QuantityListKind(element=QuantityKind(unit=unit, above=above, least=least)), default)


def nested_section_field(
    section: type[Section], *, default: Any = dataclasses.MISSING, optional: bool = False
) -> Any:
    """Declare a section within a section."""
    return section_field(NestedSectionKind(optional, section=section), default)


def section_list_field(section: type[Section], *, least: int = 0, default: Any = dataclasses.MISSING) -> Any:
    """Declare a list of sections within a section."""
    return section_field(SectionListKind(section=section, least=least), default)


@dataclass_transform(
    frozen_default=True,
    kw_only_default=True,
    field_specifiers=(
        section_field,
        quantity,
        temperature_field,
        integer_field,
        choice_field,
        text_field,
        quantity_list_field,
        nested_section_field,
        section_list_field,
    ),
)
class Section:
    """Base class of the sections of a scene. Subclasses are frozen dataclasses with keyword fields."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]
    unwritten_defaults: ClassVar[tuple[str, ...]] = ()  # keys that `to_plain` omits at their defaults

    def __init_subclass__(cls) -> None:
        dataclasses.dataclass(frozen=True, kw_only=True)(cls)

    def __post_init__(self) -> None:
        self._read_fields(None)

    def _read_fields(self, diameter: float | None) -> None:
        for field in dataclasses.fields(self):
            kind: FieldKind = field.metadata["kind"]
            with add_key_to_errors(field.name):
                value = kind.read_value(getattr(self, field.name), diameter)
                object.__setattr__(self, field.name, value)
        self.validate()

    def validate(self) -> None:
        """Check conditions on several fields; raise `FieldError` if a condition is not met."""

    def _inner_section(self, part: str) -> Any:
        """Section for the next part of a dotted key; None if there is no such section."""
        return getattr(self, part, None)

    @classmethod
    def key_names(cls) -> tuple[str, ...]:
        """Names of the fields, in their order.

        Returns
        -------
        tuple of str
            Keys that a scene may give.
        """
        return tuple(field.name for field in dataclasses.fields(cls))

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Self:
        """Make a section from plain data.

        Parameters
        ----------
        plain : mapping of str
            Plain data, as from `to_plain`.
        diameter : float, optional
            Value of the unit D [m].

        Returns
        -------
        Section
            The checked section.

        Raises
        ------
        FieldError
            For an unknown key (with the most similar known key), or a missing or invalid value.
        """
        if plain is True:
            plain = {}
        if not isinstance(plain, Mapping):
            raise FieldError(
                f"{quote(plain)} is not a table; give a table with the keys {', '.join(cls.key_names())}"
            )
        for key in plain:
            if key not in cls.key_names():
                raise FieldError(unknown_word_message(key, cls.key_names(), "key"))
        # The constructor does not take a diameter, which the unit D requires.
        self = object.__new__(cls)
        for field in dataclasses.fields(cls):
            default = None if field.default is dataclasses.MISSING else field.default
            object.__setattr__(self, field.name, plain.get(field.name, default))
        self._read_fields(diameter)
        return self

    def to_plain(self) -> dict[str, Any]:
        """Convert the section to plain data for TOML, which `from_plain` converts back.

        Returns
        -------
        dict
            Keys and plain values.
        """
        out: dict[str, Any] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name in self.unwritten_defaults and value == field.default:
                continue
            if value is not None:
                out[field.name] = field.metadata["kind"].to_plain(value)
            elif field.default is not None:
                # TOML has no null, and a missing key would take the default.
                out[field.name] = "none"
        return out


def find_field_value_and_kind(section: Any, key: str) -> tuple[Any, FieldKind] | None:
    """Return value and kind of the field at a dotted key, with list items given by index or ``name``."""
    *path, name = key.split(".")
    for part in path:
        section = _find_inner_section(section, part)
    if not isinstance(section, Section):
        return None
    field = section.__dataclass_fields__.get(name)
    return None if field is None else (getattr(section, name), field.metadata["kind"])


def find_value(section: Any, key: str) -> Any:
    """Return the value at a dotted key; None if there is no such key."""
    return (find_field_value_and_kind(section, key) or (None,))[0]


def _find_inner_section(section: Any, part: str) -> Any:
    if isinstance(section, tuple):
        indexed = {str(index): item for index, item in enumerate(section)}
        named = {str(getattr(item, "name", "")): item for item in section}
        return (indexed | named).get(part)
    return section._inner_section(part) if isinstance(section, Section) else None


_UNIT = re.compile(r"\s*[-+0-9.eE]+\s*(.*?)\s*")


@dataclasses.dataclass(frozen=True)
class ParameterValuesKind(FieldKind):
    """Kind of a field that maps names to numbers with an SI unit, such as ``10.0 kg s^-2``."""

    def parse(self, value: Any, diameter: float | None) -> tuple[tuple[str, str], ...]:
        """Read parameters, each a number with a unit."""
        result = {}
        for name, given in dict(value).items():
            with add_key_to_errors(name, errors=SceneError):
                result[name] = _si_value_text(given, diameter)
        return tuple(sorted(result.items()))


def _si_value_text(given: Any, diameter: float | None) -> str:
    if isinstance(given, bool) or not isinstance(given, int | float | str):
        raise FieldError(f"{quote(given)} is not a quantity; write a number and a unit, such as '5 mm'")
    match = _UNIT.fullmatch(str(given))
    unit = match[1] if match is not None else ""
    si = unit_text_of_dimension(_dimension_of_unit(unit or "1", diameter))
    return f"{si_value(str(given), si, diameter)!r} {si}"


def _dimension_of_unit(unit: str, diameter: float | None = None) -> Dimension:
    return tuple(map(Fraction, unit_size(unit, diameter)[1]))


class SectionWithFormula(Section):
    """A section with a formula, and the parameters of the formula.

    Attributes
    ----------
    variables : mapping of str to Dimension
        Variables of the formula and their dimensions; a scene gives no values for them.
    formula_key : str
        Key of the formula.
    unit : str
        SI unit of the formula's value.
    values : pairs of str
        Parameters, each with a number and SI unit; in a scene they are given next to the formula.
    """

    variables: ClassVar[Mapping[str, Dimension]] = {}
    formula_key: ClassVar[str] = ""
    unit: ClassVar[str] = "1"

    values: tuple[tuple[str, str], ...] = section_field(ParameterValuesKind(), default=())

    @property
    def formula(self) -> str:
        """Text of the formula."""
        formula: str = getattr(self, self.formula_key)
        return formula

    @property
    def parameters(self) -> list[tuple[float, str]]:
        """Values of the parameters with their SI units, in the order of `values`."""
        split = (given.split(" ", 1) for _, given in self.values)
        return [(float(number), unit) for number, unit in split]

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Self:
        """Read a table, in which additional keys are parameters of the formula."""
        if isinstance(plain, Mapping) and "values" not in plain:
            known = {name: plain[name] for name in plain if name in cls.key_names()}
            plain = known | {"values": {name: plain[name] for name in plain if name not in known}}
        return super().from_plain(plain, diameter)

    def to_plain(self) -> dict[str, Any]:
        """Convert the section to a table with its parameters, which `from_plain` converts back."""
        plain = super().to_plain()
        del plain["values"]
        return plain | dict(self.values)

    def validate(self) -> None:
        """Check that the formula is valid and has the right unit, and that all its parameters are given."""
        given = dict(self.values)
        try:
            tree = parse(self.formula)
            written = [name.text for name in variable_names(tree)]
            for name in written:
                if name not in self.variables and name not in given:
                    names = (*self.variables, *given)
                    raise InputError(
                        f"{unknown_word_message(name, names, 'name')}; or give the parameter as {name} = ..."
                    )
            for name in given:
                if name in self.variables:
                    raise FieldError("is a variable; give the parameter another name", name)
                if name not in written:
                    raise FieldError(f"{quote(name)} does not occur in {self.formula_key}; remove it", name)
            self.check_unit(tree, self.unit)
        except FieldError:
            raise
        except InputError as error:
            raise FieldError(str(error), self.formula_key) from None

    def check_unit(self, tree: Node, unit: str) -> None:
        """Check that the value of a formula has the given unit."""
        units = {name: given.split(" ", 1)[1] for name, given in self.values}
        known = dict(self.variables) | {name: _dimension_of_unit(unit) for name, unit in units.items()}
        dimension = infer_dimension(tree, known)
        if dimension != _dimension_of_unit(unit):
            raise InputError(
                f"the value is in {unit_text_of_dimension(dimension)}, but {unit} is required; "
                "check the units"
            )
