"""Envelope of a free oscillation: amplitude, frequency and damping of each half cycle.

An extreme lies between two zero crossings, at which the motion passes its equilibrium. A crossing counts
only if the displacement afterwards exceeds the noise, the sensor's rounding and a fifth of the amplitude. For
this reason, neither noise nor a second mode produces additional extremes. Three successive extremes form one
cycle. The frequency and decay rate of all cycles, plotted against amplitude, are the backbone and damping
curves of the oscillator (Londono, Neild & Cooper 2015, doi:10.1016/j.jsv.2015.02.003). No law is needed.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import RecordError
from reduced_models.records.derivatives import (
    noise_standard_deviation,
    rms_noise_above_motion,
    sensor_rounding_step,
)

__all__ = ["Envelope", "envelope"]

_CONFIDENCE = 0.975  # quantile of a two-sided 95 % interval
MINIMUM_EXTREMES = 5
_MINIMUM_ROWS = 10  # minimum number of cycles, half a period apart, for a remark on the amplitude
_RISE_RATIO, _DECAY_RATIO = 1.3, 0.8
"""The amplitude has risen if it exceeds `_RISE_RATIO` times its previous minimum. It has decayed if it is
below `_DECAY_RATIO` times its previous maximum."""
_HYSTERESIS_NOISES, _HYSTERESIS_FRACTION = 5.0, 0.2
"""A zero crossing counts only if the displacement after it exceeds `_HYSTERESIS_NOISES` times the noise and
`_HYSTERESIS_FRACTION` of the amplitude. A rise in amplitude must also exceed `_HYSTERESIS_NOISES` times the
noise."""
_POLYNOMIAL_HALF_WIDTH = 0.3  # half-width of the polynomial about an extreme, over the time between crossings
_DEGREE = 4
_MINIMUM_SAMPLES = 10  # minimum number of samples for a polynomial; with fewer it is fitted to a spline
# Minimum number of samples between zero crossings for a spline to give the extreme.
_MINIMUM_HALF_CYCLE_SAMPLES = 2.2
# Minimum gap that hides an extreme: in usual time steps, and as a fraction of the time between crossings.
_GAP_LIMITS = 2.5, 0.25
_LEVEL_PART = 3  # the mean of the last third of the record is the first estimate of equilibrium
_MAXIMUM_SHIFT = 0.2  # half cycles by which an extreme may differ from the fitted motion's
_NEIGHBOURS, _POOLED_NEIGHBOURS, _COEFFICIENTS = 3, 6, 4
"""To measure the scatter of the extremes, a mean level and a parabola (`_COEFFICIENTS` coefficients in all)
are fitted to each extreme and `_NEIGHBOURS` extremes on either side. The mean squared residual is then
averaged over `_POOLED_NEIGHBOURS` extremes on either side."""
_MINIMUM_SCATTER = 0.15  # minimum scatter of an extreme, in rounding steps of the sensor: half of 1/sqrt(12)
# Number of samples in a running median, and distance from it, in noise levels, that makes an outlier.
_MEDIAN_WINDOW, _OUTLIER_LIMIT = 5, 5.0


@dataclasses.dataclass(frozen=True)
class PeakDampingRatios:
    """Damping ratios measured from successive peaks of a record, without a law."""

    mean: float
    low: float  # minimum over the complete record and its halves
    high: float
    noise: float  # maximum error of the mean due to the record's noise

    def contradicts(self, ratio: float) -> bool:
        """Return whether a ratio is outside the measured range by more than a factor of 2 plus the noise."""
        low = min(0.5 * self.low, 2.0 * self.low) - self.noise
        high = max(0.5 * self.high, 2.0 * self.high) + self.noise
        return not low <= ratio <= high


@dataclasses.dataclass(frozen=True, eq=False)
class Envelope:
    """The envelope of a record, one row per cycle.

    Attributes
    ----------
    time : float64 (n,)
        Time of each cycle's middle extreme [s].
    level : float64 (n,)
        Mean level of the oscillation [m].
    amplitude, frequency, damping : float64 (n,)
        Amplitude [m], angular frequency [rad/s], and rate at which the logarithm of the amplitude
        decreases [1/s] (negative if the amplitude grows).
    amplitude_noise, frequency_noise : float64 (n,)
        Standard deviations of amplitude [m] and frequency [rad/s], from the scatter of the extremes.
    phase : float64 (n,)
        Phase of each cycle's middle extreme [rad]; half a period is pi.
    """

    time: np.ndarray
    level: np.ndarray
    amplitude: np.ndarray
    frequency: np.ndarray
    damping: np.ndarray
    amplitude_noise: np.ndarray
    frequency_noise: np.ndarray
    phase: np.ndarray

    @property
    def peak_damping(self) -> PeakDampingRatios:
        """Damping ratios from the decay of the peaks, in the complete record and in each half."""
        half = len(self.amplitude) // 2
        parts = (slice(None), slice(half + 1), slice(half, None))
        (total, error), *halves = (self._logarithmic_decay_and_half_interval(part) for part in parts)
        ratios = [ratio for ratio, _ in halves]
        largest = max(error, *(error for _, error in halves))
        return PeakDampingRatios(total, min(total, *ratios), max(total, *ratios), largest)

    def _logarithmic_decay_and_half_interval(self, part: slice) -> tuple[float, float]:
        """Return the decrease of the log amplitude per radian of phase, and half its 95 % interval."""
        from scipy.stats import t

        phase, size = self.phase[part], self.amplitude[part]
        basis = np.stack([size, size * phase], axis=1)  # logarithms scatter inversely to the amplitude
        slope = float(np.linalg.lstsq(basis, size * np.log(size), rcond=None)[0][1])
        # successive cycles share two of three extremes
        freedom = max(1.0, 0.5 * len(size) - 2.0)
        variance = unexplained_sum_of_squares(basis, size * np.log(size)) / freedom
        quantile = float(t.ppf(_CONFIDENCE, freedom))
        return -slope, quantile * math.sqrt(variance * float(np.linalg.pinv(basis.T @ basis)[1, 1]))

    @property
    def damping_ratio(self) -> np.ndarray:
        """Damping ratio of each cycle (n,): decay rate divided by angular frequency."""
        return self.damping / self.frequency


def envelope(record: PistonRecord) -> Envelope:
    """Find amplitude, frequency and damping of an oscillation as functions of time.

    They are computed from every three successive extremes, as for the logarithmic decrement (Londono,
    Neild & Cooper 2015, doi:10.1016/j.jsv.2015.02.003).

    Parameters
    ----------
    record : PistonRecord
        Oscillating motion.

    Returns
    -------
    Envelope
        Amplitude [m], angular frequency [rad/s] and decay rate [1/s] of each cycle, arrays (n,).

    Raises
    ------
    RecordError
        If fewer than five extremes exceed the noise.

    Examples
    --------
    >>> import numpy as np
    >>> from reduced_models import PistonRecord
    >>> time = np.linspace(0.0, 2.0, 2000)
    >>> record = PistonRecord(time, 0.06 + 1e-3 * np.exp(-0.8 * time) * np.cos(21.8 * time))
    >>> from reduced_models.records.envelope import envelope
    >>> found = envelope(record)
    >>> float(np.mean(found.frequency).round(1))  # [rad/s]
    21.8
    """
    return envelope_of_extremes(find_extremes(record))


def envelope_of_extremes(extremes: Extremes) -> Envelope:
    """Return amplitude [m], angular frequency [rad/s] and decay rate [1/s] of each cycle."""
    require_enough_extremes(extremes)
    scatter = extremes.scatter()
    before, here, after = extremes.height[:-2], extremes.height[1:-1], extremes.height[2:]
    period = extremes.time[2:] - extremes.time[:-2]
    amplitude = np.abs(before - 2.0 * here + after) / 4.0
    seen = np.isfinite(amplitude) & np.isfinite(period) & (amplitude > 0.0)
    frequency = 2.0 * math.pi / period
    middle = extremes.time[1:-1][seen]
    return Envelope(
        time=middle,
        level=((before + 2.0 * here + after) / 4.0)[seen],
        amplitude=amplitude[seen],
        frequency=frequency[seen],
        damping=-np.gradient(np.log(amplitude[seen]), middle),
        amplitude_noise=scatter.height[1:-1][seen] * math.sqrt(6.0) / 4.0,
        frequency_noise=(frequency / period * np.hypot(scatter.time[2:], scatter.time[:-2]))[seen],
        phase=math.pi * np.flatnonzero(seen),
    )


def require_enough_extremes(extremes: Extremes) -> None:
    """Raise an error if the extremes form too few complete cycles."""
    cycles = np.isfinite(extremes.height[:-2] + extremes.height[1:-1] + extremes.height[2:]).sum()
    if cycles < MINIMUM_EXTREMES - 2:
        seen = int(np.isfinite(extremes.height).sum())
        raise RecordError(
            f"only {seen} successive extremes of the height exceed the noise; {MINIMUM_EXTREMES} or more are "
            "needed for an envelope; record longer, or with less noise"
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Extremes:
    """Alternating crests and troughs of an oscillation; an extreme hidden by a gap is NaN."""

    time: Float[np.ndarray, "k"]  # [s]
    height: Float[np.ndarray, "k"]  # [m]
    sign: Float[np.ndarray, "k"]  # 1 for a crest, -1 for a trough
    rounding: float = 0.0  # step of the sensor [m]; 0 if it does not round

    def __len__(self) -> int:
        return len(self.time)

    def scatter(self) -> ExtremeScatter:
        """Measure the scatter of the extremes' heights and times about local parabolas."""
        number = np.arange(len(self))
        known = np.isfinite(self.height)
        size = np.abs(self.height - np.nanmean(self.height))
        squares = np.full((2, len(self)), np.nan)
        for k in range(len(self)):
            first = min(max(0, k - _NEIGHBOURS), max(0, len(self) - 2 * _NEIGHBOURS - 1))
            near = number[first : first + 2 * _NEIGHBOURS + 1]
            near = near[known[near]]
            away, sign = near - k, self.sign[near]
            if len(near) <= _COEFFICIENTS:
                continue
            turned = np.stack([np.ones_like(sign), sign, sign * away, sign * away**2], axis=1)
            passing = np.stack([sign, np.ones_like(sign), away, away**2], axis=1)
            squares[:, k] = [
                unexplained_sum_of_squares(turned, self.height[near]) / (len(near) - _COEFFICIENTS),
                # noise shifts an extreme in time inversely to the amplitude
                unexplained_sum_of_squares(passing, self.time[near])
                / (len(near) - _COEFFICIENTS)
                * size[k] ** 2,
            ]
        height, clock = (
            np.sqrt(
                [
                    _mean_of_finite_values(row[max(0, k - _POOLED_NEIGHBOURS) : k + _POOLED_NEIGHBOURS + 1])
                    for k in number
                ]
            )
            for row in squares
        )
        reach = _POOLED_NEIGHBOURS + _NEIGHBOURS
        count = np.array([known[max(0, k - reach) : k + reach + 1].sum() for k in number])
        # a crest that a sensor rounds to one value would have no scatter
        height = np.maximum(height, _MINIMUM_SCATTER * self.rounding)
        return ExtremeScatter(height, clock / size, np.maximum(1, count - _COEFFICIENTS))


