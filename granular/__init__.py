"""Simulation of beds of repelling magnets between two glass plates, and of the piston on them.

>>> from granular import load_scene, simulate
>>> run = simulate(load_scene("damper"))
>>> record = run.piston()
"""

from __future__ import annotations

import importlib
from typing import Any

_HOMES = {
    "Scene": "granular.scene",
    "load_scene": "granular.scene",
    "scene_names": "granular.scene",
    "mono_bed": "granular.beds",
    "bidisperse": "granular.beds",
    "damper": "granular.beds",
    "sweep": "granular.studies.sweep",
    "Study": "granular.studies.sweep",
    "simulate": "granular.simulation",
    "evaluate": "granular.evaluation",
    "Evaluation": "granular.evaluation",
    "Trajectory": "granular.trajectory",
    "load_trajectory": "granular.trajectory",
    "PistonRecord": "granular.record",
    "GranularError": "granular.errors",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    # Names are looked up when they are used, so that importing the package costs next to nothing.
    if name not in _HOMES:
        raise AttributeError(f"module 'granular' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
