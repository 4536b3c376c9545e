"""Interface to PySR, tested without Julia: detection, error, settings, and conversion to SymPy."""

import ast
import importlib.util
import os
import subprocess
import sys
import types
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import sympy

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import DiscoveryOptions, discover
from reduced_models.discovery import symbolic_search
from reduced_models.discovery.structure_proposals import _pruned_candidates_of_expression
from reduced_models.discovery.subset_selection import all_index_subsets, score_subsets_and_make_scorer
from reduced_models.discovery.terms import physical_library_terms
from reduced_models.discovery.weak_form import estimate_smoothed_motion, make_weak_form
from reduced_models.laws.law import HeightLine
from tests.reduced_models.made import damped_cosine, moved, noisy

TIME = np.linspace(0.0, 20.0, 400)
RECORD = PistonRecord(TIME, np.cos(TIME))


@pytest.mark.skipif(symbolic_search.missing_pysr_requirements() is None, reason="Julia is installed")
def test_error_for_missing_julia_is_one_line_with_the_two_commands_that_install_it() -> None:
    with pytest.raises(InputError) as caught:
        discover(RECORD, "pysr")
    text = str(caught.value)
    assert "\n" not in text
    assert all(command in text for command in symbolic_search.COMMANDS)


def python(code: str, **environment: str) -> str:
    """Return the output of a new Python process that turns warnings into errors."""
    kept = {key: value for key, value in os.environ.items() if "JULIACALL" not in key}
    words, surroundings = [sys.executable, "-W", "error", "-c", code], kept | environment
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=surroundings)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_detection_of_pysr_neither_imports_it_nor_downloads_julia() -> None:
    code = (
        "import socket, sys\n"
        "def refuse(*a, **k): raise SystemExit('the network was used')\n"
        "socket.socket.connect = refuse\n"
        "from reduced_models.discovery import symbolic_search\n"
        "symbolic_search.missing_pysr_requirements(); print({'pysr', 'juliacall'} & set(sys.modules))\n"
    )
    assert python(code) == "set()"


PLACES = [
    ("python", "full", None),
    ("python", "", "must be set together"),
    ("", "full", "must be set together"),
    ("/nowhere/julia", "full", "no Julia at '/nowhere/julia'"),
    ("python", "/nowhere", "no Julia project at '/nowhere'"),
    ("python", "empty", "lacks SymbolicRegression and PythonCall"),
    ("python", "broken", "lacks SymbolicRegression and PythonCall"),
    ("", "", "are not installed"),
]


@pytest.mark.parametrize(("julia", "project", "lack"), PLACES)
def test_a_given_julia_program_is_inspected_without_being_run(
    julia: str, project: str, lack: str | None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    entry = '[[deps.{}]]\nuuid = "0"\nversion = "1.0.0"\n'
    manifest = "".join(map(entry.format, ("SymbolicRegression", "PythonCall")))
    for name, text in (("full", f'manifest_format = "2.0"\n{manifest}'), ("broken", "[[deps.Symb")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "Manifest.toml").write_text(text)
    (tmp_path / "empty").mkdir()
    monkeypatch.setattr(symbolic_search, "_has_resolved_julia_packages", lambda: False)
    monkeypatch.setattr(symbolic_search.importlib.util, "find_spec", lambda _: object())
    given = {"EXE": sys.executable if julia == "python" else julia, "PROJECT": project}
    if project and not project.startswith("/"):
        given["PROJECT"] = str(tmp_path / project)
    for name, value in given.items():
        monkeypatch.delenv(f"PYTHON_JULIACALL_{name}", raising=False)
        if value:
            monkeypatch.setenv(f"PYTHON_JULIACALL_{name}", value)
    found = symbolic_search.missing_pysr_requirements()
    assert found is None if lack is None else lack in str(found)


def test_a_failed_import_of_pysr_gives_a_one_line_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "pysr.py").write_text("raise Exception('no package\\nin this project')")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "pysr", raising=False)
    with pytest.raises(InputError, match="could not be started: Exception") as caught:
        symbolic_search.import_pysr_regressor()
    assert "\n" not in str(caught.value)


class SymbolicSearch:
    """Substitute for PySR's search, which returns a given answer and stores its settings."""

    settings: ClassVar[dict[str, Any]] = {}
    interrupted_ = False

    def __init__(self, **settings: Any) -> None:
        self.settings.update(settings)

    def fit(self, matrix: np.ndarray, target: np.ndarray, variable_names: list[str]) -> None:
        import pandas as pd

        folder = Path(self.settings["output_directory"])
        (folder / "hall_of_fame.csv").write_text("1")
        numbers, *_ = np.linalg.lstsq(matrix[:, :2], target)
        best = " + ".join(f"({c} * {s})" for c, s in zip(numbers, variable_names, strict=False))
        self.equations_ = pd.DataFrame({"equation": ["x0 * -1.0", "x0 * NaN", best]})


@pytest.fixture
def search(monkeypatch: pytest.MonkeyPatch) -> type[SymbolicSearch]:
    """Replace PySR's search by the substitute."""
    monkeypatch.setattr(symbolic_search, "missing_pysr_requirements", lambda: None)
    monkeypatch.setitem(sys.modules, "pysr", types.SimpleNamespace(PySRRegressor=SymbolicSearch))
    return SymbolicSearch


def test_a_pysr_search_stops_at_the_noise_level_and_removes_its_files(search: type[SymbolicSearch]) -> None:
    x = np.linspace(-1.0, 1.0, 50)
    assert symbolic_search.search_expressions_with_pysr({"x": x}, 3.0 * x, noise=0.03)
    assert search.settings["early_stop_condition"] == pytest.approx((0.03 / np.std(3.0 * x)) ** 2)
    assert search.settings["temp_equation_file"] is False
    assert search.settings["deterministic"] is True
    assert not Path(search.settings["output_directory"]).exists()


