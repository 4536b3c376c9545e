"""Cases that are kept, found again, do not lose each other, and go stale with the laws alone."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from research.published import reference, rerun, runner
from research.published.__main__ import CAMPAIGN
from research.published.calculations import TIMED_SIZES
from research.published.catalogue import entries
from research.published.collecting import checked, collected, missing
from research.published.page import page
from research.published.plan import Group
from research.published.protocols import QUICK
from research.published.results import EMPTY, Results, counted, is_whole, read
from research.published.series import Series, fall, mixture, mono
from research.published.series_runs import forget, outcomes_of, run_groups

SMALL = QUICK._replace(speed=0.3, settling=0.5)


def small(name: str, step: float | str = "auto", **changes: Any) -> Series:
    return mono(name, 12, SMALL, seeds=(1, 2), step=step, **changes)


def here(groups: Sequence[Group], directory: Path, **settings: Any) -> None:
    """Run groups in this process."""
    after = settings.get("after", lambda: None)
    with ThreadPoolExecutor(1) as executor:
        run_groups(groups, directory, executor=executor, progress=False, after=after)


@pytest.fixture(scope="module")
def groups() -> list[Group]:
    return [Group("small", [small("direct 368"), small("direct 736", 0.02)])]


@pytest.fixture(scope="module")
def kept(groups: list[Group], tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("cases")
    here(groups, directory)
    return directory


@pytest.fixture(scope="module")
def found(groups: list[Group], kept: Path) -> Results:
    return collected(groups, kept, "test")


def test_a_case_that_fails_loses_no_other(groups: list[Group], kept: Path, found: Results) -> None:
    good, bad = groups[0].series
    assert [one.error for one in outcomes_of(good, kept)] == [None, None]
    assert all(one.error for one in outcomes_of(bad, kept))
    assert is_whole(found.series[good.key])
    assert not is_whole(found.series[bad.key])
    assert len(found.series[bad.key]["errors"]) == 2
    assert found.series[bad.key]["errors"][0] in page(found).to_html().replace("&#x27;", "'")


def test_what_was_run_is_found_again(groups: list[Group], kept: Path) -> None:
    def times() -> dict[str, int]:
        return {path.name: path.stat().st_mtime_ns for path in (kept / "cases").iterdir()}

    before = times()
    assert len(before) == 4
    calls: list[int] = []
    here(groups, kept, after=lambda: calls.append(1))
    assert times() == before
    assert calls == [1]
    assert not list((kept / "runs").iterdir())


def test_the_file_alone_is_gone_on_from(groups: list[Group], found: Results, tmp_path: Path) -> None:
    """A start that the file holds is not run again; one that it lacks is."""
    good = groups[0].series[0]
    through_file = Results.from_plain(json.loads(json.dumps(found.to_plain())))
    again = collected(groups, tmp_path, "test", [through_file])
    assert again.series[good.key] == found.series[good.key]
    assert again.made["sittings"] == found.made["sittings"]
    assert missing(good, tmp_path, [through_file]) == []
    assert missing(good._replace(seeds=(1, 2, 3)), tmp_path, [through_file]) == [3]
    other = small("direct 368", cell__width="13 D")
    assert missing(other, tmp_path, [through_file]) == [1, 2]


def test_figures_of_a_bed_fit_its_geometry(groups: list[Group], found: Results) -> None:
    figures = found.series[groups[0].series[0].key]["figures"]
    size = (12 / 368) ** 0.5
    for start in range(2):
        assert figures["down"][start][-1] == pytest.approx(figures["force"][start])
        assert 0.0 < figures["least_distance_D"][start] < 20.0 * size
        # The mean distance of two grains is between a grain's and the cell's diagonal.
        assert 0.5 < figures["half_full_D"][start] < 0.5 * (60.0**2 + 20.0**2) ** 0.5 * size
        assert figures["half_full_D"][start] < figures["half_end_D"][start]
        # 12 grains of 6 mm in a cell of 60 by 20 diameters times the size.
        assert figures["packing"][start] == pytest.approx(368 * 3.14159 / 4 / 1200, rel=1e-4)
        hysteresis = figures["half_start_D"][start] - figures["half_end_D"][start]
        assert figures["hysteresis_D"][start] == pytest.approx(hysteresis, abs=2e-5)


def test_series_of_a_mixture_name_their_protocol() -> None:
    one = mixture("mixture", 0.6, 0.5, QUICK)
    assert one.words == "quick: 16 mm/s after 5 T"
    assert one.key == "mixture | quick"
    scene = one.scene(1)
    assert [stage.name for stage in scene.protocol] == ["relax", "compress"]
    assert scene.grains.species_fractions() == (0.5, 0.5)
    assert Results({}, {}, {}).sample("mixture", "force") is None


def test_the_full_run_goes_on_from_the_file_that_comes_with_the_package(
    groups: list[Group], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a new directory, with nothing but the file, only what it lacks is run."""
    asked: list[list[tuple[str, list[int]]]] = []

    def run(some: Sequence[Group], directory: Path, **settings: Any) -> None:
        asked.append([(one.key, list(one.seeds)) for group in some for one in group.series])
        here(some, directory, **settings)

    good = groups[0].series[0]
    first = good._replace(seeds=(1,))
    monkeypatch.setattr(runner, "run_groups", run)
    monkeypatch.setattr(runner, "calculated", lambda *_, **__: None)
    monkeypatch.setattr(runner, "_write_report", lambda *_: {})  # `test_command` looks at reports
    monkeypatch.setattr(runner, "committed", lambda: EMPTY)
    for place, series in (("one", first), ("two", good), ("three", good)):
        plan = [Group("small", [series])]
        monkeypatch.setattr(runner, "full_plan", lambda plan=plan: plan)
        runner.published(tmp_path / place, "full", workers=1, progress=False)
        made = read(tmp_path / place / "results.json")
        monkeypatch.setattr(runner, "committed", lambda made=made: made)
    assert asked == [[(good.key, [1])], [(good.key, [2])], []]
    assert made.series[good.key]["done"] == [1, 2]
    assert made.made["sittings"] == 3


