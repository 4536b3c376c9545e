"""Frequency and damping as functions of amplitude, measured from a record without a law.

For a free oscillation, the frequency follows from the times of the extremes, and the damping from the decay
of the amplitude. For a driven oscillation, both follow from the restoring force (drive minus acceleration):
a stiffness and a damping coefficient are fitted to this force in each cycle (Masri & Caughey 1979,
doi:10.1115/1.3424568).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import RecordError
from reduced_models.records.derivatives import derivatives
from reduced_models.records.envelope import (
    MINIMUM_EXTREMES,
    Extremes,
    ExtremeScatter,
    find_extremes,
    require_enough_extremes,
    unexplained_sum_of_squares,
)

SHOWN_FRACTIONS = (1.0, 0.7, 0.5, 0.25, 0.1)
"""Amplitudes shown in tables, as fractions of the record's maximum amplitude."""
_NEIGHBOUR_RATIO = 1.6  # ratio of amplitudes up to which cycles are neighbours
_MINIMUM_NEIGHBOURS = 5  # minimum number of neighbours of a driven cycle, whatever their amplitude
_NEIGHBOUR_COUNTS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)  # neighbours on either side of a free cycle
_CUBIC_NEIGHBOURS = 6  # number of neighbours from which on a cubic is determined
_PRECISE_DAMPING = 0.03  # relative error at which a damping ratio is precise enough
_POLYNOMIAL_ERRORS = 1e-4, 3e-3  # relative errors of frequency and damping ratio due to the polynomials
# Relative error of a frequency from the restoring force: smoothing reduces the acceleration more than the
# height, by 0.1 to 0.45 % in simulated records.
_SMOOTHING_ERROR = 4e-3
_MINIMUM_ROWS = 8  # minimum number of rows that determines their scatter about a curve
_CONFIDENCE = 0.975  # quantile of a two-sided 95 % interval
_STOPPING_RATIO = 0.6  # fraction of the usual frequency: a slower cycle shows that the motion has stopped
_CUT_SHORT_RATIO = 1.9  # multiple of the minimum amplitude below which a cycle may be cut short
_MAXIMUM_DECAY = 0.5  # decay of an amplitude [1/rad] up to which it follows from the curvature
_ERROR_FACTOR = 2.0  # standard deviations


class BackbonePoint(NamedTuple):
    """Frequency and damping at one amplitude."""

    amplitude: float  # [m], or [rad] of an angle
    frequency: float  # angular frequency [rad/s]; of a driven motion, from its stiffness
    damping_ratio: float
    frequency_error: float  # two standard deviations [rad/s]
    damping_error: float


@dataclasses.dataclass(frozen=True, eq=False)
class Backbone:
    """Frequency and damping of a record against amplitude: one row per cycle, smallest amplitude first."""

    method: str
    amplitude: Float[np.ndarray, "n"]  # [m, rad]
    frequency: Float[np.ndarray, "n"]  # angular [rad/s]
    damping_ratio: Float[np.ndarray, "n"]
    frequency_error: Float[np.ndarray, "n"]  # [rad/s]
    damping_error: Float[np.ndarray, "n"]
    drive: float | None = None  # [rad/s]

    def interpolate_at(self, amplitude: float) -> BackbonePoint:
        """Interpolate frequency [rad/s] and damping at an amplitude [m or rad]."""

        def interpolate_row(row: np.ndarray) -> float:
            return float(np.interp(amplitude, self.amplitude, row))

        # Damping times amplitude, which is constant for dry friction.
        ratio, error = (
            interpolate_row(self.amplitude * row) / interpolate_row(self.amplitude)
            for row in (self.damping_ratio, self.damping_error)
        )
        return BackbonePoint(
            amplitude, interpolate_row(self.frequency), ratio, interpolate_row(self.frequency_error), error
        )

    def amplitudes_to_show(self, scale: float) -> tuple[float, ...]:
        """Return the amplitudes [m or rad] to show in a table of the curves, the largest first."""
        # The last cycles before a motion stops are cut short, so their amplitude is too small.
        minimum, maximum = scale * float(self.amplitude[0]), scale * float(self.amplitude[-1])
        rounded = [float(f"{fraction * maximum:.2g}") for fraction in SHOWN_FRACTIONS]
        return tuple(
            size / scale
            for size in dict.fromkeys(rounded)
            if size >= min(_CUT_SHORT_RATIO * minimum, rounded[0])
        )


def backbone_of_free_oscillation(record: PistonRecord) -> Backbone:
    """Measure frequency [rad/s] and damping of a free oscillation against amplitude [m or rad]."""
    # Frequency from the time between extremes, damping from the fall of the amplitude, by local polynomials
    # over neighbouring cycles (Londono, Neild & Cooper 2015, doi:10.1016/j.jsv.2015.02.003).
    return backbone_of_extremes(find_extremes(record))


