"""The steps by hand that the engine is timed against are the same steps."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.absent_effect_cost import hand_and_engine
from benchmarks.handwritten_steps import KERNELS
from benchmarks.timing import least_seconds
from granular.kernel_data.state import LOSSES


@pytest.mark.parametrize(
    "scenery", [pytest.param(one, marks=() if "drag" in one else pytest.mark.long) for one in KERNELS]
)
def test_steps_by_hand_are_the_engine_s(scenery: str) -> None:
    bed, engine, calls = hand_and_engine(scenery, 92, 100)
    for call in calls.values():
        call()
    state = engine.run.state
    for name in ("x", "y", "vx", "vy"):
        np.testing.assert_array_equal(getattr(bed, name)[:92], getattr(state, name)[:92])
    np.testing.assert_array_equal(bed.totals[:4], state.wall_forces)
    assert bed.totals[4] == pytest.approx(state.ledger[LOSSES:].sum(), rel=1e-12)


def test_least_seconds_calls_each_as_often() -> None:
    counts = {"a": 0, "b": 0}

    def call(name: str) -> None:
        counts[name] += 1

    found = least_seconds({"a": lambda: call("a"), "b": lambda: call("b")}, rounds=3, seconds=0.0)
    assert set(found) == {"a", "b"}
    assert min(found.values()) > 0.0
    assert counts == {"a": 5, "b": 5}
