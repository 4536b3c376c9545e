"""What would cost Verlet's method its second order: drag in the force sum, a drive that jumps.

Run with ``NUMBA_DISABLE_JIT=1``, as `tests/architecture/test_plain_python.py` does: only there can
a test put something into the force sum of the loop.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import granular.engine.energy_ledger
import granular.engine.time_step
from granular import Scene, load_scene, simulate
from granular.effects.excitation import Excitation, evaluate_excitation
from granular.kernel_data.state import Bed
from granular.schema.natural_units import Scales

pytestmark = pytest.mark.skipif(not numba.config.DISABLE_JIT, reason="only where numba does not compile")

COEFFICIENT = 0.2
"""[kg/s]: a grain loses a third of its speed in the time of a run."""

TIME = 0.02
STEPS = (2e-4, 1e-4, 5e-5, 2.5e-5)


def bouncing(coefficient: float) -> Scene:
    """A grain that falls on the bottom and comes up again."""
    return load_scene("single-particle").replace(
        **{
            "arrangement.positions": [["30 D", "3 D"]],
            "effects.drag.coefficient": coefficient,
            "output.scalars": TIME,
            "output.frames": TIME,
        }
    )


def slope(scene: Scene) -> float:
    """Order by the differences of steps that halve."""
    ends = [simulate(scene, dt, TIME, progress=False).dataset["position"].values[-1, 0, 1] for dt in STEPS]
    return float(np.polyfit(np.log(STEPS[:-1]), np.log(np.abs(np.diff(ends))), 1)[0])


def smuggled(compute: Callable[..., int], rate: float) -> Callable[..., int]:
    """The engine's force sum, with drag in it."""

    def forces(bed: Bed, *more: object) -> int:
        outside = compute(bed, *more)
        state, count = bed.state, bed.constants.grains
        state.fx[:count] -= rate * state.vx[:count]
        state.fy[:count] -= rate * state.vy[:count]
        return outside

    return forces


def test_drag_as_a_flow_of_its_own_keeps_order_two() -> None:
    assert slope(bouncing(COEFFICIENT)) == pytest.approx(2.0, abs=0.05)


@pytest.mark.filterwarnings("ignore:the energy ledger is off")
def test_drag_in_the_force_sum_has_order_one(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = bouncing(COEFFICIENT)
    assert scene.effects.drag is not None
    rate = scene.effects.drag.decay_rate(Scales.from_grains(scene.grains))
    for name in ("compute_forces", "compute_and_measure_forces"):
        compute = getattr(granular.engine.time_step, name)
        monkeypatch.setattr(granular.engine.time_step, name, smuggled(compute, rate))
    monkeypatch.setattr(granular.engine.energy_ledger, "WRONG", np.inf)  # it knows nothing of this loss
    assert slope(bouncing(0.0)) == pytest.approx(1.0, abs=0.1)


START, SPAN = 0.10002, 0.40003
"""[s]: no step ends where the drive begins or ends."""

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
def test_a_drive_that_jumps_within_a_step_keeps_order_two(name: str) -> None:
    mass, stiffness, damping, end = 2.0, 800.0, 3.0, 0.6
    words = JUMPS[name] | {"start": START} | ({} if name == "table" else {"duration": SPAN})
    drive = Excitation(**words)
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
    size = -scales.acceleration * mass if natural.base else scales.force

    def rate(t: float, y: np.ndarray, first: float, last: float) -> list[float]:
        inside = min(max(t, first + 1e-9), last - 1e-9)
        force = size * evaluate_excitation(natural, inside / scales.time)
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
