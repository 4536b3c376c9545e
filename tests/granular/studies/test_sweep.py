"""Sweeps compute every case exactly once, and give tables and pages of results."""

import io
import warnings
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pandas
import pytest

import granular.studies.cases
from granular import Study, Trajectory, load_scene, sweep
from granular.__main__ import main
from granular.commands.console import run_command_and_return_exit_code
from granular.shared.errors import InputError, SceneError
from granular.studies.cases import (
    CaseOutcome,
    OutcomeCache,
    last_values,
    make_cases,
    measure_identity,
    piston_columns,
)
from granular.studies.study_page import study_page
from granular.studies.sweep import load_study
from tests.granular.studies.conftest import falling


def measured(run: Trajectory) -> dict[str, float]:
    return {"energy": float(run.dataset["kinetic_energy"][-1])}


def test_results_of_a_grid_and_of_single_cases_are_rows_of_one_table(thread_executor: Executor) -> None:
    study = sweep(
        falling(),
        {"effects.gravity.acceleration": [1.0, 2.0], "cell.width": [0.4, 0.5]},
        cases=[{"grains.density": 7000.0}],
        measure=measured,
        dt=1e-4,
        executor=thread_executor,
        progress=False,
    )
    table = study.table
    assert len(table) == 5
    assert list(table.columns[:2]) == ["effects.gravity.acceleration", "cell.width"]
    assert list(table.columns[-2:]) == ["error", "key"]
    first = table["energy"][0]
    mass = falling().grains.density * 0.003 * 3.141592653589793 / 4.0 * 0.005**2
    diameter = falling().grains.species[0].diameter
    mass *= (diameter / 0.005) ** 2
    assert first == pytest.approx(0.5 * mass * 0.01**2, rel=1e-9)
    assert table["energy"][2] == pytest.approx(4.0 * first, rel=1e-9)
    assert study.reused == 0


def test_a_failing_case_does_not_affect_the_others(tmp_path: Path, thread_executor: Executor) -> None:
    # The second grain starts next to the wall; with too long a time step it penetrates the wall.
    scene = load_scene("single-particle").replace(
        **{
            "protocol": [{"kind": "hold", "name": "fall", "duration": 0.05}],
            "output.scalars": 1e-3,
            "output.frames": 1e-2,
        }
    )
    study = sweep(
        scene,
        cases=[{"arrangement.velocities": [[0.0, 0.0]]}, {"arrangement.velocities": [[0.0, -50.0]]}],
        dt=1e-3,
        out=tmp_path,
        executor=thread_executor,
        progress=False,
    )
    assert [outcome.error is None for outcome in study.outcomes] == [True, False]
    assert "Error: step" in study.outcomes[1].error
    assert len(study.failed) == 1
    again = sweep(
        scene,
        cases=[{"arrangement.velocities": [[0.0, 0.0]]}, {"arrangement.velocities": [[0.0, -50.0]]}],
        dt=1e-3,
        out=tmp_path,
        executor=thread_executor,
        progress=False,
    )
    assert again.reused == 2
    pandas.testing.assert_frame_equal(study.table, again.table, check_exact=True)


def test_key_of_a_stored_case_depends_on_measure_and_time_step(
    tmp_path: Path, thread_executor: Executor
) -> None:
    arguments: dict[str, Any] = {
        "cases": [{}],
        "out": tmp_path,
        "executor": thread_executor,
        "progress": False,
    }
    keys = {
        sweep(falling(), dt=dt, measure=measure, **arguments).cases[0].key
        for dt in (1e-4, 2e-4)
        for measure in (measured, last_values)
    }
    assert len(keys) == 4
    assert sweep(falling(), dt=1e-4, measure=measured, **arguments).reused == 1


def test_cases_can_override_time_step_integration_method_and_end_time(
    tmp_path: Path, thread_executor: Executor
) -> None:
    """The results equal a sweep that has these settings for all cases."""
    arguments: dict[str, Any] = {"out": tmp_path, "executor": thread_executor, "progress": False}
    mixed = sweep(
        falling(),
        {"dt": [1e-4, "auto/2"], "method": ["stormer-verlet", "pefrl"]},
        cases=[{"t_end": 0.005, "cell.width": 0.5}],
        dt=2e-4,
        **arguments,
    )
    table = mixed.table
    assert list(table["dt"][:4]) == [1e-4, 1e-4, "auto/2", "auto/2"]
    assert table["error"].isna().all()
    assert table["kinetic_energy"][4] == pytest.approx(0.25 * table["kinetic_energy"][0])
    alike = sweep(falling(), cases=[{}], dt="auto/2", method="pefrl", **arguments)
    assert alike.reused == 1
    assert alike.outcomes[0] == mixed.outcomes[3]
    short = {"dt": 2e-4, "t_end": 0.005}
    assert sweep(falling(), cases=[{"cell.width": 0.5}], **short, **arguments).reused == 1


