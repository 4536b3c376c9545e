"""Convergence of second order with dissipation and jumps; bit-identical runs with rebuilt pair lists."""

from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import Scene, load_scene, simulate
from granular.effects.effect import EFFECTS
from granular.effects.excitation import HostExcitation, excitation_force_or_acceleration
from granular.engine import time_step
from granular.schema.natural_units import Scales
from tests.plain_python.test_drawn_scenes import FORMULA
from tests.plain_python.test_every_effect import EXAMPLES, NAMES, STEP, small

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

DASHPOT = {
    "mount": "cell",
    "bodies": [{"mass": "0.1 kg", "stiffness": "400 N/m", "damping": "200 kg/s"}],
    "excitation": {"kind": "sine", "force": "20 N", "frequency": "300 Hz"},
}
DISSIPATIVE: dict[str, dict[str, Any]] = {
    "contact": {},
    "drag": {"effects.drag": {"coefficient": "1 kg/s"}},
    "friction": {"effects.friction": {"load": "20 mN"}, "arrangement.speed": "150 D/s"},
    "friction with drag": {
        "effects.friction": {"load": "20 mN"},
        "arrangement.speed": "150 D/s",
        "effects.drag": {"coefficient": "1 kg/s"},
    },
    "wall_friction": {"effects.wall_friction": {"coefficient": 0.3}, "arrangement.speed": "150 D/s"},
    "eddy": {"effects.eddy": EXAMPLES["eddy"] | {"mutual": False}},
    "mutual eddy": {"effects.eddy": EXAMPLES["eddy"] | {"mutual": True}},
    "mud": {"effects.mud": {"gamma": "1 kg/s"}},
    "oil": {"effects.oil": {"drag": "1 kg/s"}},
    "host": {"effects.host": DASHPOT},
    "drag of the piston": {"piston.mass": "20 g", "piston.drag": "10 kg/s"},
    "friction of the piston": {"piston.mass": "20 g", "piston.friction": "0.5 N"},
}
"""So strong that each takes a visible part of the energy within a few steps."""


def dissipating(name: str) -> Scene:
    """Return nine moving grains, with a free piston if the piston dissipates."""
    scene = small("walls", **DISSIPATIVE[name])
    if name == "contact":  # of two grains, as long as the run
        scene = with_touching_grains(scene.replace(**{"effects.contact": {"modulus": "5 MPa"}}), 0.92)
    if "piston" in name:
        scene = scene.replace(protocol=[{"name": "rise", "kind": "free", "duration": 1.0}])
    return scene


def with_touching_grains(scene: Scene, near: float) -> Scene:
    """Return a scene with the second grain at a given distance from the first, relative to the contact
    distance.
    """
    start, velocities = scene.initial_positions_and_velocities()
    way = start[1] - start[0]
    start[1] = start[0] + near * scene.grains.diameters()[:2].mean() * way / np.hypot(*way)
    return scene.replace(arrangement={"positions": start.tolist(), "velocities": velocities.tolist()})


def test_the_convergence_test_includes_every_dissipative_effect() -> None:
    """The exception is the Langevin bath, whose order is defined only for averages (see test_bath)."""
    named = {
        key.split(".")[1] for changes in DISSIPATIVE.values() for key in changes if key[:8] == "effects."
    }
    damping = {name for name in NAMES if EFFECTS[name].loss_record is not None}
    assert damping - named - {"contact", "bath"} == set()


@pytest.mark.parametrize("name", DISSIPATIVE)
def test_positions_converge_with_order_two_for_every_dissipative_effect(name: str) -> None:
    scene = dissipating(name)
    end = (2 if name == "contact" else 8) * STEP
    runs = [simulate(scene, dt=STEP / k, t_end=end, progress=False) for k in (2, 4, 8)]
    losses = [str(one) for one in runs[0].dataset if str(one).endswith("_loss")]
    lost = sum(float(runs[0].dataset[one].values[-1]) for one in losses)
    assert lost > 1e-4 * float(runs[0].dataset["kinetic_energy"].values[0])
    ends = [
        np.append(run.dataset["position"].values[-1], run.dataset["velocity"].values[-1] * 1e-3)
        for run in runs
    ]
    coarse, fine = (float(np.linalg.norm(ends[k] - ends[k + 1])) for k in (0, 1))
    assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.02)


