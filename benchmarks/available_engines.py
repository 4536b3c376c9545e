"""Other engines that can be timed here, and reasons for missing ones."""

from __future__ import annotations

import importlib
from types import ModuleType

FOLDER = "benchmarks.other_engines"

NAMES = {"openmm": "OpenMM", "lammps": "LAMMPS"}


def unavailability_reason(name: str) -> str | None:
    """Return the reason why an engine cannot be timed here, or None."""
    module = _module(name)
    if module is None:
        return (
            f"{NAMES[name]} is timed only from a checkout, since a wheel omits it; run "
            "python -m benchmarks in a checkout, with pip install '.[peers]'"
        )
    reason: str | None = module.missing()
    return reason


def engine(name: str) -> ModuleType | None:
    """Return the module that times an engine, or None if it cannot be timed here."""
    return None if unavailability_reason(name) else _module(name)


def _module(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(f"{FOLDER}.{name}")
    except ModuleNotFoundError:
        return None