LAWS = [
    {"effects__friction": {"dynamic": 0.4515}},
    {"effects__gravity": {"acceleration": 9.81}},
    {"grains__remanence": 1.302},
    pytest.param({"effects__walls__right": "infinite"}, marks=pytest.mark.long),
    pytest.param({"effects__drag": {"coefficient": 1e-4}}, marks=pytest.mark.long),
]


@pytest.mark.parametrize("changes", LAWS)
def test_a_changed_law_makes_results_stale(changes: dict[str, Any]) -> None:
    """Coefficients that are off by less than half a percent are seen."""
    before = reference.reference(small("direct 368"))
    after = reference.reference(small("direct 368", **changes))
    shared = {name: after[name] for name in before}
    assert not reference.agrees(before, shared)


def test_another_step_does_not() -> None:
    before = reference.reference(small("direct 368"))
    assert reference.agrees(before, reference.reference(small("direct 368")))
    assert reference.agrees(before, reference.reference(small("direct 368", "auto/1.3")))
    assert not reference.agrees(before, {})


@pytest.mark.long
def test_another_kernel_does_not() -> None:
    before = reference.reference(small("direct 368"))
    other = reference.reference(small("direct 368", pairs__method="cut-off", pairs__cut_off="1 m"))
    # With a radius, however large, the energy of a pair ends there at 0.
    both = [{k: v for k, v in one.items() if k != "pair_energy"} for one in (before, other)]
    assert reference.agrees(*both)


def test_a_damper_has_a_reference() -> None:
    found = reference.reference(fall("damper", 7.5))
    assert {"piston_energy", "drag_loss", "pair_energy"} <= set(found)
    assert all(error < 1e-3 * abs(value) for value, error in found.values() if value)


