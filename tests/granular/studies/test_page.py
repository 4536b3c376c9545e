"""Reports of a study: a table with units, a page, and one warning."""

import io
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pandas
import pytest

from granular import Study, Trajectory, load_scene, sweep
from granular.__main__ import main
from granular.commands.console import launch
from granular.studies.cases import CaseOutcome, make_cases
from granular.studies.study_page import study_page

GRID = {"piston.mass": ["6 kg", 7.5], "arrangement.seed": [1, 2], "effects.drag": [{"coefficient": 0.1}]}

SETTINGS: dict[str, Any] = {"dt": "auto", "t_end": None, "method": "stormer-verlet"}


def doubtful(run: Trajectory) -> dict[str, float]:
    mass = run.scene.piston.mass if run.scene.piston else None
    if mass == 7.5:
        warnings.warn(f"a piston of {mass} kg is heavy", UserWarning, stacklevel=1)
    return {"mass": 2.0 * (mass or 0.0), "piston_height": 0.12, "drop.height": 0.11 - 0.001 * (mass or 0.0)}


@pytest.fixture(scope="module")
def study() -> Study:
    with ThreadPoolExecutor(1) as here, pytest.warns(UserWarning, match="cases are in doubt") as told:
        result = sweep(
            load_scene("damper"), GRID, measure=doubtful, t_end=1e-3, dt=1e-5, executor=here, progress=False
        )
    (told_once,) = [one for one in told if "in doubt" in str(one.message)]
    assert str(told_once.message).startswith(
        "2 of 4 cases are in doubt (see the table), the first (piston.mass = 7.5, arrangement.seed = 1"
    )
    assert "a piston of 7.5 kg is heavy" in str(told_once.message)
    return result


def test_a_table_is_in_si_and_names_its_units(study: Study) -> None:
    assert list(study.table["piston.mass"]) == [6.0, 6.0, 7.5, 7.5]
    assert study.table.attrs["units"] == {"piston.mass": "kg", "piston_height": "m", "drop.height": "m"}
    read = pandas.read_csv(io.StringIO(study.to_csv()))
    assert {"piston.mass [kg]", "drop.height [m]", "mass", "warning", "error", "key"} < set(read.columns)
    assert list(read["warning"].isna()) == [True, True, False, False]


def test_a_case_that_leaves_a_key_has_the_scenes_value(study: Study) -> None:
    cases = [*study.cases[:1], *make_cases(load_scene("damper"), {}, [{"dt": 1e-4}], SETTINGS, doubtful)]
    table = Study(tuple(cases), study.outcomes[:2], 0).table
    assert list(table["piston.mass"]) == [6.0, 7.5]
    assert list(table["dt"]) == [1e-5, 1e-4]


def test_a_page_shows_what_varies_over_what_is_varied(study: Study) -> None:
    text = study_page(study).to_html()
    assert "4 cases" in text
    assert "<h2>Cases in doubt</h2>" in text
    assert "<li>3, 4: a piston of 7.5 kg is heavy</li>" in text
    assert "over piston.mass" in text
    assert text.count("<svg") == 1
    assert "Means over random starts" in text
    assert "run until 0.001 s" in text
    assert all(case.key in text for case in study.cases)
    assert "<th>piston.mass [kg]</th>" in text


def test_an_end_in_words_and_a_start_that_failed_have_a_page() -> None:
    grid = {"piston.mass": [6.0], "arrangement.seed": [1, 2]}
    cases = make_cases(load_scene("damper"), grid, [], SETTINGS | {"t_end": "2 ms"}, doubtful)
    outcomes = (CaseOutcome({"mass": 12.0}, None), CaseOutcome({}, "StepError: step 3"))
    text = study_page(Study(tuple(cases), outcomes, 0)).to_html()
    assert "run until 2 ms" in text
    assert "nan" not in text


def test_the_command_writes_both(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def computed(cases: Any, *_: Any) -> Iterator[Any]:
        outcomes = [CaseOutcome({"piston_height": 0.06 + 0.01 * k}) for k in range(2)]
        yield from zip(cases, outcomes, strict=True)

    monkeypatch.setattr("granular.studies.sweep.compute_outcomes_with_retries", computed)
    (tmp_path / "study.toml").write_text('scene = "damper"\n[grid]\n"piston.mass" = ["6 kg", 7]\n')
    words = ["sweep", str(tmp_path / "study.toml"), "-o", str(tmp_path / "out"), "--quiet"]
    assert launch(main, words) == 0
    assert "pictures in" in capsys.readouterr().out
    assert "over piston.mass" in (tmp_path / "out" / "report.html").read_text()
    lines = (tmp_path / "out" / "table.csv").read_text().splitlines()
    assert lines[0] == "piston.mass [kg],piston_height [m],error,key"
    assert lines[1].startswith("6.0,0.06,,")


def test_cases_that_failed_have_a_page_too() -> None:
    cases = make_cases(load_scene("damper"), {"piston.mass": [6.0, 7.0]}, [], SETTINGS, doubtful)
    lost = CaseOutcome(error="StepError: step 3")
    text = study_page(Study(tuple(cases), (lost, lost), 0)).to_html()
    assert "<li>1, 2: StepError: step 3</li>" in text
    assert "<svg" not in text
