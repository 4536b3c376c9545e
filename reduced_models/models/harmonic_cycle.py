"""A harmonic cycle of a motion, or of a force on a prescribed stroke."""

from __future__ import annotations

import math
from typing import NamedTuple

from reduced_models.models.plain_data import SizeOrUnknown


class HarmonicCycle(NamedTuple):
    """A harmonic cycle: of a motion per kilogram, of a force on a prescribed stroke in newtons.

    Attributes
    ----------
    amplitude, frequency, centre : float
        [m], [rad/s], [m].
    stiffness, damping, energy : float
        Of the first harmonic, and dissipated: [1/s^2], [1/s], [J/kg], or [N/m], [N s/m], [J].
    errors : (float, float, float)
        Half-widths of the intervals of these three; zero where none are known.
    measured : int
        Number of cycles that were measured; 0 of a law.
    """

    amplitude: float
    frequency: float
    centre: float
    stiffness: float
    damping: float
    energy: float
    errors: tuple[SizeOrUnknown, ...] = (0.0, 0.0, 0.0)
    measured: int = 0

    @property
    def damping_ratio(self) -> float:
        """Fraction of critical damping."""
        return self.damping / (2.0 * math.sqrt(self.stiffness))
