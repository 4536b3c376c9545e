"""Method, step and sum over pairs for an accuracy that is asked for, by the stored table."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import NamedTuple

from granular.engine.step_size import StepRequest, auto_step_text
from granular.methods.registry import method_named
from granular.pairs.pair_sum_settings import PairSumSettings
from granular.run.time_steps import can_run_with_step, parse_time_step
from granular.run.work_precision import (
    SceneWorkPrecision,
    WorkPrecisionEntry,
    load_work_precision_scenes,
    most_similar_measured_scene,
)
from granular.scene.scene import Scene
from granular.scene.scene_in_natural_units import scene_in_natural_units
from granular.schema.field_kinds import unknown_word_message
from granular.shared.errors import InputError
from granular.shared.message_text import quote

MARGIN = 1.5
"""Factor of a bound of the table: scenes differ."""

FLOORS = 3.0
"""A single run cannot be promised to fewer standard deviations of its random start than this."""

FARTHEST = 4.0
"""Greatest factor by which a step may be shorter than the table's shortest, by its method's order."""

MESH_ERROR = 5e-4
"""Error of the mesh in a bed's forces at rest; the tests of the benchmark hold it to that."""

MESH_IS_FASTER_FROM = 300
"""Grains from which a step of Störmer-Verlet by the mesh takes two thirds of the time of one by the direct
sum, or less: 22 for 33 us at 300, 27 for 47 us at 368. Its compiling, some fifteen seconds once, pays where
several runs follow."""

RESOLVED = 1.0
"""Step times highest frequency up to which a method shows its order; half the limit."""

MOTION = ("rest height", "period", "damping ratio")
"""Quantities of a piston that comes to rest, in the table of prices."""

_ASKED = re.compile(r"\s*(?P<value>[0-9.eE+-]+)\s*(?P<percent>%?)\s+(?P<quantity>\D.*?)\s*")


class ChosenSettings(NamedTuple):
    """Settings that a scene is to be run with."""

    scene: Scene
    dt: str
    method: str
    words: str


def parse_accuracy(text: str) -> tuple[float, str]:
    """Parse an accuracy such as "1e-4 rest height" or "1 % piston force"."""
    names = sorted({name for entry in load_work_precision_scenes() for name in entry.floors})
    match = _ASKED.fullmatch(text) if isinstance(text, str) else None
    try:
        value = float(match["value"]) if match else math.nan
    except ValueError:
        value = math.nan
    if match is None or not 0.0 < value < math.inf:
        raise InputError(
            f"accuracy = {quote(text)}; give an error above 0 and a quantity, such as "
            "'1e-3 rest height' or '1 % piston force'"
        )
    if match["quantity"] not in names:
        raise InputError(unknown_word_message(match["quantity"], names, "quantity"))
    return value * (0.01 if match["percent"] else 1.0), match["quantity"]


def starts_for_tolerance(floor: float, tolerance: float) -> int:
    """Return the number of random starts whose mean is within a tolerance, at two standard errors."""
    return max(1, math.ceil((2.0 * floor / tolerance) ** 2))


def choose_settings_for_accuracy(scene: Scene, text: str) -> ChosenSettings:
    """Choose the cheapest method and step for an accuracy, by the stored work-precision table."""
    tolerance, quantity = parse_accuracy(text)
    costs = most_similar_measured_scene(scene, quantity)
    if costs is None:
        raise InputError(
            f"accuracy = {quote(text)}: the table of prices holds no scene like {scene.name!r} "
            "with this quantity; measure it: granular-damper validate cheapest"
        )
    floor = costs.scatter_for_grain_count(quantity, scene.grains.count)
    if tolerance < FLOORS * floor:
        raise InputError(
            f"accuracy = {quote(text)}: random starts scatter by {floor:.2g}, so no single run "
            f"can be promised below {FLOORS * floor:.2g}; ask for that, or average "
            f"{starts_for_tolerance(floor, tolerance):d} starts (arrangement.seed)"
        )
    cheapest = min(_accurate_methods(scene, costs, quantity, tolerance), default=None)
    if cheapest is None:
        least = min(entry.bounds[quantity] for entry in costs.entries)
        raise InputError(
            f"accuracy = {quote(text)}: the least error that the table of prices holds is "
            f"{MARGIN * least:.2g}, with its margin; ask for that, or measure: python -m "
            "validation cheapest"
        )
    _, dt, method, bound = cheapest
    summed, how = _choose_pair_sum(scene, quantity, tolerance, text)
    scatter = f", starts scatter by {floor:.1g}" if floor else ""
    words = (
        f"{quantity} to {tolerance:g}: {method}, dt {dt}, {how}; the step errs by at most "
        f"{bound:.1g}{scatter} ({costs.name}, {costs.starts} starts, {costs.date})"
    )
    return ChosenSettings(summed, dt, method, words)


