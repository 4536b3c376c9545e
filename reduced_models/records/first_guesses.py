"""First guesses from a record: rest level, amplitude, frequency, decay, and the initial motion."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from granular.shared.array_types import Float
from granular.shared.errors import RecordError
from reduced_models.records.derivatives import noise_faster_than_motion, noise_level, spectral_peak_frequency

LEAST_SAMPLES = 20
LARGEST, SMALLEST = 1e12, 1e-18
"""Greatest height, and least swing [m]; squares and cubes stay far from overflow and from zero."""
LONGEST, SHORTEST = 1e12, 1e-12
"""Limits of times [s], likewise: thirty thousand years, and a sound's time through an atom."""
_PADDING, _MOST_PEAKS = 8, 6  # of a spectrum: points between its own, and lines that are told
LEAST_CROSSINGS = 3
"""Passages through rest below which frequency and rest level are hardly better than guesses."""
_APART = 0.05  # of logarithms of frequencies that are clearly others
_FARTHEST = 8.0  # times the frequency, or a part of it: a rival further away is none
_FAST_NOISES = 3.0  # root mean squares of hum, twice its crest, that a passage must exceed
_FEW_SAMPLES = 2.5  # samples between two passages, below which a spectrum tells the frequency better
# Half-widths of the logarithm of starting frequencies. 15 % is a third of a cycle after the two that a search
# sees first, within the valley of the right one; with fewer than three passages, a factor of six.
_SPREAD, _SPREAD_IF_POOR = 0.15, math.log(6.0)
_LINEAR_SAMPLES, _LINEAR_GRID = 2000, 16
"""Samples that a linear motion of few passages is fitted to at most, and rates that are tried first."""
_LINEAR_MISFIT = 0.1  # of the height's deviation: a motion that it leaves more of is not linear


