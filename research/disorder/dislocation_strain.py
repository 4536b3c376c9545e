"""How much of a bed's plastic strain its dislocations carry: slopes over several cycles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

WINDOW = 2
"""Kept frames from one increment to the next: 0.4 s. Over a second and more all starts of a size
slip in the same increments, and the control tells nothing."""

DRAWS, LEVEL = 2000, 0.95
PARTS: Mapping[str, tuple[str, ...]] = {
    "tracked": ("moves",),
    "with events": ("moves", "events"),
    "to the rim": ("moves", "events", "rim"),
}
"""What is added up of the dislocations."""


class Carried(NamedTuple):
    """Slope of the strain by dislocations over that of the bed.

    Attributes
    ----------
    slope, low, high : float
        Of the increments of all starts, through zero, with the interval over starts.
    control : float
        The same with the dislocations of another start: both are driven alike.
    left : float
        Fraction of the variance of the dislocations' increments about zero that the line leaves.
    """

    slope: float
    low: float
    high: float
    control: float
    left: float


def distinct(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """One row of all that are alike: different starts may anneal to the same crystal."""
    result = {(row["grains"], tuple(row["plastic"])): row for row in reversed(rows)}
    return list(reversed(result.values()))


def carried(
    rows: Sequence[Mapping[str, Any]],
    parts: Sequence[str],
    of: str = "plastic",
    window: int = WINDOW,
    seed: int = 1,
) -> Carried:
    """The slope over the starts of a size.

    Parameters
    ----------
    rows : sequence of mapping
        Of `research.disorder.cycles.cycle_row`; two at least.
    parts : sequence of str
        Of `PARTS`.
    of : str
        ``"plastic"`` or ``"law"``.
    window : int
        Kept frames from one increment to the next.
    seed : int
        Of the starts that are drawn again.
    """
    x = np.array([increments(row[of], window) for row in rows])
    y = np.array([sum(increments(row[part], window) for part in parts) for row in rows])
    both, square = (x * y).sum(axis=1), (x**2).sum(axis=1)
    slope = both.sum() / square.sum()
    drawn = np.random.default_rng(seed).integers(len(rows), size=(DRAWS, len(rows)))
    slopes = both[drawn].sum(axis=1) / square[drawn].sum(axis=1)
    tail = 0.5 * (1.0 - LEVEL)
    low, high = np.quantile(slopes, [tail, 1.0 - tail])
    others = [(x * np.roll(y, k, axis=0)).sum() / square.sum() for k in range(1, len(rows))]
    full = float((y**2).sum())
    left = float(((y - slope * x) ** 2).sum()) / full if full > 0.0 else 1.0
    return Carried(float(slope), float(low), float(high), float(np.mean(others)), left)


def increments(series: Sequence[float], window: int = WINDOW) -> np.ndarray:
    """Changes over so many kept frames."""
    return np.diff(np.asarray(series, dtype=float)[::window])
