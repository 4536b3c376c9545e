"""Overview: the first screen of the report.

It answers three questions of a user: what accuracy costs in a scene, what its effects cost, and how
hard cases end.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from granular.methods import METHODS
from granular.run.plan import can_run
from granular.run.work_precision import FLOORS
from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from granular.shared.errors import GranularError
from granular.shared.files import replace_non_finite_by_none
from granular.shared.plotting import COLOURS, GREY, STYLES, figure
from validation.cost.advised_setting import (
    USUAL,
    AdvisedSetting,
    SolverSettings,
    WorkPrecisionPoint,
    duration_text,
)
from validation.cost.report_section import studies_from_plain
from validation.cost.work_precision import (
    STEPS,
    depends_on_seed,
    make_work_precision,
    measure_points,
    reference_setting,
    reference_values,
    run_setting,
    scenes_with_other_seeds,
)
from validation.cost.work_precision_result import LEVELS, WorkPrecision, label_run_times
from validation.effect_costs import effect_costs, first_and_last_costs_agree
from validation.hard_case_outcomes import (
    ACCURATE,
    DEGRADED,
    STOPPED,
    HardCaseOutcome,
    outcome_summary,
    run_hard_case,
)
from validation.hard_cases import COSTLY, hard_case_catalogue
from validation.measured_quantities import QUANTITIES, MeasuredQuantity
from validation.report_scenes import compression_scene
from validation.report_tasks import Plain, Section, Task, scene_key
from validation.text_tables import WIDTH, TextTable, add_table_to_page, draw_legend_below, text_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from granular.shared.html_pages import HtmlPage
    from validation.cost.work_precision import ReferenceValue

QUICK_SECONDS, FULL_SECONDS = 75.0, 1200.0
"""Time that the runs of one scene may take [s]."""

MANY_STARTS, FEW_STARTS = 8, 3
"""Starts of a scene whose runs are short, and of one whose are long."""

OTHERS = ("blanes-moan-4",)
"""Methods next to Verlet's, in steps as long as their fraction of the time allows."""

FRACTION = 0.25
"""Fraction of the time for each other method."""

SINGLE = 0.3
"""Length of a run without a piston [s]: positions mean something over a short time only."""


def overview_tasks(scenes: Sequence[Scene], full: bool, *, hard: bool) -> list[Task]:
    """Tasks that measure the accuracy and the effects' costs of scenes."""
    seconds = FULL_SECONDS if full else QUICK_SECONDS
    tasks = []
    for scene in scenes:
        key = {**scene_key(scene), "name": scene.name}
        tasks += [
            Task(
                f"{scene.name}: accuracy",
                {**key, "seconds": seconds},
                partial(_measure_accuracy, scene, seconds),
            ),
            Task(f"{scene.name}: effects", {**key, "what": "effects"}, partial(_measure_effects, scene)),
        ]
    return [*tasks, Task("hard cases", {"what": "hard cases"}, _run_hard_cases)] if hard else tasks


def _measure_effects(scene: Scene) -> Plain:
    return {"effects": replace_non_finite_by_none(effect_costs(scene))}


def _run_hard_cases() -> Plain:
    light = [case for case in hard_case_catalogue() if not any(word in case.name for word in COSTLY)]
    return {"outcomes": [run_hard_case(case).to_plain() for case in light]}


def suitable_quantities(scene: Scene) -> tuple[str, ...]:
    """Names of the quantities that a scene is made for, by its piston and its stages."""
    if scene.piston is None:
        return ("energy", "positions")
    rests = any(getattr(stage, "until", None) == "rest" for stage in scene.protocol)
    swings = scene.output.record is not None
    result = ("rest height",) if rests else ("piston force", "mean distance")
    return (*result, *(("period", "damping ratio") if swings else ()), "energy")


