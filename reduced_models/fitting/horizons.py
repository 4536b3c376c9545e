"""Records as a search sees them: means on coarse grids, of horizons that double."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from reduced_models.fitting.case import Case, Data
from reduced_models.fitting.joint_vector import JointVector, joint_normal
from reduced_models.least_squares.levenberg_marquardt import Normal, Prior
from reduced_models.least_squares.residuals import residual_functions
from reduced_models.least_squares.samples import (
    Samples,
    grid_over,
    means_on_grid,
    samples_on_grid,
)
from reduced_models.least_squares.unknowns import Unknowns
from reduced_models.records.inputs import driving

FIRST_SWINGS = 2.0
COARSE_STEPS = 16
"""Grid steps of a period: the phase error of a period is then 4e-6."""
_MOST_COARSE = 2**13  # steps over which all starts are followed; behind them, the best one
_THIN = 2.0  # samples a coarse step, above which their means are fitted


class Coarse(NamedTuple):
    """A record's means on a coarse grid, over the part of it that all starts follow."""

    data: Data
    means: Samples
    end: float


def coarse_record(unknowns: Unknowns, case: Case, data: Data) -> Coarse:
    """Means of a training stretch, or of its first part, on a coarse grid."""
    training, law = data.training, unknowns.law
    wanted = law.resolution * COARSE_STEPS
    period = data.guess.shortest_period
    grid = grid_over(training, law.inputs, period, wanted, case.interpolation)
    if grid.steps > _MOST_COARSE:
        count = int(np.searchsorted(training.time, grid.step * _MOST_COARSE, side="right"))
        training = training.first(count)
        grid = grid_over(training, law.inputs, period, wanted, case.interpolation)
    weights = data.weights[: len(training)]
    end = float(training.time[-1])
    if driving(law.inputs) or len(training) > _THIN * grid.steps:
        means = means_on_grid(training, grid, law.inputs, case.interpolation, weights)
        return Coarse(data, means, end)
    # A mean of few samples is moved to its grid point by the slope between them, which is off
    # where they are far apart: by as much as the noise, which the doubling does not survive.
    samples = samples_on_grid(training, grid, law.inputs, case.interpolation)
    padded = np.zeros_like(samples.weight)
    padded[: len(training)] = weights
    return Coarse(data, samples.weighted(padded), end)


def coarse_normal(
    unknowns: Unknowns,
    vector: JointVector,
    case: Case,
    coarse: Sequence[Coarse],
    swings: float,
) -> tuple[Normal, Prior]:
    """The normal equations of the first swings, and the prior about the starts."""
    normals, total = [], 0.0
    for data, means, _ in coarse:
        seen = means.step * (means.place + means.share) <= swings * data.guess.quickest
        weight = means.weight * seen
        total += float((weight**2).sum())
        loss = case.loss_of(data, unknowns.amplitude)
        seen_means = means.weighted(weight)
        normals.append(residual_functions(unknowns).of(seen_means, unknowns.scales, loss))
    return joint_normal(normals, vector), Prior(vector.joined(unknowns.prior), total)


def horizons(coarse: Sequence[Coarse]) -> Iterator[float]:
    """Swings that a search sees one after the other; infinitely many are all of them."""
    most = max(one.end / one.data.guess.quickest for one in coarse)
    swings = FIRST_SWINGS
    while swings < most:
        yield swings
        swings *= 2.0
    yield math.inf
