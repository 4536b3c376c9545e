"""Kinds of fields. Each kind reads, checks and writes values as plain data, as in a TOML file."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from granular.schema.units import si_value
from granular.shared.errors import InputError, SceneError, quote, sanitize, unknown_word_message

_LONGEST = 200  # characters of a name
_DIGITS = re.compile(r"[+-]?[0-9]{1,30}")
_TEMPERATURE = re.compile(r"\s*([+-]?[0-9]{1,6}(?:\.[0-9]{0,20})?)\s*(°C|degC|K|)\s*")


class FieldError(SceneError):
    """Invalid value of a field; ``path`` is the path of the field's key in the scene."""

    def __init__(self, reason: str, *path: str) -> None:
        self.reason, self.path = reason, path
        super().__init__(f"{'.'.join(map(sanitize, path))}: {reason}" if path else reason)


@contextlib.contextmanager
def add_key_to_errors(*path: str, errors: type[InputError] = FieldError) -> Iterator[None]:
    """Convert errors in the ``with`` block to `FieldError`, and put ``path`` in front of their paths."""
    try:
        yield
    except errors as error:
        raise FieldError(getattr(error, "reason", str(error)), *path, *getattr(error, "path", ())) from None


def _parse_number(value: object) -> float:
    """Convert a number, or a string with a number, to a float; reject booleans and too large values."""
    if not isinstance(value, bool | np.bool_):
        try:
            if not isinstance(value, str) or (value.isascii() and "_" not in value):
                return float(value)  # type: ignore[arg-type]  # raises if it is not a number
        except (TypeError, ValueError):
            pass
        except OverflowError:
            raise FieldError(f"{quote(value)} is too large for double precision; check the unit") from None
    raise FieldError(f"{quote(value)} is not a number")


@dataclasses.dataclass(frozen=True)
class FieldKind:
    """Base class of kinds of fields, which read, check and write a field's value."""

    optional: bool = False

    def read_value(self, value: Any, diameter: float | None) -> Any:
        """Read a value, which may be missing if the field is optional.

        Parameters
        ----------
        value : object
            Value as plain data.
        diameter : float or None
            Value of the unit D [m]; None if D cannot be used.

        Returns
        -------
        object
            Value of the field; None if it is missing.

        Raises
        ------
        FieldError
            If the value is invalid.
        """
        if value is None or (self.optional and value == "none"):
            if self.optional:
                return None
            raise FieldError("must be given")
        return self.parse(value, diameter)

    def parse(self, value: Any, diameter: float | None) -> Any:
        """Read a value that is not missing.

        Parameters
        ----------
        value : object
            Value as plain data.
        diameter : float or None
            Value of the unit D [m]; None if D cannot be used.

        Returns
        -------
        object
            Value of the field.

        Raises
        ------
        FieldError
            If the value is invalid.
        """
        raise NotImplementedError

    def to_plain(self, value: Any) -> Any:
        """Convert a value to plain data.

        Parameters
        ----------
        value : object
            Value of the field.

        Returns
        -------
        object
            Plain data.
        """
        return value


@dataclasses.dataclass(frozen=True)
class QuantityKind(FieldKind):
    """A number in an SI unit, with bounds."""

    unit: str = "1"
    above: float | None = None
    least: float | None = None
    below: float | None = None
    most: float | None = None

    def parse(self, value: Any, diameter: float | None) -> float:
        """Read a number in the field's SI unit, or text with a unit of the same dimension."""
        if isinstance(value, str):
            with add_key_to_errors(errors=SceneError):
                number = si_value(value, self.unit, diameter)
        else:
            number = _parse_number(value)
        unit = "" if self.unit == "1" else f" {self.unit}"
        if not math.isfinite(number):
            raise FieldError(f"{number} must be finite; give a number{unit and ' in' + unit}")
        tiny = self.above is not None and 0.0 < number < 1e-30
        if self.unit != "1" and (tiny or abs(number) > 1e30):
            raise FieldError(f"{number:g}{unit} is too large or too small for any quantity; check the unit")
        for limit, words, fits in (
            (self.above, "above", operator.gt),
            (self.least, "at least", operator.ge),
            (self.below, "below", operator.lt),
            (self.most, "at most", operator.le),
        ):
            if limit is not None and not fits(number, limit):
                raise FieldError(f"{number:g}{unit} must be {words} {limit:g}{unit}")
        return number


@dataclasses.dataclass(frozen=True)
class TemperatureKind(QuantityKind):
    """A temperature in degrees Celsius; text can also give the temperature in kelvin."""

    unit: str = "degC"

    def parse(self, value: Any, diameter: float | None) -> float:
        """Read a temperature: a number in deg C, or text in deg C or kelvin."""
        if isinstance(value, str) and (match := _TEMPERATURE.fullmatch(value)):
            value = float(match[1]) - (273.15 if match[2] == "K" else 0.0)
        return super().parse(_parse_number(value), diameter)


@dataclasses.dataclass(frozen=True)
class IntegerKind(FieldKind):
    """An integer, with bounds."""

    least: int = 0
    most: int = 2**63 - 1

    def parse(self, value: Any, diameter: float | None) -> int:
        """Read an integer, also from text or from a float with an integer value."""
        number = _parse_integer(value)
        if number is None:
            raise FieldError(f"{quote(value)} must be an integer")
        if number < self.least:
            raise FieldError(f"{quote(number)} must be at least {self.least}")
        if number > self.most:
            raise FieldError(f"{quote(number)} must be at most {self.most:g}")
        return number


