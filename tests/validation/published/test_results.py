"""Results made up in the test: which protocol counts, what is found from them, and the report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular.shared.errors import InputError
from validation.published.causes import comparisons
from validation.published.judging import Judged, counts, judged
from validation.published.page import page
from validation.published.plan import LARGE, LISTED, RATIOS, full_plan, mixture_name, quick_plan
from validation.published.programme import published, summary
from validation.published.results import EMPTY, Results, committed, read
from validation.published.values import published_value


def series(
    name: str, protocol: str = "published", planned: int = 3, **figures: list[Any]
) -> dict[str, dict[str, Any]]:
    count = max(len(one) for one in figures.values())
    plain = {
        "name": name, "protocol": protocol, "words": protocol, "step": "auto*1.5",
        "planned": planned, "figures": {"steps": [1] * count} | figures, "errors": [],
    }  # fmt: skip
    return {f"{name} | {protocol}": plain}


def results(*some: dict[str, dict[str, Any]]) -> Results:
    return Results({key: one for each in some for key, one in each.items()}, {}, {})


def row(found: Results, key: str) -> Judged:
    return next(one for one in judged(found) if one.entry.key == key)


KEY = "piston_force_direct_sum.mean[0]"


def test_nothing_is_not_run_yet() -> None:
    rows = judged(EMPTY)
    assert {one.verdict.words for one in rows} == {"not run yet"}
    assert counts(rows)["not run yet"] == len(rows)
    assert comparisons(EMPTY) == []


def test_mean_and_deviation_of_the_starts() -> None:
    found = row(results(series("direct 368", force=[15.0, 15.3, 15.6])), KEY)
    assert found.found is not None
    assert found.found.value == pytest.approx(15.3)
    assert found.found.spread == pytest.approx(0.3)
    assert found.found.starts == 3
    assert found.verdict.words == "agrees within scatter"


def test_the_best_protocol_that_is_whole_counts() -> None:
    quick = series("direct 368", "quick", force=[14.0, 14.0, 14.0])
    part = series("direct 368", force=[15.0])
    whole = series("direct 368", force=[15.0, 15.0, 15.0])
    for some, value in (((quick, part), 14.0), ((quick, whole), 15.0), ((part,), 15.0)):
        finding = row(results(*some), KEY).found
        assert finding is not None
        assert finding.value == value


def test_figures_of_several_beds_are_of_one_protocol() -> None:
    direct = series("direct 368", force=[16.0] * 3)
    both = [
        series(f"{way} 368", "quick", force=[f] * 3)
        for way, f in (("direct", 15.3), ("list", 15.0))
    ]
    finding = row(results(direct, *both), "piston_force_verlet.percent_difference[0]").found
    assert finding is not None
    assert finding.value == pytest.approx(100.0 * (15.0 - 15.3) / 15.0)
    assert finding.protocol == "quick"


def test_lines_of_the_published_forces_are_the_published_lines() -> None:
    names = {"direct": "piston_force_direct_sum", "list": "piston_force_verlet"}
    some = [
        series(f"{way} {n}", force=[published_value(f"{section}.mean[{k}]")] * 3)
        for way, section in names.items()
        for k, n in enumerate((*LISTED, *LARGE))
    ]
    wanted = (
        "linear_fit_direct.slope", "linear_fit_direct.intercept", "linear_fit_verlet.slope",
        "linear_fit_verlet.intercept",
    )  # fmt: skip
    found = results(*some)
    for name in wanted:
        one = row(found, f"piston_force_verlet.{name}")
        assert one.found is not None
        assert one.found.value == pytest.approx(one.published, rel=5e-3), name
    assert row(found, "mono_further.r_squared_direct").verdict.agrees
    assert row(found, "mono_further.asymptote_percent").verdict.agrees
    for k in range(len(LISTED) + len(LARGE)):
        one = row(found, f"piston_force_verlet.percent_difference[{k}]")
        assert one.found is not None
        assert one.found.value == pytest.approx(one.published, abs=0.06)


def scan(aspect: float, place: int) -> list[dict[str, dict[str, Any]]]:
    """Forces on the published curve, and orders that go together."""
    a, slow, b, fast = (
        published_value(f"biexponential_fmax.{name}[{place}]")
        for name in ("A", "lambda1", "B", "lambda2")
    )
    made = []
    for r in RATIOS:
        force = 100.0 * (a * np.exp(slow * r) + b * np.exp(fast * r))
        order = 1.0 - r * (1.0 - r)
        made.append(
            series(mixture_name(aspect, r), planned=2, force=[force] * 2,
                   hexagons_full=[order, order + 0.01], psi6_full=[order, order - 0.01])
        )  # fmt: skip
    return made


def test_the_published_curve_is_found_again() -> None:
    found = results(*scan(0.6, 1))
    for name, rel in (("A", 0.05), ("lambda1", 0.2), ("B", 0.3), ("lambda2", 0.05)):
        one = row(found, f"biexponential_fmax.{name}[1]")
        assert one.found is not None
        assert one.found.value == pytest.approx(one.published, rel=rel)
    assert row(found, "fmax_over_r.at_zero[1]").verdict.agrees
    assert row(found, "fmax_over_r.at_half[1]").verdict.agrees
    correlation = row(found, "bidisperse_all_r.psi6_n6_correlation[1]")
    assert correlation.verdict.agrees
    assert correlation.found is not None
    assert correlation.found.starts == 2 * len(RATIOS)


def test_deviations_anywhere_in_the_cycle() -> None:
    down = [[0.0, 2.5, 5.0, 7.5, 10.0], [0.0, 2.5, 6.0, 7.5, 10.0]]
    found = results(series("starts", planned=2, force=[10.0, 10.0], down=down, up=[[0.0]] * 2))
    one = row(found, "independence_of_start.std_over_mean_anywhere")
    assert one.found is not None
    assert one.found.value == pytest.approx(np.sqrt(0.5) / 10.0)


def test_a_change_matters_beyond_the_error_of_the_means() -> None:
    usual = series("direct 368", "quick", force=[15.0, 15.2, 15.4])
    for shift, matters in ((0.1, False), (2.0, True)):
        drag = series("drag", "quick", force=[15.0 - shift, 15.2 - shift, 15.4 - shift])
        (one,) = [c for c in comparisons(results(usual, drag)) if c.figure == "piston force"]
        assert one.matters is matters


def test_results_survive_their_file(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    whole = results(*scan(0.6, 1))
    path.write_text(json.dumps(whole.to_plain()), encoding="utf-8")
    assert summary(read(path)) == summary(whole)
    assert read(tmp_path / "none.json") == EMPTY
    path.write_text("[]", encoding="utf-8")
    with pytest.raises(InputError, match="holds no results"):
        read(path)


def test_the_report_says_what_was_not_run() -> None:
    some = results(*scan(0.6, 1), series("direct 368", force=[17.0, 17.0, 17.0]))
    html = page(some, some).render()
    assert "not run yet" in html
    assert "differs" in html
    assert page(EMPTY).render()


def test_committed_results_hold_their_own_verdicts() -> None:
    """The rows of the file are those that the package finds from the file's series."""
    path = Path(published.__code__.co_filename).with_name("results.json")
    plain = json.loads(path.read_text(encoding="utf-8"))
    assert {"command", "date", "numpy", "numba", "granular-damper"} <= set(plain["made"])
    rows = {one["key"]: one["verdict"] for one in plain["entries"]}
    assert "not run yet" not in rows.values()
    assert rows == {one.entry.key: one.verdict.words for one in judged(committed())}


def test_plans_have_no_series_twice() -> None:
    for plan in (quick_plan(), full_plan()):
        names = [series.key for group in plan for series in group.series]
        assert len(set(names)) == len(names)
