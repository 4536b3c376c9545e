"""The piston is driven to and fro."""

from __future__ import annotations

import math

from granular.protocol.motion import SINE, Motion
from granular.protocol.stage import Stage
from granular.scene.scales import Scales
from granular.scene.schema import FieldError, quantity


class Oscillate(Stage):
    """Height H + amplitude sin(2 pi f t) about the present height H.

    Attributes
    ----------
    amplitude : float
        [m]
    frequency : float
        f [Hz]; t counts from the stage's start.
    duration : float or None
        [s]; without, as long as the run.
    """

    amplitude: float = quantity("m", above=0.0)
    frequency: float = quantity("Hz", above=0.0)
    duration: float | None = quantity("s", above=0.0, default=None, optional=True)

    def validate(self) -> None:
        if self.duration is not None and self.duration * self.frequency < 0.25:
            raise FieldError(
                f"{self.duration:g} s is less than a quarter of a period, "
                f"{0.25 / self.frequency:g} s",
                "duration",
            )

    def span(self, height: float) -> float | None:
        return self.duration

    def motion(self, height: float, scales: Scales) -> Motion:
        return Motion(
            kind=SINE,
            start=height / scales.length,
            reach=self.amplitude / scales.length,
            omega=2.0 * math.pi * self.frequency * scales.time,
        )
