"""Sections of the report, on results made by hand: tables that answer at a glance, JSON and texts."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import pytest

from granular.shared.terminal import blocks_text
from validation.accuracy_cost import Studies, advised_setting_table
from validation.convergence_result import ConvergenceResult, FittedSlope, convergence_holds, slope_table
from validation.depaula_experiment import (
    COMPENSATED,
    PLAIN,
    TOOLKIT,
    DepaulaRun,
    DepaulaStepTest,
    depaula_blocks,
)
from validation.energy_drift import EnergyStudy, EnergyTrend
from validation.hard_case_outcomes import ACCURATE, DEGRADED, STOPPED, HardCaseOutcome, outcome_matrix
from validation.overview import EffectCost, EffectCosts, OverviewResult
from validation.report import outcomes_from_plain, report_page, section_tables
from validation.report_tasks import Outcome
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
        ("work-precision", Studies((COST,)), ("period of damper", "auto*8", "1.5")),
        ("stability", DROP, ("drop", "auto", "2.0e-02")),
        ("overview", OverviewResult((COST,), (), 5), ("damper: what accuracy costs", "auto*8: 1.5 s")),
        ("overview", OverviewResult(effects=EFFECTS), ("bed: what its effects cost", "1.25 ± 0.1")),
        ("overview", OverviewResult(outcomes=(DROP,)), ("Hard cases at a glance", "1")),
    ],
)
def test_figures_of_a_section_are_kept_and_said(name: str, result: Any, said: tuple[str, ...]) -> None:
    """As they come back from a file, on the console and on the page, with what failed."""
    outcomes = [Outcome("one", result), Outcome("the next", failed="RunError: off")]
    plain = json.loads(json.dumps([outcome.to_plain() for outcome in outcomes], allow_nan=False))
    read = outcomes_from_plain(name, plain)
    assert [outcome.result for outcome in read] == [result, None]
    text, page = blocks_text(section_tables(name, read)), report_page({name: read}, full=False).to_html()
    assert all(words in text for words in (*said, "the next failed: RunError: off")), text
    assert str(math.nan) not in text
    assert said[0] in page.replace("\u2011", "-")  # which keeps a number on one line
    assert "the next failed: RunError: off" in page


def result(
    problem: str, method: str, order: int, slope: float | None, finest: float = 0.01
) -> ConvergenceResult:
    fit = None if slope is None else FittedSlope(slope, (slope, slope), 0, 1)
    return ConvergenceResult(problem, method, order, True, (0.1, finest), (1.0, 0.1), 1e-3, fit, (0.1, 0.1))


@pytest.mark.parametrize(
    ("method", "order", "slope", "holds"),
    [
        ("stormer-verlet", 2, 2.019, True),
        ("stormer-verlet", 2, 2.021, False),
        ("adaptive-verlet", 2, 1.979, False),
        ("pefrl", 4, 3.91, True),
        ("pefrl", 4, 3.89, False),
        ("yoshida-6", 6, None, False),
        ("kahan-li-8", 8, None, True),
    ],
)
def test_a_slope_holds_within_its_tolerance(
    method: str, order: int, slope: float | None, holds: bool
) -> None:
    assert convergence_holds(result("bounce", method, order, slope)) is holds


def test_a_slope_over_less_than_a_decade_does_not_hold() -> None:
    assert not convergence_holds(result("bounce", "pefrl", 4, 4.0, finest=0.02))
    assert convergence_holds(result("bounce", "kahan-li-8", 8, 8.0, finest=0.02))


@pytest.mark.parametrize(
    ("slope", "holds"), [(2.95, True), (3.33, True), (3.88, True), (2.8, False), (4.2, False)]
)
def test_an_odd_order_may_show_the_next(slope: float, holds: bool) -> None:
    assert convergence_holds(result("bounce", "ruth-3", 3, slope)) is holds


def test_slopes_stand_in_rows_by_order() -> None:
    found = slope_table(
        [
            result("bounce", "pefrl", 4, 4.001),
            result("bounce", "symplectic-euler", 1, 1.0),
            result("drag", "symplectic-euler", 1, 1.5),
        ]
    )
    assert found.header == ("method", "order", "bounce", "drag")
    assert found.rows == [("symplectic-euler", 1, "1.000", "1.500 (!)"), ("pefrl", 4, "4.001", "")]


def ended(case: str, dt: str, kind: str, error: float, allowed: bool = True) -> HardCaseOutcome:
    said = "EnergyError: step 3: off" if kind == STOPPED else ""
    return HardCaseOutcome(case, "stormer-verlet", dt, kind, error, 0.1, said, allowed, 1.0, "distance [D]")


def test_outcomes_stand_in_a_row_a_case() -> None:
    found = outcome_matrix(
        [
            ended("drop", "auto", ACCURATE, 0.02),
            ended("limit", "0.5", STOPPED, math.nan),
            ended("drop", "auto*4", DEGRADED, 0.5, allowed=False),
            ended("drop", "auto/4", ACCURATE, 0.0),
        ]
    )
    assert found.header == (
        "case",
        "error of what [unit]",
        "accurate up to",
        "its own settings",
        "dt = auto*4",
        "dt = auto/4",
    )
    assert found.rows == [
        ("drop", "distance [D]", "1e-01", "accurate: 0.02", "degraded and said so: 0.5 (!)", "accurate: 0"),
        ("limit", "distance [D]", "1e-01", "stopped: EnergyError", "", ""),
    ]


def test_choices_say_their_share_of_the_default_time() -> None:
    coarse = WorkPrecisionPoint(SolverSettings("stormer-verlet", "auto*4"), 5e-3, 1.0, 10)
    usual = WorkPrecisionPoint(SolverSettings(*USUAL, {"effects.friction.scheme": "velocity"}), 1e-4, 4.0, 40)
    study = WorkPrecision("bed", "energy", "1", None, (coarse, usual), 0.0, "the value 0")
    good, _, none = advised_setting_table([study]).rows
    assert good[2:] == ("1 %", "stormer-verlet", "auto*4", "0.005", "1", "1", "0.25")
    assert none[2:4] == ("1e-6", "none reaches it")
    exact = dataclasses.replace(usual, error=0.0)
    scattered = WorkPrecision("bed", "energy", "1", None, (coarse, exact), 1e-3, "")
    (_, below, _) = advised_setting_table([scattered]).rows
    assert below[3:] == ("any: starts scatter by 0.001", "auto", "0", "4", "16", "4")


def test_the_section_of_de_paula_tells_slope_scatter_and_peaks() -> None:
    """Errors of h^2 without rounding: relative to the finest of 4, 2, 1 they are 15 and 3."""
    experiment = DepaulaStepTest(RUNS)
    assert experiment.error_slope(COMPENSATED) == pytest.approx(2.0)
    assert experiment.slope_relative_to_finest(COMPENSATED) == pytest.approx(math.log2(5.0))
    assert experiment.scatter_about_slope(COMPENSATED) == pytest.approx(0.0, abs=1e-9)
    text = blocks_text(depaula_blocks([experiment]))
    assert "slope 2.0000" in text
    assert "makes a slope of 2.322" in text
    assert "difference of two peaks is 3.0e-09 m" in text
