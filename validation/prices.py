"""The table of prices that `granular` promises accuracies from: measured here, kept there.

A rung is a method with a multiple of the automatic step, in one scene: what it errs at most, by
quantity, and what a run of it takes.
"""

from __future__ import annotations

import datetime
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.run.prices import TABLE, kind_of
from granular.run.time_step import checked_step
from granular.scene.beds import damper
from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from granular.shared.files import write_text
from granular.shared.version import versions
from validation.cost.measuring import points, run, starts_of, truths
from validation.cost.point import Point, Setting
from validation.quantities import QUANTITIES, MeasuredQuantity


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


def priced_scenes() -> tuple[Priced, ...]:
    """Two dampers, a bed at rest, and a compression under dry friction."""
    from validation.programme import compression_scene

    swings = ("rest height", "period", "damping ratio", "energy")
    presses = ("piston force", "mean distance", "energy")
    bed = load_scene("bed").replace(
        **{"name": "bed-92", "grains.count": 92, "cell.width": "30 D", "piston.height": "10 D",
           "arrangement.height": "9 D"}
    )  # fmt: skip
    return (
        Priced(compression_scene(), presses, ("auto*2", "auto", "auto/2", "auto/4"), (), "auto/8",
               12),
        Priced(bed, presses, ("auto*8", "auto*4", "auto*2", "auto"), ("auto*8", "auto*4"),
               "auto/2", 8),
        Priced(damper(count=92), swings, ("auto*8", "auto*4", "auto*2"), (), "auto", 6),
        Priced(load_scene("damper"), swings, ("auto*8", "auto*4"), (), "auto*2", 4),
    )  # fmt: skip


def prices(path: Path | None = None, progress: bool = True) -> dict[str, Any]:
    """Measure the table, and write it where `granular` reads it, or to another file.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    import tomli_w

    from granular.shared.progress import progress_bar

    rows = [
        _row(one)
        for one in progress_bar(
            iterable=priced_scenes(), desc="prices", wanted=progress, unit="scene"
        )
    ]
    made = {"date": datetime.datetime.now(datetime.UTC).date().isoformat(), **versions()}
    found = {"made": made, "scenes": rows}
    head = "# Measured by: python -m validation prices. See granular/run/prices.py.\n\n"
    write_text(TABLE if path is None else path, head + tomli_w.dumps(found))
    return found


def _row(one: Priced) -> dict[str, Any]:
    chosen = [QUANTITIES[name] for name in one.quantities]
    scenes = starts_of(one.scene, one.starts - 1)
    reference = Setting("stormer-verlet", one.reference)
    given = [None if each.exact is not None else reference for each in chosen]
    truth = truths(scenes, chosen, given, None)
    settings = [Setting("stormer-verlet", dt) for dt in one.steps]
    settings += [Setting("blanes-moan-4", dt) for dt in one.others]
    rungs = [_rung(one.scene, scenes, chosen, setting, truth) for setting in settings]
    return {
        "name": one.scene.name, "grains": one.scene.grains.count, "kind": kind_of(one.scene),
        "starts": len(scenes), "reference": one.reference,
        "floors": {q.name: rounded(t.floor) for q, t in zip(chosen, truth, strict=True)},
        "rungs": [rung for rung in rungs if rung is not None],
    }  # fmt: skip


def _rung(
    scene: Scene, scenes: Sequence[Scene], chosen: Sequence[MeasuredQuantity], setting: Setting,
    truth: Sequence[Any],
) -> dict[str, Any] | None:  # fmt: skip
    """A row of the table; None for a setting that fails."""
    found = points(scenes, chosen, setting, truth, None, 1)
    if any(one.failed for one in found):
        return None
    begun = time.process_time()  # other programs take none of it
    seen = run(scene, setting, None).settings()["step_times_highest_frequency"]
    seconds = time.process_time() - begun
    names = [one.name for one in chosen]
    return {
        "method": setting.method, "dt": str(setting.dt),
        "fraction": checked_step(setting.dt, scene).fraction, "frequency": rounded(seen),
        "seconds": rounded(seconds),
        "bounds": {name: rounded(one.bound) for name, one in zip(names, found, strict=True)},
        "clear": _clear(names, found),
    }  # fmt: skip


def _clear(names: Sequence[str], found: Sequence[Point]) -> list[str]:
    """Quantities whose error stands out against its doubt, and so falls with the step."""
    return [name for name, one in zip(names, found, strict=True) if one.error > 2.0 * one.doubt]


def rounded(value: float) -> float:
    """Three digits, upwards."""
    if value == 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - 2)
    return float(np.format_float_positional(math.ceil(value / unit) * unit, 3, fractional=False))


def prices_text(found: Mapping[str, Any]) -> str:
    """The table for people."""
    lines = []
    for scene in found["scenes"]:
        lines.append(f"{scene['name']} ({scene['starts']} starts): scatter {scene['floors']}")
        lines += [
            f"  {rung['method']} {rung['dt']}: {rung['seconds']:g} s, at most {rung['bounds']}"
            for rung in scene["rungs"]
        ]
    return "\n".join(lines)