def _measure_accuracy(scene: Scene, seconds: float) -> Plain:
    """Studies of a scene's quantities, and how one fresh start met what they advise."""
    until = SINGLE if scene.piston is None else None
    chosen = [QUANTITIES[name] for name in suitable_quantities(scene)]
    ladder, scenes, reference = plan_runs(scene, until, seconds)
    given = [None if quantity.exact is not None else reference for quantity in chosen]
    truth = reference_values(scenes, chosen, given, until)
    rows = [measure_points(scenes, chosen, item, truth, until, 1) for item in ladder]
    studies = [
        make_work_precision(scene, quantity, until, [row[k] for row in rows], truth[k])
        for k, quantity in enumerate(chosen)
    ]
    fresh = _check_with_fresh_start(scenes, chosen, truth, studies, until) if len(scenes) > 1 else []
    return {"studies": [study.to_plain() for study in studies], "fresh": fresh, "starts": len(scenes)}


def plan_runs(
    scene: Scene, until: float | None, seconds: float
) -> tuple[list[SolverSettings], tuple[Scene, ...], SolverSettings]:
    """Plan settings, starts and a reference whose runs fit into a time; until, seconds [s]."""
    steps = [dt for dt in STEPS if can_run(scene, dt, "stormer-verlet")]
    took = _run_seconds(scene, SolverSettings("stormer-verlet", steps[0]), until)
    random = depends_on_seed(scene)
    many = random and MANY_STARTS * took * 2.0**6 <= seconds
    starts = (MANY_STARTS if many else FEW_STARTS) if random else 1
    # Each halving takes twice the time of the run before: n runs take 2^n - 1 times the first, and the
    # reference, one halving further, as long as all of them.
    entries = math.floor(math.log2(seconds / (starts * took) + 1.0)) - 1
    entries = min(max(entries, 2), len(steps) - 1)
    ladder = [SolverSettings("stormer-verlet", dt) for dt in steps[:entries]]
    for name in OTHERS:
        calls = METHODS[name].force_evaluations_per_step
        runs = seconds * FRACTION / (starts * took * calls)
        more = min(math.floor(math.log2(runs + 1.0)), len(steps)) if runs >= 1.0 else 0
        ladder += [SolverSettings(name, dt) for dt in steps[:more] if can_run(scene, dt, name)]
    reference = SolverSettings("stormer-verlet", steps[entries]) if random else reference_setting(scene)
    return ladder, scenes_with_other_seeds(scene, starts - 1), reference


def _run_seconds(scene: Scene, setting: SolverSettings, until: float | None) -> float:
    """Time of a run, compiled before [s]."""
    run_setting(scene, setting._replace(dt="auto"), 1e-3 * scene.output.scalars)
    start = time.perf_counter()
    run_setting(scene, setting, until)
    return time.perf_counter() - start


def _check_with_fresh_start(
    scenes: Sequence[Scene],
    quantities: Sequence[MeasuredQuantity],
    truth: Sequence[ReferenceValue],
    studies: Sequence[WorkPrecision],
    until: float | None,
) -> list[dict[str, Any]]:
    """One more start, run with each setting that a single run is advised of."""
    # Its value is compared with the mean of the reference over the other starts, or with the exact one.
    last = scenes[-1].arrangement.seed
    other = scenes[0].replace(**{"arrangement.seed": last + 1})
    runs: dict[str, Any] = {}
    result = []
    for quantity, item, study in zip(quantities, truth, studies, strict=True):
        if quantity.differs_by_start and quantity.exact is None:
            continue
        for words, level in LEVELS.items():
            best = study.cheapest_point(level)
            if best is None:
                continue
            label = f"{best.setting.family}, {best.setting.dt}"
            if label not in runs:
                runs[label] = run_setting(other, best.setting, until)
            mean = sum(item.values) / len(item.values)
            error = _error_of_quantity(quantity, runs[label], mean)
            result.append(
                {
                    "scene": other.name,
                    "quantity": quantity.name,
                    "level": words,
                    "setting": label,
                    "error": error,
                    "holds": error <= level,
                }
            )
    return result


def _error_of_quantity(quantity: MeasuredQuantity, item: Any, reference: Any) -> float:
    try:
        return quantity.error(quantity.measure(item), reference)
    except GranularError:
        return math.inf


def cost_of_digit_text(study: WorkPrecision, best: WorkPrecisionPoint | None) -> str:
    """Text of the factor by which the time grows for a tenth of the error."""
    measured = study.cost_of_digit()
    if measured is not None:
        return f"{measured:.2g} times"
    order = METHODS[best.setting.method].order if best is not None else 2
    return f"{10.0 ** (1.0 / order):.2g} times, by the order"


