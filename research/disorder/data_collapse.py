"""Test whether the data of all kinds of driving collapse on one curve as a function of a quantity.

Curves may be any monotone functions, so only ranks matter. Two figures are given with an interval over runs:
Spearman's rank correlation, and the skill of a curve in predicting a kind of driving to which the curve was
not fitted. Both figures are compared with their values for shuffled data.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

DRAWS = 500
"""Number of resampled and shuffled sets of runs."""

LEVEL = 0.95
MINIMUM_SKILL = 0.5
"""Minimum skill: a curve must explain more than half of the variance of the ranks."""


class FigureWithInterval(NamedTuple):
    """Figure with its interval over runs, and its upper limit for shuffled data.

    Attributes
    ----------
    value : float
    low, high : float
        Interval of `LEVEL` over runs resampled within each kind of driving.
    chance : float
        Upper limit of `LEVEL` of the figures of shuffled data.
    """

    value: float
    low: float
    high: float
    chance: float


class CollapseQuality(NamedTuple):
    """Quality of the order of a quantity by a candidate.

    Attributes
    ----------
    rank : Figure
        Spearman's rank correlation.
    skill : Figure
        Result of `held_out_skill`.
    """

    rank: FigureWithInterval
    skill: FigureWithInterval

    @property
    def orders(self) -> bool:
        """True if the skill's interval lies above chance and above `MINIMUM_SKILL`."""
        return self.skill.low > max(self.skill.chance, MINIMUM_SKILL)


def rank_correlation(x: np.ndarray, y: np.ndarray) -> float:
    """Return Spearman's rank correlation; 0 if x or y is constant."""
    first, second = _ranks_with_ties_averaged(x), _ranks_with_ties_averaged(y)
    first, second = first - first.mean(), second - second.mean()
    size = float(np.sqrt((first**2).sum() * (second**2).sum()))
    return float((first * second).sum()) / size if size > 0.0 else 0.0


def held_out_skill(x: np.ndarray, y: np.ndarray, groups: np.ndarray) -> float:
    """Return 1 - (residual of a rising curve)/(residual of the mean) over held-out groups.

    For each group the curve is the isotonic regression of the ranks of y on x over all other groups, and the
    mean is the mean of the same ranks. The skill is 1 if each group lies on the curve of the others, 0 if the
    curve predicts no better than the mean, below 0 if it predicts worse.

    Parameters
    ----------
    x, y : float (n,)
    groups : int (n,)
        Group of each run; two or more groups.
    """
    ranks = _ranks_with_ties_averaged(y) / len(y)
    left = full = 0.0
    for group in np.unique(groups):
        unseen = groups == group
        curve = isotonic_regression_curve(x[~unseen], ranks[~unseen])
        left += float(((ranks[unseen] - curve(x[unseen])) ** 2).sum())
        full += float(((ranks[unseen] - ranks[~unseen].mean()) ** 2).sum())
    return 1.0 - left / full if full > 0.0 else 0.0


def isotonic_regression_curve(x: np.ndarray, y: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return the isotonic regression of y on x, as a function.

    Equal x have one value. Between two known x it is the mean of their values, independent of the scale of x;
    beyond the range of x it is constant.
    """
    from scipy.optimize import isotonic_regression

    known, index = np.unique(x, return_inverse=True)
    weights = np.bincount(index).astype(float)
    means = np.bincount(index, y) / weights
    levels = isotonic_regression(means, weights=weights).x

    def interpolate_levels(at: np.ndarray) -> np.ndarray:
        below = np.clip(np.searchsorted(known, at, "right") - 1, 0, len(known) - 1)
        above = np.clip(np.searchsorted(known, at, "left"), 0, len(known) - 1)
        return np.asarray(0.5 * (levels[below] + levels[above]))

    return interpolate_levels


def judge_collapse(
    x: np.ndarray, y: np.ndarray, groups: Sequence[str], draws: int = DRAWS, seed: int = 1
) -> CollapseQuality:
    """Return rank correlation and skill with intervals, for y expected to increase with x.

    The same seed draws the same runs for any x and y.

    Parameters
    ----------
    x, y : float (n,)
    groups : sequence of str
        Kind of driving of each run.
    draws : int
    seed : int
    """
    _, owner = np.unique(np.array(groups), return_inverse=True)
    random = np.random.default_rng(seed)
    members = [np.flatnonzero(owner == group) for group in np.unique(owner)]
    again, shuffled = np.zeros((2, draws, 2))
    for k in range(draws):
        drawn = np.concatenate([random.choice(item, len(item)) for item in members])
        again[k] = _rank_correlation_and_held_out_skill(x[drawn], y[drawn], owner[drawn])
        shuffled[k] = _rank_correlation_and_held_out_skill(random.permutation(x), y, owner)
    tail = 0.5 * (1.0 - LEVEL)
    low, high = np.quantile(again, [tail, 1.0 - tail], axis=0)
    chance = np.quantile(shuffled, LEVEL, axis=0)
    figures = [
        FigureWithInterval(*map(float, item))
        for item in zip(_rank_correlation_and_held_out_skill(x, y, owner), low, high, chance, strict=True)
    ]
    return CollapseQuality(*figures)


def _rank_correlation_and_held_out_skill(
    x: np.ndarray, y: np.ndarray, groups: np.ndarray
) -> tuple[float, float]:
    return rank_correlation(x, y), held_out_skill(x, y, groups)


def _ranks_with_ties_averaged(values: np.ndarray) -> np.ndarray:
    """Return ranks, starting from 1; equal values have their mean rank."""
    _, index, number = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(number)
    return np.asarray((last - 0.5 * (number - 1))[index])
