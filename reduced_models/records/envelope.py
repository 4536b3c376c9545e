"""The envelope of a free oscillation: amplitude, frequency and damping, half cycle by half cycle.

An extreme lies between two passages through equilibrium. A passage counts once the motion is beyond
that by more than the noise, the sensor's rounding and a fifth of its amplitude, so that neither noise nor
a second mode makes an extreme of its own. Every three extremes in a row make one cycle; its amplitude,
its frequency and the rate at which the amplitude falls, plotted over the amplitude, are the backbone and
damping curves of the oscillator (Londono, Neild & Cooper 2015, doi:10.1016/j.jsv.2015.02.003). They need
no law.
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
from reduced_models.records.derivatives import noise_faster_than_motion, noise_level, rounding_step

__all__ = ["Envelope", "envelope"]

_CONFIDENCE = 0.975  # quantile of a half-width of 95 %
LEAST_EXTREMES = 5
_FEWEST_ROWS = 10  # cycles, half a period apart, from which on an amplitude is said not to fall
_RISES, _FALLS = 1.3, 0.8
"""Amplitude over the smallest one before it that is a rise, and over the largest one that is a fall."""
_NOISES, _FRACTION = 5.0, 0.2
"""Hysteresis of a passage, in standard deviations of the noise (of a rise too), and over the amplitude."""
_REACH = 0.3  # of the time between passages, to either side of an extreme, that its polynomial sees
_DEGREE = 4
_FEWEST = 10  # samples of a polynomial; with fewer it sees a spline between them
_FEWEST_A_HALF = 2.2  # samples between two passages, without which no spline tells the extreme
_HOLE = 2.5, 0.25  # usual steps, and part of the time between passages: a hole that hides an extreme
_LEVEL_PART = 3  # of the record, at its end, whose mean is the first equilibrium
_APART = 0.2  # half cycles by which an extreme may miss that of a fitted motion
_NEIGHBOURS, _POOL, _TERMS = 3, 6, 4
"""Extremes to either side in a parabola, of those whose squares are averaged, and its coefficients."""
_ROUNDED = 0.15  # of the sensor's step, that an extreme scatters at least: half of 1/sqrt(12)
_WINDOW, _FAR = 5, 5.0  # samples about each one, and noise levels, from which on it is an outlier


@dataclasses.dataclass(frozen=True)
class PeakDamping:
    """Damping ratios that a record's own peaks show."""

    mean: float
    low: float  # of the whole record and of its halves
    high: float
    noise: float  # largest error of the mean by the record's noise

    def contradicts(self, ratio: float) -> bool:
        """Return whether a damping ratio is far from those of the peaks."""
        low = min(0.5 * self.low, 2.0 * self.low) - self.noise
        high = max(0.5 * self.high, 2.0 * self.high) + self.noise
        return not low <= ratio <= high


@dataclasses.dataclass(frozen=True, eq=False)
class Envelope:
    """The envelope of a record, one row a cycle.

    Attributes
    ----------
    time : float64 (n,)
        Time of each cycle's middle extreme [s].
    level : float64 (n,)
        Level about which the height swings [m].
    amplitude, frequency, damping : float64 (n,)
        Half the swing [m]; angular frequency [rad/s]; rate at which the logarithm of the amplitude
        falls [1/s] (negative where the swing grows).
    amplitude_noise, frequency_noise : float64 (n,)
        Standard deviations [m] and [rad/s], by the scatter of the extremes.
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
    def peak_damping(self) -> PeakDamping:
        """Damping ratios, without unit, by how the peaks fall, of the whole record and of its two halves."""
        half = len(self.amplitude) // 2
        parts = (slice(None), slice(half + 1), slice(half, None))
        (total, error), *halves = (self._logarithmic_slope(part) for part in parts)
        ratios = [ratio for ratio, _ in halves]
        largest = max(error, *(error for _, error in halves))
        return PeakDamping(total, min(total, *ratios), max(total, *ratios), largest)

    def _logarithmic_slope(self, part: slice) -> tuple[float, float]:
        """Fall of the logarithm of the amplitude [1/rad], and half of its 95 % interval by the scatter."""
        from scipy.stats import t

        phase, size = self.phase[part], self.amplitude[part]
        basis = np.stack([size, size * phase], axis=1)  # logarithms scatter by one over the amplitude
        slope = float(np.linalg.lstsq(basis, size * np.log(size), rcond=None)[0][1])
        # successive cycles share two of three extremes
        freedom = max(1.0, 0.5 * len(size) - 2.0)
        variance = residual_square(basis, size * np.log(size)) / freedom
        sure = float(t.ppf(_CONFIDENCE, freedom))
        return -slope, sure * math.sqrt(variance * float(np.linalg.pinv(basis.T @ basis)[1, 1]))

    @property
    def damping_ratio(self) -> np.ndarray:
        """Damping ratio of each cycle, float64 (n,), without unit: decay rate over angular frequency."""
        return self.damping / self.frequency


def envelope(record: PistonRecord) -> Envelope:
    """Find amplitude, frequency and damping of a record's swing in the course of time.

    From every three successive extremes, as by the logarithmic decrement (Londono, Neild & Cooper 2015,
    doi:10.1016/j.jsv.2015.02.003).

    Parameters
    ----------
    record : PistonRecord
        Swinging motion.

    Returns
    -------
    Envelope
        Amplitude [m], angular frequency [rad/s] and decay rate [1/s] of each cycle, (n,) each.

    Raises
    ------
    RecordError
        If fewer than five extremes stand out of the noise.

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
    """Amplitude [m], angular frequency [rad/s] and decay rate [1/s] of each cycle, from its extremes."""
    check_extremes(extremes)
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


