"""A study of many small dampers: overhead of a sweep, and its use of the cores."""

from __future__ import annotations

import os
import time
from typing import Any

from granular import simulate
from granular.run.trajectory import Trajectory
from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene
from granular.studies.sweep import sweep

GRAINS = 92

_SHAPE: dict[str, Any] = {
    "grains.count": GRAINS,
    "cell.width": "30 D",
    "piston.height": "10 D",
    "arrangement.height": "9.5 D",
    "protocol.release.duration": 1.0,
}


def small_damper() -> Scene:
    """Return the packaged damper at half its width and height, released for a second."""
    return load_scene("damper").replace(**_SHAPE)


def rest_height(run: Trajectory) -> dict[str, float]:
    """Return the final height of the piston [m], and its mean force [N]."""
    data = run.dataset
    return {
        "height": float(data["piston_height"].values[-1]),
        "force": float(data["piston_force"].values.mean()),
    }


def study_times(cases: int) -> list[dict[str, Any]]:
    """Return the wall time [s] of a sweep over masses and seeds, and of a single run.

    ``filled`` is the fraction of the processors' time that the runs alone would take.
    """
    scene = small_damper()
    grid: dict[str, list[Any]] = {
        "piston.mass": [1.6, 1.7, 1.8, 1.9],
        "arrangement.seed": list(range(1, cases // 4 + 1)),
    }
    simulate(scene, t_end=0.01, threads=1, progress=False)
    started = time.perf_counter()
    simulate(scene.replace(**{"piston.mass": 1.8}), threads=1, progress=False)
    alone = time.perf_counter() - started
    started = time.perf_counter()
    result = sweep(scene, grid=grid, measure=rest_height, progress=False)
    seconds = time.perf_counter() - started
    cores = os.cpu_count() or 1
    return [
        {
            "cases": len(result.cases),
            "grains": GRAINS,
            "cores": cores,
            "seconds": seconds,
            "run alone": alone,
            "filled": len(result.cases) * alone / (cores * seconds),
            "failed": len(result.failed),
        }
    ]
