"""The first screen: what it measures for a small scene, and what it shows."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from granular import Scene, effect
from granular.shared.terminal import blocks_text
from validation import overview
from validation.accuracy_cost import Plan, work_precision_task
from validation.overview import (
    NOTHING,
    EffectCost,
    EffectCosts,
    FreshStart,
    OverviewResult,
    advice_table,
    effect_costs,
    overview_blocks,
    overview_tasks,
    plan_runs,
    suitable_quantities,
)
from validation.report import report_page, section_tables, summarise_verdicts
from validation.report_tasks import Outcome, run_tasks
from validation.work_precision_result import SolverSettings, WorkPrecision, WorkPrecisionPoint


def study(floor: float) -> WorkPrecision:
    points = (
        WorkPrecisionPoint(SolverSettings("stormer-verlet", "auto*8"), 2e-3, 1.0, 100, None, 1e-4, 5),
        WorkPrecisionPoint(SolverSettings("stormer-verlet", "auto*4"), 5e-4, 2.0, 200, None, 1e-5, 5),
    )
    return WorkPrecision("damper", "period", "1", None, points, floor, "finer")


def result(holds: bool) -> list[Outcome]:
    fresh = FreshStart("damper", "period", "1 %", "a", 0.1, holds)
    return [Outcome("damper: accuracy", OverviewResult((study(1e-4),), (fresh,), 5))]


def test_quantities_follow_the_stages(bed: Scene, damper: Scene) -> None:
    assert suitable_quantities(damper) == ("rest height", "period", "damping ratio", "energy")
    assert suitable_quantities(bed) == ("piston force", "mean distance", "energy")
    alone = bed.replace(**{"piston": None, "effects.walls.top": None})
    assert suitable_quantities(alone) == ("energy", "positions")


def test_advice_is_a_row_a_quantity() -> None:
    found = advice_table([study(1e-4), study(5e-3)])
    assert found.header[:4] == ("quantity", "1 %", "0.1 %", "1e-6")
    assert found.rows[0][:4] == (
        "period",
        "auto*8: 1 s",
        "auto*4: 2 s",
        "any of these: the starts scatter by 0.0001, and "
        "more of them would show what no setting tried is free of",
    )
    assert found.rows[1][4] == "0.005"


def test_a_fresh_start_that_misses_fails_the_report() -> None:
    assert summarise_verdicts({"overview": result(True)})["holds"] is True
    bad = {"overview": result(False)}
    assert summarise_verdicts(bad)["holds"] is False
    assert "Not all holds: overview." in report_page(bad, full=False).to_html()


@pytest.mark.parametrize(("first", "last", "alike"), [(1.0, 1.2, True), (1.0, 1.3, False)])
def test_prices_that_differ_by_more_than_a_fifth_both_stand(first: float, last: float, alike: bool) -> None:
    cost = EffectCost("drag", first, 0.1, last, 0.1)
    assert cost.agrees() is alike
    costs = EffectCosts("s", 2, 3.0, 1.0, (cost, cost._replace(first=math.nan)), {"direct": 3.0})
    rows = costs.table().rows
    assert rows[0][3] == ("yes" if alike else "no")
    assert rows[1][1] == "cannot be run"
    again = EffectCosts.from_plain(json.loads(json.dumps(costs.to_plain(), allow_nan=False)))
    assert "direct 3 microseconds" in blocks_text(overview_blocks([OverviewResult(effects=again)]))


@pytest.mark.long
def test_effects_of_a_small_bed_are_timed(small_bed: Scene) -> None:
    found = effect_costs(small_bed, rounds=3, workers=1)
    assert {cost.effect for cost in found.effects} == {"dipole", "walls", "gravity", "drag"}
    assert all(math.isfinite(cost.first) for cost in found.effects)
    assert 0.0 < found.nothing < found.step
    assert set(found.sums) == {"direct", "cut-off", "mesh"}
    assert NOTHING not in found.sums


@pytest.mark.long
def test_plan_keeps_to_its_time(small_bed: Scene) -> None:
    """More time buys finer steps, and a reference finer than all of them."""
    short, long = (plan_runs(small_bed, 0.01, seconds) for seconds in (1e-3, 10.0))
    assert len(short[0]) < len(long[0])
    assert long[2].dt == "auto/8"
    assert len(long[1]) > 1


def test_pieces_of_an_edited_effect_are_measured_again(bed: Scene) -> None:
    """Its scene is the same, as text; its functions are not."""
    keys = []
    for factor in (1.0, 2.0):

        @effect
        class EditedPush:
            @staticmethod
            def energy(p: Any, grain: Any, time: float, factor: float = factor) -> float:
                return factor * grain.y

            @staticmethod
            def force(p: Any, grain: Any, time: float, factor: float = factor) -> tuple[float, float]:
                return 0.0, -factor

        scene = bed.replace(**{"effects.edited_push": True})
        keys.append([task.key for task in overview_tasks([scene], full=False, hard=False)])
        keys[-1].append(work_precision_task(Plan(scene, ("energy",), (), {})).key)
    assert all(first != second for first, second in zip(*keys, strict=True))


def test_first_screen_of_a_small_bed(
    small_bed: Scene, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Measured, advised, followed by a fresh start, and said on the page and the console."""
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
    assert run_tasks("overview", tasks, tmp_path, OverviewResult, progress=False) == found  # from the disk
    text = blocks_text(section_tables("overview", found))
    assert "bed of 23: what accuracy costs" in text
    assert "bed of 23" in report_page({"overview": found}, full=False).to_html()
