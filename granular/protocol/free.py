"""The piston moves freely, under its weight and the force of the grains."""

from __future__ import annotations

from granular.protocol.motion import Motion
from granular.protocol.stage import Timed
from granular.scene.scales import Scales


class Free(Timed):
    """Free motion from the present height and velocity. Needs ``piston.mass``."""

    @property
    def needs_mass(self) -> bool:
        return True

    def motion(self, height: float, scales: Scales) -> Motion:
        return Motion(free=True, start=height / scales.length)
