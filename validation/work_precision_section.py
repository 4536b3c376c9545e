"""Error against time in the report: scenes, pictures, and which setting to take."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.blocks import Block, Table, Text
from validation.exact import exact_problem
from validation.external_integrators import ORDERS
from validation.report_tasks import PlainData, Section, Task, picture, scene_key
from validation.work_precision_result import LEVELS, USUAL, SolverSettings, WorkPrecision
from validation.work_precision_runs import candidate_settings, work_precision_of_quantities

# Scenes -----------------------------------------------------------------------------------------


def compression_scene() -> Scene:
    """Quarter of de Paula's bed with dry friction, compressed at 33 mm/s [D, 2.3.3]."""
    return load_scene("bed").replace(
        **{
            "name": "compression",
            "grains.count": 92,
            "cell.width": "30 D",
            "piston.height": "45 D",
            "arrangement.height": "40 D",
            "effects.drag": None,
            "effects.friction": {},
            "protocol": [
                {"kind": "hold", "name": "relax", "duration": 1.0},
                {"kind": "move", "name": "compress", "to": "10 D", "speed": "33 mm/s"},
            ],
            "output.scalars": 0.01,
            "output.frames": 1.0,
        }
    )


def frictionless_bed() -> Scene:
    """Return the packaged bed without drag: it keeps its energy."""
    return load_scene("bed").replace(**{"name": "bed without friction", "effects.drag": None})


