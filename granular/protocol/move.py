"""The piston moves at constant speed to a height."""

from __future__ import annotations

import math

from granular.protocol.motion import Motion
from granular.protocol.stage import Stage
from granular.scene.scales import Scales
from granular.scene.schema import FieldError, quantity


class Move(Stage):
    """Constant speed to a height, as in the compression of [D, 2.3.3].

    Attributes
    ----------
    to : float
        Height at the end [m].
    speed : float or None
        Magnitude of the velocity [m/s].
    duration : float or None
        How long it takes [s]; one of speed and duration is given.
    until_force : float or None
        Stop before, as soon as the grains push the piston with this force [N]; the experiments of
        de Paula stop at 110 N.
    """

    to: float = quantity("m", above=0.0)
    speed: float | None = quantity("m/s", above=0.0, default=None, optional=True)
    duration: float | None = quantity("s", above=0.0, default=None, optional=True)
    until_force: float | None = quantity("N", above=0.0, default=None, optional=True)

    def validate(self) -> None:
        if (self.speed is None) == (self.duration is None):
            raise FieldError("give either speed or duration", "speed")

    @property
    def limits_force(self) -> bool:
        return self.until_force is not None

    def span(self, height: float) -> float | None:
        if self.duration is not None:
            return self.duration
        assert self.speed is not None
        return abs(self.to - height) / self.speed

    def motion(self, height: float, scales: Scales) -> Motion:
        span = self.span(height)
        velocity = (self.to - height) / span if span else 0.0
        limit = math.inf if self.until_force is None else self.until_force / scales.force
        return Motion(start=height / scales.length, speed=velocity / scales.velocity, limit=limit)

    def final_height(self) -> float | None:
        return self.to
