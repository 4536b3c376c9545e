"""Intervals by resampling: the sieve bootstrap of the residuals.

What is new in each residual, beside what follows from the ones before it, is drawn with
replacement; the autoregression makes residuals of the draws, which are laid on the fitted motion,
and each such record is fitted again from the fit (Buehlmann 1997, doi:10.2307/3318584). Intervals
are the percentiles of what comes out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from reduced_models.fitting.diagnostics import autoregression
from reduced_models.least_squares.joint_records import JointRecords
from reduced_models.least_squares.residuals import (
    Loss,
    cost_and_weight,
    with_walk,
    without_walk,
)

REPLICATES = 200
_ROUNDS = 10


def replicates(joint: JointRecords, theta: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Search vectors (count, p) fitted to resampled records."""
    random = np.random.default_rng(seed)
    residuals = joint.residuals(theta)
    lengths = [len(each) for each in residuals]
    amplitude = joint.unknowns.amplitude
    # A residual is solution minus data.
    fitted = [
        grid.record.height + each * amplitude
        for grid, each in zip(joint.grids, residuals, strict=True)
    ]
    draws = [
        _resampler(each, grid.gain, grid.loss)
        for each, grid in zip(residuals, joint.grids, strict=True)
    ]
    found = np.empty((count, len(theta)))
    for k in range(count):
        heights = [
            motion - amplitude * draw(random) for motion, draw in zip(fitted, draws, strict=True)
        ]
        grids = tuple(
            grid.with_heights(each) for grid, each in zip(joint.grids, heights, strict=True)
        )
        trial = dataclasses.replace(joint, grids=grids)
        found[k] = trial.refit(theta, lengths, tolerance=1e-6)
    return found


def _resampler(
    residuals: np.ndarray, gain: float, loss: Loss
) -> Callable[[np.random.Generator], np.ndarray]:
    """Draws of residuals that follow each other as these do, about their middle."""
    from scipy.signal import lfilter

    count = len(residuals)
    if gain > 0.0:
        left = without_walk(residuals, gain)
        left = left - middle(left, loss)
        return lambda random: with_walk(random.choice(left, count), gain)
    centred = residuals - middle(residuals, loss)
    series = autoregression(centred)
    new = series.new(centred)
    new = new - middle(new, loss)
    # What comes first has nothing before it: as much again, and more, is drawn and left out.
    ahead = count if len(series.weights) else 0

    def draw(random: np.random.Generator) -> np.ndarray:
        drawn = random.choice(new, count + ahead)
        return np.asarray(lfilter([1.0], series.filter, drawn)[ahead:])

    return draw


def middle(values: np.ndarray, loss: Loss) -> float:
    """Where the loss of values is least, which outliers do not move as they move the mean."""
    found = 0.0
    for _ in range(_ROUNDS):
        _, weight = cost_and_weight(values - found, loss.numbers, np)
        found = float(np.average(values, weights=weight))
    return found
