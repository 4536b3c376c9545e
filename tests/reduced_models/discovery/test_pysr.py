"""The adapter of PySR without Julia: the probe, the error, the settings, the way back to SymPy."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import sympy

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import DiscoveryOptions, discover
from reduced_models.discovery import symbolic_search
from reduced_models.discovery.structure_proposals import _prune_expression
from reduced_models.discovery.subset_selection import all_index_subsets, score_subsets
from reduced_models.discovery.terms import physical_library_terms
from reduced_models.discovery.weak_form import estimate_motion, weak_form
from reduced_models.laws.law import HeightLine

TIME = np.linspace(0.0, 20.0, 400)
RECORD = PistonRecord(TIME, np.cos(TIME))

# The real package over a juliacall that answers everything with itself.
STUB = """
import sys, types
class Anything(types.ModuleType):
    def __init__(self): super().__init__("juliacall"); self.__path__ = []
    def __getattr__(self, name):
        if name.startswith("__"): raise AttributeError(name)
        return 1 if name in ("major", "minor", "patch") else Anything()
    def __call__(self, *a, **k): return Anything()
stub = Anything()
stub.AnyValue = type("AnyValue", (), {}); stub.VectorValue = type("VectorValue", (), {})
sys.modules["juliacall"] = stub
import warnings; warnings.simplefilter("ignore")
from reduced_models.discovery.symbolic_search import import_pysr_regressor, pysr_regressor_settings
PySRRegressor = import_pysr_regressor()
for options in (dict(), dict(functions=("sin", "exp"), seed=3)):
    wanted = pysr_regressor_settings(**options)
    made = PySRRegressor(early_stop_condition=1e-3, **wanted)
    assert all(made.get_params()[name] == value for name, value in wanted.items())
try:
    PySRRegressor(**pysr_regressor_settings(), tea=3)
except TypeError as error:
    print("TypeError", error)
"""


def needs_no_julia() -> None:
    if symbolic_search.missing_pysr_requirements() is None:
        pytest.skip("Julia is here")


def test_absent_julia_is_one_line_with_two_commands() -> None:
    needs_no_julia()
    with pytest.raises(InputError) as caught:
        discover(RECORD, "pysr")
    text = str(caught.value)
    assert "\n" not in text
    assert all(command in text for command in symbolic_search.COMMANDS)


def test_the_probe_imports_no_pysr_and_downloads_nothing() -> None:
    needs_no_julia()
    code = (
        "import socket, sys\n"
        "def refuse(*a, **k): raise SystemExit('the network was used')\n"
        "socket.socket.connect = refuse\n"
        "from reduced_models.discovery import pysr_search\n"
        "assert symbolic_search.missing_pysr_requirements()\n"
        "assert not {'pysr', 'juliacall'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A Julia project with all that PySR needs, by its manifest."""
    manifest = 'manifest_format = "2.0"\n'
    for name in ("SymbolicRegression", "PythonCall"):
        manifest += f'[[deps.{name}]]\nuuid = "0"\nversion = "1.0.0"\n'
    (tmp_path / "Manifest.toml").write_text(manifest)
    return tmp_path


PLACES = [
    ("0.9.36", {"EXE": "python", "PROJECT": "full"}, None),
    ("0.9.28", {"EXE": "python", "PROJECT": "full"}, None),
    ("0.9.27", {"EXE": "python", "PROJECT": "full"}, "0.9.28 and newer only"),
    ("0.9.36", {"EXE": "python"}, "must be set together"),
    ("0.9.36", {"PROJECT": "full"}, "must be set together"),
    ("0.9.36", {"EXE": "/nowhere/julia", "PROJECT": "full"}, "no Julia at '/nowhere/julia'"),
    ("0.9.36", {"EXE": "python", "PROJECT": "/nowhere"}, "no Julia project at '/nowhere'"),
    ("0.9.36", {"EXE": "python", "PROJECT": "empty"}, "lacks SymbolicRegression and PythonCall"),
    ("0.9.36", {"EXE": "python", "PROJECT": "broken"}, "lacks SymbolicRegression and PythonCall"),
    ("0.9.36", {}, "are not there"),
]


