"""The piston (if there is one) stands still."""

from __future__ import annotations

from granular.protocol.motion import Motion
from granular.protocol.stage import Timed
from granular.scene.scales import Scales


class Hold(Timed):
    """The piston stays where it is. Without duration and ``until``: as long as the run."""

    @property
    def needs_piston(self) -> bool:
        return False

    def motion(self, height: float, scales: Scales) -> Motion:
        return Motion(start=height / scales.length)
