"""A record whose zero drifts, as a random walk beside the noise.

What the walk has done so far is followed by exponential smoothing of the residuals, the filter of
Muth (1960, doi:10.2307/2281542), and taken out of the next one; what is left is white where the
walk and the noise are as strong as the filter's gain says, and is what the fit makes small. The
walk starts at zero with the record.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from reduced_models.fitting.refinement import JointRecords
from reduced_models.least_squares.residuals import without_walk

_ROUNDS = 3
_LEAST = 1e-4  # gain: a walk that gains as much as the noise in ten thousand samples


def drifting(
    joint: JointRecords, theta: np.ndarray, counts: Sequence[int]
) -> tuple[JointRecords, np.ndarray]:
    """The same records with the gains that leave least of their residuals, and the fit to them."""
    for _ in range(_ROUNDS):
        gains = [_gain(each) for each in joint.residuals(theta)]
        grids = [
            dataclasses.replace(grid, gain=gain)
            for grid, gain in zip(joint.grids, gains, strict=True)
        ]
        joint = dataclasses.replace(joint, grids=tuple(grids))
        theta = joint.sharpened(theta, counts, tolerance=1e-6)
    return joint, theta


def _gain(residuals: np.ndarray) -> float:
    """The gain with the least squares of what is left."""
    from scipy.optimize import minimize_scalar

    def left(log_gain: float) -> float:
        return float((without_walk(residuals, float(np.exp(log_gain))) ** 2).sum())

    found = minimize_scalar(left, bounds=(np.log(_LEAST), 0.0), method="bounded")
    return float(np.exp(found.x))
