"""Choose, among fits to training segments, the one from which the complete records are fitted best.

A law that is wrong for a record may fit the training segment in several ways. The best of these fits may
fail in the rest of the record, and a fit to all samples that starts from this best fit ends in a poor
minimum.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from reduced_models.fitting.levenberg_marquardt import TIE, agreeing_cost_limit, promising_start_mask
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.refinement import (
    BETTER_COST_RATIO,
    COMPARISON_TOLERANCE,
    SearchedStarts,
    SearchResult,
    cost_of_first_samples,
    distinct_vectors,
    refit_over_growing_times,
)

_MAXIMUM_ALTERNATIVES = 4  # fits to the training segments that are compared with the best one
_PREDICTED_RATIO = 4.0
"""A fit to the training segments predicts the rest of the records if the mean squared residual in the rest is
below this multiple of the mean squared residual in the segments."""


def choose_by_whole_records(
    result: SearchResult, coarse: FitProblem, searched: SearchedStarts
) -> SearchResult:
    """Return the given result, or a fit to the training segments that leads to a better complete fit."""
    problem, best = result.problem, result.theta
    counts, lengths = problem.training_sample_counts, [len(data.record) for data in problem.data]
    if list(counts) == lengths or _end_is_predicted(problem, best, lengths):
        return result
    samples = sum(counts)
    order = np.argsort(searched.costs, kind="stable")
    order = order[promising_start_mask(searched.costs, samples)[order]]
    reached = [float(data.record.time[-1]) for data in coarse.data]
    vectors = distinct_vectors([searched.theta[k] for k in order])[: 1 + _MAXIMUM_ALTERNATIVES]
    fits = [
        best,
        *(refit_over_growing_times(problem, theta, reached, COMPARISON_TOLERANCE) for theta in vectors),
    ]
    costs = []
    for theta in fits:
        complete = problem.refit(theta, lengths, tolerance=COMPARISON_TOLERANCE)
        costs.append(cost_of_first_samples(problem, complete, lengths))
    chosen = int(np.argmin(costs))
    if not costs[chosen] < BETTER_COST_RATIO * costs[0]:
        return result
    theta = problem.refit(fits[chosen], counts)
    start = int(np.argmax((searched.theta == vectors[chosen - 1]).all(axis=1)))
    coarse_cost = float(searched.costs[start])
    # Starts with a lower cost have led to the fit that fails in the rest of the records.
    width = agreeing_cost_limit(np.array([coarse_cost]), samples) - coarse_cost
    converged, independent = searched.agreeing_start_and_origin_counts(
        np.abs(searched.costs - coarse_cost) <= width
    )
    return dataclasses.replace(
        result,
        trained=theta,
        theta=theta,
        converged=converged,
        independent=independent,
        cost=cost_of_first_samples(problem, theta, counts),
        coarse_cost=coarse_cost,
        collocation="none",
    )


def _end_is_predicted(problem: FitProblem, theta: np.ndarray, lengths: Sequence[int]) -> bool:
    """Return whether the mean squared residuals inside and outside the training segments are similar."""
    counts = problem.training_sample_counts
    inside = cost_of_first_samples(problem, theta, counts)
    outside = cost_of_first_samples(problem, theta, lengths) - inside
    limit = _PREDICTED_RATIO * inside / sum(counts) + TIE**2
    return outside <= limit * (sum(lengths) - sum(counts))