def _accurate_methods(
    scene: Scene, costs: SceneWorkPrecision, quantity: str, tolerance: float
) -> Iterator[tuple[float, str, str, float]]:
    """Price, step, method and bound of each method that reaches the tolerance."""
    for method in dict.fromkeys(entry.method for entry in costs.entries):
        entries = sorted(
            (entry for entry in costs.entries if entry.method == method), key=lambda entry: entry.fraction
        )
        fraction = _longest_step_fraction(entries, quantity, tolerance / MARGIN)
        if fraction is None:
            continue
        dt = step_from_frequency_product(scene, fraction)
        if not can_run_with_step(scene, dt, method):
            continue
        near = min(entries, key=lambda entry: abs(math.log(entry.fraction / fraction)))
        order = method_named(method).order
        scale = (fraction / near.fraction) ** order
        bound = near.bounds[quantity] * (scale if quantity in near.clear else max(1.0, scale))
        yield near.seconds * near.fraction / fraction, dt, method, bound


def _longest_step_fraction(
    entries: list[WorkPrecisionEntry], quantity: str, tolerance: float
) -> float | None:
    """Longest step times highest frequency that keeps a tolerance; None where none does."""
    # Between two steps of the table, and below its shortest, errors follow the method's order; beyond its
    # longest no step is promised.
    held = [entry for entry in entries if entry.bounds[quantity] <= tolerance]
    order = method_named(entries[0].method).order
    if not held:
        finest = entries[0]
        shorter = (tolerance / finest.bounds[quantity]) ** (1.0 / order)
        clear = quantity in finest.clear and shorter * FARTHEST >= 1.0
        return shorter * finest.fraction if clear else None
    best = held[-1]
    if best is entries[-1] or not best.bounds[quantity] > 0.0:
        return best.fraction
    if quantity not in entries[entries.index(best) + 1].clear:
        return best.fraction  # what the next one errs is scatter, and follows no order
    longer = (tolerance / best.bounds[quantity]) ** (1.0 / order)
    return min(best.fraction * longer, entries[entries.index(best) + 1].fraction)


def pair_sum_hidden_by_scatter(scene: Scene, method: str) -> Scene:
    """Scene with the fastest sum over pairs whose errors are hidden by the scatter over random starts."""
    count = scene.grains.count
    if scene.pairs != PairSumSettings() or scene.grains.magnets != "dipoles" or count < MESH_IS_FASTER_FROM:
        return scene
    if scene.pair_method != "direct" or scene.cell.periods is not None or not scene.has_closed_walls:
        return scene
    resolved = method_named(method)
    if not resolved.allows_far_field_impulses or resolved.compensated:
        return scene
    costs = most_similar_measured_scene(scene, MOTION[0])
    if costs is None or any(FLOORS * _scatter_of(costs, name, count) < MESH_ERROR for name in MOTION):
        return scene
    summed = scene.replace(**{"pairs.method": "mesh"})
    try:
        scene_in_natural_units(summed, method=resolved)
    except InputError:  # a cell so large that its mesh does not fit into memory
        return scene
    return summed


def _scatter_of(costs: SceneWorkPrecision, quantity: str, count: int) -> float:
    """Scatter of a quantity, by the inverse square root of the number of grains also beyond the table."""
    return costs.floors[quantity] * math.sqrt(costs.grains / count)


def step_from_frequency_product(scene: Scene, fraction: float) -> str:
    """Time step with a given product of step and highest frequency, as a multiple of the automatic one."""
    step: StepRequest = parse_time_step("auto", scene)
    factor = min(fraction / step.step_times_frequency, step.greatest_factor)
    if factor < 1.0:
        # Rounded down to hundredths, so that the error stays below the bound.
        return f"auto/{math.ceil(100.0 / factor - 1e-6) / 100.0:g}"
    return auto_step_text(math.floor(100.0 * factor + 1e-6) / 100.0)


def _choose_pair_sum(scene: Scene, quantity: str, tolerance: float, text: str) -> tuple[Scene, str]:
    """Scene with a sum over pairs that keeps the tolerance, and its name."""
    method = scene.pair_method
    if method in ("cut-off", "verlet-list"):
        raise InputError(
            f"accuracy = {quote(text)}: pairs.method = {method!r} leaves pairs out, which no step "
            "corrects; take 'auto'"
        )
    if method == "mesh" and quantity != "energy" and tolerance < 2.0 * MESH_ERROR:
        return scene.replace(**{"pairs.method": "direct"}), "direct sum"
    return scene, "sum by the mesh" if method == "mesh" else "direct sum"


def longest_step_hidden_by_scatter(scene: Scene, method: str) -> str:
    """Longest automatic step whose errors are hidden by the scatter over random starts."""
    costs = most_similar_measured_scene(scene, MOTION[0])
    fraction = 0.0
    for entry in sorted(costs.entries if costs else (), key=lambda entry: entry.fraction):
        if entry.method == method and entry.frequency <= RESOLVED:
            # From here on an error of the step stands out from the scatter of the starts.
            if not set(entry.clear).isdisjoint(MOTION):
                break
            fraction = entry.fraction
    shortest = parse_time_step("auto", scene).step_times_frequency
    return step_from_frequency_product(scene, fraction) if fraction > shortest else "auto"
