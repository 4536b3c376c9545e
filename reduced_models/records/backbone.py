"""Frequency and damping against amplitude, told by a record alone, without a law.

Of a free swing by its envelope: its frequency as it is seen, and the fall of its amplitude. Of a
driven one by its restoring force, what the acceleration leaves of the drive (Masri & Caughey 1979,
doi:10.1115/1.3424568): stiffness and damping that fit it best in each cycle.
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
    LEAST_EXTREMES,
    Extremes,
    Scatter,
    check_extremes,
    find_extremes,
    residual_square,
)

FRACTIONS = (1.0, 0.7, 0.5, 0.25, 0.1)
"""Amplitudes that are looked at, over the greatest one of the record."""
_NEAR = 1.6  # a cycle's neighbours have its amplitude to this factor
_FEWEST = 5  # neighbours of a driven cycle, nearer or not
_WIDTHS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)  # neighbours on either side of a free one
_WIDE = 6  # neighbours from which on a cubic is told
_PRECISE = 0.03  # error of a damping ratio that is known well enough
_FINEST = 1e-4, 3e-3  # relative errors of a frequency and a damping ratio that polynomials leave
# Of a frequency by the restoring force: smoothing takes more of the acceleration than of the height, 0.1 to
# 0.45 % in made records.
_SMOOTHED = 4e-3
_FEWEST_ROWS = 8  # from which on their scatter about a curve is told
_CONFIDENCE = 0.975  # quantile of a half-width of 95 %
_SLOW = 0.6  # of the usual frequency: a cycle that is slower is none
_CUT = 1.9  # times the least amplitude: below it a cycle may be cut short
_STEEPEST = 0.5  # fall of an amplitude [1/rad], up to which it is told from its bend
_SURE = 2.0  # standard deviations


class BackbonePoint(NamedTuple):
    """Frequency and damping at one amplitude."""

    amplitude: float  # [m], or [rad] of an angle
    frequency: float  # angular [rad/s]; a driven one by its stiffness
    damping_ratio: float
    frequency_error: float  # two standard deviations [rad/s]
    damping_error: float


@dataclasses.dataclass(frozen=True, eq=False)
class Backbone:
    """Backbone and damping curves of a record, one row a cycle, by rising amplitude."""

    method: str
    amplitude: Float[np.ndarray, "n"]  # [m, rad]
    frequency: Float[np.ndarray, "n"]  # angular [rad/s]
    damping_ratio: Float[np.ndarray, "n"]
    frequency_error: Float[np.ndarray, "n"]  # [rad/s]
    damping_error: Float[np.ndarray, "n"]
    drive: float | None = None  # [rad/s]

    def interpolate_at(self, amplitude: float) -> BackbonePoint:
        """Frequency [rad/s] and damping at an amplitude [m, rad], between the nearest rows."""

        def between(row: np.ndarray) -> float:
            return float(np.interp(amplitude, self.amplitude, row))

        # Damping times amplitude: that of dry friction does not change.
        ratio, error = (
            between(self.amplitude * row) / between(self.amplitude)
            for row in (self.damping_ratio, self.damping_error)
        )
        return BackbonePoint(amplitude, between(self.frequency), ratio, between(self.frequency_error), error)

    def amplitudes_to_show(self, scale: float) -> tuple[float, ...]:
        """Amplitudes [m, rad] of a table of the curves, the largest first."""
        # The last cycles before a motion stops are cut short, and would show too small an amplitude.
        least, greatest = scale * float(self.amplitude[0]), scale * float(self.amplitude[-1])
        rounded = [float(f"{fraction * greatest:.2g}") for fraction in FRACTIONS]
        return tuple(size / scale for size in dict.fromkeys(rounded) if size >= min(_CUT * least, rounded[0]))


def free_backbone(record: PistonRecord) -> Backbone:
    """Backbone [m or rad, rad/s] and damping curves of a free oscillation, from its extremes."""
    # Frequency from the time between extremes, damping from the fall of the amplitude, by local polynomials
    # over neighbouring cycles (Londono, Neild & Cooper 2015, doi:10.1016/j.jsv.2015.02.003).
    return backbone_of_extremes(find_extremes(record))


def backbone_of_extremes(extremes: Extremes) -> Backbone:
    """Backbone [m or rad, rad/s] and damping curves from extremes."""
    extremes = _before_standstill(extremes)
    check_extremes(extremes)
    size = np.full(len(extremes), np.nan)
    size[1:-1] = np.abs(extremes.height[:-2] - 2.0 * extremes.height[1:-1] + extremes.height[2:]) / 4.0
    scatter = extremes.scatter()
    rows = [
        row
        for k in np.flatnonzero(np.isfinite(size))
        if (row := _row_about(extremes, scatter, size, int(k))) is not None
    ]
    if len(rows) < LEAST_EXTREMES - 2:
        raise RecordError(
            f"{len(rows)} cycles tell a fall of the amplitude; record longer, or with less noise"
        )
    amplitude, frequency, ratio, frequency_error, error = np.array(rows).T
    relative = amplitude / amplitude.max()
    terms = np.stack([np.ones_like(relative), 1.0 / relative, relative], axis=1)
    error = np.maximum(error, _scatter_of_rows(terms, ratio, error, relative))
    terms = relative[:, None] ** np.arange(4)
    frequency_error = np.maximum(
        frequency_error, _scatter_of_rows(terms, frequency, frequency_error, relative)
    )
    frequency_error = np.hypot(frequency_error, _FINEST[0] * frequency)
    error = np.hypot(error, _FINEST[1] * np.abs(ratio))
    order = np.argsort(amplitude)
    columns = (row[order] for row in (amplitude, frequency, ratio, frequency_error, error))
    return Backbone("envelope", *columns)


def _before_standstill(extremes: Extremes) -> Extremes:
    """Extremes before the first that takes much longer: by then the motion stands still."""
    halves = np.diff(extremes.time)
    slow = np.flatnonzero(halves[1:] > halves[:-1] / _SLOW) + 2
    stop = int(slow[0]) if len(slow) and slow[0] >= LEAST_EXTREMES else len(extremes)
    return dataclasses.replace(
        extremes, time=extremes.time[:stop], height=extremes.height[:stop], sign=extremes.sign[:stop]
    )


def _row_about(
    extremes: Extremes, scatter: Scatter, size: np.ndarray, k: int
) -> tuple[float, float, float, float, float] | None:
    """Amplitude [m], frequency [rad/s], damping ratio and the errors of both at an extreme.

    By as few neighbours as tell the damping, and none of a very different amplitude.
    """
    from scipy.stats import t

    row, seen = None, 0
    sure = float(t.ppf(_CONFIDENCE, scatter.freedom[k]))
    for width in _WIDTHS:
        first = min(max(0, k - width), max(0, len(extremes) - 2 * width - 1))
        near = np.arange(first, min(len(extremes), first + 2 * width + 1))
        near = near[np.isfinite(extremes.height[near])]
        sign, away = extremes.sign[near], math.pi * (near - k)
        if len(near) < LEAST_EXTREMES or np.abs(sign.sum()) > len(near) - 4:
            continue
        sizes = size[near][np.isfinite(size[near])]
        if row is not None and (len(near) == seen or sizes.max() > _NEAR**2 * sizes.min()):
            break
        degree = 2 if width < _WIDE else 3
        powers = away[:, None] ** np.arange(degree + 1)
        level = away[:, None] ** np.arange(1 if width < _WIDE else 2)  # wide enough to see it drift
        (amplitude, slope, bend, *_), (_, error, *_) = _fit_columns(
            np.concatenate([sign[:, None] * powers, level], axis=1), extremes.height[near]
        )
        # An amplitude that falls exponentially is no parabola: what that does to one tells by how much.
        rate = 2.0 * bend / slope if slope else 0.0
        if 0.0 < abs(rate) < _STEEPEST:
            slope *= rate / _fit_columns(powers, np.exp(rate * away))[0][1]
        # crests and troughs may come early and late in turn
        (_, _, pace, *_), (_, _, pace_error, *_) = _fit_columns(
            np.concatenate([sign[:, None], powers], axis=1) / scatter.time[near, None],
            extremes.time[near] / scatter.time[near],
        )
        # zeta = d/sqrt(1 + d^2), d the logarithmic decrement per radian
        fall = -float(slope) / abs(float(amplitude))
        row = (
            abs(float(amplitude)),
            1.0 / float(pace),
            fall / math.hypot(1.0, fall),
            sure * float(pace_error) / float(pace) ** 2,
            sure * scatter.height[k] * float(error) / abs(float(amplitude)),
        )
        seen = len(near)
        if row[4] < _PRECISE * abs(row[2]):
            break
    return row


def _fit_columns(columns: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of columns (n, p) in values (n,), and their standard deviations for noise of 1."""
    units = np.abs(columns).max(axis=0)
    basis = columns / units
    solution, *_ = np.linalg.lstsq(basis, values, rcond=None)
    return solution / units, np.sqrt(np.diag(np.linalg.pinv(basis.T @ basis))) / units


