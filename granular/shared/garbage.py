"""Rare collection of garbage: compilers make objects by the million, and hardly any cycle of them."""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Iterator

RARE = (50_000, 20, 50)
"""Thresholds of `gc.set_threshold`; Python's own take an eighth of the time of compiling."""

_lock = threading.Lock()
_before: list[tuple[int, int, int]] = []
"""Thresholds that each thread within it found."""


@contextlib.contextmanager
def rare_garbage_collection() -> Iterator[None]:
    """Look for garbage seldom until the last thread has left, unless the program looks less often still."""
    with _lock:
        _before.append(gc.get_threshold())
        if 0 < _before[0][0] < RARE[0]:
            gc.set_threshold(*RARE)
    try:
        yield
    finally:
        with _lock:
            # Whoever leaves last gives back what the first one found.
            thresholds = _before.pop()
            if not _before:
                gc.set_threshold(*thresholds)
