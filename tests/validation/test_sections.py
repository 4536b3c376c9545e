"""The first screen and the sections of the report: tables, JSON and texts."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import pytest

from granular import Scene, effect
from granular.shared.blocks import blocks_text
from validation import overview
from validation.accuracy_cost import (
    TaskStudies,
    WorkPrecisionPlan,
    advised_setting_table,
    work_precision_task,
)
from validation.convergence_result import ConvergenceResult, FittedSlope, convergence_holds, slope_table
from validation.depaula_step_test import (
    COMPENSATED,
    PLAIN,
    TOOLKIT,
    DepaulaRun,
    DepaulaStepTest,
    depaula_step_test_blocks,
)
from validation.energy_drift import EnergyStudy, EnergyTrend
from validation.hard_case_outcomes import ACCURATE, DEGRADED, STOPPED, HardCaseOutcome, outcome_matrix
from validation.overview import (
    NOTHING,
    EffectCost,
    EffectCosts,
    ErrorAtFreshStart,
    OverviewResult,
    advice_table,
    choose_settings_starts_and_reference,
    effect_costs,
    overview_blocks,
    overview_tasks,
    quantities_suitable_for_scene,
)
from validation.report import outcomes_from_plain, report_page, section_tables, verdicts_and_passed
from validation.report_tasks import Outcome, run_tasks
from validation.work_precision_result import USUAL, SolverSettings, WorkPrecision, WorkPrecisionPoint

ORDER = ConvergenceResult(
    *("bounce", "pefrl", 4, True, (0.1, 0.01), (1.0, 1e-4), 1e-9),
    fit=FittedSlope(4.01, (3.9, 4.1), 0, 1),
    seconds=(0.1, 1.0),
)
UNFITTED = dataclasses.replace(ORDER, method="of-three-steps", fit=None)
TREND = EnergyTrend(1e-3, (5e-4, 2e-3), 1e-3, 1e-3, 0.1, 1.0)
ENERGY = EnergyStudy(
    *("swing", "explicit-euler", False, 0.1, 10, None, (0.0, 0.5, 1.0), (0.0, 5e-4, 1e-3), TREND),
    heights=(2.0, 1.0, 2.0),
    velocities=(0.0, -1.0, 0.0),
)
POINT = WorkPrecisionPoint(SolverSettings("stormer-verlet", "auto*8"), 2e-3, 1.5, 100, None, 1e-4, 5)
COST = WorkPrecision("damper", "period", "1", None, (POINT,), 1e-4, "finer")
DROP = HardCaseOutcome("drop", "stormer-verlet", "auto", ACCURATE, 0.02, 0.1, "", True, 1.0, "distance [D]")
EFFECTS = EffectCosts("bed", 2, 3.0, 1.0, (EffectCost("drag", 1.5, 0.1, 1.25, 0.1),), {"direct": 3.0})
RUNS = tuple(
    DepaulaRun(form, h, 0.1 + error * h * h, error * h * h, 1.0, (1e-9, -2e-9), (0.2, 0.1, 0.2))
    for form, error in ((PLAIN, 1e4), (COMPENSATED, 1e3), (TOOLKIT, 1e3))
    for h in (4e-6, 2e-6, 1e-6)
)


@pytest.mark.parametrize(
    ("name", "result", "said"),
    [
        ("convergence", ORDER, ("bounce", "pefrl", "4.0100")),
        ("convergence", UNFITTED, ("of-three-steps", "too few steps above rounding")),
        ("depaula", DepaulaStepTest(RUNS), ("4e-06", "1.60e-07")),
        ("energy", ENERGY, ("swing", "explicit-euler", "gains")),
        ("work-precision", TaskStudies((COST,)), ("period of damper", "auto*8", "1.5")),
        ("stability", DROP, ("drop", "auto", "2.0e-02")),
        ("overview", OverviewResult((COST,), (), 5), ("damper: cost of accuracy", "auto*8: 1.5 s")),
        ("overview", OverviewResult(effects=EFFECTS), ("bed: cost of effects", "1.25 ± 0.1")),
        ("overview", OverviewResult(outcomes=(DROP,)), ("Hard cases: overview", "1")),
    ],
)
def test_results_of_a_section_are_cached_and_shown(name: str, result: Any, said: tuple[str, ...]) -> None:
    """Results from a file appear on the console and on the page, with the failures."""
    outcomes = [Outcome("one", result), Outcome("the next", failed="RunError: off")]
    plain = json.loads(json.dumps([outcome.to_plain() for outcome in outcomes], allow_nan=False))
    read = outcomes_from_plain(name, plain)
    assert [outcome.result for outcome in read] == [result, None]
    text, page = blocks_text(section_tables(name, read)), report_page({name: read}, full=False).to_html()
    assert all(words in text for words in (*said, "the next failed: RunError: off")), text
    assert str(math.nan) not in text
    assert said[0] in page.replace("\u2011", "-")  # keeps a number on one line
    assert "the next failed: RunError: off" in page


def result(
    problem: str, method: str, order: int, slope: float | None, finest: float = 0.01
) -> ConvergenceResult:
    fit = None if slope is None else FittedSlope(slope, (slope, slope), 0, 1)
    return ConvergenceResult(problem, method, order, True, (0.1, finest), (1.0, 0.1), 1e-3, fit, (0.1, 0.1))


@pytest.mark.parametrize(
    ("method", "order", "slope", "finest", "holds"),
    [
        ("stormer-verlet", 2, 2.019, 0.01, True),
        ("stormer-verlet", 2, 2.021, 0.01, False),
        ("adaptive-verlet", 2, 1.979, 0.01, False),
        ("pefrl", 4, 3.91, 0.01, True),
        ("pefrl", 4, 3.89, 0.01, False),
        ("yoshida-6", 6, None, 0.01, False),
        ("kahan-li-8", 8, None, 0.01, True),
        ("pefrl", 4, 4.0, 0.02, False),  # less than a decade
        ("kahan-li-8", 8, 8.0, 0.02, True),
        *(
            ("ruth-3", 3, slope, 0.01, True) for slope in (2.95, 3.33, 3.88)
        ),  # an odd order may show the next one
        *(("ruth-3", 3, slope, 0.01, False) for slope in (2.8, 4.2)),
    ],
)
def test_a_slope_passes_within_its_tolerance(
    method: str, order: int, slope: float | None, finest: float, holds: bool
) -> None:
    assert convergence_holds(result("bounce", method, order, slope, finest)) is holds


def test_rows_of_the_slope_table_are_sorted_by_order() -> None:
    slopes = [("bounce", "pefrl", 4, 4.001), ("bounce", "symplectic-euler", 1, 1.0)]
    found = slope_table([result(*one) for one in (*slopes, ("drag", "symplectic-euler", 1, 1.5))])
    assert found.header == ("method", "order", "bounce", "drag")
    assert found.rows == [("symplectic-euler", 1, "1.000", "1.500 (!)"), ("pefrl", 4, "4.001", "")]


def test_table_of_outcomes_has_one_row_per_difficult_scene() -> None:
    bad = dataclasses.replace(DROP, dt="auto*4", kind=DEGRADED, error=0.5, allowed=False)
    stopped = dataclasses.replace(
        DROP, case="limit", dt="0.5", kind=STOPPED, error=math.nan, said="EnergyError: step 3: off"
    )
    found = outcome_matrix([DROP, stopped, bad])
    assert found.header[3:] == ("settings of the case", "dt = auto*4")
    assert found.rows == [
        ("drop", "distance [D]", "1e-01", "accurate: 0.02", "degraded, with warning: 0.5 (!)"),
        ("limit", "distance [D]", "1e-01", "stopped: EnergyError", ""),
    ]


def test_advised_settings_show_their_time_relative_to_the_default() -> None:
    coarse = WorkPrecisionPoint(SolverSettings("stormer-verlet", "auto*4"), 5e-3, 1.0, 10)
    usual = WorkPrecisionPoint(SolverSettings(*USUAL, {"effects.friction.scheme": "velocity"}), 1e-4, 4.0, 40)
    found = WorkPrecision("bed", "energy", "1", None, (coarse, usual), 0.0, "the value 0")
    good, _, none = advised_setting_table([found]).rows
    assert good[2:] == ("1 %", "stormer-verlet", "auto*4", "0.005", "1", "1", "0.25")
    assert none[2:4] == ("1e-6", "not reached")


def test_the_section_on_de_paula_shows_the_slope_the_scatter_and_the_peaks() -> None:
    """If the error of a step h is h^2, the results of steps 4 and 2 differ from the result of step 1 by
    15 and 3.
    """
    experiment = DepaulaStepTest(RUNS)
    assert experiment.error_slope(COMPENSATED) == pytest.approx(2.0)
    assert experiment.slope_relative_to_finest(COMPENSATED) == pytest.approx(math.log2(5.0))
    assert experiment.maximum_deviation_from_power_law(COMPENSATED) == pytest.approx(0.0, abs=1e-9)
    text = blocks_text(depaula_step_test_blocks([experiment]))
    assert "slope 2.0000" in text
    assert "have a slope of 2.322" in text
    assert "difference of two peaks is 3.0e-09 m" in text


def study(floor: float) -> WorkPrecision:
    points = (
        WorkPrecisionPoint(SolverSettings("stormer-verlet", "auto*8"), 2e-3, 1.0, 100, None, 1e-4, 5),
        WorkPrecisionPoint(SolverSettings("stormer-verlet", "auto*4"), 5e-4, 2.0, 200, None, 1e-5, 5),
    )
    return WorkPrecision("damper", "period", "1", None, points, floor, "finer")


def overview_result(holds: bool) -> list[Outcome]:
    fresh = ErrorAtFreshStart("damper", "period", "1 %", "a", 0.1, holds)
    return [Outcome("damper: accuracy", OverviewResult((study(1e-4),), (fresh,), 5))]


def test_suitable_quantities_depend_on_the_piston_and_the_stages_of_a_scene(
    bed: Scene, damper: Scene
) -> None:
    alone = bed.replace(**{"piston": None, "effects.walls.top": None})
    assert quantities_suitable_for_scene(damper) == ("rest height", "period", "damping ratio", "energy")
    assert quantities_suitable_for_scene(bed) == ("piston force", "mean distance", "energy")
    assert quantities_suitable_for_scene(alone) == ("energy", "positions")


def test_the_table_of_advice_has_one_row_per_quantity() -> None:
    found = advice_table([study(1e-4), study(5e-3)])
    assert found.header[:4] == ("quantity", "1 %", "0.1 %", "1e-6")
    assert found.rows[0][:4] == (
        "period",
        "auto*8: 1 s",
        "auto*4: 2 s",
        "single runs scatter by 0.0001 over the starts, and every setting tried also has a systematic error",
    )
    assert found.rows[1][4] == "0.005"


def test_an_error_above_the_tolerance_on_a_new_start_fails_the_report() -> None:
    assert verdicts_and_passed({"overview": overview_result(True)})["holds"] is True
    bad = {"overview": overview_result(False)}
    assert verdicts_and_passed(bad)["holds"] is False
    assert "Failed: overview." in report_page(bad, full=False).to_html()


@pytest.mark.parametrize(("first", "last", "alike"), [(1.0, 1.2, True), (1.0, 1.3, False)])
def test_two_measured_costs_of_an_effect_count_as_equal_within_a_fifth(
    first: float, last: float, alike: bool
) -> None:
    cost = EffectCost("drag", first, 0.1, last, 0.1)
    assert cost.costs_agree() is alike
    costs = EffectCosts("s", 2, 3.0, 1.0, (cost, cost._replace(first=math.nan)), {"direct": 3.0})
    rows = costs.table().rows
    assert rows[0][3] == ("yes" if alike else "no")
    assert rows[1][1] == "cannot be run"
    again = EffectCosts.from_plain(json.loads(json.dumps(costs.to_plain(), allow_nan=False)))
    assert "direct 3 microseconds" in blocks_text(overview_blocks([OverviewResult(effects=again)]))


@pytest.mark.long
def test_computing_time_of_each_effect_is_measured_in_a_small_bed(small_bed: Scene) -> None:
    found = effect_costs(small_bed, rounds=3, workers=1)
    assert {cost.effect for cost in found.effects} == {"dipole", "walls", "gravity", "drag"}
    assert all(math.isfinite(cost.first) for cost in found.effects)
    assert 0.0 < found.nothing < found.step
    assert set(found.sums) == {"direct", "cut-off", "mesh"}
    assert NOTHING not in found.sums


@pytest.mark.long
def test_planned_runs_stay_within_the_time_limit(small_bed: Scene) -> None:
    """More time allows finer steps, and a reference that is finer than all of them."""
    short, long = (choose_settings_starts_and_reference(small_bed, 0.01, seconds) for seconds in (1e-3, 10.0))
    assert len(short[0]) < len(long[0])
    assert long[2].dt == "auto/8"
    assert len(long[1]) > 1


def test_an_edited_effect_is_measured_again(bed: Scene) -> None:
    """The text of the scene is unchanged, but the functions of its effect differ."""

    def keys(factor: float) -> list[Any]:
        @effect
        class EditedPush:
            @staticmethod
            def energy(p: Any, grain: Any, time: float, factor: float = factor) -> float:
                return factor * grain.y

            @staticmethod
            def force(p: Any, grain: Any, time: float, factor: float = factor) -> tuple[float, float]:
                return 0.0, -factor

        scene = bed.replace(**{"effects.edited_push": True})
        tasks = overview_tasks([scene], full=False, hard=False)
        return [
            task.key for task in (*tasks, work_precision_task(WorkPrecisionPlan(scene, ("energy",), (), {})))
        ]

    assert all(first != second for first, second in zip(keys(1.0), keys(2.0), strict=True))


def test_the_first_screen_for_a_small_bed_shows_advice_tested_on_a_new_start(
    small_bed: Scene, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The first screen is shown on the page and on the console."""
    monkeypatch.setattr(overview, "QUICK_SECONDS", 1e-3)
    monkeypatch.setattr(overview, "STEPS", ("auto*8", "auto*4", "auto*2"))
    monkeypatch.setattr(overview, "OTHERS", ())
    settle = {"kind": "hold", "name": "settle", "duration": "0.01 s"}
    scene = small_bed.replace(name="bed of 23", protocol=[settle])
    tasks = overview_tasks([scene], full=False, hard=False)[:1]
    found = run_tasks("overview", tasks, tmp_path, OverviewResult, progress=False)
    measured = found[0].result
    assert [study.quantity for study in measured.studies] == ["piston force", "mean distance", "energy"]
    assert measured.starts > 1
    assert "mean distance" in {start.quantity for start in measured.fresh}
    assert all(math.isfinite(start.error) for start in measured.fresh)
    assert run_tasks("overview", tasks, tmp_path, OverviewResult, progress=False) == found  # from the cache
    text = blocks_text(section_tables("overview", found))
    assert "bed of 23: cost of accuracy" in text
    assert "bed of 23" in report_page({"overview": found}, full=False).to_html()
