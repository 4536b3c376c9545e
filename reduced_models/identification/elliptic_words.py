"""The elliptic motion behind a fitted Duffing law, where it describes the record."""

from __future__ import annotations

import math

from granular.run.record import PistonRecord
from reduced_models.identification.comparison import NOISE_TIE, TIE
from reduced_models.identification.comparison_table import Comparison
from reduced_models.laws.duffing import DUFFING
from reduced_models.laws.elliptic_motion import EllipticMotion, elliptic_motion
from reduced_models.models.model import ReducedModel

_BENT = 0.01
"""Least m: below it the motion is a cosine."""
_MOST_LOST = 0.5
"""Share of the amplitude that drag may take in the record: with more, no one function is said."""


def elliptic_of(comparison: Comparison, record: PistonRecord) -> EllipticMotion | None:
    """The elliptic motion that the Duffing law starts with, where no law predicts better."""
    model = _model(comparison)
    if model is None or _lost(model, record) > _MOST_LOST:
        return None
    values = model.parameters
    found = elliptic_motion(values["k"], values["beta"], values["rest"], *model.initial)
    return found if found is not None and found.m >= _BENT else None


def elliptic_words(comparison: Comparison, record: PistonRecord) -> str:
    """That the fitted Duffing law and an elliptic function are one motion; empty where none is."""
    found, model = elliptic_of(comparison, record), _model(comparison)
    if found is None or model is None:
        return ""
    lost = _lost(model, record)
    start = "" if lost < 0.01 else f" at the start (drag takes {100 * lost:.2g} % of the swing)"
    return (
        f"The motion of {DUFFING.name}{start} is {found.text()}, with m = k^2: Jacobi's "
        f"{found.function} solves this law, so the elliptic motion and the Duffing law are one "
        "motion, not two."
    )


def _model(comparison: Comparison) -> ReducedModel | None:
    """Of the Duffing law, where it predicts as well as the best law does."""
    best = comparison.rows[0]
    limit = max((1.0 + TIE) * best.error, NOISE_TIE * comparison.noise)
    for row in comparison.rows:
        if row.name == DUFFING.name and len(row.models) == 1 and row.error <= limit:
            return row.models[0]
    return None


def _lost(model: ReducedModel, record: PistonRecord) -> float:
    """Share of the amplitude that the drag takes in the course of the record."""
    return 1.0 - math.exp(-model.parameters["lam"] * float(record.time[-1] - record.time[0]))
