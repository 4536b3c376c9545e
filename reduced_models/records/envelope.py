"""The envelope of a free swing: amplitude, frequency and damping, half swing by half swing.

Every three extremes in a row make one cycle of the motion. Its amplitude, its frequency and the
rate at which the amplitude falls, plotted over the amplitude, are the backbone and damping curves
of the oscillator (Londono, Neild & Cooper 2015, doi:10.1016/j.jsv.2015.02.003); they need neither a
law nor a level of rest.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from granular.run.piston_record import PistonRecord
from granular.shared.errors import RecordError
from reduced_models.records.derivatives import DerivativeMethod, Derivatives, derivatives

if TYPE_CHECKING:
    from jaxtyping import Float

__all__ = ["Envelope", "envelope"]

_NOISE_TIMES = 5.0  # a half swing must exceed so many standard deviations of the smoothed height
_LEAST_SHARE = 1e-4  # and this fraction of the greatest one
LEAST_EXTREMES = 5


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
        Standard deviations [m] and [rad/s] that the record's noise leaves.
    """

    time: np.ndarray
    level: np.ndarray
    amplitude: np.ndarray
    frequency: np.ndarray
    damping: np.ndarray
    amplitude_noise: np.ndarray
    frequency_noise: np.ndarray

    @property
    def peak_damping(self) -> PeakDamping:
        """Damping ratios, without unit, by how the peaks fall, of the whole record and of its two halves."""
        half = len(self.amplitude) // 2
        # From one row to the next passes half a period.
        phase, size = math.pi * np.arange(len(self.amplitude)), np.log(self.amplitude)
        parts = (slice(None), slice(half + 1), slice(half, None))
        total, *halves = (-float(np.polyfit(phase[part], size[part], 1)[0]) for part in parts)
        noise = float(np.max(self.amplitude_noise / self.amplitude) / phase[-1])
        return PeakDamping(total, min(total, *halves), max(total, *halves), noise)

    @property
    def damping_ratio(self) -> np.ndarray:
        """Damping ratio of each cycle, float64 (n,), without unit: decay rate over angular frequency."""
        return self.damping / self.frequency


def envelope(record: PistonRecord, derivative: DerivativeMethod = "savitzky-golay") -> Envelope:
    """Find amplitude, frequency and damping of a record's swing in the course of time.

    From every three successive extremes, as by the logarithmic decrement (Londono, Neild & Cooper 2015,
    doi:10.1016/j.jsv.2015.02.003).

    Parameters
    ----------
    record : PistonRecord
        Swinging motion.
    derivative : str
        Estimator that finds the extremes, see `derivatives`.

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
    smooth = derivatives(record, derivative)
    time, height, times_noise = find_alternating_extremes(smooth)
    if len(time) < LEAST_EXTREMES:
        raise RecordError(
            f"{len(time)} extremes of the height stand out of the noise; at least "
            f"{LEAST_EXTREMES} are needed for an envelope: record longer, or with less noise"
        )
    before, here, after = height[:-2], height[1:-1], height[2:]
    amplitude = np.abs(before - 2.0 * here + after) / 4.0
    period = time[2:] - time[:-2]
    middle = time[1:-1]
    frequency = 2.0 * math.pi / period
    return Envelope(
        time=middle,
        level=(before + 2.0 * here + after) / 4.0,
        amplitude=amplitude,
        frequency=frequency,
        damping=-np.gradient(np.log(amplitude), middle),
        amplitude_noise=np.full(len(middle), smooth.noise.height * math.sqrt(6.0) / 4.0),
        frequency_noise=frequency / period * np.hypot(times_noise[2:], times_noise[:-2]),
    )


def find_alternating_extremes(
    smooth: Derivatives,
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Return times [s] and heights [m, rad] of crests and troughs in turn, and the times' noise [s]."""
    # Beyond five standard deviations, noise makes one extreme in a million.
    from scipy.signal import find_peaks

    time, height = smooth.time, smooth.height
    noise = smooth.noise
    least = max(_NOISE_TIMES * noise.height, _LEAST_SHARE * float(np.ptp(height)))
    result = [(k, sign) for sign in (1.0, -1.0) for k in find_peaks(sign * height, prominence=least)[0]]
    indices: list[tuple[int, float]] = []
    for point, sign in sorted(result):
        if indices and indices[-1][1] == sign:
            # Of two crests without a trough between them only the higher one is an extreme.
            if sign * height[point] > sign * height[indices[-1][0]]:
                indices[-1] = (point, sign)
            continue
        indices.append((point, sign))
    chosen = np.array([position for position, _ in indices], dtype=int)
    velocity, bend = smooth.velocity[chosen], smooth.acceleration[chosen]
    shift = np.where(np.abs(bend) > 0.0, -velocity / np.where(bend == 0.0, 1.0, bend), 0.0)
    step = np.gradient(time)[chosen]
    shift = np.clip(shift, -step, step)
    crest = height[chosen] + 0.5 * velocity * shift
    return time[chosen] + shift, crest, noise.velocity / np.maximum(np.abs(bend), 1e-300)
