"""Find a second mode in a free decay from its spectral line, and confirm it by a fit of both modes.

A decay of one mode may have a frequency that changes with the amplitude, harmonics, hum and a drift.
A second mode is distinguished from these by three conditions:

- The residual of two damped cosines is clearly smaller than the residual of a single cosine whose frequency
  changes with the amplitude.
- The second mode decays.
- The second mode exceeds the noise at its frequency.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from granular.shared.array_types import Float
from granular.shared.errors import GranularError
from reduced_models.records.first_guesses import first_guesses, spectral_peak_frequencies

_MOST_SAMPLES = 4000  # number of samples in a fit: if there are more, they are averaged
_STANDS_OUT = 12.0
"""Minimum ratio of a mode's energy to the energy that a fit of four parameters to pure noise would remove.
Noise alone gives ratios up to about 3."""
_ALIVE = 3.0  # decay times in which a mode is observed (or the record, if shorter)
_CYCLES = 2.0  # cycles of a mode in that time: with fewer it is a drift
_BEATS = 0.9  # minimum phase difference, in cycles, that two modes gain in that time
_STEADY = 0.8  # ratio of final to initial amplitude above which a line is hum or a drive
_NEARLY_STEADY = 0.5  # ratio above which it is one too, unless its decay is certain
_CERTAIN_DECAY = 9.0 * 12.0
"""A decay is certain if (decrease of log amplitude)^2 energy/noise is above this value: the decrease is then
larger than three standard errors."""
_HARMONIC = 0.02  # relative distance of a line from a multiple of the frequency
_MULTIPLES = (2, 3, 4, 5)
_LARGE = 0.15  # fraction of the amplitude above which a line is not a harmonic
_UNEXPLAINED = 0.5  # excess, over the gain, of a law's mean squared residual over the modes'
_LEFT = 0.05
"""Maximum of R/S, where R is the residual energy near the first mode, and S the residual energy removed by
the second mode. A larger ratio shows that the decay is nonlinear."""
_LOCAL = 0.3  # half-width of the band of a mode's noise, as a fraction of its frequency
_DAMPINGS = (0.3, 1.0, 3.0)  # multiples of the first mode's damping that are tried for the second mode
_BESIDE = (-0.3, -0.2, -0.13, -0.08, -0.05, 0.05, 0.08, 0.13, 0.2, 0.3)
"""Relative distances from the first mode's frequency at which a hidden second mode is tried."""
_REFINED = 4  # number of trials that are refined


class SecondMode(NamedTuple):
    """A second mode of a free decay."""

    frequency: float  # [Hz]
    damping_ratio: float
    fraction: float  # amplitude as a fraction of the sum of both amplitudes at the start
    first_frequency: float  # [Hz]
    residual: float  # rms residual of both modes [m, or the record's unit]
    gain: float  # decrease of the mean squared residual by the second mode, in that unit squared

    def is_in_residual_of_law(self, law_residual: float) -> bool:
        """Return whether a law's residual contains the mode; ``law_residual`` is the rms residual [m]."""
        return law_residual**2 - self.residual**2 > _UNEXPLAINED * self.gain

    @property
    def text(self) -> str:
        """Sentence that describes the mode and gives the remedy."""
        return (
            f"a second mode at {self.frequency:.4g} Hz has {100.0 * self.fraction:.2g} % of the amplitude at "
            f"the start (first mode: {self.first_frequency:.4g} Hz); fit both: identify --coordinates 2"
        )


class TwoModes(NamedTuple):
    """Two damped cosines fitted to a decay."""

    frequencies: tuple[float, float]  # angular frequencies of the damped motion [rad/s]
    decay_rates: tuple[float, float]  # [1/s]
    amplitudes: tuple[complex, complex]  # of exp((i frequency - decay rate) t), whose real part is taken [m]
    level: float  # equilibrium [m]


