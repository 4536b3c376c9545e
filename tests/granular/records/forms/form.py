"""The motion, and how a form of it is noted."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

COUNT = 80
TIME = 0.01 * np.arange(COUNT)
HEIGHT = 0.059 + 0.003 * np.exp(-0.8 * TIME) * np.cos(21.0 * TIME)
FORCE = 74.0 + 5.0 * np.cos(21.0 * TIME)

Write = Callable[[Path], Any]


class Form(NamedTuple):
    """A file."""

    name: str
    write: Write
    said: Mapping[str, Any] = MappingProxyType({})
    places: float = 5e-9
    scale: float = 1.0
    after: str = ""
    source: str = ""


FORMS: dict[str, Form] = {}


def form(name: str, **more: Any) -> Callable[[Write], Write]:
    def note(write: Write) -> Write:
        FORMS[write.__name__] = Form(name, write, **more)
        return write

    return note


def rows(decimals: int = 6, mark: str = ".", scale: float = 1e3) -> list[tuple[str, str]]:
    """Times [s], and heights with so many decimals."""
    return [
        (f"{t:.4f}".replace(".", mark), f"{scale * z:.{decimals}f}".replace(".", mark))
        for t, z in zip(TIME, HEIGHT, strict=True)
    ]


def lines(header: str, separator: str, end: str = "\n", **more: Any) -> str:
    return end.join([header, *(separator.join(row) for row in rows(**more)), ""])