BIG_CELL = {"cell": {"width": "12 D", "height": "11 D", "sides": "periodic"}, "piston": "none"}
TOUCHING = {"effects.contact": {"modulus": "500 MPa", "restitution": 0.5}, "arrangement.speed": "600 D/s"}
DISCS = {"grains.magnets": "cylinders", "grains.spread": 0.05}
PAIR_LAW = {"energy": "a*q1*q2*exp(-r/l)", "a": "30 uJ", "l": "3 mm", "reach": "3 D"}
PERIODIC: dict[str, Any] = BIG_CELL | {"grains.count": 30, "arrangement.height": None}
RESUMED: dict[str, dict[str, Any]] = {
    "own pair law": {"effects.bumpers": {"k": "20 N/m", "end": "2 D"}, "arrangement.speed": "600 D/s"},
    "formula pair law": {"effects.pair_law": [PAIR_LAW], "arrangement.speed": "600 D/s"},
    "discs by mesh": {"pairs.method": "mesh", **DISCS, **TOUCHING},
    "discs by cut-off": {"pairs": {"method": "cut-off", "cut_off": "5 D"}, **DISCS, **TOUCHING},
    "contact and discs, periodic": PERIODIC | {"effects": {"dipole": True}} | DISCS | TOUCHING,
    "own pair law, periodic": PERIODIC
    | {"effects": {"dipole": True, "bumpers": {"k": "20 N/m", "end": "2 D"}}, "arrangement.speed": "600 D/s"},
    "formula pair law, periodic": PERIODIC
    | {"effects": {"dipole": True, "pair_law": [PAIR_LAW]}, "arrangement.speed": "600 D/s"},
    "pair law with a tail by mesh": {
        "effects.dipole": None,
        "effects.pair_law": [FORMULA],
        "pairs.method": "mesh",
        "arrangement.speed": "600 D/s",
    },
}
"""Grains so fast that lists of near pairs are made again before and behind the pause."""
LATER = ("formula pair law", "discs by mesh", "discs by cut-off", "own pair law, periodic")
TIME = 24 * STEP


