"""Convert values to plain data (numbers, strings, lists, tables), and back to the annotated types."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import numpy as np

from granular.formulas import MAX_CHARACTERS
from granular.shared.errors import InputError, quote, sanitize, unknown_word_message

_MOST_ITEMS = 200
_LARGEST = 1e100  # its square and cube are still finite


class NumberLimits(NamedTuple):
    """Annotation of a number: its limits, and the number that null represents, if null is allowed."""

    minimum: float = -_LARGEST
    maximum: float = _LARGEST
    null: float | None = None


class TextForm(NamedTuple):
    """Annotation of a string: its maximum length, line breaks and choices."""

    maximum_length: int = MAX_CHARACTERS
    lines: bool = False
    choices: tuple[str, ...] = ()


Size = Annotated[float, NumberLimits(0.0)]
SizeOrInfinity = Annotated[float, NumberLimits(0.0, math.inf)]
SizeOrUnknown = Annotated[float, NumberLimits(0.0, null=math.nan)]
Probability = Annotated[float, NumberLimits(0.0, 1.0)]
Interval = Annotated[tuple[float, float], "in order"]
Lines = Annotated[str, TextForm(lines=True)]


def wrong_value_error(path: str, value: object, wanted: str) -> InputError:
    """Return an error that names an entry by its path, its value, and the required form."""
    return InputError(f"the data are not a reduced model: {sanitize(path)} is {quote(value)}; give {wanted}")


@functools.cache
def field_annotations_of_class(kind: type) -> dict[str, Any]:
    """Return the annotations of a class's fields, with `Annotated` metadata."""
    return get_type_hints(kind, include_extras=True)


def plain_value(value: Any) -> Any:
    """Return a number, string, array, dataclass, named tuple or container of these as plain data."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    elif hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {key: plain_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_value(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def read_value(kind: Any, path: str, value: Any) -> Any:
    """Return a value of an annotated type from plain data; raise an error if the data do not match."""
    mark = None
    if get_origin(kind) is Annotated:
        kind, mark = get_args(kind)
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return None if value is None else read_value(parts[0], path, value)
    if origin is Literal:
        return _read_text(path, value, TextForm(choices=parts))
    if origin is Mapping:
        return _read_table(parts[1], path, value)
    if origin in (tuple, Sequence):
        items = _read_list(parts, path, value, ordered=mark is not None)
        return items if origin is tuple else list(items)
    if kind is bool:
        if not isinstance(value, bool):
            raise wrong_value_error(path, value, "true or false")
        return value
    if kind is str:
        return _read_text(path, value, mark or TextForm())
    if kind is int:
        return _read_integer(path, value, mark or NumberLimits(0, 10**12))
    if kind is float:
        return _read_number(path, value, mark or NumberLimits())
    return kind(**read_entries(field_annotations_of_class(kind), path, value))


def read_entries(kinds: Mapping[str, Any], path: str, value: Any) -> dict[str, Any]:
    """Return the entries of a table, which must have the given names and types."""
    if not isinstance(value, Mapping):
        raise wrong_value_error(path, value, "a table")
    for key in value:
        if key not in kinds:
            raise InputError(
                "the data are not a reduced model: "
                f"{sanitize(path)}: {unknown_word_message(str(key), tuple(kinds), 'key')}"
            )
    for key in kinds:
        if key not in value:
            raise InputError(
                f"the data are not a reduced model: {sanitize(path)}: {key!r} is "
                "missing; give the file that was saved"
            )
    return {key: read_value(kinds[key], f"{path}.{key}", item) for key, item in value.items()}


def _read_table(kind: Any, path: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping) or len(value) > _MOST_ITEMS:
        raise wrong_value_error(path, value, f"a table of at most {_MOST_ITEMS} entries")
    return {
        _read_text(path, key, TextForm(200)): read_value(kind, f"{path}.{key}", item)
        for key, item in value.items()
    }


def _read_list(kinds: Sequence[Any], path: str, value: Any, *, ordered: bool) -> tuple[Any, ...]:
    """Return a list of values; if ``ordered``, an increasing pair of numbers, with null for infinity."""
    most = 2 if len(kinds) == 2 and kinds[1] is float else _MOST_ITEMS
    if not isinstance(value, list | tuple) or len(value) > most:
        raise wrong_value_error(path, value, f"a list of at most {most} items")
    if most == 2 and len(value) != 2:
        raise wrong_value_error(path, value, "a pair")
    if not ordered:
        return tuple(read_value(kinds[0], f"{path}.{index}", item) for index, item in enumerate(value))
    low, high = (
        _read_number(f"{path}.{index}", item, NumberLimits(-math.inf, math.inf, null))
        for index, (item, null) in enumerate(zip(value, (-math.inf, math.inf), strict=True))
    )
    if low > high:
        raise wrong_value_error(path, value, "a pair in order (low, high)")
    return low, high


def _read_number(path: str, value: Any, limits: NumberLimits) -> float:
    if value is None and limits.null is not None:
        return limits.null
    try:
        number = float(value) if isinstance(value, int | float) else math.nan
    except OverflowError:
        number = math.nan
    if isinstance(value, bool) or not limits.minimum <= number <= limits.maximum:
        raise wrong_value_error(path, value, f"a number from {limits.minimum:g} to {limits.maximum:g}")
    return number


def _read_integer(path: str, value: Any, limits: NumberLimits) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not limits.minimum <= value <= limits.maximum:
        raise wrong_value_error(path, value, f"an integer from {limits.minimum:g} to {limits.maximum:g}")
    return value


def _read_text(path: str, value: Any, form: TextForm) -> str:
    if form.choices and value not in form.choices:
        raise wrong_value_error(path, value, f"one of {', '.join(form.choices)}")
    if not isinstance(value, str) or len(value) > form.maximum_length:
        raise wrong_value_error(path, value, f"a string of at most {form.maximum_length} characters")
    if not (" ".join(value.split()) if form.lines else value).isprintable():
        raise wrong_value_error(path, value, "a string of printable characters")
    return value
