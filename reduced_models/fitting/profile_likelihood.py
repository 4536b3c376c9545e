"""Profile-likelihood intervals: how far a parameter can move before the fit becomes significantly worse.

One parameter is held at a value and all others are refitted. The sum of squares then rises by S. The profile
t is sqrt(S) divided by the residuals' standard deviation, with the sign of the parameter's change. The
interval ends at the values for which |t| reaches Student's quantile (Bates, Watts 1988,
doi:10.1002/9780470316757, section 6.1). If the solution is linear in the parameter, this interval equals the
one from the linearisation. Otherwise, or if parameters are strongly correlated or bounded, the two differ,
and the profile is correct.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from granular.shared.array_types import Float
from reduced_models.fitting.levenberg_marquardt import (
    Normal,
    NormalPrior,
    SearchBounds,
    levenberg_marquardt_vectors_and_costs,
)
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.uncertainty import Interval, intervals_between_search_vectors, sandwich_covariance

# An entry that may change by a factor of a million either way is not bounded by the data.
UNBOUNDED_DISTANCE = math.log(1e6)
_ROUNDS = 16
_QUANTILE_TOLERANCE = 0.001  # tolerance of the profile t, as a fraction of the quantile
_COST_RESOLUTION = 1e-3  # resolution of the sum of squares, as a fraction of the residuals' variance
# Maximum ratio of successive distances, and of a step along the path: three steps lead from a distance of 1
# to `UNBOUNDED_DISTANCE`.
_MAXIMUM_GROWTH = 2.5
_ATTEMPTS = 2
_UNCONVERGED_SHARE = 0.05  # fraction of the rise at an end: a fit further from its minimum is no proof
_ROUNDING = 1e-11
_MAXIMUM_FIRST_DISTANCE = 1.0  # maximum first distance: further out, the linearisation is not a guide


def profile_intervals(
    problem: FitProblem, theta: Float[np.ndarray, "q"], covariance: Float[np.ndarray, "q q"], quantile: float
) -> list[dict[str, Interval]]:
    """Return the profile intervals of each record's parameters."""
    # The profile uses the variance that belongs to the covariance of the linearisation, so that both agree
    # for a solution linear in its parameters (profile t: Bates and Watts 1988, ch. 6).
    unknowns = problem.unknowns
    count = len(unknowns.law.parameters)
    entries = sorted({int(entry) for data in problem.data for entry in data.joint_vector_indices[:count]})
    free = np.flatnonzero(~problem.held_entry_mask)
    normal, plain = problem.normal_matrix(theta)[np.ix_(free, free)], np.ones(len(theta))
    plain[free] = np.diag(sandwich_covariance(normal, normal, 1.0))
    variance = np.where(problem.held_entry_mask, 1.0, np.maximum(np.diag(covariance), 1e-300) / plain)
    low, high = profile_interval_ends(problem, theta, entries, covariance, variance, quantile)
    return [
        intervals_between_search_vectors(
            unknowns, low[data.joint_vector_indices], high[data.joint_vector_indices]
        )
        for data in problem.data
    ]


def profile_interval_ends(
    problem: FitProblem,
    theta: Float[np.ndarray, "p"],
    entries: Sequence[int],
    covariance: Float[np.ndarray, "p p"],
    variance: Float[np.ndarray, "p"],
    quantile: float,
) -> SearchBounds:
    """Return interval ends: infinite if neither quantile nor bound is reached, NaN for entries not given."""
    # Both ends of all entries are searched together: s of them.
    entry = np.repeat(np.array(entries, dtype=int), 2)
    sign = np.tile([-1.0, 1.0], len(entries))
    slack = np.where(
        sign < 0,
        theta[entry] - problem.search_bounds.low[entry],
        problem.search_bounds.high[entry] - theta[entry],
    )
    maximum = np.minimum(np.maximum(slack, 0.0), UNBOUNDED_DISTANCE)
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))[entry]
    distances = np.minimum(np.minimum(quantile * spread, _MAXIMUM_FIRST_DISTANCE), maximum)
    guide = theta + sign[:, None] * covariance[entry] / spread[:, None] ** 2
    distance = _distances_to_interval_ends(
        problem, theta, entry, sign, distances, maximum, guide, variance[entry], quantile
    )
    # If the profile does not reach the quantile, the interval ends at the bound, or has no end.
    distance = np.where(np.isinf(distance) & (slack < UNBOUNDED_DISTANCE), np.maximum(slack, 0.0), distance)
    low, high = np.full((2, len(theta)), np.nan)
    low[entry[::2]] = theta[entry[::2]] - distance[::2]
    high[entry[::2]] = theta[entry[::2]] + distance[1::2]
    return SearchBounds(low, high)