def backbone_of_extremes(extremes: Extremes) -> Backbone:
    """Compute frequency [rad/s] and damping against amplitude [m or rad] from extremes."""
    extremes = _extremes_before_rest(extremes)
    require_enough_extremes(extremes)
    size = np.full(len(extremes), np.nan)
    size[1:-1] = np.abs(extremes.height[:-2] - 2.0 * extremes.height[1:-1] + extremes.height[2:]) / 4.0
    scatter = extremes.scatter()
    rows = [
        row
        for k in np.flatnonzero(np.isfinite(size))
        if (row := _backbone_row_and_errors_at_extreme(extremes, scatter, size, int(k))) is not None
    ]
    if len(rows) < MINIMUM_EXTREMES - 2:
        raise RecordError(
            f"the decay of the amplitude can be measured in only {len(rows)} cycles, but "
            f"{MINIMUM_EXTREMES - 2} are needed; record longer, or with less noise"
        )
    amplitude, frequency, ratio, frequency_error, error = np.array(rows).T
    relative = amplitude / amplitude.max()
    terms = np.stack([np.ones_like(relative), 1.0 / relative, relative], axis=1)
    error = np.maximum(error, _doubled_deviation_from_smooth_rows(terms, ratio, error, relative))
    terms = relative[:, None] ** np.arange(4)
    frequency_error = np.maximum(
        frequency_error, _doubled_deviation_from_smooth_rows(terms, frequency, frequency_error, relative)
    )
    frequency_error = np.hypot(frequency_error, _POLYNOMIAL_ERRORS[0] * frequency)
    error = np.hypot(error, _POLYNOMIAL_ERRORS[1] * np.abs(ratio))
    order = np.argsort(amplitude)
    columns = (row[order] for row in (amplitude, frequency, ratio, frequency_error, error))
    return Backbone("envelope", *columns)


def _extremes_before_rest(extremes: Extremes) -> Extremes:
    """Return the extremes before the motion stops, that is, before a much longer time to the next extreme."""
    halves = np.diff(extremes.time)
    slow = np.flatnonzero(halves[1:] > halves[:-1] / _STOPPING_RATIO) + 2
    stop = int(slow[0]) if len(slow) and slow[0] >= MINIMUM_EXTREMES else len(extremes)
    return dataclasses.replace(
        extremes, time=extremes.time[:stop], height=extremes.height[:stop], sign=extremes.sign[:stop]
    )


def _backbone_row_and_errors_at_extreme(
    extremes: Extremes, scatter: ExtremeScatter, size: np.ndarray, k: int
) -> tuple[float, float, float, float, float] | None:
    """Return amplitude [m], frequency [rad/s] and damping ratio at an extreme, with errors of the last two.

    All three come from a fit to neighbouring extremes of similar amplitude. The fit uses as few extremes as
    determine the damping precisely.
    """
    from scipy.stats import t

    row, seen = None, 0
    quantile = float(t.ppf(_CONFIDENCE, scatter.freedom[k]))
    for width in _NEIGHBOUR_COUNTS:
        first = min(max(0, k - width), max(0, len(extremes) - 2 * width - 1))
        near = np.arange(first, min(len(extremes), first + 2 * width + 1))
        near = near[np.isfinite(extremes.height[near])]
        sign, away = extremes.sign[near], math.pi * (near - k)
        if len(near) < MINIMUM_EXTREMES or np.abs(sign.sum()) > len(near) - 4:
            continue
        sizes = size[near][np.isfinite(size[near])]
        if row is not None and (len(near) == seen or sizes.max() > _NEIGHBOUR_RATIO**2 * sizes.min()):
            break
        degree = 2 if width < _CUBIC_NEIGHBOURS else 3
        powers = away[:, None] ** np.arange(degree + 1)
        level = away[:, None] ** np.arange(1 if width < _CUBIC_NEIGHBOURS else 2)  # with drift if wide enough
        (amplitude, slope, bend, *_), (_, error, *_) = _least_squares_coefficients_and_errors(
            np.concatenate([sign[:, None] * powers, level], axis=1), extremes.height[near]
        )
        # An exponential decay is not a parabola; a parabola fitted to one gives the correction of the slope.
        rate = 2.0 * bend / slope if slope else 0.0
        if 0.0 < abs(rate) < _MAXIMUM_DECAY:
            slope *= rate / _least_squares_coefficients_and_errors(powers, np.exp(rate * away))[0][1]
        # crests and troughs may be alternately early and late
        (_, _, pace, *_), (_, _, pace_error, *_) = _least_squares_coefficients_and_errors(
            np.concatenate([sign[:, None], powers], axis=1) / scatter.time[near, None],
            extremes.time[near] / scatter.time[near],
        )
        # zeta = d/sqrt(1 + d^2), d the logarithmic decrement per radian
        fall = -float(slope) / abs(float(amplitude))
        row = (
            abs(float(amplitude)),
            1.0 / float(pace),
            fall / math.hypot(1.0, fall),
            quantile * float(pace_error) / float(pace) ** 2,
            quantile * scatter.height[k] * float(error) / abs(float(amplitude)),
        )
        seen = len(near)
        if row[4] < _PRECISE_DAMPING * abs(row[2]):
            break
    return row


