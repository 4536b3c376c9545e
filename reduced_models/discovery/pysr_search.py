"""Symbolic regression by PySR (Cranmer 2023, arXiv:2305.01582), where Julia is there.

Nothing is imported or downloaded before a probe has found Julia and PySR's Julia packages in
place: importing PySR without them would fetch both.
"""

from __future__ import annotations

import importlib
import importlib.util
import logging
import os
import re
import shutil
import tempfile
import tomllib
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.formulas import FormulaFunction
from granular.shared.errors import InputError
from granular.shared.message_text import quote
from reduced_models.discovery.operon_search import scale_samples

if TYPE_CHECKING:
    import sympy
    from jaxtyping import Float

COMMANDS = ("pip install 'granular-damper[discover]'", 'python -c "import pysr"')
"""The commands that install PySR, and then Julia with PySR's Julia packages."""

_ENOUGH = 1.0
"""Mean square error over that of the noise at which a search ends: the right expression comes to
0.66 to 0.96 of it, since it follows a little of the noise."""

_ITERATIONS = 60
_BINARY = ("/", "max", "min")
_MOST_NODES = 30
_MOST_ELLIPTIC_NODES = 16
"""Most nodes in searches with elliptic functions, which cost a hundred times a sine."""
_MEAN = "foldl((p, _) -> ((p[1] + p[2])/2, sqrt(p[1]*p[2])), 1:5; init=(one({m}), sqrt({m})))[1]"
_QUARTER = "(pi/(2*" + _MEAN.format(m="(1 - m)") + "))"
_NOME = "exp(-pi*" + _MEAN.format(m="(1 - m)") + "/" + _MEAN.format(m="m") + ")"
_PHASE = "(pi*u/(2*K))"
_ODD = "2*pi/(K*sqrt(m))*sum(q^(n + 0.5)/(1 {sign} q^(2*n + 1))*{wave}((2*n + 1)*x) for n in 0:5)"
_EVEN = "pi/(2*K) + 2*pi/K*sum(q^n/(1 + q^(2*n))*cos(2*n*x) for n in 1:5)"
_SERIES = {
    "jacobi_sn": _ODD.format(sign="-", wave="sin"),
    "jacobi_cn": _ODD.format(sign="+", wave="cos"),
    "jacobi_dn": _EVEN,
}
_RANGE = (1e-6, 0.9999)


def _scipy_elliptic_function(index: int) -> Callable[..., Any]:
    """SciPy's sn, cn or dn of u and m."""

    def value(u: Any, m: Any) -> Any:
        from scipy.special import ellipj

        return ellipj(u, m)[index]

    return value


ELLIPTIC = {name: FormulaFunction(_scipy_elliptic_function(k), 2, 2) for k, name in enumerate(_SERIES)}
"""Jacobi's functions by the names that PySR knows them by."""


def elliptic_julia_operators() -> list[str]:
    """Jacobi's sn, cn, dn of u and the parameter m as Julia functions of one line each."""
    # Six terms of the series in the nome (Abramowitz & Stegun 16.23), for 1e-6 < m < 0.9999, NaN elsewhere as
    # PySR asks; right to 3e-5 up to m = 0.9 and to 0.013 at 0.9999. Enough for a search: what it finds is
    # fitted with SciPy's functions.
    low, high = _RANGE
    return [
        f"{name}(u, m) = ({low} < m < {high}) ? "
        f"((K, q) -> ((x) -> oftype(u, {series}))({_PHASE}))({_QUARTER}, {_NOME}) : oftype(u, NaN)"
        for name, series in _SERIES.items()
    ]


def elliptic_sympy_mappings() -> dict[str, Callable[[Any, Any], Any]]:
    """Jacobi's sn, cn, dn as SymPy functions, by the names that PySR writes."""
    import sympy

    return {name: sympy.Function(name) for name in _SERIES}


def require_pysr() -> None:
    """Raise an error, with the commands that cure it, unless PySR and Julia can run."""
    lack = missing_pysr_requirements()
    if lack is not None:
        raise InputError(
            f"method 'pysr' needs Julia 1.10 or newer, and {lack}; install it with: "
            f"{COMMANDS[0]} && {COMMANDS[1]}"
        )


def import_pysr_regressor() -> Any:
    """Import the class ``pysr.PySRRegressor`` so that Ctrl-C still comes to Python."""
    # Julia would take over the signals, and end the process; without them it may have one thread, as a search
    # that can be repeated has anyway. The user's own settings stay.
    os.environ.setdefault("PYTHON_JULIACALL_HANDLE_SIGNALS", "no")
    os.environ.setdefault("PYTHON_JULIACALL_THREADS", "1")
    try:
        with warnings.catch_warnings(action="ignore"):  # PySR warns of either setting
            from pysr import PySRRegressor
    except Exception as error:  # Julia's, juliapkg's and the network's are of no common kind
        raise InputError(
            f"PySR could not be started: {type(error).__name__}: {quote(str(error))}; try {COMMANDS[1]}"
        ) from error
    return PySRRegressor


