"""The free piston is pushed by a force that is written as a formula of time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from granular.effects.dimensions import Dimension
from granular.effects.formula import TIME
from granular.protocol.course import Course
from granular.protocol.motion import SPLINE, Motion
from granular.scene.scales import Scales
from granular.scene.schema import quantity, text


class Force(Course):
    """A force on the free piston, upwards, such as ``f*exp(-t/s)``.

    Attributes
    ----------
    force : str
        [N]; of the time ``t`` since the stage's start, and parameters, which stand beside it with
        their units. It must be smooth.
    duration : float
        [s]
    """

    variables: ClassVar[Mapping[str, Dimension]] = {"t": TIME}
    written: ClassVar[str] = "force"
    unit: ClassVar[str] = "N"

    force: str = text()
    duration: float = quantity("s", above=0.0)

    @property
    def needs_mass(self) -> bool:
        return True

    def span(self, height: float) -> float | None:
        return self.duration

    def motion(self, height: float, scales: Scales) -> Motion:
        times, values = self.course(self.duration, None)
        values[0] /= scales.force
        values[1] *= scales.time / scales.force
        return Motion(
            free=True,
            kind=SPLINE,
            start=height / scales.length,
            times=times / scales.time,
            heights=values.ravel(),
        )
