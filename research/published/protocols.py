"""How long a bed relaxes, and how fast it is compressed: de Paula's protocol and shorter ones."""

from __future__ import annotations

from typing import NamedTuple

from validation.measured_quantities import compression_duration

STEP = "auto*1.5"
"""Time step of the beds. Friction holds them at rest where the forces balance, whatever the step:
a third of it, and fixed steps from 0.1 to 1 ms, move force and mean distance by less than the
scatter of the starts (the report shows it)."""


class Protocol(NamedTuple):
    """Relaxation and compression.

    Attributes
    ----------
    name : str
    speed : float
        Of the piston on beds of equal grains [m/s].
    settling : float or None
        Length of their relaxation [s]; 5 T if None.
    mixture_speed : float
        On mixtures [m/s], whose relaxation always takes 5 T.
    """

    name: str
    speed: float
    settling: float | None
    mixture_speed: float

    def relaxation(self, count: int, speed: float) -> float:
        """Length of the relaxation of a bed of equal grains, in units of T."""
        if self.settling is None:
            return 5.0
        return self.settling / compression_duration(count, speed)

    def words(self, mixture: bool) -> str:
        """The protocol in words."""
        speed = 1e3 * (self.mixture_speed if mixture else self.speed)
        settling = "5 T" if mixture or self.settling is None else f"{self.settling:g} s"
        return f"{self.name}: {speed:g} mm/s after {settling}"


PUBLISHED = Protocol("published", 8.33e-3, None, 1e-3)
QUICK = Protocol("quick", 33e-3, 5.0, 16e-3)
HASTE = 4.0
"""The accelerated cycle's speed over the published one's."""
ACCELERATED = Protocol("accelerated", HASTE * PUBLISHED.speed, None, 16e-3)

BEST_FIRST = (PUBLISHED.name, QUICK.name, ACCELERATED.name)
