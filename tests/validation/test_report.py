"""The report: cached results, sections, verdicts, and the command line."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from granular import load_scene, plan
from granular.methods import METHODS
from granular.shared.errors import InputError, SceneError
from validation.energy_drift import EnergyStudy, EnergyTrend, energy_runs_of_report, run_energy_study
from validation.report import SECTIONS, report_page, verdicts_and_passed
from validation.report_tasks import Outcome, Plain, Task, run_tasks

Command = Callable[..., subprocess.CompletedProcess[str]]


def measured(made: Callable[[], Plain], directory: Path | None, key: str = "a") -> list[Outcome]:
    return run_tasks("section", [Task("task", {"key": key}, made)], directory, progress=False)


def test_finished_validation_tasks_are_read_from_the_cache(tmp_path: Path) -> None:
    calls: list[int] = []

    def made() -> Plain:
        calls.append(1)
        return {"value": 0.1}

    for _ in range(2):
        assert measured(made, tmp_path) == [Outcome("task", {"value": 0.1})]
    assert len(calls) == 1
    measured(made, tmp_path, "b")
    assert len(calls) == 2  # a different key is a different task
    measured(made, None)
    assert len(calls) == 3  # without a directory nothing is cached


def test_a_task_whose_cached_result_is_truncated_is_measured_again(tmp_path: Path) -> None:
    measured(lambda: {"value": 1}, tmp_path)
    (kept,) = (tmp_path / "pieces").iterdir()
    kept.write_text(kept.read_text(encoding="utf-8")[:-3], encoding="utf-8")
    with pytest.warns(UserWarning, match="damaged; its result is computed again"):
        assert measured(lambda: {"value": 2}, tmp_path)[0].result == {"value": 2}


def test_a_failed_validation_task_is_cached_as_a_result(tmp_path: Path) -> None:
    def fails() -> Plain:
        raise SceneError("a value, a limit, a remedy")

    outcomes = measured(fails, tmp_path)
    assert outcomes == [Outcome("task", failed="SceneError: a value, a limit, a remedy")]
    assert measured(fails, tmp_path) == outcomes  # from the cache
    results = {"convergence": outcomes}
    assert verdicts_and_passed(results)["holds"] is False
    assert "a value, a limit, a remedy" in report_page(results, full=False).to_html()


def test_a_directory_that_cannot_be_written_is_reported_as_bad_input(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="give another path"):
        measured(dict, tmp_path / "file")


def test_validation_tasks_have_distinct_keys() -> None:
    for one in SECTIONS.values():
        for full in (False, True):
            keys = [json.dumps(task.key, sort_keys=True) for task in one.tasks(full)]
            assert len(set(keys)) == len(keys), one.name
            assert keys


def study(method: str, symplectic: bool, drift: float) -> Outcome:
    trend = EnergyTrend(drift, (drift, drift), 1e-9 if drift else 0.5, 1e-9 if drift else 0.5, 0.1, 1.0)
    times, errors = (0.0, 0.5, 1.0), (0.0, 0.5 * drift, drift)
    one = EnergyStudy(
        "swing", method, symplectic, 0.1, 10, None, times, errors, trend, (2.0, 1.0, 2.0), (0.0, -1.0, 0.0)
    )
    return Outcome("swing", one)


def test_an_energy_trend_of_a_symplectic_method_fails_the_validation() -> None:
    good = [study("stormer-verlet", True, 0.0), study("explicit-euler", False, 0.1)]
    assert verdicts_and_passed({"energy": good})["holds"] is True
    assert "which is not expected" not in report_page({"energy": good}, full=False).to_html()
    for method, keeps, drift in (
        ("explicit-euler", False, 0.0),
        ("explicit-euler", False, -0.1),
        ("runge-kutta-4", False, 0.1),
        ("stormer-verlet", True, 0.1),
    ):
        bad = {"energy": [study(method, keeps, drift)]}
        assert verdicts_and_passed(bad)["holds"] is False
    assert "which is not expected" in report_page(bad, full=False).to_html()


RUNS = {run.method: run for run in energy_runs_of_report()}
SYMPLECTIC = tuple(name for name in RUNS if METHODS[name].symplectic)


def test_energy_of_a_symplectic_method_has_no_trend() -> None:
    found = run_energy_study(RUNS["stormer-verlet"])
    assert found.trend.verdict() == "none"
    assert 1e-5 < found.trend.swing < 1e-2
    assert abs(found.trend.total_drift) < 0.1 * found.trend.swing


@pytest.mark.long
@pytest.mark.parametrize("method", [*SYMPLECTIC, "explicit-euler", "runge-kutta-4"])
def test_symplectic_methods_have_no_energy_trend_and_control_methods_have_one(method: str) -> None:
    wanted = {"explicit-euler": "gains", "runge-kutta-4": "loses"}.get(method, "none")
    assert run_energy_study(RUNS[method]).trend.verdict() == wanted


def test_help_lists_the_commands_and_bad_input_is_refused(command: Command) -> None:
    assert "report" in command("validation", "--help").stdout
    for words, said in (
        (("cheapest", "single-particle", "enrgy", "0.01"), "did you mean 'energy'"),
        (("cheapest", "single-particle", "energy", "0"), "above 0"),
        (("cheapest", "no-scene", "energy", "0.1"), "unknown scene"),
        (("nothing",), "--help"),
        (("report", "--quick", "--full"), "exclude each other"),
    ):
        done = command("validation", *words)
        assert done.returncode == 2
        assert said in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1
        assert not done.stdout


def test_command_cheapest_finds_a_method_and_step_within_the_tolerance(command: Command) -> None:
    done = command("validation", "cheapest", "single-particle", "energy", "0.01", "--t-end", "0.3", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["error"] <= 0.01
    assert found["command"].startswith("python -m granular run single-particle")
    # Measured costs are in the user's table and are used for an accuracy of the same scene.
    told = plan(load_scene("single-particle"), accuracy=f"{found['error']} energy", t_end=0.3)
    assert told.dt == found["keywords"]["dt"]
    assert told.method.name == found["keywords"]["method"]
    with pytest.raises(InputError, match="have no scene like"):
        plan(load_scene("single-particle"), accuracy="0.01 energy", t_end=0.2)
