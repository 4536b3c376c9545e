"""The bath: its random numbers, its temperature, its order, and bits that nothing changes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from granular import Scene, evaluate, load_trajectory, simulate
from granular.effects.langevin_bath import draw_normal_pair, philox_random_words
from granular.observables import configurational_temperature
from granular.run.run_directory import is_run_directory
from granular.shared.errors import InputError, SceneError

ROOT = Path(__file__).parents[3]
TEMPERATURE = 2e-6


def crystal(small_bed: Scene, **changes: object) -> Scene:
    return small_bed.replace(
        **{
            "effects": {
                "dipole": True,
                "walls": True,
                "bath": {"temperature": TEMPERATURE, "rate": "100 1/s"},
            },
            "protocol": [{"kind": "hold", "name": "rest", "duration": 100.0}],
            "output": {"scalars": "20 ms", "frames": "20 ms"},
            **changes,
        }
    )


def test_known_answers_of_the_generator() -> None:
    """Of Random123's file of known answers, for a counter and a key of zeros and of ones."""
    zero, ones = np.uint64(0), np.uint64(2**64 - 1)
    assert [int(one) for one in philox_random_words(zero, zero, zero)] == [
        0x6627E8D5,
        0xE169C58D,
        0xBC57AC4C,
        0x9B00DBD8,
    ]
    assert [int(one) for one in philox_random_words(ones, ones, ones)] == [
        0x408F276D,
        0x41C83B0E,
        0xA20BC7C6,
        0x6D5451FD,
    ]


def test_normal_numbers() -> None:
    steps, grains = np.divmod(np.arange(40_000, dtype=np.uint64), np.uint64(200))
    drawn = np.array([draw_normal_pair(np.uint64(7), s, g) for s, g in zip(steps, grains, strict=True)])
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=0.02)
    np.testing.assert_allclose(drawn.var(axis=0), 1.0, atol=0.03)
    np.testing.assert_allclose((drawn**4).mean(axis=0), 3.0, atol=0.2)
    assert abs(np.corrcoef(drawn.T)[0, 1]) < 0.02


def test_kicks_need_the_plain_steps_and_grains_that_slide(small_bed: Scene) -> None:
    with pytest.raises(InputError, match="acts within the drift; take 'stormer-verlet'"):
        simulate(crystal(small_bed), method="kahan-li-8", t_end=0.1, progress=False)
    with pytest.raises(SceneError, match="'friction' holds at rest"):
        crystal(small_bed).replace(**{"effects.friction": {}})


@pytest.mark.long
def test_temperatures_and_displacements_of_a_crystal(small_bed: Scene) -> None:
    """Both temperatures to 0.5 %, displacements to 2 % of T tr H^-1, at the automatic step."""
    settled = crystal(small_bed, **{"effects.bath.temperature": 0.0})
    rest = simulate(settled, t_end=20.0, progress=False).dataset["position"].values[-1]
    # So cold that the crystal is harmonic, and its grains stay where they are.
    cold = TEMPERATURE / 200.0
    scene = crystal(
        small_bed,
        **{
            "effects.bath.temperature": cold,
            "arrangement.positions": rest.tolist(),
            "arrangement.height": None,
        },
    )
    run = simulate(scene, t_end=300.0, progress=False)
    kept = run.dataset.isel(frame=slice(50, None))
    masses = run.scene.grains.masses()
    kinetic = (masses[None, :, None] * kept["velocity"].values ** 2).mean()
    assert kinetic == pytest.approx(cold, rel=5e-3)
    places = kept["position"].values
    found = configurational_temperature(scene, places)
    assert found == pytest.approx(cold, rel=5e-3)
    count, step = len(rest), 1e-6
    matrix = np.zeros((2 * count, 2 * count))
    for k, way in enumerate(step * np.eye(2 * count)):
        up, down = (evaluate(scene, rest + sign * way.reshape(count, 2)).force for sign in (1.0, -1.0))
        matrix[k] = -(up - down).ravel() / (2.0 * step)
    wanted = cold * np.trace(np.linalg.inv(matrix))
    moved = ((places - places.mean(axis=0)) ** 2).sum(axis=(1, 2)).mean()
    assert moved == pytest.approx(wanted, rel=0.02)


@pytest.mark.long  # quick: a run that goes on, in plain Python
def test_same_bits_when_a_run_goes_on(small_bed: Scene, tmp_path: Path) -> None:
    """A run that goes on from where it was kept, and one that is left alone."""
    scene = crystal(small_bed)
    integer = simulate(scene, t_end=4.0, progress=False)
    run = simulate(scene, t_end=2.0, out=tmp_path / "run", progress=False)
    assert len(run.dataset["frame"]) == 101
    rest = simulate(scene, t_end=4.0, out=tmp_path / "run", resume=True, progress=False)
    for name in ("position", "velocity", "bath_heat"):
        np.testing.assert_array_equal(integer.dataset[name], rest.dataset[name])
    assert integer.dataset["bath_heat"].values[-1] != 0.0


PROGRAM = """
import json, os, signal, sys
import granular.run.simulation as simulation
from granular import Scene, simulate
plain, out, threads, kill = sys.argv[1:]
simulation.COMMIT_SECONDS = 0.0
store = simulation.RunDirectoryWriter
commits = 0
def commit(self, kept, former=store.replace_checkpoint):
    global commits
    former(self, kept)
    commits += 1
    if kill == "kill" and commits == 3:
        os.kill(os.getpid(), signal.SIGKILL)
store.replace_checkpoint = commit
simulate(Scene.from_plain(json.loads(plain)), t_end=0.4, progress=False, out=out, resume=True,
         threads=int(threads))
"""


def carry_out(scene: Scene, out: Path, threads: int, told: str = "go") -> int:
    plain = json.dumps(scene.to_plain())
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, plain, str(out), str(threads), told],
        cwd=ROOT,
        env=os.environ,
        check=False,
    ).returncode


@pytest.mark.long
def test_same_bits_after_a_kill_and_on_two_threads(small_bed: Scene, tmp_path: Path) -> None:
    scene = crystal(small_bed, output={"scalars": "4 ms", "frames": "20 ms"})
    assert carry_out(scene, tmp_path / "killed", 1, "kill") == -signal.SIGKILL
    assert is_run_directory(tmp_path / "killed")
    assert carry_out(scene, tmp_path / "killed", 1) == 0
    assert carry_out(scene, tmp_path / "whole", 1) == 0
    assert carry_out(scene, tmp_path / "threads", 2) == 0
    runs = [load_trajectory(tmp_path / name) for name in ("killed", "whole", "threads")]
    for name in ("position", "velocity", "bath_heat"):
        for other in runs[1:]:
            np.testing.assert_array_equal(
                runs[0].dataset[name].values, other.dataset[name].values, strict=True
            )
    assert runs[0].settings()["ledger_residual"] < 1e-4
