"""Interrupted sweeps give the same final table. No case is computed twice, and no process remains."""

import contextlib
import errno
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pandas
import pytest

import granular.run.simulation
import granular.shared.files
from granular import Trajectory, sweep
from granular.shared.errors import StoreError
from granular.studies.cases import CaseOutcome, keep_measure_name, last_values
from granular.studies.sweep import Study, load_study
from tests.granular.studies.conftest import falling, write_study
from tests.processes import living

ROOT = Path(__file__).parents[3]

LEFT_SECONDS = 10.0
"""Time within which all processes of a killed sweep must end [s]."""

ACCELERATIONS = [1.0, 2.0, 3.0, 4.0, 5.0]


def swept_area(executor: Executor, out: Path | None, **more: Any) -> Study:
    grid = {"effects.gravity.acceleration": more.pop("values", ACCELERATIONS)}
    return sweep(falling(), grid, dt=1e-4, out=out, executor=executor, progress=False, **more)


@pytest.fixture(scope="module")
def integer(thread_executor: Executor) -> pandas.DataFrame:
    """Return the table of an uninterrupted sweep."""
    return swept_area(thread_executor, None).table


def assert_same_table(found: pandas.DataFrame, expected: pandas.DataFrame) -> None:
    pandas.testing.assert_frame_equal(found, expected, check_exact=True)


def kept(out: Path) -> list[str]:
    return sorted(one.name for one in (out / "cases").iterdir())


class Failing:
    """A function whose first calls fail and whose later calls succeed."""

    def __init__(self, function: Callable[..., Any], error: BaseException, times: float) -> None:
        self.function, self.error, self.times, self.calls = function, error, times, 0

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        self.calls += 1
        if self.calls <= self.times:
            raise self.error
        return self.function(*arguments, **keywords)


OF_THE_MACHINE = [
    OSError(errno.ENOSPC, "No space left on device"),
    StoreError("the run cannot be written"),
    MemoryError("1 TB"),
]


@pytest.mark.parametrize("error", OF_THE_MACHINE, ids=lambda error: type(error).__name__)
def test_cases_that_fail_because_of_the_computer_are_retried_and_the_errors_are_not_stored(
    tmp_path: Path,
    thread_executor: Executor,
    integer: pandas.DataFrame,
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
) -> None:
    simulate = granular.run.simulation.simulate
    monkeypatch.setattr(granular.run.simulation, "simulate", Failing(simulate, error, 5))
    assert_same_table(swept_area(thread_executor, tmp_path / "once").table, integer)

    always = Failing(simulate, error, float("inf"))
    monkeypatch.setattr(granular.run.simulation, "simulate", always)
    study = swept_area(thread_executor, tmp_path / "always")
    assert always.calls == 2 * len(ACCELERATIONS)
    assert study.unfinished == study.failed == study.cases
    assert kept(tmp_path / "always") == []

    monkeypatch.setattr(granular.run.simulation, "simulate", simulate)
    again = swept_area(thread_executor, tmp_path / "always")
    assert (again.reused, again.unfinished) == (0, ())
    assert_same_table(again.table, integer)


