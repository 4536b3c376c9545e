"""Handling of Ctrl-C and, on the command line, of SIGTERM.

If the toolkit is used as a library, it does not change the handling of SIGTERM.
"""

from __future__ import annotations

import _thread
import contextlib
import ctypes
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import TYPE_CHECKING, NoReturn

from granular.shared.errors import Interrupted, Terminated

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

AGAIN = 0.05
"""Delay [s] after which a stop exception is raised again if Python has dropped it."""


class StopRequest:
    """Record of a stop signal that arrived while stop signals were deferred."""

    def __init__(self) -> None:
        self.number: int | None = None
        self.trajectory: object = None

    @property
    def is_requested(self) -> bool:
        """True once a signal has arrived."""
        return self.number is not None

    def stop_exception(self) -> KeyboardInterrupt:
        """Make the exception for the signal, with the results of the run so far, if any."""
        terminated = self.number == signal.SIGTERM
        if self.trajectory is not None:
            return Interrupted(self.trajectory, terminated)
        return Terminated() if terminated else KeyboardInterrupt()

    def _record_signal(self, number: int, _: FrameType | None) -> None:
        self.number = number
        # Numba may be unusable afterwards, which matters if the process continues, as in a notebook.
        if signal.getsignal(signal.SIGTERM) == self._record_signal and _is_compiling():
            _raise_stop(self.stop_exception())


@contextlib.contextmanager
def defer_stop_signals() -> Iterator[StopRequest]:
    """Defer stop signals to the end of the block; yield the request that records them."""
    stop = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    former = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    if former[signal.SIGINT] in (signal.SIG_IGN, None):  # as for background jobs of a shell script
        del former[signal.SIGINT]
    if former[signal.SIGTERM] is not _terminate:
        del former[signal.SIGTERM]
    try:
        for number in former:
            signal.signal(number, stop._record_signal)
        yield stop
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)
        if stop.is_requested:
            # The stop also replaces an error that ends the block, since a handler of that error would lose
            # the stop.
            raise stop.stop_exception()


def _raise_stop(error: KeyboardInterrupt) -> NoReturn:
    """Raise a stop exception; during a compilation, keep the exception in memory to avoid a crash."""
    if _is_compiling():
        # After an interrupted compilation an LLVM object may have two owners. Freeing it with the frames
        # of the error caused a segmentation fault in one command of twenty, so the error is never freed.
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(error))
    raise error


def _is_compiling() -> bool:
    """Return True if this thread is compiling, that is, if it holds the lock of Numba's compiler."""
    module = sys.modules.get("numba.core.compiler_lock")
    return module is not None and module.global_compiler_lock.is_locked()


@contextlib.contextmanager
def handle_sigterm(*, last: bool = False) -> Iterator[None]:
    """Raise `Terminated` for SIGTERM while the block runs.

    If ``last`` is True, Ctrl-C and SIGTERM are ignored after the block. The process is then shutting down,
    which takes a second or more with JAX, and a signal would change the exit status of a finished command.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # Python drops exceptions in destructors and in callbacks of the garbage collector. A stop that is lost
    # there is repeated, at the latest at the end of the block.
    repeats: dict[threading.Timer, type[KeyboardInterrupt]] = {}

    def repeat(dropped: UnraisableHookArgs) -> None:
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(dropped)
            return
        stop = dropped.exc_type
        while True:
            timer: threading.Timer | None = None
            try:
                number = signal.SIGTERM if issubclass(stop, Terminated) else signal.SIGINT
                timer = threading.Timer(AGAIN, _thread.interrupt_main, (number,))
                repeats[timer] = stop
                timer.start()
            except KeyboardInterrupt as other:
                # On a busy machine the repeated stop arrives before the timer has started; it may also be a
                # further signal. SIGTERM takes precedence over Ctrl-C.
                if isinstance(other, Terminated):
                    stop = Terminated
                if timer is not None:
                    timer.cancel()
                    repeats.pop(timer, None)
            else:
                return

    hook = sys.unraisablehook
    former = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    if former[signal.SIGINT] is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    if former[signal.SIGTERM] is not signal.SIG_IGN:
        signal.signal(signal.SIGTERM, _terminate)
    sys.unraisablehook = repeat
    try:
        yield
        for timer, stop in repeats.items():
            if timer.is_alive():
                raise stop
    finally:
        for number, handler in former.items():
            signal.signal(number, signal.SIG_IGN if last else handler)
        for timer in repeats:
            timer.cancel()
        sys.unraisablehook = hook


def _terminate(*_: object) -> None:
    _raise_stop(Terminated())


def _interrupt(*_: object) -> None:
    _raise_stop(KeyboardInterrupt())
