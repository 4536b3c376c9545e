"""Runs of nine grains over some dozens of steps in plain Python, with every effect, stage and method.

They run with ``NUMBA_DISABLE_JIT=1``, set by `tests/architecture/test_plain_python.py`. Without
compilation all features can be tested within seconds, and the executed lines counted.
"""

import dataclasses
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Scene, Trajectory, load_scene, simulate
from granular.methods import METHODS
from granular.methods.method import COMPENSATED
from granular.shared.errors import NotFiniteError
from tests.plain_python.independent_equations import Case, solve

pytestmark = [
    # Numba answers a division by zero with infinity and does not warn of it, as Python does.
    pytest.mark.filterwarnings("ignore::RuntimeWarning")
]

STEP = 2e-5
"""[s]: a sixtieth of a grain's natural time."""

TIME = 40 * STEP


def small(**changes: Any) -> Scene:
    """Return nine moving grains under a light piston, without dissipation."""
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


def run(
    scene: Scene, dt: float | str = STEP, method: str = "stormer-verlet", time: float = TIME
) -> Trajectory:
    return simulate(scene, dt=dt, t_end=time, method=method, progress=False)


def residual(trajectory: Trajectory) -> float:
    """Return the error of the energy balance relative to the energy converted."""
    return float(trajectory.settings()["ledger_residual"])


def final(trajectory: Trajectory) -> np.ndarray:
    """Return final positions of the grains (n, 2) [m]."""
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
        "positions": [[0.007 + 0.0057 * i, 0.007 + 0.0055 * k] for i in range(3) for k in range(3)]
    },
}
"""Grains of 6 mm that overlap a little."""
SPECIES = {
    "grains.species": [
        {"name": "big", "diameter": "6 mm", "share": 0.5},
        {"name": "small", "diameter": "4 mm", "share": 0.5},
    ]
}

DISCS = {
    "grains.magnets": "cylinders",
    "effects.walls": dict.fromkeys(("left", "right", "bottom", "top"), "experimental"),
    "grains.species": [
        {"name": "big", "diameter": "6 mm", "share": 0.5},
        {"name": "small", "diameter": "4 mm", "thickness": "2 mm", "share": 0.5},
    ],
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
    "contact of two species, with friction": {"effects.friction": {}, **TOUCHING, **SPECIES},
    "contact of discs of two species": {**TOUCHING, **DISCS},
    "shaking": {"effects.shaking": {"amplitude": "0.5 mm", "frequency": 100.0}},
    "shaking with friction": {
        "effects.shaking": {"amplitude": "0.5 mm", "frequency": 100.0},
        "effects.friction": {},
    },
    "slabs": SLAB,
    "slabs of two species": {**SLAB, **SPECIES},
    "infinite walls": {"effects.walls": dict.fromkeys(("left", "right", "top"), "infinite")},
    "a wall with a gap": {"effects.walls.bottom": {"law": "slab", "gap_start": "2 D", "gap_end": "3 D"}},
    "no side wall": {"effects.walls.left": None},
    "no pairs": {"effects.dipole": None},
    "cut-off": {"pairs.method": "cut-off"},
    "the source's list": {"pairs.method": "verlet-list"},
    "mesh": {"pairs.method": "mesh"},
    "far pairs less often": {"pairs": {"method": "direct", "far_every": 4}},
    "move": stage("move", to="5.9 D", duration=TIME),
    "move to a force": stage("move", to="4 D", speed="0.5 m/s", until_force=0.2),
    "descend": stage("descend", to="5.9 D", duration=TIME),
    # A kink within a step would add an error that depends on its position in the step.
    "follow": stage("follow", times=[0.0, 12 * STEP, TIME], heights=["6 D", "5.9 D", "5.95 D"]),
    "oscillate": stage("oscillate", amplitude="0.1 D", frequency=500.0, duration=TIME),
    "free": stage("free", duration=TIME),
    "free, with friction": {**stage("free", duration=TIME), "effects.friction": {}},
    "free, rubbing": {**stage("free", duration=TIME), "piston.friction": 0.05, "piston.drag": 0.1},
    "push": stage("push", mean=-0.1, amplitude=0.5, frequency=500.0, duration=TIME),
    "push, shaken": {
        **stage("push", amplitude=0.5, frequency=500.0, duration=TIME),
        "effects.shaking": {"amplitude": "0.5 mm", "frequency": 100.0},
    },
    "lift": {
        "protocol": [
            {"kind": "hold", "name": "a", "duration": TIME / 2},
            {"kind": "lift", "name": "b", "by": "0.2 D"},
            {"kind": "free", "name": "c", "duration": TIME / 2},
        ]
    },
    "until rest": stage("free", until="rest"),
}


