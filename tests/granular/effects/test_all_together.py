"""All effects that can act together, a user's own among them, in one compiled loop."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from granular import evaluate, load_trajectory
from granular.run.run_directory import is_run_directory
from granular.scene.scene import Scene
from granular.user_code import import_user_code

ROOT = Path(__file__).parents[3]

OWN = '''
import math

from granular import effect, load_scene, quantity


@effect
class Pull:
    """A spring that swings in time."""

    k: float = quantity("N/m", default=1.0)

    @staticmethod
    def energy(p, grain, time):
        return 0.5 * p.k * (1.0 + 0.1 * math.sin(time)) * grain.y**2

    @staticmethod
    def force(p, grain, time):
        return 0.0, -p.k * (1.0 + 0.1 * math.sin(time)) * grain.y

    @staticmethod
    def power(p, grain, time):
        return 0.05 * p.k * math.cos(time) * grain.y**2

    @staticmethod
    def stiffness(p, grain, time):
        return 1.1 * p.k


@effect
class Haze:
    """A drag of its own."""

    rate: float = quantity("1/s", default=5.0)

    @staticmethod
    def flow(p, grain, vx, vy, span):
        left = math.exp(-p.rate * span)
        return left * vx, left * vy


SCENE = load_scene("bed").replace(**{
    "grains.count": 300,
    "grains.species": [
        {"name": "big", "diameter": "6 mm", "share": 0.6},
        {"name": "small", "diameter": "4 mm", "share": 0.4, "remanence": "1 T"},
    ],
    "grains.spread": 0.05,
    "cell.width": "50 D", "piston.height": "22 D", "arrangement.height": "21 D",
    "effects.contact": {"modulus": "1 MPa"},
    "effects.shaking": {"amplitude": "0.2 mm", "frequency": "20 Hz"},
    "effects.eddy": {"conductivity": "5 MS/m", "thickness": "1 mm", "distance": "4 mm"},
    "effects.gradient": {"x": "0.02 T/m", "y": "-0.05 T/m"},
    "effects.wall_friction": {"coefficient": 0.2},
    "effects.field": [{"energy": "a*sin(x/l)*cos(w*t)", "a": "5 uJ", "l": "1 cm", "w": "60 1/s"}],
    "effects.pair_law": [{"energy": "a*exp(-r/l)", "a": "10 uJ", "l": "2 mm", "reach": "5 D"}],
    "effects.pull": True, "effects.haze": True,
    "effects.walls.left": {"energy": "a*(l/w)**3", "a": "0.5 mJ", "l": "6 mm"},
    "output": {"scalars": "1 ms", "frames": "10 ms"},
})
'''

PROGRAM = """
import os, signal, sys, warnings
import granular.run.simulation as simulation
from granular import simulate
from granular.user_code import import_user_code
from granular.shared.user_file import run_user_file, user_definitions
warnings.simplefilter("ignore")
file, out, threads, kill = sys.argv[1:]
import_user_code([file])
simulation.COMMIT_SECONDS = 0.0
store = simulation.RunDirectoryWriter
commits = 0
def commit(self, kept, former=store.replace_checkpoint):
    global commits
    former(self, kept)
    commits += 1
    if kill == "kill" and commits == 4:
        os.kill(os.getpid(), signal.SIGKILL)
store.replace_checkpoint = commit
simulate(contents(read_user_file(file))["SCENE"], t_end=0.1, progress=False, out=out, resume=True,
         threads=int(threads))
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("own") / "own.py"
    path.write_text(OWN, encoding="utf-8")
    return path


def carry_out(file: Path, out: Path, threads: int, *, kill: bool = False) -> int:
    told = "kill" if kill else "go"
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, str(file), str(out), str(threads), told],
        cwd=ROOT,
        env=os.environ,
        check=False,
    ).returncode


@pytest.mark.long
def test_a_killed_run_goes_on_with_the_same_bits_on_any_threads(file: Path, tmp_path: Path) -> None:
    assert carry_out(file, tmp_path / "killed", 1, kill=True) == -signal.SIGKILL
    assert is_run_directory(tmp_path / "killed")
    assert carry_out(file, tmp_path / "killed", 1) == 0
    assert carry_out(file, tmp_path / "whole", 1) == 0
    assert carry_out(file, tmp_path / "threads", 2) == 0
    import_user_code([file])
    runs = [load_trajectory(tmp_path / name) for name in ("killed", "whole", "threads")]
    for name in ("position", "velocity", "field_energy", "pull_energy", "haze_loss", "work"):
        for other in runs[1:]:
            np.testing.assert_array_equal(
                runs[0].dataset[name].values, other.dataset[name].values, strict=True
            )
    assert runs[0].settings()["ledger_residual"] < 1e-4


@pytest.mark.long
def test_the_force_of_all_is_minus_the_gradient(file: Path) -> None:
    from granular.shared.user_file import run_user_file, user_definitions

    scene: Scene = user_definitions(run_user_file(file))["SCENE"]
    place = scene.initial_positions_and_velocities()[0]
    direction = np.random.default_rng(2).normal(size=place.shape)
    h = 1e-6

    def energy(steps: float) -> float:
        return evaluate(scene, place + steps * h * direction).potential_energy

    slope = (8.0 * (energy(1) - energy(-1)) - (energy(2) - energy(-2))) / (12.0 * h)
    force = evaluate(scene, place).force
    size = float(np.abs(force * direction).sum())
    assert abs(float((force * direction).sum()) + slope) < 1e-7 * size
