"""Conversion of values to plain data (numbers, texts, lists, tables), and back by annotations."""

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
    """Limits of a number in an annotation, and the meaning of null if null is allowed."""

    minimum: float = -_LARGEST
    maximum: float = _LARGEST
    null: float | None = None


class TextForm(NamedTuple):
    """Form of a text in an annotation."""

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
    """Error with the path of an entry, its value, and the required form."""
    return InputError(
        f"the data are not a reduced model: {sanitize(path)} is {quote(value)}; {wanted} is wanted"
    )


@functools.cache
def field_annotations_of_class(kind: type) -> dict[str, Any]:
    """Annotations of the fields of a class, with the metadata of their types."""
    return get_type_hints(kind, include_extras=True)


def plain_value(value: Any) -> Any:
    """Plain data of a number, text, array, dataclass or named tuple, or of a container of these."""
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
    """Value of an annotated kind, from plain data."""
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
    """Entries of a table with exactly the given names, each of its kind."""
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
    """Read several values of one kind, or a pair of numbers; in an ordered pair null means infinite."""
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
        raise wrong_value_error(path, value, "a pair in order")
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
        raise wrong_value_error(path, value, f"a text of at most {form.maximum_length} characters")
    if not (" ".join(value.split()) if form.lines else value).isprintable():
        raise wrong_value_error(path, value, "a text that can be printed")
    return value