def check_extremes(extremes: Extremes) -> None:
    """Refuse a record of which too few cycles are seen."""
    cycles = np.isfinite(extremes.height[:-2] + extremes.height[1:-1] + extremes.height[2:]).sum()
    if cycles < LEAST_EXTREMES - 2:
        seen = int(np.isfinite(extremes.height).sum())
        raise RecordError(
            f"{seen} extremes of the height stand out of the noise; at least "
            f"{LEAST_EXTREMES} in turn are needed for an envelope: record longer, or with less noise"
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Extremes:
    """Crests and troughs of an oscillation in turn, half a cycle apart; NaN if a hole hides one."""

    time: Float[np.ndarray, "k"]  # [s]
    height: Float[np.ndarray, "k"]  # [m]
    sign: Float[np.ndarray, "k"]  # 1 for a crest, -1 for a trough
    rounding: float = 0.0  # step of the sensor [m]; 0 if it does not round

    def __len__(self) -> int:
        return len(self.time)

    def scatter(self) -> Scatter:
        """Scatter about local parabolas of amplitude and time: all noise counts, of whatever kind."""
        number = np.arange(len(self))
        known = np.isfinite(self.height)
        size = np.abs(self.height - np.nanmean(self.height))
        squares = np.full((2, len(self)), np.nan)
        for k in range(len(self)):
            first = min(max(0, k - _NEIGHBOURS), max(0, len(self) - 2 * _NEIGHBOURS - 1))
            near = number[first : first + 2 * _NEIGHBOURS + 1]
            near = near[known[near]]
            away, sign = near - k, self.sign[near]
            if len(near) <= _TERMS:
                continue
            turned = np.stack([np.ones_like(sign), sign, sign * away, sign * away**2], axis=1)
            passing = np.stack([sign, np.ones_like(sign), away, away**2], axis=1)
            squares[:, k] = [
                residual_square(turned, self.height[near]) / (len(near) - _TERMS),
                # noise moves an extreme in time by one over the amplitude
                residual_square(passing, self.time[near]) / (len(near) - _TERMS) * size[k] ** 2,
            ]
        height, clock = (
            np.sqrt([_mean_if_any(row[max(0, k - _POOL) : k + _POOL + 1]) for k in number]) for row in squares
        )
        reach = _POOL + _NEIGHBOURS
        count = np.array([known[max(0, k - reach) : k + reach + 1].sum() for k in number])
        # a top that a sensor rounds to one number scatters by nothing
        height = np.maximum(height, _ROUNDED * self.rounding)
        return Scatter(height, clock / size, np.maximum(1, count - _TERMS))


class Scatter(NamedTuple):
    """Standard deviations of the heights [m] and times [s] of extremes, and their degrees of freedom."""

    height: np.ndarray
    time: np.ndarray
    freedom: np.ndarray


def residual_square(basis: np.ndarray, values: np.ndarray) -> float:
    """Sum of the squared residuals of the columns of a basis fitted to values."""
    solution, *_ = np.linalg.lstsq(basis, values, rcond=None)
    return float(((basis @ solution - values) ** 2).sum())


def _mean_if_any(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.inf


def find_extremes(record: PistonRecord, *, exact: bool = False) -> Extremes:
    """Find the extremes of a record, or of an exact solution, which has no noise."""
    time, height = record.time, record.height
    rounding = floor = 0.0
    if not exact:
        rounding = rounding_step(height)
        noise = noise_level(height, time)
        height = _without_outliers(height, noise)
        floor = max(_NOISES * max(noise, noise_faster_than_motion(time, height)), rounding)
    level = np.full(len(time), height[-len(height) // _LEVEL_PART :].mean())
    for _ in range(2):  # the second time about the equilibrium that the first extremes show
        passages = _passages(time, height - level, floor)
        extremes = _extremes_between(time, height, passages)
        middle = (extremes.height[:-2] + 2.0 * extremes.height[1:-1] + extremes.height[2:]) / 4.0
        known = np.isfinite(middle)
        if known.sum() < 2:
            break
        level = np.interp(time, extremes.time[1:-1][known], middle[known])
    return dataclasses.replace(extremes, rounding=rounding)


def extremes_apart(seen: Extremes, fitted: Extremes) -> str:
    """Return words on how extremes of a record differ from those of a fitted motion; empty if they agree."""
    known = np.isfinite(seen.time)
    times = seen.time[known]
    if not len(times):
        return "the record shows no extremes"
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
    if apart[k] > _APART:
        return f"the extreme at {times[k]:.4g} s is {apart[k]:.2g} half cycles off the fitted motion's"
    return ""


def _without_outliers(height: np.ndarray, noise: float) -> np.ndarray:
    """Heights with the median of five in place of single samples far off it."""
    around = np.pad(height, _WINDOW // 2, mode="reflect")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(around, _WINDOW), axis=1)
    usual = float(np.quantile(np.abs(np.diff(medians)), 0.9))
    return np.where(np.abs(height - medians) > _FAR * max(noise, usual), medians, height)


def _passages(time: np.ndarray, away: np.ndarray, floor: float) -> tuple[np.ndarray, float]:
    """Return the times of the passages through equilibrium, and the sign of the motion before the first."""
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
        turned = np.flatnonzero(-here > np.maximum(floor, _FRACTION * tops))
        if not len(turned):
            largest, start, chunk = float(tops[-1]), start + chunk, 2 * chunk
            continue
        turn = start + int(turned[0])
        width = max(floor, _FRACTION * float(tops[turned[0]]))
        outside = np.flatnonzero(sign * away[since:turn] > width)
        before = since + (int(outside[-1]) if len(outside) else 0)
        inside = slice(before, turn + 1)
        # the line through all samples between, of which noise may make several zeros
        part, values = time[inside], away[inside]
        fraction = values[0] / (values[0] - values[-1]) if values[0] != values[-1] else 0.5
        passages.append(float(part[0] + fraction * (part[-1] - part[0])))
        chunk = max(16, 2 * (turn - since))
        sign, largest, start, since = -sign, 0.0, turn, turn
    return np.array(passages), first


def _extremes_between(time: np.ndarray, height: np.ndarray, passages: tuple[np.ndarray, float]) -> Extremes:
    """Extremes between two passages each, and the one before the first if it is seen from both sides."""
    from scipy.interpolate import make_interp_spline

    times, first = passages
    if len(times) < 2:
        return Extremes(np.empty(0), np.empty(0), np.empty(0))
    halves = np.diff(times)
    if float(np.median(halves)) < _FEWEST_A_HALF * float(np.median(np.diff(time))):
        cycle = 2.0 * np.median(halves) / np.median(np.diff(time))
        raise RecordError(
            f"the record has {cycle:.2g} samples a cycle, and {2.0 * _FEWEST_A_HALF:.2g} are needed to see "
            "its extremes: sample faster"
        )
    sign = -first * (-1.0) ** np.arange(len(halves))
    # Of few samples a half cycle alone.
    spline = functools.cache(lambda: make_interp_spline(time, height, k=5))
    extremes = [
        _extreme_about(time, height, spline, 0.5 * (begin + end), end - begin, side)
        for begin, end, side in zip(times[:-1], times[1:], sign, strict=True)
    ]
    early = _extreme_about(time, height, spline, times[0] - 0.5 * halves[0], halves[0], first)
    if math.isfinite(early[0]):
        extremes, sign = [early, *extremes], np.concatenate([[first], sign])
    placed = np.array(extremes)
    return Extremes(placed[:, 0], placed[:, 1], sign)


def _extreme_about(
    time: np.ndarray,
    height: np.ndarray,
    spline: Callable[[], Callable[[np.ndarray], np.ndarray]],
    middle: float,
    half: float,
    sign: float,
) -> tuple[float, float]:
    """Time and height of the extreme about a time, half a cycle wide; not a number if a hole hides it."""
    begin, end = np.searchsorted(time, [middle - half, middle + half])
    usual = 2.0 * half / max(4, end - begin)
    for _ in range(2):  # the second time about the extreme
        low, high = middle - _REACH * half, middle + _REACH * half
        first, last = np.searchsorted(time, [low, high])
        slack = 1e-9 * half + usual
        if low < time[0] - slack or high > time[-1] + slack:
            return math.nan, math.nan
        edges = time[max(0, first - 1) : last + 1]
        if len(edges) < 2 or np.diff(edges).max() > max(_HOLE[0] * usual, _HOLE[1] * half):
            return math.nan, math.nan
        if last - first < _FEWEST:
            x = np.linspace(-1.0, 1.0, 2 * _DEGREE + 1)
            values = spline()(middle + _REACH * half * x)
        else:
            x, values = (time[first:last] - middle) / (_REACH * half), height[first:last]
        top, value = _polynomial_top(x, sign * values)
        middle += _REACH * half * top
    return middle, sign * value


_FINE = np.linspace(-1.0, 1.0, 201)
_POWERS_OF_FINE = np.vander(_FINE, _DEGREE + 1, increasing=True)


def _polynomial_top(x: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Place, from -1 to 1, and value of the maximum of a polynomial through points."""
    basis = np.vander(x, _DEGREE + 1, increasing=True)
    coefficients, *_ = np.linalg.lstsq(basis, values, rcond=None)
    top = float(_FINE[int((_POWERS_OF_FINE @ coefficients).argmax())])
    power = np.arange(_DEGREE + 1)
    for _ in range(3):  # Newton's steps to where the slope is zero
        terms = coefficients[1:] * power[1:] * top ** power[:-1]
        bend = float((coefficients[2:] * power[2:] * power[1:-1]) @ top ** power[:-2])
        if bend < 0.0:
            top = min(max(top - float(terms.sum()) / bend, -1.0), 1.0)
    return top, float(coefficients @ top**power)


def amplitude_remarks(cycles: Envelope, damping_is_known: bool) -> tuple[str, ...]:
    """Say if an amplitude falls and rises, or does not fall and no damping by a law explains it."""
    size = cycles.amplitude
    if len(size) < _FEWEST_ROWS:
        return ()
    mean = np.convolve(size, np.ones(3) / 3.0, mode="valid")
    least = np.minimum.accumulate(mean)
    top = int((mean / least).argmax())
    bottom = int(mean[: top + 1].argmin())
    rise = mean[top] - mean[bottom]
    fallen, risen = mean[bottom] / mean[: bottom + 1].max(), mean[top] / mean[: bottom + 1].max()
    if (
        mean[top] > _RISES * mean[bottom]
        and rise > _NOISES * cycles.amplitude_noise.max()
        and fallen < _FALLS
    ):
        return (
            f"the amplitude falls to {fallen:.2g} of its first value and rises again to {risen:.2g}: "
            "two modes? Filter one of them out, or fit what follows once one has died away (--between T:T)",
        )
    damping, error = cycles._logarithmic_slope(slice(None))
    if damping > error or damping_is_known:
        return ()
    grows = damping < -error
    return (
        f"the amplitude {'grows' if grows else 'does not fall'} from {cycles.time[0]:.4g} to "
        f"{cycles.time[-1]:.4g} s: driven? Then frequency and damping ratio are not the oscillator's own; "
        "record the force in a column and give it (identify --input NAME)",
    )