def test_a_study_file_can_override_the_time_step_of_cases(tmp_path: Path) -> None:
    falling().save(tmp_path / "fall.toml")
    (tmp_path / "study.toml").write_text(
        'scene = "fall.toml"\ndt = 1e-4\n[grid]\ndt = ["auto", "auto/2"]\n'
        '[[cases]]\n"cell.width" = 0.5\n[[cases]]\nmethod = "pefrl"\nt_end = 0.005\n'
    )
    study = load_study(tmp_path / "study.toml")
    settings = {"dt": study["dt"], "t_end": None, "method": "stormer-verlet"}
    made = make_cases(study["scene"], study["grid"], study["cases"], settings, last_values)
    assert [case.settings["dt"] for case in made] == ["auto", "auto/2", 1e-4, 1e-4]
    assert made[3].settings == {"dt": 1e-4, "t_end": 0.005, "method": "pefrl"}
    usual = falling().cell.width
    assert [case.scene.cell.width for case in made] == [usual, usual, 0.5, usual]


def test_a_case_with_a_damaged_stored_outcome_is_computed_again(
    tmp_path: Path, thread_executor: Executor
) -> None:
    arguments: dict[str, Any] = {"cases": [{}], "dt": 1e-4, "out": tmp_path, "executor": thread_executor}
    first = sweep(falling(), **arguments, progress=False)
    (kept,) = (tmp_path / "cases").iterdir()
    integer = kept.read_bytes()
    kept.write_bytes(integer[:-5])
    with pytest.warns(UserWarning, match="damaged; its result is computed again"):
        again = sweep(falling(), **arguments, progress=False)
    assert again.reused == 0
    assert again.outcomes == first.outcomes
    assert kept.read_bytes() == integer


def test_outcome_files_of_earlier_versions_can_still_be_read(
    tmp_path: Path, thread_executor: Executor
) -> None:
    """Files in the earlier plain format are read, and written in the present format."""
    sound = {"figures": {"energy": 1.5}, "error": None, "warning": "doubtful"}
    failed = {"figures": {}, "error": "EnergyError: step 3: off"}
    arguments: dict[str, Any] = {"cases": [{}, {"cell.width": 0.4}], "dt": 1e-4, "measure": measured}
    keys = [
        case.key for case in sweep(falling(), **arguments, executor=thread_executor, progress=False).cases
    ]
    cache = OutcomeCache(tmp_path)
    for key, plain in zip(keys, (sound, failed), strict=True):
        cache.files.store(key, plain)
    with pytest.warns(UserWarning, match="1 of 2 cases raised warnings"):
        study = sweep(falling(), **arguments, out=tmp_path, executor=thread_executor, progress=False)
    assert study.reused == 2
    assert study.outcomes == (
        CaseOutcome({"energy": 1.5}, warning="doubtful"),
        CaseOutcome(error="EnergyError: step 3: off"),
    )
    assert study.failed == study.cases[1:]
    assert not study.unfinished
    for key, outcome, plain in zip(keys, study.outcomes, (sound, failed), strict=True):
        cache.store(key, outcome)
        assert cache.files.read(key) == plain


