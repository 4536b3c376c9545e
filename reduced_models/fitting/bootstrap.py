"""Intervals by resampling: the moving-block bootstrap of the residuals.

Blocks of the residuals, which keep how they follow each other, are drawn with replacement and laid
on the fitted motion; each such record is fitted again from the fit (Kuensch 1989,
doi:10.1214/aos/1176347265). Intervals are the percentiles of what comes out.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from reduced_models.fitting.refinement import JointRecords
from reduced_models.fitting.uncertainty import autocorrelation_time

REPLICATES = 200
_BLOCK = 4.0  # in autocorrelation times


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
    draws = [_resampler(each) for each in residuals]
    found = np.empty((count, len(theta)))
    for k in range(count):
        heights = [
            motion - amplitude * draw(random) for motion, draw in zip(fitted, draws, strict=True)
        ]
        grids = tuple(
            grid.with_heights(each) for grid, each in zip(joint.grids, heights, strict=True)
        )
        trial = dataclasses.replace(joint, grids=grids)
        found[k] = trial.sharpened(theta, lengths, tolerance=1e-6)
    return found


def _resampler(residuals: np.ndarray) -> Callable[[np.random.Generator], np.ndarray]:
    """Draws of residuals in blocks, about their mean."""
    count = len(residuals)
    block = min(count, math.ceil(_BLOCK * autocorrelation_time(residuals)))
    centred = residuals - residuals.mean()
    inside = np.arange(block)

    def draw(random: np.random.Generator) -> np.ndarray:
        starts = random.integers(0, count - block + 1, -(-count // block))
        return np.asarray(centred[(starts[:, None] + inside).ravel()[:count]])

    return draw
