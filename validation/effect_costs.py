"""The timer of steps, and the cost of each effect of a scene.

An effect is added to nothing, and taken away from the whole.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any, NamedTuple

import numba
import numpy as np

from granular.engine.step_size import StepSchedule
from granular.run.engines import NO_TICKS, Ticks, advance
from granular.run.plan import plan
from granular.run.protocol_runner import ProtocolRunner
from granular.run.summary import active_effect_names
from granular.scene.scene import Scene
from granular.shared.blocks import Block, Heading, Table, Text
from granular.shared.errors import GranularError
from validation.report_tasks import PlainData

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


class EffectCost(NamedTuple):
    """Cost of an effect added first and taken away last, with half their 95 % intervals."""

    effect: str
    first: float  # [us]
    first_doubt: float  # [us]
    last: float  # [us]
    last_doubt: float  # [us]

    def agrees(self) -> bool:
        """Tell if an effect costs the same first and last, within a fifth."""
        return abs(self.first - self.last) <= AGREE * max(abs(self.first), abs(self.last))


@dataclasses.dataclass(frozen=True)
class EffectCosts(PlainData):
    """Cost of a step of a scene [us], by effect and by sum over pairs."""

    scene: str
    grains: int
    step: float
    nothing: float
    effects: tuple[EffectCost, ...]
    sums: dict[str, float]

    def table(self) -> Table:
        """Cost of each effect: what it adds first and what it saves last [us]."""
        rows = [
            (
                cost.effect,
                _cost_text(cost.first, cost.first_doubt),
                _cost_text(cost.last, cost.last_doubt),
                "yes" if cost.agrees() else "no",
            )
            for cost in self.effects
        ]
        columns = ("adds when it comes first [us]", "saves when taken away last [us]")
        return Table(("effect", *columns, "alike within a fifth"), rows)

    def blocks(self) -> list[Block]:
        """Make the table, and what it says, for a page."""
        sums = ", ".join(f"{name} {value:.3g}" for name, value in self.sums.items())
        return [
            Heading(f"{self.scene}: what its effects cost"),
            Text(
                f"Microseconds of a step of {self.grains} grains on one core, medians of interleaved "
                f"runs: {self.step:.3g} with all effects, {self.nothing:.2g} with none. An effect "
                "that is added to others may share their work: both prices stand where they differ by "
                "more than a fifth. What a scene does not name leaves nothing in its step; "
                '"python -m benchmarks --part absent" times that next to steps written by hand.'
            ),
            self.table(),
            Text(f"A whole step by the sum over pairs: {sums} microseconds."),
        ]


def _cost_text(value: float, doubt: float) -> str:
    return "cannot be run" if math.isnan(value) else f"{value:.3g} ± {doubt:.1g}"


def effect_costs(scene: Scene, rounds: int = ROUNDS, workers: int = 2) -> EffectCosts:
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
    costs = [
        EffectCost(
            name,
            *_median_difference(value.get(f"{name} alone"), value[NOTHING]),
            *_median_difference(value[FULL], value.get(f"without {name}")),
        )
        for name in names
    ]
    step, nothing = (float(np.median(value[name])) for name in (FULL, NOTHING))
    sums = {name: float(np.median(value[name])) for name in SUMS if name in value}
    return EffectCosts(scene.name, scene.grains.count, step, nothing, tuple(costs), sums)


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


def _median_difference(more: np.ndarray | None, less: np.ndarray | None) -> tuple[float, float]:
    """Median of the differences of pairs, and half its 95 % interval; NaN without a pair."""
    if more is None or less is None:
        return math.nan, math.nan
    off = more - less
    quarters = np.percentile(off, [25.0, 75.0])
    return float(np.median(off)), float(1.57 * (quarters[1] - quarters[0]) / math.sqrt(len(off)))
