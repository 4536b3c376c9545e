"""Sections: frozen dataclasses whose fields check themselves and round-trip through plain data.

A section's fields are declared by the functions below (`quantity`, `integer_field`, ...). Each makes a field
of a kind (`granular.schema.field_kinds`), which reads, checks and writes its value.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar, Self, dataclass_transform

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
    at_key,
)
from granular.shared.message_text import quote, unknown_word_message


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
    """Declare a number in an SI unit, which scenes also give as text with a unit of that dimension.

    Nothing is checked here: a scene whose value, or whose default, does not fit raises `FieldError`.

    Parameters
    ----------
    unit : str
        SI unit of the number, such as ``"N/m"``; ``"1"`` for none.
    default : float or str or None, optional
        Value where a scene gives none, in that unit or as text; without it the key is needed.
    above, least, below, most : float, optional
        Bounds in that unit; ``above`` and ``below`` are left out of the range.
    optional : bool
        Allow None.

    Returns
    -------
    field
        Field of a section, with its checks; the made object has the number, in SI.

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
    # No magnet of NdFeB bears more, and the liquids are known up to there.
    return section_field(TemperatureKind(True, above=-273.15, most=250.0), None)


def integer_field(
    *, default: Any = dataclasses.MISSING, least: int = 0, most: int = 2**63 - 1, optional: bool = False
) -> Any:
    """Declare an integer of a section."""
    return section_field(IntegerKind(optional, least=least, most=most), default)


def flag_field(*, default: Any = dataclasses.MISSING, optional: bool = False) -> Any:
    """Declare a truth value of a section."""
    return section_field(FlagKind(optional), default)


def choice_field(*names: str, default: Any = dataclasses.MISSING, optional: bool = False) -> Any:
    """Declare a word of a section, one of several."""
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
    """Base of the scene's parts. Subclasses are frozen dataclasses with keyword fields."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]

    def __init_subclass__(cls) -> None:
        dataclasses.dataclass(frozen=True, kw_only=True)(cls)

    def __post_init__(self) -> None:
        self._read_fields(None)

    def _read_fields(self, diameter: float | None) -> None:
        for field in dataclasses.fields(self):
            kind: FieldKind = field.metadata["kind"]
            with at_key(field.name):
                value = kind.read_value(getattr(self, field.name), diameter)
                object.__setattr__(self, field.name, value)
        self.validate()

    def validate(self) -> None:
        """Check what no single field can; raise `FieldError`."""

    def _inner_section(self, part: str) -> Any:
        """Part by which a dotted key goes on; None if there is none."""
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
        """Section from plain data.

        Parameters
        ----------
        plain : mapping of str
            Plain data, as `to_plain` makes them.
        diameter : float, optional
            Diameter that the unit D stands for [m].

        Returns
        -------
        Section
            The section, checked.

        Raises
        ------
        FieldError
            For an unknown key (with the nearest known one), a missing or an unfit value.
        """
        if plain is True:
            plain = {}
        if not isinstance(plain, Mapping):
            raise FieldError(f"{quote(plain)} must be a table with the keys {', '.join(cls.key_names())}")
        for key in plain:
            if key not in cls.key_names():
                raise FieldError(unknown_word_message(key, cls.key_names(), "key"))
        # The constructor has no diameter, which the unit D of the fields needs.
        self = object.__new__(cls)
        for field in dataclasses.fields(cls):
            default = None if field.default is dataclasses.MISSING else field.default
            object.__setattr__(self, field.name, plain.get(field.name, default))
        self._read_fields(diameter)
        return self

    def to_plain(self) -> dict[str, Any]:
        """Section as plain data, ready for TOML; `from_plain` makes an equal section of it.

        Returns
        -------
        dict
            Keys and plain values.
        """
        out: dict[str, Any] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None:
                out[field.name] = field.metadata["kind"].to_plain(value)
            elif field.default is not None:
                # TOML has no null, and a missing key would take the default.
                out[field.name] = "none"
        return out


def find_field(section: Any, key: str) -> tuple[Any, FieldKind] | None:
    """Find the field that a dotted key leads to, an item of a list by its index or ``name``."""
    *path, name = key.split(".")
    for part in path:
        section = _find_inner_section(section, part)
    if not isinstance(section, Section):
        return None
    field = section.__dataclass_fields__.get(name)
    return None if field is None else (getattr(section, name), field.metadata["kind"])


def find_value(section: Any, key: str) -> Any:
    """Find the value that a dotted key leads to; None if it leads nowhere."""
    return (find_field(section, key) or (None,))[0]


def _find_inner_section(section: Any, part: str) -> Any:
    if isinstance(section, tuple):
        indexed = {str(index): item for index, item in enumerate(section)}
        named = {str(getattr(item, "name", "")): item for item in section}
        return (indexed | named).get(part)
    return section._inner_section(part) if isinstance(section, Section) else None
