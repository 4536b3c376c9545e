"""Smooth a record and differentiate it; estimate its noise and the noise of the derivatives.

For a given window the estimator is linear in the heights. The window is the widest for which the
smoothing residual is not larger than the record's noise (discrepancy principle, Morozov 1966). A record
without noise is therefore hardly smoothed at all.
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

NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal variable."""
_MINIMUM_STEP = 1e-9  # fraction of the range: finer steps are floating-point rounding
# Minimum number of steps of a rounding sensor; a signal of two or three levels is switched.
_MINIMUM_STEPS = 5
_STEP_TOLERANCE = 0.01  # tolerance, in steps, for heights of a rounding sensor to be multiples of the step
_FAST_RATIO = 1.7  # multiple of the motion's frequency above which a component is not part of the motion
_MINIMUM_CYCLES = 6.0  # number of cycles in a Hann window that separates the line of the motion
_EVEN_TOLERANCE = 0.01  # tolerance, in time steps, for samples to count as evenly spaced in a spectrum
LEAST_SAMPLES = 20
_DEGREE = 5  # degree of the local polynomials
# One degree of freedom more than the six coefficients of a quintic.
_MINIMUM_WINDOW = 7
_WINDOW_FRACTION = 0.8  # fraction of the widest window that the discrepancy principle allows
_RESIDUAL_SIGMAS = 4.0  # standard errors by which the mean square smoothing residual may exceed the noise
_PROBE_SAMPLES = 20_000
_BATCH = 4096

# Of local cubics:
# In periods. A cubic over this half-window underestimates the acceleration of a cosine by 4 % and its height
# by 0.1 %. With 0.2 the errors are 11 % and 0.9 %; with 0.06 only 1 %, but the noise is sqrt(2^5) times
# larger.
_HALF_WINDOW = 0.12
_MINIMUM_WINDOW_SAMPLES = 6  # minimum number of samples in a window
_MINIMUM_TIMES = 8  # minimum number of times of a motion
_WINDOWS_IN_MEMORY = 2**16  # maximum number of window samples in memory
_EIGENVALUE_CUT_OFF = 1e-13  # fraction of the largest eigenvalue below which there is only rounding error

Smoother = Callable[[np.ndarray], np.ndarray]
"""Function that turns heights (m, n) of m records into height, velocity and acceleration (m, 3, n)."""


class Derivatives(NamedTuple):
    """Smoothed heights of a record, their derivatives and their noise."""

    time: Float[np.ndarray, "n"]  # [s]
    height: Float[np.ndarray, "n"]  # [m]
    velocity: Float[np.ndarray, "n"]  # [m/s]
    acceleration: Float[np.ndarray, "n"]  # [m/s^2]
    width: float  # [s]
    record_noise: float  # [m]
    acceleration_noise: float  # [m/s^2], due to the record's noise, without the bias of smoothing


def derivatives(record: PistonRecord) -> Derivatives:
    """Smooth a record and differentiate it twice by local polynomials (Savitzky & Golay 1964)."""
    if len(record) < LEAST_SAMPLES:
        raise RecordError(
            f"the record has {len(record)} samples; {LEAST_SAMPLES} or more are needed to "
            "differentiate it; sample faster or longer"
        )
    time, height = record.time, record.height
    sigma = noise_standard_deviation(height, time)
    smoother, width = _choose_smoother_and_width(time, height, sigma)
    smooth, velocity, acceleration = smoother(height[None])[0]
    gain = (
        _known_noise_gain if isinstance(smoother, _SavitzkyGolayFilter) else _rms_acceleration_of_unit_noise
    )
    noise = sigma * gain(smoother, len(time))
    return Derivatives(time, smooth, velocity, acceleration, width, sigma, noise)