@dataclasses.dataclass(frozen=True)
class FirstGuesses:
    """First guesses of the parameters of a record's motion, as `first_guesses` makes them.

    Of an angle [rad] stands for [m].

    Attributes
    ----------
    rest, amplitude : float
        Mean level of the last third of the record, and the greatest distance from it [m].
    frequency, decay : float
        Angular frequency [rad/s] and decay rate [1/s] of the swing about it, above 0.
    height, velocity : float
        Height [m] and velocity [m/s] at the start.
    crossings : int
        Passages through the level of rest that were counted.
    rivals : tuple of float
        Other angular frequencies [rad/s], where they are clearly others: that of the first swings,
        which may be larger than the later ones, and the strongest one in the spectrum.
    fastest : float
        Half the sampling rate, as an angular frequency [rad/s].
    time, heights : float64 (n,)
        Times [s] from 0 on and heights [m] of the record.
    given : mapping of str to float
        Parameters of the law that are known, in their units.
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
        """True where fewer than three passages through rest are seen, so that guesses are poor."""
        return self.crossings < LEAST_CROSSINGS

    @property
    def log_frequency_spread(self) -> float:
        """Half-width of the natural logarithm of the starting frequencies: 0.15, or ln 6 if poor."""
        return _SPREAD_IF_POOR if self.is_poor else _SPREAD

    @property
    def period(self) -> float:
        """Period of the swing [s], 2 pi over its angular frequency."""
        return 2.0 * math.pi / self.frequency

    @property
    def shortest_start_period(self) -> float:
        """Shortest period of all motions that a search may start from, rivals included [s]."""
        return self.shortest_cycle_period * math.exp(-self.log_frequency_spread)

    @property
    def shortest_cycle_period(self) -> float:
        """Period of the quickest swing, that of the rivals included [s]."""
        return 2.0 * math.pi / max(self.frequency, *self.rivals, 0.0)

    def draw_frequencies(self, random: np.random.Generator, count: int) -> np.ndarray:
        """Random starting frequencies, log-uniform about the estimate and its rivals in turn.

        Parameters
        ----------
        random : numpy.random.Generator
            Source of the random numbers.
        count : int
            Number of draws, 0 or more.

        Returns
        -------
        float64 (count,)
            Angular frequencies [rad/s], within a factor exp(`log_frequency_spread`) of these.

        Raises
        ------
        ValueError
            If the number is negative.
        """
        spread = self.log_frequency_spread
        about = np.resize([self.frequency, *self.rivals], count)
        drawn = about * np.exp(self._spread_from_first(random.uniform(-spread, spread, count)))
        # beyond half the sampling rate lies the mirror image of what is below
        return np.asarray(np.where(drawn < self.fastest, drawn, self.fastest**2 / drawn))

    def _spread_from_first(self, drawn: np.ndarray) -> np.ndarray:
        """Spread of starts; the first is the estimate itself, if few passages leave a wide one."""
        return drawn * (np.arange(len(drawn)) > 0) if self.is_poor else drawn

    def draw_rest_levels(self, random: np.random.Generator, count: int) -> np.ndarray:
        """Random starting levels of rest, uniform about the estimate.

        Parameters
        ----------
        random : numpy.random.Generator
            Source of the random numbers.
        count : int
            Number of draws, 0 or more.

        Returns
        -------
        float64 (count,)
            Levels [m], within a tenth of the amplitude, or the amplitude where guesses are poor.

        Raises
        ------
        ValueError
            If the number is negative.
        """
        spread = 1.0 if self.is_poor else 0.1
        drawn = self._spread_from_first(random.uniform(-spread, spread, count))
        return np.asarray(self.rest + self.amplitude * drawn)

    def draw_decay_rates(self, random: np.random.Generator, count: int) -> np.ndarray:
        """Random starting decay rates, log-uniform about the estimate.

        Parameters
        ----------
        random : numpy.random.Generator
            Source of the random numbers.
        count : int
            Number of draws, 0 or more.

        Returns
        -------
        float64 (count,)
            Rates [1/s], within a factor exp(1.5).

        Raises
        ------
        ValueError
            If the number is negative.
        """
        drawn = self._spread_from_first(random.uniform(-1.5, 1.5, count))
        return np.asarray(self.decay * np.exp(drawn))


def zero_crossing_times(
    time: Float[np.ndarray, "n"], swing: Float[np.ndarray, "n"], threshold: float
) -> Float[np.ndarray, "k"]:
    """Return the times [s] at which a swing passes zero, each counted once it is beyond a threshold."""
    beyond = np.flatnonzero(np.abs(swing) > threshold)
    if len(beyond) < 2:
        return np.empty(0)
    sign = np.sign(swing[beyond])
    turns = np.flatnonzero(sign[1:] != sign[:-1])
    before, after = beyond[turns], beyond[turns + 1]
    fraction = swing[before] / (swing[before] - swing[after])
    return np.asarray(time[before] + fraction * (time[after] - time[before]))


def first_guesses(time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"]) -> FirstGuesses:
    """First guesses of the parameters of a recorded swing; time [s], height [m, rad]."""
    time = time - time[0]
    if len(time) < LEAST_SAMPLES:
        raise RecordError(
            f"the record has {len(time)} samples to fit; at least {LEAST_SAMPLES} are needed to "
            "identify a law: sample faster, or hold out less"
        )
    largest = float(np.abs(height).max())
    if largest > LARGEST:
        raise RecordError(
            f"the record has heights up to {largest:g} m, and {LARGEST:g} m is the most that can "
            "be computed with: check the units"
        )
    if not SHORTEST <= time[-1] <= LONGEST:
        raise RecordError(
            f"the record lasts {time[-1]:g} s, and {SHORTEST:g} to {LONGEST:g} s can be computed "
            "with: check the units"
        )
    rest = float(height[-len(height) // 3 :].mean())
    swing = height - rest
    amplitude = float(np.abs(swing).max())
    if amplitude <= max(1e-12 * abs(rest), SMALLEST):
        raise RecordError(f"the height stays at {rest:g} m; a motion is needed to identify a law")
    noise = max(4.0 * noise_level(height, time), _FAST_NOISES * noise_faster_than_motion(time, height))
    threshold = min(max(0.01 * amplitude, noise), 0.5 * amplitude)
    passages = zero_crossing_times(time, swing, threshold)
    half = _half_period(passages, float(time[-1]))
    if half < _FEW_SAMPLES * float(np.median(np.diff(time))):  # passages between samples are guesses
        half = math.pi / spectral_peak_frequency(time, swing)
    frequency = math.pi / half
    start, speed = _initial_motion(time, height, half)
    decay = _decay_rate(time, swing, half)
    rivals = _alternative_frequencies(time, swing, passages, frequency)
    fastest = math.pi / float(np.median(np.diff(time)))
    motion = (rest, amplitude, frequency, decay, start, speed)
    guess = FirstGuesses(*motion, len(passages), rivals, fastest, time, height)
    return _without_oscillation(time, height, guess) if guess.is_poor else guess


def _without_oscillation(time: np.ndarray, height: np.ndarray, guess: FirstGuesses) -> FirstGuesses:
    """Guesses of a motion of few passages through rest, from the linear motion that fits it best.

    Its level and its first height and velocity are linear in the record, so that decay rate and frequency
    alone are searched for: of a creep back to rest they are those of two exponentials.
    """
    from scipy.optimize import least_squares

    every = max(1, len(time) // _LINEAR_SAMPLES)
    time, height = time[::every], height[::every]
    duration, step = float(time[-1]), float(np.median(np.diff(time)))

    def fitted(logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        decay, omega = np.exp(logs)
        root = np.sqrt(complex(decay**2 - omega**2)) or 1e-9 * decay
        # of height and velocity 1 at the start
        fast, slow = (np.exp((sign * root - decay) * time) for sign in (-1.0, 1.0))
        displaced = 0.5 * (fast + slow) + 0.5 * decay * (slow - fast) / root
        basis = np.stack([np.ones_like(time), displaced.real, (0.5 * (slow - fast) / root).real], axis=1)
        solution, *_ = np.linalg.lstsq(basis, height, rcond=None)
        return basis @ solution - height, solution

    decays = np.geomspace(0.2 / duration, 0.5 / step, _LINEAR_GRID)
    omegas = np.geomspace(0.5 / duration, 1.0 / step, _LINEAR_GRID)
    grid = np.log([(decay, omega) for decay in decays for omega in omegas])
    costs = [float((fitted(logs)[0] ** 2).sum()) for logs in grid]
    solution = least_squares(lambda logs: fitted(logs)[0] / guess.amplitude, grid[int(np.argmin(costs))])
    left, (rest, away, speed) = fitted(solution.x)
    reach = float(np.ptp(height))
    if left.std() > _LINEAR_MISFIT * height.std() or not abs(rest - height.mean()) < 2.0 * reach:
        return guess
    decay, frequency = np.exp(solution.x)
    return dataclasses.replace(
        guess,
        rest=float(rest),
        frequency=float(frequency),
        decay=float(decay),
        height=float(rest + away),
        velocity=float(speed),
    )


def _alternative_frequencies(
    time: np.ndarray, swing: np.ndarray, passages: np.ndarray, frequency: float
) -> tuple[float, ...]:
    """Frequencies of the first swings and of the spectrum's peak, where they are clearly others."""
    if len(passages) <= LEAST_CROSSINGS:
        return ()
    early = math.pi / float(np.diff(passages[: 2 * LEAST_CROSSINGS]).mean())
    result: list[float] = []
    for rival in (early, spectral_peak_frequency(time, swing)):
        apart = [abs(math.log(rival / other)) for other in (frequency, *result)]
        if min(apart) > _APART and max(apart) < math.log(_FARTHEST):
            result.append(rival)
    return tuple(result)


