"""Stages of the protocol on every kind of machine, compared with independent equations.

Each run is made at two steps and extrapolated, since the order is two with dissipation. The comparison
therefore tests the equations and not the time step.
"""

import math
from typing import Any

import numpy as np
import pytest

import tests.plain_python.test_every_effect  # noqa: F401 (brings the stages "dip" and "fade")
from granular import Scene, simulate
from granular.run.trajectory import Trajectory
from tests.plain_python.independent_equations import Case, solve

STEP = 4e-5
CLOSE = 1e-9
"""[m]"""

DRIVEN = ("hold", "move", "descend", "path", "oscillate", "follow", "dip", "lift")
FREE = ("free", "push", "force", "fade")
MOUNTS = ("none", "cell", "piston", "base")
ASPECTS = {"square": (5.0, 5.0), "flat": (400.0, 4.0), "tall": (5.0, 60.0)}
"""Width and height of the piston [D]."""


def stage(kind: str, random: np.random.Generator, height: float) -> dict[str, Any]:
    """Return a stage of 2 or 3 ms, in SI; ``height`` is approximately the initial height."""
    duration = float(random.choice([2e-3, 3e-3]))
    way, size = float(random.uniform(-6e-4, 6e-4)), float(random.uniform(-1.0, 1.0))
    lasting = {"duration": duration}
    more: dict[str, dict[str, Any]] = {
        "hold": lasting,
        "free": lasting,
        "move": {"to": height + way} | lasting,
        "descend": {"to": height - abs(way), "steepness": 1.0 + size / 2} | lasting,
        "path": {"height": "h0 - a*(1 - cos(w*t))", "a": way, "w": 900.0} | lasting,
        "dip": {"depth": abs(way), "omega": 700.0} | lasting,
        "oscillate": {"amplitude": abs(way), "frequency": 220.0} | lasting,
        "follow": {"times": [0.0, 1e-3, duration], "heights": [height, height + way, height - way / 2]},
        "lift": {"by": way / 3},
        "push": {"mean": size, "amplitude": 1.0, "frequency": 150.0} | lasting,
        "force": {"force": "f*exp(-t/s)", "f": size, "s": 2e-3} | lasting,
        "fade": {"size": 0.5, "span": 1e-3} | lasting,
    }
    return {"kind": kind} | more[kind]


def with_units(one: dict[str, Any]) -> dict[str, Any]:
    """Return a stage as in a scene, with units for the parameters of a formula."""
    units = {"a": "m", "w": "1/s", "f": "N", "s": "s"}
    return {key: f"{value!r} {units[key]}" if key in units else value for key, value in one.items()}


def host(mount: str, random: np.random.Generator) -> dict[str, Any]:
    """Return a machine of one to three bodies, driven by a force, by its base, or not at all."""
    drives: list[dict[str, Any] | None] = [
        None,
        {"force": 3.0, "frequency": 60.0},
        {"acceleration": 4.0, "frequency": 60.0},
        {"displacement": 2e-4, "frequency": 60.0},
    ]
    if mount == "none":
        return {}
    if mount == "base":
        return {"mount": mount, "bodies": [], "excitation": drives[random.integers(2, 4)]}
    count = int(random.integers(1, 4))
    bodies = [
        {"mass": random.uniform(0.1, 1.0), "stiffness": random.uniform(0.0, 3e3), "damping": damping}
        for damping in (random.uniform(0.0, 3.0, count) * random.integers(0, 2)).tolist()
    ]
    result: dict[str, Any] = {"mount": mount, "bodies": bodies, "excited": int(random.integers(count))}
    drive = drives[random.integers(len(drives))]
    if drive is not None:
        result["excitation"] = drive
    return result | ({"cell_mass": random.uniform(0.1, 1.0)} if mount == "piston" else {})


