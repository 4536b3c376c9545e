"""Samples that tell of the sensor and not of the motion: lost, clipped, or within its noise."""

from __future__ import annotations

import dataclasses
import math
import warnings

import numpy as np

from granular.records.options import RecordSource
from granular.records.record import PistonRecord
from granular.shared.array_types import Bool, Float
from granular.shared.errors import RecordWarning
from reduced_models.records.derivatives import NORMAL_MEDIAN, noise_level, rounding_step
from reduced_models.records.first_guesses import LEAST_SAMPLES, first_guesses, zero_crossing_times
from reduced_models.records.release import active_inputs

KEEP = "to keep them: --between :"
# Samples at a sensor's limit from which on a record is clipped: half a crest, cut off by 5 % as a release
# begins, at 120 samples a period. 12 would miss it.
_LEAST_CLIPPED = 6
_RUN = 3
"""Least number of equal samples in a row: two may be the same by chance of rounding."""
_COARSE = 1e-3  # step of a sensor over the range, from which on two samples are equal by chance
# Samples at a limit over those of the next number inside, from which on a peak is cut off there. A crest that
# is rounded has at most 1/(sqrt(2) - 1) = 2.4 times as many on its last step as on the one before; 8 misses
# peaks cut off by 5 %.
_RARE = 4.0
_BEYOND, _REPEATED = 0.3, 2
"""Displacement over the largest from which on passages through rest are counted; and plateaus at one level
that are no hold."""
_DEPTH, _DEEPEST, _LONGER = 7.0, 0.35, 1.1
"""Standard deviations of the noise between the highest and the lowest sample of a plateau; most of that over
the displacement; and its duration over that of a crest."""
_CYCLE = 0.3  # of a period by which the time from plateau to plateau may differ from it
_ROUND = 0.3  # standard deviations by which the middle of a plateau may be higher
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
_OFF = 8.0  # standard deviations of the usual residual, beyond which a single one is a spike
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
    floor = max(_NOISES * noise_level(height, time), _LEAST_SPIKE * float(high - low))
    steps = np.abs(np.diff(np.pad(height, _WINDOW // 2, mode="reflect")))
    steps = np.lib.stride_tricks.sliding_window_view(steps, _WINDOW - 1)
    middle_two = slice(_WINDOW // 2 - 1, _WINDOW // 2 + 1)
    others = np.sort(np.delete(steps, middle_two, axis=1), axis=1)[:, 1]
    # a bounce is as sharp, but the motion comes and goes as quickly next to it
    alone = steps[:, middle_two].min(axis=1) > _SUDDEN * others
    spikes = alone & (away > _SPIKE * spread) & (away > floor)
    spikes[: _WINDOW // 2] = spikes[len(spikes) - _WINDOW // 2 :] = False
    return spikes if spikes.mean() < _MOST_SPIKES else none


def clipped_sample_mask(record: PistonRecord) -> Bool[np.ndarray, "n"]:
    """Mask of the samples at the limits of a sensor, if runs of them stand at several crests."""
    clipped = _clipped_sample_mask(record)
    if clipped.any():
        warnings.warn(_clipped_text(record, clipped), RecordWarning, stacklevel=3)
    return clipped


def _clipped_sample_mask(record: PistonRecord) -> np.ndarray:
    clipped = _equal_sample_mask(record)
    return clipped if clipped.any() else _plateau_mask(record)


def _clipped_text(record: PistonRecord, clipped: np.ndarray) -> str:
    return (
        f"{int(clipped.sum())} samples stand at the limit of the sensor (clipped) and are left out; "
        f"{keep_text(record)}"
    )


def keep_text(record: PistonRecord) -> str:
    """Remedy for samples that are left out of a record."""
    known = record.source is not None and record.source.name
    return KEEP if known else "to keep them: complete=True of the PistonRecord"


def with_note(record: PistonRecord, words: str) -> PistonRecord:
    """Record whose source has a further note on its samples."""
    source = record.source or RecordSource("")
    return dataclasses.replace(record, source=dataclasses.replace(source, notes=(*source.notes, words)))


def without_clipped_samples(record: PistonRecord) -> PistonRecord:
    """Record without the samples at a sensor's limits, which a fit would take for the motion."""
    # what is driven may be held at a level again and again
    if record.complete or active_inputs(record):
        return record
    clipped = _clipped_sample_mask(record)
    if not clipped.any() or (~clipped).sum() < LEAST_SAMPLES:
        return record
    words = _clipped_text(record, clipped)
    warnings.warn(words, RecordWarning, stacklevel=3)
    return with_note(record.select(~clipped), words)


def spike_mask(record: PistonRecord, fitted: Float[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Mask of single samples far off the heights of a fitted motion [m]; none of a complete record."""
    # Among few samples a cycle the neighbours alone tell no spike from the motion.
    away = np.abs(record.height - fitted)
    about = np.pad(away, 1, mode="reflect")
    alone = away > _SUDDEN * np.maximum(about[:-2], about[2:])
    spikes = alone & (away > _OFF * float(np.median(away)) / NORMAL_MEDIAN)
    few = spikes.mean() <= _MOST_SPIKES and (~spikes).sum() >= LEAST_SAMPLES
    return spikes if few and not record.complete else np.zeros_like(spikes)


def _equal_sample_mask(record: PistonRecord) -> np.ndarray:
    """Mask of samples that are equal to the least or the largest, in runs."""
    height = record.height
    at_limit = np.zeros(len(height), dtype=bool)
    runs = samples = 0
    # noise shows where the sensor does not stand at its limits
    free = (height > height.min()) & (height < height.max())
    if free.sum() < LEAST_SAMPLES:
        return at_limit
    noisy = noise_level(height[free], record.time[free]) > _LEAST_NOISE * float(np.ptp(height))
    noisy &= float((np.diff(height[free]) == 0.0).mean()) < _SAME
    run = _RUN if rounding_step(height) > _COARSE * float(np.ptp(height)) else _RUN - 1
    values = np.unique(height)
    for limit, inside in ((values[0], values[1]), (values[-1], values[-2])):
        here = height == limit
        # a turning point of a sensor that rounds has nearly half as many samples a step further in
        if here.sum() <= _RARE * (height == inside).sum():
            continue
        lengths = np.array([stop - start for start, stop in mask_runs(here)])
        long = lengths >= run
        runs, samples = runs + int(long.sum()), samples + int(lengths[long].sum())
        if long.any():
            at_limit |= here
    # A hold is one long run; crests that are cut off are several. In noise no hold is one number.
    return at_limit & bool((runs >= _REPEATED or noisy) and samples >= _LEAST_CLIPPED)


def _plateau_mask(record: PistonRecord) -> np.ndarray:
    """Mask of samples that stay at the largest displacement, but for noise, longer than a crest does."""
    time, height = record.time, record.height
    plateau = np.zeros(len(height), dtype=bool)
    noise = noise_level(height, time)
    swing = height - np.median(height)
    passages = zero_crossing_times(time, swing, _BEYOND * float(np.abs(swing).max()))
    if noise == 0.0 or len(passages) < 2 * _REPEATED:
        return plateau
    half = float(np.median(np.diff(passages)))
    step = float(np.median(np.diff(time)))  # a hole is no plateau
    for away in (swing, -swing):
        largest = float(away.max())
        # the largest of many is three standard deviations above the plateau, the least as far below
        depth = _DEPTH * noise
        if depth > _DEEPEST * largest:
            continue
        # a harmonic crest is within the depth for this long
        natural = half * math.acos(1.0 - depth / largest) * 2.0 / math.pi
        near = away > largest - depth
        starts = [
            time[start]
            for start, stop in mask_runs(near)
            if (stop - start - 1) * step > _LONGER * natural
            and stop - start >= _RUN
            and _is_flat(away[start:stop], noise)
        ]
        # from cycle to cycle; holds before further releases are further apart
        if (np.abs(np.diff(starts) / (2.0 * half) - 1.0) < _CYCLE).sum() >= _REPEATED - 1:
            plateau |= near
    return plateau


def _is_flat(values: np.ndarray, noise: float) -> bool:
    """Return whether the middle of a run is no higher than what is about it."""
    quarter = max(1, len(values) // 5)
    middle, about = values[2 * quarter : -2 * quarter], values[quarter:-quarter]
    if not len(middle):
        return True
    return bool(middle.mean() - about.mean() < noise * (_ROUND + 3.0 / math.sqrt(len(middle))))


def mask_runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """First and behind the last sample of each run of a mask."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def end_time_of_motion(record: PistonRecord) -> float:
    """Time after which the motion is hardly more than noise about where it ends [s]."""
    swing = record.height - np.median(record.height[-max(3, int(_LEAST_END * len(record))) :])
    count = min(len(swing), max(_FEWEST, len(swing) // 50))
    largest = float(np.abs(swing).max()) or 1.0  # squares of heights may leave the floats
    sums = np.concatenate([[0.0], np.cumsum((swing / largest) ** 2)])
    rms = np.sqrt(np.maximum(sums[count:] - sums[:-count], 0.0) / count)
    # the rms of so few samples of noise alone scatters by 1/sqrt(2 count)
    limit = max(_DEAD, 1.0 + 4.0 / math.sqrt(2.0 * count))
    moving = np.flatnonzero(rms > limit * noise_level(record.height, record.time) / largest)
    return float(record.time[int(moving[-1]) + count - 1 if len(moving) else 0])


def count_samples_in_motion(record: PistonRecord) -> int:
    """Count the samples until a free swing is lost in the noise of its record."""
    if active_inputs(record):
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