def pysr_regressor_settings(
    functions: Sequence[str] = (), elliptic: bool = False, effort: float = 1.0, seed: int = 0
) -> dict[str, Any]:
    """Keywords of ``pysr.PySRRegressor`` for a search that a seed repeats."""
    binary = ["+", "-", "*", *(name for name in functions if name in _BINARY)]
    return {
        "binary_operators": binary + (elliptic_julia_operators() if elliptic else []),
        "unary_operators": [name for name in functions if name not in _BINARY],
        "extra_sympy_mappings": elliptic_sympy_mappings() if elliptic else None,
        "niterations": max(1, round(effort * _ITERATIONS)),
        "maxsize": _MOST_ELLIPTIC_NODES if elliptic else _MOST_NODES,
        "precision": 64,
        "deterministic": True,
        "parallelism": "serial",
        "random_state": seed,
        "temp_equation_file": False,  # it would be left behind
        "progress": False,
        "verbosity": 0,
        "input_stream": "devnull",
    }


def search_expressions_with_pysr(
    inputs: Mapping[str, np.ndarray],
    target: Float[np.ndarray, "n"],
    noise: float,
    functions: Sequence[str] = (),
    elliptic: bool = False,
    effort: float = 1.0,
    seed: int = 0,
) -> list[sympy.Expr]:
    """Find expressions for a target by PySR (Cranmer 2023, arXiv:2305.01582)."""
    require_pysr()
    samples = scale_samples(inputs, target)
    with tempfile.TemporaryDirectory(prefix="granular-damper-") as folder:
        search = import_pysr_regressor()(
            early_stop_condition=_ENOUGH * (noise / samples.target_size) ** 2,
            output_directory=folder,
            **pysr_regressor_settings(functions, elliptic, effort, seed),
        )
        search.fit(samples.matrix, samples.target, variable_names=list(samples.names))
        if getattr(search, "interrupted_", False):
            raise KeyboardInterrupt
        # Not the column of SymPy's objects: PySR evaluates its texts to make them.
        return samples.parse_expressions(search.equations_["equation"], ELLIPTIC if elliptic else {})


EXE, PROJECT = "PYTHON_JULIACALL_EXE", "PYTHON_JULIACALL_PROJECT"
_READS_BOTH = (0, 9, 28)
"""The juliacall from which on a Julia and a project that both are named so are taken
(PythonCall.jl's changelog); otherwise juliapkg finds them, and fetches what is not there."""

_PACKAGES = ("SymbolicRegression", "PythonCall")
_MANIFEST = re.compile(r"(Julia)?Manifest(-v[0-9.]+)?\.toml")


def missing_pysr_requirements() -> str | None:
    """Return the requirement that PySR lacks here, in words; nothing is ever downloaded."""
    if importlib.util.find_spec("pysr") is None:
        return "the package pysr is not installed"
    julia, project = os.environ.get(EXE), os.environ.get(PROJECT)
    if (julia or project) and _juliacall_version() >= _READS_BOTH:
        return _missing_from_named_julia(julia, project)
    if _has_resolved_julia_packages():
        return None
    if julia or project:
        return f"{EXE} and {PROJECT} are read by juliacall 0.9.28 and newer only"
    return "Julia, or PySR's Julia packages, are not there"


def _missing_from_named_julia(julia: str | None, project: str | None) -> str | None:
    """Return what is missing of a Julia and a project that the user names."""
    if not julia or not project:
        return f"{EXE} and {PROJECT} must be set together"
    if shutil.which(julia) is None:
        return f"there is no Julia at {quote(julia)}"
    if not os.path.isdir(project):
        return f"there is no Julia project at {quote(project)}"
    installed = _julia_project_packages(Path(project))
    lack = [name for name in _PACKAGES if name not in installed]
    if lack:
        return f"the Julia project at {quote(project)} lacks {' and '.join(lack)}"
    return None


def _julia_project_packages(project: Path) -> set[str]:
    """Return the packages of a project's manifests: Julia takes the one of its version."""
    names: set[str] = set()
    for path in project.iterdir():
        if _MANIFEST.fullmatch(path.name):
            try:
                plain: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
            except (OSError, ValueError):
                continue
            packages = plain.get("deps", plain)  # a manifest of the first format has them on top
            names |= set(packages) if isinstance(packages, dict) else set()
    return names


def _juliacall_version() -> tuple[int, ...]:
    """Version of juliacall; (0,) where there is none."""
    try:
        words = re.match(r"\d+(\.\d+)*", version("juliacall"))
    except PackageNotFoundError:
        return (0,)
    return tuple(map(int, words[0].split("."))) if words else (0,)


def _has_resolved_julia_packages() -> bool:
    """Return true where juliapkg has all in place; a dry run looks without installing."""
    logging.getLogger("juliapkg").setLevel(logging.ERROR)
    try:
        return bool(importlib.import_module("juliapkg").resolve(dry_run=True))
    except Exception:  # whatever is wrong with it, PySR cannot run
        return False
