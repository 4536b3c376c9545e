"""Proof of the toolkit's numbers: convergence, energy, cost of accuracy, hard cases, one report.

>>> from validation import cheapest
>>> choice = cheapest(scene, "rest height", 0.01)
>>> run = simulate(scene.replace(**choice.changes), **choice.keywords)
"""

from __future__ import annotations

import importlib
from typing import Any

_HOMES = {
    "ConvergenceResult": "validation.convergence",
    "convergence": "validation.convergence",
    "Trend": "validation.trend",
    "energy_trend": "validation.trend",
    "WorkPrecision": "validation.work_precision",
    "work_precision": "validation.work_precision",
    "cheapest": "validation.cheapest",
    "exact_problems": "validation.exact",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    # Names are looked up when they are used, so that importing the package costs next to nothing.
    if name not in _HOMES:
        raise AttributeError(f"module 'validation' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
