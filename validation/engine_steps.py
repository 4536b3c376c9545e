"""The timer of steps: a run of the engine whose bare steps can be called."""

from __future__ import annotations

import math

import numba
import numpy as np

from granular.engine.columns import width
from granular.engine.loop import Window, advance
from granular.engine.step_size import Pace, Step
from granular.methods import method_named
from granular.run.run import Run
from granular.scene.scene import Scene
from granular.scene.system import natural_system

STEP = 0.02
"""Time step [tau]."""


class EngineSteps:
    """A run of the engine whose bare steps can be called: one tick without records."""

    def __init__(self, scene: Scene, threads: int = 1, step: float = STEP) -> None:
        method = method_named("stormer-verlet")
        system = natural_system(scene, threads=threads, method=method)
        self.threads, self.step = threads, step
        self.run = Run(scene, system, method, Step(), None)
        self.run.begin_stage()
        self.watch = self.run.stop_criteria()._replace(stiff=math.inf, rest=-1.0)
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
