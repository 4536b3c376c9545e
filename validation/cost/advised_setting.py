"""Settings, what they gave, and which to take; when more starts are the only way to a tolerance."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

from granular.run.work_precision import FLOORS, starts_for_tolerance
from validation.external_integrators import ORDERS

SURE = 0.95
"""Probability, of one side, with which an error is to lie below its bound."""


class SolverSettings(NamedTuple):
    """Settings that a scene is run with.

    Attributes
    ----------
    method : str
        Name of a method, or of an outside reference, one of `validation.external_integrators.ORDERS`.
    dt : float or str
        Time step [s], or a rule such as ``"auto"``; for an outside reference its tolerance, without
        unit.
    changes : mapping of str to anything
        Changes to the scene, by dotted keys, as `granular.Scene.replace` takes them.
    """

    method: str
    dt: float | str
    changes: Mapping[str, Any] = {}

    @property
    def is_external(self) -> bool:
        """True where the method is one of `validation.external_integrators.ORDERS`, not the toolkit's."""
        return self.method in ORDERS

    @property
    def fineness(self) -> str:
        """Text of the step (seconds or a rule), or of an outside integrator's tolerance, without unit."""
        return f"tolerance {self.dt}" if self.is_external else str(self.dt)

    @property
    def family(self) -> str:
        """Text of method and changes, which settings that differ in their step alone have in common."""
        changes = (f"{key.rpartition('.')[2]} {change}" for key, change in self.changes.items())
        return ", ".join([self.method, *changes])


USUAL = ("stormer-verlet", "auto")
"""Method and step that `granular.simulate` takes where nothing is said."""


@cache
def confidence_factor(starts: int) -> float:
    """Return the number of standard errors to add to a mean for a one-sided 95 % bound, two at least."""
    # Student's quantile, since the scatter is estimated from the same starts; one start shows none.
    if starts < 2:
        return 0.0
    from scipy.stats import t as student

    return max(2.0, float(student.ppf(SURE, starts - 1)))


@dataclasses.dataclass(frozen=True)
class WorkPrecisionPoint:
    """Error and time of one setting."""

    setting: SolverSettings
    error: float  # mean over the starts; NaN if it failed
    seconds: float  # of one run [s]
    steps: int
    failure: str | None = None
    doubt: float = 0.0  # standard error of the error; 0 for one start
    starts: int = 1
    frequency: float = 0.0  # step times highest frequency, as seen in the runs; 0 for variable steps

    @property
    def has_failed(self) -> bool:
        """True where the run of the setting ended in an error."""
        return self.failure is not None

    @property
    def upper_error_bound(self) -> float:
        """Upper bound of the error, one-sided at 95 % over the starts, in the error's unit."""
        return self.error + confidence_factor(self.starts) * self.doubt

    @property
    def lower_error_bound(self) -> float:
        """Lower bound of the error, one-sided at 95 % over the starts, in the error's unit; 0 at least."""
        return max(0.0, self.error - confidence_factor(self.starts) * self.doubt)


def time_then_error(point: WorkPrecisionPoint) -> tuple[float, float]:
    """Key that sorts by time [s], and settings as fast by their error."""
    return point.seconds, point.error


def group_by_family(points: Iterable[WorkPrecisionPoint]) -> dict[str, tuple[WorkPrecisionPoint, ...]]:
    """Points grouped by method and changes of the scene, from coarse to fine steps."""
    result: dict[str, list[WorkPrecisionPoint]] = {}
    for point in points:
        result.setdefault(point.setting.family, []).append(point)
    # What failed is taken for the coarsest: too long a step is why a run fails.
    for group in result.values():
        group.sort(key=lambda point: 0 if point.has_failed else point.steps)
    return {name: tuple(group) for name, group in result.items()}


class AdvisedSetting(NamedTuple):
    """Advice for a tolerance."""

    tolerance: float
    point: WorkPrecisionPoint | None  # None if no setting reaches the tolerance
    starts: int  # to average over; 1 if a single run is good enough
    floor: float  # scatter of the quantity over the starts

    @property
    def needs_more_starts(self) -> bool:
        """True where the starts scatter by too much for a single run to reach the tolerance."""
        return self.tolerance < FLOORS * self.floor

    @property
    def seconds(self) -> float:
        """Wall time of all the runs together [s]; NaN where no setting is advised."""
        return math.nan if self.point is None else self.starts * self.point.seconds

    def __str__(self) -> str:
        if self.needs_more_starts:
            words = f"any of these: the starts scatter by {self.floor:.2g}"
            if self.point is None:
                return f"{words}, and more of them would show what no setting tried is free of"
            return f"{words}; {self.starts:.3g} starts cost {duration_text(self.seconds)}"
        if self.point is None:
            return "none reaches it"
        return f"{self.point.setting.family}, {self.point.setting.fineness}"


def duration_text(seconds: float) -> str:
    """Text of a duration as it is read: 0.3 s, 12 minutes, 5 days; seconds [s]."""
    sizes = (("years", 3.156e7), ("days", 86400.0), ("hours", 3600.0), ("minutes", 120.0))
    for unit, size in sizes:
        if seconds >= size:
            count = seconds / (60.0 if unit == "minutes" else size)
            return f"{float(f'{count:.2g}'):g} {unit}"
    return f"{seconds:.2g} s"


def advise_setting(points: Iterable[WorkPrecisionPoint], floor: float, tolerance: float) -> AdvisedSetting:
    """Advise the fastest setting for a tolerance, and from how many starts."""
    own = [point for point in points if not point.setting.is_external]
    if tolerance < FLOORS * floor:
        best = min(
            (point for fam in group_by_family(own).values() for point in points_without_clear_error(fam)),
            key=time_then_error,
            default=None,
        )
        return AdvisedSetting(tolerance, best, starts_for_tolerance(floor, tolerance), floor)
    sound = [point for fam in group_by_family(own).values() for point in accurate_points(fam, tolerance)]
    return AdvisedSetting(tolerance, min(sound, key=time_then_error, default=None), 1, floor)


def accurate_points(family: Sequence[WorkPrecisionPoint], tolerance: float) -> list[WorkPrecisionPoint]:
    """Points of a family that are accurate to a tolerance, and not so by luck."""
    # The bound of the error must be within the tolerance, and no point of the family with more steps clearly
    # above it: an error that is small by chance at a long step grows again.
    result = []
    for point in reversed(family):
        if point.has_failed or not point.lower_error_bound <= tolerance:
            break
        if point.upper_error_bound <= tolerance:
            result.append(point)
    return result


def points_without_clear_error(family: Sequence[WorkPrecisionPoint]) -> list[WorkPrecisionPoint]:
    """Points of a family whose errors, and all finer ones', cannot be told from nought."""
    result = []
    for point in reversed(family):
        if point.has_failed or point.lower_error_bound > 0.0:
            break
        result.append(point)
    return result
