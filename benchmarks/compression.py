"""The published compression of 368 grains, from start to end [D, 2.3, 3.4]."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from granular import mono_bed, simulate
from granular.observables import depaula_pair_distance
from granular.run.trajectory import Trajectory

SPEED = 8.33e-3
"""Speed of the piston [m/s]: T = stroke/speed = 39.6 s; the protocol takes eight T."""

PUBLISHED = {"force": 15.26, "half distance": 10.90}
"""Force on the piston [N] and half of the mean distance [D] at full compression [D, Table 3.2]."""


FAR_EVERY = (1, 8)
"""Steps between successive sums over the far pairs."""


def compression(seed: int, speed: float = SPEED) -> list[dict[str, Any]]:
    """Run relaxation 5 T, compression, expansion, relaxation; return wall time [s] and results.

    Runs use the automatic step, with far pairs at every step and at every eighth.

    ``python -m benchmarks --part protocol`` is the command. At a ``speed`` above the
    published one the bed has less time to settle.
    """
    return [_compressed(seed, speed, every) for every in FAR_EVERY]


def _compressed(seed: int, speed: float, every: int) -> dict[str, Any]:
    scene = mono_bed(368, speed=speed, seed=seed).replace(**{"pairs.far_every": every})
    simulate(scene, t_end=0.01, progress=False)
    started = time.perf_counter()
    run = simulate(scene, progress=False)
    seconds = time.perf_counter() - started
    return {
        "seed": seed,
        "speed": speed,
        "far every": every,
        "seconds": seconds,
        "simulated": run.stages[-1].end,
        "steps": run.settings()["steps"],
        "ledger": run.settings()["ledger_residual"],
        **_at_full_compression(run),
    }


def _at_full_compression(run: Trajectory) -> dict[str, float]:
    end, data = run.stage("compress").end, run.dataset
    last = int(np.flatnonzero(data["time"].values <= end + 1e-9)[-1])
    frame = int(np.abs(data["frame_time"].values - end).argmin())
    distance = depaula_pair_distance(data["position"].values[frame])
    return {
        "force": float(data["piston_force"].values[last]),
        "half distance": float(distance / run.scene.grains.species[0].diameter),
    }
