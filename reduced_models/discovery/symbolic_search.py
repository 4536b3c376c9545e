"""Symbolic regression by other programs: Operon and PySR.

pyoperon does genetic programming with fitted constants (Burlacu, Kronberger & Kommenda 2020,
doi:10.1145/3377929.3398099). PySR (Cranmer 2023, arXiv:2305.01582) needs Julia.

Importing PySR without Julia or PySR's Julia packages would download them. PySR is therefore imported only
after a check has found both.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import importlib.util
import logging
import os
import re
import shutil
import tempfile
import tomllib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.formulas import FormulaError, parse, variable_names
from granular.formulas.algebra import sympy_expression
from granular.shared.array_types import Float
from granular.shared.errors import InputError, import_extra, quote

if TYPE_CHECKING:
    import sympy


_OPERON_ITERATIONS = 10  # iterations in the fit of the constants of each new expression
# A search ends after this number of evaluations: a search that ends by time cannot be repeated.
_EVALUATIONS = 400_000
_POPULATION = 1000
_LENGTH = 30
_GENERATIONS = 10_000  # the limit of evaluations is reached earlier


def is_operon_installed() -> bool:
    """Return whether pyoperon is installed, without importing it."""
    return importlib.util.find_spec("pyoperon") is not None


def search_expressions_with_operon(
    inputs: Mapping[str, np.ndarray],
    target: Float[np.ndarray, "n"],
    noise: float,
    functions: Sequence[str] = (),
    effort: float = 1.0,
    seed: int = 0,
) -> list[sympy.Expr]:
    """Find expressions for a target by pyoperon's genetic programming."""
    # Pareto front of error and length, constants by least squares (Burlacu, Kronberger & Kommenda 2020,
    # doi:10.1145/3377929.3398099). pyoperon's default noise of 1 would select too short expressions.
    sklearn = import_extra("pyoperon.sklearn", "method 'operon'", "discover")
    samples = scale_samples_to_unit_rms(inputs, target)
    search = sklearn.SymbolicRegressor(
        allowed_symbols=",".join(("add", "sub", "mul", "constant", "variable", *functions)),
        objectives=["r2", "length"],
        optimizer_iterations=_OPERON_ITERATIONS,
        max_evaluations=round(effort * _EVALUATIONS),
        generations=_GENERATIONS,
        population_size=_POPULATION,
        max_length=_LENGTH,
        uncertainty=[noise / samples.target_size],
        n_threads=1,
        random_state=seed + 1,  # pyoperon takes 0 for no seed
    ).fit(samples.matrix, samples.target)
    names = list(samples.names)
    texts = [search.get_model_string(item["tree"], 12, names) for item in search.pareto_front_]
    return samples.parse_expressions(texts)


@dataclasses.dataclass(frozen=True, eq=False)
class ScaledSamples:
    """Samples scaled to unit rms, since searches try constants near 1."""

    matrix: Float[np.ndarray, "n inputs"]
    target: Float[np.ndarray, "n"]
    names: tuple[str, ...]
    sizes: Mapping[str, float]  # rms of each variable, in the order of the columns
    target_size: float

    def parse_expressions(self, texts: Iterable[str]) -> list[sympy.Expr]:
        """Parse expressions from a search, and restore the names and units of the variables."""
        import sympy

        own = {
            name: sympy.Symbol(variable, real=True) / size
            for name, (variable, size) in zip(self.names, self.sizes.items(), strict=True)
        }
        expressions = []
        for text in texts:
            with contextlib.suppress(FormulaError):
                tree = parse(text)
                if {item.name for item in variable_names(tree)} <= set(self.names):
                    # Matched by name, since searches create symbols with different assumptions.
                    expression = sympy_expression(tree)
                    symbols = {symbol: own[symbol.name] for symbol in expression.free_symbols}
                    expressions.append(sympy.Float(self.target_size) * expression.xreplace(symbols))
        return expressions


def scale_samples_to_unit_rms(
    inputs: Mapping[str, np.ndarray], target: Float[np.ndarray, "n"]
) -> ScaledSamples:
    """Divide samples by their rms values for a search."""
    sizes = {name: _positive_rms(values) for name, values in inputs.items()}
    matrix = np.stack([values / sizes[name] for name, values in inputs.items()], axis=1)
    names = tuple(f"x{k}" for k in range(len(inputs)))
    return ScaledSamples(matrix, target / _positive_rms(target), names, sizes, _positive_rms(target))


def _positive_rms(values: np.ndarray) -> float:
    return max(float(np.sqrt((values**2).mean())), 1e-300)


COMMANDS = ("pip install 'granular-damper[discover]'", 'python -c "import pysr"')
"""Commands that install PySR, and then Julia with PySR's Julia packages."""

_ENOUGH = 1.0
"""Mean square error at which a search ends, relative to the mean square noise. The true expression
reaches 0.66 to 0.96, since its fitted constants also fit part of the noise."""

_ITERATIONS = 60
_BINARY = ("/", "max", "min")
_MAXIMUM_NODES = 30


def require_pysr() -> None:
    """Raise an error with installation commands if PySR or Julia cannot run."""
    lack = missing_pysr_requirements()
    if lack is not None:
        raise InputError(
            f"method 'pysr' needs PySR and Julia 1.10.3 or newer, but {lack}; install both with: "
            f"{COMMANDS[0]} && {COMMANDS[1]}"
        )


