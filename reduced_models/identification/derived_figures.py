"""Figures of small motions that the stiffness of a bed gives without a fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from reduced_models.models.quantities import DAMPING_RATIO, LEVEL, QuantityWithError

FREQUENCY = "natural frequency"
_DERIVED = (
    ("frequency", FREQUENCY, "f0", "Hz", 1.0),
    ("damping_ratio", DAMPING_RATIO, "zeta", "%", 100.0),
    ("level", LEVEL, "z0", "mm", 1e3),
)


class DerivedFigures(NamedTuple):
    """Figures of small motions, derived from the stiffness of the bed at rest."""

    level: float  # [m]
    frequency: float  # [Hz]
    damping_ratio: float
    step_error: float  # largest relative error, of frequency or damping ratio, that the run's time step makes

    def text(self, figures: Sequence[QuantityWithError]) -> str:
        """Figures in words, each with the relative difference of the fitted one, beyond its error or not."""
        fitted = {figure.name: figure for figure in figures}
        words, differences = [], []
        for field, name, symbol, unit, factor in _DERIVED:
            value, figure = factor * getattr(self, field), fitted.get(name)
            words.append(f"{symbol} {value:.5g} {unit}")
            if figure is not None and figure.unit == unit:
                difference = figure.value - value
                error = math.hypot(figure.parts.get("fit", 0.0), figure.parts.get("step", 0.0))
                beyond = " beyond its error" if abs(difference) > error else ""
                differences.append(f"{100.0 * difference / value:+.1g} %{beyond}")
        return ", ".join(words) + (f" (fit {', '.join(differences)})" if differences else "")
