"""Find the free motions in a record, without lost samples and without disturbances before and after them.

A record may hold several motions, each from its release to the next disturbance. During an oscillation the
displacement is large again after each half period. A disturbance is recognised by one of the following signs:

- a pause: the displacement is small for longer than between two extremes;
- a hold: the displacement is large and constant for longer than at a turning point;
- a lift: the displacement rises from rest, more slowly than during the oscillation;
- a knock: a half cycle is suddenly larger than the half cycle before it.

The module also chooses the held-out cycles of a record and computes the prediction error of a law on
them. These cycles are complete and spread over the motion, since an end at rest would not test a law.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.records.options import ALL
from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import RecordError, RecordWarning, quote
from reduced_models.records.derivatives import noise_standard_deviation
from reduced_models.records.first_guesses import LEAST_SAMPLES, zero_crossing_times
from reduced_models.records.release import active_input_names, cut_at_release
from reduced_models.records.sensor_artefacts import (
    clipped_sample_mask,
    cut_noise_tail,
    drop_lost_samples_and_spikes,
    start_and_stop_of_mask_runs,
)

# Thresholds. Durations are in half periods of the record's motion, displacements over its largest one.
# The values come from the records of tests/reduced_models/records/test_motion.py: decays of damping ratio
# 0.05 with 1 % noise that are held, lifted by hand, released two or three times, knocked or clipped,
# and beats, which are one motion. The failures stated below were found by changing one value at a time, on
# these records and on decays of damping ratio 0.005 to 0.6, knocks of 0.2 to 1.5, beats, sweeps, oscillators
# with two wells or a one-sided spring, and random drives.

# Last fractions of a record (1/5, ...) whose median may be the equilibrium. A record held for most of its
# time needs the short ones (a fifth alone misses two of three releases), a record that ends in a hold the
# fifth.
_END_DIVISORS = (5, 10, 20, 40)
# Large displacement. 0.25: a sweep through resonance and a fall from one well into another are cut in two;
# 0.6: a release from half the height of the first is missed.
_LARGE = 0.4
# Small displacement, three times `_NOISIEST`, so that noise alone does not exceed it. 0.12: the end of
# a decay hides a knock of 0.7; 0.3: decays of damping ratio 0.2 are small from their first cycle on.
_SMALL = 0.16
# Start and end of the time before a release in which no displacement is large. From -1 on, steps from one
# hold to another are taken for releases; from -6 on, the motion after a knock 1.5 s into a decay is missed;
# until 0, the slope of a knock or a quick lift is included; until -0.5, an oscillation in two wells is cut.
_BEFORE = (-2.0, -0.2)
# Start and end of the time after a release in which no half cycle may be larger than the first. Beats and
# random drives grow for longer: they are cut in two if it starts at 2 or ends at 2.
_AFTER = (1.0, 4.0)
# Time without a large displacement before another release. A free oscillation is large again after 1, so
# 0.5 to 4 give the same on all these records; 16: a release 20 after another is missed.
_PAUSE = 2.0
# Fraction of a pause with small displacements. 0 to 0.4 give the same; 0.6: the motion after a knock is
# missed; 0.8: so are releases, since the end of the last decay is itself visible.
_CALM = 0.4
# Zero crossings that determine a period. Two to six give the same; none or one: no half period,
# NaN; eight: three releases of damping ratio 0.2 are taken for one motion.
_MINIMUM_PASSAGES = 4
# Shortest hold. 0.4: turning points with 3 % noise are taken for holds; 2.0: holds of 0.2 s before
# motions of period 0.24 s are missed, and the last decay includes the lift.
_MINIMUM_HOLD = 1.2
# Range of heights in a hold: a turning point falls by 2 % of its height in 0.06 periods. 0: holds that creep
# by 15 % are cut late; 0.05: slow turning points of a one-sided spring are taken for holds.
_HOLD_RANGE = 0.02
# The range of many noisy samples, in standard deviations of the noise. 2: holds with 4.5 % noise
# are missed; 12: slow beats are cut. Also the minimum growth of a knock above the noise.
_NOISE_RANGE = 6.0
# Maximum duration of the fall from a hold or a lift to a small displacement; a released motion takes half a
# half period. 0.6: a lift of 0.5 s with a flat top is missed; from 0.8 up nothing changes here.
_MAXIMUM_FALL = 1.2
# Shortest lift; an oscillation rises in 0.5. Up to 0.5, knocks are taken for lifts and the motion before
# loses 0.3 s; from 1.0 on, lifts of 0.15 s are included in the decay before them.
_MINIMUM_LIFT = 0.75
# End of a motion in which the next lift may already have begun. 0: the last decay lasts 0.36 s longer, into
# the lift; longer: good samples are lost.
_UNDISTURBED_MARGIN = 3.0
# Recurrence of two modes: samples per period, order, and the ratio of residuals in and outside knocks above
# which it is broken.
_SAMPLES_PER_PERIOD, _RECURRENCE_ORDER, _BROKEN_RATIO = 8, 4, 6.0
# Number of large half cycles before a hold that make it a motion. 2: a hand that slips before the release
# counts as one; 4: the first of three releases of damping ratio 0.1 is lost.
_MINIMUM_LARGE_HALF_CYCLES = 3
# Growth of a half cycle that shows a knock, and apparent growth of a steady one due to noise and sampling.
# From 60 decays with one to three knocks of 0.5 to 2, and twelve of each of ten kinds without any (beats, two
# modes, sweeps, random drives, two wells, one-sided springs), all with 0, 0.5 and 2 % noise.
_KNOCK_GROWTH, _STEADY_GROWTH = 1.25, 1.05
# Duration of a knock in half cycles: the half cycle of the knock, one before and one after. Beats grow
# for longer.
_KNOCK_HALF_CYCLES = 3
# Fraction of growing half cycles above which a record beats or is driven.
_DRIVEN_FRACTION = 0.2
# Average that reduces the noise, in half periods: an eighth of a period lowers all extremes by 3 %.
_AVERAGING_TIME = 0.25
# Smallest extreme that counts; after a motion has decayed below it, a knock is a release.
_MINIMUM_EXTREME = 0.005
# Noise above which the record is not analysed. 0.02: three releases with 3 % noise are taken for one motion;
# 0.1: noise of 10 % cuts one decay into four.
_MAXIMUM_NOISE = 0.05
# Mean displacement of a half cycle over its amplitude. 0.05: knocks on asymmetric springs are missed; 0.5:
# beats are cut; 1.0: a jump between two wells, which changes the mean, is taken for a knock.
_MAXIMUM_OFFSET = 0.35
# Half of the minimum number of half cycles of a record that can show a knock.
_MINIMUM_KNOCK_PERIODS = 3
# Shortest motion in half periods. 2: the last tenth of a random drive is taken for a motion; 12: decays that
# end in a knock are lost.
_MINIMUM_HALF_PERIODS = 4.0


def find_free_motion(record: PistonRecord, release: int | str | None = None) -> PistonRecord:
    """Return one free motion in a record, from its release on."""
    if release == ALL:
        raise RecordError(
            "release = 'all', but one motion is needed; give the number of a release, or fit all motions "
            "together with fit, compare or discover"
        )
    drives = active_input_names(record) if release is None else []
    if drives:
        return _driven_motion(record, drives)
    motions = _cut_free_motions(record)
    if len(motions) > 1 and release is None:
        times = ", ".join(f"{motion.time[0]:.4g}:{motion.time[-1]:.4g}" for motion in motions)
        warnings.warn(
            f"the record holds {len(motions)} releases, at {times} s; the first is used; for "
            "another: --release 2; for all of them: --release all",
            RecordWarning,
            stacklevel=2,
        )
    if not 1 <= (number := int(release or 1)) <= len(motions):
        raise RecordError(
            f"release {number} does not exist; the record has {len(motions)}, so give a number from 1 to "
            f"{len(motions)}"
        )
    return _cut_motion_at_knock_or_noise(motions[number - 1])


def find_free_motions(record: PistonRecord) -> list[PistonRecord]:
    """Return all free motions in a record; see `find_free_motion`."""
    return [_cut_motion_at_knock_or_noise(motion) for motion in _cut_free_motions(record)]


def _driven_motion(record: PistonRecord, drives: Sequence[str]) -> PistonRecord:
    """Return a driven motion without lost and clipped samples; warn if the record may hold free motions."""
    record = drop_lost_samples_and_spikes(record)
    clipped = clipped_sample_mask(record)
    count = len(_free_motion_slices(record))
    if count > 1:
        warnings.warn(
            f"{' and '.join(map(quote, drives))} acts throughout the record, so the record is not cut; if "
            f"the record instead contains {count} free motions, --release 1 selects the first and "
            "--release all selects all",
            RecordWarning,
            stacklevel=3,
        )
    return cut_at_release(record.select(~clipped) if clipped.any() else record)


def _cut_free_motions(record: PistonRecord) -> list[PistonRecord]:
    """Cut a record into its free motions, each with the hold before it."""
    record = drop_lost_samples_and_spikes(record)
    # a clipped hold still shows a release
    clipped = clipped_sample_mask(record)
    parts = _free_motion_slices(record)
    start = parts[0].start
    if start > 0:
        warnings.warn(
            f"the samples before {record.time[start]:.4g} s, during which the moving part is brought to its "
            "release point, are omitted; to keep them: --between :",
            RecordWarning,
            stacklevel=3,
        )
    if len(parts) == 1 and start == 0 and not clipped.any():
        return [record]
    return [record.select(np.flatnonzero(~clipped[part]) + part.start) for part in parts]


def _cut_motion_at_knock_or_noise(record: PistonRecord) -> PistonRecord:
    """Return the longest part of a motion between knocks, without an end that is lost in the noise."""
    record = cut_at_release(record)
    if active_input_names(record):
        return record
    if impacts := _knock_times(record):
        edges = [
            float(record.time[0]),
            *(edge for times in impacts for edge in times),
            float(record.time[-1]),
        ]
        start, stop = max(zip(edges[::2], edges[1::2], strict=True), key=lambda part: part[1] - part[0])
        times = ", ".join(f"{before:.4g} to {after:.4g}" for before, after in impacts)
        warnings.warn(
            f"the amplitude grows suddenly at {times} s (a knock or another release), so only the longest "
            f"undisturbed part, from {start:.4g} to {stop:.4g} s, is used; to keep all: --between :",
            RecordWarning,
            stacklevel=3,
        )
        record = record.between(start, stop)
    return cut_noise_tail(record)


def _free_motion_slices(record: PistonRecord) -> list[slice]:
    """Return the samples of each free motion, including the hold before it."""
    total = slice(0, len(record))
    if len(record) < LEAST_SAMPLES:
        return [total]
    time = record.time
    displacement = _displacement_from_equilibrium(record)
    away = np.abs(displacement)
    largest = float(away.max())
    half, gaps = _half_period_and_restarts(time, displacement)
    if half is None:
        return [total]
    small = away < _SMALL * largest
    tops = {k: _top_sample_index_of_lift(time, away, small, k, half) for k in gaps}
    restarts = [k for k in gaps if tops[k] or _starts_suddenly(time, away, k, half)]
    starts = [0]
    for first, last in _find_hold_sample_ranges(record, away, half):
        restarts = [
            k for k in restarts if not first - _count_samples_before(time, first, _PAUSE * half) <= k <= last
        ]
        starts.append(first)
    starts += [tops[k] or _onset_sample_index(time, small, k, half) for k in restarts]
    ends = np.append(time[starts := sorted(set(starts))], time[-1])
    starts = [k for k, long in zip(starts, np.diff(ends) > _MINIMUM_HALF_PERIODS * half, strict=True) if long]
    if not starts:
        return [total]
    stops = [_end_index_of_undisturbed_motion(time, displacement, small, k, half) for k in starts[1:]] + [
        len(record)
    ]
    if len(starts) > 1 and not _is_oscillating(away[: stops[0]], _LARGE * largest):
        starts, stops = starts[1:], stops[1:]
    parts = [
        slice(start, stop) for start, stop in zip(starts, stops, strict=True) if stop - start >= LEAST_SAMPLES
    ]
    noise = _NOISE_RANGE * noise_standard_deviation(displacement, time)
    return (
        parts
        if parts and all(_decays_from_start(time[part], displacement[part], noise) for part in parts)
        else [total]
    )


def _decays_from_start(
    time: Float[np.ndarray, "n"], displacement: Float[np.ndarray, "n"], noise: float
) -> bool:
    """Return whether a motion has nearly its maximum amplitude at the start and rarely grows later."""
    _, extremes = _times_and_heights_of_half_cycle_extremes(
        time, displacement, max(noise, _SMALL * float(np.abs(displacement).max()))
    )
    size = 0.5 * np.abs(np.diff(extremes))
    if len(size) < 2:
        return True
    grows = size[1:] > _STEADY_GROWTH * size[:-1]
    return bool(size[0] * _STEADY_GROWTH >= size.max() and grows.mean() <= _DRIVEN_FRACTION)


def _displacement_from_equilibrium(record: PistonRecord) -> np.ndarray:
    """Return the displacement (n,) from equilibrium, which is the final median height crossed most often."""
    # Part of the record may be a hold, whose level is never crossed.
    levels = [np.median(record.height[-max(1, len(record) // part) :]) for part in _END_DIVISORS]
    displacements = [np.asarray(record.height - level) for level in levels]
    counts = [
        len(zero_crossing_times(record.time, displacement, _SMALL * np.abs(displacement).max()))
        for displacement in displacements
    ]
    return displacements[int(np.argmax(counts))]


def _half_period_and_restarts(time: np.ndarray, displacement: np.ndarray) -> tuple[float | None, list[int]]:
    """Return the time between zero crossings, and the samples at which motions restart after a pause."""
    largest, noise = float(np.abs(displacement).max()), noise_standard_deviation(displacement, time)
    passages = zero_crossing_times(time, displacement, _SMALL * largest)
    if len(passages) < _MINIMUM_PASSAGES or noise > _MAXIMUM_NOISE * largest:
        return None, []
    half = float(np.median(np.diff(passages)))
    away = np.abs(displacement)
    large = np.flatnonzero(away > _LARGE * largest)
    small = away < _SMALL * largest
    before, after = large[:-1], large[1:]
    calm = np.concatenate([[0], np.cumsum(small)])
    passes = (after > before + 1) & (calm[after] > calm[before])
    mostly = (calm[after] - calm[before]) > _CALM * (after - before)
    restarts = passes & mostly & (time[after] - time[before] > _PAUSE * half)
    return half, [int(k) for k in after[restarts]]


def _starts_suddenly(time: np.ndarray, away: np.ndarray, start: int, half: float) -> bool:
    """Return whether a motion starts after a calm period; beats instead grow from cycle to cycle."""
    edges = np.searchsorted(time, time[start] + half * np.array([*_BEFORE, *_AFTER]))
    before, first, next_ = (
        float(away[begin:end].max(initial=0.0))
        for begin, end in ((edges[0], edges[1]), (start, edges[2]), (edges[2], edges[3]))
    )
    return bool(before < 1.5 * _SMALL * away.max() and next_ < _STEADY_GROWTH * first)


def _count_samples_before(time: np.ndarray, before: int, duration: float) -> int:
    """Count the samples within a duration before a given sample."""
    return before - int(np.searchsorted(time, time[before] - duration))


def _onset_sample_index(time: np.ndarray, small: np.ndarray, start: int, half: float) -> int:
    """Return the sample at which a motion begins from rest; for a jump, the sample after it."""
    calm = int(np.flatnonzero(small[:start])[-1])
    return start if start - calm <= 2 else calm - _count_samples_before(time, calm, half)


def _top_sample_index_of_lift(
    time: np.ndarray, away: np.ndarray, small: np.ndarray, start: int, half: float
) -> int:
    """Return the sample at which a slow rise from rest turns into a decay; 0 if there is no slow rise."""
    calm = int(np.flatnonzero(small[:start])[-1])
    end = start + int(np.argmax(small[start:])) if small[start:].any() else len(time)
    top = calm + int(np.argmax(away[calm:end]))
    if (
        end == len(time)
        or time[end] - time[top] > _MAXIMUM_FALL * half
        or time[top] - time[calm] < _MINIMUM_LIFT * half
    ):
        return 0
    edges = np.searchsorted(time, [time[calm] + half * _BEFORE[0], time[end] + half * _AFTER[1]])
    before, behind = float(away[edges[0] : calm].max(initial=0.0)), float(away[end : edges[1]].max())
    return top if before < 1.5 * _SMALL * away.max() and behind < _STEADY_GROWTH * away[top] else 0


def _end_index_of_undisturbed_motion(
    time: np.ndarray, displacement: np.ndarray, small: np.ndarray, start: int, half: float
) -> int:
    """Return the first sample that is disturbed by the beginning of the next motion."""
    calm = np.flatnonzero(small[:start])
    if not len(calm):
        return start
    stop = int(calm[-1])
    if start - stop <= 2:  # a jump
        return start
    # from its beginning a lift goes to one side
    other = np.flatnonzero(displacement[:stop] * np.sign(displacement[start]) < 0.0)
    stop = int(other[-1]) if len(other) else stop
    return stop - _count_samples_before(time, stop, _UNDISTURBED_MARGIN * half)


def _find_hold_sample_ranges(record: PistonRecord, away: np.ndarray, half: float) -> list[tuple[int, int]]:
    """Find the first and last sample of each hold: a large constant displacement that then decreases."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

    time, largest = record.time, float(away.max())
    width = int(_MINIMUM_HOLD * half / float(np.median(np.diff(time))))
    if width < 5 or width >= len(time):
        return []
    count = max(1, width // 8)
    mean = uniform_filter1d(record.height, count)
    noise = noise_standard_deviation(record.height, time) / np.sqrt(count)
    extent = maximum_filter1d(mean, width) - minimum_filter1d(mean, width)
    still = (extent < _HOLD_RANGE * largest + _NOISE_RANGE * noise) & (away > _LARGE * largest)
    holds: list[tuple[int, int]] = []
    for begin, end in start_and_stop_of_mask_runs(still):
        first, last = max(0, begin - width // 4), min(len(time) - 1, end + width // 2)
        together = bool(holds) and first - holds[-1][1] < width  # noise cuts a hold in two
        holds.append((holds.pop()[0] if together else first, last))
    ends = [int(np.searchsorted(time, time[last] + _MAXIMUM_FALL * half)) for _, last in holds]
    return [
        hold
        for hold, end in zip(holds, ends, strict=True)
        if away[hold[1] : end].min(initial=np.inf) < _SMALL * largest
    ]


def _is_oscillating(away: np.ndarray, minimum: float) -> bool:
    """Return whether a displacement is repeatedly large, above a minimum, and small in between."""
    largest = max(minimum, float(away.max(initial=0.0)))
    kinds = np.where(away > _LARGE * largest, 1, np.where(away < _SMALL * largest, -1, 0))
    kinds = kinds[kinds != 0]
    return bool((np.diff(kinds) > 0).sum() + (kinds[:1] > 0).sum() >= _MINIMUM_LARGE_HALF_CYCLES)


def _knock_times(record: PistonRecord) -> list[tuple[float, float]]:
    """Return the times [s] of the extremes before and after each sudden growth of a free oscillation."""
    if len(record) < LEAST_SAMPLES:
        return []
    time = record.time
    displacement = _displacement_from_equilibrium(record)
    half, _ = _half_period_and_restarts(time, displacement)
    if half is None:
        return []
    from scipy.ndimage import uniform_filter1d

    count = max(1, int(_AVERAGING_TIME * half / float(np.median(np.diff(time)))))
    noise = _NOISE_RANGE * noise_standard_deviation(displacement, time) / np.sqrt(count)
    displacement = uniform_filter1d(displacement, count)
    times, extremes = _times_and_heights_of_half_cycle_extremes(
        time, displacement, max(noise, _MINIMUM_EXTREME * float(np.abs(displacement).max()))
    )
    size, middle = 0.5 * np.abs(np.diff(extremes)), 0.5 * (extremes[1:] + extremes[:-1])
    grows = (size[1:] > _STEADY_GROWTH * size[:-1]) & (size[1:] - size[:-1] > noise / np.sqrt(2.0))
    if len(size) < 2 * _MINIMUM_KNOCK_PERIODS or grows.mean() > _DRIVEN_FRACTION:
        return []
    knocks = []
    for before, after in start_and_stop_of_mask_runs(grows):
        if size[after] <= _KNOCK_GROWTH * size[before]:
            continue
        if after - before > _KNOCK_HALF_CYCLES:  # a drive or a beat
            return []
        if (np.abs(middle[[before, after]]) > _MAXIMUM_OFFSET * size[[before, after]]).any():
            return []
        # the first and last half cycles may be cut by the record's ends
        if before > 0 and after < len(size) - 1:
            knocks.append((float(times[before]), float(times[after + 1])))
    return [] if knocks and _is_beat_of_two_modes(time, displacement, half, knocks) else knocks


def _is_beat_of_two_modes(
    time: np.ndarray, displacement: np.ndarray, half: float, knocks: list[tuple[float, float]]
) -> bool:
    """Return whether two decaying modes continue through all supposed knocks."""
    # Their sum obeys a linear recurrence of order four (Prony 1795), which a knock breaks.
    edges = np.arange(time[0], time[-1], 2.0 * half / _SAMPLES_PER_PERIOD)
    firsts = np.searchsorted(time, edges)
    counts = np.diff(np.append(firsts, len(time)))
    if counts.min() < 1:
        return False
    means = np.add.reduceat(displacement, firsts) / counts
    windows = np.lib.stride_tricks.sliding_window_view(means, _RECURRENCE_ORDER + 1)
    known, wanted = np.column_stack([windows[:, :-1], np.ones(len(windows))]), windows[:, -1]
    prediction_residuals = np.abs(wanted - known @ np.linalg.lstsq(known, wanted, rcond=None)[0])
    here = edges[_RECURRENCE_ORDER:]
    within = np.any([(here >= before) & (here <= after + half) for before, after in knocks], axis=0)
    return bool(
        prediction_residuals[within].max(initial=0.0)
        <= _BROKEN_RATIO * np.sqrt((prediction_residuals[~within] ** 2).mean())
    )


def _times_and_heights_of_half_cycle_extremes(
    time: Float[np.ndarray, "n"], displacement: Float[np.ndarray, "n"], minimum: float
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Return times [s] and displacements of the extremes of all half cycles above a minimum."""
    beyond = np.flatnonzero(np.abs(displacement) > minimum)
    firsts = np.flatnonzero(np.diff(np.sign(displacement[beyond]), prepend=0.0))
    parts = np.split(beyond, firsts[1:]) if len(firsts) else []
    tops = np.array([part[np.argmax(np.abs(displacement[part]))] for part in parts], dtype=int)
    return time[tops], displacement[tops]


_MINIMUM_AMPLITUDE, _MINIMUM_NOISES = 0.01, 4.0
"""Minimum amplitude of a cycle, as a fraction of the maximum amplitude and as a multiple of the noise."""
_MAXIMUM_BLOCKS = 60
"""Maximum number of parts of a motion; with more cycles than this, several cycles form one part."""
_FEW_CYCLES = 10
"""Minimum number of complete cycles; a motion with fewer cycles is divided into half cycles."""
# A single cycle has no standard error.
_MINIMUM_HELD_OUT = 2


def find_cycles_above_noise(
    time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"], moving_samples: int
) -> tuple[slice, ...]:
    """Return the samples of each complete cycle above the noise, among the first ``moving_samples``."""
    # The errors in both halves of a cycle are similar, so whole cycles are used. Few cycles are halved, since
    # a standard error needs enough parts; more than `_MAXIMUM_BLOCKS` parts do not improve it.
    displacement = height[:moving_samples] - height[-len(height) // 3 :].mean()
    largest = float(np.abs(displacement).max())
    minimum = max(_MINIMUM_AMPLITUDE * largest, _MINIMUM_NOISES * noise_standard_deviation(height, time))
    passages = zero_crossing_times(time[:moving_samples], displacement, min(minimum, 0.5 * largest))
    passages = passages[::2] if len(passages) > 2 * _FEW_CYCLES else passages
    passages = passages[:: max(1, -(-len(passages) // _MAXIMUM_BLOCKS))]
    edges = np.searchsorted(time[:moving_samples], passages)
    return tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(edges) if b > a)


def choose_held_out_cycles(
    time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"], fraction: float, moving_samples: int
) -> tuple[slice, ...]:
    """Return the samples of a fraction of the cycles, evenly spread over the first ``moving_samples``."""
    # The first one is never held out, since it determines the initial state.
    cycles = find_cycles_above_noise(time, height, moving_samples)
    passed = np.floor(fraction * np.arange(len(cycles) + 1) + 0.5 + 1e-9)
    chosen = tuple(cycle for cycle, step in zip(cycles, np.diff(passed), strict=True) if step > 0.0)
    chosen = chosen[1:] if chosen[:1] == cycles[:1] else chosen
    return chosen if len(chosen) >= _MINIMUM_HELD_OUT else ()


class PredictionErrorEstimate(NamedTuple):
    """Prediction error of a law on held-out cycles, divided by the rms displacement of the record."""

    value: float
    at_rest: float  # error of a piston that stays at rest
    standard_error: float | None  # from the scatter between cycles; None for a single cycle


def prediction_error_on_cycles(
    residuals: Float[np.ndarray, "n"],
    displacement: Float[np.ndarray, "n"],
    cycles: Sequence[slice],
    rms_displacement: float,
) -> PredictionErrorEstimate:
    """Return the prediction error of a law on given cycles, with its standard error."""
    # Squared errors are summed, so each cycle counts by its size. The standard error is the error of their
    # ratio to the cycles' squared displacements (for a wrong law) or lengths (for noise), whichever scatters
    # less (ratio estimator, Cochran 1977, Sampling Techniques, ch. 6).
    counts = np.array([cycle.stop - cycle.start for cycle in cycles])
    squared_error = np.array([float((residuals[cycle] ** 2).sum()) for cycle in cycles])
    squared_displacement = np.array([float((displacement[cycle] ** 2).sum()) for cycle in cycles])
    total, several = float(counts.sum()), len(cycles)
    value, at_rest = (
        math.sqrt(squares.sum() / total) / rms_displacement
        for squares in (squared_error, squared_displacement)
    )
    if several < 2 or not 0.0 < value < math.inf or not at_rest > 0.0:
        return PredictionErrorEstimate(value, at_rest, None)
    prediction_residuals = [
        squared_error - size * squared_error.sum() / size.sum() for size in (squared_displacement, counts)
    ]
    spread = (
        math.sqrt(several / (several - 1) * min(float(part @ part) for part in prediction_residuals)) / total
    )
    return PredictionErrorEstimate(value, at_rest, spread / (2.0 * value * rms_displacement**2))
