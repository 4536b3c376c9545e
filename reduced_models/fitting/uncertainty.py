"""Intervals of fitted parameters, and directions in parameter space that the data do not determine.

Intervals come from the covariance at the minimum. The Fisher information, in
which a residual's variance is multiplied by the integrated autocorrelation time, decides which directions
are undetermined.

With correlated residuals (from correlated noise or an inexact law) some parameters are less precise, others
more precise, than with white residuals. The covariance is a sandwich estimate: the gradient's covariance,
from the autoregression of the residuals, multiplied from both sides by the inverse curvature (Huber 1967;
White 1980, doi:10.2307/1912934). The estimate also holds for robust losses and for noise that grows with
the speed. The rounding error of a sensor stays the same while its reading is constant, so equal
successive readings count as one reading.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from granular.shared.array_types import Bool, Float, Int
from reduced_models.fitting.parameter import SearchUnknowns
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.residual_diagnostics import (
    autocorrelation_time,
    fit_autoregression,
    gradient_covariance,
)
from reduced_models.fitting.residuals import half_cost_curvature, residual_costs_and_weights
from reduced_models.laws.linearization import (
    FORCE_JUMPS,
    NoOscillationReason,
    compile_dry_friction_coefficient,
    make_rates_of_law,
    small_oscillation,
    solve_harmonic_balance,
)
from reduced_models.models.at_rest import AtRest, EquivalentDamping
from reduced_models.models.quantities import ParameterDirection
from reduced_models.records.derivatives import sensor_rounding_step

# Student's quantile at 95 % is 4.3 for two degrees of freedom; fully correlated residuals would give one
# degree and 12.7.
MINIMUM_DEGREES_OF_FREEDOM = 2.0
_EQUAL_NOISE_RATIO = 1.5  # maximum ratio of the variances of records that count as equally noisy
_RESOLVED_STRENGTH = 1e-12  # fraction of the largest eigenvalue, a thousand times its rounding error


class FitStatistics(NamedTuple):
    """Statistics at the minimum of a fit, from which a record's intervals are computed."""

    normal: Float[np.ndarray, "p p"]  # J'J, marginalised over the other records' entries
    covariance: Float[np.ndarray, "p p"]  # zero for entries that are held
    residuals: tuple[np.ndarray, ...]  # residuals of all records, in amplitudes, without drift
    fitted: int  # number of free entries of the joint search vector
    free: Bool[np.ndarray, "p"]  # entries of the record's vector that are not held
    independent: float  # number of white samples that would determine a mean equally well

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom of the residuals."""
        return max(1.0, sum(map(len, self.residuals)) - self.fitted)

    @property
    def residual_variance(self) -> float:
        """Variance of a residual, multiplied by the residuals' autocorrelation time."""
        total = sum(
            float((residual**2).sum()) * autocorrelation_time(residual) for residual in self.residuals
        )
        return total / self.degrees_of_freedom

    def student_quantile(self, confidence: float) -> float:
        """Return Student's quantile for a two-sided interval of a confidence level."""
        from scipy.stats import t as student

        dof = min(self.degrees_of_freedom, max(MINIMUM_DEGREES_OF_FREEDOM, self.independent - 1.0))
        return float(student.ppf(0.5 + 0.5 * confidence, dof))


def joint_covariance_and_independent_count(
    problem: FitProblem, theta: Float[np.ndarray, "q"]
) -> tuple[Float[np.ndarray, "q q"], float]:
    """Return the covariance (q, q) of a search vector, and the number of independent samples."""
    free, size = np.flatnonzero(~problem.held_entry_mask), len(theta)
    bread, spread, variance = np.zeros((size, size)), np.zeros((size, size)), 0.0
    independent = 0.0
    linear = [
        data.weighted_residuals_and_derivatives(theta[data.joint_vector_indices]) for data in problem.data
    ]
    count = sum(len(left) for left, _ in linear)
    inflation = count / max(1, count - len(free))
    variance_weights = _variance_weights_of_records([left for left, _ in linear])
    for data, (left, slopes), ratio in zip(problem.data, linear, variance_weights, strict=True):
        loss, unit, here = (
            data.loss,
            data.unknowns.residual_unit,
            np.ix_(data.joint_vector_indices, data.joint_vector_indices),
        )
        _, weight = residual_costs_and_weights(left, loss.compiled_arguments, np)
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
                spread[here] += covariance_by_rounding_errors(slopes, signal)
            zero_frequency_power = float(series.power_spectrum(2)[0]) if level > 0.0 else 0.0
            correlation_factor = max(1.0, zero_frequency_power / max(level, 1e-300))
            independent += len(left) / correlation_factor
            level *= correlation_factor
        variance = max(variance, level)
    result = np.zeros((size, size))
    result[np.ix_(free, free)] = sandwich_covariance(
        bread[np.ix_(free, free)], spread[np.ix_(free, free)], variance
    )
    return result, independent


