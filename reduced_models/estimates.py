"""First guesses from a record: rest level, amplitude, frequency, decay, and the initial motion."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from granular.errors import RecordError
from granular.record import PistonRecord

LEAST_SAMPLES = 20


@dataclasses.dataclass(frozen=True)
class Estimates:
    """What a glance at a record tells.

    Attributes
    ----------
    rest, amplitude : float
        Level at the end of the record, and the greatest distance from it [m].
    frequency, decay : float
        Angular frequency [rad/s] and decay rate [1/s] of the swing about it.
    height, velocity : float
        At the start [m], [m/s].
    """

    rest: float
    amplitude: float
    frequency: float
    decay: float
    height: float
    velocity: float

    def seen_as(self, shift: float, scale: float) -> Estimates:
        """The same guesses for z = (height - shift)/scale."""
        return Estimates(
            rest=(self.rest - shift) / scale,
            amplitude=self.amplitude / scale,
            frequency=self.frequency,
            decay=self.decay,
            height=(self.height - shift) / scale,
            velocity=self.velocity / scale,
        )

    @property
    def period(self) -> float:
        return 2.0 * math.pi / self.frequency


def crossings(time: np.ndarray, swing: np.ndarray, threshold: float) -> np.ndarray:
    """Times at which a swing passes zero, counted once it has gone beyond the threshold."""
    beyond = np.flatnonzero(np.abs(swing) > threshold)
    if len(beyond) < 2:
        return np.empty(0)
    sign = np.sign(swing[beyond])
    turns = np.flatnonzero(sign[1:] != sign[:-1])
    before, after = beyond[turns], beyond[turns + 1]
    share = swing[before] / (swing[before] - swing[after])
    return np.asarray(time[before] + share * (time[after] - time[before]))


def estimates(record: PistonRecord) -> Estimates:
    """First guesses from a record.

    Raises
    ------
    RecordError
        If the record is too short, or the height does not change.
    """
    time, height = record.time - record.time[0], record.height
    if len(time) < LEAST_SAMPLES:
        raise RecordError(
            f"the record has {len(time)} samples; at least {LEAST_SAMPLES} are needed to identify "
            "a law"
        )
    rest = float(height[-len(height) // 3 :].mean())
    swing = height - rest
    amplitude = float(np.abs(swing).max())
    if amplitude <= 1e-12 * max(abs(rest), 1e-300):
        raise RecordError(f"the height stays at {rest:g} m; a motion is needed to identify a law")
    threshold = min(max(0.01 * amplitude, 4.0 * noise_level(height)), 0.5 * amplitude)
    half = _half_period(crossings(time, swing, threshold), float(time[-1]))
    frequency = math.pi / half
    start, speed = _initial_motion(time, height, half)
    decay = _decay(time, swing, half)
    return Estimates(rest, amplitude, frequency, decay, start, speed)


def noise_level(height: np.ndarray) -> float:
    """Standard deviation of white noise on a smooth record, from its third differences.

    Their median absolute value is that of noise times sqrt(20); a smooth motion hardly adds to it.
    """
    return float(np.median(np.abs(np.diff(height, 3))) / (0.6745 * math.sqrt(20.0)))


def _half_period(passes: np.ndarray, duration: float) -> float:
    """Half a period from the passages through the level of rest."""
    if len(passes) > 1:
        return float(np.median(np.diff(passes)))
    if len(passes) == 1:
        return 2.0 * float(passes[0])
    return 0.5 * duration


def _initial_motion(time: np.ndarray, height: np.ndarray, half: float) -> tuple[float, float]:
    """Height and velocity at the start, from a parabola through the first part of the swing."""
    count = max(4, int(np.searchsorted(time, 0.1 * half)))
    first = slice(0, min(count, len(time)))
    line = np.polynomial.Polynomial.fit(time[first], height[first], 2).convert()
    return float(line(0.0)), float(line.deriv()(0.0))


def _decay(time: np.ndarray, swing: np.ndarray, half: float) -> float:
    """Slope of the logarithm of the greatest swing in each half period."""
    edges = np.arange(0.0, time[-1], half)
    peaks = []
    for start in edges:
        inside = (time >= start) & (time < start + half)
        if inside.any():
            peaks.append((start + 0.5 * half, float(np.abs(swing[inside]).max())))
    middle, peak = np.array(peaks).T
    lively = peak > 0.02 * peak.max()
    if lively.sum() < 2:
        return 1.0 / float(time[-1])
    slope = -np.polynomial.Polynomial.fit(middle[lively], np.log(peak[lively]), 1).convert().coef[1]
    return float(np.clip(slope, 0.01 / time[-1], math.pi / half))
