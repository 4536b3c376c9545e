"""Samples that tell of the sensor and not of the motion: lost, clipped, or within its noise."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING

import numpy as np

from granular.run.piston_record import PistonRecord
from granular.shared.errors import RecordWarning
from reduced_models.records.first_guesses import LEAST_SAMPLES, first_guesses, noise_level
from reduced_models.records.release import has_active_input

if TYPE_CHECKING:
    from jaxtyping import Bool

KEEP = "to keep them: --between :"
# Samples at a sensor's limit from which on a record is clipped: half a crest, cut off by 5 % as a release
# begins, at 120 samples a period. 12 would miss it.
_LEAST_CLIPPED = 6
_RUN = 3
"""Least number of equal samples in a row: two may be the same by chance of rounding."""
# Samples at a limit over those of the next number inside, from which on a peak is cut off there. A crest that
# is rounded has at most 1/(sqrt(2) - 1) = 2.4 times as many on its last step as on the one before; 8 misses
# peaks cut off by 5 %.
_RARE = 4.0
_LEAST_NOISE, _SAME = 1e-4, 0.3
"""Noise over the range of a record that hides no hold, and fraction of equal neighbours in a sensor that
rounds: from there on a single run of equal samples may be a hold."""
# Times the usual step, of all and of those about them, by which lost samples are away. 4 to 32 do the same on
# zeros and -999 in made records; by 2 the first sample of a shock is lost.
_JUMP = 8.0
# Fraction of samples from which on one number is a level of the record; 0.05 keeps a tenth of zeros.
_MOST_LOST = 0.2
# Samples about each one; its distance from their median over their own (7.4 is five standard deviations),
# over the noise and over the range of the record, from which on it is a spike. By 15, or 20 noise levels,
# spikes of 0.3 under noise of 1 % are missed, by 0.1 of the range small ones; smaller values find more.
_WINDOW, _SPIKE, _NOISES, _LEAST_SPIKE = 7, 7.4, 10.0, 0.03
_SUDDEN = 3.0
"""Steps to a spike and back over those about them."""
# Fraction of samples from which on spikes are part of the record: of a tenth of them 15 to 30 % would still
# be missed. 0.01 leaves all in if they are 2 %.
_MOST_SPIKES = 0.05
_DEAD, _FEWEST = 1.5, 5
"""Noise levels of a swing, as root mean square of at least so many samples, that count no more."""
_ENDS = 0.7
"""Part of a record in which its motion must have ended for the rest to be left out: a fit holds as
much back to be tested with, which then would hold noise alone."""
_LEAST_END = 0.05
"""Part of a record that its level of rest is taken from at least."""
_MOST_OF_RECORD = 0.85
"""Part of a record up to which its motion must have ended for the rest not to count."""
_FEWEST_CROSSINGS = 8
"""Passages through rest of a motion that is long enough to be split on its own."""


def drop_lost_samples(record: PistonRecord) -> PistonRecord:
    """Record without samples that a sensor or a logger lost and wrote a number for."""
    lost = _placeholder_mask(record.height)
    spikes = np.zeros_like(lost)
    spikes[~lost] = _spike_mask(record.time[~lost], record.height[~lost])
    lost |= spikes
    if not lost.any() or (~lost).sum() < LEAST_SAMPLES:
        return record
    warnings.warn(
        f"samples that stand far off those about them (lost, or spikes) are left out: "
        f"{int(lost.sum())}, the first at {record.time[np.argmax(lost)]:.4g} s; {KEEP}",
        RecordWarning,
        stacklevel=3,
    )
    return record.select(~lost)


def _placeholder_mask(height: np.ndarray) -> np.ndarray:
    """Return the samples of one extreme number that the record jumps to and back from."""
    lost = np.zeros(len(height), dtype=bool)
    for extreme in (np.min, np.max):
        here = height == extreme(height)
        inner = ~here[1:] & ~here[:-1]
        edges = np.flatnonzero(here[1:] != here[:-1])
        within = len(edges) - int(here[0]) - int(here[-1])  # of runs with samples on both sides
        if inner.sum() < LEAST_SAMPLES or here.mean() > _MOST_LOST or within < 2:
            continue
        steps = np.abs(np.diff(height))
        quiet = steps[inner]  # lost samples may lie close together
        nearest = np.searchsorted(np.flatnonzero(inner), edges)[:, None] + np.arange(-4, 5)
        about = np.sort(quiet[np.clip(nearest, 0, len(quiet) - 1)], axis=1)
        usual = np.maximum(about[:, 2], np.quantile(quiet, 0.95))
        if (steps[edges] > _JUMP * usual).all():
            lost |= here
    return lost


def _spike_mask(time: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Return single samples that stand off the median of their neighbours (Hampel's identifier)."""
    none = np.zeros(len(height), dtype=bool)
    if len(height) < LEAST_SAMPLES:
        return none
    about = np.lib.stride_tricks.sliding_window_view(np.pad(height, _WINDOW // 2, mode="reflect"), _WINDOW)
    middle = np.median(about, axis=1)
    away = np.abs(height - middle)
    spread = np.median(np.abs(about - middle[:, None]), axis=1)
    low, high = np.quantile(height, [0.02, 0.98])
    floor = max(_NOISES * _sensor_noise(time, height), _LEAST_SPIKE * float(high - low))
    steps = np.abs(np.diff(np.pad(height, _WINDOW // 2, mode="reflect")))
    steps = np.lib.stride_tricks.sliding_window_view(steps, _WINDOW - 1)
    middle_two = slice(_WINDOW // 2 - 1, _WINDOW // 2 + 1)
    others = np.sort(np.delete(steps, middle_two, axis=1), axis=1)[:, 1]
    # a bounce is as sharp, but the motion comes and goes as quickly next to it
    alone = steps[:, middle_two].min(axis=1) > _SUDDEN * others
    spikes = alone & (away > _SPIKE * spread) & (away > floor)
    spikes[: _WINDOW // 2] = spikes[len(spikes) - _WINDOW // 2 :] = False
    return spikes if spikes.mean() < _MOST_SPIKES else none


def _sensor_noise(time: np.ndarray, height: np.ndarray) -> float:
    """Noise of a sensor, its rounding among it."""
    # Rounding errors are uniform over a step: step/sqrt(12).
    steps = np.abs(np.diff(height))
    extent = float(np.ptp(height))
    rounding = float(steps[steps > 1e-9 * extent].min(initial=extent))
    few = float((steps < 1.5 * rounding).mean()) > 0.5
    return math.hypot(noise_level(height, time), rounding / math.sqrt(12.0) if few else 0.0)


def clipped_sample_mask(record: PistonRecord) -> Bool[np.ndarray, "n"]:
    """Mask of the samples at the limits of a sensor, where runs of them stand at a peak."""
    height = record.height
    at_limit = np.zeros(len(height), dtype=bool)
    several = False
    # noise shows where the sensor does not stand at its limits
    free = (height > height.min()) & (height < height.max())
    if free.sum() < LEAST_SAMPLES:
        return at_limit
    noisy = noise_level(height[free], record.time[free]) > _LEAST_NOISE * float(np.ptp(height))
    noisy &= float((np.diff(height[free]) == 0.0).mean()) < _SAME
    values = np.unique(height)
    for limit, inside in ((values[0], values[1]), (values[-1], values[-2])):
        here = height == limit
        # a turning point of a sensor that rounds has nearly half as many samples a step further in
        if here.sum() <= _RARE * (height == inside).sum():
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[False], here, [False]]).astype(int)))
        lengths = edges[1::2] - edges[::2]
        long = lengths >= _RUN
        # A hold is one long run; peaks that are cut off are several. In noise no hold is one number.
        several |= bool((long.sum() >= 2 or noisy) and lengths[long].sum() >= _LEAST_CLIPPED)
        if long.any():
            at_limit |= here
    at_limit &= several
    if not at_limit.any():
        return at_limit
    warnings.warn(
        f"{int(at_limit.sum())} samples stand at the limit of the sensor (clipped) and are left out; {KEEP}",
        RecordWarning,
        stacklevel=3,
    )
    return at_limit


def end_time_of_motion(record: PistonRecord) -> float:
    """Time after which the motion is hardly more than noise about where it ends [s]."""
    swing = record.height - np.median(record.height[-max(3, int(_LEAST_END * len(record))) :])
    count = min(len(swing), max(_FEWEST, len(swing) // 50))
    largest = float(np.abs(swing).max()) or 1.0  # squares of heights may leave the floats
    sums = np.concatenate([[0.0], np.cumsum((swing / largest) ** 2)])
    rms = np.sqrt(np.maximum(sums[count:] - sums[:-count], 0.0) / count)
    # the rms of so few samples of noise alone scatters by 1/sqrt(2 count)
    limit = max(_DEAD, 1.0 + 4.0 / math.sqrt(2.0 * count))
    moving = np.flatnonzero(rms > limit * _sensor_noise(record.time, record.height) / largest)
    return float(record.time[int(moving[-1]) + count - 1 if len(moving) else 0])


def count_samples_in_motion(record: PistonRecord) -> int:
    """Count the samples until a free swing is lost in the noise of its record."""
    if has_active_input(record):
        return len(record)
    end, duration = end_time_of_motion(record), float(record.time[-1])
    count = int(np.searchsorted(record.time, end, side="right"))
    if end > _MOST_OF_RECORD * duration or count < LEAST_SAMPLES:
        return len(record)
    if first_guesses(record.time[:count], record.height[:count]).crossings < _FEWEST_CROSSINGS:
        return len(record)
    return count


def cut_noise_tail(record: PistonRecord) -> PistonRecord:
    """Record until its motion is lost in the sensor's noise, where that takes much of it."""
    start, stop = float(record.time[0]), float(record.time[-1])
    end = end_time_of_motion(record)
    motion = record.time <= end
    if end - start > _ENDS * (stop - start) or motion.sum() < LEAST_SAMPLES:
        return record
    warnings.warn(
        f"from {end:.4g} s on the motion is within the sensor's noise, and what follows is left "
        "out; to keep it: --between :",
        RecordWarning,
        stacklevel=3,
    )
    return record.select(motion)
