"""A host against exact solutions: alone, loaded, with linear dampers, on all mounts."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import load_scene, load_trajectory, simulate
from granular.methods import METHODS
from granular.pairs.mesh_far_field import FarFieldSettings
from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.scene.scene_in_natural_units import scene_in_natural_units
from granular.shared.errors import InputError, SceneError

ROOT = Path(__file__).parents[3]
MASS, STIFFNESS, DAMPING = 2.0, 800.0, 3.0
BODY = {"mass": MASS, "stiffness": STIFFNESS, "damping": DAMPING}
RESONANCE = math.sqrt(STIFFNESS / MASS) / math.tau
BARE = {"left": "none", "right": "none", "top": "none"}


def scene(duration: float = 2.0, **changes: Any) -> Scene:
    """A host without damper; a force swings it."""
    plain = {
        "name": "host",
        "grains": {"count": 0, "species": [{"diameter": "6 mm"}]},
        "cell": {"width": "60 D"},
        "piston": {"height": "20 D"},
        "effects": {"host": {"bodies": [BODY]}},
        "protocol": [{"name": "shake", "kind": "hold", "duration": duration}],
        "output": {"scalars": "2 ms", "frames": "0.1 s"},
    }
    return Scene.from_plain(plain).replace(**changes)


def force(frequency: float, size: float = 2.0) -> dict[str, Any]:
    return {"kind": "sine", "force": size, "frequency": frequency}


def run(one: Scene, dt: float | str = "auto") -> Trajectory:
    return simulate(one, dt=dt, progress=False)


def solved(rate: Any, found: Trajectory, states: int) -> np.ndarray:
    time = found.dataset.time.values
    answer = solve_ivp(
        rate, (0.0, time[-1]), np.zeros(states), t_eval=time, rtol=1e-10, atol=1e-14, max_step=0.01
    )
    return np.asarray(answer.y)


def off(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.abs(found - exact).max() / np.abs(exact).max())


def grain_on_spring(mass: float, frequency: float) -> dict[str, Any]:
    """One grain over a bottom that is a spring, in drag: a tuned mass."""
    spring = mass * (math.tau * frequency) ** 2
    return {
        "grains.count": 1,
        "grains.density": mass / (math.pi / 4.0 * 0.006**2 * 0.003),
        "effects.walls": BARE | {"bottom": {"energy": "k*(w-l)^2/2", "k": f"{spring!r} N/m", "l": "60 mm"}},
        "effects.drag.coefficient": "1 kg/s",
        "arrangement.positions": [["0.1 m", "60 mm"]],
    }


@pytest.mark.long  # quick: two degrees of freedom here, and forces and ledger in plain Python
@pytest.mark.parametrize("ratio", [0.3, 1.0, 3.0])
def test_a_host_alone_swings_as_one_mass_does(ratio: float) -> None:
    omega = math.tau * ratio * RESONANCE
    found = run(scene(**{"effects.host.excitation": force(ratio * RESONANCE)}))
    x, _ = solved(
        lambda t, y: [y[1], (2.0 * math.sin(omega * t) - DAMPING * y[1] - STIFFNESS * y[0]) / MASS], found, 2
    )
    assert off(found.dataset.host_displacement.values, x) < 1e-3
    assert found.settings()["ledger_residual"] < 1e-5


@pytest.mark.parametrize(
    ("base", "ratio"),
    [
        *((False, 0.3), (False, 1.1), (True, 0.9), (True, 3.0)),
        *(pytest.param(False, ratio, marks=pytest.mark.long) for ratio in (0.9, 3.0)),
        *(pytest.param(True, ratio, marks=pytest.mark.long) for ratio in (0.3, 1.1)),
    ],
)
def test_a_linear_damper_makes_two_degrees_of_freedom(ratio: float, base: bool) -> None:
    mass, omega = 0.2, math.tau * ratio * RESONANCE
    spring = mass * (math.tau * RESONANCE) ** 2
    shake = {"kind": "sine", "acceleration": 0.8, "frequency": ratio * RESONANCE}
    found = run(
        scene(**grain_on_spring(mass, RESONANCE)).replace(
            **{"effects.host.excitation": shake if base else force(ratio * RESONANCE)}
        )
    )

    def rate(t: float, y: np.ndarray) -> list[float]:
        x, w, r, v = y
        pull, swing = spring * r + 1.0 * v, math.sin(omega * t)
        drive, shaken = (0.0, 0.8 * swing) if base else (2.0 * swing, 0.0)
        host = (drive - DAMPING * w - STIFFNESS * x + pull) / MASS
        return [w, host - shaken, v, -pull / mass - host]

    x, _, r, _ = solved(rate, found, 4)
    data = found.dataset
    assert off(data.host_displacement.values, x) < 1e-3
    grain = data.position.values[:, 0, 1] - 0.06
    at = np.searchsorted(data.time.values, data.frame_time.values - 1e-9)
    assert off(grain, r[at]) < 2e-3
    assert data.host_loss.values[-1] > 0.0
    assert data.drag_loss.values[-1] > 0.0
    assert found.settings()["ledger_residual"] < 1e-5


@pytest.mark.long  # quick: two degrees of freedom here, and forces and ledger in plain Python
@pytest.mark.parametrize("ratio", [0.3, 0.6, 0.9, 1.2, 2.0, 3.0])
def test_grains_that_stick_are_a_mass_more(ratio: float) -> None:
    count = 6
    loaded = {
        "grains.count": count,
        "grains.density": "2e6 kg/m^3",
        "effects.gravity": True,
        "effects.dipole": True,
        "effects.friction": {"load": "50 N"},
    }
    mass = count * 2e6 * math.pi / 4.0 * 0.006**2 * 0.003
    omega = math.tau * ratio * RESONANCE
    # With friction the automatic step is four times that of other scenes.
    found = run(scene(**loaded).replace(**{"effects.host.excitation": force(ratio * RESONANCE)}), "auto/2")
    x, _ = solved(
        lambda t, y: [y[1], (2.0 * math.sin(omega * t) - DAMPING * y[1] - STIFFNESS * y[0]) / (MASS + mass)],
        found,
        2,
    )
    assert mass > 0.5
    assert off(found.dataset.host_displacement.values, x) < 2e-3
    assert found.settings()["ledger_residual"] < 1e-5
    assert np.ptp(found.dataset.position.values[1:], axis=0).max() == 0.0


@pytest.mark.long  # quick: two degrees of freedom here, and forces and ledger in plain Python
def test_a_piston_in_drag_pulls_at_the_body_that_carries_the_cell() -> None:
    drag, mass, omega = 4.0, 0.5, math.tau * RESONANCE
    found = run(
        scene(
            **{
                "piston.mass": mass,
                "piston.drag": drag,
                "effects.host.bodies": [{"mass": 3.0, "stiffness": 900.0, "damping": 2.0}, BODY],
                "effects.host.excitation": force(RESONANCE),
                "effects.host.excited": 0,
                "protocol": [{"name": "shake", "kind": "free", "duration": 2.0}],
            }
        )
    )

    def rate(t: float, y: np.ndarray) -> list[float]:
        x, w, x_2, w_2, _, v = y
        pull = DAMPING * (w_2 - w) + STIFFNESS * (x_2 - x)
        low = (2.0 * math.sin(omega * t) - 2.0 * w - 900.0 * x + pull) / 3.0
        high = (-pull + drag * v) / MASS
        return [w, low, w_2, high, v, -drag * v / mass - high]

    x, _, x_2, _, r, _ = solved(rate, found, 6)
    data = found.dataset
    assert off(data.host_displacement.values, x_2) < 1e-3
    assert off(data.body_0_displacement.values, x) < 1e-3
    assert off(data.piston_height.values - 0.12, r) < 2e-3
    assert found.settings()["ledger_residual"] < 1e-5


@pytest.mark.long  # quick: two degrees of freedom here, and forces and ledger in plain Python
def test_a_free_cell_hangs_by_its_drag_on_the_piston() -> None:
    drag, own, cell, omega = 4.0, 0.5, 0.7, math.tau * RESONANCE
    found = run(
        scene(
            **{
                "piston.mass": own,
                "piston.drag": drag,
                "effects.host.mount": "piston",
                "effects.host.cell_mass": cell,
                "effects.host.excitation": force(RESONANCE),
                "protocol": [{"name": "shake", "kind": "free", "duration": 2.0}],
            }
        )
    )

    def rate(t: float, y: np.ndarray) -> list[float]:
        x, w, _, v = y
        host = (2.0 * math.sin(omega * t) - DAMPING * w - STIFFNESS * x - drag * v) / (MASS + own)
        return [w, host, v, host - drag * v / cell]

    x, _, r, _ = solved(rate, found, 4)
    data = found.dataset
    assert off(data.host_displacement.values, x) < 1e-3
    assert off(data.piston_height.values - 0.12, r) < 2e-3
    assert found.settings()["ledger_residual"] < 1e-5


@pytest.mark.long  # quick: two degrees of freedom here, and forces and ledger in plain Python
def test_a_load_in_drag_over_a_shaken_base() -> None:
    drag, mass, omega = 4.0, 0.5, math.tau * 3.0
    found = run(
        scene(
            **{
                "piston.mass": mass,
                "piston.drag": drag,
                "effects.host": {
                    "mount": "base",
                    "bodies": [],
                    "excitation": {"displacement": "5 mm", "frequency": "3 Hz"},
                },
                "protocol": [{"name": "shake", "kind": "free", "duration": 2.0}],
            }
        )
    )
    r, _ = solved(lambda t, y: [y[1], 0.005 * omega**2 * math.sin(omega * t) - drag / mass * y[1]], found, 2)
    assert off(found.dataset.piston_height.values - 0.12, r) < 1e-3
    assert found.settings()["ledger_residual"] < 1e-5


BED = {
    "grains.count": 24,
    "cell.width": "16 D",
    "piston.height": "8 D",
    "piston.mass": 0.4,
    "effects.dipole": True,
    "effects.walls": True,
    "effects.gravity": True,
    "arrangement.height": "7 D",
    "arrangement.speed": "1e-2 D/s",
    "effects.host.bodies": [{"mass": 2.0, "stiffness": 800.0}],
    "effects.host.excitation": force(3.0),
    "protocol": [{"name": "shake", "kind": "free", "duration": 0.02}],
}


@pytest.mark.long  # quick: two degrees of freedom here, and forces and ledger in plain Python
@pytest.mark.parametrize("mount", ["cell", "piston"])
@pytest.mark.parametrize("drag", [0.0, 0.1])
def test_a_bed_on_a_host_has_the_order_and_the_ledger_of_the_method(mount: str, drag: float) -> None:
    bed = scene(**BED)
    if mount == "piston":
        host = bed.to_plain()["effects"]["host"] | {"mount": mount, "cell_mass": 0.6}
        bed = bed.replace(**{"effects.host": host})
    if drag:
        bed = bed.replace(
            **{"effects.drag.coefficient": drag, "piston.drag": 0.3, "effects.host.bodies": [BODY]}
        )
    steps = [4e-5 / 2**k for k in range(4)]
    runs = [run(bed, dt) for dt in steps]
    last = [
        np.append(one.dataset.piston_height.values[-1:], one.dataset.host_displacement.values[-1:])
        for one in runs
    ]
    errors = [np.abs(one - last[-1]).max() for one in last[:-1]]
    # Against the finest of the steps, errors of second order have these ratios.
    assert errors[0] / errors[1] == pytest.approx((64 - 1) / (16 - 1), rel=0.15)
    assert errors[1] / errors[2] == pytest.approx((16 - 1) / (4 - 1), rel=0.15)
    assert runs[2].settings()["ledger_residual"] < 1e-5


@pytest.mark.long  # quick: two degrees of freedom here, and forces and ledger in plain Python
def test_the_momentum_of_the_whole_is_that_of_the_outer_force() -> None:
    bed = scene(**BED).replace(
        **{
            "effects.host.bodies": [{"mass": 2.0}],
            "effects.drag.coefficient": 0.5,
            "output": {"scalars": "2 ms", "frames": "2 ms"},
        }
    )
    found = run(bed)
    data, grain = found.dataset, float(bed.grains.masses()[0])
    host = data.host_velocity.values
    inside = grain * data.velocity.values[:, :, 1].sum(axis=1)
    momentum = (2.0 + 0.4 + 24 * grain) * host + inside + 0.4 * data.piston_velocity.values
    omega = math.tau * 3.0
    given = 2.0 / omega * (1.0 - np.cos(omega * data.time.values))
    np.testing.assert_allclose(momentum - momentum[0], given, atol=2e-6 * np.abs(given).max())


KILLED = """
import os, signal, sys, warnings
import granular.run.simulation as simulation
from granular.scene.loading import load_scene
warnings.simplefilter("ignore")
file, out, threads, kill = sys.argv[1:]
simulation.COMMIT_SECONDS = 0.0
store, commits = simulation.RunDirectoryWriter, 0
def commit(self, kept, former=store.replace_checkpoint):
    global commits
    former(self, kept)
    commits += 1
    if kill == "kill" and commits == 4:
        os.kill(os.getpid(), signal.SIGKILL)
