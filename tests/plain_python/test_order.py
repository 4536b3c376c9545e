"""A drive that jumps within a step keeps the second order of Verlet's method."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import load_scene, simulate
from granular.effects.excitation import Excitation, evaluate_excitation
from granular.schema.natural_units import Scales

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
