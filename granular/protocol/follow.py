"""The piston follows a table of heights."""

from __future__ import annotations

import numpy as np

from granular.protocol.motion import TABLE, Motion
from granular.protocol.stage import Stage
from granular.scene.scales import Scales
from granular.scene.schema import FieldError, numbers


class Follow(Stage):
    """Straight lines from row to row of a table; the piston is at the first height at once.

    Attributes
    ----------
    times : tuple of float
        [s], increasing from 0, counted from the stage's start.
    heights : tuple of float
        [m]
    """

    times: tuple[float, ...] = numbers("s", least=0.0)
    heights: tuple[float, ...] = numbers("m", above=0.0)

    def validate(self) -> None:
        if len(self.times) != len(self.heights):
            raise FieldError(
                f"holds {len(self.heights)} values for {len(self.times)} times", "heights"
            )
        if len(self.times) < 2 or self.times[0] != 0.0 or (np.diff(self.times) <= 0.0).any():
            raise FieldError("must increase from 0, with at least two values", "times")

    @property
    def tabled(self) -> bool:
        return True

    def span(self, height: float) -> float | None:
        return self.times[-1]

    def motion(self, height: float, scales: Scales) -> Motion:
        return Motion(
            kind=TABLE,
            start=self.heights[0] / scales.length,
            times=np.array(self.times) / scales.time,
            heights=np.array(self.heights) / scales.length,
        )

    def jump(self, height: float) -> float:
        return self.heights[0] - height

    def final_height(self) -> float | None:
        return self.heights[-1]
