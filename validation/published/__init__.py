"""The source's published values beside the toolkit's own, with scatter and a verdict each.

>>> from validation.published import published
>>> found = published("out/published", full=False)
"""

from __future__ import annotations

import importlib
from typing import Any

_HOMES = {
    "published": "validation.published.programme",
    "entries": "validation.published.entries",
    "Entry": "validation.published.entry",
    "Finding": "validation.published.entry",
    "committed": "validation.published.results",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    # Names are looked up when they are used, so that importing the package costs next to nothing.
    if name not in _HOMES:
        raise AttributeError(f"module 'validation.published' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
