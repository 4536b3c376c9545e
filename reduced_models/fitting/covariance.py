"""Covariance of a joint search vector: what the data say of fitted parameters.

Residuals that follow each other, because the noise does or because the law is not quite right, say
less of some parameters and more of others than white ones. The covariance is the sandwich estimate
with the autoregression of the residuals between two linearisations (Huber 1967; White 1980,
doi:10.2307/1912934), which holds for the losses that spare outliers too, and for noise that grows with
the speed. A sensor that rounds errs alike while its reading stands: such readings count as one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.residual_diagnostics import (
    autocorrelation_time,
    fit_autoregression,
    gradient_covariance,
)
from reduced_models.fitting.residuals import cost_and_weight, half_cost_curvature
from reduced_models.records.derivatives import rounding_step

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

# Student's quantile of 95 % is 4.3 for two degrees of freedom; one, of residuals that all follow each other,
# would make it 12.7.
LEAST_DOF = 2.0
_AS_NOISY = 1.5  # times the variance of another record
_RESOLVED = 1e-12  # of the greatest strength, a thousand times the rounding of an eigenvalue


class FitStatistics(NamedTuple):
    """Information of the data on a record's search vector, at the minimum of a fit."""

    normal: Float[np.ndarray, "p p"]  # J'J, other records' vectors taken out
    covariance: Float[np.ndarray, "p p"]  # zero for entries that are held
    residuals: tuple[np.ndarray, ...]  # of all records, in amplitudes
    fitted: int  # free entries of the joint search vector
    free: Bool[np.ndarray, "p"]  # entries of the record's vector that are not held
    independent: float  # samples that would say as much of a level if they were white

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom that the residuals have left."""
        return max(1.0, sum(map(len, self.residuals)) - self.fitted)

    @property
    def residual_variance(self) -> float:
        """Variance of a residual, enlarged by how the residuals follow each other."""
        total = sum(
            float((residual**2).sum()) * autocorrelation_time(residual) for residual in self.residuals
        )
        return total / self.degrees_of_freedom

    def student_quantile(self, confidence: float) -> float:
        """Student's quantile, for an interval of that confidence."""
        from scipy.stats import t as student

        dof = min(self.degrees_of_freedom, max(LEAST_DOF, self.independent - 1.0))
        return float(student.ppf(0.5 + 0.5 * confidence, dof))


def joint_covariance(
    problem: FitProblem, theta: Float[np.ndarray, "q"]
) -> tuple[Float[np.ndarray, "q q"], float]:
    """Covariance (q, q) of a search vector, and the number of independent samples."""
    free, size = np.flatnonzero(~problem.held_entries), len(theta)
    bread, spread, variance = np.zeros((size, size)), np.zeros((size, size)), 0.0
    independent = 0.0
    linear = [data.linearised_residuals(theta[data.entries]) for data in problem.data]
    count = sum(len(left) for left, _ in linear)
    inflation = count / max(1, count - len(free))
    alike = _record_variance_weights([left for left, _ in linear])
    for data, (left, slopes), ratio in zip(problem.data, linear, alike, strict=True):
        loss, unit, here = data.loss, data.unknowns.residual_unit, np.ix_(data.entries, data.entries)
        _, weight = cost_and_weight(left, loss.compiled_arguments, np)
        bread[here] += slopes.T @ (half_cost_curvature(left, loss)[:, None] * slopes)
        pull = weight * left
        level = float((pull**2).mean()) * inflation
        if problem.known_noise:
            level = (data.weighted_noise / unit) ** 2
            spread[here] += level * slopes.T @ slopes
            independent += len(left)
        else:
            series, signal = fit_autoregression(pull), data.record.height / unit
            speed = np.gradient(signal + left, data.record.time)
            spread[here] += inflation * ratio * gradient_covariance(slopes, pull, series, speed)
            if data.gain == 0.0:
                spread[here] += standing_reading_covariance(slopes, signal)
            still = float(series.power_spectrum(2)[0]) if level > 0.0 else 0.0
            memory = max(1.0, still / max(level, 1e-300))
            independent += len(left) / memory
            level *= memory
        variance = max(variance, level)
    result = np.zeros((size, size))
    result[np.ix_(free, free)] = sandwich_covariance(
        bread[np.ix_(free, free)], spread[np.ix_(free, free)], variance
    )
    return result, independent


