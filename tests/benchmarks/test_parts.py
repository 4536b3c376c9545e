"""The benchmark's measurements, its table of computing time against accuracy, and its history of speed."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import costs as module
from benchmarks import history, jobs, package
from benchmarks.__main__ import main
from benchmarks.absent_effect_cost import hand_and_engine
from benchmarks.compilations import count_compilations
from benchmarks.compression import PUBLISHED, compression
from benchmarks.costs import Priced, costs, priced_scenes, prices_text, rounded
from benchmarks.engine import PAIR_METHODS
from benchmarks.fits import TRUTHS, measured_here
from benchmarks.fresh_process import peak_memory, starts
from benchmarks.handwritten_steps import KERNELS
from benchmarks.package import IMPORTS, packed_size
from benchmarks.pair_sum_errors import FORCES, forces_at_rest
from benchmarks.steps import EFFECTS, effect_steps, method_errors, method_steps
from benchmarks.timing import minimum_seconds
from granular import Scene
from granular.commands.console import run_command_and_return_exit_code
from granular.kernel_data.state import LOSSES
from granular.run import work_precision as stored
from granular.shared.errors import InputError
from validation.report_tasks import Plain


@pytest.mark.long
def test_benchmark_rows_cover_every_pair_sum_method_and_every_effect() -> None:
    rows = method_steps(92, rounds=1)
    assert [row["method"] for row in rows] == list(PAIR_METHODS)
    assert all(row["seconds"] > 0.0 for row in rows)
    found = effect_steps(92, rounds=1)
    assert [row["effect"] for row in found] == list(EFFECTS)
    assert found[0]["added"] == 0.0


@pytest.mark.long
def test_direct_pair_sum_is_exact_and_the_sum_with_a_cut_off_is_not() -> None:
    rows = {row["method"]: row for row in method_errors(368)}
    assert rows["direct"]["force error"] == 0.0
    assert 1e-4 < rows["cut-off"]["force error"] < 1e-2
    assert rows["mesh"]["force error"] < 1e-3
    assert rows["direct"]["energy drift"] < 1e-4
    assert rows["mesh"]["energy drift"] < 1e-4


@pytest.mark.long
def test_mesh_sum_gives_accurate_forces_at_equilibrium() -> None:
    """Forces by the mesh differ by less than 0.05 % from the direct sum.

    With a cut-off, the piston force is over 1 % too low.
    """
    rows = {row["method"]: row for row in forces_at_rest(368)}
    assert rows["mesh"]["greatest_speed"] < 1e-5
    assert all(abs(rows["mesh"][f"{name} off"]) < 5e-4 for name in FORCES)
    assert rows["cut-off"]["piston_force off"] < -0.01


@pytest.mark.long
def test_memory_and_start_times_are_measured_in_separate_processes() -> None:
    (row,) = peak_memory(20000, "cut-off")
    # Coordinates, velocities and forces alone take 48 bytes per grain.
    assert row["bytes"] - row["of 92 grains"] > 48 * 20000
    times = {row["start"].split(":")[0]: row["seconds"] for row in starts()}
    assert set(times) == {"import granular", "cold run", "warm run", "first step of a damper"}


@pytest.mark.long
def test_fast_compression_of_a_bed_gives_nearly_the_published_force() -> None:
    (row,) = compression(1, speed=0.1)
    assert row["simulated"] == pytest.approx(8.0 * 0.33 / 0.1, rel=1e-6)
    assert row["ledger"] < 1e-2
    assert row["force"] == pytest.approx(PUBLISHED["force"], rel=0.1)
    assert row["half distance"] == pytest.approx(PUBLISHED["half distance"], rel=0.02)
    assert np.isfinite(row["seconds"])


@pytest.mark.parametrize(
    "scenery", [pytest.param(one, marks=() if "drag" in one else pytest.mark.long) for one in KERNELS]
)
def test_handwritten_integration_steps_agree_with_the_engine(scenery: str) -> None:
    bed, engine, calls = hand_and_engine(scenery, 92, 100)
    for call in calls.values():
        call()
    state = engine.run.state
    for name in ("x", "y", "vx", "vy"):
        np.testing.assert_array_equal(getattr(bed, name)[:92], getattr(state, name)[:92])
    np.testing.assert_array_equal(bed.totals[:4], state.wall_forces)
    assert bed.totals[4] == pytest.approx(state.ledger[LOSSES:].sum(), rel=1e-12)


def test_timing_of_several_functions_calls_each_equally_often() -> None:
    counts = {"a": 0, "b": 0}

    def call(name: str) -> None:
        counts[name] += 1

    found = minimum_seconds({"a": lambda: call("a"), "b": lambda: call("b")}, rounds=3, seconds=0.0)
    assert set(found) == {"a", "b"}
    assert min(found.values()) > 0.0
    assert counts == {"a": 5, "b": 5}


def test_the_fit_timed_by_the_benchmark_is_accurate() -> None:
    found = measured_here("linear", 500, 2)
    assert len(found["warm"]) == 2
    assert 0.0 < found["error"] < 0.01
    assert found["converged"] > 0.8


def test_benchmark_fits_have_a_true_value_for_every_parameter() -> None:
    from reduced_models.laws import law_named

    for name, truth in TRUTHS.items():
        assert set(truth.parameters) == set(law_named(name).parameters)


BUSY = """
import json, time
started = time.process_time()
while time.process_time() - started < 0.3:
    pass
