"""Number of threads of a run, by how long its steps take.

The bits are the same for any number. Where other programs want the processors, threads that wait
for each other can take hundreds of times as long as one.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import time

import numba

from granular.pairs.direct_sum import PARTED_FROM, PARTS
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from granular.shared.message_text import quote

SHORTEST, LONGEST = 1.0, 60.0
"""Seconds until the number that took longer is tried again: at first, and after many trials, each
of which doubles them."""


class ThreadCountTuner:
    """One thread, or as many as there can be: what was quicker when it was tried last."""

    def __init__(self, most: int) -> None:
        self.most = self.count = most
        self.trying = most > 1
        self._took: dict[int, float] = {}
        self._until, self._wait = 0.0, SHORTEST

    def record_step_time(self, steps: int, seconds: float) -> None:
        """Record the time of steps with the present number of threads [s], and set the next number."""
        if self.most == 1 or steps == 0:
            return
        self._took[self.count] = seconds / steps
        now = time.perf_counter()
        other = 1 if self.count == self.most else self.most
        if self.trying and other in self._took:
            self.trying, self._until = False, now + self._wait
            self._wait = min(2.0 * self._wait, LONGEST)
            self.count = min(self._took, key=lambda count: self._took[count])
        elif now >= self._until:
            self.trying, self.count = True, other
        set_thread_count(self.count)


def choose_thread_count(scene: Scene, requested: int | None) -> int:
    """Choose the number of threads: the requested one, or the greatest that can pay off."""
    available = int(numba.config.NUMBA_NUM_THREADS)
    if requested is None:
        parted = scene.pair_method != "verlet-list" and scene.grains.count > PARTED_FROM
        return min(available, PARTS) if parted and _threads_start_quickly(scene) else 1
    if isinstance(requested, bool) or not isinstance(requested, int) or not 1 <= requested <= available:
        raise InputError(f"threads = {quote(requested)}; give an integer from 1 to {available}")
    return requested


def _threads_start_quickly(scene: Scene) -> bool:
    """Return True where threads start within a small fraction of a step."""
    if scene.pair_method == "direct" and scene.pairs.far_every is None:
        return True
    # Numba's own threads take some 50 us to start, several times a step of near pairs and mesh; those of
    # OpenMP and TBB one or two.
    if numba.config.THREADING_LAYER == "workqueue":
        return False
    for pool in ("omppool", "tbbpool"):
        with contextlib.suppress(ImportError):
            importlib.import_module(f"numba.np.ufunc.{pool}")
            return True
    return False


def set_thread_count(count: int) -> None:
    """Set the number of threads that compiled kernels use."""
    try:
        numba.set_num_threads(max(1, min(count, numba.config.NUMBA_NUM_THREADS)))
    except ValueError as error:
        layer = os.environ.get("NUMBA_THREADING_LAYER")
        reason = " ".join(str(error).split())
        raise InputError(f"NUMBA_THREADING_LAYER = {layer!r} cannot be used ({reason}); unset it") from None
