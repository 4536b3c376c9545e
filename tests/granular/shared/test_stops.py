"""Ctrl-C and SIGTERM: immediate and deferred stops, none of which is lost."""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from types import SimpleNamespace

import pytest

from granular.commands.console import run_command_and_return_exit_code
from granular.shared.errors import Interrupted, Terminated
from granular.shared.stop_signals import AGAIN, defer_stop_signals, handle_sigterm

pytestmark = pytest.mark.usefixtures("interruptible")


@pytest.fixture(autouse=True)
def handlers(interruptible: None) -> Iterator[None]:
    """Restore the signal handlers after each test."""
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    yield
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


def wait() -> None:
    """Wait for a stop signal, at most a minute."""
    for _ in range(6000):
        time.sleep(0.01)


def stop_and_wait(number: int) -> None:
    os.kill(os.getpid(), number)
    wait()


def stop_in_a_callback(number: int, then: Callable[[], None] = wait) -> None:
    """Send a stop signal in a callback of the garbage collector, in which Python drops exceptions."""

    def swallow(*_: object) -> None:
        gc.callbacks.remove(swallow)
        os.kill(os.getpid(), number)
        for _ in range(1000):
            pass

    gc.callbacks.append(swallow)
    gc.collect()
    then()


def stop_while_a_class_is_made(number: int) -> None:
    """Send a stop signal in ``__set_name__``, whose exceptions Python 3.11 wraps in others, as in an
    import of JAX.
    """

    class Named:
        def __set_name__(self, owner: type, name: str) -> None:
            stop_and_wait(number)

    type("Holder", (), {"field": Named()})