def _rms_acceleration_of_unit_noise(smoother: Smoother, count: int) -> float:
    """Rms acceleration that a smoother returns for white noise of unit variance, away from the ends."""
    random = np.random.default_rng(0)
    probes = max(1, _PROBE_SAMPLES // count)
    inner = slice(count // 4, count - count // 4)
    smoothed = smoother(random.normal(size=(probes, count)))
    return math.sqrt(np.mean([(outputs[2, inner] ** 2).mean() for outputs in smoothed]))


_known_noise_gain = functools.lru_cache(maxsize=64)(_rms_acceleration_of_unit_noise)
"""Version of `_rms_acceleration_of_unit_noise` that caches its results, since every fit needs them."""


# Local polynomials -----------------------------------------------------------------------------


def _choose_smoother_and_width(time: np.ndarray, height: np.ndarray, sigma: float) -> tuple[Smoother, float]:
    even, step = is_evenly_sampled(time), float(time[-1] - time[0]) / (len(time) - 1)

    def smooth(window: int) -> np.ndarray:
        if even:
            return _SavitzkyGolayFilter(step, window).filter_heights(height, 0)
        return np.asarray(_polynomials_at_uneven_times(height[None], time, window)[0, 0])

    longest = max(_MINIMUM_WINDOW, (len(time) // 3) | 1)
    chosen = _MINIMUM_WINDOW
    limit = 1.0 + _RESIDUAL_SIGMAS * np.sqrt(2.0 / len(time))
    window = _MINIMUM_WINDOW
    while window <= longest:
        smoothing_residual = height - smooth(window)
        # A local fit retains this fraction of the noise, its central weight.
        retained = _central_smoother_weight(window)
        # Discrepancy principle (Morozov 1966): stop when the smoothing residual exceeds the noise.
        if (smoothing_residual**2).mean() > limit * sigma**2 * (1.0 - retained):
            break
        chosen = window
        window = max(window + 2, int(window * 1.25) | 1)
    # The widest window removes as much of the motion as of the noise; a narrower one preserves the motion.
    chosen = max(_MINIMUM_WINDOW, int(_WINDOW_FRACTION * chosen) | 1)
    if even:
        return _SavitzkyGolayFilter(step, chosen), chosen * step
    smoother = functools.partial(_polynomials_at_uneven_times, time=time, window=chosen)
    return smoother, chosen * step


def is_evenly_sampled(time: Float[np.ndarray, "n"]) -> bool:
    """Return whether times [s] are evenly spaced, to a thousandth of a step."""
    steps = np.diff(time)
    return bool(np.ptp(steps) < 1e-3 * steps.mean())


@functools.cache
def _central_smoother_weight(window: int) -> float:
    position = np.linspace(-1.0, 1.0, window)
    basis, _ = np.linalg.qr(np.vander(position, _DEGREE + 1))
    return float((basis[window // 2] ** 2).sum())


@dataclasses.dataclass(frozen=True)
class _SavitzkyGolayFilter:
    """Local polynomials on evenly spaced times."""

    step: float
    window: int

    def __call__(self, heights: np.ndarray) -> np.ndarray:
        return np.stack([self.filter_heights(heights, order) for order in range(3)], axis=1)

    def filter_heights(self, height: np.ndarray, order: int) -> np.ndarray:
        """Return smoothed heights, or a derivative of the smoothed heights."""
        from scipy.signal import savgol_filter

        result = savgol_filter(height, self.window, _DEGREE, deriv=order, delta=self.step)
        return np.asarray(result)


def _polynomials_at_uneven_times(heights: np.ndarray, time: np.ndarray, window: int) -> np.ndarray:
    count = len(time)
    first = np.clip(np.arange(count) - window // 2, 0, count - window)
    out = np.empty((len(heights), 3, count))
    for start in range(0, count, _BATCH):
        here = np.arange(start, min(start + _BATCH, count))
        inside = first[here, None] + np.arange(window)
        away = time[inside] - time[here, None]
        reach = np.abs(away).max(axis=1)
        powers = (away / reach[:, None])[:, :, None] ** np.arange(_DEGREE + 1)
        basis, triangle = np.linalg.qr(powers)
        for k, height in enumerate(heights):
            projected = np.einsum("nwp,nw->np", basis, height[inside])
            result = np.linalg.solve(triangle, projected[:, :, None])[:, :, 0]
            out[k][:, here] = result[:, 0], result[:, 1] / reach, 2.0 * result[:, 2] / reach**2
    return out


# Local cubics ----------------------------------------------------------------------------------


def fit_local_cubics(
    time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"], period: float, nodes: np.ndarray | int
) -> Float[np.ndarray, "4 m"]:
    """Fit local cubics; return height [m], velocity [m/s], acceleration [m/s^2] and time [s] at nodes."""
    half = min(_HALF_WINDOW * period, 0.1 * float(time[-1] - time[0]))
    if isinstance(nodes, int):
        nodes = np.linspace(time[0] + half, time[-1] - half, nodes)
    positions = np.clip(nodes, time[0] + half, time[-1] - half)
    first, last = (np.searchsorted(time, positions + side * half) for side in (-1.0, 1.0))
    usable = (last - first >= _MINIMUM_WINDOW_SAMPLES) & np.concatenate([[True], np.diff(positions) > 0.0])
    if usable.sum() < _MINIMUM_TIMES:  # too few samples per period: differences of the samples
        speed = np.gradient(height, time)
        return np.stack([height, speed, np.gradient(speed, time), time])
    level, slope, bend = np.empty((3, int(usable.sum())))
    sizes = (last - first)[usable]
    for size in np.unique(sizes):
        equal_windows = np.flatnonzero(sizes == size)
        for here in np.array_split(equal_windows, 1 + size * len(equal_windows) // _WINDOWS_IN_MEMORY):
            inside = first[usable][here, None] + np.arange(size)
            shifted = (time[inside] - positions[usable][here, None]) / half
            level[here], slope[here], bend[here] = _cubic_coefficients(shifted, height[inside])
    return np.stack([level, slope / half, 2.0 * bend / half**2, positions[usable]])


def _cubic_coefficients(position: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Fit cubics to points (m, n) from -1 to 1; return their first three coefficients (3, m)."""
    from numpy.polynomial.legendre import legvander

    # Legendre polynomials are nearly orthogonal there; the pseudo-inverse is for samples that
    # are crowded in a part of the window.
    basis = legvander(position, 3)
    transposed = basis.transpose(0, 2, 1)
    inverse = np.linalg.pinv(transposed @ basis, _EIGENVALUE_CUT_OFF, hermitian=True)
    a, b, c, d = (inverse @ (transposed @ height[:, :, None]))[:, :, 0].T
    return np.stack([a - 0.5 * c, b - 1.5 * d, 1.5 * c])


# Noise -----------------------------------------------------------------------------------------


def sensor_rounding_step(height: Float[np.ndarray, "n"]) -> float:
    """Return the rounding step of a sensor, in the unit of the heights; 0 if it does not round."""
    levels = np.unique(height)
    gaps = np.diff(levels)
    gaps = gaps[gaps > _MINIMUM_STEP * float(np.ptp(height))]
    if len(gaps) < _MINIMUM_STEPS:
        return 0.0
    step = float(gaps.min())
    steps = gaps / step
    return step if np.abs(steps - np.round(steps)).max() < _STEP_TOLERANCE else 0.0


def noise_standard_deviation(height: Float[np.ndarray, "n"], time: Float[np.ndarray, "n"]) -> float:
    """Return the standard deviation of a record's noise, white or due to rounding, in the record's unit."""
    if len(height) < 4:
        return 0.0
    white = min(_noise_by_differences(height, time), _noise_by_spectrum(height, time))
    # Rounding errors are uniform over a step: step/sqrt(12).
    return max(white, sensor_rounding_step(height) / math.sqrt(12.0))


def _noise_by_differences(height: np.ndarray, time: np.ndarray) -> float:
    """Estimate white noise on a smooth record from its third differences."""
    # Divided differences of a smooth motion are small at uneven times too; each is scaled to unit noise. The
    # median is insensitive to outliers.
    quadruples = np.lib.stride_tricks.sliding_window_view(height, 4)
    times = np.lib.stride_tricks.sliding_window_view(time, 4)
    times = (times - times[:, :1]) / (times[:, 3:] - times[:, :1])
    weights = 1.0 / (times[:, :, None] - times[:, None, :] + np.eye(4)).prod(axis=2)
    weights /= np.sqrt((weights**2).sum(axis=1, keepdims=True))
    return float(np.median(np.abs((quadruples * weights).sum(axis=1))) / NORMAL_MEDIAN)


def _noise_by_spectrum(height: np.ndarray, time: np.ndarray) -> float:
    """Estimate white noise from the median of a spectrum; infinite for uneven samples.

    With few samples per cycle, the motion dominates the differences of heights. In the spectrum it is
    only a line, which does not affect the median.
    """
    steps = np.diff(time)
    if np.ptp(steps) > _EVEN_TOLERANCE * float(steps.mean()):
        return math.inf
    window = np.hanning(len(height) + 2)[1:-1]
    away = height - height.mean()
    largest = float(np.abs(away).max()) or 1.0  # squares of heights may overflow or underflow
    power = np.abs(np.fft.rfft(away / largest * window)) ** 2 / (window**2).sum()
    return largest * math.sqrt(float(np.median(power)) / math.log(2.0))


def rms_noise_above_motion(time: np.ndarray, height: np.ndarray) -> float:
    """Return the rms of components above 1.7 times the motion's frequency; 0 for fewer than six cycles.

    A Hann window is applied. With twelve cycles or more, only the second half of the record is used, to
    exclude the harmonics of the initial, larger motion.
    """
    count = len(time)
    even = np.interp(np.linspace(time[0], time[-1], count), time, height)
    frequency = spectral_peak_frequency(time, height - height.mean())
    cycles = frequency * float(time[-1] - time[0]) / math.tau
    if cycles < _MINIMUM_CYCLES:
        return 0.0
    late = even[count // 2 :] if cycles >= 2.0 * _MINIMUM_CYCLES else even
    window = np.hanning(len(late))
    spectrum = np.fft.rfft((late - np.average(late, weights=window)) * window)
    lines = np.arange(len(spectrum)) / len(late) * count / cycles  # over the motion's frequency
    spectrum[lines < _FAST_RATIO] = 0.0
    return float(np.sqrt((np.fft.irfft(spectrum, len(late)) ** 2).sum() / (window**2).sum()))


def spectral_peak_frequency(time: Float[np.ndarray, "n"], displacement: Float[np.ndarray, "n"]) -> float:
    """Angular frequency [rad/s] of the strongest spectral line of a displacement; ``time`` is in s."""
    # A Hann window against leakage, fourfold zero padding against the coarse grid of a short record.
    count = len(time)
    even = np.interp(np.linspace(time[0], time[-1], count), time, displacement)
    spectrum = np.abs(np.fft.rfft((even - even.mean()) * np.hanning(count), 4 * count))
    peak = max(4, int(spectrum.argmax()))  # one complete cycle or more
    return 2.0 * math.pi * peak * (count - 1) / (4 * count * float(time[-1] - time[0]))
