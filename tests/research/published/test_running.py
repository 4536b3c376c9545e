"""Cached cases, which become outdated only when force laws change, and the command line."""

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from granular.commands.console import run_command_and_return_exit_code
from research.published import reference, rerun, runner
from research.published.__main__ import CAMPAIGN
from research.published.calculations import TIMED_SIZES
from research.published.collecting import (
    collect_results_of_all_series,
    mark_series_not_reproduced_as_stale,
    missing_starts,
)
from research.published.page import report_page
from research.published.plan import SeriesGroup
from research.published.protocols import QUICK
from research.published.results import (
    EMPTY,
    PublishedResults,
    count_series_by_state,
    is_complete,
    read_results_or_empty,
)
from research.published.series import Series, damper_fall_series, equal_grain_series
from research.published.series_runs import (
    cached_outcomes_of_series,
    delete_outcomes_and_reference,
    run_groups,
)

SMALL = QUICK._replace(speed=0.3, settling=0.5)


def small(name: str, step: float | str = "auto", **changes: Any) -> Series:
    return equal_grain_series(name, 12, SMALL, seeds=(1, 2), step=step, **changes)


def here(groups: Sequence[SeriesGroup], directory: Path, **settings: Any) -> None:
    """Run groups of cases in this process."""
    after = settings.get("after", lambda: None)
    with ThreadPoolExecutor(1) as executor:
        run_groups(groups, directory, executor=executor, progress=False, after=after)


@pytest.fixture(scope="module")
def groups() -> list[SeriesGroup]:
    return [SeriesGroup("small", [small("direct 368"), small("direct 736", 0.02)])]


