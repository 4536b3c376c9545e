"""Drag in the engine's force sum costs Verlet's method its second order: the negative control.

Run with ``NUMBA_DISABLE_JIT=1``, as `tests/architecture/test_plain_python.py` does: only there can
a test put something into the force sum of the loop.
"""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np
import pytest

import granular.engine.ledger
import granular.engine.step
from granular import Scene, load_scene, simulate
from granular.engine.constants import Constants
from granular.engine.state import State
from granular.scene.scales import Scales

pytestmark = pytest.mark.skipif(
    not numba.config.DISABLE_JIT, reason="only where numba does not compile"
)

COEFFICIENT = 0.2
"""[kg/s]: a grain loses a third of its speed in the time of a run."""

TIME = 0.02
STEPS = (2e-4, 1e-4, 5e-5, 2.5e-5)


def bouncing(coefficient: float) -> Scene:
    """A grain that falls on the bottom and comes up again."""
    return load_scene("single-particle").replace(
        **{"arrangement.positions": [["30 D", "3 D"]], "effects.drag.coefficient": coefficient,
           "output.scalars": TIME, "output.frames": TIME}
    )  # fmt: skip


def slope(scene: Scene) -> float:
    """Order by the differences of steps that halve."""
    ends = [
        simulate(scene, dt, TIME, progress=False).dataset["position"].values[-1, 0, 1]
        for dt in STEPS
    ]
    return float(np.polyfit(np.log(STEPS[:-1]), np.log(np.abs(np.diff(ends))), 1)[0])


def smuggled(compute: Callable[..., int], rate: float) -> Callable[..., int]:
    """The engine's force sum, with drag in it."""

    def forces(state: State, constants: Constants, *more: object) -> int:
        outside = compute(state, constants, *more)
        count = constants.grains
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
    rate = scene.effects.drag.decay_rate(Scales.of(scene.grains))
    for name in ("compute_forces", "measure_forces"):
        compute = getattr(granular.engine.step, name)
        monkeypatch.setattr(granular.engine.step, name, smuggled(compute, rate))
    monkeypatch.setattr(granular.engine.ledger, "WRONG", np.inf)  # it knows nothing of this loss
    assert slope(bouncing(0.0)) == pytest.approx(1.0, abs=0.1)
