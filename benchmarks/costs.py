"""Measurement of the work-precision table from which `granular` promises accuracies.

An entry ("rung") is a method with a multiple of the automatic step, in one scene: upper bound of its error,
by quantity, and time of a run.
"""

from __future__ import annotations

import datetime
import math
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.run.plan import parse_time_step
from granular.run.work_precision import damping_kind
from granular.scene.named_scenes import damper, load_scene
from granular.scene.scene import Scene
from granular.shared.errors import GranularError
from granular.shared.files import write_text
from granular.shared.version import toolkit_and_library_versions
from validation.accuracy_cost import (
    ReferenceValue,
    ScenesWithReferences,
    quarter_bed_compression_scene,
    run_scene_with_setting,
    scenes_with_other_seeds,
    scenes_with_reference_values,
)
from validation.measured_quantities import QUANTITIES
from validation.report_tasks import Plain, Task, failure_lines, run_tasks, successful_results
from validation.work_precision_result import SolverSettings, WorkPrecisionPoint


class Priced(NamedTuple):
    """A scene of the table, its settings from coarse to fine, and a reference.

    Attributes
    ----------
    scene : Scene
    quantities, steps : tuple of str
    others : tuple of str
        Steps of the method of order four.
    reference : str
        Step of the reference, by Verlet's method.
    starts : int
    """

    scene: Scene
    quantities: tuple[str, ...]
    steps: tuple[str, ...]
    others: tuple[str, ...]
    reference: str
    starts: int

    @property
    def key(self) -> Plain:
        """Key of its cached results."""
        return {
            "scene": self.scene.digest(),
            "quantities": list(self.quantities),
            "reference": self.reference,
            "starts": self.starts,
        }


def priced_scenes() -> tuple[Priced, ...]:
    """Return two dampers, a bed at rest, and a compression with dry friction."""
    swings = ("rest height", "period", "damping ratio", "energy")
    presses = ("piston force", "mean distance", "energy")
    bed = load_scene("bed").replace(
        **{
            "name": "bed-92",
            "grains.count": 92,
            "cell.width": "30 D",
            "piston.height": "10 D",
            "arrangement.height": "9 D",
        }
    )
    return (
        Priced(
            quarter_bed_compression_scene(), presses, ("auto*2", "auto", "auto/2", "auto/4"), (), "auto/8", 12
        ),
        Priced(bed, presses, ("auto*8", "auto*4", "auto*2", "auto"), ("auto*8", "auto*4"), "auto/2", 8),
        Priced(damper(count=92), swings, ("auto*8", "auto*4", "auto*2"), (), "auto", 6),
        Priced(load_scene("damper"), swings, ("auto*8", "auto*4"), (), "auto*2", 4),
    )


def costs(path: Path, progress: bool = True) -> dict[str, Any]:
    """Measure the table, and write it to the file read by `granular`, or to another file.

    Finished measurements are cached in a folder of the file's name (``out/prices`` without a file), and
    reused.

    Raises
    ------
    InputError
        If the file cannot be written.
    GranularError
        If a reference fails.
    """
    import tomli_w

    scenes = priced_scenes()
    kept = path.with_suffix("")
    references = run_tasks("references", _references(scenes), kept, progress=progress)
    for line in failure_lines(references):
        raise GranularError(f"the reference of {line}")
    known = successful_results(references)
    rungs = run_tasks("settings", _rungs(scenes, known), kept, progress=progress)
    entries = iter([rung.result or {} for rung in rungs])
    rows = [
        _row(item, truth, [next(entries) for _ in _settings(item)])
        for item, truth in zip(scenes, known, strict=True)
    ]
    made = {"date": datetime.datetime.now(datetime.UTC).date().isoformat(), **toolkit_and_library_versions()}
    result = {"made": made, "scenes": rows}
    head = "# Measured by: python -m benchmarks --prices. See granular/run/work_precision.py.\n\n"
    write_text(path, head + tomli_w.dumps(result))
    return result


