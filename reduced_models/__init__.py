"""From a piston's motion to its equation.

>>> from reduced_models import PistonRecord, fit
>>> model = fit(PistonRecord.from_csv("lab.csv"), law="van-der-pol-like")
>>> print(model)
"""

from __future__ import annotations

import importlib
from typing import Any

_HOMES = {
    "PistonRecord": "granular.record",
    "fit": "reduced_models.fitting",
    "HeightMap": "reduced_models.model",
    "ReducedModel": "reduced_models.model",
    "load_model": "reduced_models.model",
    "Law": "reduced_models.law",
    "law_named": "reduced_models.laws",
    "identify": "reduced_models.identification",
    "discover": "reduced_models.discovery.discovering",
    "compare": "reduced_models.comparison",
    "Comparison": "reduced_models.comparison",
    "roll_out": "reduced_models.judging",
    "forced_law": "reduced_models.response",
    "calibrate": "reduced_models.calibration",
    "Calibration": "reduced_models.calibrated",
    "LawEstimator": "reduced_models.estimator",
    "design": "reduced_models.designs.design",
    "Design": "reduced_models.designs.result",
    "Candidate": "reduced_models.designs.candidate",
    "DamperMaps": "reduced_models.designs.maps",
    "damper_maps": "reduced_models.designs.maps",
    "run_study": "reduced_models.designs.study",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    # Names are looked up when they are used, so that importing the package costs next to nothing.
    if name not in _HOMES:
        raise AttributeError(f"module 'reduced_models' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