def draw(number: int) -> tuple[Scene, Case]:
    """Return the combination with a given number; every stage and mount is drawn in turn."""
    random = np.random.default_rng([65, number])
    mount = MOUNTS[number % len(MOUNTS)]
    kinds = [
        DRIVEN[number % len(DRIVEN)],
        FREE[random.integers(len(FREE))],
        DRIVEN[random.integers(len(DRIVEN))],
    ]
    kinds = [kinds[k] for k in random.permutation(3)[: random.integers(2, 4)]]
    width, height = ASPECTS[list(ASPECTS)[random.integers(len(ASPECTS))]]
    count = int(random.integers(1, 4))
    place = np.column_stack([1.3 + 1.2 * np.arange(count), height - random.uniform(1.3, 2.2, count)]) * 6e-3
    speeds = random.normal(size=(count, 2)) * 0.05
    springs = [
        (float(random.uniform(0.5, 3.0)), float(random.uniform(0.0, 0.02)))
        for _ in range(random.choice([0, 1, 3]))
    ]
    protocol = []
    # A table of heights comes first: later the height at its start is not known before the run.
    kinds = [kinds[0], *("oscillate" if kind == "follow" else kind for kind in kinds[1:])]
    for index, kind in enumerate(kinds):
        protocol.append({"name": f"s{index}", **stage(kind, random, height * 6e-3)})
    drag = float(random.choice([0.0, 0.1]))
    effects: dict[str, Any] = {"dipole": True, "walls": True}
    machine = host(mount, random)
    effects |= {"drag": {"coefficient": drag}} if drag else {}
    effects |= {"gravity": True} if random.integers(2) else {}
    effects |= {"host": machine} if machine else {}
    if springs:
        effects["field"] = [
            {"energy": "k*(y - h)**2/2", "k": f"{k!r} N/m", "h": f"{h!r} m"} for k, h in springs
        ]
    mass, piston_drag = float(random.uniform(0.1, 0.5)), float(random.choice([0.0, 2.0]))
    end = sum(one["times"][-1] if one["kind"] == "follow" else one.get("duration", 0.0) for one in protocol)
    scene = Scene.from_plain(
        {
            "grains": {
                "count": count,
                "species": [
                    {"name": "big", "diameter": "6 mm", "share": 0.6},
                    {"name": "small", "diameter": "5 mm", "share": 0.4},
                ],
            },
            "cell": {"width": width * 6e-3},
            "piston": {"height": height * 6e-3, "mass": mass, "drag": piston_drag},
            "effects": effects,
            "arrangement": {"positions": place.tolist(), "velocities": speeds.tolist()},
            "protocol": [with_units(one) for one in protocol],
            "output": {"scalars": 1e-3, "frames": end},
        }
    )
    case = Case(
        diameters=scene.grains.diameters(),
        positions=place,
        velocities=speeds,
        width=width * 6e-3,
        height=height * 6e-3,
        mass=mass,
        piston_drag=piston_drag,
        drag=drag,
        weight="gravity" in effects,
        springs=tuple(springs),
        host=machine,
        stages=tuple(protocol),
    )
    return scene, case


def last(run: Trajectory, name: str) -> np.ndarray:
    return np.asarray(run.dataset[name].values[-1])


QUICK = (1, 2, 3, 6, 18)


@pytest.mark.parametrize(
    "number", [n if n in QUICK else pytest.param(n, marks=pytest.mark.long) for n in range(60)]
)
def test_motions_of_random_stages_and_machines_agree_with_independent_equations(number: int) -> None:
    scene, case = draw(number)
    coarse, fine = (simulate(scene, dt=dt, progress=False) for dt in (STEP, STEP / 2))
    for name, wanted in solve(case).items():
        found = (4.0 * last(fine, name) - last(coarse, name)) / 3.0
        assert np.abs(found - wanted).max() < CLOSE, (name, scene.to_toml())
    assert fine.settings()["ledger_residual"] < 1e-3


def test_random_stages_and_machines_cover_every_kind_of_stage_and_mount() -> None:
    cases = [draw(number)[1] for number in range(60)]
    assert {one["kind"] for case in cases for one in case.stages} == {*DRIVEN, *FREE}
    assert {case.host.get("mount", "none") for case in cases} == set(MOUNTS)
    quick = {cases[number].host["mount"] for number in QUICK}
    assert quick == set(MOUNTS) - {"none"}


MASS, BODY, STIFFNESS = 0.4, 2.0, 800.0


@pytest.mark.parametrize("mass", [MASS, 0.05])
def test_a_driven_piston_excites_the_machine(mass: float) -> None:
    """For masses m of the machine and M of the piston, (m + M) X'' = -k X - M z''.

    The piston moves as z = A sin(wt), and starts with the velocity A w.
    """
    frequency, reach = 5.0, 2e-3
    oscillate = {"kind": "oscillate", "amplitude": reach, "frequency": frequency, "duration": 0.2}
    scene = Scene.from_plain(
        {
            "grains": {"count": 0, "species": [{"diameter": "6 mm"}]},
            "cell": {"width": "60 D"},
            "piston": {"height": "20 D", "mass": mass},
            "effects": {"host": {"mount": "cell", "bodies": [{"mass": BODY, "stiffness": STIFFNESS}]}},
            "protocol": [{"name": "driven", **oscillate}],
            "output": {"scalars": "4 ms", "frames": "0.2 s"},
        }
    )
    run = simulate(scene, dt=2e-4, progress=False)
    omega, total = math.tau * frequency, BODY + mass
    own = math.sqrt(STIFFNESS / total)
    driven = mass * reach * omega**2 / total / (own**2 - omega**2)
    free = -(mass * reach * omega / total + driven * omega) / own
    time = run.dataset["time"].values
    wanted = driven * np.sin(omega * time) + free * np.sin(own * time)
    found = run.dataset["host_displacement"].values
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-5 * np.abs(wanted).max())
