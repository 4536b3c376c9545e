"""Integration methods given by name, as objects and as plain data; user-defined methods in runs."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from granular import load_scene, load_trajectory, simulate
from granular.__main__ import main
from granular.commands.console import run_command_and_return_exit_code
from granular.methods import METHODS, Method, method_named, resolve_method
from granular.methods.method import method_from_plain
from granular.methods.tables import method_as_run_setting, register_methods
from granular.run.summary import run_text
from granular.shared.errors import InputError, StoreError
from granular.user_code import import_user_code_and_collect_measures

Z = 0.1931833275037836
MCLACHLAN = Method(
    "mclachlan-2",
    2,
    "McLachlan 1995, doi:10.1137/0916010",
    kicks=(0.0, 0.5, 0.5, 0.0),
    drifts=(Z, 1.0 - 2.0 * Z, Z),
)


@pytest.mark.parametrize("name", [*METHODS, "stormer-verlet+compensated"])
def test_built_in_integration_methods_are_stored_by_name(name: str) -> None:
    method = method_named(name)
    assert method_as_run_setting(method) == name
    assert resolve_method(method) == resolve_method(name) == method
    assert method_from_plain(json.loads(json.dumps(method.to_plain()))) == method


def test_custom_integration_methods_are_stored_with_their_coefficients() -> None:
    plain = method_as_run_setting(MCLACHLAN)
    assert resolve_method(json.loads(json.dumps(plain))) == MCLACHLAN
    summed = dataclasses.replace(MCLACHLAN, compensated=True)
    assert resolve_method(json.loads(json.dumps(method_as_run_setting(summed)))) == summed


@given(st.floats(-2.0, 2.0))
def test_any_consistent_composition_method_is_restored_from_its_plain_data(fraction: float) -> None:
    method = Method("any", 1, kicks=(fraction, 1.0 - fraction), drifts=(1.0,))
    assert resolve_method(json.loads(json.dumps(method.to_plain()))) == method


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("stormer-verlt", r"did you mean 'stormer-verlet'.*--import FILE.*granular.methods"),
        (Method("stormer-verlet", 1, kicks=(1.0, 0.0), drifts=(1.0,)), "name of a built-in method"),
        (3, "granular.Method"),
        ({"name": "a"}, "lacks the required field 'order'"),
        ({"name": "a", "order": 1, "kick": (1.0,)}, "has no field 'kick'"),
        ({"name": "a", "order": 1, "kicks": (1.0,), "drifts": (1.0,)}, "one kick more"),
    ],
)
def test_unknown_or_invalid_integration_method_is_an_error(given: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        resolve_method(given)


def test_integration_methods_are_imported_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from granular import Method\nfrom granular.methods import METHODS\n"
        "verlet = METHODS['stormer-verlet']\n"
        "mine = Method('from-a-file', 2, kicks=(0.5, 0.5), drifts=(1,))\n"
        "def first_measure(run): return {}\n"
    )
    assert list(import_user_code_and_collect_measures([tmp_path / "mine.py"])) == ["first_measure"]
    assert method_named("from-a-file").kicks == (0.5, 0.5)
    assert method_named("from-a-file+compensated").compensated
    (tmp_path / "other.py").write_text(
        "from granular import Method\nmine = Method('from-a-file', 2, kicks=(0, 1, 0), drifts=(0.5, 0.5))\n"
    )
    with pytest.raises(InputError, match="two methods are called 'from-a-file'"):
        import_user_code_and_collect_measures([tmp_path / "other.py"])
    with pytest.raises(InputError, match="name of a built-in method"):
        register_methods([Method("pefrl", 2, kicks=(0.5, 0.5), drifts=(1.0,))])


def test_integration_methods_of_an_installed_package_are_found(installed: Callable[..., None]) -> None:
    source = "from granular import Method\nlab = Method('lab-2', 2, kicks=(0.5, 0.5), drifts=(1,))\nno = 3\n"
    installed("methods", source, {"lab-2": "lab", "no": "no", "gone": "gone"})
    assert method_named("lab-2").order == 2
    with pytest.raises(InputError, match=r"'no' of laboratory 1\.0 is not a granular\.Method"):
        method_named("no")
    with pytest.raises(InputError, match=r"'gone' of laboratory 1\.0 cannot be loaded"):
        method_named("gone")


PLAIN = METHODS["position-verlet"]
TWIN = Method("twin", 2, kicks=PLAIN.kicks, drifts=PLAIN.drifts)
OTHER = Method("twin", 2, kicks=(0.5, 0.5), drifts=(1.0,))
"""Another method of the same name."""

SCENE = load_scene("single-particle")
END = 0.02


def positions(**words: Any) -> np.ndarray:
    run = simulate(SCENE, dt=1e-4, t_end=END, progress=False, **words)
    return np.asarray(run.dataset["position"].values)


def test_custom_method_with_the_coefficients_of_a_built_in_one_gives_identical_results() -> None:
    assert (positions(method=TWIN) == positions(method="position-verlet")).all()
    assert (positions(method=TWIN.to_plain()) == positions(method=TWIN)).all()
    assert (positions(method=OTHER) != positions(method=TWIN)).any()


def test_coefficients_of_a_custom_method_are_stored_and_checked_on_resuming(tmp_path: Path) -> None:
    words: dict[str, Any] = {"dt": 1e-4, "t_end": END, "progress": False, "out": tmp_path / "run"}
    simulate(SCENE, method=TWIN, **words)
    kept = load_trajectory(tmp_path / "run")
    assert kept.settings()["method"] == TWIN.to_plain()
    assert kept.method == TWIN
    assert "(twin, dt" in run_text(kept)
    with pytest.raises(StoreError, match="has another method"):
        simulate(SCENE, method=OTHER, resume=True, **words)
    again = simulate(SCENE, method=TWIN, resume=True, **words)
    assert again.complete


def test_command_line_imports_an_integration_method(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text(
        "from granular import Method\nm = Method('on-the-line', 2, kicks=(0, 1, 0), drifts=(0.5, 0.5))\n"
    )
    words = ["run", "single-particle", "--dt", "1e-4", "--t-end", "0.02", "--json", "--quiet"]
    words += ["--method", "on-the-line"]
    assert run_command_and_return_exit_code(main, [*words, "--import", str(tmp_path / "mine.py")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["method"]["drifts"] == [0.5, 0.5]


def test_integration_method_incompatible_with_the_scene_is_an_error() -> None:
    scene = load_scene("bed").replace(**{"effects.friction": {}})
    backward = Method("backward", 4, kicks=METHODS["pefrl"].kicks, drifts=METHODS["pefrl"].drifts)
    with pytest.raises(InputError, match="method = 'backward' cannot run a scene with"):
        simulate(scene, method=backward, progress=False)
