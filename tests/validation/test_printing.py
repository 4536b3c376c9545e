"""What a part's results say on the console: the same figures as on the page, and what failed."""

from __future__ import annotations

import json
import math

import pytest

from validation.convergence_result import ConvergenceResult, FittedSlope
from validation.depaula_experiment import COMPENSATED, PLAIN, TOOLKIT, DepaulaRun, DepaulaStepTest
from validation.energy_drift import EnergyStudy
from validation.hard_case_outcomes import ACCURATE, HardCaseOutcome
from validation.report import outcomes_from_plain, section_text
from validation.report_tasks import FAILED, Plain
from validation.trend_significance import EnergyTrend
from validation.work_precision_result import SolverSettings, WorkPrecision, WorkPrecisionPoint

ORDER = ConvergenceResult(
    "bounce",
    "pefrl",
    4,
    True,
    (0.1, 0.01),
    (1.0, 1e-4),
    1e-9,
    FittedSlope(4.01, (3.9, 4.1), 0, 1),
    (0.1, 1.0),
)
TREND = EnergyTrend(1e-3, (5e-4, 2e-3), 1e-3, 1e-3, 0.1, 1.0)
ENERGY = EnergyStudy(
    "swing",
    "explicit-euler",
    False,
    0.1,
    10,
    None,
    (0.0, 0.5, 1.0),
    (0.0, 5e-4, 1e-3),
    TREND,
    (2.0, 1.0, 2.0),
    (0.0, -1.0, 0.0),
)
COST = WorkPrecision(
    "damper",
    "period",
    "1",
    None,
    (WorkPrecisionPoint(SolverSettings("stormer-verlet", "auto*8"), 2e-3, 1.5, 100, None, 1e-4, 5),),
    1e-4,
    "finer",
)
CASE = HardCaseOutcome("drop", "stormer-verlet", "auto", ACCURATE, 0.02, 0.1, "", True, 1.0, "distance [D]")
SOURCE = DepaulaStepTest(
    tuple(
        DepaulaRun(form, h, 0.1 + 1e4 * h * h, 1e4 * h * h, 1.0, (1e-9,), (0.2, 0.1))
        for form in (PLAIN, COMPENSATED, TOOLKIT)
        for h in (4e-6, 2e-6, 1e-6)
    )
)


@pytest.mark.parametrize(
    ("part", "plain", "said"),
    [
        ("convergence", ORDER.to_plain(), ("bounce", "pefrl", "4.0100")),
        ("depaula", SOURCE.to_plain(), ("4e-06", "1.60e-07")),
        ("energy", ENERGY.to_plain(), ("swing", "explicit-euler", "gains")),
        ("work-precision", {"studies": [COST.to_plain()]}, ("period of damper", "auto*8", "1.5")),
        ("stability", CASE.to_plain(), ("drop", "auto", "2.0e-02")),
        (
            "overview",
            {"studies": [COST.to_plain()], "fresh": [], "starts": 5},
            ("damper: what accuracy costs", "auto*8: 1.5 s"),
        ),
        ("overview", {"outcomes": [CASE.to_plain()]}, ("1",)),
    ],
)
def test_a_parts_figures_are_said(part: str, plain: Plain, said: tuple[str, ...]) -> None:
    kept = json.loads(json.dumps(plain))  # as it comes back from a file
    failed = {"label": "the next", FAILED: "RunError: off"}
    text = section_text(part, outcomes_from_plain(part, [kept, failed]))
    assert all(words in text for words in said), text
    assert "the next failed: RunError: off" in text
    assert str(math.nan) not in text