def test_keys_of_stored_cases_are_unchanged_since_earlier_versions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stored cases are found by these keys."""
    from reduced_models.designs.design import measure_design_check

    monkeypatch.setattr(granular.studies.cases, "__version__", "0.1.0")
    settings = {"dt": "auto", "t_end": None, "method": "stormer-verlet"}
    (case,) = make_cases(load_scene("bed"), {}, [{"grains.density": 7000.0}], settings, piston_columns)
    assert case.key == "c13407cf185437283957"
    assert measure_identity(measure_design_check) == "reduced_models.designs.study:check#2"


def test_runs_kept_by_a_sweep_can_be_loaded(tmp_path: Path, thread_executor: Executor) -> None:
    from granular import load_trajectory

    study = sweep(
        falling(), cases=[{}], dt=1e-4, out=tmp_path, keep_runs=True, executor=thread_executor, progress=False
    )
    run = load_trajectory(tmp_path / "runs" / study.cases[0].key)
    assert run.complete


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({}, "no case"),
        ({"cases": [{}, {}]}, "two cases are the same"),
        ({"grid": {"arrangement.seed": 3}}, "must be a list"),
        ({"cases": [{"piston.mas": 1.0}]}, "unknown key"),
        ({"cases": [{}], "keep_runs": True}, "needs out"),
        ({"cases": [{}], "workers": 0}, "workers = 0"),
        ({"cases": [{"dt": "atuo"}]}, "give seconds, 'auto'"),
        ({"grid": {"method": ["stormer-verlett"]}}, "did you mean 'stormer-verlet'"),
    ],
)
def test_invalid_sweeps_are_refused(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises((InputError, SceneError), match=words):
        sweep(falling(), **arguments, progress=False)


GRID = {"piston.mass": ["6 kg", 7.5], "arrangement.seed": [1, 2], "effects.drag": [{"coefficient": 0.1}]}

SETTINGS: dict[str, Any] = {"dt": "auto", "t_end": None, "method": "stormer-verlet"}


def doubtful(run: Trajectory) -> dict[str, float]:
    mass = run.scene.piston.mass if run.scene.piston else None
    if mass == 7.5:
        warnings.warn(f"a piston of {mass} kg is heavy", UserWarning, stacklevel=1)
    return {"mass": 2.0 * (mass or 0.0), "piston_height": 0.12, "drop.height": 0.11 - 0.001 * (mass or 0.0)}


@pytest.fixture(scope="module")
def study() -> Study:
    with (
        ThreadPoolExecutor(1) as thread_executor,
        pytest.warns(UserWarning, match="cases raised warnings") as caught,
    ):
        result = sweep(
            load_scene("damper"),
            GRID,
            measure=doubtful,
            t_end=1e-3,
            dt=1e-5,
            executor=thread_executor,
            progress=False,
        )
    (summary,) = [one for one in caught if "raised warnings" in str(one.message)]
    assert str(summary.message).startswith(
        "2 of 4 cases raised warnings (see the table), the first (piston.mass = 7.5, arrangement.seed = 1"
    )
    assert "a piston of 7.5 kg is heavy" in str(summary.message)
    return result


def test_table_of_a_sweep_has_si_values_and_their_units(study: Study) -> None:
    assert list(study.table["piston.mass"]) == [6.0, 6.0, 7.5, 7.5]
    assert study.table.attrs["units"] == {"piston.mass": "kg", "piston_height": "m", "drop.height": "m"}
    read = pandas.read_csv(io.StringIO(study.to_csv()))
    assert {"piston.mass [kg]", "drop.height [m]", "mass", "warning", "error", "key"} < set(read.columns)
    assert list(read["warning"].isna()) == [True, True, False, False]


def test_table_shows_the_scene_value_of_a_key_that_a_case_does_not_set(study: Study) -> None:
    cases = [*study.cases[:1], *make_cases(load_scene("damper"), {}, [{"dt": 1e-4}], SETTINGS, doubtful)]
    table = Study(tuple(cases), study.outcomes[:2], 0).table
    assert list(table["piston.mass"]) == [6.0, 7.5]
    assert list(table["dt"]) == [1e-5, 1e-4]


def test_page_of_a_sweep_plots_results_against_the_varied_keys(study: Study) -> None:
    text = study_page(study).to_html()
    assert "4 cases" in text
    assert "<h2>Cases with warnings</h2>" in text
    assert "<li>3, 4: a piston of 7.5 kg is heavy</li>" in text
    assert "against piston.mass" in text
    assert text.count("<svg") == 1
    assert "Means over random packings" in text
    assert "run until 0.001 s" in text
    assert all(case.key in text for case in study.cases)
    assert "<th>piston.mass [kg]</th>" in text


def test_page_of_a_sweep_shows_end_times_with_units_and_failed_cases() -> None:
    grid = {"piston.mass": [6.0], "arrangement.seed": [1, 2]}
    cases = make_cases(load_scene("damper"), grid, [], SETTINGS | {"t_end": "2 ms"}, doubtful)
    outcomes = (CaseOutcome({"mass": 12.0}, None), CaseOutcome({}, "StepError: step 3"))
    text = study_page(Study(tuple(cases), outcomes, 0)).to_html()
    assert "run until 2 ms" in text
    assert "nan" not in text


def test_command_sweep_writes_table_and_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def computed(cases: Any, *_: Any) -> Iterator[Any]:
        outcomes = [CaseOutcome({"piston_height": 0.06 + 0.01 * k}) for k in range(2)]
        yield from zip(cases, outcomes, strict=True)

    monkeypatch.setattr("granular.studies.sweep.compute_outcomes_with_retries", computed)
    (tmp_path / "study.toml").write_text('scene = "damper"\n[grid]\n"piston.mass" = ["6 kg", 7]\n')
    words = ["sweep", str(tmp_path / "study.toml"), "-o", str(tmp_path / "out"), "--quiet"]
    assert run_command_and_return_exit_code(main, words) == 0
    assert "pictures in" in capsys.readouterr().out
    assert "against piston.mass" in (tmp_path / "out" / "report.html").read_text()
    lines = (tmp_path / "out" / "table.csv").read_text().splitlines()
    assert lines[0] == "piston.mass [kg],piston_height [m],error,key"
    assert lines[1].startswith("6.0,0.06,,")


def test_a_study_in_which_all_cases_failed_has_a_page() -> None:
    cases = make_cases(load_scene("damper"), {"piston.mass": [6.0, 7.0]}, [], SETTINGS, doubtful)
    lost = CaseOutcome(error="StepError: step 3")
    text = study_page(Study(tuple(cases), (lost, lost), 0)).to_html()
    assert "<li>1, 2: StepError: step 3</li>" in text
    assert "<svg" not in text