def covariance_by_rounding_errors(
    slopes: Float[np.ndarray, "n p"], reading: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "p p"]:
    """Return the part of a gradient's covariance due to the common rounding error of equal readings."""
    step = sensor_rounding_step(reading)
    starts = np.flatnonzero(np.diff(reading, prepend=np.nan) != 0.0)
    moves = np.sign(np.diff(reading[starts]))
    # While a reading passes through a step from one side to the other, it takes all rounding errors, which
    # cancel.
    stands = np.ones(len(starts), dtype=bool)
    stands[1:-1] = moves[1:] != moves[:-1]
    variance = np.where(stands, step**2 / 12.0, 0.0)
    lengths = np.diff(np.append(starts, len(reading)))
    together = np.add.reduceat(slopes, starts, axis=0)
    apart = np.repeat(variance, lengths)
    return np.asarray((together * variance[:, None]).T @ together - (slopes * apart[:, None]).T @ slopes)


def search_vector_shifts_by_calibration_errors(
    problem: FitProblem, theta: Float[np.ndarray, "q"]
) -> Float[np.ndarray, "m q"]:
    """Return shifts S (m, q) of a joint search vector due to the sensors' calibration uncertainty."""
    # Each independent deviation of one standard uncertainty is added to the records and shifts the linearised
    # fit, so that S'S is their covariance. Records with the same number of deviations share a sensor, and
    # their deviations move together.
    size, free = len(theta), np.flatnonzero(~problem.held_entry_mask)
    if not any(data.record.deviations for data in problem.data):
        return np.zeros((0, size))
    matrix = np.zeros((size, size))
    pulls: dict[tuple[int, str, int], np.ndarray] = {}
    for data in problem.data:
        here = data.joint_vector_indices
        left, slopes = data.weighted_residuals_and_derivatives(theta[here])
        weighted = half_cost_curvature(left, data.loss)[:, None] * slopes
        matrix[np.ix_(here, here)] += slopes.T @ weighted
        for name, every in data.record.deviations.items():
            for k, deviation in enumerate(every):
                shifted, _ = data.with_column_shifted_by(name, deviation).weighted_residuals_and_derivatives(
                    theta[here]
                )
                pull = pulls.setdefault((len(every), name, k), np.zeros(size))
                pull[here] += weighted.T @ (shifted - left)
    result = np.zeros((len(pulls), size))
    if pulls:
        inverse = np.linalg.pinv(matrix[np.ix_(free, free)], hermitian=True)
        result[:, free] = -np.array(list(pulls.values()))[:, free] @ inverse
    return result


def _variance_weights_of_records(residuals: Sequence[np.ndarray]) -> np.ndarray:
    """Return each record's weight: mean variance / its variance, or 1 if the variances differ strongly."""
    levels = np.array([float((left**2).mean()) for left in residuals])
    if levels.min() <= 0.0 or levels.max() > _EQUAL_NOISE_RATIO * levels.min():
        return np.ones(len(levels))
    counts = np.array([len(left) for left in residuals])
    return np.asarray((levels * counts).sum() / counts.sum() / levels)


def sandwich_covariance(
    bread: Float[np.ndarray, "p p"], spread: Float[np.ndarray, "p p"], variance: float
) -> Float[np.ndarray, "p p"]:
    """Return the covariance, given curvature (bread) and gradient covariance (spread) of the loss."""
    # Both are first scaled to a unit diagonal. In directions of very small curvature the gradient's
    # covariance is rounding error, of either sign: there the variance of the residuals' mean is used.
    # Directions below rounding altogether get a huge but finite variance.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(bread), 1e-300))
    strengths, directions = np.linalg.eigh(bread * np.outer(scale, scale))
    known = strengths > strengths[-1] * _RESOLVED_STRENGTH
    inverse = 1.0 / np.maximum(strengths, strengths[-1] * 1e-15)
    inner = directions.T @ (spread * np.outer(scale, scale)) @ directions
    resolved = np.where(known, inverse, 0.0)
    result = resolved[:, None] * inner * resolved + np.diag(np.where(known, 0.0, variance * inverse))
    return np.asarray((directions @ result @ directions.T) * np.outer(scale, scale))