# In the report ----------------------------------------------------------------------------------


def show_overview_section(page: HtmlPage, results: Sequence[Plain]) -> None:
    """Add the costs of accuracy and effects of each scene, and the hard cases, to a page."""
    for result in results:
        if "studies" in result:
            _show_accuracy(page, result)
        elif "effects" in result:
            _show_effects(page, result["effects"])
    if outcomes := _outcomes_of_results(results):
        page.add_section("Hard cases at a glance")
        add_table_to_page(page, outcome_count_table(outcomes))


def _outcomes_of_results(results: Sequence[Plain]) -> list[HardCaseOutcome]:
    return [HardCaseOutcome.from_plain(row) for result in results for row in result.get("outcomes", ())]


def _show_accuracy(page: HtmlPage, plain: Plain) -> None:
    studies = studies_from_plain(plain)
    first, starts = studies[0], plain["starts"]
    page.add_section(f"{first.scene}: what accuracy costs")
    if starts > 1:
        page.add_paragraph(
            f"Errors are means over {starts} starts, against a finer step from the same starts; "
            "bars end at the bound that the starts allow. Dashed: how far the starts themselves "
            f"scatter. One run cannot be trusted below {FLOORS:g} times that, whatever its step; "
            "the mean of more starts can, at their price. Where no method is named it is "
            f"{USUAL[0]}."
        )
    with figure(width=WIDTH, height=4.2) as (drawing, axes):
        plot_error_over_run_time(axes, studies)
        draw_legend_below(axes)
        until = "" if first.horizon is None else f" over {first.horizon:g} s"
        page.add_figure(drawing, f"{first.scene}{until}: error over the time of a run.")
    add_table_to_page(page, advice_table(studies))


def plot_error_over_run_time(axes: Axes, studies: Sequence[WorkPrecision]) -> None:
    """Draw errors over the time [s] of a run: a colour a quantity, a line a method."""
    for k, study in enumerate(studies):
        colour = COLOURS[k % len(COLOURS)]
        for j, (name, family) in enumerate(study.points_by_family().items()):
            done = [point for point in family if not point.has_failed and point.error > 0.0]
            seconds = [point.seconds for point in done]
            words = study.quantity if j == 0 else f"{study.quantity}, {name}"
            axes.loglog(
                seconds,
                [point.error for point in done],
                marker="os^vD"[j % 5],
                markersize=3.5,
                color=colour,
                linestyle=STYLES[j % len(STYLES)],
                linewidth=1.2,
                label=words,
            )
            axes.vlines(
                seconds,
                [point.error for point in done],
                [point.upper_error_bound for point in done],
                color=colour,
                linewidth=0.8,
            )
        if study.floor > 0.0:
            axes.axhline(study.floor, color=colour, linestyle=(0, (6, 3)), linewidth=0.9)
    for level in LEVELS.values():
        axes.axhline(level, color=GREY, linewidth=0.6, linestyle=":")
    label_run_times(axes)
    axes.set(xlabel="time of a run [s]", ylabel="error")


def advice_table(studies: Sequence[WorkPrecision]) -> TextTable:
    """Table of the settings to take for each quantity and tolerance, with their times."""
    rows = []
    for study in studies:
        advised = [study.advise(level) for level in LEVELS.values()]
        scatter = f"{study.floor:.1g}" if study.floor else "none"
        rows.append(
            (
                study.quantity,
                *map(_setting_and_price, advised),
                scatter,
                cost_of_digit_text(study, advised[0].point),
            )
        )
    return text_table(("quantity", *LEVELS, "starts scatter by", "a digit costs"), rows)


def _setting_and_price(advice: AdvisedSetting) -> str:
    """Return the setting to take for a level, and its price."""
    if advice.point is None:
        return str(advice)
    method, price = advice.point.setting.method, duration_text(advice.seconds)
    if advice.needs_more_starts:
        number = f"{advice.starts:d}" if advice.starts < 1000 else f"{advice.starts:.0e}"
        return f"{number} starts of any step: {price}"
    named = "" if method == USUAL[0] else f"{method} "
    return f"{named}{advice.point.setting.fineness}: {price}"