def _references(scenes: Sequence[Priced]) -> list[Task]:
    """Return the references of each scene."""
    return [Task(item.scene.name, item.key, partial(_truth, item)) for item in scenes]


def _rungs(scenes: Sequence[Priced], known: Sequence[Plain]) -> list[Task]:
    """Measure the settings of all scenes."""
    return [
        Task(
            f"{item.scene.name}, {setting.family}, {setting.dt}",
            item.key | {"setting": [setting.method, str(setting.dt)]},
            partial(_rung, item, setting, truth),
        )
        for item, truth in zip(scenes, known, strict=True)
        for setting in _settings(item)
    ]


def _settings(item: Priced) -> list[SolverSettings]:
    """Return the settings to run in a scene."""
    others = [SolverSettings("blanes-moan-4", dt) for dt in item.others]
    return [SolverSettings("stormer-verlet", dt) for dt in item.steps] + others


def _truth(item: Priced) -> Plain:
    """Return the values of each quantity over the starts, and their scatter."""
    scenes = scenes_with_other_seeds(item.scene, item.starts - 1)
    reference = SolverSettings("stormer-verlet", item.reference)
    chosen = [QUANTITIES[name] for name in item.quantities]
    given = [None if entry.exact is not None else reference for entry in chosen]
    known = scenes_with_reference_values(scenes, chosen, given, None)
    return {
        name: {"values": [float(value) for value in truth.values], "floor": truth.floor}
        for name, truth in zip(item.quantities, known.truth, strict=True)
    }


def _rung(item: Priced, setting: SolverSettings, truth: Plain) -> Plain:
    """Return an entry of the table; empty for a setting that fails."""
    scenes = scenes_with_other_seeds(item.scene, item.starts - 1)
    chosen = [QUANTITIES[name] for name in item.quantities]
    known = [ReferenceValue("", tuple(entry["values"]), entry["floor"]) for entry in truth.values()]
    points = ScenesWithReferences(scenes, chosen, None, known).measure_points(setting)
    result = [point for point in points if point is not None]
    if any(entry.has_failed for entry in result):
        return {}
    started = time.process_time()  # processor time, which excludes other programs
    seen = run_scene_with_setting(item.scene, setting, None).settings()["step_times_highest_frequency"]
    seconds = time.process_time() - started
    return {
        "method": setting.method,
        "dt": str(setting.dt),
        "fraction": parse_time_step(setting.dt, item.scene).step_times_frequency,
        "frequency": rounded(seen),
        "seconds": rounded(seconds),
        "bounds": {
            name: rounded(entry.upper_error_bound)
            for name, entry in zip(item.quantities, result, strict=True)
        },
        "clear": _clear(item.quantities, result),
    }


def _row(item: Priced, truth: Plain, entries: Sequence[Plain]) -> Plain:
    """Return a scene's part of the table."""
    return {
        "name": item.scene.name,
        "grains": item.scene.grains.count,
        "kind": damping_kind(item.scene),
        "starts": item.starts,
        "reference": item.reference,
        "floors": {name: rounded(entry["floor"]) for name, entry in truth.items()},
        "entries": [rung for rung in entries if "method" in rung],
    }


def _clear(names: Sequence[str], result: Sequence[WorkPrecisionPoint]) -> list[str]:
    """Return quantities whose error exceeds its uncertainty, and so falls with the step."""
    return [name for name, item in zip(names, result, strict=True) if item.error > 2.0 * item.doubt]


def rounded(value: float) -> float:
    """Round up to three digits."""
    if value == 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - 2)
    return float(np.format_float_positional(math.ceil(value / unit) * unit, 3, fractional=False))


def prices_text(result: Mapping[str, Any]) -> str:
    """Return the table as text."""
    lines = []
    for scene in result["scenes"]:
        lines.append(f"{scene['name']} ({scene['starts']} starts): scatter {scene['floors']}")
        lines += [
            f"  {rung['method']} {rung['dt']}: {rung['seconds']:g} s, at most {rung['bounds']}"
            for rung in scene["entries"]
        ]
    return "\n".join(lines)