print(json.dumps({"seconds": {"loop": 0.3}}))
"""


def test_processor_time_and_stage_times_of_a_benchmark_job_are_measured_in_its_own_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(jobs, "JOBS", {jobs.MAIN: ("-c", BUSY), "idle": ("-c", "pass")})
    busy, idle = jobs.job_times([jobs.MAIN, "idle"])
    assert 0.3 <= busy["processor"] <= busy["seconds"] + 0.5
    assert busy["parts"] == {"loop": 0.3}
    assert idle["processor"] < busy["processor"] - 0.2
    assert idle["parts"] == {}


ONE = "from reduced_models.jax_setup import jax; jax.jit(lambda x: x + 1.0)({0})"
BOTH = f"{ONE.format('1.0')}; jax.jit(lambda x: x - 1.0)(jax.numpy.ones(3))"


def test_number_and_duration_of_jax_compilations_in_a_process_are_measured() -> None:
    few, more = (count_compilations(("-c", code)) for code in (ONE.format("1.0"), BOTH))
    assert 1 <= few.counts["compiling"] < more.counts["compiling"]
    assert 0.0 < more.seconds["compiling"] < more.processor
    assert more.longest[0][0] >= more.longest[-1][0]


ROOT = Path(__file__).parents[2]


def test_reported_package_size_is_the_size_of_the_compressed_files() -> None:
    files = [
        path
        for package in ("granular", "reduced_models", "validation")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    ]
    integer = sum(path.stat().st_size for path in files)
    assert 0.1 * integer < packed_size() < 0.7 * integer
    assert packed_size() < 2_000_000  # a package of text and a few tables


def test_benchmark_rows_contain_the_package_size_and_the_time_of_every_import(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    light = IMPORTS[:2]  # the others take seconds
    monkeypatch.setattr(package, "IMPORTS", light)
    rows = package.package_figures(rounds=1)
    assert rows[0]["bytes"] == packed_size()
    assert [row["what"] for row in rows[2:]] == list(light[1:])


NAMES = ("piston force", "energy")


@pytest.fixture(scope="module")
def priced(small_bed: Scene) -> Priced:
    settle = {"kind": "hold", "name": "settle", "duration": "0.02 s"}
    scene = small_bed.replace(protocol=[settle])
    return Priced(scene, NAMES, ("auto*8", "auto*4"), (), "auto/2", 2)


@pytest.fixture(scope="module")
def found(priced: Priced, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Plain]:
    path = tmp_path_factory.mktemp("prices") / "table.toml"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "priced_scenes", lambda: (priced,))
        return path, costs(path, progress=False)


def test_table_of_time_against_accuracy_is_written_and_read_back(
    found: tuple[Path, Plain], priced: Priced, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, plain = found
    monkeypatch.setattr(stored, "TABLE", path)
    stored.load_work_precision_scenes.cache_clear()
    try:
        known = stored.most_similar_measured_scene(priced.scene, "piston force")
    finally:
        stored.load_work_precision_scenes.cache_clear()
    assert known.grains == 23
    assert known.date == plain["made"]["date"]
    assert [(rung.method, rung.dt) for rung in known.entries] == [
        ("stormer-verlet", "auto*8"),
        ("stormer-verlet", "auto*4"),
    ]
    coarse, fine = known.entries
    assert coarse.bounds["energy"] > fine.bounds["energy"] > 0.0
    assert coarse.fraction == pytest.approx(2.0 * fine.fraction)
    assert coarse.frequency == pytest.approx(2.0 * fine.frequency, rel=0.05)
    assert known.floors["piston force"] > 0.0
    text = prices_text(plain)
    assert "2 starts" in text
    assert "stormer-verlet auto*8" in text


def test_entries_already_in_the_table_of_time_against_accuracy_are_not_measured_again(
    found: tuple[Path, Plain], priced: Priced, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, before = found
    monkeypatch.setattr(module, "priced_scenes", lambda: (priced,))
    monkeypatch.setattr(module, "_truth", pytest.fail)
    monkeypatch.setattr(module, "_rung", pytest.fail)
    assert costs(path, progress=False)["scenes"] == before["scenes"]


def test_scenes_in_the_table_of_time_against_accuracy_are_distinct_and_include_friction_and_drag() -> None:
    scenes = priced_scenes()
    assert {stored.damping_kind(one.scene) for one in scenes} == {"friction", "drag"}
    assert len({str(one.key) for one in scenes}) == len(scenes)


@given(st.floats(1e-30, 1e30))
def test_errors_in_the_table_of_time_against_accuracy_are_rounded_upwards(value: float) -> None:
    assert value * (1.0 - 1e-12) <= rounded(value) <= 1.0101 * value


def entry(ratio: float, **more: Any) -> dict[str, Any]:
    return {"commit": "abc", "changed": False, "date": "2026-01-01 00:00", **more, "ratios": {"sum": ratio}}


def test_each_entry_in_the_history_of_speed_is_added_as_one_line(tmp_path: Path) -> None:
    path = tmp_path / "speed.jsonl"
    assert history.read(path) == []
    for k in range(3):
        assert len(history.add(path, entry(float(k)))) == k + 1
    assert path.read_text().count("\n") == 3
    assert history.read(path) == [entry(0.0), entry(1.0), entry(2.0)]


def test_history_of_speed_compares_the_newest_entry_with_the_median_of_earlier_ones() -> None:
    many = [entry(9.0)] * 30 + [entry(2.0), entry(2.0), entry(4.0), entry(3.0, changed=True)]
    shown = history.history_table(many[-4:])
    assert list(shown.rows[-1][2:]) == ["1.50"]
    assert shown.rows[-2][1] == "abc+"
    assert len(history.history_table(many).rows) == 13
    assert len(history.history_table(many[:1]).rows) == 1


def test_history_of_speed_shows_no_ratio_for_a_newly_measured_kernel() -> None:
    new = entry(1.0)
    new["ratios"] = {"step": 5.0}
    shown = history.history_table([entry(1.0), new])
    assert list(shown.header[2:]) == ["sum", "step"]
    assert list(shown.rows[-1][2:]) == ["", ""]


@pytest.mark.parametrize("line", ["nonsense", "[]", "{}", '{"ratios": {"sum": "fast"}}', "7"])
def test_an_invalid_line_in_the_history_of_speed_is_reported(line: str, tmp_path: Path) -> None:
    path = tmp_path / "speed.jsonl"
    path.write_text(json.dumps(entry(1.0)) + "\n" + line + "\n")
    with pytest.raises(InputError, match="line 2 is not an entry"):
        history.read(path)


def test_benchmark_command_adds_an_entry_to_the_history_and_refuses_options_without_effect(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(history, "measured", lambda: entry(0.5))
    path = tmp_path / "speed.jsonl"
    for _ in range(2):
        assert run_command_and_return_exit_code(main, ["--history", str(path)]) == 0
    assert len(history.read(path)) == 2
    assert "newest over the median before" in capsys.readouterr().out
    assert run_command_and_return_exit_code(main, ["--history", str(path), "--full"]) == 2
    assert run_command_and_return_exit_code(main, ["--history", str(tmp_path)]) == 2
    assert len(history.read(path)) == 2


@pytest.mark.long
def test_speed_ratios_include_every_timed_kernel() -> None:
    found = history.measured(rounds=2, jobs=["compression of 92 grains"])
    assert found["reference"]["seconds"] > 0.0
    wanted = {"direct sum", "step, drag", "fit, linear law", "compression of 92 grains, processor"}
    assert wanted <= set(found["ratios"])
    assert 0.0 < found["ratios"]["direct sum"] < 1.0
