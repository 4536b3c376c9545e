"""A made-up run: random motion, two species, a grain that leaves, no simulation needed."""

from __future__ import annotations

import numpy as np
import pytest
import xarray

from granular import Scene
from granular.run.trajectory import Trajectory, make_trajectory

FRAMES, COUNT = 90, 7


@pytest.fixture(scope="session")
def mixture(small_bed: Scene) -> Scene:
    """Seven grains of two species, held for a second and compressed for two."""
    return small_bed.replace(
        **{
            "grains.count": COUNT,
            "grains.species": [
                {"name": "big", "diameter": "5 mm", "share": 0.6},
                {"name": "two words, 100 %", "diameter": "3 mm", "share": 0.4},
            ],
            "protocol": [
                {"kind": "hold", "name": "relax", "duration": 1.0},
                {"kind": "move", "name": "compress", "to": "20 mm", "speed": "5 mm/s"},
            ],
        }
    )


@pytest.fixture(scope="session")
def run(mixture: Scene) -> Trajectory:
    """Frames every 250 steps of the source from 0 s; the last grain leaves after 40 frames."""
    random = np.random.default_rng(7)
    height = 0.03
    every = 2.5e-4 * 2.0
    shape = (FRAMES, COUNT, 2)
    place = random.uniform(0.0, 1.0, shape) * [mixture.cell.width, height]
    fields = {
        "position": place,
        "velocity": random.normal(0.0, 0.1, shape),
        "force": random.normal(0.0, 0.3, shape),
    }
    for field in fields.values():
        field[40:, -1] = np.nan
    time = np.arange(10 * FRAMES) * every / 10.0
    data = xarray.Dataset(
        {name: (("frame", "grain", "axis"), field) for name, field in fields.items()}
        | {
            "frame_time": ("frame", np.arange(FRAMES) * every),
            "frame_height": ("frame", np.linspace(height, 0.02, FRAMES)),
            "piston_height": ("time", np.linspace(height, 0.02, 10 * FRAMES)),
            "piston_force": ("time", np.linspace(1.0, 2.0, 10 * FRAMES)),
            "stage": ("time", np.zeros(10 * FRAMES, dtype=int)),
        },
        coords={"time": time},
    )
    stages = [
        {"name": "relax", "start": 0.0, "end": 1.0, "reason": "duration", "height": height, "spread": 0.0},
        {"name": "compress", "start": 1.0, "end": 3.0, "reason": "duration", "height": 0.02, "spread": 0.0},
    ]
    outcome = {"stages": stages, "complete": True, "figures": {}}
    return make_trajectory(
        mixture.replace(**{"piston.height": height}), data, {"method": "none"}, outcome, None
    )