def _least_squares_coefficients_and_errors(
    columns: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fit columns (n, p) to values (n,); return coefficients and their standard errors for unit noise."""
    units = np.abs(columns).max(axis=0)
    basis = columns / units
    solution, *_ = np.linalg.lstsq(basis, values, rcond=None)
    return solution / units, np.sqrt(np.diag(np.linalg.pinv(basis.T @ basis))) / units


def _doubled_deviation_from_smooth_rows(
    terms: np.ndarray, values: np.ndarray, errors: np.ndarray, amplitude: np.ndarray
) -> np.ndarray:
    """Return twice the standard deviation (n,) of neighbouring rows about a smooth function of amplitude.

    Slow noise and beats contribute to this deviation. They shift neighbouring rows together, so the
    scatter of the extremes within one row does not show them.
    """
    if len(values) < _MINIMUM_ROWS:
        return np.zeros(len(values))
    weight = 1.0 / np.maximum(errors, 1e-9 * np.abs(values).max())
    solution, *_ = np.linalg.lstsq(terms * weight[:, None], values * weight, rcond=None)
    squares = (terms @ solution - values) ** 2 * len(values) / (len(values) - terms.shape[1])
    near = np.abs(np.log(amplitude[:, None] / amplitude)) < math.log(_NEIGHBOUR_RATIO)
    return _ERROR_FACTOR * np.sqrt((near * squares).sum(axis=1) / near.sum(axis=1))


def backbone_of_driven_oscillation(
    record: PistonRecord, drive_acceleration: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> Backbone:
    """Measure frequency [rad/s] and damping; ``drive_acceleration``(height, velocity) is in m/s^2."""
    # Restoring force method (Masri & Caughey 1979, doi:10.1115/1.3424568): a stiffness and a damping are
    # fitted to drive minus acceleration in each cycle.
    smooth = derivatives(record)
    time, height, velocity = smooth.time, smooth.height, smooth.velocity
    force = drive_acceleration(height, velocity) - smooth.acceleration
    extremes = find_extremes(record)
    times, heights = (row[np.isfinite(extremes.height)] for row in (extremes.time, extremes.height))
    sizes, rows = [], []
    for k in range(len(times) - 2):
        here = slice(*np.searchsorted(time, times[[k, k + 2]]))
        parts = np.stack(
            [height[here] - height[here].mean(), velocity[here], np.ones_like(time[here])], axis=1
        )
        if len(parts) <= 2 * parts.shape[1]:
            continue
        (stiffness, damping, _), *_ = np.linalg.lstsq(parts, force[here], rcond=None)
        if stiffness > 0.0:
            omega = math.sqrt(stiffness)
            # The second difference of three extremes is four amplitudes, whatever their centre.
            sizes.append(abs(heights[k] - 2.0 * heights[k + 1] + heights[k + 2]) / 4.0)
            rows.append((omega, damping / (2.0 * omega)))
    if len(rows) < MINIMUM_EXTREMES - 2:
        raise RecordError(
            f"a stiffness can be fitted in only {len(rows)} cycles, but {MINIMUM_EXTREMES - 2} are needed; "
            "record longer, or with less noise"
        )
    size, values = np.log(sizes), np.array(rows)
    fitted = []
    for k in range(len(size)):
        near = _rows_of_similar_amplitude(size, k)
        (omega, spread), (ratio, error) = (
            _line_value_at_zero_and_error(size[near] - size[k], values[near, column]) for column in (0, 1)
        )
        fitted.append((omega, ratio, math.hypot(spread, _SMOOTHING_ERROR * omega), error))
    tone = math.pi * (len(times) - 1) / float(times[-1] - times[0])
    order = np.argsort(size)
    frequency, ratio, frequency_error, error = np.array(fitted)[order].T
    amplitude = np.exp(size)[order]
    return Backbone("restoring force", amplitude, frequency, ratio, frequency_error, error, tone)


def _rows_of_similar_amplitude(size: np.ndarray, k: int) -> np.ndarray:
    """Return rows whose amplitude is similar to that of row k; ``size`` has logarithms of amplitudes."""
    away = np.abs(size - size[k])
    near = np.flatnonzero(away <= math.log(_NEIGHBOUR_RATIO))
    return (
        near
        if len(near) >= _MINIMUM_NEIGHBOURS
        else np.sort(np.argsort(away, kind="stable")[:_MINIMUM_NEIGHBOURS])
    )


def _line_value_at_zero_and_error(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Fit a line to points; return its value at zero, and twice the standard error, from the scatter."""
    basis = np.stack([np.ones_like(x), x], axis=1)
    (value, _), (error, _) = _least_squares_coefficients_and_errors(basis, y)
    scatter = unexplained_sum_of_squares(basis, y) / max(1, len(x) - 2)
    return float(value), _ERROR_FACTOR * math.sqrt(scatter) * float(error)
