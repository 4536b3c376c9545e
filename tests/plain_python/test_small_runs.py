"""Runs of nine grains, some dozens of steps long, in plain Python: every effect, stage and method.

Run with ``NUMBA_DISABLE_JIT=1``, as `tests/architecture/test_plain_python.py` does: nothing is
compiled, so that all that acts can be met within seconds, and lines can be watched.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from granular import Scene, Trajectory, load_scene, simulate
from granular.methods import METHODS
from granular.methods.method import COMPENSATED

pytestmark = [
    pytest.mark.skipif(not numba.config.DISABLE_JIT, reason="only where numba does not compile"),
    # Numba answers a division by zero with infinity and does not warn of it, as Python does.
    pytest.mark.filterwarnings("ignore::RuntimeWarning"),
    pytest.mark.filterwarnings("ignore:two grains came as close"),
]

STEP = 2e-5
"""[s]: a sixtieth of a grain's natural time."""

TIME = 40 * STEP


def small(**changes: Any) -> Scene:
    """Nine grains that move, under a light piston, without what dissipates."""
    base: dict[str, Any] = {
        "grains.count": 9,
        "cell.width": "6 D",
        "piston.height": "6 D",
        "piston.mass": 0.01,
        "arrangement.height": "5.9 D",
        "arrangement.speed": "20 D/s",
        "effects.drag": None,
        "output": {"scalars": 10 * STEP, "frames": 20 * STEP},
    }
    return load_scene("bed").replace(**(base | changes))


def run(scene: Scene, dt: float | str = STEP, method: str = "stormer-verlet") -> Trajectory:
    return simulate(scene, dt=dt, t_end=TIME, method=method, progress=False)


def residual(trajectory: Trajectory) -> float:
    """How far the ledger is off, over the energy turned over."""
    return float(trajectory.settings()["ledger_residual"])


def final(trajectory: Trajectory) -> np.ndarray:
    """Where the grains are in the end (n, 2) [m]."""
    return np.asarray(trajectory.dataset["position"].values[-1])


def stage(kind: str, **more: Any) -> dict[str, Any]:
    return {"protocol": [{"kind": kind, "name": kind, **more}]}


SLAB = {
    "effects.walls.left": {"law": "slab", "length": "7 D"},
    "effects.walls.right": {"law": "slab", "length": "8 D"},
    "effects.walls.top": {"law": "slab"},
}
TOUCHING = {
    "effects.contact.modulus": 1e6,
    "arrangement": {
        "positions": [[0.007 + 0.0057 * i, 0.007 + 0.0055 * k] for i in range(3) for k in range(3)],
        "speed": 0.1,
    },
}
"""Grains of 6 mm that overlap a little."""
SPECIES = {
    "grains.species": [
        {"name": "big", "diameter": "6 mm", "share": 0.5},
        {"name": "small", "diameter": "4 mm", "share": 0.5},
    ]
}

SCENES: dict[str, dict[str, Any]] = {
    "conservative": {},
    "drag": {"effects.drag": {}},
    "friction": {"effects.friction": {}},
    "friction of a given load, and drag": {"effects.friction.load": 0.01, "effects.drag": {}},
    "friction of two species": {"effects.friction": {"torque": "second"}, **SPECIES},
    "friction under a list": {"effects.friction": {}, "pairs.method": "cut-off"},
    "friction of the source": {"effects.friction.scheme": "regularised"},
    "contact": TOUCHING,
    "contact of two species, with friction":
        {"effects.friction": {}, **TOUCHING, **SPECIES},
    "shaking": {"effects.shaking": {"amplitude": "0.5 mm", "frequency": 100.0}},
    "shaking with friction":
        {"effects.shaking": {"amplitude": "0.5 mm", "frequency": 100.0}, "effects.friction": {}},
    "slabs": SLAB,
    "slabs of two species": {**SLAB, **SPECIES},
    "infinite walls": {"effects.walls": dict.fromkeys(("left", "right", "top"), "infinite")},
    "a wall with a gap": {
        "effects.walls.bottom": {"law": "slab", "gap_start": "2 D", "gap_end": "3 D"}
    },
    "no side wall": {"effects.walls.left": None},
    "no pairs": {"effects.dipole": None},
    "cut-off": {"pairs.method": "cut-off"},
    "the source's list": {"pairs.method": "verlet-list"},
    "mesh": {"pairs.method": "mesh"},
    "move": stage("move", to="5.9 D", duration=TIME),
    "move to a force": stage("move", to="4 D", speed="0.5 m/s", until_force=0.2),
    "descend": stage("descend", to="5.9 D", duration=TIME),
    "follow": stage("follow", times=[0.0, TIME], heights=["6 D", "5.9 D"]),
    "oscillate": stage("oscillate", amplitude="0.1 D", frequency=500.0, duration=TIME),
    "free": stage("free", duration=TIME),
    "free, with friction": {**stage("free", duration=TIME), "effects.friction": {}},
    "free, rubbing": {**stage("free", duration=TIME), "piston.friction": 0.05, "piston.drag": 0.1},
    "push": stage("push", mean=-0.1, amplitude=0.5, frequency=500.0, duration=TIME),
    "push, shaken": {
        **stage("push", amplitude=0.5, frequency=500.0, duration=TIME),
        "effects.shaking": {"amplitude": "0.5 mm", "frequency": 100.0},
    },
    "lift": {"protocol": [{"kind": "hold", "name": "a", "duration": TIME / 2},
                          {"kind": "lift", "name": "b", "by": "0.2 D"},
                          {"kind": "free", "name": "c", "duration": TIME / 2}]},
    "until rest": stage("free", until="rest"),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_ledger_closes_to_second_order(name: str) -> None:
    """Half the step leaves a quarter; a wrong sign or factor anywhere leaves all of it, or half."""
    scene = small(**SCENES[name])
    whole, half = (residual(run(scene, dt)) for dt in (STEP, STEP / 2))
    assert 0.0 < whole < 1e-4
    assert whole / half == pytest.approx(4.0, abs=0.1)


FARTHEST = {1: 3e-3, 2: 1e-5, 4: 1e-8, 6: 1e-12, 8: 1e-12}
"""How far a grain may end from where the exact motion takes it [D], by the method's order."""


@pytest.fixture(scope="module")
def exact() -> np.ndarray:
    return final(run(small(), STEP / 2, "kahan-li-8"))


@pytest.mark.parametrize("name", METHODS)
def test_every_method_comes_to_the_same_place(name: str, exact: np.ndarray) -> None:
    method = METHODS[name]
    dt = "auto/2" if method.variable else STEP / 8 if method.order == 1 else STEP
    way = np.abs(final(run(small(), dt, name)) - exact).max() / 0.006
    assert way < FARTHEST[method.order]


def test_compensated_sums_change_the_last_bits_only() -> None:
    names = ("stormer-verlet", f"stormer-verlet{COMPENSATED}")
    plain, compensated = (final(run(small(), STEP, name)) for name in names)
    assert 0.0 < np.abs(compensated - plain).max() < 1e-15