@pytest.mark.parametrize(("juliacall", "given", "lack"), PLACES)
def test_given_julia_is_looked_at_and_not_run(
    juliacall: str, given: dict[str, str], lack: str | None, monkeypatch: pytest.MonkeyPatch, project: Path
) -> None:
    (project / "empty").mkdir()
    (project / "broken").mkdir()
    (project / "broken" / "Manifest.toml").write_text("[[deps.Symb")
    places = {
        "full": str(project),
        "empty": str(project / "empty"),
        "broken": str(project / "broken"),
        "python": sys.executable,
    }
    monkeypatch.setattr(symbolic_search, "_has_resolved_julia_packages", lambda: False)
    monkeypatch.setattr(symbolic_search, "version", lambda _: juliacall)
    monkeypatch.setattr(symbolic_search.importlib.util, "find_spec", lambda _: object())
    for name in ("EXE", "PROJECT"):
        monkeypatch.delenv(f"PYTHON_JULIACALL_{name}", raising=False)
    for name, value in given.items():
        monkeypatch.setenv(f"PYTHON_JULIACALL_{name}", places.get(value, value))
    found = symbolic_search.missing_pysr_requirements()
    assert found is None if lack is None else lack in str(found)


def test_what_only_juliapkg_reads_is_left_to_its_dry_run(
    monkeypatch: pytest.MonkeyPatch, project: Path
) -> None:
    """Its own variable names a Julia, and no project: with juliacall's the two make no pair."""
    pytest.importorskip("juliapkg")
    monkeypatch.setenv("PYTHON_JULIAPKG_EXE", sys.executable)
    monkeypatch.setenv("PYTHON_JULIACALL_PROJECT", str(project))
    monkeypatch.delenv("PYTHON_JULIACALL_EXE", raising=False)
    assert symbolic_search.missing_pysr_requirements() is not None


def test_an_import_that_fails_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "pysr.py").write_text("raise Exception('no package\\nin this project')")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "pysr", raising=False)
    with pytest.raises(InputError, match="could not be started: Exception") as caught:
        symbolic_search.import_pysr_regressor()
    assert "\n" not in str(caught.value)


def searched(monkeypatch: pytest.MonkeyPatch, interrupted: bool) -> dict[str, object]:
    """Settings that a search is made with, and what is in its folder while it runs."""
    import types

    import pandas as pd

    seen: dict[str, object] = {}

    class SymbolicSearch:
        def __init__(self, **settings: object) -> None:
            seen.update(settings)
            self.interrupted_ = interrupted

        def fit(self, matrix: np.ndarray, target: np.ndarray, variable_names: list[str]) -> None:
            folder = Path(str(seen["output_directory"]))
            assert folder.is_dir()
            (folder / "hall_of_fame.csv").write_text("1")
            self.equations_ = pd.DataFrame({"equation": ["x0 * 2.0"]})

    monkeypatch.setattr(symbolic_search, "missing_pysr_requirements", lambda: None)
    monkeypatch.setitem(sys.modules, "pysr", types.SimpleNamespace(PySRRegressor=SymbolicSearch))
    x = np.linspace(-1.0, 1.0, 50)
    seen["found"] = symbolic_search.search_expressions_with_pysr({"x": x}, 3.0 * x, noise=0.03)
    seen["size"] = float(np.std(3.0 * x))
    return seen


def test_a_search_ends_at_the_noise_and_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = searched(monkeypatch, interrupted=False)
    assert seen["early_stop_condition"] == pytest.approx((0.03 / float(str(seen["size"]))) ** 2)
    assert seen["temp_equation_file"] is False
    assert not Path(str(seen["output_directory"])).exists()
    assert seen["found"]


