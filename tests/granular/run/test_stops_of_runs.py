"""Ctrl-C and SIGTERM end single runs and loops of runs at any time."""

import gc
import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numba.core.compiler_lock import global_compiler_lock

import granular.run.engines
import granular.run.simulation
from granular import Scene, Trajectory, load_scene, simulate
from granular.shared.errors import Interrupted, RunError
from granular.shared.stop_signals import defer_stop_signals, handle_sigterm

pytestmark = pytest.mark.usefixtures("interruptible")

ROOT = Path(__file__).parents[3]
END = 0.02


@pytest.fixture(scope="module")
def scene() -> Scene:
    scene = load_scene("single-particle")
    simulate(scene, t_end=END, progress=False)  # compiled before signals come
    return scene


def short_runs(scene: Scene, folder: Path | None) -> Callable[[], None]:
    """Return a function that makes another short run, in memory or in a folder."""
    made = iter(range(10**6))

    def one() -> None:
        out = None if folder is None else folder / str(next(made))
        simulate(scene, t_end=END, out=out, progress=False)

    return one


def seconds_until_the_end(one: Callable[[], None], delay: float) -> float:
    """Return how long [s] a loop of runs continues after a delayed Ctrl-C, at most 5 s."""
    sent: list[float] = []

    def send() -> None:
        time.sleep(delay)
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    sender = threading.Thread(target=send)
    sender.start()
    try:
        while not sent or time.monotonic() - sent[0] < 5.0:
            one()
    except KeyboardInterrupt:
        sender.join()
        return time.monotonic() - sent[0]
    sender.join()
    return np.inf


@pytest.mark.parametrize("kept", ["memory", "disk"])
def test_ctrl_c_ends_a_loop_of_short_runs(
    scene: Scene, tmp_path: Path, random: np.random.Generator, kept: str
) -> None:
    one = short_runs(scene, tmp_path if kept == "disk" else None)
    for delay in random.uniform(0.0, 0.1, 5):
        assert seconds_until_the_end(one, delay) < 5.0


@pytest.mark.parametrize("kept", ["memory", "disk"])
def test_ctrl_c_after_the_last_step_returns_the_complete_run(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kept: str
) -> None:
    plain = granular.run.simulation.make_trajectory
    ends = "granular.run.trajectory.make_trajectory", "granular.run.simulation.make_trajectory"

    def finished(*known: object) -> Trajectory:
        os.kill(os.getpid(), signal.SIGINT)
        return plain(*known)  # type: ignore[arg-type]

    for end in ends:
        monkeypatch.setattr(end, finished)
    out = tmp_path / "run" if kept == "disk" else None
    with pytest.raises(Interrupted) as caught:
        simulate(scene, t_end=END, out=out, progress=False)
    monkeypatch.undo()
    run = caught.value.trajectory
    assert isinstance(run, Trajectory)
    assert run.complete
    assert run.dataset.equals(simulate(scene, t_end=END, progress=False).dataset)


@pytest.mark.parametrize("calls", [0, 1])
def test_a_run_whose_compilation_was_interrupted_by_a_stop_signal_can_be_resumed(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, calls: int
) -> None:
    """Compilation for a new set of effects takes up to a minute."""
    plain, made = granular.run.engines.advance_ticks, iter(range(100))

    def advance(*known: object) -> object:
        if next(made) == calls:
            with global_compiler_lock:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.01)
            pytest.fail("it was compiled to the end")
        return plain(*known)  # type: ignore[arg-type]

    monkeypatch.setattr("granular.run.engines.advance_ticks", advance)
    with pytest.raises(Interrupted) as caught, handle_sigterm():
        simulate(scene, t_end=END, out=tmp_path / "run", progress=False)
    monkeypatch.undo()
    assert not caught.value.trajectory.complete
    integer = simulate(scene, t_end=END, progress=False)
    resumed = simulate(scene, t_end=END, out=tmp_path / "run", resume=True, progress=False)
    assert resumed.dataset.equals(integer.dataset)
    assert resumed.complete


def test_objects_of_an_interrupted_compilation_are_not_freed() -> None:
    """After the interruption, an LLVM object may have two owners.

    If both freed it, the process would crash.
    """
    freed = []

    class Module:
        def __del__(self) -> None:
            freed.append(self)

    def compile_one() -> None:
        module = Module()
        with global_compiler_lock:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
        del module

    try:
        with handle_sigterm(), defer_stop_signals():
            compile_one()
    except KeyboardInterrupt:
        pass
    gc.collect()
    assert not freed


def test_a_stop_signal_during_a_failing_run_is_not_lost(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A loop that ignores the error of the failed run ends too."""
    from granular.run.protocol_runner import ProtocolRunner

    def advance(_: ProtocolRunner) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        raise RunError("it fails", step=0, time=0.0, remedy="try again")

    monkeypatch.setattr(ProtocolRunner, "advance", advance)
    with pytest.raises(KeyboardInterrupt):
        simulate(scene, t_end=END, progress=False)
