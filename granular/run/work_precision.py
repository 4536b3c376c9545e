"""The stored table of prices: what steps err in a few measured scenes, and what they take.

``prices.toml`` is made by ``python -m benchmarks --prices``. A scene is looked up by what damps it
and by its number of grains; an error, by the step over the period of the stiffest mode. What a run
cost and risks follows from both, and from its ledger, in one line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from granular.run.summary import active_effect_names
from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.shared.files import parse_toml

TABLE = Path(__file__).with_name("work_precision.toml")

KNOWN = frozenset({"dipole", "walls", "gravity", "drag", "friction"})
"""Effects that the scenes of the table have; it says nothing of others."""

ALIKE = 8.0
"""Ratio of numbers of grains up to which a scene of the table stands for another."""


class WorkPrecisionEntry(NamedTuple):
    """A method at a step, in a scene of the table."""

    method: str
    dt: str
    fraction: float  # automatic step times the highest frequency that it is chosen for
    frequency: float  # the same product as seen in the run
    seconds: float  # computing time of a run [s]
    bounds: Mapping[str, float]  # largest error of each quantity
    clear: list[str]  # quantities whose error stands out from the scatter


class SceneWorkPrecision(NamedTuple):
    """A scene of the table."""

    name: str
    kind: str
    grains: int
    starts: int
    floors: Mapping[str, float]  # scatter of each quantity over random starts
    entries: tuple[WorkPrecisionEntry, ...]
    date: str

    def scatter_for_grain_count(self, quantity: str, grains: int) -> float:
        """Scatter of a quantity over random starts, for a number of grains."""
        # With the inverse root of the number of grains, and never less than was measured.
        return self.floors[quantity] * max(1.0, math.sqrt(self.grains / max(grains, 1)))


def damping_kind(scene: Scene) -> str:
    """Kind of damping in a scene."""
    friction = scene.effects.friction
    if friction is not None:
        return "friction" if friction.scheme == "velocity" else "regularised friction"
    return "drag" if scene.effects.drag is not None else "nothing"


@cache
def load_work_precision_scenes() -> tuple[SceneWorkPrecision, ...]:
    """Scenes of the stored work-precision table, as a tuple of `SceneWorkPrecision`."""
    plain = parse_toml(TABLE.read_text(encoding="utf-8"))
    return tuple(
        _parse_scene_work_precision(scene_table, plain["made"]["date"]) for scene_table in plain["scenes"]
    )


def _parse_scene_work_precision(plain: Mapping[str, Any], date: str) -> SceneWorkPrecision:
    entries = tuple(WorkPrecisionEntry(**rung_values) for rung_values in plain["entries"])
    return SceneWorkPrecision(
        plain["name"], plain["kind"], plain["grains"], plain["starts"], plain["floors"], entries, date
    )


def most_similar_measured_scene(scene: Scene, quantity: str) -> SceneWorkPrecision | None:
    """Find the scene of the work-precision table that is most like another one."""
    if not KNOWN.issuperset(active_effect_names(scene)) or not scene.has_closed_walls:
        return None

    kind = damping_kind(scene)
    rests = any(getattr(stage, "until", None) == "rest" for stage in scene.protocol)

    def apart(item: SceneWorkPrecision) -> float:
        return abs(math.log(item.grains / max(scene.grains.count, 1)))

    def unlike(item: SceneWorkPrecision) -> tuple[bool, float]:
        return ("rest height" in item.floors) is not rests, apart(item)

    near = [
        entry
        for entry in load_work_precision_scenes()
        if entry.kind == kind and quantity in entry.floors and apart(entry) <= math.log(ALIKE)
    ]
    return min(near, key=unlike, default=None)


def work_precision_text(run: Trajectory) -> str:
    """Say in a line how long a run took, its error by the step, and both for half the step [s]."""
    settings = run.settings()
    seconds, order = settings["seconds"], run.method.order
    finer = f"twice as fine: {2.0 * seconds:.3g} s"
    quantity = _main_quantity(run)
    costs = None if quantity is None else most_similar_measured_scene(run.scene, quantity)
    seen = settings.get("step_times_highest_frequency", 0.0)
    entry = None if costs is None else _entry_nearest_to_step(costs, run.method.name, seen)
    if quantity is None or costs is None or entry is None:
        error = settings["ledger_residual"]
        return f"price: {seconds:.3g} s; energy to {error:.1g} by the step; {finer}, {error / 2.0**order:.1g}"
    bound, scatter = entry.bounds[quantity], costs.scatter_for_grain_count(quantity, run.scene.grains.count)
    scattered = f"; starts scatter it by {scatter:.1g}" if scatter else ""
    if quantity not in entry.clear:
        return (
            f"price: {seconds:.3g} s; {quantity} to {bound:.1g} or better by the step{scattered}; "
            f"{finer}, and no better where the starts decide"
        )
    # By the method's order from the step of the table to the one used here.
    error = bound * (seen / entry.frequency) ** order
    return (
        f"price: {seconds:.3g} s; {quantity} to {error:.1g} by the step{scattered}; {finer}, "
        f"{error / 2.0**order:.1g}"
    )


def _main_quantity(run: Trajectory) -> str | None:
    """Quantity that a run is first looked at for."""
    if run.scene.piston is None:
        return None
    rested = any(stage.reason == "rest" for stage in run.stages)
    return "rest height" if rested else "piston force"


def _entry_nearest_to_step(costs: SceneWorkPrecision, method: str, seen: float) -> WorkPrecisionEntry | None:
    """Entry of a method next to a step, of those at least as long; else its longest."""
    entries = sorted(
        (entry for entry in costs.entries if entry.method == method), key=lambda entry: entry.frequency
    )
    if not entries or not 0.0 < seen <= 2.0 * entries[-1].frequency:
        return None
    return next((entry for entry in entries if entry.frequency >= seen), entries[-1])