def _scatter_of_rows(
    terms: np.ndarray, values: np.ndarray, errors: np.ndarray, amplitude: np.ndarray
) -> np.ndarray:
    """Two standard deviations of rows (n,) about a smooth curve of the amplitude, among those near it.

    Slow noise and beats move neighbouring rows together, which their own extremes do not tell.
    """
    if len(values) < _FEWEST_ROWS:
        return np.zeros(len(values))
    weight = 1.0 / np.maximum(errors, 1e-9 * np.abs(values).max())
    solution, *_ = np.linalg.lstsq(terms * weight[:, None], values * weight, rcond=None)
    squares = (terms @ solution - values) ** 2 * len(values) / (len(values) - terms.shape[1])
    near = np.abs(np.log(amplitude[:, None] / amplitude)) < math.log(_NEAR)
    return _SURE * np.sqrt((near * squares).sum(axis=1) / near.sum(axis=1))


def driven_backbone(
    record: PistonRecord, drive_acceleration: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> Backbone:
    """Backbone [m or rad, rad/s] and damping of a driven swing; drive_acceleration [m/s^2] by motion."""
    # Restoring force method (Masri & Caughey 1979, doi:10.1115/1.3424568): drive minus acceleration is fitted
    # in each cycle by a stiffness and a damping.
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
            # The second difference of three extremes is four amplitudes, wherever they are centred.
            sizes.append(abs(heights[k] - 2.0 * heights[k + 1] + heights[k + 2]) / 4.0)
            rows.append((omega, damping / (2.0 * omega)))
    if len(rows) < LEAST_EXTREMES - 2:
        raise RecordError(f"{len(rows)} cycles tell a stiffness; record longer, or with less noise")
    size, values = np.log(sizes), np.array(rows)
    fitted = []
    for k in range(len(size)):
        near = _cycles_of_similar_amplitude(size, k)
        (omega, spread), (ratio, error) = (
            _fit_line(size[near] - size[k], values[near, column]) for column in (0, 1)
        )
        fitted.append((omega, ratio, math.hypot(spread, _SMOOTHED * omega), error))
    tone = math.pi * (len(times) - 1) / float(times[-1] - times[0])
    order = np.argsort(size)
    frequency, ratio, frequency_error, error = np.array(fitted)[order].T
    amplitude = np.exp(size)[order]
    return Backbone("restoring force", amplitude, frequency, ratio, frequency_error, error, tone)


def _cycles_of_similar_amplitude(size: np.ndarray, k: int) -> np.ndarray:
    """Rows of about the amplitude of row k, by the logarithms of all."""
    away = np.abs(size - size[k])
    near = np.flatnonzero(away <= math.log(_NEAR))
    return near if len(near) >= _FEWEST else np.sort(np.argsort(away, kind="stable")[:_FEWEST])


def _fit_line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Value of a line through points at zero, and two standard deviations by their scatter."""
    basis = np.stack([np.ones_like(x), x], axis=1)
    (value, _), (error, _) = _fit_columns(basis, y)
    scatter = residual_square(basis, y) / max(1, len(x) - 2)
    return float(value), _SURE * math.sqrt(scatter) * float(error)
