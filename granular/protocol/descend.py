"""The piston comes down slowly at first and faster later, as in de Paula's relaxation."""

from __future__ import annotations

from granular.protocol.motion import DESCENT, Motion
from granular.protocol.stage import Stage
from granular.scene.scales import Scales
from granular.scene.schema import quantity


class Descend(Stage):
    """The exponential law of [D, 2.3.2], in the reading

        H(t) = H_s - (H_s - to) (e^(k t/duration) - 1) / (e^k - 1)

    from the present height H_s, with k = 5: de Paula's relaxation of 5 T under exp(t/T - 5).

    Attributes
    ----------
    to : float
        Height at the end [m].
    duration : float
        [s]
    steepness : float
        k
    """

    to: float = quantity("m", above=0.0)
    duration: float = quantity("s", above=0.0)
    steepness: float = quantity("1", default=5.0, above=0.0)

    def span(self, height: float) -> float | None:
        return self.duration

    def motion(self, height: float, scales: Scales) -> Motion:
        return Motion(
            kind=DESCENT,
            start=height / scales.length,
            reach=(height - self.to) / scales.length,
            span=self.duration / scales.time,
            steepness=self.steepness,
        )

    def final_height(self) -> float | None:
        return self.to