def test_stale_series_are_marked_and_run_anew(
    groups: list[Group], found: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = groups[0].series[0]
    said: list[str] = []
    assert is_whole(checked(found, groups, said.append).series[good.key])
    assert not said
    now = found.series[good.key]["reference"]
    other = {name: [1.01 * value, error] for name, (value, error) in now.items()}
    monkeypatch.setattr("research.published.collecting.reference", lambda _: other)
    marked = checked(found, groups, said.append)
    assert marked.series[good.key]["stale"]
    assert good.key in said[0]
    assert missing(good, tmp_path, [marked]) == [1, 2]
    here([Group("small", [good])], tmp_path)
    assert missing(good, tmp_path, [marked]) == []
    assert not collected(groups, tmp_path, "test", [marked]).series[good.key].get("stale")
    forget(good, tmp_path)
    assert outcomes_of(good, tmp_path) == []


def test_an_entry_run_anew_is_compared_to_the_last_digit(
    groups: list[Group], found: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = "piston_force_direct_sum.mean[0]"
    monkeypatch.setattr(rerun, "full_plan", lambda: groups)
    monkeypatch.setattr(rerun, "run_groups", here)
    monkeypatch.setattr(rerun, "committed", lambda: found)
    same = rerun.rerun(key, workers=1, progress=False)
    assert same["same"], same["differences"]
    assert "same to the last digit" in rerun.text(same)
    name = groups[0].series[0].key
    figures = found.series[name]["figures"]
    wrong = {**figures, "force": [1.000001 * x for x in figures["force"]]}
    series = {**found.series, name: {**found.series[name], "figures": wrong}}
    monkeypatch.setattr(rerun, "committed", lambda: Results(series, {}, found.made))
    differs = rerun.rerun(key, workers=1, progress=False)
    assert not differs["same"]
    assert len(differs["differences"]) == 2
    assert "force" in rerun.text(differs)
    with pytest.raises(Exception, match="did you mean"):
        rerun.rerun("piston_force_direct_sum.maen[0]")


def test_an_entry_without_a_series_is_compared_by_its_value(monkeypatch: pytest.MonkeyPatch) -> None:
    """Calculations have no figures of starts; a time is compared with nothing."""
    now = {"default_grain": {"mass_kg": 6.25e-4}, "loop_times": TIMES}
    monkeypatch.setattr(rerun, "calculated", lambda *_, **__: None)
    monkeypatch.setattr("research.published.collecting.kept", lambda _: now)
    for factor, same in ((1.0, True), (2.0, False)):
        before = {
            name: {one: factor * value for one, value in numbers.items()} for name, numbers in now.items()
        }
        monkeypatch.setattr(rerun, "committed", lambda before=before: Results({}, before, {}))
        found = rerun.rerun("default_grain.mass_kg", progress=False)
        assert found["same"] is same
        assert ("same to the last digit" in rerun.text(found)) is same
    timed = rerun.rerun("algorithm.direct_exponent", progress=False)
    assert "timed: not comparable to the last digit" in rerun.text(timed)


TIMES = {f"{way} {n}": n / 100.0 for way in ("direct", "list") for n in TIMED_SIZES}


@pytest.fixture
def small_plan(groups: list[Group], monkeypatch: pytest.MonkeyPatch) -> list[list[int]]:
    """The full plan is one small series, and the package holds nothing; the starts that are run."""
    asked: list[list[int]] = []

    def run(some: Sequence[Group], directory: Path, **settings: Any) -> None:
        asked.append([seed for group in some for one in group.series for seed in one.seeds])
        here(some, directory, **settings)

    plan = [Group("small", [groups[0].series[0]])]
    monkeypatch.setattr(runner, "full_plan", lambda: plan)
    monkeypatch.setattr(runner, "run_groups", run)
    monkeypatch.setattr(runner, "calculated", lambda *_, **__: None)
    monkeypatch.setattr(runner, "_write_report", lambda *_: {})
    monkeypatch.setattr(runner, "committed", lambda: EMPTY)
    return asked


def changed_law(monkeypatch: pytest.MonkeyPatch, factor: float = 1.01) -> None:
    """Another reference from now on, as if a law had been changed."""

    def other(series: Series) -> reference.Reference:
        now = reference.reference(series)
        return {name: [factor * value, error] for name, (value, error) in now.items()}

    monkeypatch.setattr("research.published.collecting.reference", other)


def test_a_changed_law_is_run_anew_once(
    small_plan: list[list[int]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reference of the former code goes with its outcomes: nothing is stale for ever."""
    for _ in range(2):
        runner.published(tmp_path, "full", workers=1, progress=False)
    assert small_plan == [[1, 2], []]
    changed_law(monkeypatch)
    for _ in range(2):
        runner.published(tmp_path, "full", workers=1, progress=False)
    assert small_plan[2:] == [[1, 2], []]
    assert counted(read(tmp_path / "results.json"))["stale"] == 0


@pytest.mark.long  # quick: a changed law is run anew, above
def test_a_mark_stays_until_the_series_is_run_anew(
    small_plan: list[list[int]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A call that only shows takes no mark away, with the cases next to the file and without."""

    def stale() -> int:
        return counted(read(tmp_path / "results.json"))["stale"]

    runner.published(tmp_path, "full", workers=1, progress=False)
    package = read(tmp_path / "results.json")
    monkeypatch.setattr(runner, "committed", lambda: package)
    changed_law(monkeypatch)
    for length in ("check", None, None):
        runner.published(tmp_path, length, progress=False)
        assert stale() == 1
    for name in ("cases", "references", "figures"):
        shutil.rmtree(tmp_path / name)
    runner.published(tmp_path, progress=False)
    assert stale() == 1

    def stop(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    run = runner.run_groups
    monkeypatch.setattr(runner, "run_groups", stop)
    with pytest.raises(KeyboardInterrupt):
        runner.published(tmp_path, "full", progress=False)
    runner.published(tmp_path, progress=False)
    (one,) = read(tmp_path / "results.json").series.values()
    assert one["done"] == []  # what the package holds of it is the former code's
    monkeypatch.setattr(runner, "run_groups", run)
    runner.published(tmp_path, "full", workers=1, progress=False)
    assert small_plan == [[1, 2], [1, 2]]
    assert stale() == 0


SCRIPT = """
    import sys
    from pathlib import Path
    from tests.research.published.test_running import small
    from research.published.plan import Group
    from research.published.protocols import QUICK
    from research.published.series_runs import run_groups
    from research.published.series import mono

    if __name__ == "__main__":
        long = mono("long", 40, QUICK, seeds=(1,))
        groups = [Group("all", [small("direct 368"), long])]
        run_groups(groups, Path(sys.argv[1]), workers=1, progress=False)
        print("done")
"""


@pytest.mark.long
@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_loses_nothing(tmp_path: Path) -> None:
    """Stopped again and again, the same command comes to the same figures."""
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent(SCRIPT), encoding="utf-8")

    def run(out: str, patience: float | None) -> bool:
        command = [sys.executable, str(script), str(tmp_path / out)]
        process = subprocess.Popen(
            command, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        try:
            output, _ = process.communicate(timeout=patience)
            return b"done" in output
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=120)
            return False

    started = time.monotonic()
    assert run("whole", None)
    stops, patience = 0, 0.4 * (time.monotonic() - started)
    while not run("stopped", patience):
        stops, patience = stops + 1, 1.5 * patience
        assert stops < 20
        time.sleep(0.2)
    assert stops > 0
    outcomes = [
        {path.name: _figures(path) for path in (tmp_path / name / "cases").glob("*.json")}
        for name in ("whole", "stopped")
    ]
    assert len(outcomes[0]) == 3
    assert outcomes[0] == outcomes[1]


def environment() -> dict[str, str]:
    import os

    return os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])}


def _figures(path: Path) -> dict[str, Any]:
    figures: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))["figures"]
    return {name: value for name, value in figures.items() if name != "seconds"}


def test_blocks_of_the_guide_stand_between_marks() -> None:
    begin, end = CAMPAIGN.marks("counts")
    page_before = f"before\n{begin}\nold\n{end}\nafter"
    written = CAMPAIGN.with_blocks(page_before, {"counts": "new"})
    assert written == f"before\n{begin}\nnew\n{end}\nafter"
    assert len({one.key for one in entries()}) == len(entries())