@pytest.mark.parametrize("name", SCENES)
def test_error_of_the_energy_balance_is_of_second_order_in_the_step(name: str) -> None:
    """Half the step gives a quarter of the error.

    With a wrong sign or factor in the balance, the error would fall to a half, or not at all.
    """
    scene = small(**SCENES[name])
    # The far field acts eight steps at once there: at `STEP` its higher orders still make 3 %.
    step = STEP / 2 if name == "mesh" else STEP
    long = "protocol" in SCENES[name] or "contact" in name
    time = TIME if long else TIME / 2
    integer, half = (residual(run(scene, dt, time=time)) for dt in (step, step / 2))
    assert 0.0 < integer < 1e-4
    assert integer / half == pytest.approx(4.0, abs=0.1)


def test_regularised_friction_agrees_with_coulomb_friction_at_high_speed() -> None:
    """The speed is far above the threshold of the regularisation."""
    speeds = []
    for scheme in ("velocity", "regularised"):
        alone = small(
            **{
                "grains.count": 1,
                "effects": {"friction": {"load": 0.01, "scheme": scheme}},
                "arrangement": {"positions": [["3 D", "3 D"]], "velocities": [[0.1, 0.0]]},
            }
        )
        speeds.append(float(run(alone).dataset["velocity"].values[-1, 0, 0]))
    assert 0.0 < speeds[0] < 0.1
    assert speeds[0] == pytest.approx(speeds[1], rel=1e-6)


@pytest.mark.parametrize("energy", ["k*y*sqrt(1 - t/s)", "k*y*(1 + sqrt(1 - t/s))"])
def test_error_for_a_formula_that_gives_nan_names_the_formula_and_not_the_time_step(energy: str) -> None:
    field = [{"energy": energy, "k": "1 uN", "s": f"{10 * STEP} s"}]
    with pytest.raises(NotFiniteError, match="correct the formula of 'field': its value is not a number"):
        run(small(**{"effects.field": field}), "auto")


LISTED = {"pairs": {"method": "verlet-list", "cut_off": "3 D", "skin": "0.05 D"}}
"""A list that is rebuilt while grains cross its radius."""


