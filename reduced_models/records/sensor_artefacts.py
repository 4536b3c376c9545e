"""Find samples that do not show the motion: lost or clipped samples, spikes, and noise after the motion."""

from __future__ import annotations

import dataclasses
import math
import warnings

import numpy as np

from granular.records.options import RecordSource
from granular.records.record import PistonRecord
from granular.shared.array_types import Bool, Float
from granular.shared.errors import RecordWarning
from reduced_models.records.derivatives import NORMAL_MEDIAN, noise_standard_deviation, sensor_rounding_step
from reduced_models.records.first_guesses import LEAST_SAMPLES, first_guesses, zero_crossing_times
from reduced_models.records.release import active_input_names

KEEP_REMEDY = "to keep them: --between :"
# Minimum number of samples at a sensor's limit in a clipped record: half a crest, cut off by 5 % as a release
# begins, at 120 samples per period. 12 would miss it.
_MINIMUM_CLIPPED = 6
_MINIMUM_RUN = 3
"""Minimum number of successive equal samples that count as a run; two may be equal because of rounding."""
_COARSE_STEP = 1e-3  # rounding step over the range above which two samples are equal by chance
# Ratio of the numbers of samples at a limit and at the next value inside, above which a peak is clipped. A
# rounded crest has at most 1/(sqrt(2) - 1) = 2.4 times as many on its last step as on the one before; 8
# misses peaks clipped by 5 %.
_CLIPPED_RATIO = 4.0
_PASSAGE_DISPLACEMENT, _MINIMUM_PLATEAUS = 0.3, 2
"""A zero crossing counts only if the displacement after it exceeds `_PASSAGE_DISPLACEMENT` times its maximum.
Clipping shows as `_MINIMUM_PLATEAUS` or more plateaus at one level; a single plateau may be a hold."""
_PLATEAU_NOISES, _MAXIMUM_DEPTH, _MINIMUM_DURATION_RATIO = 7.0, 0.35, 1.1
"""Heights within `_PLATEAU_NOISES` standard deviations of the noise, and within `_MAXIMUM_DEPTH` of the
displacement, form a plateau if they last `_MINIMUM_DURATION_RATIO` times as long as in a harmonic crest."""
_PERIOD_TOLERANCE = 0.3  # maximum deviation of the time between plateaus from a period, in periods
_FLATNESS = 0.3  # standard deviations by which the middle of a plateau may be higher
_MINIMUM_NOISE, _ROUNDING_SHARE = 1e-4, 0.3
"""A single run of equal samples may be a hold if the noise, relative to the record's range, is below
`_MINIMUM_NOISE`, or if the sensor rounds: more than `_ROUNDING_SHARE` of neighbouring samples are equal."""
# Step to a lost sample over the usual step, of the whole record and near it. 4 to 32 give the same for zeros
# and -999 in simulated records; with 2 the first sample of a shock is dropped.
_JUMP_RATIO = 8.0
# Fraction of samples above which one number is a level of the record; 0.05 keeps a tenth of zeros.
_MAXIMUM_LOST = 0.2
# Window of a running median; and the distance of a spike from it, over the median deviation (7.4 is five
# standard deviations), over the noise and over the range of the record. With 15, or 20 noise levels, spikes
# of 0.3 in noise of 1 % are missed, with 0.1 of the range small ones; smaller values find more.
_MEDIAN_WINDOW, _SPIKE_DEVIATIONS, _SPIKE_NOISES, _MINIMUM_SPIKE = 7, 7.4, 10.0, 0.03
_SPIKE_STEP_RATIO = 3.0
"""Minimum ratio of the steps into and out of a spike to the other steps near it."""
_RESIDUAL_SPIKE = 8.0  # standard deviations of the usual residual beyond which a single one is a spike
# Fraction of samples above which spikes are kept as part of the record: if they are a tenth, 15 to 30 % of
# them would still be missed. 0.01 keeps all if they are 2 %.
_MAXIMUM_SPIKES = 0.05
_ENDED_RATIO, _MINIMUM_RMS_SAMPLES = 1.5, 5
"""A motion has ended if its rms displacement is below `_ENDED_RATIO` times the noise. The rms is computed
from at least `_MINIMUM_RMS_SAMPLES` samples."""
_NOISE_TAIL_START = 0.7
"""If the motion ends before this fraction of the record, the rest is omitted, since the part that a fit holds
out could otherwise be only noise."""
_EQUILIBRIUM_PART = 0.05
"""Fraction of a record, at its end, whose median height is the equilibrium."""
_MOTION_END = 0.85
"""If the motion ends before this fraction of the record, `count_samples_in_motion` ignores later samples."""
_MINIMUM_CROSSINGS = 8
"""If there are fewer zero crossings than this, `count_samples_in_motion` counts all samples."""


