"""Cost of an absent effect: the engine against handwritten steps without it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.engine import bed_of
from benchmarks.handwritten_steps import KERNELS, Bed
from benchmarks.timing import minimum_seconds
from granular.effects.effect import DissipativeEffect
from validation.overview import STEP, EngineSteps


def hand_and_engine(
    scenery: str, count: int, steps: int
) -> tuple[Bed, EngineSteps, dict[str, Callable[[], None]]]:
    """Return a bed for handwritten steps, the same for the engine, and the calls that advance each."""
    kernel, changes = KERNELS[scenery]
    engine = EngineSteps(bed_of(count, changes))
    system, bed = engine.run.system, bed_by_hand(engine)
    flows = (effect for effect in system.effects if isinstance(effect, DissipativeEffect))
    rate = sum(flow.decay_rate(system.scales) for flow in flows)
    calls = {
        "by hand": lambda: kernel(bed, system.downward_acceleration, rate, STEP, steps),
        "engine": lambda: engine.make_steps(steps),
    }
    return bed, engine, calls


def cost_of_absence(
    counts: tuple[int, ...] = (92, 368), *, steps: int = 4096, rounds: int = 12
) -> list[dict[str, Any]]:
    """Return the time of a step by the engine and by hand [s], and their ratio, one row each."""
    rows = []
    for scenery in KERNELS:
        for count in counts:
            _, _, calls = hand_and_engine(scenery, count, steps)
            result = minimum_seconds(calls, rounds=rounds)
            hand, engine = result["by hand"] / steps, result["engine"] / steps
            rows.append(
                {
                    "effects": scenery,
                    "grains": count,
                    "by hand": hand,
                    "engine": engine,
                    "ratio": engine / hand,
                }
            )
    return rows


def bed_by_hand(engine: EngineSteps) -> Bed:
    """Return a copy of the state for the handwritten steps."""
    state, constants = engine.run.state, engine.run.grain_constants
    return Bed(
        x=state.x.copy(),
        y=state.y.copy(),
        vx=state.vx.copy(),
        vy=state.vy.copy(),
        fx=state.fx.copy(),
        fy=state.fy.copy(),
        push=np.zeros_like(state.x),
        totals=np.zeros(5),
        grains=constants.grains,
        width=-constants.acting.sides[1].offset,
        height=float(state.piston[0]),
    )