def test_ctrl_c_that_julia_took_is_heeded(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(KeyboardInterrupt):
        searched(monkeypatch, interrupted=True)


@pytest.mark.long
@pytest.mark.skipif(
    symbolic_search.missing_pysr_requirements() is not None, reason="there is no Julia with PySR's packages"
)
def test_a_real_search() -> None:
    """A damped swing with 1 % noise, wherever Julia is."""
    time = np.linspace(0.0, 40.0, 2000)
    height = np.exp(-0.05 * time) * np.cos(1.4 * time)
    noise = np.random.default_rng(0).normal(0.0, 0.01 * height.std(), len(time))
    found = discover(PistonRecord(time, height + noise), "pysr")
    assert {term.text for term in found.best.terms} == {"z", "z'"}


@pytest.mark.long  # quick: searches that stand in for it take the settings
def test_settings_suit_the_real_constructor() -> None:
    pytest.importorskip("juliapkg")
    done = subprocess.run([sys.executable, "-c", STUB], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "TypeError" in done.stdout
    assert "tea" in done.stdout


PROBE = """
import os, sys
def PySRRegressor(): pass
seen = [os.environ.get(f"PYTHON_JULIACALL_{name}") for name in ("HANDLE_SIGNALS", "THREADS")]
import warnings; warnings.warn("of PySR, at these settings")
"""


@pytest.mark.parametrize(("given", "seen"), [({}, ["no", "1"]), ({"THREADS": "4"}, ["no", "4"])])
def test_ctrl_c_stays_with_python(given: dict[str, str], seen: list[str], tmp_path: Path) -> None:
    """The settings stand before PySR is imported, which imports Julia; the user's own go first."""
    (tmp_path / "pysr.py").write_text(PROBE)
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from reduced_models.discovery.symbolic_search import import_pysr_regressor\n"
        "import_pysr_regressor(); import pysr; print(pysr.seen)"
    )
    kept = {key: value for key, value in os.environ.items() if "JULIACALL" not in key}
    environment = kept | {f"PYTHON_JULIACALL_{name}": value for name, value in given.items()}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(seen)


def test_a_search_is_brought_back_to_the_record_s_units(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same call and result for PySR as for the others, with a search that knows the answer."""
    import types

    import pandas as pd

    class SymbolicSearch:
        def __init__(self, **settings: object) -> None:
            assert settings["deterministic"] is True

        def fit(self, matrix: np.ndarray, target: np.ndarray, variable_names: list[str]) -> None:
            numbers, *_ = np.linalg.lstsq(matrix[:, :2], target)
            best = " + ".join(f"({c} * {s})" for c, s in zip(numbers, variable_names, strict=False))
            self.equations_ = pd.DataFrame({"equation": ["x0 * -1.0", "x0 * NaN", best]})

    monkeypatch.setattr(symbolic_search, "missing_pysr_requirements", lambda: None)
    monkeypatch.setitem(sys.modules, "pysr", types.SimpleNamespace(PySRRegressor=SymbolicSearch))
    height = 0.7 * np.exp(-0.05 * TIME) * np.cos(1.4 * TIME)
    noise = np.random.default_rng(0).normal(0.0, 0.003, len(TIME))
    found = discover(PistonRecord(TIME, height + noise), "pysr", options=DiscoveryOptions(polish=0))
    assert found.method == "pysr"
    assert {term.text for term in found.best.terms} == {"z", "z'"}
    assert found.best.terms[min(found.best.terms)] != 0.0
    coefficients = {term.text: value for term, value in found.best.terms.items()}
    assert coefficients["z"] == pytest.approx(-(1.4**2 + 0.05**2), rel=0.01)
    assert coefficients["z'"] == pytest.approx(-0.1, rel=0.1)


def test_a_crowded_sum_is_pruned_and_stands_beside_sparse_sums(monkeypatch: pytest.MonkeyPatch) -> None:
    """PySR was seen to choose eight terms, with |z'|, for the four of a Van der Pol-like law."""
    from scipy.integrate import solve_ivp

    time = np.linspace(0.0, 30.0, 1500)
    swing = solve_ivp(
        lambda _, state: (state[1], -(state[0] ** 2 - 1.0) * state[1] * 0.8 - state[0] - 0.2 * state[0] ** 3),
        (0.0, 30.0),
        (2.0, 0.0),
        t_eval=time,
        rtol=1e-9,
    ).y[0]
    noisy = swing + 0.01 * swing.std() * np.random.default_rng(0).normal(size=len(time))
    z, v, speed = (sympy.Symbol(name, real=True) for name in ("z", "v", "speed"))
    crowded = 0.78 * v - 0.79 * z**2 * v - 0.98 * z - 0.21 * z**3
    crowded += 0.013 * speed - 0.011 * z * speed + 0.004 * z**2 - 0.006 * v * speed
    monkeypatch.setattr(symbolic_search, "missing_pysr_requirements", lambda: None)
    monkeypatch.setattr(
        "reduced_models.discovery.structure_proposals.search_expressions_with_pysr", lambda *_: [crowded]
    )
    found = discover(PistonRecord(time, noisy), "pysr", options=DiscoveryOptions(polish=0))
    assert {term.text for term in found.best.terms} == {"z", "z**3", "z'", "z'*z**2"}


def test_addends_that_hold_numbers_are_pruned_too() -> None:
    weak = weak_form(estimate_motion(RECORD, HeightLine()))
    library = physical_library_terms(1)
    _, scorer = score_subsets(weak, library, library, all_index_subsets(2))
    z, v = (sympy.Symbol(name, real=True) for name in ("z", "v"))
    candidates = _prune_expression(-1.01 * z + 0.02 * sympy.sin(1.3 * z) + 0.01 * sympy.tanh(2.0 * v), scorer)
    best = min(candidates, key=lambda candidate: candidate.criterion)
    assert best.terms is not None
    assert {term.text for term in best.terms} == {"z"}
