"""Relaxation times and compression speeds of beds: de Paula's protocol and shorter ones."""

from __future__ import annotations

from typing import NamedTuple

from validation.measured_quantities import compression_duration

STEP = "auto*1.5"
"""Time step of the beds. Friction holds them at rest when forces balance, whatever the step: a third of it,
and fixed steps from 0.1 to 1 ms, change force and mean distance by less than the scatter of the starts (see
the report)."""


class CompressionProtocol(NamedTuple):
    """Relaxation and compression.

    Attributes
    ----------
    name : str
    speed : float
        Speed of the piston on beds of equal grains [m/s].
    settling : float or None
        Duration of their relaxation [s]; 5 T if None.
    mixture_speed : float
        Speed of the piston on mixtures [m/s], whose relaxation always takes 5 T.
    """

    name: str
    speed: float
    settling: float | None
    mixture_speed: float

    def relaxation_duration(self, count: int, speed: float) -> float:
        """Return the duration of the relaxation of a bed of equal grains, in units of T."""
        if self.settling is None:
            return 5.0
        return self.settling / compression_duration(count, speed)

    def text(self, mixture: bool) -> str:
        """Return the protocol as text."""
        speed = 1e3 * (self.mixture_speed if mixture else self.speed)
        settling = "5 T" if mixture or self.settling is None else f"{self.settling:g} s"
        return f"{self.name}: {speed:g} mm/s after {settling}"


PUBLISHED = CompressionProtocol("published", 8.33e-3, None, 1e-3)
QUICK = CompressionProtocol("quick", 33e-3, 5.0, 16e-3)
HASTE = 4.0
"""Speed of the accelerated cycle over the published speed."""
ACCELERATED = CompressionProtocol("accelerated", HASTE * PUBLISHED.speed, None, 16e-3)

BEST_FIRST = (PUBLISHED.name, QUICK.name, ACCELERATED.name)
