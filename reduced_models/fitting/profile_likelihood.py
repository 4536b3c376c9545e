"""Intervals from the profile of the residuals: how far a parameter moves until the fit is bad.

One parameter is held at a value, all the others are fitted again, and the sum of squares rises by
S. Its signed root over the residuals' standard deviation is the profile t; the interval ends where
that is Student's quantile (Bates, Watts 1988, doi:10.1002/9780470316757, section 6.1). Where the
law is linear in the parameter, this is the interval of the linearisation. Where it is not, or where
parameters trade places, or one has a bound, it is not, and the profile is right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from granular.shared.array_types import Float
from reduced_models.fitting.levenberg_marquardt import Bounds, Normal, Prior, levenberg_marquardt
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.uncertainty import Interval, intervals_between, sandwich_covariance

# An entry that may go a factor of a million either way is not bounded by the data.
FAR = math.log(1e6)
_ROUNDS = 16
_CLOSE = 0.001  # of the quantile
_RESOLVED = 1e-3  # of the residuals' variance: changes of the sum of squares that matter
# Factor of the next reach, and of a step along the path: from 1 to the bound `FAR` it takes three.
_GROWTH = 2.5
_ATTEMPTS = 2
_LOST = 0.05  # of the rise at an end: a fit that lacks more does not say that there is one
_ROUNDING = 1e-11
_FIRST = 1.0  # longest first reach: further out, the linearisation is no guide


def profile_intervals(
    problem: FitProblem, theta: Float[np.ndarray, "q"], covariance: Float[np.ndarray, "q q"], quantile: float
) -> list[dict[str, Interval]]:
    """Profile intervals of each record's parameters."""
    # The profile is measured by the variance with which the linearisation has its covariance, so that both
    # agree where the law is linear (profile t: Bates and Watts 1988, ch. 6).
    unknowns = problem.unknowns
    count = len(unknowns.law.parameters)
    entries = sorted({int(entry) for data in problem.data for entry in data.entries[:count]})
    free = np.flatnonzero(~problem.held_entries)
    normal, plain = problem.normal_matrix(theta)[np.ix_(free, free)], np.ones(len(theta))
    plain[free] = np.diag(sandwich_covariance(normal, normal, 1.0))
    variance = np.where(problem.held_entries, 1.0, np.maximum(np.diag(covariance), 1e-300) / plain)
    low, high = profile_interval_ends(problem, theta, entries, covariance, variance, quantile)
    return [intervals_between(unknowns, low[data.entries], high[data.entries]) for data in problem.data]


def profile_interval_ends(
    problem: FitProblem,
    theta: Float[np.ndarray, "p"],
    entries: Sequence[int],
    covariance: Float[np.ndarray, "p p"],
    variance: Float[np.ndarray, "p"],
    quantile: float,
) -> Bounds:
    """Return ends of profile intervals: infinite where the data bound no entry, else NaN."""
    # Both sides of each entry are looked for together: s of them.
    entry = np.repeat(np.array(entries, dtype=int), 2)
    sign = np.tile([-1.0, 1.0], len(entries))
    slack = np.where(
        sign < 0, theta[entry] - problem.edges.low[entry], problem.edges.high[entry] - theta[entry]
    )
    most = np.minimum(np.maximum(slack, 0.0), FAR)
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))[entry]
    reach = np.minimum(np.minimum(quantile * spread, _FIRST), most)
    guide = theta + sign[:, None] * covariance[entry] / spread[:, None] ** 2
    distance = _distance_to_interval_end(
        problem, theta, entry, sign, reach, most, guide, variance[entry], quantile
    )
    # Where the profile does not get there, a bound is the end, or there is none.
    distance = np.where(np.isinf(distance) & (slack < FAR), np.maximum(slack, 0.0), distance)
    low, high = np.full((2, len(theta)), np.nan)
    low[entry[::2]] = theta[entry[::2]] - distance[::2]
    high[entry[::2]] = theta[entry[::2]] + distance[1::2]
    return Bounds(low, high)


