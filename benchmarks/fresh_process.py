"""Measurements that need a separate process: peak memory, and starts with and without a cache.

``python -m benchmarks.fresh_process GRAINS METHOD`` prints the peak memory of a few steps.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.process import finished

WORDS = ("-m", "granular", "run", "bed", "--t-end", "0.01", "--dt", "2.5e-5", "--quiet")
"""A short run of the packaged bed on the command line: 400 steps."""

_FIRST_STEP = """
import sys
from granular import load_scene, simulate
simulate(load_scene(sys.argv[1]), t_end=1e-6, progress=False)
"""


def peak_memory(count: int, method: str) -> list[dict[str, Any]]:
    """Return the peak memory [bytes] of a process that makes and advances a bed."""
    command = [sys.executable, "-m", "benchmarks.fresh_process", str(count), method]
    return [{"method": method, "grains": count, **json.loads(finished(command))}]


def starts() -> list[dict[str, Any]]:
    """Return the wall time [s] of processes that import, that compile, and that use cached code."""
    with tempfile.TemporaryDirectory() as cache:
        store = {"NUMBA_CACHE_DIR": cache}
        timed = {
            "import granular": _seconds(("-c", "import granular"), {}),
            "cold run: everything is compiled": _seconds(WORDS, store),
            "warm run: compiled code is on disk": _seconds(WORDS, store),
            "first step of a damper: everything is compiled": _seconds(
                ("-c", _FIRST_STEP, "damper"), {"NUMBA_CACHE_DIR": f"{cache}/other"}
            ),
        }
    return [{"start": name, "seconds": seconds} for name, seconds in timed.items()]


def _seconds(words: Sequence[str], environment: Mapping[str, str]) -> float:
    started = time.perf_counter()
    finished([sys.executable, *words], environment)
    return time.perf_counter() - started


def _peak() -> int:
    """Return the peak memory of this process [bytes]."""
    import resource

    status = Path("/proc/self/status")
    if status.is_file():
        # On Linux a process inherits the peak of getrusage from its parent process.
        (line,) = (item for item in status.read_text().splitlines() if item.startswith("VmHWM:"))
        return 1024 * int(line.split()[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _measure(count: int, method: str) -> dict[str, int]:
    from benchmarks.engine import bed_of
    from validation.overview import EngineSteps

    small = EngineSteps(bed_of(92, {"pairs.method": method}))
    small.make_steps(16)
    before = _peak()
    engine = EngineSteps(bed_of(count, {"pairs.method": method}))
    engine.make_steps(16)
    return {"bytes": _peak(), "of 92 grains": before}


if __name__ == "__main__":
    print(json.dumps(_measure(int(sys.argv[1]), sys.argv[2])))