def _parse_integer(value: object) -> int | None:
    """Return the exact integer; None if the value is not an integer."""
    if isinstance(value, str) and _DIGITS.fullmatch(value):
        return int(value)
    if isinstance(value, bool | np.bool_):
        return None
    if isinstance(value, int | np.integer):
        return int(value)
    number = _parse_number(value)
    return int(number) if math.isfinite(number) and not number % 1.0 else None


@dataclasses.dataclass(frozen=True)
class FlagKind(FieldKind):
    """True or false."""

    def parse(self, value: Any, diameter: float | None) -> bool:
        """Read true or false, also from text."""
        known = {"true": True, "false": False}
        if isinstance(value, str) and value in known:
            return known[value]
        if not isinstance(value, bool | np.bool_):
            raise FieldError(f"{quote(value)} must be true or false")
        return bool(value)


@dataclasses.dataclass(frozen=True)
class ChoiceKind(FieldKind):
    """One of the words that a field allows."""

    names: tuple[str, ...] = ()

    def parse(self, value: Any, diameter: float | None) -> str:
        """Read one of the words that the field allows."""
        if not isinstance(value, str) or value not in self.names:
            raise FieldError(unknown_word_message(str(value), self.names, "choice"))
        return value


@dataclasses.dataclass(frozen=True)
class TextKind(FieldKind):
    """One line of text."""

    def parse(self, value: Any, diameter: float | None) -> str:
        """Read one line of text."""
        if not isinstance(value, str) or not value.strip():
            raise FieldError(f"{quote(value)} must be a non-empty string")
        if len(value) > _LONGEST or not value.isprintable():
            raise FieldError(f"{quote(value)} must be one line of at most {_LONGEST} printable characters")
        return value


@dataclasses.dataclass(frozen=True)
class PointListKind(FieldKind):
    """A list of pairs of quantities."""

    unit: str = "m"

    def parse(self, value: Any, diameter: float | None) -> tuple[tuple[float, float], ...]:
        """Read a list of pairs of quantities."""
        quantity = QuantityKind(unit=self.unit)
        try:
            rows = [tuple(row) for row in value]
        except TypeError:
            raise FieldError("must be a list of pairs [x, y]") from None
        for index, row in enumerate(rows):
            if len(row) != 2 or isinstance(value[index], str):
                raise FieldError("must be a pair [x, y]", str(index))
        return tuple((quantity.parse(x, diameter), quantity.parse(y, diameter)) for x, y in rows)

    def to_plain(self, value: Any) -> Any:
        """Convert the pairs to lists."""
        return [list(row) for row in value]


def _read_items(
    items: Iterable[Any], read: Callable[[Any, float | None], Any], diameter: float | None
) -> tuple[Any, ...]:
    result = []
    for index, item in enumerate(items):
        with add_key_to_errors(str(index)):
            result.append(read(item, diameter))
    return tuple(result)


@dataclasses.dataclass(frozen=True)
class QuantityListKind(FieldKind):
    """A list of quantities."""

    element: QuantityKind = QuantityKind()

    def parse(self, value: Any, diameter: float | None) -> tuple[float, ...]:
        """Read a list of quantities."""
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise FieldError("must be a list of numbers")
        return _read_items(value, self.element.parse, diameter)

    def to_plain(self, value: Any) -> Any:
        """Convert the numbers to a list."""
        return list(value)


@dataclasses.dataclass(frozen=True)
class NestedSectionKind(FieldKind):
    """A nested section."""

    section: type[Any] | None = None

    def parse(self, value: Any, diameter: float | None) -> Any:
        """Read a section from its table."""
        assert self.section is not None
        return value if isinstance(value, self.section) else self.section.from_plain(value, diameter)

    def to_plain(self, value: Any) -> Any:
        """Convert the section to a table."""
        return value.to_plain()


@dataclasses.dataclass(frozen=True)
class SectionListKind(FieldKind):
    """A list of sections of one class, or of several classes distinguished by the key ``kind``."""

    section: type[Any] | None = None
    kinds: Mapping[str, type[Any]] | None = None
    least: int = 0

    def parse(self, value: Any, diameter: float | None) -> tuple[Any, ...]:
        """Read a list of sections, whose names must differ."""
        if isinstance(value, str | Mapping) or not isinstance(value, Sequence):
            raise FieldError("must be a list of tables")
        if len(value) < self.least:
            raise FieldError(f"must hold at least {self.least} table")
        built = _read_items(value, self._read_section, diameter)
        names = [getattr(item, "name", "") for item in built]
        for name in names:
            if name and names.count(name) > 1:
                raise FieldError(f"the name {quote(name)} is given twice; names must differ")
        return built

    def _read_section(self, item: Any, diameter: float | None) -> Any:
        if self.kinds is None:
            assert self.section is not None
            return NestedSectionKind(section=self.section).parse(item, diameter)
        if isinstance(item, tuple(self.kinds.values())):
            return item
        if not isinstance(item, Mapping):
            raise FieldError(f"{quote(item)} must be a table")
        if "kind" not in item:
            raise FieldError(f"must be given; use one of {', '.join(self.kinds)}", "kind")
        if not isinstance(item["kind"], str) or item["kind"] not in self.kinds:
            raise FieldError(unknown_word_message(str(item["kind"]), tuple(self.kinds), "kind"), "kind")
        rest = {key: value for key, value in item.items() if key != "kind"}
        return self.kinds[item["kind"]].from_plain(rest, diameter)

    def to_plain(self, value: Any) -> Any:
        """Convert the sections to tables, with the key ``kind`` if the list allows several kinds."""
        if self.kinds is None:
            return [item.to_plain() for item in value]
        names = {cls: name for name, cls in self.kinds.items()}
        return [{"kind": names.get(type(item)), **item.to_plain()} for item in value]
