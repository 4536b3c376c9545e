"""Bodies on springs, with stops and guides, compared with closed forms; most without a grain.

Störmer-Verlet advances a mode of angular frequency w by the phase 2 asin(w dt/2) in each step, with
exact amplitude after a start from rest. The closed forms use this discrete phase, which tends to w dt.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

import tests.plain_python.test_every_effect  # noqa: F401 (brings the stage "dip")
from granular import Scene, equilibrium, simulate
from granular.linear.equilibrium import equilibrium_from
from granular.run.trajectory import Trajectory

MASS, STIFFNESS, DT = 0.4, 900.0, 1e-3


def empty(host: dict[str, Any], duration: float = 1.0, **changes: Any) -> Scene:
    """Return a scene of a piston with further bodies and springs, without grains and weight."""
    plain = {
        "grains": {"count": 0, "species": [{"diameter": "6 mm"}]},
        "cell": {"width": "60 D"},
        "piston": {"height": 0.12, "mass": MASS},
        "effects": {"host": {"mount": "base", **host}},
        "protocol": [{"name": "go", "kind": "free", "duration": duration}],
        "output": {"scalars": DT, "frames": duration},
    }
    return Scene.from_plain(plain).replace(**changes)


def run(scene: Scene, dt: float = DT, **options: Any) -> Trajectory:
    return simulate(scene, dt=dt, progress=False, **options)


def test_piston_on_a_spring_oscillates_with_the_period_predicted_for_the_integrator() -> None:
    """Released from rest with a preloaded spring, it oscillates about the spring's equilibrium."""
    spring = {"upper": "piston", "stiffness": STIFFNESS, "preload": 3.0}
    data = run(empty({"springs": [spring]})).dataset
    omega = 2.0 / DT * math.asin(0.5 * DT * math.sqrt(STIFFNESS / MASS))
    wanted = 0.12 + 3.0 / STIFFNESS * (1.0 - np.cos(omega * data.time.values))
    np.testing.assert_allclose(data.piston_height.values, wanted, rtol=0.0, atol=1e-8 * 3.0 / STIFFNESS)


@pytest.mark.parametrize("count", [2, 3])
def test_bodies_in_the_cell_oscillate_in_the_modes_of_their_mass_and_stiffness_matrices(count: int) -> None:
    others = [{"name": f"b{k}", "mass": 0.3 + 0.2 * k} for k in range(count - 1)]
    names = ["piston", *(other["name"] for other in others), "base"]
    springs = [
        {"upper": names[k], "lower": names[k + 1], "stiffness": 500.0 + 300.0 * k, "preload": 1.0 + k}
        for k in range(count)
    ]
    data = run(empty({"pistons": others, "springs": springs})).dataset
    ways = np.eye(count) - np.eye(count, k=1)  # of each body over the next one
    stiffness = ways.T @ np.diag([spring["stiffness"] for spring in springs]) @ ways
    masses = np.diag([MASS, *(other["mass"] for other in others)])
    rest = np.linalg.solve(stiffness, ways.T @ [spring["preload"] for spring in springs])
    squares, shapes = eigh(stiffness, masses)
    phases = 2.0 / DT * np.arcsin(0.5 * DT * np.sqrt(squares)) * data.time.values[:, None]
    wanted = rest - (np.cos(phases) * (shapes.T @ masses @ rest)) @ shapes.T
    found = [data.piston_height.values - 0.12, *(data[f"{name}_displacement"].values for name in names[1:-1])]
    np.testing.assert_allclose(np.transpose(found), wanted, rtol=0.0, atol=1e-9 * np.abs(rest).max())


