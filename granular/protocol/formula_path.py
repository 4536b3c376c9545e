"""The piston moves along a path that is written as a formula of time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from granular.effects.dimensions import Dimension
from granular.effects.formula import LENGTH, TIME
from granular.protocol.course import Course
from granular.protocol.motion import SPLINE, Motion
from granular.scene.scales import Scales
from granular.scene.schema import FieldError, quantity, text


class Path(Course):
    """A height as a formula, such as ``h0 - a*(1 - cos(w*t))/2``.

    Attributes
    ----------
    height : str
        [m]; of the time ``t`` since the stage's start, the height ``h0`` there, and parameters,
        which stand beside it with their units. It must begin at ``h0`` and be smooth.
    duration : float
        [s]
    """

    variables: ClassVar[Mapping[str, Dimension]] = {"t": TIME, "h0": LENGTH}
    written: ClassVar[str] = "height"
    unit: ClassVar[str] = "m"

    height: str = text()
    duration: float = quantity("s", above=0.0)

    def span(self, height: float) -> float | None:
        return self.duration

    def motion(self, height: float, scales: Scales) -> Motion:
        times, values = self.course(self.duration, height)
        if abs(values[0, 0] - height) > 1e-9 * max(height, 1e-3):
            raise FieldError(
                f"begins at {values[0, 0]:g} m and the piston stands at {height:g} m; let the "
                "formula begin at h0",
                "height",
            )
        values[0] /= scales.length
        values[1] /= scales.velocity
        return Motion(
            kind=SPLINE,
            start=height / scales.length,
            times=times / scales.time,
            heights=values.ravel(),
        )
