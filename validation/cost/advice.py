"""Which setting to take for a tolerance, and when more starts are the only way to it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from validation.cost.point import Point, cost, families

FLOORS = 3.0
"""A tolerance of fewer floors than this cannot be met by one run of any setting: three standard
deviations hold all but one start in four hundred."""


class Advice(NamedTuple):
    """What to do for a tolerance.

    Attributes
    ----------
    tolerance : float
    point : Point or None
        The setting to take; None where none that was tried reaches the tolerance.
    starts : int
        How many starts to average over; 1 where a single run is good enough.
    floor : float
        Scatter of the quantity over the starts.
    """

    tolerance: float
    point: Point | None
    starts: int
    floor: float

    @property
    def below_floor(self) -> bool:
        """Whether the starts scatter by too much for a single run."""
        return self.tolerance < FLOORS * self.floor

    @property
    def seconds(self) -> float:
        """Time of all the runs; NaN where no setting is advised."""
        return math.nan if self.point is None else self.starts * self.point.seconds

    def __str__(self) -> str:
        if self.below_floor:
            words = f"any of these: the starts scatter by {self.floor:.2g}"
            if self.point is None:
                return f"{words}, and more of them would show what no setting tried is free of"
            return f"{words}; {self.starts:.3g} starts cost {duration(self.seconds)}"
        if self.point is None:
            return "none reaches it"
        return f"{self.point.setting.family}, {self.point.setting.fineness}"


def duration(seconds: float) -> str:
    """A time as it is read: 0.3 s, 12 minutes, 5 days."""
    sizes = (("years", 3.156e7), ("days", 86400.0), ("hours", 3600.0), ("minutes", 120.0))
    for unit, size in sizes:
        if seconds >= size:
            return f"{seconds / (60.0 if unit == 'minutes' else size):.2g} {unit}"
    return f"{seconds:.2g} s"


def starts_for(floor: float, tolerance: float) -> int:
    """How many starts to average over for two standard errors of their mean to be a tolerance."""
    return max(1, math.ceil((2.0 * floor / tolerance) ** 2))


def advice(points: Iterable[Point], floor: float, tolerance: float) -> Advice:
    """What to do for a tolerance.

    Below `FLOORS` floors the fastest setting whose error cannot be told from nought is named, and
    how many starts it takes; otherwise the fastest one that `holding` names.
    """
    own = [one for one in points if not one.setting.outside]
    if tolerance < FLOORS * floor:
        best = min((one for fam in families(own).values() for one in unbiased(fam)),
                   key=cost, default=None)  # fmt: skip
        return Advice(tolerance, best, starts_for(floor, tolerance), floor)
    sound = [one for fam in families(own).values() for one in holding(fam, tolerance)]
    return Advice(tolerance, min(sound, key=cost, default=None), 1, floor)


def holding(family: Sequence[Point], tolerance: float) -> list[Point]:
    """The points of a family that are accurate to a tolerance, and not so by luck.

    The error's bound must be within the tolerance, and no point of the family with more steps may
    be clearly above it.
    """
    found = []
    for one in reversed(family):
        if one.failed or not one.least <= tolerance:
            break
        if one.bound <= tolerance:
            found.append(one)
    return found


def unbiased(family: Sequence[Point]) -> list[Point]:
    """The points of a family whose errors, and all finer ones', cannot be told from nought."""
    found = []
    for one in reversed(family):
        if one.failed or one.least > 0.0:
            break
        found.append(one)
    return found
