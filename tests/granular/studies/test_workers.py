"""Study cases run on any executor, local or remote, whose worker processes may die."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from granular import load_scene, sweep
from granular.run.trajectory import Trajectory
from granular.studies.cases import Case, CaseOutcome
from granular.studies.executors import (
    DaskClusterExecutor,
    ExecutorLostError,
    connect_to_cluster,
    given_executor_or_new_processes,
)
from granular.studies.sweep import ATTEMPTS, BackgroundCaseRunner
from tests.granular.studies.conftest import write_study

ROOT = Path(__file__).parents[3]


class Mortal(Executor):
    """An executor whose worker is killed by some cases; cases submitted at the same time are lost too."""

    def __init__(self, killers: dict[int, float]) -> None:
        self.killers, self.dead = killers, False
        self.runs: list[int] = []

    def submit(self, _: Callable[..., Any], case: Case, *__: Any) -> Future[Any]:
        seed, future = case.scene.arrangement.seed, Taken(self)
        if not self.dead:
            self.runs.append(seed)
            self.dead = self.killers.get(seed, 0) > 0
            if self.dead:
                self.killers[seed] -= 1
        if self.dead:
            future.set_exception(BrokenExecutor("the worker is gone"))
        else:
            future.set_result(CaseOutcome({"seed": seed}))
        return future


class Taken(Future[Any]):
    """A submitted case. Cancelling it gives later cases a new worker."""

    def __init__(self, executor: Mortal) -> None:
        super().__init__()
        self._executor = executor

    def cancel(self) -> bool:
        self._executor.dead = False
        return super().cancel()


SEEDS = range(1, 41)


def swept_area(executor: Mortal) -> dict[int, str | None]:
    """Run a sweep over seeds, and return the error of each seed or None."""
    study = sweep(load_scene("bed"), {"arrangement.seed": SEEDS}, executor=executor, progress=False)
    assert all(
        one.error or one.figures["seed"] == seed for seed, one in zip(SEEDS, study.outcomes, strict=True)
    )
    return {seed: one.error for seed, one in zip(SEEDS, study.outcomes, strict=True)}


@pytest.mark.parametrize("times", [1, ATTEMPTS - 1])
def test_no_case_is_lost_if_worker_processes_are_killed_from_outside(times: int) -> None:
    assert set(swept_area(Mortal({3: times, 20: 1})).values()) == {None}


@pytest.mark.parametrize("killers", [(1,), (3,), (40,), (1, 2), (3, 20, 21, 40)])
def test_cases_that_kill_their_workers_do_not_affect_other_cases(killers: tuple[int, ...]) -> None:
    executor = Mortal(dict.fromkeys(killers, float("inf")))
    errors = swept_area(executor)
    for seed, error in errors.items():
        assert error == (f"the worker died {ATTEMPTS} times" if seed in killers else None)
    for seed in SEEDS:
        assert executor.runs.count(seed) == (ATTEMPTS if seed in killers else 1)


def test_a_permanently_broken_executor_ends_the_study() -> None:
    class Broken(Mortal):
        def submit(self, function: Callable[..., Any], case: Case, *more: Any) -> Future[Any]:
            if len(self.runs) == 20:
                raise BrokenExecutor("for good")
            return super().submit(function, case, *more)

    errors = list(swept_area(Broken({})).values())
    assert errors[:20] == [None] * 20
    assert set(errors[20:]) == {f"the worker died {ATTEMPTS} times"}


def test_a_given_executor_is_not_shut_down() -> None:
    with ThreadPoolExecutor(1) as pool:
        with given_executor_or_new_processes(pool) as inside:
            assert inside is pool
        assert pool.submit(int, "3").result() == 3


def dies() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_worker_processes_that_die_are_replaced() -> None:
    with given_executor_or_new_processes(None, 1) as workers:
        first = workers.submit(os.getpid).result()
        assert workers.submit(os.getpid).result() == first != os.getpid()
        with pytest.raises(BrokenExecutor):
            workers.submit(dies).result()
        second = workers.submit(os.getpid).result()
        assert second != first
    with pytest.raises(ProcessLookupError):
        os.kill(second, 0)


INTERRUPTED = """
import os, signal, threading
from granular import load_scene, sweep
long = [{"kind": "hold", "name": "fall", "duration": 1e3}]
scene = load_scene("single-particle").replace(protocol=long)
values = {"effects.gravity.acceleration": [float(k) for k in range(1, 41)]}
threading.Timer(1.0, os.kill, [os.getpid(), signal.SIGINT]).start()
sweep(scene, values, dt=1e-6, workers=1, progress=False)
"""


@pytest.mark.usefixtures("interruptible")
def test_a_sweep_interrupted_with_many_waiting_cases_ends_without_tracebacks_of_its_workers() -> None:
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert "KeyboardInterrupt" in done.stderr
    assert "executor manager" not in done.stderr


def step_and_process(run: Trajectory) -> Mapping[str, float]:
    return {"dt": run.settings()["dt"], "process": os.getpid()}


def test_a_process_that_waits_for_background_cases_computes_some_of_them_itself() -> None:
    steps = [1e-3 / parts for parts in range(1, 13)]
    settings = {"dt": 1e-3, "t_end": 1e-2, "method": "stormer-verlet"}
    with BackgroundCaseRunner(step_and_process, None) as background:
        cases = [{"dt": step} for step in steps]
        started = background.submit_cases(load_scene("single-particle"), cases, settings)
        outcomes = background.wait_for_outcomes(started, "cases", False)
    assert [outcome.error for outcome in outcomes] == [None] * len(steps)
    assert [outcome.figures["dt"] for outcome in outcomes] == steps
    assert outcomes[-1].figures["process"] == os.getpid() != outcomes[0].figures["process"]


class There:
    """Substitute for a task of a Dask client."""

    def __init__(self, result: Callable[[], Any]) -> None:
        self.result = result

    def add_done_callback(self, called: Callable[["There"], None]) -> None:
        called(self)


class Client:
    """Substitute for a Dask client whose scheduler is lost after given numbers of tasks and returns after
    given numbers of status checks.
    """

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


def test_a_lost_scheduler_ends_a_sweep_with_an_error_message(tmp_path: Path) -> None:
    arguments: dict[str, Any] = {"out": tmp_path, "progress": False}
    grid = {"arrangement.seed": range(1, 9)}
    with pytest.raises(ExecutorLostError, match="scheduler is gone; restart it"):
        sweep(load_scene("bed"), grid, executor=DaskClusterExecutor(Client(3, float("inf"))), **arguments)
    again = sweep(load_scene("bed"), grid, executor=DaskClusterExecutor(Client(100, 0)), **arguments)
    assert [one.figures["seed"] for one in again.outcomes] == list(range(1, 9))


def test_a_sweep_waits_for_a_scheduler_that_returns() -> None:
    pool: Executor = DaskClusterExecutor(Client(3, 3))
    grid = {"arrangement.seed": range(1, 9)}
    study = sweep(load_scene("bed"), grid, executor=pool, progress=False)
    assert [one.figures["seed"] for one in study.outcomes] == list(range(1, 9))


def test_a_running_task_fails_if_the_scheduler_is_lost() -> None:
    case = sweep_case()
    with pytest.raises(BrokenExecutor, match="scheduler was lost"):
        DaskClusterExecutor(Client(1, float("inf"))).submit(print, case).result()


def sweep_case() -> Any:
    class Case:
        scene = load_scene("bed")

    return Case


def test_a_sweep_refuses_two_kinds_of_executor() -> None:
    with pytest.raises(ValueError, match="use one of them"), connect_to_cluster("tcp://here", True):
        raise AssertionError


@pytest.fixture
def scheduler() -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Yield the address of a Dask scheduler in a separate process, with two workers."""
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
    """Start a sweep on the cluster, and return its process once five cases are finished."""
    study = write_study(tmp_path, 1000)
    words = f"-m granular sweep {study} -o {tmp_path / 'out'} --quiet --dask {address}"
    process = subprocess.Popen([sys.executable, *words.split()], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 120.0
    while len(list(tmp_path.glob("out/cases/[!.]*.json"))) < 5 and time.monotonic() < until:
        time.sleep(0.1)
    return process


@pytest.mark.long
def test_the_command_reports_a_killed_dask_scheduler(
    tmp_path: Path, scheduler: tuple[str, subprocess.Popen[bytes]]
) -> None:
    process = started(tmp_path, scheduler[0])
    scheduler[1].kill()
    _, told = process.communicate(timeout=60)
    assert (
        told == "error: the Dask scheduler is gone; restart it, then run the same command again to continue\n"
    )
    assert process.returncode == 1
    assert len(list(tmp_path.glob("out/cases/[!.]*.json"))) >= 5


@pytest.mark.long
@pytest.mark.usefixtures("interruptible")
def test_a_sweep_on_dask_can_be_interrupted(
    tmp_path: Path, scheduler: tuple[str, subprocess.Popen[bytes]]
) -> None:
    process = started(tmp_path, scheduler[0])
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    assert told == "error: interrupted\n"
    assert process.returncode == 130
