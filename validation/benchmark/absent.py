"""What an absent effect costs: the engine against steps written by hand without it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from granular.engine.loop import COLUMNS, Window, advance
from granular.engine.run import Run
from granular.engine.step_size import Pace, Step
from granular.engine.system import natural_system
from granular.methods import method_named
from granular.scene import Scene, load_scene
from validation.benchmark.hand import KERNELS, Bed
from validation.benchmark.timing import least_seconds

STEP = 0.02
"""Time step [tau]."""


def bed_of(count: int, changes: dict[str, Any]) -> Scene:
    """The packaged bed with that many grains, scaled to the same packing."""
    scale = math.sqrt(count / 368.0)
    shape = {
        "grains.count": count,
        "cell.width": f"{60.0 * scale} D",
        "piston.height": f"{20.0 * scale} D",
        "arrangement.height": f"{20.0 * scale - 1.0} D",
    }
    return load_scene("bed").replace(**shape, **changes)


class EngineSteps:
    """A run of the engine whose bare steps can be called: one tick without records."""

    def __init__(self, scene: Scene) -> None:
        system = natural_system(scene)
        self.run = Run(scene, system, method_named("stormer-verlet"), Step(), None)
        self.run.begin_stage()
        self.watch = self.run._watch()._replace(stiff=math.inf, rest=-1.0)
        self.rows = np.zeros((3, len(COLUMNS)))

    def make(self, steps: int) -> None:
        """That many steps, and the look at their end."""
        pace = Pace(steps * STEP, STEP, 1, 1, steps, 0)
        run = self.run
        advance(
            Window(0.0, 0.0, math.inf, 0, 1), pace, run.plan, run.state, run.constants,
            run.motion, run.measurement, self.watch, self.rows,
        )  # fmt: skip

    def bed(self) -> Bed:
        """A copy of the state for the steps by hand."""
        state, constants = self.run.state, self.run.constants
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
            width=constants.width,
            height=float(state.piston[0]),
        )


def hand_and_engine(
    scenery: str, count: int, steps: int
) -> tuple[Bed, EngineSteps, dict[str, Callable[[], None]]]:
    """A bed by hand, the same by the engine, and the calls that advance each."""
    kernel, changes = KERNELS[scenery]
    engine = EngineSteps(bed_of(count, changes))
    acting, bed = engine.run.constants.acting, engine.bed()
    gravity, rate = acting.gravity or 0.0, acting.drag or 0.0
    calls = {
        "by hand": lambda: kernel(bed, gravity, rate, STEP, steps),
        "engine": lambda: engine.make(steps),
    }
    return bed, engine, calls


def cost_of_absence(
    counts: tuple[int, ...] = (92, 368), *, steps: int = 4096, rounds: int = 12
) -> list[dict[str, Any]]:
    """Time of a step by the engine and by hand [s], and their ratio, a row each."""
    rows = []
    for scenery in KERNELS:
        for count in counts:
            _, _, calls = hand_and_engine(scenery, count, steps)
            found = least_seconds(calls, rounds=rounds)
            hand, engine = found["by hand"] / steps, found["engine"] / steps
            rows.append(
                {"effects": scenery, "grains": count, "by hand": hand, "engine": engine,
                 "ratio": engine / hand}
            )  # fmt: skip
    return rows
