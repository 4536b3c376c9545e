"""Error against time in the report: pictures, and which setting to take."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any

from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.plotting import figure
from validation.cost.advised_setting import USUAL, SolverSettings
from validation.cost.work_precision import candidate_settings, work_precision_of_quantities
from validation.cost.work_precision_result import LEVELS, WorkPrecision
from validation.exact import exact_problem
from validation.external_integrators import ORDERS
from validation.report_scenes import compression_scene, disturbed_lattice, frictionless_bed
from validation.report_tasks import Plain, Section, Task, scene_key
from validation.text_tables import WIDTH, TextTable, add_table_to_page, draw_legend_below, text_table

if TYPE_CHECKING:
    from granular.shared.html_pages import HtmlPage

Studies = list[WorkPrecision]
"""Those of one task: a quantity each."""


def studies_from_plain(plain: Mapping[str, Any]) -> Studies:
    """Work-precision studies of a task's plain result."""
    return [WorkPrecision.from_plain(study) for study in plain["studies"]]


def join_studies(results: Sequence[Studies]) -> Studies:
    """Work-precision studies of all tasks in one list."""
    return list(chain.from_iterable(results))


OUTSIDE_TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
"""Tolerances of the outside references; for the bed the first and the third, which take seconds."""

DAMPER_STEPS = {
    "stormer-verlet": ("auto*8", "auto*4", "auto*2", "auto", "auto/2"),
    "blanes-moan-4": ("auto*8", "auto*4", "auto*2"),
}
"""Fewer than for the others: the damper's runs are long, and soon within the scatter of starts."""


def work_precision_tasks(full: bool) -> list[Task]:
    """Tasks that measure error against time: lone grain, frictionless bed and compression."""
    grain, bed, squeezed = load_scene("single-particle"), frictionless_bed(), compression_scene()
    saved = ("energy", "positions")
    many = [SolverSettings(name, limit) for name in ORDERS for limit in OUTSIDE_TOLERANCES]
    few = [SolverSettings(name, limit) for name in ORDERS for limit in OUTSIDE_TOLERANCES[:3:2]]
    wanted: list[tuple[Scene, tuple[str, ...], Sequence[SolverSettings], dict[str, Any]]] = [
        (
            grain,
            saved,
            [*candidate_settings(grain), *many],
            {"until": 1.0, "references": _exact_grain_references()},
        ),
        (bed, saved, [*candidate_settings(bed), *few], {"until": 0.02}),
        (squeezed, ("piston force", "mean distance"), candidate_settings(squeezed), {"seeds": 4}),
    ]
    if full:
        damper = [SolverSettings(name, dt) for name, steps in DAMPER_STEPS.items() for dt in steps]
        quantities = ("rest height", "period", "damping ratio")
        options: dict[str, Any] = {
            "seeds": 4,
            "repeats": 1,
            "references": [SolverSettings("stormer-verlet", "auto/8")] * len(quantities),
        }
        wanted.append((load_scene("damper"), quantities, damper, options))
        wanted.append(_pair_sum_study())
    return [work_precision_task(*quantity) for quantity in wanted]


def work_precision_task(
    scene: Scene,
    quantities: Sequence[str],
    settings: Sequence[SolverSettings],
    options: dict[str, Any],
    **more: Any,
) -> Task:
    """Task that runs one scene with many settings."""
    key = {
        **scene_key(scene),
        "quantities": quantities,
        "settings": str(settings),
        "options": str(options),
        **more,
    }
    return Task(scene.name, key, partial(_measure_studies, scene, quantities, settings, options))


SUMS: tuple[dict[str, Any], ...] = (
    {"pairs.method": "direct"},
    *({"pairs.method": "mesh", "pairs.tolerance": value} for value in (3e-3, 3e-4, 3e-5)),
    {"pairs.method": "mesh", "pairs.far_every": 1},
    *({"pairs.method": "cut-off", "pairs.cut_off": f"{value} D"} for value in (5, 8, 11.26, 16)),
    *({"pairs.method": "verlet-list", "pairs.cut_off": f"{value} D"} for value in (5, 8, 11.26, 16)),
)
"""Ways of summing pairs, and the radii of de Paula's list about its own 11.26 D [D, 5.2]."""


def _pair_sum_study() -> tuple[Scene, tuple[str, ...], Sequence[SolverSettings], dict[str, Any]]:
    """Piston's force on 1472 grains as they settle, by method of summing pairs."""
    scene = disturbed_lattice(1472).replace(name="1472 grains, by sum over pairs")
    settings = [SolverSettings("stormer-verlet", "auto", sums) for sums in SUMS]
    exact = SolverSettings("stormer-verlet", "auto/2", SUMS[0])
    return scene, ("piston force",), settings, {"until": 0.3, "references": [exact], "repeats": 1}


def _exact_grain_references() -> list[Any]:
    """Lone grain's exact energy error and position [D] after 1 s."""
    problem = exact_problem("bounce")
    return [0.0, problem.exact(1.0).positions / Scales.from_grains(problem.scene.grains).length]


def _measure_studies(
    scene: Scene, quantities: Sequence[str], settings: Sequence[SolverSettings], options: dict[str, Any]
) -> Plain:
    studies = work_precision_of_quantities(scene, quantities, settings, **options)
    return {"studies": [study.to_plain() for study in studies]}


# In the report ----------------------------------------------------------------------------------


def show_work_precision_section(page: HtmlPage, results: Sequence[Studies]) -> None:
    """Add a picture and a table for each quantity, and the settings to take, to a page."""
    studies = join_studies(results)
    page.add_paragraph(
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
    add_table_to_page(page, advised_setting_table(studies))
    for study in studies:
        with figure(width=WIDTH, height=5.0) as (drawing, axes):
            study.plot(axes)
            draw_legend_below(axes)
            until = "" if study.horizon is None else f" over {study.horizon:g} s"
            page.add_figure(drawing, f"{study.quantity} of {study.scene}{until}, against {study.reference}.")


def advised_setting_table(studies: Sequence[WorkPrecision]) -> TextTable:
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
    return text_table(header, rows)


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


def _study_tables(results: Sequence[Studies]) -> list[tuple[str, TextTable]]:
    title = "Cost of the {0.quantity} of {0.scene}; a star marks the best of all."
    return [
        *((title.format(study), study.table()) for study in join_studies(results)),
        ("What to take.", advised_setting_table(join_studies(results))),
    ]


def _studies_verdict(results: Sequence[Studies]) -> tuple[str, bool]:
    studies = join_studies(results)
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
    work_precision_tasks,
    studies_from_plain,
    _study_tables,
    _studies_verdict,
    show_work_precision_section,
)
