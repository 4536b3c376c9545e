"""The piston is raised (or lowered) at once and held there."""

from __future__ import annotations

from granular.protocol.motion import Motion
from granular.protocol.stage import Stage
from granular.scene.scales import Scales
from granular.scene.schema import quantity


class Lift(Stage):
    """The nudge of [D, 5.3]: the piston is set ``by`` higher, faster than the grains can follow.

    Attributes
    ----------
    by : float
        How far [m]; negative lowers it.
    """

    by: float = quantity("m")

    def jump(self, height: float) -> float:
        return self.by

    def span(self, height: float) -> float | None:
        return 0.0

    def motion(self, height: float, scales: Scales) -> Motion:
        return Motion(start=height / scales.length)