def find_second_mode(time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"]) -> SecondMode | None:
    """Find the second mode of a free decay; None if the decay has only one mode; ``time`` is in s."""
    return _find_second_mode(time.tobytes(), height.tobytes())


@functools.lru_cache(maxsize=4)  # every law of a record is compared with it
def _find_second_mode(times: bytes, heights: bytes) -> SecondMode | None:
    time, height = np.frombuffer(times), np.frombuffer(heights)
    try:
        pair, single = _fit_one_and_two_modes(time, height)
    except GranularError:
        return None
    decay = DampedCosines(time, height)
    squares = min(float((decay.one_mode_residuals(vector) ** 2).sum()) for vector in single)
    return decay.weaker_mode(pair, squares)


def fit_two_modes(time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"]) -> TwoModes:
    """Fit two damped cosines to a decay; ``time`` is in s, ``height`` in m."""
    (pair, _), decay = _fit_one_and_two_modes(time, height), DampedCosines(time, height)
    factors = decay.residuals_and_factors(decay.two_mode_columns(pair))[1]
    amplitudes = [complex(factors[k], -factors[k + 1]) for k in (0, 2)]
    return TwoModes(
        (float(pair[0]), float(pair[2])),
        (float(pair[1]), float(pair[3])),
        (amplitudes[0], amplitudes[1]),
        float(height.mean() + (decay.slow @ factors[4:]).mean()),
    )


def _fit_one_and_two_modes(time: np.ndarray, height: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Fit two modes, then one mode without and one with a chirp (frequency shift); return all parameters."""
    guess = first_guesses(time, height)
    decay = DampedCosines(*interpolate_or_average_to_even_times(time, height))
    start = np.array([guess.frequency, min(guess.decay, 0.5 * guess.frequency), 0.0])
    chirped = decay.refine_one_mode(start, chirp=True)
    single = decay.refine_one_mode(np.array([chirped[0], chirped[1], 0.0]), chirp=False)
    lines = [
        *spectral_peak_frequencies(decay.time, decay.one_mode_residuals(single)),
        *(single[0] * (1.0 + by) for by in _BESIDE),
    ]
    trials = [
        np.array([*single[:2], line, factor * single[1]])
        for line in lines
        for factor in _DAMPINGS
        if line > 0.0
    ]
    costs = [float((decay.two_mode_residuals(trial) ** 2).sum()) for trial in trials]
    best = [decay.refine_two_modes(trials[k]) for k in np.argsort(costs)[:_REFINED]]
    pair = min(best, key=lambda vector: float((decay.two_mode_residuals(vector) ** 2).sum()))
    return pair, [single, chirped]


def interpolate_or_average_to_even_times(
    time: np.ndarray, height: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate a record to even times; average its samples if there are many."""
    even = np.linspace(time[0], time[-1], len(time))
    height = np.interp(even, time, height)
    every = max(1, len(time) // _MOST_SAMPLES)
    count = len(time) // every * every
    return even[:count].reshape(-1, every).mean(1) - even[0], height[:count].reshape(-1, every).mean(1)


class DampedCosines:
    """Fits of damped cosines plus a slow drift to a record."""

    def __init__(self, time: np.ndarray, height: np.ndarray, slow_degree: int = 3) -> None:
        self.time, self.height = time - time[0], height - height.mean()
        self.duration = float(self.time[-1])
        self.slow = np.polynomial.chebyshev.chebvander(2.0 * self.time / self.duration - 1.0, slow_degree)

    def mode_columns(self, frequency: float, decay: float, chirp: float = 0.0) -> np.ndarray:
        """Columns (n, 2) of one mode: decaying cosine and sine of the phase."""
        faded = np.exp(np.clip(-decay * self.time, -50.0, 2.0))
        phase = frequency * self.time
        if chirp:
            phase = phase + chirp * (1.0 - faded**2)
        return np.stack([faded * np.cos(phase), faded * np.sin(phase)], axis=1)

    def two_mode_columns(self, pair: np.ndarray) -> np.ndarray:
        """Columns (n, 4) of two modes; ``pair`` has frequency and decay rate of each."""
        return np.hstack([self.mode_columns(*pair[:2]), self.mode_columns(*pair[2:])])

    def residuals_and_factors(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fit columns (n, k) and a slow drift; return residuals (n,) and the fitted factors."""
        basis = np.hstack([columns, self.slow])
        factors = np.linalg.lstsq(basis, self.height, rcond=1e-10)[0]
        return self.height - basis @ factors, factors

    def one_mode_residuals(self, vector: np.ndarray) -> np.ndarray:
        """Residuals (n,) of one mode; ``vector`` has frequency, decay rate and amplitude-dependent phase."""
        return self.residuals_and_factors(self.mode_columns(*vector))[0]

    def two_mode_residuals(self, vector: np.ndarray) -> np.ndarray:
        """Residuals (n,) of two modes; ``vector`` has frequency and decay rate of each."""
        return self.residuals_and_factors(self.two_mode_columns(vector))[0]

    def refine_one_mode(self, start: np.ndarray, *, chirp: bool) -> np.ndarray:
        """Fit frequency, decay rate and chirp of one mode by least squares."""
        from scipy.optimize import least_squares

        count = 3 if chirp else 2
        scale = np.array([1.0 / self.duration, 1.0 / self.duration, 1.0])[:count]
        solution = least_squares(
            lambda x: self.one_mode_residuals(np.append(x, start[count:])),
            start[:count],
            x_scale=scale,
            max_nfev=40,
        )
        return np.append(solution.x, start[count:])

    def refine_two_modes(self, start: np.ndarray) -> np.ndarray:
        """Fit frequencies and decay rates of two modes by least squares."""
        from scipy.optimize import least_squares

        solution = least_squares(
            self.two_mode_residuals, start, x_scale=np.full(4, 1.0 / self.duration), max_nfev=60
        )
        return np.asarray(solution.x)

    def weaker_mode(self, pair: np.ndarray, squares: float) -> SecondMode | None:
        """Return the weaker of two modes if it decays and exceeds the noise; None otherwise."""
        left, factors = self.residuals_and_factors(self.two_mode_columns(pair))
        sizes = np.hypot(factors[[0, 2]], factors[[1, 3]])
        parts = [slice(2 * k, 2 * k + 2) for k in (0, 1)]
        motions = [self.mode_columns(*pair[part]) @ factors[part] for part in parts]
        order = (0, 1) if motions[0] @ motions[0] >= motions[1] @ motions[1] else (1, 0)
        (first, first_decay), (frequency, decay) = (pair[parts[k]] for k in order)
        frequency, first = abs(float(frequency)), abs(float(first))
        if not (frequency > 0.0 and first > 0.0 and decay > 0.0):
            return None
        alive = min(self.duration, _ALIVE / max(decay, first_decay, 1e-300))
        if frequency * min(self.duration, _ALIVE / decay) < 2.0 * math.pi * _CYCLES:
            return None
        if abs(frequency - first) * alive < 2.0 * math.pi * _BEATS:
            return None
        if math.exp(-decay * self.duration) > _STEADY:
            return None
        fraction = float(sizes[order[1]] / sizes.sum())
        multiple = any(abs(frequency / (factor * first) - 1.0) < _HARMONIC for factor in _MULTIPLES)
        if multiple and fraction < _LARGE:
            return None
        gain = squares - float((left**2).sum())
        power, near = self._spectrum_and_mask(left, frequency)
        noise = max(float(power[near].mean()) if near.any() else 0.0, float(np.median(power)), 1e-300)
        decrease = decay * self.duration
        uncertain = math.exp(-decrease) > _NEARLY_STEADY and decrease**2 * gain < _CERTAIN_DECAY * noise
        if gain < 4.0 * _STANDS_OUT * noise or uncertain:
            return None
        power, near = self._spectrum_and_mask(left, first)
        if 2.0 * float(power[near].sum()) > _LEFT * gain:
            return None
        turn, count = 2.0 * math.pi, len(left)
        return SecondMode(
            frequency / turn,
            float(decay) / math.hypot(frequency, decay),
            fraction,
            first / turn,
            math.sqrt(float((left**2).mean())),
            gain / count,
        )

    def _spectrum_and_mask(self, left: np.ndarray, frequency: float) -> tuple[np.ndarray, np.ndarray]:
        """Return half the energy of each spectral line of residuals, and a mask of lines near a frequency."""
        window = np.hanning(len(left))
        power = np.abs(np.fft.rfft(left * window)) ** 2 / (window**2).sum()
        lines = 2.0 * math.pi * np.fft.rfftfreq(len(left), self.duration / (len(left) - 1))
        return power, np.abs(lines / frequency - 1.0) <= _LOCAL