def marginal_information(
    normal: Float[np.ndarray, "q q"], entries: Int[np.ndarray, "p"], free: Bool[np.ndarray, "q"]
) -> Float[np.ndarray, "p p"]:
    """Return the information (p, p) on some entries of a search vector, marginalised over the rest."""
    others = np.setdiff1d(np.flatnonzero(free), entries)
    if not len(others):
        return normal[np.ix_(entries, entries)]
    cross = normal[np.ix_(entries, others)]
    inner = np.linalg.pinv(normal[np.ix_(others, others)], hermitian=True)
    return np.asarray(normal[np.ix_(entries, entries)] - cross @ inner @ cross.T)


Interval = tuple[float, float]  # low, high, in the SI unit of the quantity

# Standard error of the logarithm above which a direction is undetermined: 28 % either way.
OPEN = 0.25
AMPLITUDE_FRACTIONS = (0.5, 0.1)
"""Amplitudes at which the equivalent damping is computed, as fractions of the maximum displacement."""
DAMPING_DIFFERENCE = 0.5
"""Fraction of the larger of two damping ratios, for small oscillations and at a tenth of the maximum
displacement. If the ratios differ by more, an equivalent damping ratio is reported."""
_NO_DAMPING = 1e-6
_SMALL_POWER = 0.05
# In units of the entry: a smaller value cannot serve as the scale of its error.
_NEAR_ZERO = 0.25
_UNBOUNDED = math.log(1e6)  # half-width of a logarithmic interval above which it is unbounded
_ROUNDING = 1e-9  # fraction of the amplitude: an equilibrium nearer to 0 is 0
# Undetermined variances stay finite, so that a covariance times derivatives has no NaN.
_MAXIMUM_VARIANCE = 1e99


def intervals_oscillation_and_directions(
    unknowns: SearchUnknowns,
    theta: Float[np.ndarray, "p"],
    known: FitStatistics,
    quantile: float,
    seen: tuple[float, float],
    shifts: Float[np.ndarray, "m p"],
) -> tuple[dict[str, Interval], AtRest | NoOscillationReason, tuple[ParameterDirection, ...]]:
    """Return intervals, small oscillation and undetermined directions; ``seen`` is the motion's range [m]."""
    names, intervals = unknowns.law.parameters, {}
    for k, name in enumerate(names):
        spread = quantile * math.sqrt(max(known.covariance[k, k], 0.0))
        intervals[name] = _parameter_confidence_interval(float(theta[k]), spread, unknowns, k)
    information = _fisher_information(unknowns, theta, known)
    open_names = [name for name, free in zip(names, known.free, strict=False) if free]
    at_rest = _small_motion_with_intervals(unknowns, theta, known.covariance, quantile, seen, shifts)
    # The zero of heights is arbitrary: a height may be smaller than its error and still be determined.
    heights = unknowns.law.parsed_equation.height_parameters
    directions = [
        direction
        for direction in undetermined_directions(open_names, information)
        if direction.is_undetermined or not heights.issuperset(direction.powers)
    ]
    return intervals, at_rest, tuple(directions)


def widen_to_linear_intervals(
    linear: Mapping[str, Interval],
    undetermined: Sequence[ParameterDirection],
    intervals: Mapping[str, Interval],
) -> dict[str, Interval]:
    """Widen profile intervals to the linear ones, for parameters in undetermined directions."""
    # Along undetermined directions the prior limits a profile.
    left_open = {name for direction in undetermined if direction.is_undetermined for name in direction.powers}
    return {
        name: ((min(low, linear[name][0]), max(high, linear[name][1])) if name in left_open else (low, high))
        for name, (low, high) in intervals.items()
    }


