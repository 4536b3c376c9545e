"""The engine's bare steps, for the benchmark."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from granular.engine.columns import width
from granular.engine.loop import Window, advance
from granular.engine.step_size import Pace, Step
from granular.engine.system import natural_system
from granular.methods import method_named
from granular.pairs.section import METHODS
from granular.run.run import Run
from granular.run.watch import watch_of
from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from validation.benchmark.hand import Bed

STEP = 0.02
"""Time step [tau]."""

PAIR_METHODS = tuple(name for name in METHODS if name != "auto")
"""Every way of summing pairs that a scene can name."""


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

    def __init__(self, scene: Scene, threads: int = 1, step: float = STEP) -> None:
        method = method_named("stormer-verlet")
        system = natural_system(scene, threads=threads, method=method)
        self.threads, self.step = threads, step
        self.run = Run(scene, system, method, Step(), None)
        self.run.begin_stage()
        self.watch = watch_of(self.run)._replace(stiff=math.inf, rest=-1.0)
        self.rows = np.zeros((3, width(len(system.effects))))

    def make(self, steps: int) -> None:
        """That many steps, and the look at their end."""
        numba.set_num_threads(self.threads)
        pace = Pace(steps * self.step, self.step, 1, 1, steps, 0)
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
