"""Numbers that de Paula (2025) prints, from ``published.toml``, and the duration of a compression.

>>> from validation.published import published_value
>>> alpha = published_value("damper.van_der_pol_like.alpha")
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from granular.scene.published_beds import END, LOWEST_START, REFERENCE_COUNT, START
from granular.shared.errors import InputError

__all__ = ["compression_duration", "published_value"]

PATH = Path(__file__).parent / "published.toml"

LABELS = ("source", "n", "aspect_ratio", "aspect", "steps")
"""Keys that say what the other values of a section belong to."""

_INDEX = re.compile(r"(.*)\[(\d+)\]")


@cache
def published_values() -> dict[str, dict[str, Any]]:
    """All values that de Paula (2025) prints, by section and name."""
    return tomllib.loads(PATH.read_text(encoding="utf-8"))


def published_value(key: str) -> Any:
    """Look up a number that de Paula (2025) prints.

    Parameters
    ----------
    key : str
        Path of a value in ``published.toml``, such as ``"damper.van_der_pol_like.alpha"`` or
        ``"section.name[2]"``.

    Returns
    -------
    Any
        Number, text or list, in the unit of the thesis.

    Raises
    ------
    InputError
        If there is no value at the key.

    Examples
    --------
    >>> from validation.published import published_value
    >>> published_value("damper.rest_height")
    10.53
    """
    match = _INDEX.fullmatch(key)
    name, position = (match[1], int(match[2])) if match else (key, None)
    result: Any = published_values()
    try:
        for part in name.split("."):
            result = result[part]
        return result if position is None else result[position]
    except (KeyError, IndexError, TypeError):
        raise InputError(f"{key!r} is no published value; see {PATH.name}") from None


def published_keys() -> Iterator[str]:
    """Keys of all published values, labels left out."""
    for section, entries in published_values().items():
        for name, value in entries.items():
            if name not in LABELS:
                yield from _flatten_below(f"{section}.{name}", value)


def _flatten_below(key: str, value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        for name, item in value.items():
            yield from _flatten_below(f"{key}.{name}", item)
    elif isinstance(value, list):
        yield from (f"{key}[{index}]" for index in range(len(value)))
    else:
        yield key


def compression_duration(count: int, speed: float) -> float:
    """Compute the duration of the compression of a bed of equal 6 mm grains.

    From the heights of the piston before and after it by de Paula (2025, Table 2.1 and section 3.4).

    Parameters
    ----------
    count : int
        Number of grains, from 1 on.
    speed : float
        Speed of the piston [m/s], above 0.

    Returns
    -------
    float
        Duration [s].
    """
    size = math.sqrt(count / REFERENCE_COUNT)
    return (max(START * size, LOWEST_START) - END * size) * 0.006 / speed