def _distances_to_interval_ends(
    problem: FitProblem,
    theta: np.ndarray,
    entry: np.ndarray,
    sign: np.ndarray,
    distances: np.ndarray,
    maximum: np.ndarray,
    guide: np.ndarray,
    variance: np.ndarray,
    quantile: float,
) -> np.ndarray:
    """Return the distances (s,) at which t reaches the quantile; infinite if t stays below."""
    normal = problem.make_normal_equations()
    lowest_cost = float(np.asarray(normal(theta[None])[0])[0])
    near, near_t = np.zeros_like(distances), np.zeros_like(distances)
    far, far_t = np.full_like(distances, np.inf), np.full_like(distances, np.inf)
    end_distances = np.full_like(distances, np.nan)
    end_distances[maximum <= 0.0] = np.inf
    for _ in range(_ROUNDS):
        start = _vectors_along_path(theta, guide, entry, sign, distances)
        fits, costs, decrease = _refits_costs_and_decreases_with_entry_fixed(
            problem, normal, start, entry, _COST_RESOLUTION * float(variance.min())
        )
        lowest_cost = min(lowest_cost, float(costs.min()))
        rise = np.sqrt(np.maximum(costs - lowest_cost, 0.0) / variance)
        end_distances = np.where(
            np.isnan(end_distances) & (np.abs(rise - quantile) <= _QUANTILE_TOLERANCE * quantile),
            distances,
            end_distances,
        )
        inside = rise < quantile
        end_distances = np.where(
            np.isnan(end_distances) & inside & (distances >= maximum), np.inf, end_distances
        )
        unconverged = (decrease > _UNCONVERGED_SHARE * quantile**2 * variance) & (rise < 5.0 * quantile)
        end_distances = np.where(np.isnan(end_distances) & unconverged & ~inside, np.inf, end_distances)
        guide = np.where(inside[:, None] & (distances > 0.0)[:, None], fits, guide)
        near, near_t = np.where(inside, distances, near), np.where(inside, rise, near_t)
        far, far_t = np.where(inside, far, distances), np.where(inside, far_t, rise)
        if not np.isnan(end_distances).any():
            break
        distances = np.where(
            np.isnan(end_distances),
            _next_trial_distances(near, near_t, far, far_t, maximum, quantile),
            distances,
        )
    return np.where(np.isnan(end_distances), distances, end_distances)


def _next_trial_distances(
    near: np.ndarray,
    near_t: np.ndarray,
    far: np.ndarray,
    far_t: np.ndarray,
    maximum: np.ndarray,
    quantile: float,
) -> np.ndarray:
    """Return the next trial distances: between points inside and outside the interval, or further out."""
    with np.errstate(all="ignore"):
        fraction = (quantile - near_t) / (far_t - near_t)
        # If the solution diverges beyond the end, interpolation is meaningless: bisect.
        fraction = np.where(far_t > 10.0 * quantile, 0.5, np.clip(fraction, 0.05, 0.95))
        between = near + fraction * (far - near)
        growth = np.clip(quantile / near_t, 1.1, _MAXIMUM_GROWTH)
    growth = np.where(np.isfinite(growth), growth, _MAXIMUM_GROWTH)
    return np.where(np.isfinite(far), between, np.minimum(near * growth, maximum))


def _vectors_along_path(
    theta: np.ndarray, guide: np.ndarray, entry: np.ndarray, sign: np.ndarray, distances: np.ndarray
) -> np.ndarray:
    """Return start vectors (s, p): one entry moves by a distance, the others linearly towards ``guide``."""
    # The guide is the last good fit, since the path curves little, and a fit beyond the end may have left the
    # minimum's valley.
    rows = np.arange(len(distances))
    moved = sign * (guide[rows, entry] - theta[entry])
    fraction = np.minimum(distances / np.where(moved > 0.0, moved, np.inf), _MAXIMUM_GROWTH)
    start = np.asarray(theta + fraction[:, None] * (guide - theta))
    start[rows, entry] = theta[entry] + sign * distances
    return start


def _refits_costs_and_decreases_with_entry_fixed(
    problem: FitProblem, normal: Normal, start: np.ndarray, entry: np.ndarray, resolved: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Refit with one entry fixed per row; return fits (s, p), costs, and cost decreases by a further step."""
    # If a Gauss-Newton step would still decrease the sum by more than `resolved`, the search has stopped
    # early in a curved valley; it is restarted from there.
    rows = np.arange(len(start))
    low = np.tile(problem.search_bounds.low, (len(start), 1))
    high = np.tile(problem.search_bounds.high, (len(start), 1))
    low[rows, entry] = high[rows, entry] = start[rows, entry]
    size = sum(len(data.record) for data in problem.data)
    free = NormalPrior(np.zeros(start.shape[1]), float(size))
    for _ in range(_ATTEMPTS):
        tolerance = min(1e-6, resolved / float(np.asarray(normal(start)[0]).min()))
        start, costs = levenberg_marquardt_vectors_and_costs(
            normal, start, free, tolerance, SearchBounds(low, high)
        )
        _, gradient, matrix = map(np.asarray, normal(start))
        decrease = _gauss_newton_decrease(gradient, matrix, (start > low) & (start < high))
        if (decrease <= 10.0 * resolved).all():
            break
    return start, costs, decrease


def _gauss_newton_decrease(gradient: np.ndarray, matrix: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return the decrease (s,) of the sum of squares by a Gauss-Newton step of the free entries."""
    result = np.zeros(len(gradient))
    for k, (slope, curvature, moving) in enumerate(zip(gradient, matrix, free, strict=True)):
        inner = curvature[np.ix_(moving, moving)]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(inner), 1e-300))
        strengths, directions = np.linalg.eigh(inner * np.outer(scale, scale))
        parts = directions.T @ (scale * slope[moving])
        sound = strengths > _ROUNDING * strengths[-1]
        result[k] = float((parts[sound] ** 2 / strengths[sound]).sum())
    return result