@pytest.mark.filterwarnings("ignore:the energy balance is off")
def test_drag_added_to_the_force_sum_converges_with_order_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The result shows that the other tests would detect an error of first order.

    Only plain Python allows a term to be added to the force sum.
    """
    start = {"arrangement.positions": [["30 D", "3 D"]], "output.scalars": 0.02, "output.frames": 0.02}
    scene = load_scene("single-particle").replace(**start)
    drag = scene.replace(**{"effects.drag.coefficient": 0.2}).effects.drag
    assert drag is not None
    rate, steps = drag.decay_rate(Scales.from_grains(scene.grains)), (2e-4, 1e-4, 5e-5, 2.5e-5)

    def smuggle(name: str) -> None:
        compute = getattr(time_step, name)

        def forces(bed: Any, *more: object) -> int:
            outside = compute(bed, *more)
            count = bed.constants.grains
            bed.state.fx[:count] -= rate * bed.state.vx[:count]
            bed.state.fy[:count] -= rate * bed.state.vy[:count]
            return int(outside)

        monkeypatch.setattr(time_step, name, forces)

    smuggle("compute_forces")
    smuggle("compute_and_measure_forces")
    monkeypatch.setattr("granular.engine.state.WRONG", np.inf)  # the ledger knows nothing of this loss
    ends = [simulate(scene, dt, 0.02, progress=False).dataset["position"].values[-1, 0, 1] for dt in steps]
    order = np.polyfit(np.log(steps[:-1]), np.log(np.abs(np.diff(ends))), 1)[0]
    assert order == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.long if one in LATER else ()) for one in RESUMED]
)
def test_runs_are_bit_identical_although_lists_of_near_pairs_are_rebuilt_on_resuming(
    name: str, tmp_path: Path
) -> None:
    check_bits(name, tmp_path)


def check_bits(name: str, out: Path) -> None:
    """Assert that a run in three parts is bit-identical to the given run.

    If threads are available, a run on two threads must be too.
    """
    scene = small("walls", **RESUMED[name])
    if scene.effects.contact is not None:
        scene = with_touching_grains(scene, 0.99)
    whole = simulate(scene, dt=STEP / 4, t_end=TIME, progress=False)
    moved = whole.dataset["position"].values[-1] - scene.initial_positions_and_velocities()[0]
    assert np.abs(moved).max() > 0.5 * scene.grains.species[0].diameter
    if scene.effects.contact is not None:
        assert float(whole.dataset["contact_loss"].values[-1]) > 0.0
    for end in (0.3 * TIME, 0.7 * TIME, TIME):
        parts = simulate(scene, dt=STEP / 4, t_end=end, out=out, resume=True, progress=False)
    assert parts.dataset.equals(whole.dataset)
    if not numba.config.DISABLE_JIT:  # if threads are available
        two = simulate(scene, dt=STEP / 4, t_end=TIME, threads=2, progress=False)
        assert two.dataset.equals(whole.dataset)


START, SPAN = 0.10002, 0.40003
"""[s]: no step ends at the beginning or end of the drive."""

JUMPS: dict[str, dict[str, Any]] = {
    "sweep": {"kind": "sweep", "force": 2.0, "frequency": 1.0, "to": 5.0},
    "moved base": {"kind": "sweep", "displacement": 0.01, "frequency": 1.0, "to": 5.0},
    "noise": {"kind": "noise", "force": 2.0, "frequency": 1.0, "to": 9.0},
    "table": {
        "kind": "table",
        "force": 2.0,
        "times": tuple(np.linspace(0.0, SPAN, 4)),
        "values": (1.0, 2.0, 0.5, 1.0),
    },
}


@pytest.mark.parametrize("name", JUMPS)
def test_convergence_is_of_order_two_even_if_a_driving_force_jumps_within_a_step(name: str) -> None:
    mass, stiffness, damping, end = 2.0, 800.0, 3.0, 0.6
    words = JUMPS[name] | {"start": START} | ({} if name == "table" else {"duration": SPAN})
    drive = HostExcitation(**words)
    body = {"mass": mass, "stiffness": stiffness, "damping": damping}
    scene = load_scene("bed").replace(
        **{
            "grains.count": 0,
            "effects": {"host": {"bodies": [body]}},
            "effects.host.excitation": drive.to_plain(),
            "output": {"scalars": end, "frames": end},
            "protocol": [{"name": "shake", "kind": "hold", "duration": end}],
        }
    )
    scales = Scales.from_grains(scene.grains)
    natural = drive.make_kernel_law(scales)
    size = -scales.acceleration * mass if natural.moves_base else scales.force

    def rate(t: float, y: np.ndarray, first: float, last: float) -> list[float]:
        inside = min(max(t, first + 1e-9), last - 1e-9)
        force = size * excitation_force_or_acceleration(natural, inside / scales.time)
        return [y[1], (force - stiffness * y[0] - damping * y[1]) / mass]

    state = np.zeros(2)
    for part in ((0.0, START), (START, START + SPAN), (START + SPAN, end)):
        state = solve_ivp(rate, part, state, args=part, rtol=1e-10, atol=1e-13).y[:, -1]
    steps = (4e-3, 2e-3, 1e-3)
    off = [
        abs(simulate(scene, dt, progress=False).dataset["host_displacement"].values[-1] - state[0])
        for dt in steps
    ]
    assert float(np.polyfit(np.log(steps), np.log(off), 1)[0]) == pytest.approx(2.0, abs=0.15)
