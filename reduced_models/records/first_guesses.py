"""Guess equilibrium, amplitude, frequency, decay rate and initial motion from a record."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from granular.shared.array_types import Float
from granular.shared.errors import RecordError
from reduced_models.records.derivatives import (
    noise_standard_deviation,
    rms_noise_above_motion,
    spectral_peak_frequency,
)

LEAST_SAMPLES = 20
MAXIMUM_HEIGHT, MINIMUM_AMPLITUDE = 1e12, 1e-18
"""Maximum height and minimum amplitude [m], so that squares and cubes neither overflow nor underflow."""
MAXIMUM_TIME, MINIMUM_TIME = 1e12, 1e-12
"""Limits of the duration [s], so that squares and cubes of times neither overflow nor underflow."""
_PADDING, _MAXIMUM_PEAKS = 8, 6  # of a spectrum: zero-padding factor, and maximum number of lines
MINIMUM_CROSSINGS = 3
"""Minimum number of zero crossings; with fewer, frequency and equilibrium are poorly determined."""
_DISTINCT_LOG_RATIO = 0.05  # difference of logarithms of clearly different frequencies
_MAXIMUM_RIVAL_RATIO = 8.0  # maximum ratio of a rival frequency to the estimate, or of the estimate to it
_HUM_FACTOR = 3.0  # rms values of hum (twice its crest) that the motion must exceed for a crossing
_MINIMUM_SAMPLES_PER_HALF = 2.5  # samples between crossings below which a spectrum gives the frequency better
# Half-widths of the logarithm of starting frequencies. 15 % is a third of a cycle after the first two cycles
# of a search, within the valley of the right minimum; with fewer than three crossings, a factor of six.
_SPREAD, _SPREAD_IF_POOR = 0.15, math.log(6.0)
_LINEAR_SAMPLES, _LINEAR_GRID = 2000, 16
"""With few zero crossings, a linear motion is fitted to at most 2000 samples, with 16 x 16 start values."""
_LINEAR_MISFIT = 0.1  # residual, in standard deviations of the height, above which the motion is not linear


@dataclasses.dataclass(frozen=True)
class FirstGuesses:
    """First guesses of the parameters of a record's motion, from `first_guesses`.

    For an angle, read rad for m.

    Attributes
    ----------
    rest, amplitude : float
        Mean level of the last third of the record, and the maximum displacement from it [m].
    frequency, decay : float
        Angular frequency [rad/s] and decay rate [1/s] of the oscillation about this level, above 0.
    height, velocity : float
        Initial height [m] and velocity [m/s].
    crossings : int
        Number of zero crossings of the displacement from equilibrium.
    rivals : tuple of float
        Alternative angular frequencies [rad/s], if they clearly differ from ``frequency``: the frequency of
        the first cycles, whose amplitude may be larger, and the frequency of the strongest spectral line.
    fastest : float
        Half the sampling rate, as an angular frequency [rad/s].
    time, heights : float64 (n,)
        Times [s] from 0 on and heights [m] of the record.
    given : mapping of str to float
        Known parameters of the law, in their units.
    """

    rest: float
    amplitude: float
    frequency: float
    decay: float
    height: float
    velocity: float
    crossings: int
    rivals: tuple[float, ...] = ()
    fastest: float = math.inf
    time: Float[np.ndarray, "n"] = dataclasses.field(default_factory=lambda: np.empty(0), compare=False)
    heights: Float[np.ndarray, "n"] = dataclasses.field(default_factory=lambda: np.empty(0), compare=False)
    given: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def is_poor(self) -> bool:
        """True if guesses are poor because the displacement has fewer than three zero crossings."""
        return self.crossings < MINIMUM_CROSSINGS

    @property
    def log_frequency_spread(self) -> float:
        """Half-width of the range of log(starting frequency): 0.15, or log(6) if guesses are poor."""
        return _SPREAD_IF_POOR if self.is_poor else _SPREAD

    @property
    def period(self) -> float:
        """Period of the oscillation [s], 2 pi divided by the angular frequency."""
        return 2.0 * math.pi / self.frequency

    @property
    def shortest_start_period(self) -> float:
        """Shortest period [s] among all start values of a search, including alternative frequencies."""
        return self.shortest_cycle_period * math.exp(-self.log_frequency_spread)

    @property
    def shortest_cycle_period(self) -> float:
        """Shortest period [s] among the estimate and the alternative frequencies."""
        return 2.0 * math.pi / max(self.frequency, *self.rivals, 0.0)

    def draw_frequencies(self, random: np.random.Generator, count: int) -> np.ndarray:
        """Draw starting frequencies, log-uniform about the estimate and each alternative in turn.

        Parameters
        ----------
        random : numpy.random.Generator
            Source of the random numbers.
        count : int
            Number of draws, 0 or more.

        Returns
        -------
        float64 (count,)
            Angular frequencies [rad/s], within a factor exp(`log_frequency_spread`) of the estimate or an
            alternative.

        Raises
        ------
        ValueError
            If the number is negative.
        """
        spread = self.log_frequency_spread
        about = np.resize([self.frequency, *self.rivals], count)
        drawn = about * np.exp(self._zero_first_deviation_if_poor(random.uniform(-spread, spread, count)))
        # frequencies beyond half the sampling rate are mirrored below it
        return np.asarray(np.where(drawn < self.fastest, drawn, self.fastest**2 / drawn))

    def _zero_first_deviation_if_poor(self, drawn: np.ndarray) -> np.ndarray:
        """Set the first of the drawn deviations to 0 if guesses are poor, so that the estimate is tried."""
        return drawn * (np.arange(len(drawn)) > 0) if self.is_poor else drawn

    def draw_rest_levels(self, random: np.random.Generator, count: int) -> np.ndarray:
        """Draw starting equilibrium heights, uniform about the estimate.

        Parameters
        ----------
        random : numpy.random.Generator
            Source of the random numbers.
        count : int
            Number of draws, 0 or more.

        Returns
        -------
        float64 (count,)
            Heights [m]. They differ from the estimate by at most a tenth of the amplitude or, if guesses
            are poor, by at most the amplitude.

        Raises
        ------
        ValueError
            If the number is negative.
        """
        spread = 1.0 if self.is_poor else 0.1
        drawn = self._zero_first_deviation_if_poor(random.uniform(-spread, spread, count))
        return np.asarray(self.rest + self.amplitude * drawn)

    def draw_decay_rates(self, random: np.random.Generator, count: int) -> np.ndarray:
        """Draw starting decay rates, log-uniform about the estimate.

        Parameters
        ----------
        random : numpy.random.Generator
            Source of the random numbers.
        count : int
            Number of draws, 0 or more.

        Returns
        -------
        float64 (count,)
            Rates [1/s], within a factor exp(1.5) of the estimate.

        Raises
        ------
        ValueError
            If the number is negative.
        """
        drawn = self._zero_first_deviation_if_poor(random.uniform(-1.5, 1.5, count))
        return np.asarray(self.decay * np.exp(drawn))


def zero_crossing_times(
    time: Float[np.ndarray, "n"], displacement: Float[np.ndarray, "n"], threshold: float
) -> Float[np.ndarray, "k"]:
    """Return times [s] of zero crossings between displacements larger than a threshold."""
    beyond = np.flatnonzero(np.abs(displacement) > threshold)
    if len(beyond) < 2:
        return np.empty(0)
    sign = np.sign(displacement[beyond])
    turns = np.flatnonzero(sign[1:] != sign[:-1])
    before, after = beyond[turns], beyond[turns + 1]
    fraction = displacement[before] / (displacement[before] - displacement[after])
    return np.asarray(time[before] + fraction * (time[after] - time[before]))


def first_guesses(time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"]) -> FirstGuesses:
    """Guess the parameters of a recorded motion; ``time`` is in s, ``height`` in m or rad."""
    time = time - time[0]
    if len(time) < LEAST_SAMPLES:
        raise RecordError(
            f"the record has {len(time)} samples to fit; {LEAST_SAMPLES} or more are needed to "
            "identify a law; sample faster, or hold out less"
        )
    largest = float(np.abs(height).max())
    if largest > MAXIMUM_HEIGHT:
        raise RecordError(
            f"the record has heights up to {largest:g} m, but the maximum is {MAXIMUM_HEIGHT:g} m; "
            "check the units"
        )
    if not MINIMUM_TIME <= time[-1] <= MAXIMUM_TIME:
        raise RecordError(
            f"the record lasts {time[-1]:g} s, but it must last {MINIMUM_TIME:g} to {MAXIMUM_TIME:g} s; "
            "check the units"
        )
    rest = float(height[-len(height) // 3 :].mean())
    displacement = height - rest
    amplitude = float(np.abs(displacement).max())
    if amplitude <= max(1e-12 * abs(rest), MINIMUM_AMPLITUDE):
        raise RecordError(f"the height stays at {rest:g} m; give a record of a motion to identify a law")
    noise = max(
        4.0 * noise_standard_deviation(height, time), _HUM_FACTOR * rms_noise_above_motion(time, height)
    )
    threshold = min(max(0.01 * amplitude, noise), 0.5 * amplitude)
    passages = zero_crossing_times(time, displacement, threshold)
    half = _estimate_half_period(passages, float(time[-1]))
    # With few samples between zero crossings, the times of the crossings are inaccurate.
    if half < _MINIMUM_SAMPLES_PER_HALF * float(np.median(np.diff(time))):
        half = math.pi / spectral_peak_frequency(time, displacement)
    frequency = math.pi / half
    start, speed = _estimate_initial_height_and_velocity(time, height, half)
    decay = _estimate_decay_rate(time, displacement, half)
    rivals = _alternative_frequencies(time, displacement, passages, frequency)
    fastest = math.pi / float(np.median(np.diff(time)))
    motion = (rest, amplitude, frequency, decay, start, speed)
    guess = FirstGuesses(*motion, len(passages), rivals, fastest, time, height)
    return _guess_from_linear_motion(time, height, guess) if guess.is_poor else guess


def _guess_from_linear_motion(time: np.ndarray, height: np.ndarray, guess: FirstGuesses) -> FirstGuesses:
    """Guess the parameters of a motion with few zero crossings from the linear motion that fits best.

    Equilibrium, initial height and initial velocity follow from linear least squares, so the search varies
    only decay rate and frequency. An overdamped motion is a sum of two exponentials.
    """
    from scipy.optimize import least_squares

    every = max(1, len(time) // _LINEAR_SAMPLES)
    time, height = time[::every], height[::every]
    duration, step = float(time[-1]), float(np.median(np.diff(time)))

    def residuals_and_coefficients(logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        decay, omega = np.exp(logs)
        root = np.sqrt(complex(decay**2 - omega**2)) or 1e-9 * decay
        # for unit initial displacement and for unit initial velocity
        fast, slow = (np.exp((sign * root - decay) * time) for sign in (-1.0, 1.0))
        displaced = 0.5 * (fast + slow) + 0.5 * decay * (slow - fast) / root
        basis = np.stack([np.ones_like(time), displaced.real, (0.5 * (slow - fast) / root).real], axis=1)
        solution, *_ = np.linalg.lstsq(basis, height, rcond=None)
        return basis @ solution - height, solution

    decays = np.geomspace(0.2 / duration, 0.5 / step, _LINEAR_GRID)
    omegas = np.geomspace(0.5 / duration, 1.0 / step, _LINEAR_GRID)
    grid = np.log([(decay, omega) for decay in decays for omega in omegas])
    costs = [float((residuals_and_coefficients(logs)[0] ** 2).sum()) for logs in grid]
    solution = least_squares(
        lambda logs: residuals_and_coefficients(logs)[0] / guess.amplitude, grid[int(np.argmin(costs))]
    )
    misfit, (rest, initial_displacement, speed) = residuals_and_coefficients(solution.x)
    reach = float(np.ptp(height))
    if misfit.std() > _LINEAR_MISFIT * height.std() or not abs(rest - height.mean()) < 2.0 * reach:
        return guess
    decay, frequency = np.exp(solution.x)
    return dataclasses.replace(
        guess,
        rest=float(rest),
        frequency=float(frequency),
        decay=float(decay),
        height=float(rest + initial_displacement),
        velocity=float(speed),
    )


def _alternative_frequencies(
    time: np.ndarray, displacement: np.ndarray, passages: np.ndarray, frequency: float
) -> tuple[float, ...]:
    """Return frequencies of the first cycles and the spectral peak that clearly differ from the estimate."""
    if len(passages) <= MINIMUM_CROSSINGS:
        return ()
    early = math.pi / float(np.diff(passages[: 2 * MINIMUM_CROSSINGS]).mean())
    result: list[float] = []
    for rival in (early, spectral_peak_frequency(time, displacement)):
        log_ratios = [abs(math.log(rival / other)) for other in (frequency, *result)]
        if min(log_ratios) > _DISTINCT_LOG_RATIO and max(log_ratios) < math.log(_MAXIMUM_RIVAL_RATIO):
            result.append(rival)
    return tuple(result)


def _estimate_half_period(passages: np.ndarray, duration: float) -> float:
    """Estimate half a period from the times of the zero crossings."""
    if len(passages) > 1:
        return float(np.median(np.diff(passages)))
    if len(passages) == 1:
        return 2.0 * float(passages[0])
    return 0.5 * duration


def _estimate_initial_height_and_velocity(
    time: np.ndarray, height: np.ndarray, half: float
) -> tuple[float, float]:
    """Estimate initial height and velocity from a parabola fitted to the first part of the motion."""
    count = max(4, int(np.searchsorted(time, 0.1 * half)))
    first = slice(0, min(count, len(time)))
    line = np.polynomial.Polynomial.fit(time[first], height[first], 2).convert()
    return float(line(0.0)), float(line.deriv()(0.0))


def _estimate_decay_rate(time: np.ndarray, displacement: np.ndarray, half: float) -> float:
    """Estimate the decay rate from the maximum displacements in successive half periods."""
    edges = half * np.floor(time / half)
    first = np.flatnonzero(np.diff(edges, prepend=-1.0))
    first = first[edges[first] < time[-1]]
    middle = edges[first] + 0.5 * half
    peak = np.maximum.reduceat(np.abs(displacement), first)
    above_noise = peak > 0.02 * peak.max()
    if above_noise.sum() < 2:
        return 1.0 / float(time[-1])
    line = np.polynomial.Polynomial.fit(middle[above_noise], np.log(peak[above_noise]), 1).convert()
    # If all peaks are equal, the polynomial has no slope.
    slope = -line.coef[1] if len(line.coef) > 1 else 0.0
    return float(np.clip(slope, 0.01 / time[-1], math.pi / half))


def spectral_peak_frequencies(
    time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "k"]:
    """Angular frequencies [rad/s] of the strongest lines of a record's spectrum; ``time`` is in s."""
    count = len(time)
    even = np.interp(np.linspace(time[0], time[-1], count), time, height)
    window = np.hanning(count)
    # Padding resolves a line to a small fraction of its width.
    power = np.abs(np.fft.rfft(window * (even - np.average(even, weights=window)), _PADDING * count)) ** 2
    peaks = 1 + np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:]))
    strongest = peaks[np.argsort(-power[peaks])][:_MAXIMUM_PEAKS]
    return np.asarray(2.0 * np.pi * strongest * (count - 1) / (_PADDING * count * (time[-1] - time[0])))