@pytest.mark.parametrize("stopping", [stop_and_wait, stop_in_a_callback, stop_while_a_class_is_made])
@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
def test_a_command_stopped_by_a_signal_ends_with_one_line(
    stopping: Callable[[int], None], number: int, code: int, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_and_return_exit_code(lambda _: stopping(number), []) == code
    said = capsys.readouterr().err
    assert said.endswith(f"error: {word}\n")
    assert said.count("\n") == 1 or stopping is stop_in_a_callback


@pytest.mark.parametrize("link", ["__cause__", "__context__"])
@pytest.mark.parametrize(("stop", "code"), [(KeyboardInterrupt, 130), (Terminated, 143)])
def test_an_error_caused_by_an_interrupt_or_termination_ends_a_command_like_the_signal(
    stop: type[BaseException], code: int, link: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """JAX adds a cause to a stop exception, and libraries raise other errors while they handle it."""

    def linked(error: BaseException, cause: BaseException) -> BaseException:
        setattr(error, link, cause)
        return error

    for error in (
        linked(stop(), ValueError("where it was")),
        linked(RuntimeError("a class"), linked(stop(), ValueError("where it was"))),
        linked(OSError(5, "in the end"), linked(RuntimeError("a class"), stop())),
    ):

        def command(_: Sequence[str], error: BaseException = error) -> None:
            raise error

        assert run_command_and_return_exit_code(command, []) == code
        assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("path", "saved", "words"),
    [
        (None, "", ""),
        (
            "run",
            "",
            ": the results so far are in run; to continue, repeat the command, "
            "and add --resume if it is the command run",
        ),
        (None, "simulations are kept in out", ": simulations are kept in out"),
        ("out/runs/1", "simulations are kept in out", ": simulations are kept in out"),
    ],
)
@pytest.mark.parametrize("terminated", [False, True])
def test_message_of_a_stopped_command_reports_only_stored_results(
    path: str | None, saved: str, words: str, terminated: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """A report stores parts that are not listed in the exception of its interrupted simulation."""

    def command(_: Sequence[str]) -> None:
        stop = Interrupted(SimpleNamespace(path=path), terminated)
        stop.saved = saved  # type: ignore[attr-defined]
        raise stop

    assert run_command_and_return_exit_code(command, []) == (143 if terminated else 130)
    assert capsys.readouterr().err == f"error: {'terminated' if terminated else 'interrupted'}{words}\n"


def test_a_stop_signal_dropped_in_a_callback_still_ends_the_command() -> None:
    """The stop is repeated before the command ends, not during the shutdown of the interpreter."""
    assert (
        run_command_and_return_exit_code(lambda _: stop_in_a_callback(signal.SIGINT, then=lambda: None), [])
        == 130
    )
    time.sleep(3 * AGAIN)


def test_a_lost_stop_is_repeated_although_the_timer_of_its_repetition_fires_at_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a busy computer the start of the timer's thread can take longer than the timer's 0.05 s."""

    class LateTimer(threading.Timer):
        late = True

        def start(self) -> None:
            super().start()
            if LateTimer.late:
                LateTimer.late = False
                self.join()

    monkeypatch.setattr(threading, "Timer", LateTimer)
    assert run_command_and_return_exit_code(lambda _: stop_in_a_callback(signal.SIGTERM), []) == 143
    assert capsys.readouterr().err == "error: terminated\n"


@pytest.mark.parametrize("method", ["__init__", "start"])
def test_sigterm_that_arrives_while_a_dropped_ctrl_c_is_repeated_terminates_the_command(
    method: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    signals = [signal.SIGTERM]
    former = getattr(threading.Timer, method)

    def with_signal(timer: threading.Timer, *arguments: object) -> None:
        former(timer, *arguments)
        if signals:
            os.kill(os.getpid(), signals.pop())

    monkeypatch.setattr(threading.Timer, method, with_signal)
    assert run_command_and_return_exit_code(lambda _: stop_in_a_callback(signal.SIGINT), []) == 143
    assert capsys.readouterr().err == "error: terminated\n"


def stopped(number: int, seen: list[bool], error: Exception | None = None) -> None:
    """Send a stop signal within a block that defers it, and end the block normally or by an error."""
    with defer_stop_signals() as stop:
        seen.append(stop.is_requested)
        os.kill(os.getpid(), number)
        seen.append(stop.is_requested)
        if error is not None:
            raise error


def test_a_deferred_stop_is_raised_at_the_end_of_the_block() -> None:
    seen: list[bool] = []
    with pytest.raises(KeyboardInterrupt) as caught:
        stopped(signal.SIGINT, seen)
    assert caught.type is KeyboardInterrupt
    with pytest.raises(Terminated), handle_sigterm():
        stopped(signal.SIGTERM, seen)
    assert seen == [False, True, False, True]


def test_a_deferred_stop_is_raised_instead_of_an_error_of_the_block() -> None:
    """A program that ignores the error therefore still stops."""
    failure = ValueError("something else")
    with pytest.raises(KeyboardInterrupt) as caught:
        stopped(signal.SIGINT, [], failure)
    assert caught.value.__context__ is failure


def test_functions_of_the_library_do_not_change_the_handling_of_sigterm() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with defer_stop_signals():
        assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_was_ignored_at_the_start_stays_ignored(number: int) -> None:
    """Examples are Ctrl-C in background jobs of shell scripts, under nohup, and in some CI systems."""

    def command(_: Sequence[str]) -> None:
        with defer_stop_signals() as stop:
            os.kill(os.getpid(), number)
            assert not stop.is_requested
        os.kill(os.getpid(), number)

    before = signal.signal(number, signal.SIG_IGN)
    try:
        assert run_command_and_return_exit_code(command, []) == 0
        assert signal.getsignal(number) is signal.SIG_IGN
    finally:
        signal.signal(number, before)


ENDING = """
import atexit, os, sys
from granular.commands.console import run_command_and_return_exit_code
atexit.register(lambda: [os.kill(os.getpid(), number) for number in (2, 15)])
sys.exit(run_command_and_return_exit_code(lambda _: print("done")))
"""


def test_a_stop_signal_after_the_end_of_a_command_changes_nothing() -> None:
    """With JAX imported, the process takes another second to end."""
    done = subprocess.run([sys.executable, "-c", ENDING], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")


def test_threads_other_than_the_main_one_do_not_handle_signals() -> None:
    seen = []

    def other() -> None:
        with handle_sigterm(), defer_stop_signals() as stop:
            seen.append(stop.is_requested)

    thread = threading.Thread(target=other)
    thread.start()
    thread.join()
    assert seen == [False]