def standing_reading_covariance(
    slopes: Float[np.ndarray, "n p"], reading: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "p p"]:
    """Covariance of a gradient by the common error of equal readings in a row, beyond that of each alone."""
    step = rounding_step(reading)
    starts = np.flatnonzero(np.diff(reading, prepend=np.nan) != 0.0)
    moves = np.sign(np.diff(reading[starts]))
    # A level that is passed from one side to the other has all errors of a step, which cancel.
    stands = np.ones(len(starts), dtype=bool)
    stands[1:-1] = moves[1:] != moves[:-1]
    variance = np.where(stands, step**2 / 12.0, 0.0)
    lengths = np.diff(np.append(starts, len(reading)))
    together = np.add.reduceat(slopes, starts, axis=0)
    apart = np.repeat(variance, lengths)
    return np.asarray((together * variance[:, None]).T @ together - (slopes * apart[:, None]).T @ slopes)


def shifts_by_calibration_errors(
    problem: FitProblem, theta: Float[np.ndarray, "q"]
) -> Float[np.ndarray, "m q"]:
    """Shifts (m, q) of a joint search vector by what sensors' calibrations leave open."""
    # Each independent deviation of one standard uncertainty is laid on the records and moves the linearised
    # fit, so that S'S is their covariance. Those of records that have equally many are of one sensor, and
    # move together.
    size, free = len(theta), np.flatnonzero(~problem.held_entries)
    if not any(data.record.deviations for data in problem.data):
        return np.zeros((0, size))
    matrix = np.zeros((size, size))
    pulls: dict[tuple[int, str, int], np.ndarray] = {}
    for data in problem.data:
        here = data.entries
        left, slopes = data.linearised_residuals(theta[here])
        weighted = half_cost_curvature(left, data.loss)[:, None] * slopes
        matrix[np.ix_(here, here)] += slopes.T @ weighted
        for name, every in data.record.deviations.items():
            for k, deviation in enumerate(every):
                shifted, _ = data.with_column_deviation(name, deviation).linearised_residuals(theta[here])
                pull = pulls.setdefault((len(every), name, k), np.zeros(size))
                pull[here] += weighted.T @ (shifted - left)
    result = np.zeros((len(pulls), size))
    if pulls:
        inverse = np.linalg.pinv(matrix[np.ix_(free, free)], hermitian=True)
        result[:, free] = -np.array(list(pulls.values()))[:, free] @ inverse
    return result


def _record_variance_weights(residuals: Sequence[np.ndarray]) -> np.ndarray:
    """Return common variance over that of each record, where all are as noisy; otherwise ones."""
    levels = np.array([float((left**2).mean()) for left in residuals])
    if levels.min() <= 0.0 or levels.max() > _AS_NOISY * levels.min():
        return np.ones(len(levels))
    counts = np.array([len(left) for left in residuals])
    return np.asarray((levels * counts).sum() / counts.sum() / levels)


def sandwich_covariance(
    bread: Float[np.ndarray, "p p"], spread: Float[np.ndarray, "p p"], variance: float
) -> Float[np.ndarray, "p p"]:
    """Covariance (p, p) from the curvature of the loss and the spread of its gradient, both (p, p)."""
    # Scaled to a unit diagonal first. In directions that the bread hardly holds, the spread is lost
    # in its own rounding, with either sign: they keep the variance of a mean of the residuals, and
    # what is below rounding altogether keeps a huge, finite one.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(bread), 1e-300))
    strengths, directions = np.linalg.eigh(bread * np.outer(scale, scale))
    known = strengths > strengths[-1] * _RESOLVED
    inverse = 1.0 / np.maximum(strengths, strengths[-1] * 1e-15)
    inner = directions.T @ (spread * np.outer(scale, scale)) @ directions
    resolved = np.where(known, inverse, 0.0)
    result = resolved[:, None] * inner * resolved + np.diag(np.where(known, 0.0, variance * inverse))
    return np.asarray((directions @ result @ directions.T) * np.outer(scale, scale))


def marginal_information(
    normal: Float[np.ndarray, "q q"], entries: Int[np.ndarray, "p"], free: Bool[np.ndarray, "q"]
) -> Float[np.ndarray, "p p"]:
    """Information (p, p) on some entries of a search vector, the others that are free left open."""
    others = np.setdiff1d(np.flatnonzero(free), entries)
    if not len(others):
        return normal[np.ix_(entries, entries)]
    cross = normal[np.ix_(entries, others)]
    inner = np.linalg.pinv(normal[np.ix_(others, others)], hermitian=True)
    return np.asarray(normal[np.ix_(entries, entries)] - cross @ inner @ cross.T)
