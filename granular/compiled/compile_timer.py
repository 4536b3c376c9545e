"""Time that kernels take to be compiled or read, which is no price of a run, and their number."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator

from numba.core.event import Event, Listener, install_listener


class CompileTimer(Listener):
    """Counts the time in which its thread holds the lock of Numba's compiler."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._thread, self._depth, self._begun = threading.get_ident(), 0, 0.0

    def on_start(self, event: Event) -> None:
        """Start the clock where the thread takes the lock."""
        if threading.get_ident() == self._thread:
            if self._depth == 0:
                self._begun = time.perf_counter()
            self._depth += 1

    def on_end(self, event: Event) -> None:
        """Stop the clock where the thread gives the lock back."""
        if threading.get_ident() == self._thread:
            self._depth -= 1
            if self._depth == 0:
                self.seconds += time.perf_counter() - self._begun


@contextlib.contextmanager
def measure_compile_time() -> Iterator[CompileTimer]:
    """Measure the time in which kernels are compiled or read within the block [s]."""
    with install_listener("numba:compiler_lock", CompileTimer()) as timer:
        yield timer


class CompileReporter(Listener):
    """Tells how many kernels its thread has begun to compile; those from the cache do not count."""

    def __init__(self, report: Callable[[int], None]) -> None:
        self._report, self._thread, self._begun = report, threading.get_ident(), 0

    def on_start(self, event: Event) -> None:
        """Count a kernel whose compiling the thread begins, and report the number."""
        if threading.get_ident() == self._thread:
            self._begun += 1
            self._report(self._begun)

    def on_end(self, event: Event) -> None:
        """Do nothing where a kernel is done."""
        pass


@contextlib.contextmanager
def report_compiled_kernels(report: Callable[[int], None]) -> Iterator[None]:
    """Call a function with the number of each kernel that is compiled within the block."""
    with install_listener("numba:compile", CompileReporter(report)):
        yield