def import_pysr_regressor() -> Any:
    """Import the class ``pysr.PySRRegressor`` so that Python still handles Ctrl-C."""
    # Julia would handle the signals and end the process. Without signals it is limited to one thread, which
    # a repeatable search has anyway, and Ctrl-C waits for the end of the search. The user's settings take
    # precedence: with "yes", PySR stops the search at Ctrl-C.
    os.environ.setdefault("PYTHON_JULIACALL_HANDLE_SIGNALS", "no")
    os.environ.setdefault("PYTHON_JULIACALL_THREADS", "1")
    try:
        with warnings.catch_warnings(action="ignore"):  # PySR warns of either setting
            from pysr import PySRRegressor
    except Exception as error:  # errors of Julia, juliapkg and the network share no base class
        raise InputError(
            f"PySR could not be started: {type(error).__name__}: {quote(str(error))}; try the command "
            f"{COMMANDS[1]}"
        ) from error
    return PySRRegressor


def pysr_regressor_settings(
    functions: Sequence[str] = (), effort: float = 1.0, seed: int = 0
) -> dict[str, Any]:
    """Return keyword arguments of ``pysr.PySRRegressor`` with which the seed makes a search repeatable."""
    return {
        "binary_operators": ["+", "-", "*", *(name for name in functions if name in _BINARY)],
        "unary_operators": [name for name in functions if name not in _BINARY],
        "niterations": max(1, round(effort * _ITERATIONS)),
        "maxsize": _MAXIMUM_NODES,
        "precision": 64,
        "deterministic": True,
        "parallelism": "serial",
        "random_state": seed,
        "temp_equation_file": False,  # it would not be deleted
        "progress": False,
        "verbosity": 0,
        "input_stream": "devnull",
    }


def search_expressions_with_pysr(
    inputs: Mapping[str, np.ndarray],
    target: Float[np.ndarray, "n"],
    noise: float,
    functions: Sequence[str] = (),
    effort: float = 1.0,
    seed: int = 0,
) -> list[sympy.Expr]:
    """Find expressions for a target by PySR (Cranmer 2023, arXiv:2305.01582)."""
    require_pysr()
    samples = scale_samples_to_unit_rms(inputs, target)
    with tempfile.TemporaryDirectory(prefix="granular-damper-") as folder:
        search = import_pysr_regressor()(
            early_stop_condition=_ENOUGH * (noise / samples.target_size) ** 2,
            output_directory=folder,
            **pysr_regressor_settings(functions, effort, seed),
        )
        search.fit(samples.matrix, samples.target, variable_names=list(samples.names))
        if getattr(search, "interrupted_", False):
            raise KeyboardInterrupt
        # The texts, not the column of SymPy objects: PySR makes those by eval.
        return samples.parse_expressions(search.equations_["equation"])


EXE, PROJECT = "PYTHON_JULIACALL_EXE", "PYTHON_JULIACALL_PROJECT"
"""Environment variables from which juliacall takes Julia and its project if both are set. Otherwise juliapkg
finds Julia and a project, and downloads missing parts."""

_PACKAGES = ("SymbolicRegression", "PythonCall")
_MANIFEST = re.compile(r"(Julia)?Manifest(-v[0-9.]+)?\.toml")


def missing_pysr_requirements() -> str | None:
    """State the missing requirement of PySR, or return None; downloads nothing."""
    if importlib.util.find_spec("pysr") is None:
        return "the package pysr is not installed"
    julia, project = os.environ.get(EXE), os.environ.get(PROJECT)
    if julia or project:
        return _find_fault_of_given_julia(julia, project)
    return None if _has_resolved_julia_packages() else "Julia or PySR's Julia packages are not installed"


def _find_fault_of_given_julia(julia: str | None, project: str | None) -> str | None:
    """State the fault of the user's Julia executable or project; None without fault."""
    if not julia or not project:
        return f"{EXE} and {PROJECT} must be set together"
    if shutil.which(julia) is None:
        return f"found no Julia at {quote(julia)}"
    if not os.path.isdir(project):
        return f"found no Julia project at {quote(project)}"
    installed = _julia_project_packages(Path(project))
    lack = [name for name in _PACKAGES if name not in installed]
    if lack:
        return f"the Julia project at {quote(project)} lacks {' and '.join(lack)}"
    return None


def _julia_project_packages(project: Path) -> set[str]:
    """Return the packages in all manifests of a Julia project (one for each version of Julia)."""
    names: set[str] = set()
    for path in project.iterdir():
        if _MANIFEST.fullmatch(path.name):
            try:
                plain: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
            except (OSError, ValueError):
                continue
            packages = plain.get("deps", plain)  # format 1 lists packages at the top level
            names |= set(packages) if isinstance(packages, dict) else set()
    return names


def _has_resolved_julia_packages() -> bool:
    """Return whether juliapkg has installed everything; checked by a dry run that installs nothing."""
    logging.getLogger("juliapkg").setLevel(logging.ERROR)
    try:
        return bool(importlib.import_module("juliapkg").resolve(dry_run=True))
    except Exception:  # with any error of juliapkg, PySR cannot run
        return False