def intervals_between_search_vectors(
    unknowns: SearchUnknowns, low: Float[np.ndarray, "p"], high: Float[np.ndarray, "p"]
) -> dict[str, Interval]:
    """Return each parameter's interval between its values in two search vectors (p,)."""
    return {
        name: (
            _parameter_confidence_interval(float(low[k]), 0.0, unknowns, k)[0],
            _parameter_confidence_interval(float(high[k]), 0.0, unknowns, k)[1],
        )
        for k, name in enumerate(unknowns.law.parameters)
    }


def _parameter_confidence_interval(
    value: float, spread: float, unknowns: SearchUnknowns, k: int
) -> tuple[float, float]:
    if unknowns.parameters_are_logarithmic[k]:
        if spread > _UNBOUNDED:
            return 0.0, math.inf
        return math.exp(value - spread), math.exp(value + spread)
    unit = unknowns.units[k]
    return unit * (value - spread), unit * (value + spread)


def _fisher_information(unknowns: SearchUnknowns, theta: np.ndarray, known: FitStatistics) -> np.ndarray:
    """Return the Fisher information on logarithms of free parameters, marginalised over the initial state."""
    logs = np.array(unknowns.parameters_are_logarithmic)
    values = theta[: len(logs)]
    # Relative to a value near zero an error has no meaning, so it is taken relative to the unit.
    relative = np.where(logs | (np.abs(values) <= _NEAR_ZERO), 1.0, values)
    free_parameters = np.flatnonzero(known.free[: len(logs)])
    left, relative = (
        marginal_information(known.normal, free_parameters, known.free),
        relative[free_parameters],
    )
    return np.asarray(left * np.outer(relative, relative)) / max(known.residual_variance, 1e-300)


def physical_covariance(
    unknowns: SearchUnknowns, theta: Float[np.ndarray, "p"], covariance: Float[np.ndarray, "p p"]
) -> tuple[tuple[str, ...], Float[np.ndarray, "k k"]]:
    """Return names and covariance (k, k), in SI units, of a record's parameters and initial state."""
    names, logs = unknowns.law.parameters, unknowns.parameters_are_logarithmic
    units = [
        unit * (math.exp(min(value, 700.0)) if log else 1.0)
        for unit, value, log in zip(unknowns.units, theta[: len(names)], logs, strict=True)
    ]
    hidden = unknowns.law.hidden
    units += [unknowns.amplitude, unknowns.speed, *(1.0 for _ in hidden)]
    covariance = covariance[: len(units), : len(units)]
    result = np.clip(covariance * np.outer(units, units), -_MAXIMUM_VARIANCE, _MAXIMUM_VARIANCE)
    return (*names, "height", "velocity", *hidden), result


def undetermined_directions(
    names: Sequence[str], information: Float[np.ndarray, "p p"]
) -> tuple[ParameterDirection, ...]:
    """Return directions not determined by an information matrix (p, p) of logarithmic parameters."""
    if not len(information):
        return ()
    strengths, directions = np.linalg.eigh(information)
    result = []
    for strength, direction in zip(strengths, directions.T, strict=True):
        spread = 1.0 / math.sqrt(max(float(strength), 1e-30))
        if spread <= OPEN:
            continue
        powers = direction / direction[np.argmax(np.abs(direction))]
        moving = {
            name: float(power) for name, power in zip(names, powers, strict=True) if abs(power) > _SMALL_POWER
        }
        largest = float(np.abs(direction).max())
        result.append(ParameterDirection(moving, min(spread * largest, 1e6)))
    return tuple(result)


