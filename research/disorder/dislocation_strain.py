"""Fraction of a bed's plastic strain carried by its dislocations: slopes over several cycles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

WINDOW = 2
"""Frames of a row per increment, 0.4 s. With increments of one second or more all starts of a size slip in
the same increments, so that a control with another start does not test anything."""

DRAWS, LEVEL = 2000, 0.95
PARTS: Mapping[str, tuple[str, ...]] = {
    "tracked": ("moves",),
    "with events": ("moves", "events"),
    "to the rim": ("moves", "events", "rim"),
}
"""Contributions of dislocations that are summed."""


class DislocationStrainFraction(NamedTuple):
    """Slope of the dislocations' strain over the strain of the bed.

    Attributes
    ----------
    slope, low, high : float
        Slope of the increments of all starts, through zero, with the interval over starts.
    control : float
        The same with the dislocations of another start, which has the same driving.
    left : float
        Residual fraction of the mean square of the dislocations' increments.
    """

    slope: float
    low: float
    high: float
    control: float
    left: float


def distinct_rows(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return distinct rows only, since different starts may anneal to the same crystal."""
    result = {(row["grains"], tuple(row["plastic"])): row for row in reversed(rows)}
    return list(reversed(result.values()))


def fit_dislocation_strain_fraction(
    rows: Sequence[Mapping[str, Any]],
    parts: Sequence[str],
    of: str = "plastic",
    window: int = WINDOW,
    seed: int = 1,
) -> DislocationStrainFraction:
    """Return the slope over the starts of a size.

    Parameters
    ----------
    rows : sequence of mapping
        Rows of `research.disorder.cycles.simulate_and_measure_cycle`, two or more.
    parts : sequence of str
        Contributions from `PARTS`.
    of : str
        Strain of the bed: ``"plastic"`` or ``"law"``.
    window : int
        Frames of a row per increment.
    seed : int
        Seed of the resampling of starts.
    """
    x = np.array([changes_over_frames(row[of], window) for row in rows])
    y = np.array([sum(changes_over_frames(row[part], window) for part in parts) for row in rows])
    both, square = (x * y).sum(axis=1), (x**2).sum(axis=1)
    slope = both.sum() / square.sum()
    drawn = np.random.default_rng(seed).integers(len(rows), size=(DRAWS, len(rows)))
    slopes = both[drawn].sum(axis=1) / square[drawn].sum(axis=1)
    tail = 0.5 * (1.0 - LEVEL)
    low, high = np.quantile(slopes, [tail, 1.0 - tail])
    others = [(x * np.roll(y, k, axis=0)).sum() / square.sum() for k in range(1, len(rows))]
    full = float((y**2).sum())
    left = float(((y - slope * x) ** 2).sum()) / full if full > 0.0 else 1.0
    return DislocationStrainFraction(float(slope), float(low), float(high), float(np.mean(others)), left)


def changes_over_frames(series: Sequence[float], window: int = WINDOW) -> np.ndarray:
    """Return the changes over a number of frames."""
    return np.diff(np.asarray(series, dtype=float)[::window])