# Effects ----------------------------------------------------------------------------------------


def _show_effects(page: HtmlPage, plain: Mapping[str, Any]) -> None:
    page.add_section(f"{plain['scene']}: what its effects cost")
    page.add_paragraph(
        f"Microseconds of a step of {plain['grains']} grains on one core, medians of interleaved "
        f"runs: {plain['step']:.3g} with all effects, {plain['nothing']:.2g} with none. An effect "
        "that is added to others may share their work: both prices stand where they differ by "
        "more than a fifth. What a scene does not name leaves nothing in its step; "
        '"python -m benchmarks --part absent" times that next to steps written by hand.'
    )
    add_table_to_page(page, effect_cost_table(plain))
    sums = ", ".join(f"{name} {value:.3g}" for name, value in plain["sums"].items())
    page.add_paragraph(f"A whole step by the sum over pairs: {sums} microseconds.")


def effect_cost_table(plain: Mapping[str, Any]) -> TextTable:
    """Table of the cost of each effect: what it adds first and what it saves last [us]."""
    rows = []
    for effect in plain["effects"]:
        first, last = _effect_cost_text(effect, "first"), _effect_cost_text(effect, "last")
        both = effect["first"] is not None and effect["last"] is not None
        shown = "yes" if both and first_and_last_costs_agree(effect) else "no"
        rows.append((effect["effect"], first, last, shown))
    header = (
        "effect",
        "adds when it comes first [us]",
        "saves when taken away last [us]",
        "alike within a fifth",
    )
    return text_table(header, rows)


def _effect_cost_text(mapping: Mapping[str, Any], which: str) -> str:
    value, doubt = mapping[which], mapping[f"{which}_doubt"]
    return "cannot be run" if value is None else f"{value:.3g} ± {doubt:.1g}"


# Hard cases -------------------------------------------------------------------------------------


def outcome_count_table(outcomes: Sequence[HardCaseOutcome]) -> TextTable:
    """Table of how many hard cases ended how, in one row."""
    counts = [sum(item.kind == kind for item in outcomes) for kind in (ACCURATE, DEGRADED, STOPPED)]
    wrong = [item.case for item in outcomes if not item.allowed]
    row = (len(outcomes), *counts, ", ".join(wrong) or "none")
    header = (
        "hard cases",
        "accurate",
        "degraded and said so",
        "stopped by a typed error",
        "ended as they must not",
    )
    return text_table(header, [row])


def _overview_tables(results: Sequence[Plain]) -> list[tuple[str, TextTable]]:
    tables = []
    for result in results:
        if "studies" in result:
            studies = studies_from_plain(result)
            tables.append((f"{studies[0].scene}: what accuracy costs", advice_table(studies)))
        elif "effects" in result:
            plain = result["effects"]
            tables.append((f"{plain['scene']}: what its effects cost", effect_cost_table(plain)))
    if outcomes := _outcomes_of_results(results):
        tables.append(("Hard cases", outcome_count_table(outcomes)))
    return tables


def _overview_verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    fresh = [row for outcome in results for row in outcome.get("fresh", ())]
    hard = _outcomes_of_results(results)
    missed = [
        f"{row['quantity']} of {row['scene']} to {row['level']} by {row['setting']}"
        for row in fresh
        if not row["holds"]
    ]
    words = f"{len(fresh) - len(missed)} of {len(fresh)} advised settings hold for a fresh start"
    if missed:
        words += f", not {'; '.join(missed)}"
    if hard:
        words += f"; {outcome_summary(hard).rstrip('.')}"
    return words, not missed and all(outcome.allowed for outcome in hard)


def overview_section_for(scenes: Sequence[Scene]) -> Section:
    """Overview section of the report for a user's own scenes, with the quick hard cases."""
    return OVERVIEW._replace(tasks=lambda full: overview_tasks(scenes, full, hard=True))


def _packaged_overview_tasks(full: bool) -> list[Task]:
    """Return the packaged damper, and the compression with dry friction."""
    return overview_tasks([load_scene("damper"), compression_scene()], full, hard=False)


OVERVIEW = Section(
    "overview", "", _packaged_overview_tasks, dict, _overview_tables, _overview_verdict, show_overview_section
)
