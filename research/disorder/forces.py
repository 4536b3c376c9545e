"""Forces at defects, in beds under compression and in beds with a heat bath."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene
from granular.shared.files import digest
from research.disorder.force_heterogeneity import (
    QUIET,
    SHELLS,
    ForceField,
    choose_random_grains_of_same_classes,
    find_defect_arrivals,
    mean_around_arrivals,
    mean_relative_to_other_grains,
    measure_force_field,
)

Row = dict[str, Any]

COUNT, STARTS = 184, 12
KINDS = ("compressed", "warm")
FRAMES = 0.01
"""Interval between frames [s]."""

SPEED, DRAG = 0.01, 0.1
"""Speed of the piston [m/s], and drag of a grain [kg/s], of the compressed beds."""

WARM, RATE = 0.09, 5.0
"""Warm beds: temperature over the energy of a pair at the mean spacing (a crystal melts near 0.100), and rate
of the bath [1/s]."""

SETTLE, MEASURE = 2.0, 4.0
SHUFFLES, DRAWS = 20, 2000
LEVEL = 0.95
_UNIT = 5.68e-4


class MeanWithInterval(NamedTuple):
    """A mean over independent runs, with its interval from resampled runs."""

    value: float
    low: float
    high: float


def scene_for_forces(kind: str, seed: int) -> Scene:
    """Return a bed of `KINDS`, measured from the time `SETTLE` on."""
    height = 20.0 * math.sqrt(COUNT / 368)
    begun = 1.4 * height if kind == "compressed" else height
    changes: dict[str, Any] = {
        "name": f"forces-{kind}-{seed}",
        "grains.count": COUNT,
        "cell.width": f"{60.0 * math.sqrt(COUNT / 368)!r} D",
        "piston.height": f"{begun!r} D",
        "arrangement.height": f"{begun - 1.0!r} D",
        "arrangement.seed": seed,
        "output.frames": FRAMES,
        "output.scalars": FRAMES,
    }
    stages: list[dict[str, Any]] = [{"name": "settle", "kind": "hold", "duration": SETTLE}]
    if kind == "compressed":
        stages.append({"name": "press", "kind": "move", "to": f"{height!r} D", "speed": SPEED})
        changes["effects.drag.coefficient"] = DRAG
    else:
        stages.append({"name": "warm", "kind": "hold", "duration": MEASURE})
        changes["effects.drag"] = None
        changes["effects.bath"] = {"temperature": WARM * _UNIT, "rate": RATE, "seed": seed}
    return load_scene("bed").replace(**changes, protocol=stages)


def key_of_force_row(case: tuple[str, int]) -> str:
    """Return the key of the row of a kind of bed and a seed."""
    return f"{case[0]}-{case[1]}-{digest(scene_for_forces(*case).to_plain(), 8)}"


def simulate_and_measure_forces(case: tuple[str, int]) -> Row:
    """Simulate and measure a bed of a kind and a seed."""
    from granular.run.simulation import simulate

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # as of `simulate_and_measure_bed`
        run = simulate(scene_for_forces(*case), progress=False)
    return {"kind": case[0], "seed": case[1], **row_of_force_field(measure_force_field(run, SETTLE), case[1])}


def row_of_force_field(field: ForceField, seed: int = 1) -> Row:
    """Return the row of one bed.

    Returns
    -------
    dict
        Means at defects, pentagons and heptagons over means at other grains at the same distance from the
        walls: ``uneven``, ``force``, ``force 5``, ``force 7``; ``uneven, shuffled``, the same for shuffled
        positions; ``shells`` of the unevenness; ``arrivals``, their number, and ``uneven about`` and ``force
        about`` them, `QUIET` frames before to as many after; and the fraction of ``defects``.
    """
    known = field.depth >= 0
    odd = known & (field.sides != 6)
    random = np.random.default_rng(seed)
    by_chance = [
        mean_relative_to_other_grains(
            field, field.unevenness, choose_random_grains_of_same_classes(field, odd, random)
        )
        for _ in range(SHUFFLES)
    ]
    events = find_defect_arrivals(field)
    calm = field.shell == SHELLS
    return {
        "defects": float(odd.sum() / known.sum()),
        "uneven": mean_relative_to_other_grains(field, field.unevenness, odd),
        "uneven, shuffled": float(np.mean(by_chance)),
        "force": mean_relative_to_other_grains(field, field.force, odd),
        "force 5": mean_relative_to_other_grains(field, field.force, known & (field.sides == 5)),
        "force 7": mean_relative_to_other_grains(field, field.force, known & (field.sides == 7)),
        "shells": [
            mean_relative_to_other_grains(
                _restrict_to_chosen_grains(field, calm | (field.shell == k)),
                field.unevenness,
                field.shell == k,
            )
            for k in range(SHELLS)
        ],
        "arrivals": len(events),
        "uneven about": mean_around_arrivals(field, field.unevenness, events).tolist(),
        "force about": mean_around_arrivals(field, field.force, events).tolist(),
    }


def _restrict_to_chosen_grains(field: ForceField, chosen: np.ndarray) -> ForceField:
    return field._replace(depth=np.where(chosen, field.depth, -1))


def mean_with_bootstrap_interval(values: Sequence[float], seed: int = 1) -> MeanWithInterval:
    """Return the mean over runs and the interval of `LEVEL`; runs without a value are omitted."""
    known = np.array([item for item in values if np.isfinite(item)])
    random = np.random.default_rng(seed)
    means = known[random.integers(len(known), size=(DRAWS, len(known)))].mean(axis=1)
    tail = 0.5 * (1.0 - LEVEL)
    return MeanWithInterval(float(known.mean()), *map(float, np.quantile(means, [tail, 1.0 - tail])))


def means_before_at_and_after_arrivals(
    rows: Sequence[Mapping[str, Any]], name: str
) -> dict[str, MeanWithInterval]:
    """Return means over the earlier half of the frames before arrivals, at arrivals, and long after.

    ``name`` is ``uneven about`` or ``force about``.
    """
    table = np.array([row[name] for row in rows], dtype=float)
    spans = {
        "before": slice(0, QUIET // 2),
        "just before": slice(QUIET - 2, QUIET),
        "at": slice(QUIET, QUIET + 2),
        "after": slice(QUIET + QUIET // 2 + 1, 2 * QUIET + 1),
    }
    return {
        word: mean_with_bootstrap_interval(table[:, duration].mean(axis=1).tolist())
        for word, duration in spans.items()
    }