def test_an_outcome_that_cannot_be_written_is_written_later_without_computing_it_again(
    tmp_path: Path, thread_executor: Executor, integer: pandas.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The worker, the sweep and a final attempt may write it.

    If all of them fail, the case stays unfinished.
    """
    simulate = Failing(granular.run.simulation.simulate, OSError(), 0)
    monkeypatch.setattr(granular.run.simulation, "simulate", simulate)
    write, full = granular.shared.files.write_text, StoreError("no space left; free space")
    for times in (1, 5, 10, 12):
        out = tmp_path / str(times)
        monkeypatch.setattr(granular.shared.files, "write_text", Failing(write, full, times))
        simulate.calls = 0
        study = swept_area(thread_executor, out)
        assert simulate.calls == len(ACCELERATIONS)
        assert len(kept(out)) == len(ACCELERATIONS) - len(study.unfinished)
        assert len(study.unfinished) == max(0, times - 2 * len(ACCELERATIONS))
        assert "no space left" in study.outcomes[0].error if study.unfinished else True
        assert_same_table(swept_area(thread_executor, out).table, integer)
        assert simulate.calls == len(ACCELERATIONS) + len(study.unfinished)


def test_an_error_in_a_measure_is_reported_but_not_stored(tmp_path: Path, thread_executor: Executor) -> None:
    calls = []

    def faulty(run: Trajectory) -> dict[str, float]:
        calls.append(run)
        return {"a": 1.0 / (len(calls) > 1)}

    study = swept_area(thread_executor, tmp_path, measure=faulty, values=[1.0])
    assert study.outcomes[0].error == "ZeroDivisionError: float division by zero"
    assert len(calls) == len(study.unfinished) == 1
    assert swept_area(thread_executor, tmp_path, measure=faulty, values=[1.0]).outcomes[0].figures == {
        "a": 1.0
    }


def test_two_simultaneous_sweeps_into_one_directory_compute_each_case_only_once(tmp_path: Path) -> None:
    values = [1.0 + 0.1 * k for k in range(8)]
    calls: list[float] = []

    @keep_measure_name("counted")  # it modifies the list that it uses
    def counted(run: Trajectory) -> dict[str, Any]:
        assert run.scene.effects.gravity is not None
        calls.append(run.scene.effects.gravity.acceleration)
        return dict(last_values(run))

    with ThreadPoolExecutor(2) as first, ThreadPoolExecutor(2) as second:
        arguments: dict[str, Any] = {"measure": counted, "keep_runs": True, "values": values}
        with ThreadPoolExecutor(2) as both:
            studies = [both.submit(swept_area, pool, tmp_path, **arguments) for pool in (first, second)]
        tables = [study.result().table for study in studies]
        assert sorted(calls) == values
        assert len(kept(tmp_path)) == len(values)
        assert_same_table(*tables)
        assert_same_table(tables[0], swept_area(first, None, measure=counted, values=values).table)


def test_the_command_reports_cases_that_failed_because_of_the_computer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import granular.studies.sweep
    from granular.__main__ import main
    from granular.commands.console import run_command_and_return_exit_code

    study = write_study(tmp_path, 2)
    failed = CaseOutcome(error="OSError: no space left", cause="machine")
    sound = CaseOutcome({"height": 1.0})

    def computed(cases: Any, *_: Any) -> Iterator[Any]:
        yield from zip(cases, [sound, failed], strict=True)

    monkeypatch.setattr(granular.studies.sweep, "compute_outcomes_with_retries", computed)
    code = run_command_and_return_exit_code(
        main, ["sweep", str(study), "-o", str(tmp_path / "out"), "--quiet"]
    )
    told = capsys.readouterr()
    assert code == 1
    assert told.out.startswith("2 cases, 0 of them done before, 1 failed")
    assert told.err == (
        "error: 1 of 2 cases could not be computed, the first because of OSError: no space left; "
        "correct this, and repeat the command to compute them\n"
    )


def command(study: Path, out: Path, *more: str) -> list[str]:
    words = ["-m", "granular", "sweep", str(study), "-o", str(out), "--quiet", *more]
    return [sys.executable, *words]


def outcomes(out: Path) -> dict[str, float]:
    return {one.name: one.stat().st_mtime_ns for one in (out / "cases").glob("[!.]*.json")}


def wait_for(out: Path, count: int) -> None:
    for _ in range(6000):
        if (out / "cases").is_dir() and len(outcomes(out)) >= count:
            return
        time.sleep(0.02)
    raise AssertionError(f"{count} cases were not finished in two minutes")


needs_proc = pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds processes in /proc")


def end_left(group: int) -> None:
    """Assert that all processes of a group end by themselves."""
    until = time.monotonic() + LEFT_SECONDS
    while living(group) and time.monotonic() < until:
        time.sleep(0.1)
    assert living(group) == []


def cmdline(pid: int) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


START = """
import os, time
from granular.studies.executors import ProcessPool
workers = ProcessPool(1)
pid = workers.submit(os.getpid).result()
busy = [workers.submit(time.sleep, 600.0) for _ in range(2)]
print(pid, flush=True)
time.sleep(600.0)
"""


@needs_proc
def test_worker_processes_end_when_their_parent_is_killed() -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", START], cwd=ROOT, stdout=subprocess.PIPE, start_new_session=True
    )
    try:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        assert worker in living(parent.pid)
        parent.kill()
        parent.wait()
        end_left(parent.pid)
    finally:
        parent.kill()
        parent.communicate()


@pytest.mark.long
@needs_proc
def test_a_study_of_200_cases_gives_the_same_table_although_command_and_worker_are_killed(
    tmp_path: Path,
) -> None:
    """No case is computed twice."""
    study = write_study(tmp_path, 200)
    subprocess.run(command(study, tmp_path / "whole"), check=True, cwd=ROOT)
    out = tmp_path / "killed"
    process = subprocess.Popen(command(study, out), cwd=ROOT, start_new_session=True)
    wait_for(out, 40)
    process.kill()
    process.wait()
    end_left(process.pid)
    first = outcomes(out)
    assert 40 <= len(first) < 200
    process = subprocess.Popen(command(study, out), cwd=ROOT, start_new_session=True)
    wait_for(out, len(first) + 40)
    victims = [
        pid for pid in living(process.pid) if b"loky" in cmdline(pid) and b"tracker" not in cmdline(pid)
    ]
    os.kill(victims[-1], signal.SIGKILL)
    assert process.wait(timeout=300) == 0
    end_left(process.pid)
    after = outcomes(out)
    assert len(after) == 200
    assert all(after[name] == time for name, time in first.items())
    assert (out / "table.csv").read_bytes() == (tmp_path / "whole" / "table.csv").read_bytes()


@pytest.mark.long
def test_two_simultaneous_commands_on_one_directory_give_the_same_table(tmp_path: Path) -> None:
    """The table is the same as for a single command, and each run is stored once."""
    study = write_study(tmp_path, 60)
    subprocess.run(command(study, tmp_path / "alone"), check=True, cwd=ROOT)
    out = tmp_path / "shared"
    both = [
        subprocess.Popen(command(study, out, "--keep-runs", "--workers", "2"), cwd=ROOT) for _ in range(2)
    ]
    assert [one.wait(timeout=300) for one in both] == [0, 0]
    assert len(kept(out)) == len(list((out / "runs").iterdir())) == 60
    assert (out / "table.csv").read_bytes() == (tmp_path / "alone" / "table.csv").read_bytes()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Yield the folder of a disk of 16 MB."""
    place = tmp_path / "disk"
    place.mkdir()
    if not hasattr(os, "geteuid") or os.geteuid() != 0 or sys.platform != "linux":
        pytest.skip("only root may mount a disk")
    options = ["-t", "tmpfs", "-o", "size=16m", "tmpfs", str(place)]
    if subprocess.run(["mount", *options], capture_output=True, check=False).returncode:
        pytest.skip("no disk can be mounted here")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


@pytest.mark.long
@pytest.mark.parametrize("more", [(), ("--keep-runs",)], ids=["outcomes", "runs"])
def test_a_sweep_can_be_continued_after_space_is_freed_on_a_full_disk(
    tmp_path: Path, small_disk: Path, more: tuple[str, ...]
) -> None:
    study = write_study(tmp_path, 8)
    subprocess.run(command(study, tmp_path / "whole"), check=True, cwd=ROOT)
    out = small_disk / "out"
    (out / "cases").mkdir(parents=True)
    filler = small_disk / "filler"
    with filler.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))
    os.truncate(filler, filler.stat().st_size - 4096 * 3)  # room for some of the cases
    first = subprocess.run(command(study, out, *more), cwd=ROOT, capture_output=True, text=True, check=False)
    assert first.returncode in (1, 2)
    assert first.stderr.startswith("error: ")
    assert first.stderr.count("\n") == 1
    before = outcomes(out)
    assert len(before) < 8
    filler.unlink()
    subprocess.run(command(study, out, *more), check=True, cwd=ROOT)
    after = outcomes(out)
    assert len(after) == 8
    assert all(after[name] == time for name, time in before.items())
    assert (out / "table.csv").read_bytes() == (tmp_path / "whole" / "table.csv").read_bytes()


@pytest.mark.long
def test_a_sweep_gives_the_same_table_although_a_dask_worker_is_lost(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    study = load_study(write_study(tmp_path, 40))
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:

        def kill() -> None:
            wait_for(tmp_path / "dask", 8)
            os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        with distributed.Client(cluster) as client:
            found = sweep(
                **study, out=tmp_path / "dask", executor=client.get_executor(retries=2), progress=False
            )
        killer.join()
    integer = sweep(**study, workers=1, progress=False)
    assert_same_table(found.table, integer.table)