def _small_motion_with_intervals(
    unknowns: SearchUnknowns,
    theta: np.ndarray,
    covariance: np.ndarray,
    quantile: float,
    edges: tuple[float, float],
    shifts: np.ndarray,
) -> AtRest | NoOscillationReason:
    """Return equilibrium, period and damping ratio of small oscillations, with linearised intervals."""
    figures = rest_height_period_and_damping(unknowns, theta)
    if isinstance(figures, NoOscillationReason):
        return figures
    if abs(figures[0] - unknowns.rest) > 2.0 * unknowns.amplitude:
        return NoOscillationReason(f"the equilibrium, {figures[0]:.4g} m, lies far outside the record")
    sizes = np.array(AMPLITUDE_FRACTIONS) * max(abs(edge - figures[0]) for edge in edges)
    equivalent = False
    if (
        not unknowns.law.other_coordinates
    ):  # with several coordinates, the motion is not a harmonic cycle of one
        seen = _damping_and_friction_at_two_amplitudes(unknowns, theta[:, None], figures[:, None], sizes)
        small, tenth = figures[2], seen[1, 0]
        far = max(DAMPING_DIFFERENCE * max(abs(small), abs(tenth)), _NO_DAMPING)
        # The damping ratio of small oscillations is far from the ratio at observed amplitudes.
        equivalent = np.isfinite(seen).all() and (not math.isfinite(small) or abs(tenth - small) > far)
    if not (equivalent or math.isfinite(figures[2])):
        return FORCE_JUMPS
    step = 1e-6 * np.maximum(1.0, np.abs(theta))
    thetas = theta[:, None] + np.hstack([np.diag(step), -np.diag(step)])
    moved = []
    for shifted in thetas.T:
        motion = rest_height_period_and_damping(unknowns, shifted)
        if isinstance(motion, NoOscillationReason):
            return motion
        moved.append(motion)
    around = np.transpose(moved)
    if equivalent:
        figures = np.append(figures[:2], seen[:, 0])
        around = np.vstack(
            [around[:2], _damping_and_friction_at_two_amplitudes(unknowns, thetas, around, sizes)]
        )
    slope = (around[:, : len(theta)] - around[:, len(theta) :]) / (2.0 * step)
    spread = quantile * np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slope, covariance, slope), 0.0))
    intervals = [
        (float(figure - width), float(figure + width)) for figure, width in zip(figures, spread, strict=True)
    ]
    others = None
    if equivalent:
        others = EquivalentDamping(
            amplitude=float(sizes[0]),
            tenth_ratio=float(figures[3]),
            friction=float(figures[4]),
            own=compile_dry_friction_coefficient(unknowns.law.equation, unknowns.law.inputs) is not None,
            intervals=dict(zip(("tenth_ratio", "friction"), intervals[3:], strict=True)),
        )
    height, period, ratio = map(float, figures[:3])
    names = ("height", "period", "damping_ratio")
    moved_by = quantile * np.linalg.norm(slope[:3] @ shifts.T, axis=1)
    return AtRest(
        height,
        period,
        ratio,
        dict(zip(names, intervals[:3], strict=True)),
        others,
        calibration=dict(zip(names, map(float, moved_by), strict=True)) if len(shifts) else {},
    )


def _damping_and_friction_at_two_amplitudes(
    unknowns: SearchUnknowns, thetas: np.ndarray, figures: np.ndarray, sizes: np.ndarray
) -> np.ndarray:
    """Return rows (3, m): the damping ratios at two amplitudes, and the (equivalent) friction [m/s^2]."""
    # For dry friction the product of equivalent damping and amplitude is constant, for viscous drag the
    # damping itself, so two amplitudes separate both.
    law = unknowns.law
    values = unknowns.physical_values(thetas)[0]
    amplitude = sizes[:, None]
    result = solve_harmonic_balance(
        make_rates_of_law(law, values), len(law.hidden), amplitude, figures[0], 2.0 * math.pi / figures[1]
    )
    own = compile_dry_friction_coefficient(law.equation, law.inputs)
    if own is not None:
        friction = np.broadcast_to(own(*values), thetas.shape[1:])
    else:
        wide, narrow = result.equivalent_friction(amplitude)
        friction = (AMPLITUDE_FRACTIONS[0] * narrow - AMPLITUDE_FRACTIONS[1] * wide) / (
            AMPLITUDE_FRACTIONS[0] - AMPLITUDE_FRACTIONS[1]
        )
    return np.vstack([result.damping_ratio, friction])


def rest_height_period_and_damping(
    unknowns: SearchUnknowns, theta: Float[np.ndarray, "p"]
) -> np.ndarray | NoOscillationReason:
    """Return equilibrium height [m], period [s] and damping ratio, or the reason why these are missing."""
    if unknowns.law.prescribed:
        return NoOscillationReason("the record prescribes the motion")
    result = small_oscillation(unknowns.law, unknowns.physical_values(theta)[0], unknowns.rest)
    if isinstance(result, NoOscillationReason):
        return result
    level = float(result.z)
    if abs(level) < _ROUNDING * unknowns.amplitude:  # the root finder returns such values for 0
        level = 0.0
    return np.array([level, result.period, result.damping_ratio])
