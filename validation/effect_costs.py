"""The timer of steps, and the cost of each effect of a scene.

An effect is added to nothing, and taken away from the whole.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any

import numba
import numpy as np

from granular.engine.step_size import StepSchedule
from granular.run.engines import NO_TICKS, Ticks, advance
from granular.run.plan import plan
from granular.run.protocol_runner import ProtocolRunner
from granular.run.summary import active_effect_names
from granular.scene.scene import Scene
from granular.shared.errors import GranularError

STEP = 0.02
"""Time step of bare steps [tau]."""


class EngineSteps:
    """A run of the engine whose bare steps can be called: one tick without records."""

    def __init__(self, scene: Scene, threads: int = 1, step: float = STEP) -> None:
        self.threads, self.step = threads, step
        self.run = ProtocolRunner(plan(scene, threads=threads))
        self.run.begin_stage()
        self.watch = self.run.stop_criteria()._replace(stiff=math.inf, rest=-1.0)

    def make_steps(self, steps: int) -> None:
        """Make that many steps, and check the state at their end."""
        numba.set_num_threads(self.threads)
        schedule = StepSchedule(steps * self.step, self.step, 1, 1, steps, 0)
        run, window = self.run, NO_TICKS._replace(ticks=1)
        ticks = Ticks(window, schedule, run.tables, run.motion, run.measurement, self.watch)
        advance(run.system, run.state, ticks)


STILL = 1e-5
"""Time step [tau]: so short that grains stay in the cell, also without walls."""

ROUNDS = 40
# About the time of one timing [s]: a million times the clock's resolution, and short against what disturbs
# the machine.
BURST = 4e-3

_HELD: dict[str, Any] = {
    "protocol": [{"kind": "hold", "name": "hold", "duration": 60.0}],
    "output.record": None,
}
"""A piston that is held needs no wall to be pushed by."""

SUMS = ("direct", "cut-off", "mesh")

FULL, NOTHING = "all effects", "no effect"

AGREE = 0.2
"""Fraction of the greater one by which the two prices of an effect may differ to be called one."""


def effect_costs(scene: Scene, rounds: int = ROUNDS, workers: int = 2) -> dict[str, Any]:
    """Cost of a step of a scene, by effect and by sum over pairs [us]."""
    # Steps are timed in turn, so that a slow minute of the machine hits all alike; the cost is the median
    # over the rounds of the difference of two steps timed in one round.
    names = active_effect_names(scene)
    held = scene.replace(**_HELD)
    builds = _scenes_to_time(held, names)
    if workers > 1:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            list(pool.map(_compile_engine, builds.values()))
    calls, steps = _calls_of_equal_duration(builds)
    seconds = _time_calls(calls, rounds)
    value = {name: 1e6 * values / steps[name] for name, values in seconds.items()}
    rows = []
    for name in names:
        first = _median_difference("first", value.get(f"{name} alone"), value[NOTHING])
        last = _median_difference("last", value[FULL], value.get(f"without {name}"))
        rows.append({"effect": name, **first, **last})
    return {
        "scene": scene.name,
        "grains": scene.grains.count,
        "step": float(np.median(value[FULL])),
        "nothing": float(np.median(value[NOTHING])),
        "effects": rows,
        "sums": {name: float(np.median(value[name])) for name in SUMS if name in value},
    }


def _scenes_to_time(scene: Scene, names: tuple[str, ...]) -> dict[str, Scene]:
    """Scenes to time; those that cannot be run are left out."""
    none = {f"effects.{name}": None for name in names}
    wanted: dict[str, dict[str, Any]] = {NOTHING: none, FULL: {}}
    for name in names:
        wanted[f"{name} alone"] = {key: None for key in none if key != f"effects.{name}"}
    wanted |= {f"without {name}": {f"effects.{name}": None} for name in names}
    wanted |= {name: {"pairs.method": name} for name in SUMS}
    result = {}
    for name, changes in wanted.items():
        with contextlib.suppress(GranularError):  # such as of the mesh without four walls
            result[name] = scene.replace(**changes)
    return result


def _compile_engine(scene: Scene) -> None:
    EngineSteps(scene, step=STILL).make_steps(1)


def _calls_of_equal_duration(
    builds: Mapping[str, Scene],
) -> tuple[dict[str, Callable[[], None]], dict[str, int]]:
    """Return the calls that take about `BURST` each, and the steps of each."""
    calls: dict[str, Callable[[], None]] = {}
    steps: dict[str, int] = {}
    for name, scene in builds.items():
        engine = EngineSteps(scene, step=STILL)
        engine.make_steps(16)
        started = time.thread_time()
        engine.make_steps(64)
        steps[name] = max(16, math.ceil(64 * BURST / (time.thread_time() - started)))
        calls[name] = partial(engine.make_steps, steps[name])
    return calls, steps


def _time_calls(calls: Mapping[str, Callable[[], None]], rounds: int) -> dict[str, np.ndarray]:
    """Seconds of processor time of each call in each round: other programs take none of it."""
    result = {name: np.empty(rounds) for name in calls}
    for k in range(rounds):
        for name, call in calls.items():
            started = time.thread_time()
            call()
            result[name][k] = time.thread_time() - started
    return result


def _median_difference(name: str, more: np.ndarray | None, less: np.ndarray | None) -> dict[str, float]:
    """Median of the differences of pairs, and half its 95 % interval; NaN without a pair."""
    if more is None or less is None:
        return {name: math.nan, f"{name}_doubt": math.nan}
    off = more - less
    quarters = np.percentile(off, [25.0, 75.0])
    doubt = 1.57 * (quarters[1] - quarters[0]) / math.sqrt(len(off))
    return {name: float(np.median(off)), f"{name}_doubt": float(doubt)}


def first_and_last_costs_agree(row: Mapping[str, Any]) -> bool:
    """Tell if an effect costs the same first and last, within a fifth; row [us]."""
    first, last = row["first"], row["last"]
    return bool(abs(first - last) <= AGREE * max(abs(first), abs(last)))