@pytest.mark.parametrize(
    ("changes", "steps", "words"),
    [
        ({}, 1, None),
        ({}, 4, "shorten dt"),
        ({"effects.friction": {}}, 4, "shorten dt"),
        ({"effects.friction.scheme": "regularised"}, 4, None),
        ({"effects.friction": {}, "pairs.method": "verlet-list"}, 4, None),
        (LISTED, 0.5, "or use pairs.method = 'direct'"),
    ],
)
def test_large_error_of_the_energy_balance_is_reported(
    changes: dict[str, Any], steps: float, words: str | None
) -> None:
    """The limit is 1e-4, or 1e-2 with regularised friction or the Verlet list."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        off = residual(run(small(**changes), steps * STEP))
    told = [str(one.message) for one in said if "energy balance is off" in str(one.message)]
    assert (off > 1e-4) == (steps != 1)
    assert len(told) == (words is not None)
    assert words is None or words in told[0]


@pytest.mark.filterwarnings("ignore:the energy balance is off")
def test_shorter_steps_do_not_reduce_the_error_of_the_verlet_list() -> None:
    """Pairs that enter or leave the list change the energy abruptly."""
    listed = [residual(run(small(**LISTED), dt)) for dt in (STEP / 2, STEP / 4)]
    assert min(listed) > 100.0 * residual(run(small(), STEP / 2))


FARTHEST = {1: 3e-3, 2: 1e-5, 4: 1e-8, 6: 1e-12, 8: 1e-12}
"""Allowed distance between final and exact positions [D], by the order of the method."""


@pytest.fixture(scope="module")
def exact() -> np.ndarray:
    return final(run(small(), STEP / 2, "kahan-li-8", TIME / 2))


@pytest.mark.parametrize("name", METHODS)
def test_all_integration_methods_converge_to_the_same_positions(name: str, exact: np.ndarray) -> None:
    method = METHODS[name]
    dt = "auto/2" if method.variable else STEP / 8 if method.order == 1 else STEP
    way = np.abs(final(run(small(), dt, name, TIME / 2)) - exact).max() / 0.006
    assert way < FARTHEST[method.order]


def test_compensated_sums_change_only_the_last_bits_of_positions() -> None:
    names = ("stormer-verlet", f"stormer-verlet{COMPENSATED}")
    plain, compensated = (final(run(small(), STEP, name)) for name in names)
    assert 0.0 < np.abs(compensated - plain).max() < 1e-15


def test_resumed_run_with_compensated_sums_is_bit_identical(tmp_path: Path) -> None:
    scene, method = small(), f"stormer-verlet{COMPENSATED}"
    whole = run(scene, method=method)
    for time in (0.37 * TIME, TIME):
        parts = simulate(scene, dt=STEP, t_end=time, method=method, out=tmp_path, resume=True, progress=False)
    assert parts.dataset.equals(whole.dataset)


def test_the_end_of_a_stage_at_a_given_force_does_not_depend_on_the_frame_interval() -> None:
    """The time loop is called for each frame, and the stage ends in the first or a later call."""
    ends = []
    for frames in (3, 40):
        scene = small(
            **stage("move", to="4 D", speed="0.5 m/s", until_force=0.87),
            output={"scalars": STEP, "frames": frames * STEP},
        )
        trajectory = simulate(scene, STEP, progress=False)
        force = trajectory.dataset["piston_force"].values
        assert (force[:-1] < 0.87).all()
        assert force[-1] >= 0.87
        assert trajectory.stages[0].reason == "force"
        assert trajectory.stages[0].end == pytest.approx(STEP * (len(force) - 1))
        ends.append(len(force) - 1)
    assert 3 < ends[0] == ends[1] < 40


def test_a_grain_that_leaves_is_removed_with_all_its_values(tmp_path: Path) -> None:
    """Two of four grains, of two species and with friction, leave through a gap one after the other."""
    scene = small(
        **SPECIES,
        **{
            "grains.count": 4,
            "effects.friction": {},
            "effects.walls.bottom": {"law": "slab", "gap_start": "1 D", "gap_end": "5 D"},
            "arrangement": {
                "positions": [["3 D", "1 D"], ["1 D", "4.5 D"], ["3 D", "3 D"], ["5 D", "4.5 D"]],
                "velocities": [[0.0, -10.0], [0.0, 0.0], [0.0, -10.0], [0.0, 0.0]],
            },
            "output": {"scalars": 10 * STEP, "frames": 10 * STEP},
        },
    )
    trajectory = simulate(scene, STEP, t_end=300 * STEP, progress=False)
    data = trajectory.dataset
    assert data["time"].values == pytest.approx(10 * STEP * np.arange(31))
    assert data["frame_time"].values == pytest.approx(10 * STEP * np.arange(31))
    assert data["grain_count"].values[0] == 4
    assert data["grain_count"].values[-1] == 2
    gone = np.isnan(data["position"].values[:, :, 0])
    assert list(gone[-1]) == [True, False, True, False]
    leaving = [int(np.flatnonzero(gone[:, grain])[0]) for grain in (0, 2)]
    assert 0 < leaving[0] < leaving[1]
    for end in (10 * leaving[0] + 5, 300):
        parts = simulate(scene, STEP, t_end=end * STEP, out=tmp_path, resume=True, progress=False)
    assert parts.dataset.equals(data)
    stays = data["position"].values[:, [1, 3]]
    assert np.abs(np.diff(stays, axis=0)).max() < 1e-3
    assert residual(trajectory) < 1e-4


def test_runge_kutta_methods_record_the_work_on_a_driven_piston() -> None:
    """The energy of the lifted piston, including its weight, changes by this work."""
    scene = small(
        **{
            "effects.gravity": {},
            "protocol": [{"kind": "move", "name": "up", "to": "6.2 D", "speed": "0.25 D/ms"}],
        }
    )
    driven = run(scene, method="runge-kutta-4")
    lifted = float(np.ptp(driven.dataset["piston_height"].values))
    assert lifted > 0.1 * 0.006
    assert driven.dataset["piston_energy"].values[-1] > 0.0
    assert residual(driven) < 1e-4


def test_runge_kutta_methods_move_a_shaken_free_piston() -> None:
    scene = small(
        **stage("free", duration=TIME),
        **{"effects.gravity": {}, "effects.shaking": {"amplitude": "0.5 mm", "frequency": 100.0}},
    )
    other, verlet = run(scene, method="runge-kutta-4"), run(scene, dt=STEP / 4)
    heights = verlet.dataset["piston_height"].values
    still = run(scene.replace(**{"effects.shaking": None}), dt=STEP / 4).dataset["piston_height"].values
    assert np.abs(heights - still).max() > 1e-5
    np.testing.assert_allclose(other.dataset["piston_height"].values, heights, rtol=0.0, atol=2e-9)
    np.testing.assert_allclose(final(other), final(verlet), rtol=0.0, atol=5e-9)
    assert residual(other) < 1e-10


def test_drag_loss_is_correct_with_and_without_regularised_friction() -> None:
    """The reference is the closed form for a grain that falls through a liquid without friction."""
    scene = small(
        **{
            "grains.count": 1,
            "effects": {
                "gravity": {"acceleration": 9.8},
                "drag": {"coefficient": "0.5 kg/s"},
                "friction": {"scheme": "regularised", "load": 0.0},
            },
            "arrangement.positions": [["3 D", "4 D"]],
            "arrangement.height": None,
            "arrangement.speed": 0.0,
            "piston": "none",
        }
    )
    fallen = run(scene, dt=10 * STEP).dataset
    mass, g = float(scene.grains.masses()[0]), 9.8
    rate = 0.5 / mass
    t = float(fallen["time"].values[-1])
    left = np.exp(-rate * t)
    assert fallen["velocity"].values[-1, 0, 1] == pytest.approx(-g / rate * (1.0 - left), rel=1e-9)
    lost = mass * g**2 / rate**2 * (rate * t - 2.0 * (1.0 - left) + 0.5 * (1.0 - left**2))
    assert fallen["drag_loss"].values[-1] == pytest.approx(lost, rel=1e-6)


EDDY = {"conductivity": 59.6e6, "thickness": 5e-3, "distance": 2.5e-3, "plates": 2}


@pytest.mark.parametrize(
    ("drag", "eddy"),
    [(0.1, None), (0.0, {**EDDY, "mutual": False}), (0.0, {**EDDY, "mutual": True})],
    ids=["drag", "eddy currents", "mutual eddy currents"],
)
def test_unequal_grains_with_dissipation_agree_with_independent_equations(
    drag: float, eddy: dict[str, Any] | None
) -> None:
    """The reference is DOP853 with pair forces. The loss equals the decrease of the energy."""
    effects = {"effects.drag": {"coefficient": drag} if drag else None, "effects.eddy": eddy}
    scene = small(**SPECIES, **stage("hold", duration=TIME), **effects)
    coarse, fine = run(scene), run(scene, dt=STEP / 2)
    case = Case(
        diameters=scene.grains.diameters(),
        positions=fine.dataset["position"].values[0],
        velocities=fine.dataset["velocity"].values[0],
        width=scene.cell.width,
        height=0.036,
        mass=0.01,
        piston_drag=0.0,
        drag=drag,
        weight=scene.effects.gravity is not None,
        springs=(),
        host={},
        stages=({"kind": "hold", "duration": TIME},),
        eddy=eddy,
    )
    exact, free = solve(case), solve(dataclasses.replace(case, drag=0.0, eddy=None))
    assert np.abs(exact["position"] - free["position"]).max() > 1e-3 * 0.006
    # The step errs by 2e-8 m, its square by 1e-11 m.
    found = (4.0 * final(fine) - final(coarse)) / 3.0
    np.testing.assert_allclose(found, exact["position"], rtol=0.0, atol=1e-10)
    data = fine.dataset
    energy = np.sum([data[name].values for name in data if str(name).endswith("_energy")], axis=0)
    lost = data["drag_loss" if drag else "eddy_loss"].values[-1]
    assert lost == pytest.approx(energy[0] - energy[-1], rel=1e-3)