@pytest.fixture(scope="module")
def kept(groups: list[SeriesGroup], tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("cases")
    here(groups, directory)
    return directory


@pytest.fixture(scope="module")
def found(groups: list[SeriesGroup], kept: Path) -> PublishedResults:
    return collect_results_of_all_series(groups, kept, "test")


def test_a_failed_case_does_not_affect_others(
    groups: list[SeriesGroup], kept: Path, found: PublishedResults
) -> None:
    good, bad = groups[0].series
    assert [one.error for one in cached_outcomes_of_series(good, kept)] == [None, None]
    assert all(one.error for one in cached_outcomes_of_series(bad, kept))
    assert is_complete(found.series[good.key])
    assert not is_complete(found.series[bad.key])
    assert len(found.series[bad.key]["errors"]) == 2
    assert found.series[bad.key]["errors"][0] in report_page(found).to_html().replace("&#x27;", "'")


def test_finished_cases_of_the_comparison_are_reused(groups: list[SeriesGroup], kept: Path) -> None:
    def times() -> dict[str, int]:
        return {path.name: path.stat().st_mtime_ns for path in (kept / "cases").iterdir()}

    before = times()
    assert len(before) == 4
    calls: list[int] = []
    here(groups, kept, after=lambda: calls.append(1))
    assert times() == before
    assert calls == [1]
    assert not list((kept / "runs").iterdir())


def test_a_comparison_continues_from_the_committed_results(
    groups: list[SeriesGroup], found: PublishedResults, tmp_path: Path
) -> None:
    """A start in the file is not repeated; a missing start is simulated."""
    good = groups[0].series[0]
    through_file = PublishedResults.from_plain(json.loads(json.dumps(found.to_plain())))
    again = collect_results_of_all_series(groups, tmp_path, "test", [through_file])
    assert again.series[good.key] == found.series[good.key]
    assert again.made["sittings"] == found.made["sittings"]
    assert missing_starts(good, tmp_path, [through_file]) == []
    assert missing_starts(good._replace(seeds=(1, 2, 3)), tmp_path, [through_file]) == [3]
    other = small("direct 368", cell__width="13 D")
    assert missing_starts(other, tmp_path, [through_file]) == [1, 2]


def test_stored_values_of_a_bed_agree_with_its_geometry(
    groups: list[SeriesGroup], found: PublishedResults
) -> None:
    figures = found.series[groups[0].series[0].key]["figures"]
    size = (12 / 368) ** 0.5
    for start in range(2):
        assert figures["down"][start][-1] == pytest.approx(figures["force"][start])
        assert 0.0 < figures["least_distance_D"][start] < 20.0 * size
        # The mean distance of two grains is between a grain's diameter and the cell's diagonal.
        assert 0.5 < figures["half_full_D"][start] < 0.5 * (60.0**2 + 20.0**2) ** 0.5 * size
        assert figures["half_full_D"][start] < figures["half_end_D"][start]
        # 12 grains of 6 mm in a cell of 60 by 20 diameters times the size.
        assert figures["packing"][start] == pytest.approx(368 * 3.14159 / 4 / 1200, rel=1e-4)
        hysteresis = figures["half_start_D"][start] - figures["half_end_D"][start]
        assert figures["hysteresis_D"][start] == pytest.approx(hysteresis, abs=2e-5)


LAWS = [
    {"effects__friction": {"dynamic": 0.4515}},
    {"effects__gravity": {"acceleration": 9.81}},
    {"grains__remanence": 1.302},
]


@pytest.mark.parametrize("changes", LAWS)
def test_results_are_outdated_after_a_change_of_a_force_law(changes: dict[str, Any]) -> None:
    """Even changes of a coefficient by less than half a percent are detected."""
    before = reference.run_reference(small("direct 368"))
    after = reference.run_reference(small("direct 368", **changes))
    shared = {name: after[name] for name in before}
    assert not reference.references_agree(before, shared)


def test_results_are_not_outdated_by_another_time_step() -> None:
    before = reference.run_reference(small("direct 368"))
    assert reference.references_agree(before, reference.run_reference(small("direct 368")))
    assert reference.references_agree(before, reference.run_reference(small("direct 368", "auto/1.3")))
    assert not reference.references_agree(before, {})


@pytest.mark.long  # quick: the reference of a bed, above
def test_a_fall_of_the_damper_has_a_reference_calculation() -> None:
    found = reference.run_reference(damper_fall_series("damper", 7.5))
    assert {"piston_energy", "drag_loss", "pair_energy"} <= set(found)
    assert all(error < 1e-3 * abs(value) for value, error in found.values() if value)


def test_outdated_series_are_marked_and_repeated(
    groups: list[SeriesGroup], found: PublishedResults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = groups[0].series[0]
    said: list[str] = []
    assert is_complete(mark_series_not_reproduced_as_stale(found, groups, said.append).series[good.key])
    assert not said
    now = found.series[good.key]["reference"]
    other = {name: [1.01 * value, error] for name, (value, error) in now.items()}
    monkeypatch.setattr("research.published.collecting.run_reference", lambda _: other)
    marked = mark_series_not_reproduced_as_stale(found, groups, said.append)
    assert marked.series[good.key]["stale"]
    assert good.key in said[0]
    assert missing_starts(good, tmp_path, [marked]) == [1, 2]
    here([SeriesGroup("small", [good])], tmp_path)
    assert missing_starts(good, tmp_path, [marked]) == []
    assert not collect_results_of_all_series(groups, tmp_path, "test", [marked]).series[good.key].get("stale")
    delete_outcomes_and_reference(good, tmp_path)
    assert cached_outcomes_of_series(good, tmp_path) == []


def test_a_repeated_result_is_compared_digit_by_digit_with_the_committed_one(
    groups: list[SeriesGroup], found: PublishedResults, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = "piston_force_direct_sum.mean[0]"
    monkeypatch.setattr(rerun, "full_plan", lambda: groups)
    monkeypatch.setattr(rerun, "run_groups", here)
    monkeypatch.setattr(rerun, "read_committed_results", lambda: found)
    same = rerun.repeat_entry_and_compare(key, workers=1, progress=False)
    assert same["same"], same["differences"]
    assert "same to the last digit" in rerun.comparison_text(same)
    name = groups[0].series[0].key
    figures = found.series[name]["figures"]
    wrong = {**figures, "force": [1.000001 * x for x in figures["force"]]}
    series = {**found.series, name: {**found.series[name], "figures": wrong}}
    monkeypatch.setattr(rerun, "read_committed_results", lambda: PublishedResults(series, {}, found.made))
    differs = rerun.repeat_entry_and_compare(key, workers=1, progress=False)
    assert not differs["same"]
    assert len(differs["differences"]) == 2
    assert "force" in rerun.comparison_text(differs)
    with pytest.raises(Exception, match="did you mean"):
        rerun.repeat_entry_and_compare("piston_force_direct_sum.maen[0]")


def test_a_calculated_result_without_simulations_is_compared_by_its_value(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Calculations have no values for single starts. Computing times are not compared."""
    now = {"default_grain": {"mass_kg": 6.25e-4}, "loop_times": TIMES}
    monkeypatch.setattr(rerun, "make_missing_calculations", lambda *_, **__: None)
    monkeypatch.setattr("research.published.collecting.read_cached_calculations", lambda _: now)
    for factor, same in ((1.0, True), (2.0, False)):
        before = {
            name: {one: factor * value for one, value in numbers.items()} for name, numbers in now.items()
        }
        monkeypatch.setattr(
            rerun, "read_committed_results", lambda before=before: PublishedResults({}, before, {})
        )
        found = rerun.repeat_entry_and_compare("default_grain.mass_kg", progress=False)
        assert found["same"] is same
        assert ("same to the last digit" in rerun.comparison_text(found)) is same
    timed = rerun.repeat_entry_and_compare("algorithm.direct_exponent", progress=False)
    assert "timed: not comparable to the last digit" in rerun.comparison_text(timed)


TIMES = {f"{way} {n}": n / 100.0 for way in ("direct", "list") for n in TIMED_SIZES}


@pytest.fixture
def small_plan(groups: list[SeriesGroup], monkeypatch: pytest.MonkeyPatch) -> list[list[int]]:
    """Replace the full plan by one small series without committed results, and record the simulated
    starts.
    """
    asked: list[list[int]] = []

    def run(some: Sequence[SeriesGroup], directory: Path, **settings: Any) -> None:
        asked.append([seed for group in some for one in group.series for seed in one.seeds])
        here(some, directory, **settings)

    plan = [SeriesGroup("small", [groups[0].series[0]])]
    monkeypatch.setattr(runner, "full_plan", lambda: plan)
    monkeypatch.setattr(runner, "run_groups", run)
    monkeypatch.setattr(runner, "make_missing_calculations", lambda *_, **__: None)
    monkeypatch.setattr(runner, "_write_and_return_report", lambda *_: {})
    monkeypatch.setattr(runner, "read_committed_results", lambda: EMPTY)
    return asked


def test_the_full_comparison_simulates_only_starts_missing_in_the_committed_file(
    groups: list[SeriesGroup], small_plan: list[list[int]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The new directory contains only the committed file."""
    good = groups[0].series[0]
    for place, series in (("one", good._replace(seeds=(1,))), ("two", good), ("three", good)):
        monkeypatch.setattr(runner, "full_plan", lambda series=series: [SeriesGroup("small", [series])])
        runner.compare_and_summarise(tmp_path / place, "full", workers=1, progress=False)
        made = read_results_or_empty(tmp_path / place / "results.json")
        monkeypatch.setattr(runner, "read_committed_results", lambda made=made: made)
    assert small_plan == [[1], [2], []]
    assert made.series[good.key]["done"] == [1, 2]
    assert made.made["sittings"] == 3


def test_results_of_a_changed_law_are_computed_again_exactly_once(
    small_plan: list[list[int]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reference computed with the old code is deleted together with its results.

    Otherwise the new results would count as outdated.
    """

    def publish_twice() -> None:
        for _ in range(2):
            runner.compare_and_summarise(tmp_path, "full", workers=1, progress=False)

    def other(series: Series) -> reference.Reference:
        now = reference.run_reference(series)
        return {name: [1.01 * value, error] for name, (value, error) in now.items()}

    publish_twice()
    assert small_plan == [[1, 2], []]
    monkeypatch.setattr("research.published.collecting.run_reference", other)
    publish_twice()
    assert small_plan[2:] == [[1, 2], []]
    assert count_series_by_state(read_results_or_empty(tmp_path / "results.json"))["stale"] == 0


QUICK_FORCES = {
    "piston_force_direct_sum.mean[0]": 0.03,
    "piston_force_direct_sum.mean[4]": 0.03,
    "half_mean_distance.minimum[0]": 0.005,
    "half_mean_distance.minimum[3]": 0.005,
    "half_mean_distance.minimum[7]": 0.005,
}


def test_the_command_shows_the_committed_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_and_return_exit_code(CAMPAIGN.main, ["-o", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    numbers = found["summary"]
    assert sum(numbers.values()) == len(found["entries"])
    assert sum(found["statement_counts"].values()) == len(found["statements"])
    assert found["series"]["stale"] == 0
    assert all(one["verdict"] for one in found["entries"])
    written = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert written == found
    assert (tmp_path / "report.html").stat().st_size > 10_000
    assert not (tmp_path / "cases").exists()


def test_bad_input_of_the_comparison_gives_a_one_line_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_and_return_exit_code(CAMPAIGN.main, ["--workers", "0", "-o", str(tmp_path)]) == 2
    assert "--workers 0 is not a possible number of processes; give 1 or more" in capsys.readouterr().err
    file = tmp_path / "file"
    file.write_text("", encoding="utf-8")
    assert run_command_and_return_exit_code(CAMPAIGN.main, ["-o", str(file / "below")]) == 2
    assert "give another path" in capsys.readouterr().err


def test_an_unknown_published_value_gives_a_one_line_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_and_return_exit_code(CAMPAIGN.main, ["--only", "damper.rest_heigth"]) == 2
    assert "did you mean 'damper.rest_height'" in capsys.readouterr().err


@pytest.mark.long
def test_committed_references_agree_with_the_present_code() -> None:
    """Three random series are computed again."""
    import random

    from research.published.plan import full_plan
    from research.published.reference import references_agree, run_reference
    from research.published.results import read_committed_results

    found = read_committed_results().series
    done = [one for group in full_plan() for one in group.series if found[one.key]["done"]]
    for series in random.Random(5).sample(done, 3):
        assert references_agree(found[series.key]["reference"], run_reference(series)), series.key


@pytest.mark.long
def test_a_quick_run_reproduces_published_values(tmp_path: Path) -> None:
    from research.published.runner import compare_and_summarise

    found = compare_and_summarise(tmp_path, "quick", progress=False)
    rows = {one["key"]: one for one in found["quick"]["entries"]}
    for key, tolerance in QUICK_FORCES.items():
        assert rows[key]["ours"] == pytest.approx(rows[key]["published"], rel=tolerance), key
        assert rows[key]["starts"] == 3
    fractions = [one for key, one in rows.items() if key.startswith("voronoi") and one["ours"]]
    assert len(fractions) >= 15
    for one in fractions:
        assert one["ours"] == pytest.approx(one["published"], abs=0.04), one["key"]
