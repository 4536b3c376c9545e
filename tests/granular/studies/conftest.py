"""Study cases that take milliseconds, and a thread executor in this process."""

from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path

import pytest

from granular import Scene, load_scene


def falling(duration: float = 0.01) -> Scene:
    """Return a scene of one grain that falls without walls."""
    return load_scene("single-particle").replace(
        **{
            "effects.walls": None,
            "effects.dipole": None,
            "effects.drag": None,
            "protocol": [{"kind": "hold", "name": "fall", "duration": duration}],
            "output.scalars": 1e-3,
            "output.frames": 1e-2,
        }
    )


def write_study(path: Path, cases: int) -> Path:
    """Write a study of short runs with different results, and return its path."""
    falling(0.02).save(path / "fall.toml")
    values = ", ".join(f"{1.0 + 0.01 * k}" for k in range(cases))
    (path / "study.toml").write_text(
        f'scene = "fall.toml"\ndt = 1e-6\n[grid]\n"effects.gravity.acceleration" = [{values}]\n'
    )
    return path / "study.toml"


@pytest.fixture(scope="module")
def thread_executor() -> Iterator[Executor]:
    """Yield a thread executor, for tests in which it does not matter which process computes a case."""
    with ThreadPoolExecutor(1) as pool:
        yield pool
