"""Less frequent garbage collection during compilation, which makes millions of objects with few cycles."""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Iterator

RARE = (50_000, 20, 50)
"""Thresholds for `gc.set_threshold`. With Python's defaults, garbage collection takes an eighth of the
compile time."""

_lock = threading.Lock()
_before: list[tuple[int, int, int]] = []
"""Thresholds that each thread found when it entered the block of `rare_garbage_collection`."""


@contextlib.contextmanager
def rare_garbage_collection() -> Iterator[None]:
    """Make garbage collection rare until the last thread leaves the block."""
    with _lock:
        _before.append(gc.get_threshold())
        if 0 < _before[0][0] < RARE[0]:
            gc.set_threshold(*RARE)
    try:
        yield
    finally:
        with _lock:
            # The last thread restores the thresholds that the first one found.
            thresholds = _before.pop()
            if not _before:
                gc.set_threshold(*thresholds)
