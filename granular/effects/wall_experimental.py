"""The experimental wall: a power law fitted to measurements.

Force on a grain at the distance w: (1/2) q / w^3.5 along the normal; energy (1/5) q / w^2.5
[D, eq. 2.8, in the reading that reproduces the published forces: as printed its dimensions do not
match].
"""

from __future__ import annotations

import math
from typing import NamedTuple

from granular.compiled import compiled, entry

# [D, eq. 2.8]; energy and stiffness are its integral and slope.
STRENGTH = 0.5
ENERGY = STRENGTH / 2.5
STIFFNESS = STRENGTH * 3.5


class ExperimentalWall(NamedTuple):
    """The law as the kernels take it."""

    @staticmethod
    @compiled(inline=True)
    def is_behind(law: object, w: float) -> bool:
        """Return False: behind the wall the force is no number, so that the total tells; w [D]."""
        return False

    @staticmethod
    @entry
    def force(law: object, w: float) -> float:
        """Force 1/(2 w^3.5) away from the wall on a grain of the first species, [D, eq. 2.8] [F*]; w [D]."""
        return STRENGTH / (w * w * w * math.sqrt(w))

    @staticmethod
    @entry
    def energy(law: object, w: float) -> float:
        """Energy 1/(5 w^2.5) of a grain of the first species at the wall, [D, eq. 2.8] [F* D]; w [D]."""
        return ENERGY / (w * w * math.sqrt(w))

    @staticmethod
    @entry
    def stiffness(law: object, w: float) -> float:
        """Minus the slope of the force, 7/(4 w^4.5), of a grain of the first species [F*/D]; w [D]."""
        w2 = w * w
        return STIFFNESS / (w2 * w2 * math.sqrt(w))

    @staticmethod
    @entry
    def turning_point_stiffness(law: object, speed: float) -> float:
        """Stiffness per mass [1/tau^2] where a grain of this speed [D/tau] turns: U(w) = v^2/2."""
        return STIFFNESS * (speed * speed / (2.0 * ENERGY)) ** 1.8
