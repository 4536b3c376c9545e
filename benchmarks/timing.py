"""Wall time of calls: the least of many, taken in turn, so that a slow spell hits all alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping


def _seconds(call: Callable[[], object], repeats: int) -> float:
    started = time.perf_counter()
    for _ in range(repeats):
        call()
    return (time.perf_counter() - started) / repeats


def least_seconds(
    calls: Mapping[str, Callable[[], object]], *, rounds: int = 15, seconds: float = 0.01
) -> dict[str, float]:
    """Least time of one call of each [s].

    Parameters
    ----------
    calls : mapping of str to callable
        Each is called once before, which compiles and warms up.
    rounds : int
        How often each is measured, in turn.
    seconds : float
        About how long one measurement repeats its call [s].
    """
    repeats = {}
    for name, call in calls.items():
        call()
        repeats[name] = max(1, round(seconds / max(_seconds(call, 1), 1e-9)))
    result = dict.fromkeys(calls, float("inf"))
    for _ in range(rounds):
        for name, call in calls.items():
            result[name] = min(result[name], _seconds(call, repeats[name]))
    return result
