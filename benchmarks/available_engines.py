"""Which other engines can be timed here, and why the rest cannot."""

from __future__ import annotations

import importlib
from types import ModuleType

FOLDER = "benchmarks.other_engines"

NAMES = {"openmm": "OpenMM", "lammps": "LAMMPS"}


def why_not(name: str) -> str | None:
    """Why the engine cannot be timed here; None where it can."""
    module = _module(name)
    if module is None:
        return (
            f"{NAMES[name]} is timed from the sources only, which a wheel leaves out; run "
            "python -m benchmarks in a checkout, with pip install '.[peers]'"
        )
    reason: str | None = module.missing()
    return reason


def engine(name: str) -> ModuleType | None:
    """What times the engine; None where it cannot be timed here."""
    return None if why_not(name) else _module(name)


def _module(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(f"{FOLDER}.{name}")
    except ModuleNotFoundError:
        return None
