"""Wall time of calls: minimum of many, measured in turn, so that load affects all equally."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping


def _seconds(call: Callable[[], object], repeats: int) -> float:
    started = time.perf_counter()
    for _ in range(repeats):
        call()
    return (time.perf_counter() - started) / repeats


def minimum_seconds(
    calls: Mapping[str, Callable[[], object]], *, rounds: int = 15, seconds: float = 0.01
) -> dict[str, float]:
    """Return the minimum time of each call [s].

    Parameters
    ----------
    calls : mapping of str to callable
        Calls to time. Each is called once before, which compiles it.
    rounds : int
        Number of measurements of each call, in turn.
    seconds : float
        Approximate duration of one measurement, which repeats its call [s].
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