def drop_lost_samples_and_spikes(record: PistonRecord) -> PistonRecord:
    """Remove spikes and lost samples, for which a sensor or logger wrote a placeholder."""
    lost = _placeholder_mask(record.height)
    spikes = np.zeros_like(lost)
    spikes[~lost] = _spike_mask(record.time[~lost], record.height[~lost])
    lost |= spikes
    if not lost.any() or (~lost).sum() < LEAST_SAMPLES:
        return record
    warnings.warn(
        f"samples far from their neighbours (lost, or spikes) are omitted: "
        f"{int(lost.sum())}, the first at {record.time[np.argmax(lost)]:.4g} s; {KEEP_REMEDY}",
        RecordWarning,
        stacklevel=3,
    )
    return record.select(~lost)


def _placeholder_mask(height: np.ndarray) -> np.ndarray:
    """Mask the samples of an extreme value if the record jumps to this value and back."""
    lost = np.zeros(len(height), dtype=bool)
    for extreme in (np.min, np.max):
        here = height == extreme(height)
        inner = ~here[1:] & ~here[:-1]
        edges = np.flatnonzero(here[1:] != here[:-1])
        within = len(edges) - int(here[0]) - int(here[-1])  # edges of runs with samples on both sides
        if inner.sum() < LEAST_SAMPLES or here.mean() > _MAXIMUM_LOST or within < 2:
            continue
        steps = np.abs(np.diff(height))
        quiet = steps[inner]  # steps between other samples: lost ones may be close together
        nearest = np.searchsorted(np.flatnonzero(inner), edges)[:, None] + np.arange(-4, 5)
        about = np.sort(quiet[np.clip(nearest, 0, len(quiet) - 1)], axis=1)
        usual = np.maximum(about[:, 2], np.quantile(quiet, 0.95))
        if (steps[edges] > _JUMP_RATIO * usual).all():
            lost |= here
    return lost


