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
    step_errors: tuple[float, float] | None
    """Relative errors of frequency and damping ratio by the run's time step; None if it has no root."""

    def step_error(self, figure: QuantityWithError) -> float:
        """Error of a figure by the time step: none at rest; a bound for other numbers of a law."""
        assert self.step_errors is not None
        of_frequency, of_damping = self.step_errors
        relative = {FREQUENCY: of_frequency, DAMPING_RATIO: of_damping, LEVEL: 0.0, "rest": 0.0}
        return abs(figure.value) * relative.get(figure.name, 2.0 * of_frequency + of_damping)

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
