"""A run that is killed repeatedly at random times ends like an uninterrupted run."""

import multiprocessing
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

import granular.run.simulation
from granular import Scene, load_trajectory, simulate
from granular.run.run_directory import is_run_directory

KILLS = 100
STEP = 2e-6


def resume_run(scene: Scene, path: Path) -> None:
    granular.run.simulation.COMMIT_SECONDS = 0.02
    simulate(scene, STEP, out=path, resume=True, progress=False)


@pytest.mark.long  # it forks, which a process with threads of other tests must not
@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills forked processes")
def test_run_killed_a_hundred_times_equals_an_uninterrupted_run(
    small_bed: Scene, tmp_path: Path, random: np.random.Generator
) -> None:
    scene = small_bed.replace(
        **{
            "effects.friction": True,
            "protocol": [
                {"kind": "hold", "name": "settle", "duration": 0.5},
                {"kind": "move", "name": "press", "to": "4 D", "speed": 0.04},
                {"kind": "hold", "name": "rest", "duration": 0.3},
            ],
            "output.scalars": 1e-3,
            "output.frames": 5e-3,
        }
    )
    integer = simulate(scene, STEP, progress=False)
    simulate(scene, STEP, t_end=0.01, out=tmp_path / "first", progress=False)  # imports all
    started = time.perf_counter()
    simulate(scene, STEP, t_end=0.01, out=tmp_path / "second", progress=False)
    short = time.perf_counter() - started
    path = tmp_path / "run"
    fork = multiprocessing.get_context("fork")
    lengths = []
    for _ in range(KILLS):
        process = fork.Process(target=resume_run, args=(scene, path))
        process.start()
        time.sleep(random.uniform(0.0, 2.0 * short))
        assert process.pid is not None
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        if not lengths and not is_run_directory(path):
            continue  # killed before it had begun
        part = load_trajectory(path)
        lengths.append(part.dataset.sizes["time"])
        for name in part.dataset.data_vars:
            values = part.dataset[name].values
            assert np.array_equal(values, integer.dataset[name].values[: len(values)]), name
    assert 0 < lengths[len(lengths) // 2] < integer.dataset.sizes["time"]
    again = simulate(scene, STEP, out=path, resume=True, progress=False)
    assert again.complete
    assert again.dataset.equals(integer.dataset)