def test_spring_couples_a_body_in_the_cell_to_the_machine() -> None:
    """Momentum is conserved. Body and machine oscillate with the reduced mass."""
    machine = {"mount": "cell", "bodies": [{"mass": 2.0}]}
    spring = {"upper": "piston", "lower": "cell", "stiffness": STIFFNESS, "preload": 3.0}
    data = run(empty(machine | {"springs": [spring]})).dataset
    reduced = MASS * 2.0 / (MASS + 2.0)
    omega = 2.0 / DT * math.asin(0.5 * DT * math.sqrt(STIFFNESS / reduced))
    way = 3.0 / STIFFNESS * (1.0 - np.cos(omega * data.time.values))
    np.testing.assert_allclose(data.piston_height.values - 0.12, way, rtol=0.0, atol=1e-10)
    recoil = -MASS / (MASS + 2.0) * way
    np.testing.assert_allclose(data.host_displacement.values, recoil, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("dashpot", [0.0, 0.5])
def test_friction_of_a_guide_lowers_the_amplitude_by_equal_steps(dashpot: float) -> None:
    """The amplitude falls by 2 F/k in each half oscillation, and by more with a dashpot.

    Finally the body is exactly at rest.
    """
    friction, push = 0.4, 3.0
    spring = {"upper": "piston", "stiffness": STIFFNESS, "preload": push, "damping": dashpot}
    changes = {"piston.friction": friction, "output.scalars": DT / 4}
    data = run(empty({"springs": [spring]}, **changes), DT / 4).dataset
    way = data.piston_height.values - 0.12 - push / STIFFNESS
    turns = np.flatnonzero(np.diff(np.sign(data.piston_velocity.values[1:])) != 0.0) + 1
    amplitudes = [push / STIFFNESS]
    omega, rate = math.sqrt(STIFFNESS / MASS), 0.5 * dashpot / MASS
    shrink = math.exp(-math.pi * rate / math.sqrt(omega**2 - rate**2))
    shift = friction / STIFFNESS
    while amplitudes[-1] > shift:  # the spring still moves it
        amplitudes.append((amplitudes[-1] - shift) * shrink - shift)
    found = [np.abs(way[turn - 1 : turn + 3]).max() for turn in turns[: len(amplitudes) - 1]]
    np.testing.assert_allclose(found[:-1], amplitudes[1:-1], rtol=1e-4)
    assert data.piston_height.values[-1] == data.piston_height.values[-200]
    assert data.piston_velocity.values[-1] == 0.0
    lost = 0.5 * STIFFNESS * (amplitudes[0] ** 2 - way[-1] ** 2)
    taken = data.piston_loss.values[-1] + data.host_loss.values[-1]
    assert taken == pytest.approx(lost, rel=0.25 * (0.25 * omega * DT) ** 2)  # of the step


def test_a_stop_between_bodies_reverses_the_velocity_and_acts_only_beyond_its_gap() -> None:
    stop = {"upper": "piston", "lower": "cell", "stiffness": 4e5, "gap": "10 mm"}
    fall = {"effects.gravity": True, "effects.host": {"mount": "base", "springs": [stop]}}
    data = run(empty({}, 0.12).replace(**fall), DT / 16).dataset
    way, time = data.piston_height.values - 0.12, data.time.values
    omega = math.sqrt(4e5 / MASS)
    before, speed = math.sqrt(0.02 / 9.8), math.sqrt(2.0 * 9.8 * 0.01)
    free = time < before
    np.testing.assert_allclose(way[free], -4.9 * time[free] ** 2, rtol=0.0, atol=1e-12)
    # In the stop: a sine about the equilibrium under the weight.
    press = 9.8 / omega**2
    inside = 2.0 * (math.pi - math.atan(speed / omega / press)) / omega
    later = (time > before + inside) & (time < 2.0 * before + inside)
    since = time[later] - before - inside
    np.testing.assert_allclose(way[later], -0.01 + speed * since - 4.9 * since**2, rtol=0.0, atol=1e-6)


def bed_between_pistons(**changes: Any) -> Scene:
    """Return a scene of dipoles on a floor supported by a spring, under a free piston."""
    floor = {"name": "floor", "mass": 0.3, "side": "bottom", "drag": 20.0}
    plain = {
        "grains": {"count": 12, "species": [{"diameter": "6 mm"}]},
        "cell": {"width": "8 D"},
        "piston": {"height": "8 D", "mass": 0.2, "drag": 6.0},
        "effects": {
            "dipole": True,
            "walls": True,
            "gravity": True,
            "drag": {"coefficient": 0.2},
            "host": {
                "mount": "base",
                "pistons": [floor],
                "springs": [{"upper": "floor", "stiffness": 2000.0, "preload": 8.0}],
            },
        },
        "arrangement": {"height": "7 D"},
        "protocol": [{"name": "settle", "kind": "free", "duration": 0.6}],
        "output": {"scalars": 2e-3, "frames": 0.1},
    }
    return Scene.from_plain(plain).replace(**changes)


@pytest.mark.filterwarnings("ignore:the energy balance")
def test_bed_between_two_pistons_has_the_same_equilibrium_as_on_a_fixed_floor() -> None:
    scene = bed_between_pistons()
    rest = equilibrium(run(scene, 4e-4))
    floor = float(rest.pencil.at[rest.pencil.bed.pistons])
    carried = 9.8 * (0.2 + float(scene.grains.masses().sum()))
    assert rest.residual < 1e-9
    assert rest.is_stable
    assert 8.0 - 2000.0 * floor == pytest.approx(carried + 9.8 * 0.3, abs=1e-9)
    # A bed between the piston and a fixed floor has the same heights over the floor.
    alone = scene.replace(**{"effects.host": None})
    lowered = rest.positions - [0.0, floor]
    fixed = equilibrium_from(alone, lowered, (rest.piston_height or 0.0) - floor)
    np.testing.assert_allclose(fixed.positions, lowered, rtol=0.0, atol=1e-9)


def test_resumed_run_with_several_bodies_is_bit_identical(tmp_path: Path) -> None:
    stop = {"upper": "floor", "lower": "cell", "stiffness": 1e4, "gap": "1 mm"}
    springs = [{"upper": "floor", "stiffness": 2000.0, "preload": 8.0, "damping": 1.0}, stop]
    scene = bed_between_pistons(**{"effects.host.springs": springs, "protocol.settle.duration": 0.04})
    whole = run(scene, 4e-4)
    run(scene, 4e-4, out=tmp_path / "run", t_end=0.02)
    parts = run(scene, 4e-4, out=tmp_path / "run", resume=True)
    for name in ("position", "velocity", "piston_height", "floor_displacement", "host_energy", "host_loss"):
        np.testing.assert_array_equal(whole.dataset[name].values, parts.dataset[name].values, strict=True)


COURSES: tuple[dict[str, Any], ...] = (
    {"kind": "free", "duration": 0.1},
    {"kind": "push", "amplitude": 1.0, "mean": 0.5, "frequency": 20.0, "duration": 0.1},
    {"kind": "move", "to": 0.118, "duration": 0.1},
    {"kind": "oscillate", "amplitude": 1e-3, "frequency": 9.0, "duration": 0.1},
    {"kind": "path", "height": "h0 - a*(1 - cos(w*t))", "a": "1 mm", "w": "60 1/s", "duration": 0.1},
    {"kind": "descend", "to": 0.118, "duration": 0.1, "steepness": 2.0},
    {"kind": "follow", "times": [0.0, 0.04, 0.1], "heights": [0.12, 0.119, 0.12]},
    {"kind": "dip", "depth": "1 mm", "omega": "60 1/s", "duration": 0.1},
)
MOUNTS = ("base", "cell", "piston")
DRIVES: tuple[dict[str, Any] | None, ...] = (
    None,
    {"force": 3.0, "frequency": 12.0},
    {"acceleration": 4.0, "frequency": 12.0},
)


def draw(number: int) -> Scene:
    """Return the combination with a given number: mounts and piston paths in turn, with springs between
    random bodies.
    """
    random = np.random.default_rng([4, number])
    mount, course = MOUNTS[number % 3], COURSES[number % len(COURSES)]
    machine: dict[str, Any] = {"mount": mount}
    if mount != "base":
        machine["bodies"] = [
            {"mass": random.uniform(0.3, 2.0), "stiffness": random.uniform(100.0, 2e3), "damping": damping}
            for damping in random.uniform(0.0, 3.0, random.integers(1, 3))
        ]
    if mount == "piston":
        machine["cell_mass"] = 0.7
    drive = DRIVES[random.integers(3)]
    if drive is not None and not (mount == "base" and "force" in drive):
        machine["excitation"] = drive
    others = [] if mount == "piston" else ["p0", "p1"][: random.integers(0, 3)]
    machine["pistons"] = [
        {"name": name, "mass": random.uniform(0.2, 1.0), "drag": random.uniform(0.0, 4.0)} for name in others
    ]
    names = ["piston", "cell", "base", *others]
    machine["springs"] = []
    for _ in range(random.integers(1, 4)):
        upper, lower = random.choice(names, 2, replace=False).tolist()
        values = {"stiffness": random.uniform(100.0, 2e3), "damping": random.uniform(0.0, 3.0)}
        more = {"preload": random.uniform(-2.0, 2.0)}
        machine["springs"].append({"upper": upper, "lower": lower} | values | more)
    changes = {
        "piston.drag": float(random.choice([0.0, 3.0])),
        "effects.gravity": True,
        "output.scalars": 4e-3,
    }
    return empty(machine).replace(**changes, protocol=[{"name": "go", **course}])


QUICK = range(8)


@pytest.mark.parametrize(
    "number", [n if n in QUICK else pytest.param(n, marks=pytest.mark.long) for n in range(40)]
)
def test_error_of_the_energy_balance_of_random_machines_is_of_second_order_in_the_step(number: int) -> None:
    scene = draw(number)
    coarse, fine = (float(run(scene, step).settings()["ledger_residual"]) for step in (4e-4, 2e-4))
    assert coarse < 5e-3, scene.to_toml()
    assert fine < 0.3 * coarse or fine < 1e-9, scene.to_toml()