class ExtremeScatter(NamedTuple):
    """Standard deviations of the heights [m] and times [s] of extremes, and their degrees of freedom."""

    height: np.ndarray
    time: np.ndarray
    freedom: np.ndarray


def unexplained_sum_of_squares(basis: np.ndarray, values: np.ndarray) -> float:
    """Return the sum of squared residuals of a least-squares fit of a basis (columns) to values."""
    solution, *_ = np.linalg.lstsq(basis, values, rcond=None)
    return float(((basis @ solution - values) ** 2).sum())


def _mean_of_finite_values(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.inf


def find_extremes(record: PistonRecord, *, exact: bool = False) -> Extremes:
    """Find the extremes of a record; ``exact`` is for a solution without noise."""
    time, height = record.time, record.height
    rounding = floor = 0.0
    if not exact:
        rounding = sensor_rounding_step(height)
        noise = noise_standard_deviation(height, time)
        height = _replace_outliers_by_running_median(height, noise)
        floor = max(_HYSTERESIS_NOISES * max(noise, rms_noise_above_motion(time, height)), rounding)
    level = np.full(len(time), height[-len(height) // _LEVEL_PART :].mean())
    for _ in range(2):  # the second time about the equilibrium given by the first extremes
        passages = _equilibrium_passage_times_and_sign(time, height - level, floor)
        extremes = _extremes_between(time, height, passages)
        middle = (extremes.height[:-2] + 2.0 * extremes.height[1:-1] + extremes.height[2:]) / 4.0
        known = np.isfinite(middle)
        if known.sum() < 2:
            break
        level = np.interp(time, extremes.time[1:-1][known], middle[known])
    return dataclasses.replace(extremes, rounding=rounding)


def describe_extreme_mismatch(seen: Extremes, fitted: Extremes) -> str:
    """Describe how the extremes of a record differ from those of a fitted motion; empty if they agree."""
    known = np.isfinite(seen.time)
    times = seen.time[known]
    if not len(times):
        return "the record has no extremes"
    half = float(np.median(np.diff(times))) if len(times) > 1 else math.inf
    others = fitted.time[np.isfinite(fitted.time)]
    within = others[(others > times[0] - 0.5 * half) & (others < times[-1] + 0.5 * half)]
    if len(within) != len(times):
        return (
            f"the record has {len(times)} extremes from {times[0]:.4g} to {times[-1]:.4g} s, "
            f"the fitted motion {len(within)}"
        )
    apart = np.abs(within - times) / np.gradient(within) if len(within) > 1 else np.zeros(1)
    k = int(apart.argmax())
    if apart[k] > _MAXIMUM_SHIFT:
        return (
            f"the extreme at {times[k]:.4g} s is {apart[k]:.2g} half cycles from the fitted motion's extreme"
        )
    return ""


def _replace_outliers_by_running_median(height: np.ndarray, noise: float) -> np.ndarray:
    """Replace single samples far from the running median of five by that median."""
    around = np.pad(height, _MEDIAN_WINDOW // 2, mode="reflect")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(around, _MEDIAN_WINDOW), axis=1)
    usual = float(np.quantile(np.abs(np.diff(medians)), 0.9))
    return np.where(np.abs(height - medians) > _OUTLIER_LIMIT * max(noise, usual), medians, height)


def _equilibrium_passage_times_and_sign(
    time: np.ndarray, away: np.ndarray, floor: float
) -> tuple[np.ndarray, float]:
    """Return the times of the zero crossings, and the sign of the displacement before the first."""
    beyond = np.flatnonzero(np.abs(away) > floor)
    if not len(beyond):
        return np.empty(0), 1.0
    start, count, chunk = int(beyond[0]), len(away), 64
    sign = first = float(np.sign(away[start]))
    passages: list[float] = []
    largest, since = 0.0, start
    while start < count:
        here = sign * away[start : start + chunk]
        tops = np.maximum(np.maximum.accumulate(here), largest)
        turned = np.flatnonzero(-here > np.maximum(floor, _HYSTERESIS_FRACTION * tops))
        if not len(turned):
            largest, start, chunk = float(tops[-1]), start + chunk, 2 * chunk
            continue
        turn = start + int(turned[0])
        width = max(floor, _HYSTERESIS_FRACTION * float(tops[turned[0]]))
        outside = np.flatnonzero(sign * away[since:turn] > width)
        before = since + (int(outside[-1]) if len(outside) else 0)
        inside = slice(before, turn + 1)
        # a line through both ends, since noise may add zeros between them
        part, values = time[inside], away[inside]
        fraction = values[0] / (values[0] - values[-1]) if values[0] != values[-1] else 0.5
        passages.append(float(part[0] + fraction * (part[-1] - part[0])))
        chunk = max(16, 2 * (turn - since))
        sign, largest, start, since = -sign, 0.0, turn, turn
    return np.array(passages), first


def _extremes_between(time: np.ndarray, height: np.ndarray, passages: tuple[np.ndarray, float]) -> Extremes:
    """Find the extremes between zero crossings, and one before the first crossing if it is complete."""
    from scipy.interpolate import make_interp_spline

    times, first = passages
    if len(times) < 2:
        return Extremes(np.empty(0), np.empty(0), np.empty(0))
    halves = np.diff(times)
    if float(np.median(halves)) < _MINIMUM_HALF_CYCLE_SAMPLES * float(np.median(np.diff(time))):
        cycle = 2.0 * np.median(halves) / np.median(np.diff(time))
        raise RecordError(
            f"the record has {cycle:.2g} samples per cycle, but {2.0 * _MINIMUM_HALF_CYCLE_SAMPLES:.2g} are "
            "needed to find its extremes; sample faster"
        )
    sign = -first * (-1.0) ** np.arange(len(halves))
    # Used only with few samples per half cycle.
    spline = functools.cache(lambda: make_interp_spline(time, height, k=5))
    extremes = [
        _time_and_height_of_extreme_near(time, height, spline, 0.5 * (begin + end), end - begin, side)
        for begin, end, side in zip(times[:-1], times[1:], sign, strict=True)
    ]
    early = _time_and_height_of_extreme_near(
        time, height, spline, times[0] - 0.5 * halves[0], halves[0], first
    )
    if math.isfinite(early[0]):
        extremes, sign = [early, *extremes], np.concatenate([[first], sign])
    placed = np.array(extremes)
    return Extremes(placed[:, 0], placed[:, 1], sign)


def _time_and_height_of_extreme_near(
    time: np.ndarray,
    height: np.ndarray,
    spline: Callable[[], Callable[[np.ndarray], np.ndarray]],
    middle: float,
    half: float,
    sign: float,
) -> tuple[float, float]:
    """Return time and height of the extreme near the time ``middle``; NaN if a gap hides the extreme."""
    begin, end = np.searchsorted(time, [middle - half, middle + half])
    usual = 2.0 * half / max(4, end - begin)
    for _ in range(2):  # the second time about the extreme
        low, high = middle - _POLYNOMIAL_HALF_WIDTH * half, middle + _POLYNOMIAL_HALF_WIDTH * half
        first, last = np.searchsorted(time, [low, high])
        slack = 1e-9 * half + usual
        if low < time[0] - slack or high > time[-1] + slack:
            return math.nan, math.nan
        edges = time[max(0, first - 1) : last + 1]
        if len(edges) < 2 or np.diff(edges).max() > max(_GAP_LIMITS[0] * usual, _GAP_LIMITS[1] * half):
            return math.nan, math.nan
        if last - first < _MINIMUM_SAMPLES:
            x = np.linspace(-1.0, 1.0, 2 * _DEGREE + 1)
            values = spline()(middle + _POLYNOMIAL_HALF_WIDTH * half * x)
        else:
            x, values = (time[first:last] - middle) / (_POLYNOMIAL_HALF_WIDTH * half), height[first:last]
        top, value = _position_and_value_of_polynomial_maximum(x, sign * values)
        middle += _POLYNOMIAL_HALF_WIDTH * half * top
    return middle, sign * value


_FINE = np.linspace(-1.0, 1.0, 201)
_POWERS_OF_FINE = np.vander(_FINE, _DEGREE + 1, increasing=True)


def _position_and_value_of_polynomial_maximum(x: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Fit a polynomial to points; return position (from -1 to 1) and value of its maximum."""
    basis = np.vander(x, _DEGREE + 1, increasing=True)
    coefficients, *_ = np.linalg.lstsq(basis, values, rcond=None)
    top = float(_FINE[int((_POWERS_OF_FINE @ coefficients).argmax())])
    power = np.arange(_DEGREE + 1)
    for _ in range(3):  # Newton steps to zero slope
        terms = coefficients[1:] * power[1:] * top ** power[:-1]
        bend = float((coefficients[2:] * power[2:] * power[1:-1]) @ top ** power[:-2])
        if bend < 0.0:
            top = min(max(top - float(terms.sum()) / bend, -1.0), 1.0)
    return top, float(coefficients @ top**power)


def amplitude_remarks(cycles: Envelope, damping_is_known: bool) -> tuple[str, ...]:
    """Remark on an amplitude that falls and rises again, or that does not decay while damping is unknown."""
    size = cycles.amplitude
    if len(size) < _MINIMUM_ROWS:
        return ()
    mean = np.convolve(size, np.ones(3) / 3.0, mode="valid")
    least = np.minimum.accumulate(mean)
    top = int((mean / least).argmax())
    bottom = int(mean[: top + 1].argmin())
    rise = mean[top] - mean[bottom]
    fallen, risen = mean[bottom] / mean[: bottom + 1].max(), mean[top] / mean[: bottom + 1].max()
    if (
        mean[top] > _RISE_RATIO * mean[bottom]
        and rise > _HYSTERESIS_NOISES * cycles.amplitude_noise.max()
        and fallen < _DECAY_RATIO
    ):
        return (
            f"the amplitude falls to {fallen:.2g} of its first value and rises again to {risen:.2g}, "
            "perhaps because two modes beat; filter out one mode, or fit the part in which one mode has "
            "decayed (--between T:T)",
        )
    damping, error = cycles._logarithmic_decay_and_half_interval(slice(None))
    if damping > error or damping_is_known:
        return ()
    grows = damping < -error
    return (
        f"the amplitude {'grows' if grows else 'does not fall'} between {cycles.time[0]:.4g} and "
        f"{cycles.time[-1]:.4g} s; if the motion is driven, the fitted frequency and damping ratio are "
        "not the natural ones: record the force in a column and give its name (identify --input NAME)",
    )
