"""User-defined result functions (measures) and integration methods in a study."""

import pickle
import sys
from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import pytest

from granular import Method, load_scene, sweep
from granular.__main__ import main
from granular.commands.console import run_command_and_return_exit_code
from granular.methods import METHODS
from granular.shared.errors import InputError
from granular.shared.user_file import run_user_file
from granular.studies.cases import CustomMeasure, custom_measures, find_measure, last_values, measure_identity
from granular.studies.sweep import load_study

OWN = """
import dataclasses
import math
@dataclasses.dataclass
class Answer:
    value: float
def answer(run) -> dict:
    return {"answer": Answer(math.floor(42.9)).value}
"""

WAYS = (
    r"unknown measure '.*'; known are last-values; a custom measure can be added by --import FILE, or by an "
    r"installed package with an entry point in the group 'granular.measures'"
)


def own_file(path: Path, text: str = OWN) -> Path:
    (path / "swing.py").write_text(text)
    return path / "swing.py"


def read(path: Path, text: str = OWN) -> dict[str, CustomMeasure]:
    return custom_measures(run_user_file(own_file(path, text)))


def test_functions_of_a_user_file_can_be_selected_as_measures_by_name(tmp_path: Path) -> None:
    own = read(tmp_path)
    assert list(own) == ["answer"]
    measure = find_measure("answer", own)
    assert measure is own["answer"]
    assert pickle.loads(pickle.dumps(measure))(None) == {"answer": 42}
    assert find_measure("last-values", own) is last_values


def test_editing_code_but_not_comments_changes_the_identity_of_a_measure(tmp_path: Path) -> None:
    first = measure_identity(read(tmp_path)["answer"])
    same = measure_identity(read(tmp_path, "# more\n" + OWN[1:])["answer"])
    other = measure_identity(read(tmp_path, OWN.replace("42.9", "41.9"))["answer"])
    assert first == same != other


@pytest.mark.parametrize("name", ["os:system", "swing:answer", "swing", "os.system", "", "answer"])
def test_a_name_given_as_measure_is_never_imported_as_a_module(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    own_file(tmp_path, "raise AssertionError")
    with pytest.raises(InputError, match=WAYS):
        find_measure(name)
    assert "swing" not in sys.modules


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("def f(:", "SyntaxError"),
        ("1 / 0", "ZeroDivisionError"),
        ("import nothing_such", "Module"),
        ("\0", "null"),
        ("import sys; sys.exit(0)", "SystemExit"),
    ],
)
def test_user_files_that_cannot_be_imported_are_reported(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=rf"swing.py cannot be imported: .*{words}"):
        read(tmp_path, text)
    with pytest.raises(InputError, match="does not exist"):
        run_user_file(tmp_path / "none.py")


def test_measures_of_an_installed_package_are_found_by_entry_point(installed: Callable[..., None]) -> None:
    source = "def swing(run): return {'a': 1}\nno = 3\n"
    installed("measures", source, {name: name for name in ("swing", "no", "gone")})
    assert find_measure("swing").__module__ == "laboratory_measures"
    with pytest.raises(InputError, match="is not a function"):
        find_measure("no")
    with pytest.raises(InputError, match=r"'gone' of laboratory 1\.0 cannot be loaded"):
        find_measure("gone")


def test_a_study_can_use_a_function_of_the_imported_user_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "study.toml").write_text(
        'scene = "single-particle"\nmeasure = "answer"\nt_end = 0.001\n[grid]\n"arrangement.seed" = [1]\n'
    )
    words = ["sweep", str(tmp_path / "study.toml"), "-o", str(tmp_path / "out"), "--quiet"]
    assert run_command_and_return_exit_code(main, words) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "--import FILE" in told
    assert "granular.measures" in told
    assert not (tmp_path / "out").exists()
    assert run_command_and_return_exit_code(main, [*words, "--import", str(own_file(tmp_path))]) == 0
    assert "answer" in (tmp_path / "out" / "table.csv").read_text().splitlines()[0]


PLAIN = METHODS["position-verlet"]
TWIN = Method("twin", 2, kicks=PLAIN.kicks, drifts=PLAIN.drifts)
OTHER = Method("twin", 2, kicks=(0.5, 0.5), drifts=(1.0,))
"""Another method with the same name."""

SCENE = load_scene("single-particle")


def test_a_sweep_accepts_an_integration_method_given_by_its_coefficients(
    tmp_path: Path, thread_executor: Executor
) -> None:
    words: dict[str, Any] = {
        "dt": 1e-4,
        "t_end": 0.02,
        "progress": False,
        "executor": thread_executor,
        "out": tmp_path,
    }
    grid = {"method": [TWIN, "position-verlet", "stormer-verlet"]}
    table = sweep(SCENE, grid, **words).table
    assert list(table["method"]) == ["twin", "position-verlet", "stormer-verlet"]
    assert not table["error"].notna().any()
    kinetic = table["kinetic_energy"]
    assert kinetic[0] == kinetic[1] != kinetic[2]
    assert sweep(SCENE, {"method": [TWIN]}, **words).reused == 1
    assert sweep(SCENE, {"method": [OTHER]}, **words).reused == 0


def test_a_study_file_can_contain_the_coefficients_of_an_integration_method(
    tmp_path: Path, thread_executor: Executor
) -> None:
    (tmp_path / "study.toml").write_text(
        'scene = "single-particle"\ndt = 1e-4\nt_end = 0.02\n'
        "[method]\nname = 'in-a-file'\norder = 2\nkicks = [0, 1, 0]\ndrifts = [0.5, 0.5]\n"
        "[[cases]]\n'arrangement.seed' = 1\n"
        "[[cases]]\nmethod = { name = 'in-a-case', order = 2, kicks = [0.5, 0.5], drifts = [1] }\n"
    )
    study = load_study(tmp_path / "study.toml")
    found = sweep(study.pop("scene"), executor=thread_executor, progress=False, **study)
    assert [case.settings["method"]["name"] for case in found.cases] == ["in-a-file", "in-a-case"]
    assert not found.failed