def _distance_to_interval_end(
    problem: FitProblem,
    theta: np.ndarray,
    entry: np.ndarray,
    sign: np.ndarray,
    reach: np.ndarray,
    most: np.ndarray,
    guide: np.ndarray,
    variance: np.ndarray,
    quantile: float,
) -> np.ndarray:
    """Distances (s,) at which the profile t is the quantile; infinite where it never is."""
    normal = problem.normal_equations()
    least = float(np.asarray(normal(theta[None])[0])[0])
    near, near_t = np.zeros_like(reach), np.zeros_like(reach)
    far, far_t = np.full_like(reach, np.inf), np.full_like(reach, np.inf)
    done = np.full_like(reach, np.nan)
    done[most <= 0.0] = np.inf
    for _ in range(_ROUNDS):
        start = _vectors_along_path(theta, guide, entry, sign, reach)
        fits, costs, lacking = _refit_with_entry_fixed(
            problem, normal, start, entry, _RESOLVED * float(variance.min())
        )
        least = min(least, float(costs.min()))
        rise = np.sqrt(np.maximum(costs - least, 0.0) / variance)
        done = np.where(np.isnan(done) & (np.abs(rise - quantile) <= _CLOSE * quantile), reach, done)
        inside = rise < quantile
        done = np.where(np.isnan(done) & inside & (reach >= most), np.inf, done)
        lost = (lacking > _LOST * quantile**2 * variance) & (rise < 5.0 * quantile)
        done = np.where(np.isnan(done) & lost & ~inside, np.inf, done)
        guide = np.where(inside[:, None] & (reach > 0.0)[:, None], fits, guide)
        near, near_t = np.where(inside, reach, near), np.where(inside, rise, near_t)
        far, far_t = np.where(inside, far, reach), np.where(inside, far_t, rise)
        if not np.isnan(done).any():
            break
        reach = np.where(
            np.isnan(done), _next_trial_distances(near, near_t, far, far_t, most, quantile), reach
        )
    return np.where(np.isnan(done), reach, done)


def _next_trial_distances(
    near: np.ndarray,
    near_t: np.ndarray,
    far: np.ndarray,
    far_t: np.ndarray,
    most: np.ndarray,
    quantile: float,
) -> np.ndarray:
    """Next distances to try: between two sides of the end, or further out."""
    with np.errstate(all="ignore"):
        fraction = (quantile - near_t) / (far_t - near_t)
        # A blow-up beyond says nothing of the slope on this side: halve then.
        fraction = np.where(far_t > 10.0 * quantile, 0.5, np.clip(fraction, 0.05, 0.95))
        between = near + fraction * (far - near)
        growth = np.clip(quantile / near_t, 1.1, _GROWTH)
    growth = np.where(np.isfinite(growth), growth, _GROWTH)
    return np.where(np.isfinite(far), between, np.minimum(near * growth, most))


def _vectors_along_path(
    theta: np.ndarray, guide: np.ndarray, entry: np.ndarray, sign: np.ndarray, reach: np.ndarray
) -> np.ndarray:
    """Search vectors (s, p) with each side's entry moved, the others along the path to a guide."""
    # The guide is the last good fit: the profile bends little, and a fit beyond the end may have lost the
    # valley.
    rows = np.arange(len(reach))
    moved = sign * (guide[rows, entry] - theta[entry])
    fraction = np.minimum(reach / np.where(moved > 0.0, moved, np.inf), _GROWTH)
    start = np.asarray(theta + fraction[:, None] * (guide - theta))
    start[rows, entry] = theta[entry] + sign * reach
    return start


def _refit_with_entry_fixed(
    problem: FitProblem, normal: Normal, start: np.ndarray, entry: np.ndarray, resolved: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fits (s, p) with one entry held in each, their sums of squares (s,), and what these lack."""
    # A Gauss-Newton step that would still go down by more than `resolved` shows a search that lost its way in
    # a bent valley; it is begun again from there.
    rows = np.arange(len(start))
    low = np.tile(problem.edges.low, (len(start), 1))
    high = np.tile(problem.edges.high, (len(start), 1))
    low[rows, entry] = high[rows, entry] = start[rows, entry]
    size = sum(len(data.record) for data in problem.data)
    free = Prior(np.zeros(start.shape[1]), float(size))
    for _ in range(_ATTEMPTS):
        tolerance = min(1e-6, resolved / float(np.asarray(normal(start)[0]).min()))
        start, costs = levenberg_marquardt(normal, start, free, tolerance, Bounds(low, high))
        _, gradient, matrix = map(np.asarray, normal(start))
        lacking = _gauss_newton_decrease(gradient, matrix, (start > low) & (start < high))
        if (lacking <= 10.0 * resolved).all():
            break
    return start, costs, lacking


def _gauss_newton_decrease(gradient: np.ndarray, matrix: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Decrease of sums of squares (s,) by a Gauss-Newton step of the free entries."""
    result = np.zeros(len(gradient))
    for k, (slope, curvature, moving) in enumerate(zip(gradient, matrix, free, strict=True)):
        inner = curvature[np.ix_(moving, moving)]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(inner), 1e-300))
        strengths, directions = np.linalg.eigh(inner * np.outer(scale, scale))
        parts = directions.T @ (scale * slope[moving])
        sound = strengths > _ROUNDING * strengths[-1]
        result[k] = float((parts[sound] ** 2 / strengths[sound]).sum())
    return result
