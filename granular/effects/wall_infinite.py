"""The infinite wall: a half plane of dipoles.

Force on a grain at the distance w: q / w^3 along the normal; energy q / (2 w^2) [D, eq. 3.3].
"""

from __future__ import annotations

from typing import NamedTuple

from granular.compiled import compiled, entry


@entry
def force(w: float) -> float:
    """Force [F*] on a grain of the first species at the distance w [D]."""
    return 1.0 / (w * w * w)


@entry
def energy(w: float) -> float:
    """Energy [F* D] at the distance w [D]."""
    return 0.5 / (w * w)


@entry
def stiffness(w: float) -> float:
    """-d(force)/dw [F*/D] at the distance w [D]."""
    w2 = w * w
    return 3.0 / (w2 * w2)


@entry
def turning_point_stiffness(speed: float) -> float:
    """Stiffness per mass [1/tau^2] where a grain of this speed [D/tau] turns: 1/(2 w^2) = v^2/2."""
    square = speed * speed
    return 3.0 * square * square


class InfiniteWall(NamedTuple):
    """The law as the kernels take it."""

    @staticmethod
    @compiled
    def force(law: InfiniteWall, w: float) -> float:
        return force(w)

    @staticmethod
    @compiled
    def energy(law: InfiniteWall, w: float) -> float:
        return energy(w)

    @staticmethod
    @compiled
    def stiffness(law: InfiniteWall, w: float) -> float:
        return stiffness(w)

    @staticmethod
    @compiled
    def turning_point_stiffness(law: InfiniteWall, speed: float) -> float:
        return turning_point_stiffness(speed)