store.replace_checkpoint = commit
simulation.simulate(load_scene(file), progress=False, out=out, resume=True, threads=int(threads))
"""


@pytest.mark.long
def test_a_killed_run_goes_on_with_the_same_bits_on_any_threads(tmp_path: Path) -> None:
    file = tmp_path / "host.toml"
    bed = scene(**BED).replace(
        **{
            "grains.count": 300,
            "cell.width": "50 D",
            "piston.height": "22 D",
            "piston.mass": 5.0,
            "arrangement.height": "21 D",
            "effects.drag.coefficient": 0.1,
            "protocol.shake.duration": 0.1,
            "effects.host.bodies": [BODY, {"mass": 20.0, "stiffness": 8000.0, "damping": 3.0}],
            "output": {"scalars": "1 ms", "frames": "10 ms"},
        }
    )
    bed.save(file)

    def carry_out(name: str, threads: str, kill: str = "go") -> int:
        words = [sys.executable, "-c", KILLED, str(file), str(tmp_path / name), threads, kill]
        return subprocess.run(words, cwd=ROOT, env=os.environ, check=False).returncode

    assert carry_out("killed", "1", "kill") == -signal.SIGKILL
    assert [carry_out(*one) for one in (("killed", "1"), ("whole", "1"), ("two", "2"))] == [0, 0, 0]
    runs = [load_trajectory(tmp_path / name).dataset for name in ("killed", "whole", "two")]
    for name in ("position", "velocity", "host_displacement", "body_0_displacement", "host_loss"):
        for other in runs[1:]:
            np.testing.assert_array_equal(runs[0][name].values, other[name].values, strict=True)


def test_what_is_carried_is_checked() -> None:
    with pytest.raises(SceneError, match=r"give one of force, acceleration, displacement"):
        scene(**{"effects.host.excitation": {"frequency": "3 Hz"}})
    with pytest.raises(SceneError, match="shaken already"):
        scene(**{"effects.shaking": {"amplitude": "1 mm", "frequency": "3 Hz"}})
    with pytest.raises(SceneError, match="cell is free"):
        scene(**{"effects.host.cell_mass": "1 kg"})
    with pytest.raises(InputError, match="take 'stormer-verlet'"):
        simulate(scene(), method="runge-kutta-4", progress=False)


def test_the_far_field_of_a_bed_on_a_host_is_a_part_of_every_force() -> None:
    """An impulse would reach the grains and not the host."""
    bed = scene(**BED, **{"pairs.method": "mesh"})
    assert natural_far(bed).every is None
    assert natural_far(bed.replace(**{"effects.host": None})).every is not None
    with pytest.raises(InputError, match=r"far_every = 4: a host moves by the whole force"):
        natural_far(bed.replace(**{"pairs.far_every": 4}))


def natural_far(scene: Scene) -> FarFieldSettings:
    far = scene_in_natural_units(scene, method=METHODS["stormer-verlet"]).constants.acting.far
    assert far is not None
    return far


def test_the_packaged_scenes_name_no_host() -> None:
    assert load_scene("damper").effects.host is None


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        ({"walls": {"left": {"law": "slab", "length": "20 D"}}}, "its wall 'slab' pushes along itself"),
        ({"walls": {"left": {"law": "discs", "pitch": "1.3 D"}}}, "its wall 'discs' pushes along itself"),
        ({"wall_friction": {"coefficient": 0.2}}, "nothing may rub at it"),
    ],
)
def test_a_further_piston_takes_no_force_along_an_inclined_side(effects: dict[str, Any], words: str) -> None:
    host = {"mount": "base", "pistons": [{"name": "ram", "mass": 0.3, "side": "left"}]}
    host["springs"] = [{"upper": "ram", "stiffness": 2000.0}]
    scene = load_scene("bed")
    with pytest.raises(SceneError, match=words):
        scene.replace(**{f"effects.{key}": value for key, value in effects.items()}, **{"effects.host": host})


@pytest.mark.filterwarnings("ignore:the energy ledger")
def test_ledger_of_two_pistons_over_two_stages_closes_and_resumes(tmp_path: Path) -> None:
    """Compiled: a bed on a floor on a spring, whose piston is pushed to and fro and then driven."""
    floor = {"name": "floor", "mass": 0.3, "side": "bottom", "drag": 3.0}
    host = {
        "mount": "base",
        "pistons": [floor],
        "springs": [{"upper": "floor", "stiffness": 2000.0, "preload": 8.0, "damping": 1.0}],
    }
    plain = {
        "grains": {"count": 12, "species": [{"diameter": "6 mm"}]},
        "cell": {"width": "8 D"},
        "piston": {"height": "8 D", "mass": 0.2, "drag": 6.0},
        "effects": {
            "dipole": True,
            "walls": True,
            "gravity": True,
            "drag": {"coefficient": 0.2},
            "host": host,
        },
        "arrangement": {"height": "7 D"},
        "protocol": [
            {"name": "push", "kind": "push", "amplitude": 1.0, "frequency": 20.0, "duration": 0.1},
            {"name": "drive", "kind": "oscillate", "amplitude": 1e-3, "frequency": 9.0, "duration": 0.1},
        ],
        "output": {"scalars": 2e-3, "frames": 0.05},
    }
    pistons = Scene.from_plain(plain)
    coarse, fine = (run(pistons, dt) for dt in (2e-4, 1e-4))
    off_coarse, off_fine = (float(one.settings()["ledger_residual"]) for one in (coarse, fine))
    assert off_fine < 0.27 * off_coarse < 1e-4
    assert np.ptp(coarse.dataset["floor_displacement"].values) > 1e-3
    for stop in (0.03, 0.12, 0.2):
        parts = simulate(
            pistons, dt=2e-4, t_end=stop, out=tmp_path / "run", resume=stop > 0.03, progress=False
        )
    for name in coarse.dataset:
        whole, again = coarse.dataset[name].values, parts.dataset[name].values
        np.testing.assert_array_equal(again, whole, strict=True, err_msg=str(name))
