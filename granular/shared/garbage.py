"""Rare collection of garbage: compilers make objects by the million, and hardly any cycle of them."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Iterator

RARE = (50_000, 20, 50)
"""Thresholds of `gc.set_threshold`; Python's own take an eighth of the time of compiling."""


@contextlib.contextmanager
def rare_garbage_collection() -> Iterator[None]:
    """Look for garbage seldom within it, unless the program looks for it more seldom still, or never."""
    before = gc.get_threshold()
    if 0 < before[0] < RARE[0]:
        gc.set_threshold(*RARE)
    try:
        yield
    finally:
        gc.set_threshold(*before)
