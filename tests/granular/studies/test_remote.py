"""Executors on other machines, which go away."""

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor
from pathlib import Path
from typing import Any

import pytest

from granular import load_scene, sweep
from granular.studies.cases import CaseOutcome
from granular.studies.executors import DaskClusterExecutor, ExecutorLostError, cluster_executor
from tests.granular.studies.conftest import write_study

ROOT = Path(__file__).parents[3]


class There:
    """A task of a client, as Dask has it."""

    def __init__(self, result: Callable[[], Any]) -> None:
        self.result = result

    def add_done_callback(self, called: Callable[["There"], None]) -> None:
        called(self)


class Client:
    """A Dask client whose scheduler is gone after some tasks, and is back after some looks."""

    def __init__(self, tasks: int, back_after: float) -> None:
        self.tasks, self.back_after = tasks, back_after

    @property
    def status(self) -> str:
        if self.tasks > 0:
            return "running"
        self.back_after -= 1
        if self.back_after == 0:
            self.tasks = 1000
        return "closed" if self.back_after > 3 else "connecting"

    def submit(self, _: Callable[..., Any], case: Any, *__: Any, **___: Any) -> There:
        self.tasks -= 1

        def result() -> dict[str, Any]:
            if self.tasks <= 0:
                raise OSError("the stream is closed")
            return CaseOutcome({"seed": case.scene.arrangement.seed})

        return There(result)


def test_a_scheduler_that_is_gone_ends_a_sweep_in_words(tmp_path: Path) -> None:
    arguments: dict[str, Any] = {"out": tmp_path, "progress": False}
    grid = {"arrangement.seed": range(1, 9)}
    with pytest.raises(ExecutorLostError, match="scheduler is gone; start it again"):
        sweep(load_scene("bed"), grid, executor=DaskClusterExecutor(Client(3, float("inf"))), **arguments)
    again = sweep(load_scene("bed"), grid, executor=DaskClusterExecutor(Client(100, 0)), **arguments)
    assert [one.figures["seed"] for one in again.outcomes] == list(range(1, 9))


def test_a_scheduler_that_comes_back_is_waited_for() -> None:
    pool: Executor = DaskClusterExecutor(Client(3, 3))
    grid = {"arrangement.seed": range(1, 9)}
    study = sweep(load_scene("bed"), grid, executor=pool, progress=False)
    assert [one.figures["seed"] for one in study.outcomes] == list(range(1, 9))


def test_a_task_that_was_under_way_is_lost() -> None:
    case = sweep_case()
    with pytest.raises(BrokenExecutor, match="scheduler was lost"):
        DaskClusterExecutor(Client(1, float("inf"))).submit(print, case).result()


def sweep_case() -> Any:
    class Case:
        scene = load_scene("bed")

    return Case


def test_executors_exclude_each_other() -> None:
    with pytest.raises(ValueError, match="give one of them"), cluster_executor("tcp://here", True):
        raise AssertionError


@pytest.fixture
def scheduler() -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A Dask scheduler of its own process, with two workers."""
    pytest.importorskip("distributed")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": ROOT}
    first, workers = (
        subprocess.Popen([sys.executable, "-m", *f"distributed.cli.{words} --no-dashboard".split()], **quiet)
        for words in (
            f"dask_scheduler --host 127.0.0.1 --port {port}",
            f"dask_worker {address} --nworkers 2 --nthreads 1 --death-timeout 60",
        )
    )
    for _ in range(300):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                break
        time.sleep(0.2)
    yield address, first
    for process in (workers, first):
        process.terminate()
        process.wait()


def started(tmp_path: Path, address: str) -> subprocess.Popen[str]:
    """A sweep of forty cases on the cluster, some of which are done."""
    study = write_study(tmp_path, 1000)
    words = f"-m granular sweep {study} -o {tmp_path / 'out'} --quiet --dask {address}"
    process = subprocess.Popen([sys.executable, *words.split()], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 120.0
    while len(list(tmp_path.glob("out/cases/[!.]*.json"))) < 5 and time.monotonic() < until:
        time.sleep(0.1)
    return process


@pytest.mark.long
def test_a_dask_scheduler_is_killed(tmp_path: Path, scheduler: tuple[str, subprocess.Popen[bytes]]) -> None:
    process = started(tmp_path, scheduler[0])
    scheduler[1].kill()
    _, told = process.communicate(timeout=60)
    assert told == "error: the Dask scheduler is gone; start it again, and the same command goes on\n"
    assert process.returncode == 1
    assert len(list(tmp_path.glob("out/cases/[!.]*.json"))) >= 5


@pytest.mark.long
@pytest.mark.usefixtures("interruptible")
def test_a_sweep_on_dask_is_interrupted(
    tmp_path: Path, scheduler: tuple[str, subprocess.Popen[bytes]]
) -> None:
    process = started(tmp_path, scheduler[0])
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    assert told == "error: interrupted\n"
    assert process.returncode == 130
