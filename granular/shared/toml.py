"""TOML texts as plain data, within limits."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from granular.shared.errors import InputError
from granular.shared.files import read_text

MOST_BYTES = 16 * 2**20
"""Of a file: the positions of 400 000 grains, which are read in half a minute."""
MOST_PARTS = 20
"""Of a dotted key, of which a scene's have up to four: the time grows with the square of them."""

_PART = r"(?:[A-Za-z0-9_-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_DOTTED = re.compile(rf"{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MOST_PARTS}}}")


def parse_toml(text: str) -> dict[str, Any]:
    """Plain data from a TOML text.

    Raises
    ------
    ValueError
        If it is none, or too much of one.
    """
    if _DOTTED.search(text):
        raise ValueError(f"a key of more than {MOST_PARTS} parts; write fewer dots")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("tables or lists too deep within each other") from None


def read_toml(path: Path, kind: type[InputError] = InputError) -> dict[str, Any]:
    """Plain data from a TOML file.

    Raises
    ------
    InputError
        Of the given kind, if it cannot be read.
    """
    text = read_text(path, MOST_BYTES, kind)
    try:
        return parse_toml(text)
    except ValueError as error:
        raise kind(f"{path}: not a TOML file: {error}") from None