def disturbed_lattice(count: int) -> Scene:
    """Scene of a disturbed hexagonal lattice at the packing of the packaged bed."""
    scale = math.sqrt(count / 368.0)
    width, height = 60.0 * scale, 20.0 * scale
    apart = math.sqrt(2.0 / math.sqrt(3.0) * width * height / count)
    rows = round(height / (apart * math.sqrt(0.75)))
    fractions = [count // rows + (row < count % rows) for row in range(rows)]
    indices = np.array(
        [
            ((i + 0.5 + 0.25 * (-1) ** row) * width / many, (row + 0.5) * height / rows)
            for row, many in enumerate(fractions)
            for i in range(many)
        ]
    )
    indices += 0.05 * apart * np.random.default_rng(1).standard_normal(indices.shape)
    indices = np.clip(indices, 0.6, np.array([width, height]) - 0.6)
    scene = load_scene("bed")
    diameter = scene.grains.species[0].diameter
    return scene.replace(
        **{
            "grains.count": count,
            "cell.width": width * diameter,
            "piston.height": height * diameter,
            "arrangement": {"positions": (diameter * indices).tolist(), "speed": 0.0},
            "output": {"scalars": 0.01, "frames": 1.0},
        }
    )


# Tasks ------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Studies(PlainData):
    """Studies of one task: a quantity each."""

    studies: tuple[WorkPrecision, ...]


class Plan(NamedTuple):
    """A row of the table of studies: what is run, and how."""

    scene: Scene
    quantities: Sequence[str]
    settings: Sequence[SolverSettings]
    options: dict[str, Any]  # of `work_precision_of_quantities`


OUTSIDE_TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
"""Tolerances of the outside references; for the bed the first and the third, which take seconds."""

DAMPER_STEPS = {
    "stormer-verlet": ("auto*8", "auto*4", "auto*2", "auto", "auto/2"),
    "blanes-moan-4": ("auto*8", "auto*4", "auto*2"),
}
"""Fewer than for the others: the damper's runs are long, and soon within the scatter of starts."""


SUMS: tuple[dict[str, Any], ...] = (
    {"pairs.method": "direct"},
    *({"pairs.method": "mesh", "pairs.tolerance": value} for value in (3e-3, 3e-4, 3e-5)),
    {"pairs.method": "mesh", "pairs.far_every": 1},
    *({"pairs.method": "cut-off", "pairs.cut_off": f"{value} D"} for value in (5, 8, 11.26, 16)),
    *({"pairs.method": "verlet-list", "pairs.cut_off": f"{value} D"} for value in (5, 8, 11.26, 16)),
)
"""Ways of summing pairs, and the radii of de Paula's list about its own 11.26 D [D, 5.2]."""


def report_plans(full: bool) -> list[Plan]:
    """Plans of the report: lone grain, frictionless bed and compression; damper and sums over pairs."""
    grain, bed, squeezed = load_scene("single-particle"), frictionless_bed(), compression_scene()
    saved = ("energy", "positions")
    outside = [SolverSettings(name, limit) for name in ORDERS for limit in OUTSIDE_TOLERANCES]
    few = [setting for setting in outside if setting.dt in OUTSIDE_TOLERANCES[:3:2]]
    exact = {"until": 1.0, "references": _exact_grain_references()}
    plans = [
        Plan(grain, saved, [*candidate_settings(grain), *outside], exact),
        Plan(bed, saved, [*candidate_settings(bed), *few], {"until": 0.02}),
        Plan(squeezed, ("piston force", "mean distance"), candidate_settings(squeezed), {"seeds": 4}),
    ]
    if not full:
        return plans
    damper = [SolverSettings(name, dt) for name, steps in DAMPER_STEPS.items() for dt in steps]
    quantities = ("rest height", "period", "damping ratio")
    finer = [SolverSettings("stormer-verlet", "auto/8")] * len(quantities)
    lattice = disturbed_lattice(1472).replace(name="1472 grains, by sum over pairs")
    sums = [SolverSettings("stormer-verlet", "auto", changes) for changes in SUMS]
    direct = [SolverSettings("stormer-verlet", "auto/2", SUMS[0])]
    return [
        *plans,
        Plan(load_scene("damper"), quantities, damper, {"seeds": 4, "repeats": 1, "references": finer}),
        # The piston's force as the grains settle, by method of summing pairs.
        Plan(lattice, ("piston force",), sums, {"until": 0.3, "references": direct, "repeats": 1}),
    ]


def _exact_grain_references() -> list[Any]:
    """Lone grain's exact energy error and position [D] after 1 s."""
    problem = exact_problem("bounce")
    return [0.0, problem.exact(1.0).positions / Scales.from_grains(problem.scene.grains).length]


def work_precision_task(plan: Plan, **more: Any) -> Task:
    """Task that runs one scene with many settings."""
    key = {
        **scene_key(plan.scene),
        "quantities": plan.quantities,
        "settings": str(plan.settings),
        "options": str(plan.options),
        **more,
    }
    return Task(plan.scene.name, key, partial(_measure_studies, plan))


def _measure_studies(plan: Plan) -> Studies:
    return Studies(work_precision_of_quantities(plan.scene, plan.quantities, plan.settings, **plan.options))


# In the report ----------------------------------------------------------------------------------


def _all_studies(results: Sequence[Studies]) -> list[WorkPrecision]:
    """Work-precision studies of all tasks in one list."""
    return list(chain.from_iterable(result.studies for result in results))


def work_precision_blocks(results: Sequence[Studies]) -> list[Block]:
    """Make the table of settings to take, and a picture for each quantity."""
    intro = Text(
        "Error over wall time, warm, the least of the repeats. The broad line joins the settings "
        "that none beats in both. Where several starts were run, the error is the mean deviation "
        "over them and a thin bar ends at its bound. What to take for each level is ringed, and "
        "named at the dotted lines: the fastest setting whose bound is within it, and behind which "
        "no shorter step is clearly above it. The shaded band is the scatter over random starts; "
        "below three times that any setting will do, and the mean of more starts is the price. The "
        "toolkit's seconds hold its records, ledger and start-up; those of SciPy and diffrax "
        "(thin, dotted) the bare integration. The last column is the time over that of the default "
        "setting, stormer-verlet at dt = auto."
    )
    pictures = [
        picture(study.plot, f"{study.quantity} of {study.run_words}, against {study.reference}.")
        for study in _all_studies(results)
    ]
    return [intro, advised_setting_table(_all_studies(results)), *pictures]


def advised_setting_table(studies: Sequence[WorkPrecision]) -> Table:
    """Table of the setting to take for each tolerance, and its time over the default one's."""
    rows = []
    for study in studies:
        usual = study.default_point()
        seconds = math.nan if usual is None else usual.seconds
        rows += [
            (study.scene, study.quantity, words, *_advised_setting(study, level, seconds))
            for words, level in LEVELS.items()
        ]
    header = ("scene", "quantity", "to", "take", "dt", "error", "starts", "seconds", "of the default's")
    return Table(header, rows)


def _advised_setting(work_precision: WorkPrecision, level: float, usual: float) -> tuple[str, ...]:
    advice = work_precision.advise(level)
    best = advice.point
    if best is None:
        return (str(advice), "", "", "", "", "")
    take = best.setting.family
    if advice.needs_more_starts:
        take = f"any: starts scatter by {advice.floor:.2g}"
    ratio = advice.seconds / usual
    return (
        take,
        best.setting.fineness,
        f"{best.error:.2g}",
        f"{advice.starts:.3g}",
        f"{advice.seconds:.3g}",
        "" if math.isnan(ratio) else f"{ratio:.3g}",
    )


def _study_tables(results: Sequence[Studies]) -> list[Block]:
    title = "Cost of the {0.quantity} of {0.scene}; a star marks the best of all."
    pairs = [(Text(title.format(study)), study.table()) for study in _all_studies(results)]
    return list(chain.from_iterable(pairs))


def _studies_verdict(results: Sequence[Studies]) -> tuple[str, bool]:
    studies = _all_studies(results)
    usual = [study for study in studies if any(point.setting[:2] == USUAL for point in study.points)]
    right = sum(study.default_point() is not None for study in usual)
    words = (
        f"cost of accuracy shown for {len(studies)} quantities; the default setting runs in "
        f"{right} of {len(usual)}"
    )
    return words, right == len(usual)


WORK_PRECISION = Section(
    "work-precision",
    "What accuracy costs",
    lambda full: [work_precision_task(plan) for plan in report_plans(full)],
    Studies,
    _studies_verdict,
    work_precision_blocks,
    _study_tables,
)