def test_the_settings_are_parameters_of_the_installed_version_of_pysr() -> None:
    """The settings are compared with PySR's source, since importing PySR would import Julia."""
    spec = importlib.util.find_spec("pysr")
    assert spec is not None
    assert spec.origin is not None
    source = ast.parse(Path(spec.origin).with_name("sr.py").read_text(encoding="utf-8"))
    (regressor,) = (one for one in ast.walk(source) if getattr(one, "name", "") == "PySRRegressor")
    (start,) = (one for one in ast.walk(regressor) if getattr(one, "name", "") == "__init__")
    assert isinstance(start, ast.FunctionDef)
    names = {argument.arg for argument in (*start.args.args, *start.args.kwonlyargs)}
    used = {"early_stop_condition", "output_directory", *symbolic_search.pysr_regressor_settings()}
    assert used <= names


def test_an_interrupt_caught_by_julia_is_raised_in_python(
    search: type[SymbolicSearch], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(search, "interrupted_", True)
    with pytest.raises(KeyboardInterrupt):
        symbolic_search.search_expressions_with_pysr({"x": TIME}, TIME, noise=0.03)


@pytest.mark.usefixtures("search")
def test_a_pysr_search_gives_coefficients_in_the_units_of_the_record() -> None:
    """Call and result have the same form as for the other methods."""
    record = noisy(TIME, damped_cosine(TIME, 0.7, 0.05, 1.4), 0.003)
    found = discover(record, "pysr", options=DiscoveryOptions(polish=0))
    assert found.method == "pysr"
    coefficients = {term.text: value for term, value in found.best.terms.items()}
    assert coefficients == pytest.approx({"z": -(1.4**2 + 0.05**2), "z'": -0.1}, rel=0.1)


@pytest.mark.long
@pytest.mark.skipif(
    symbolic_search.missing_pysr_requirements() is not None, reason="Julia with PySR's packages is missing"
)
def test_pysr_finds_a_damped_oscillation_with_one_percent_noise() -> None:
    time = np.linspace(0.0, 40.0, 2000)
    height = np.exp(-0.05 * time) * np.cos(1.4 * time)
    noise = np.random.default_rng(0).normal(0.0, 0.01 * height.std(), len(time))
    found = discover(PistonRecord(time, height + noise), "pysr")
    assert {term.text for term in found.best.terms} == {"z", "z'"}


PROBE = """
import os, sys
def PySRRegressor(): pass
seen = [os.environ.get(f"PYTHON_JULIACALL_{name}") for name in ("HANDLE_SIGNALS", "THREADS")]
import warnings; warnings.warn("of PySR, at these settings")
"""


@pytest.mark.parametrize(("given", "seen"), [({}, ["no", "1"]), ({"THREADS": "4"}, ["no", "4"])])
def test_python_still_handles_ctrl_c_after_julia_is_started(
    given: dict[str, str], seen: list[str], tmp_path: Path
) -> None:
    """The environment variables are set before the import of PySR, which starts Julia.

    Variables that the user has set are kept.
    """
    (tmp_path / "pysr.py").write_text(PROBE)
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from reduced_models.discovery.symbolic_search import import_pysr_regressor\n"
        "import_pysr_regressor(); import pysr; print(pysr.seen)"
    )
    assert python(code, **{f"PYTHON_JULIACALL_{name}": value for name, value in given.items()}) == str(seen)


def test_superfluous_terms_of_an_equation_by_pysr_are_removed(monkeypatch: pytest.MonkeyPatch) -> None:
    """For a Van der Pol-like law of four terms, PySR once chose eight, some of them with abs(z')."""
    time = np.linspace(0.0, 30.0, 1500)
    oscillation = moved(lambda t, z, v: -(z**2 - 1.0) * v * 0.8 - z - 0.2 * z**3, time, 2.0)
    z, v, speed = (sympy.Symbol(name, real=True) for name in ("z", "v", "speed"))
    crowded = 0.78 * v - 0.79 * z**2 * v - 0.98 * z - 0.21 * z**3
    crowded += 0.013 * speed - 0.011 * z * speed + 0.004 * z**2 - 0.006 * v * speed
    monkeypatch.setattr(symbolic_search, "missing_pysr_requirements", lambda: None)
    place = "reduced_models.discovery.structure_proposals.search_expressions_with_pysr"
    monkeypatch.setattr(place, lambda *_: [crowded])
    record = noisy(time, oscillation, 0.01 * oscillation.std())
    found = discover(record, "pysr", options=DiscoveryOptions(polish=0))
    assert {term.text for term in found.best.terms} == {"z", "z**3", "z'", "z'*z**2"}


def test_superfluous_terms_are_also_removed_from_sums_whose_terms_contain_numbers() -> None:
    weak = make_weak_form(estimate_smoothed_motion(RECORD, HeightLine()))
    library = physical_library_terms(1)
    _, scorer = score_subsets_and_make_scorer(weak, library, library, all_index_subsets(2))
    z, v = (sympy.Symbol(name, real=True) for name in ("z", "v"))
    candidates = _pruned_candidates_of_expression(
        -1.01 * z + 0.02 * sympy.sin(1.3 * z) + 0.01 * sympy.tanh(2.0 * v), scorer
    )
    best = min(candidates, key=lambda candidate: candidate.criterion)
    assert best.terms is not None
    assert {term.text for term in best.terms} == {"z"}
