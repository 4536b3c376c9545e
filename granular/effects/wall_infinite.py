"""The infinite wall: a half plane of dipoles.

Force on a grain at the distance w: q / w^3 along the normal; energy q / (2 w^2) [D, eq. 3.3].
"""

from __future__ import annotations

from typing import NamedTuple

from granular.compiled import entry


class InfiniteWall(NamedTuple):
    """The law as the kernels take it."""

    @staticmethod
    @entry
    def force(law: object, w: float) -> float:
        """Force 1/w^3 away from the wall on a grain of the first species, [D, eq. 3.3] [F*]; w [D]."""
        return 1.0 / (w * w * w)

    @staticmethod
    @entry
    def energy(law: object, w: float) -> float:
        """Energy 1/(2 w^2) of a grain of the first species at the wall, [D, eq. 3.3] [F* D]; w [D]."""
        return 0.5 / (w * w)

    @staticmethod
    @entry
    def stiffness(law: object, w: float) -> float:
        """Minus the slope of the force, 3/w^4, of a grain of the first species [F*/D]; w [D]."""
        w2 = w * w
        return 3.0 / (w2 * w2)

    @staticmethod
    @entry
    def turning_point_stiffness(law: object, speed: float) -> float:
        """Stiffness per mass [1/tau^2] where a grain of this speed [D/tau] turns: 1/(2 w^2) = v^2/2."""
        square = speed * speed
        return 3.0 * square * square
