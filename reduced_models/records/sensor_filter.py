"""Find a filter of the sensor in a record, from the transient that it adds to the oscillation.

A first-order filter turns a damped cosine into a damped cosine plus an exponential that starts with the
record and decays at the filter's rate. A law without the filter adapts its damping to this exponential.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from granular.shared.array_types import Float
from granular.shared.errors import GranularError
from reduced_models.records.derivatives import noise_standard_deviation
from reduced_models.records.first_guesses import first_guesses
from reduced_models.records.second_mode import DampedCosines, interpolate_or_average_to_even_times

_HALVED = 0.5
_DECAYED = 3.0  # number of decay times in a record after which an exponential has ended
_LEAST_SAMPLES = 5.0  # minimum number of samples in a decay time
_RECTIFIED = 0.2
"""Minimum relative difference between the filter's rate and the oscillation's decay rate. The same minimum
holds for twice the decay rate, since the mean of an asymmetric oscillation decays at twice the rate."""
_NOISES = 2.0  # maximum residual, in noise levels, with which the filter explains the record
_AWAY = 0.2  # maximum ratio of mean level to amplitude for a high pass, which removes the level
_RATES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # trial rates, divided by the angular frequency


class SensorFilter(NamedTuple):
    """A first-order filter of a sensor."""

    kind: str  # low_pass or high_pass
    corner: float  # [Hz]
    residual: float  # rms residual of a damped cosine behind the filter [m]

    def text(self, law_residual: float) -> str:
        """Sentence that suggests the filter, given the residual [m] of a law without the filter."""
        words = self.kind.replace("_", " ")
        return (
            f"a first-order {words} filter of the sensor, at about {self.corner:.2g} Hz, would reduce the "
            f"residual to {100.0 * self.residual / law_residual:.2g} % of its value and change the damping; "
            f'if the sensor has such a filter: fit --measured "height {self.kind}={self.corner:.2g}"'
        )


def find_sensor_filter(
    time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"], law_residual: float
) -> SensorFilter | None:
    """Find a filter that would halve the residual [m] of a law in a free decay; None if there is none."""
    candidate = _find_sensor_filter(time.tobytes(), height.tobytes())
    return candidate if candidate is not None and candidate.residual <= _HALVED * law_residual else None


@functools.lru_cache(maxsize=4)  # every law of a record is compared with it
def _find_sensor_filter(times: bytes, heights: bytes) -> SensorFilter | None:
    from scipy.optimize import least_squares

    time, height = np.frombuffer(times), np.frombuffer(heights)
    try:
        guess = first_guesses(time, height)
    except GranularError:
        return None
    decay = DampedCosines(*interpolate_or_average_to_even_times(time, height), slow_degree=0)

    def columns(vector: np.ndarray, motion: DampedCosines) -> np.ndarray:
        exponential = np.exp(np.clip(-vector[2] * motion.time, -50.0, 2.0))
        return np.hstack([motion.mode_columns(vector[0], vector[1]), exponential[:, None]])

    start = np.array([guess.frequency, min(guess.decay, 0.5 * guess.frequency)])
    solutions = [
        least_squares(
            lambda vector: decay.residuals_and_factors(columns(vector, decay))[0],
            np.append(start, rate * guess.frequency),
            x_scale=np.array([1.0, 1.0, 3.0]) / decay.duration,
            max_nfev=40,
        )
        for rate in _RATES
    ]
    frequency, damping, rate = vector = min(solutions, key=lambda item: item.cost).x
    full = DampedCosines(time, height, slow_degree=0)
    left, factors = full.residuals_and_factors(columns(vector, full))
    step = full.duration / (len(time) - 1)
    ended = _DECAYED / full.duration < rate < 1.0 / (_LEAST_SAMPLES * step)
    rectified = any(abs(rate / (factor * damping) - 1.0) < _RECTIFIED for factor in (1.0, 2.0))
    residual = math.sqrt(float((left**2).mean()))
    if (
        not ended
        or damping <= 0.0
        or rectified
        or residual > _NOISES * noise_standard_deviation(height, time)
    ):
        return None
    level = abs(float(factors[3]) + float(height.mean()))
    is_high_pass = rate < abs(frequency) and level < _AWAY * float(np.hypot(*factors[:2]))
    kind = "high_pass" if is_high_pass else "low_pass"
    return SensorFilter(kind, float(rate) / (2.0 * math.pi), residual)