def _spike_mask(time: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Mask single samples far from the median of their neighbours (Hampel identifier)."""
    none = np.zeros(len(height), dtype=bool)
    if len(height) < LEAST_SAMPLES:
        return none
    about = np.lib.stride_tricks.sliding_window_view(
        np.pad(height, _MEDIAN_WINDOW // 2, mode="reflect"), _MEDIAN_WINDOW
    )
    middle = np.median(about, axis=1)
    away = np.abs(height - middle)
    spread = np.median(np.abs(about - middle[:, None]), axis=1)
    low, high = np.quantile(height, [0.02, 0.98])
    floor = max(_SPIKE_NOISES * noise_standard_deviation(height, time), _MINIMUM_SPIKE * float(high - low))
    steps = np.abs(np.diff(np.pad(height, _MEDIAN_WINDOW // 2, mode="reflect")))
    steps = np.lib.stride_tricks.sliding_window_view(steps, _MEDIAN_WINDOW - 1)
    middle_two = slice(_MEDIAN_WINDOW // 2 - 1, _MEDIAN_WINDOW // 2 + 1)
    others = np.sort(np.delete(steps, middle_two, axis=1), axis=1)[:, 1]
    # a bounce is as sharp, but the steps of the motion next to it are as large
    alone = steps[:, middle_two].min(axis=1) > _SPIKE_STEP_RATIO * others
    spikes = alone & (away > _SPIKE_DEVIATIONS * spread) & (away > floor)
    spikes[: _MEDIAN_WINDOW // 2] = spikes[len(spikes) - _MEDIAN_WINDOW // 2 :] = False
    return spikes if spikes.mean() < _MAXIMUM_SPIKES else none


def clipped_sample_mask(record: PistonRecord) -> Bool[np.ndarray, "n"]:
    """Mask the samples at the limits of a sensor if runs of such samples occur at several crests."""
    clipped = _clipped_sample_mask(record)
    if clipped.any():
        warnings.warn(_clipped_samples_text(record, clipped), RecordWarning, stacklevel=3)
    return clipped


def _clipped_sample_mask(record: PistonRecord) -> np.ndarray:
    clipped = _extreme_value_run_mask(record)
    return clipped if clipped.any() else _plateau_mask(record)


def _clipped_samples_text(record: PistonRecord, clipped: np.ndarray) -> str:
    count, remedy = int(clipped.sum()), keep_samples_text(record)
    return f"{count} samples at the limit of the sensor (clipped) are omitted; {remedy}"


def keep_samples_text(record: PistonRecord) -> str:
    """Explain how to keep samples that are omitted from a record."""
    known = record.source is not None and record.source.name
    return KEEP_REMEDY if known else "to keep them: PistonRecord(..., complete=True)"


def record_with_note(record: PistonRecord, text: str) -> PistonRecord:
    """Add a note about a record's samples to its source."""
    source = record.source or RecordSource("")
    return dataclasses.replace(record, source=dataclasses.replace(source, notes=(*source.notes, text)))


def without_clipped_samples(record: PistonRecord) -> PistonRecord:
    """Remove the samples at a sensor's limits, which a fit would otherwise regard as motion."""
    # a driven motion may repeatedly be held at a level
    if record.complete or active_input_names(record):
        return record
    clipped = _clipped_sample_mask(record)
    if not clipped.any() or (~clipped).sum() < LEAST_SAMPLES:
        return record
    text = _clipped_samples_text(record, clipped)
    warnings.warn(text, RecordWarning, stacklevel=3)
    return record_with_note(record.select(~clipped), text)


def spike_mask(record: PistonRecord, fitted: Float[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Mask single samples far from a fitted motion [m]; mask none if the record is marked complete."""
    # With few samples per cycle the neighbours alone do not distinguish a spike from the motion.
    away = np.abs(record.height - fitted)
    about = np.pad(away, 1, mode="reflect")
    alone = away > _SPIKE_STEP_RATIO * np.maximum(about[:-2], about[2:])
    spikes = alone & (away > _RESIDUAL_SPIKE * float(np.median(away)) / NORMAL_MEDIAN)
    few = spikes.mean() <= _MAXIMUM_SPIKES and (~spikes).sum() >= LEAST_SAMPLES
    return spikes if few and not record.complete else np.zeros_like(spikes)


def _extreme_value_run_mask(record: PistonRecord) -> np.ndarray:
    """Mask runs of samples that are equal to the minimum or to the maximum."""
    height = record.height
    at_limit = np.zeros(len(height), dtype=bool)
    runs = samples = 0
    # noise is visible away from the limits of the sensor
    free = (height > height.min()) & (height < height.max())
    if free.sum() < LEAST_SAMPLES:
        return at_limit
    noisy = noise_standard_deviation(height[free], record.time[free]) > _MINIMUM_NOISE * float(np.ptp(height))
    noisy &= float((np.diff(height[free]) == 0.0).mean()) < _ROUNDING_SHARE
    run = (
        _MINIMUM_RUN
        if sensor_rounding_step(height) > _COARSE_STEP * float(np.ptp(height))
        else _MINIMUM_RUN - 1
    )
    values = np.unique(height)
    for limit, inside in ((values[0], values[1]), (values[-1], values[-2])):
        here = height == limit
        # at a turning point, a rounding sensor has nearly half as many samples one step further in
        if here.sum() <= _CLIPPED_RATIO * (height == inside).sum():
            continue
        lengths = np.array([stop - start for start, stop in start_and_stop_of_mask_runs(here)])
        long = lengths >= run
        runs, samples = runs + int(long.sum()), samples + int(lengths[long].sum())
        if long.any():
            at_limit |= here
    # A hold is one long run; clipped crests are several runs. In noise a hold is never a single value.
    return at_limit & bool((runs >= _MINIMUM_PLATEAUS or noisy) and samples >= _MINIMUM_CLIPPED)


def _plateau_mask(record: PistonRecord) -> np.ndarray:
    """Mask samples at the maximum displacement, within noise, if they last longer than a harmonic crest."""
    time, height = record.time, record.height
    plateau = np.zeros(len(height), dtype=bool)
    noise = noise_standard_deviation(height, time)
    displacement = height - np.median(height)
    passages = zero_crossing_times(
        time, displacement, _PASSAGE_DISPLACEMENT * float(np.abs(displacement).max())
    )
    if noise == 0.0 or len(passages) < 2 * _MINIMUM_PLATEAUS:
        return plateau
    half = float(np.median(np.diff(passages)))
    step = float(np.median(np.diff(time)))  # a gap is not a plateau
    for away in (displacement, -displacement):
        largest = float(away.max())
        # the maximum of many is three standard deviations above the plateau, the minimum as far below
        depth = _PLATEAU_NOISES * noise
        if depth > _MAXIMUM_DEPTH * largest:
            continue
        # duration of a harmonic crest within the depth
        natural = half * math.acos(1.0 - depth / largest) * 2.0 / math.pi
        near = away > largest - depth
        starts = [
            time[start]
            for start, stop in start_and_stop_of_mask_runs(near)
            if (stop - start - 1) * step > _MINIMUM_DURATION_RATIO * natural
            and stop - start >= _MINIMUM_RUN
            and _is_flat_run(away[start:stop], noise)
        ]
        # one per cycle; holds before further releases are further apart
        if (np.abs(np.diff(starts) / (2.0 * half) - 1.0) < _PERIOD_TOLERANCE).sum() >= _MINIMUM_PLATEAUS - 1:
            plateau |= near
    return plateau


def _is_flat_run(values: np.ndarray, noise: float) -> bool:
    """Return whether the middle of a run is not higher than its other samples."""
    quarter = max(1, len(values) // 5)
    middle, about = values[2 * quarter : -2 * quarter], values[quarter:-quarter]
    if not len(middle):
        return True
    return bool(middle.mean() - about.mean() < noise * (_FLATNESS + 3.0 / math.sqrt(len(middle))))


def start_and_stop_of_mask_runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Start and stop (exclusive) of each run of a mask."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def end_time_of_motion(record: PistonRecord) -> float:
    """Return the time [s] after which the displacement is hardly larger than the noise."""
    displacement = record.height - np.median(record.height[-max(3, int(_EQUILIBRIUM_PART * len(record))) :])
    count = min(len(displacement), max(_MINIMUM_RMS_SAMPLES, len(displacement) // 50))
    largest = float(np.abs(displacement).max()) or 1.0  # squares of heights may overflow or underflow
    sums = np.concatenate([[0.0], np.cumsum((displacement / largest) ** 2)])
    rms = np.sqrt(np.maximum(sums[count:] - sums[:-count], 0.0) / count)
    # the rms of few samples of noise has a relative scatter of 1/sqrt(2 count)
    limit = max(_ENDED_RATIO, 1.0 + 4.0 / math.sqrt(2.0 * count))
    moving = np.flatnonzero(rms > limit * noise_standard_deviation(record.height, record.time) / largest)
    return float(record.time[int(moving[-1]) + count - 1 if len(moving) else 0])


def count_samples_in_motion(record: PistonRecord) -> int:
    """Count the samples until a free oscillation is lost in the noise of its record."""
    if active_input_names(record):
        return len(record)
    end, duration = end_time_of_motion(record), float(record.time[-1])
    count = int(np.searchsorted(record.time, end, side="right"))
    if end > _MOTION_END * duration or count < LEAST_SAMPLES:
        return len(record)
    if first_guesses(record.time[:count], record.height[:count]).crossings < _MINIMUM_CROSSINGS:
        return len(record)
    return count


def cut_noise_tail(record: PistonRecord) -> PistonRecord:
    """Remove the end of a record in which the motion is lost in the noise, if this part is large."""
    start, stop = float(record.time[0]), float(record.time[-1])
    end = end_time_of_motion(record)
    motion = record.time <= end
    if end - start > _NOISE_TAIL_START * (stop - start) or motion.sum() < LEAST_SAMPLES:
        return record
    warnings.warn(
        f"from {end:.4g} s on the motion is within the sensor's noise, so the rest is omitted; "
        "to keep it: --between :",
        RecordWarning,
        stacklevel=3,
    )
    return record.select(motion)