def _half_period(passages: np.ndarray, duration: float) -> float:
    """Half a period from the passages through the level of rest."""
    if len(passages) > 1:
        return float(np.median(np.diff(passages)))
    if len(passages) == 1:
        return 2.0 * float(passages[0])
    return 0.5 * duration


def _initial_motion(time: np.ndarray, height: np.ndarray, half: float) -> tuple[float, float]:
    """Height and velocity at the start, from a parabola through the first part of the swing."""
    count = max(4, int(np.searchsorted(time, 0.1 * half)))
    first = slice(0, min(count, len(time)))
    line = np.polynomial.Polynomial.fit(time[first], height[first], 2).convert()
    return float(line(0.0)), float(line.deriv()(0.0))


def _decay_rate(time: np.ndarray, swing: np.ndarray, half: float) -> float:
    """Slope of the logarithm of the greatest swing in each half period."""
    edges = half * np.floor(time / half)
    first = np.flatnonzero(np.diff(edges, prepend=-1.0))
    first = first[edges[first] < time[-1]]
    middle = edges[first] + 0.5 * half
    peak = np.maximum.reduceat(np.abs(swing), first)
    lively = peak > 0.02 * peak.max()
    if lively.sum() < 2:
        return 1.0 / float(time[-1])
    line = np.polynomial.Polynomial.fit(middle[lively], np.log(peak[lively]), 1).convert()
    # Where all peaks are equal, the slope is left out.
    slope = -line.coef[1] if len(line.coef) > 1 else 0.0
    return float(np.clip(slope, 0.01 / time[-1], math.pi / half))


def spectral_peaks(time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"]) -> Float[np.ndarray, "k"]:
    """Angular frequencies [rad/s] of the strongest lines of a record's spectrum; time [s]."""
    count = len(time)
    even = np.interp(np.linspace(time[0], time[-1], count), time, height)
    window = np.hanning(count)
    # Padding resolves a line to a small fraction of its width.
    power = np.abs(np.fft.rfft(window * (even - np.average(even, weights=window)), _PADDING * count)) ** 2
    peaks = 1 + np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:]))
    strongest = peaks[np.argsort(-power[peaks])][:_MOST_PEAKS]
    return np.asarray(2.0 * np.pi * strongest * (count - 1) / (_PADDING * count * (time[-1] - time[0])))
