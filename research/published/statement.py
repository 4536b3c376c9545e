"""Qualitative statements of de Paula, their tests, and functions shared by tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from research.published.measures import samples_under_common_protocol
from research.published.results import PublishedResults

FULL_PACKING = 0.2409
"""Packing fraction of equal grains at full compression: 368 (pi/4)/(60 20)."""
LEVEL = 0.05
"""Significance level of tests."""


class StatementCheck(NamedTuple):
    """Result of the test of a statement, and its figures."""

    holds: bool
    figures: str


class Statement(NamedTuple):
    """A qualitative statement of de Paula.

    Attributes
    ----------
    source : str
    words : str
    test : callable
        Returns the check, or None if runs are missing.
    """

    source: str
    words: str
    test: Callable[[PublishedResults], StatementCheck | None]

    def check(self, results: PublishedResults) -> StatementCheck | None:
        """Return the outcome of the test, with a plain bool instead of NumPy's."""
        result = self.test(results)
        return None if result is None else result._replace(holds=bool(result.holds))


def packing_fractions_along_stroke(count: int, trajectory: np.ndarray, stretch: float = 1.0) -> np.ndarray:
    """Return the packing fraction at equal steps of the stroke, from initial to final height."""
    size = (count / 368.0) ** 0.5
    start = max(75.0 * size, 50.0)
    heights = np.linspace(start, 20.0 * size, len(trajectory))
    return np.asarray(FULL_PACKING * stretch * 20.0 * size / heights)


def mean_curve_over_starts(results: PublishedResults, name: str, way: str) -> np.ndarray | None:
    """Return the mean over the starts of a figure that is a list."""
    courses = np.array(results.figure_lists_by_start(name, way))
    return courses.mean(axis=0) if courses.ndim == 2 else None


def means_of_figure_in_two_series(
    results: PublishedResults, figure: str, first: str, second: str
) -> tuple[float, float] | None:
    """Return the means of a figure of two series under one protocol."""
    result = samples_under_common_protocol([first, second], figure, results)
    return None if result is None else (result[0].values.mean(), result[1].values.mean())


def force_curves_over_mean_maximum_force(results: PublishedResults, name: str) -> np.ndarray | None:
    """Return the force over the mean maximum force, down and up, of every start."""
    courses = [np.array(results.figure_lists_by_start(name, way)) for way in ("down", "up")]
    if any(item.ndim != 2 for item in courses):
        return None
    trajectory = np.concatenate(courses, axis=1)
    return np.asarray(trajectory / trajectory.max(axis=1).mean())
