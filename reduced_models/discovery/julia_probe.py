"""Whether PySR can run: PySR, Julia and PySR's Julia packages, looked for without starting any.

juliacall takes a Julia and a project that both are named by environment variables, from 0.9.28 on
(PythonCall.jl's changelog); otherwise juliapkg finds them, and fetches what is not there.
"""

from __future__ import annotations

import importlib
import importlib.util
import logging
import os
import re
import shutil
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from granular.shared.messages import quoted

EXE, PROJECT = "PYTHON_JULIACALL_EXE", "PYTHON_JULIACALL_PROJECT"
_READS_BOTH = (0, 9, 28)
"""The juliacall from which on the two are read."""

_PACKAGES = ("SymbolicRegression", "PythonCall")
_MANIFEST = re.compile(r"(Julia)?Manifest(-v[0-9.]+)?\.toml")


def missing() -> str | None:
    """What PySR lacks here, in words; None where it can run. Never downloads anything."""
    if importlib.util.find_spec("pysr") is None:
        return "the package pysr is not installed"
    julia, project = os.environ.get(EXE), os.environ.get(PROJECT)
    if (julia or project) and _juliacall() >= _READS_BOTH:
        return _of_the_two(julia, project)
    if _resolved():
        return None
    if julia or project:
        return f"{EXE} and {PROJECT} are read by juliacall 0.9.28 and newer only"
    return "Julia, or PySR's Julia packages, are not there"


def _of_the_two(julia: str | None, project: str | None) -> str | None:
    """What is missing of a Julia and a project that the user names."""
    if not julia or not project:
        return f"{EXE} and {PROJECT} must be set together"
    if shutil.which(julia) is None:
        return f"there is no Julia at {quoted(julia)}"
    if not os.path.isdir(project):
        return f"there is no Julia project at {quoted(project)}"
    installed = _installed(Path(project))
    lack = [name for name in _PACKAGES if name not in installed]
    if lack:
        return f"the Julia project at {quoted(project)} lacks {' and '.join(lack)}"
    return None


def _installed(project: Path) -> set[str]:
    """Packages of a project's manifests: Julia takes the one of its version."""
    found: set[str] = set()
    for path in project.iterdir():
        if _MANIFEST.fullmatch(path.name):
            try:
                plain: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
            except (OSError, ValueError):
                continue
            packages = plain.get("deps", plain)  # a manifest of the first format has them on top
            found |= set(packages) if isinstance(packages, dict) else set()
    return found


def _juliacall() -> tuple[int, ...]:
    """The version of juliacall; (0,) where there is none."""
    try:
        words = re.match(r"\d+(\.\d+)*", version("juliacall"))
    except PackageNotFoundError:
        return (0,)
    return tuple(map(int, words[0].split("."))) if words else (0,)


def _resolved() -> bool:
    """Whether juliapkg has all in place; a dry run looks without installing."""
    logging.getLogger("juliapkg").setLevel(logging.ERROR)
    try:
        return bool(importlib.import_module("juliapkg").resolve(dry_run=True))
    except Exception:  # whatever is wrong with it, PySR cannot run
        return False
