"""Frequency and damping against amplitude, told by a record alone, without a law.

Of a free swing by its envelope: its frequency as it is seen, and the fall of its amplitude. Of a
driven one by its restoring force, what the acceleration leaves of the drive (Masri & Caughey 1979,
doi:10.1115/1.3424568): stiffness and damping that fit it best in each cycle.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.run.piston_record import PistonRecord
from granular.shared.errors import RecordError
from reduced_models.records.derivatives import derivatives
from reduced_models.records.envelope import LEAST_EXTREMES, envelope, find_alternating_extremes

if TYPE_CHECKING:
    from jaxtyping import Float

FRACTIONS = (1.0, 0.5, 0.25, 0.1)
"""Amplitudes that are looked at, over the greatest one of the record."""
_NEAR = 1.6  # a cycle's neighbours have its amplitude to this factor
_FEWEST = 5  # neighbours of a driven cycle, nearer or not
_WIDTHS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)  # neighbours on either side of a free one
_PRECISE = 0.03  # error of a fall that is known well enough
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
    """Backbone [m or rad, rad/s] and damping curves of a free swing, from its extremes."""
    # Frequency from the time between extremes, damping from the fall of the amplitude, by local polynomials
    # over neighbouring cycles (Londono, Neild & Cooper 2015, doi:10.1016/j.jsv.2015.02.003).
    cycles = envelope(record)
    count = _count_swinging_cycles(cycles.frequency)
    size, turn = cycles.amplitude[:count], math.pi * np.arange(count)
    rows = []
    for k in range(count):
        near, (fall, error) = _amplitude_loss_per_radian(turn, size, cycles.amplitude_noise, k)
        away = turn[near] - turn[k]
        (value, *_), (spread, *_) = _fit_local_polynomial(
            away, cycles.frequency[near], cycles.frequency_noise[near], 1
        )
        per_radian = fall / size[k]
        # zeta = d/sqrt(1 + d^2), d the logarithmic decrement per radian.
        rows.append((value, per_radian / math.hypot(1.0, per_radian), spread, error / size[k]))
    return _sorted_backbone("envelope", size, rows, None)


def _count_swinging_cycles(frequency: np.ndarray) -> int:
    """Count the cycles before the first that takes much longer: by then the motion stands still."""
    slow = np.flatnonzero(frequency < _SLOW * np.median(frequency))
    return int(slow[0]) if len(slow) and slow[0] >= LEAST_EXTREMES - 2 else len(frequency)


def _amplitude_loss_per_radian(
    turn: np.ndarray, size: np.ndarray, noise: np.ndarray, k: int
) -> tuple[slice, tuple[float, float]]:
    """Neighbours of a cycle, and the fall of the amplitude there [m/rad] with its error."""
    # Over many cycles an amplitude is no cubic, over few its fall is noise: as few as give it to `_PRECISE`,
    # and none of a very different amplitude.
    result = None
    for width in _WIDTHS:
        first = min(max(0, k - width), max(0, len(size) - 2 * width - 1))
        near = slice(first, first + 2 * width + 1)
        spread = size[near].max() / size[near].min()
        if result is not None and (spread > _NEAR**2 or len(size) <= result[0].stop - result[0].start):
            break
        away, degree = turn[near] - turn[k], 2 if width < 4 else 3
        (_, slope, bend, *_), (_, error, *_) = _fit_local_polynomial(away, size[near], noise[near], degree)
        # An amplitude that falls exponentially is no parabola: what that does to one tells by how much.
        rate = 2.0 * bend / slope if slope else 0.0
        if 0.0 < abs(rate) < _STEEPEST:
            slope *= rate / _fit_local_polynomial(away, np.exp(rate * away), noise[near], degree)[0][1]
        result = near, (-slope, error)
        if error < _PRECISE * abs(slope):
            break
    assert result is not None
    return result


def driven_backbone(
    record: PistonRecord, drive_acceleration: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> Backbone:
    """Backbone [m or rad, rad/s] and damping of a driven swing; drive_acceleration [m/s^2] by motion."""
    # Restoring force method (Masri & Caughey 1979, doi:10.1115/1.3424568): drive minus acceleration is fitted
    # in each cycle by a stiffness and a damping.
    smooth = derivatives(record)
    time, height, velocity = smooth.time, smooth.height, smooth.velocity
    force = drive_acceleration(height, velocity) - smooth.acceleration
    times, heights, _ = find_alternating_extremes(smooth)
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
            [
                float(part[0])
                for part in _fit_local_polynomial(size[near] - size[k], values[near, column], None, 1)
            ]
            for column in (0, 1)
        )
        fitted.append((omega, ratio, spread, error))
    tone = math.pi * (len(times) - 1) / float(times[-1] - times[0])
    return _sorted_backbone("restoring force", np.exp(size), fitted, tone)


def _sorted_backbone(
    method: str, amplitude: np.ndarray, rows: list[tuple[float, float, float, float]], drive: float | None
) -> Backbone:
    order = np.argsort(amplitude)
    frequency, ratio, frequency_error, error = np.array(rows)[order].T
    return Backbone(method, amplitude[order], frequency, ratio, frequency_error, error, drive)


def _cycles_of_similar_amplitude(size: np.ndarray, k: int) -> np.ndarray:
    """Rows of about the amplitude of row k, by the logarithms of all."""
    away = np.abs(size - size[k])
    near = np.flatnonzero(away <= math.log(_NEAR))
    return near if len(near) >= _FEWEST else np.sort(np.argsort(away, kind="stable")[:_FEWEST])


def _fit_local_polynomial(
    x: np.ndarray, y: np.ndarray, noise: np.ndarray | None, degree: int
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients, from the constant on, of a low polynomial through points, and their errors."""
    # Errors are two standard deviations; the scatter of the points counts if it exceeds their noise.
    degree = min(degree, len(x) - 1)
    weight = np.ones(len(x))
    if noise is not None:
        weight = 1.0 / np.maximum(noise, 1e-9 * float(np.abs(y).max()))
    reach = float(np.abs(x).max()) or 1.0
    units = reach ** -np.arange(degree + 1.0)
    basis = np.vander(x / reach, degree + 1, increasing=True) * weight[:, None]
    coefficients, *_ = np.linalg.lstsq(basis, y * weight, rcond=None)
    left = basis @ coefficients - y * weight
    scatter = float(left @ left) / max(1, len(x) - degree - 1)
    if noise is not None:
        scatter = max(1.0, scatter)
    errors = _SURE * np.sqrt(scatter * np.diag(np.linalg.pinv(basis.T @ basis)))
    return coefficients * units, errors * units
