"""A setting, and what it gave: its error with its uncertainty, and its time."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any, NamedTuple

from validation.outside import ORDERS

SURE = 0.95
"""Probability, of one side, with which an error is to lie below its bound."""


class Setting(NamedTuple):
    """How a scene is run.

    Attributes
    ----------
    method : str
        Or the name of an outside reference, one of `validation.outside.ORDERS`.
    dt : float or str
        For an outside reference its tolerance.
    changes : mapping of str to anything
        Changes to the scene, by dotted keys.
    """

    method: str
    dt: float | str
    changes: Mapping[str, Any] = {}

    @property
    def outside(self) -> bool:
        """Whether it is an outside reference."""
        return self.method in ORDERS

    @property
    def fineness(self) -> str:
        """The step, or an outside reference's tolerance, in words."""
        return f"tolerance {self.dt}" if self.outside else str(self.dt)

    @property
    def family(self) -> str:
        """What settings that differ in their step alone have in common."""
        changes = (f"{key.rpartition('.')[2]} {one}" for key, one in self.changes.items())
        return ", ".join([self.method, *changes])


USUAL = ("stormer-verlet", "auto")
"""Method and step that `granular.simulate` takes where nothing is said."""


@cache
def certainty(starts: int) -> float:
    """Standard errors to add to a mean over starts for a bound: two, and more for few starts.

    By Student's distribution, since the scatter is estimated from the same starts; 0 for one start,
    which shows no scatter.
    """
    if starts < 2:
        return 0.0
    from scipy.stats import t as student

    return max(2.0, float(student.ppf(SURE, starts - 1)))


@dataclasses.dataclass(frozen=True)
class Point:
    """What one setting gave.

    Attributes
    ----------
    setting : Setting
    error, seconds : float
        The error, as a mean over starts, and the time of one run; NaN where it failed.
    steps : int
    failure : str or None
        The error's class and message.
    doubt : float
        Standard error of the error; 0 for one start.
    starts : int
        How many it was run from.
    """

    setting: Setting
    error: float
    seconds: float
    steps: int
    failure: str | None = None
    doubt: float = 0.0
    starts: int = 1

    @property
    def failed(self) -> bool:
        return self.failure is not None

    @property
    def bound(self) -> float:
        """What the error is at most, as far as the starts tell."""
        return self.error + certainty(self.starts) * self.doubt

    @property
    def least(self) -> float:
        """What the error is at least."""
        return max(0.0, self.error - certainty(self.starts) * self.doubt)


def cost(point: Point) -> tuple[float, float]:
    """What to sort by for the fastest, and of those the most accurate."""
    return point.seconds, point.error


def families(points: Iterable[Point]) -> dict[str, tuple[Point, ...]]:
    """The points by family, from coarse to fine."""
    found: dict[str, list[Point]] = {}
    for one in points:
        found.setdefault(one.setting.family, []).append(one)
    return {name: tuple(sorted(ones, key=_work)) for name, ones in found.items()}


def _work(point: Point) -> int:
    # What failed is taken for the coarsest: too long a step is why a run fails.
    return point.steps if not point.failed else 0
