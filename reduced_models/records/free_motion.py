"""The free motion in a record: lost samples, and what was done before and after it, are no part.

A record may hold several motions, each from its release to what disturbs it. While it swings, a
displacement is large again after each half period. Another release shows by a pause in which it is
small, by a hold, a large displacement that stands still for longer than a turning point does, or by a
lift, a rise from a calm that takes longer than a swing's. A knock shows by a swing that is suddenly
larger than the one before it.

Whole swings of a record: those that no fit sees, and how well a law predicts them.

A law is tested where something can be lost: on whole swings that are spread over all of the motion,
while an end that has come to rest would judge nothing.
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
from reduced_models.records.derivatives import noise_level
from reduced_models.records.first_guesses import LEAST_SAMPLES, zero_crossing_times
from reduced_models.records.release import active_inputs, cut_at_release
from reduced_models.records.sensor_artefacts import (
    clipped_sample_mask,
    cut_noise_tail,
    drop_lost_samples,
    mask_runs,
)

# Thresholds. Durations are in half periods of the record's motion, displacements over its largest one.
# The values come from the records of tests/reduced_models/records/test_motion.py: decays of damping ratio
# 0.05 under 1 % of noise that are held, lifted by hand, released two or three times, knocked or clipped,
# and beats, which are one motion. What breaks was found by changing one value at a time on these and on
# decays of damping ratio 0.005 to 0.6, knocks of 0.2 to 1.5, beats, sweeps, oscillators with two wells or a
# one-sided spring, and random drives.

# Parts of a record, at its end, whose median may be the equilibrium. A record held for most of its time
# asks for the short ones (a fifth alone misses two of three releases), one that ends held for the fifth.
_ENDS = (5, 10, 20, 40)
# Large displacement. 0.25: a sweep through resonance and a fall from one well into another are cut in two;
# 0.6: a release from half the height of the first is missed.
_LARGE = 0.4
# Small displacement, three times `_NOISIEST`, that noise alone does not leave a calm. 0.12: the end of
# a decay hides a knock of 0.7; 0.3: decays of damping ratio 0.2 are small from their first cycle on.
_SMALL = 0.16
# Start and end of the time before a release in which nothing is large. From -1 on, steps from one hold to
# another are taken for releases; from -6 on, the motion after a knock 1.5 s into a decay is missed; until 0,
# the slope of a knock or a quick lift is in it; until -0.5, an oscillation in two wells is cut.
_BEFORE = (-2.0, -0.2)
# Start and end of the time after a release in which no half cycle may be larger than the first. Beats and
# random drives grow for longer: they are cut in two if it starts at 2 or ends at 2.
_AFTER = (1.0, 4.0)
# Time without a large displacement before another release. A free oscillation is large again after 1, so
# 0.5 to 4 do the same on all these records; 16: a release 20 after another is missed.
_PAUSE = 2.0
# Fraction of a pause with small displacements. 0 to 0.4 do the same; 0.6: the motion after a knock is
# missed; 0.8: so are releases, since the end of the last decay is itself seen.
_CALM = 0.4
# Passages through equilibrium that give a period. Two to six do the same; none or one: no half period, NaN;
# eight: the three releases of damping ratio 0.2 are taken for one motion.
_LEAST_PASSAGES = 4
# Shortest hold. 0.4: turning points under 3 % of noise are taken for holds; 2.0: holds of 0.2 s before
# motions of period 0.24 s are missed, and the last decay keeps the lift.
_STILL = 1.2
# Height of a hold: a turning point leaves 2 % of its height after 0.06 periods. 0: holds that creep by 15 %
# are cut late; 0.05: slow turning points of a one-sided spring are taken for holds.
_FLAT = 0.02
# The same in standard deviations of the noise, as a range of many samples is. 2: holds under 4.5 % of noise
# are missed; 12: slow beats are cut. Also the growth by which a knock rises above the noise.
_SIGMAS = 6.0
# Longest fall from a hold or a lift to a small displacement; a released motion needs half of one. 0.6: a
# lift of 0.5 s whose top is flat is missed; from 0.8 up nothing changes here.
_FALLS = 1.2
# Shortest lift; an oscillation rises in 0.5. Up to 0.5, knocks are taken for lifts and the motion before
# loses 0.3 s; from 1.0 on, lifts of 0.15 s are part of the decay before them.
_SLOW = 0.75
# End of a motion in which the lift behind it may have begun. 0: the last decay lasts 0.36 s longer, into
# the lift; longer: good samples are lost.
_LEFT = 3.0
# Samples a period of the recurrence of two modes, its order, and its residual over the rms of the others from
# which on it is broken.
_RECURRENT, _ORDER, _BROKEN = 8, 4, 6.0
# Large half cycles that make a motion of what is before a hold. 2: a hand that slips before the release
# makes one; 4: the first of three releases of damping ratio 0.1 is lost.
_MINIMUM_LARGE_HALF_CYCLES = 3
# Growth of a half cycle that shows a knock, and what noise and sampling make of a steady one. On 60 decays
# with one to three knocks of 0.5 to 2, and twelve of each of ten kinds without any (beats, two modes, sweeps,
# random drives, two wells, one-sided springs), both under 0, 0.5 and 2 % of noise.
_GROWN, _STEADY = 1.25, 1.05
# Half cycles in which a knock is over: one before its own, its own and one behind. Beats grow for longer.
_SUDDEN = 3
# Fraction of growing half cycles, above which a record beats or is driven.
_RARELY = 0.2
# Average that lowers the noise, in half periods: an eighth of a period lowers all extremes by 3 %.
_SMOOTHED = 0.25
# Smallest extreme that counts; where a motion has decayed to less, a knock is a release.
_SEEN = 0.005
# Noise above which nothing is concluded. 0.02: three releases under 3 % of noise are taken for one motion;
# 0.1: noise of 10 % cuts one decay into four.
_NOISIEST = 0.05
# Middle of a cycle over its height. 0.05: knocks on asymmetric springs are missed; 0.5: beats are cut; 1.0:
# a jump between two wells, which changes the middle, is taken for a knock.
_CENTRED = 0.35
# Half of the half cycles of a record that can show a knock.
_LEAST_PERIODS = 3
# Shortest motion in half periods. 2: the last tenth of a random drive is taken for a motion; 12: decays cut
# short by a knock are lost.
_LEAST_HALVES = 4.0


def find_free_motion(record: PistonRecord, release: int | str | None = None) -> PistonRecord:
    """Return a free motion in a record, from its release on."""
    if release == ALL:
        raise RecordError(
            "release = 'all' where one motion is taken; give its number, or take them together "
            "with fit, compare or discover"
        )
    drives = active_inputs(record) if release is None else []
    if drives:
        return _driven_motion(record, drives)
    motions = _cut_free_motions(record)
    if len(motions) > 1 and release is None:
        times = ", ".join(f"{motion.time[0]:.4g}:{motion.time[-1]:.4g}" for motion in motions)
        warnings.warn(
            f"the record holds {len(motions)} releases, at {times} s, and the first is taken; for "
            "another: --release 2; for all of them: --release all",
            RecordWarning,
            stacklevel=2,
        )
    if not 1 <= (number := int(release or 1)) <= len(motions):
        raise RecordError(
            f"release {number} of a record that holds {len(motions)}; give one from 1 to {len(motions)}"
        )
    return _trim_motion(motions[number - 1])


def find_free_motions(record: PistonRecord) -> list[PistonRecord]:
    """Return all free motions in a record; see `find_free_motion`."""
    return [_trim_motion(motion) for motion in _cut_free_motions(record)]


def _driven_motion(record: PistonRecord, drives: Sequence[str]) -> PistonRecord:
    """Whole record of a motion that columns drive, without lost and clipped samples."""
    record = drop_lost_samples(record)
    clipped = clipped_sample_mask(record)
    count = len(_free_motion_slices(record))
    if count > 1:
        warnings.warn(
            f"{' and '.join(map(quote, drives))} acts in all of the record, which stays whole; if it holds "
            f"{count} free motions, --release 1 takes the first, and --release all each of them",
            RecordWarning,
            stacklevel=3,
        )
    return cut_at_release(record.select(~clipped) if clipped.any() else record)


def _cut_free_motions(record: PistonRecord) -> list[PistonRecord]:
    """Free motions of a record, each with what stands still before it."""
    record = drop_lost_samples(record)
    # a hold that is clipped tells a release all the same
    clipped = clipped_sample_mask(record)
    parts = _free_motion_slices(record)
    start = parts[0].start
    if start > 0:
        warnings.warn(
            f"before {record.time[start]:.4g} s what moves is moved to where it is held and "
            "released, and that is left out; to keep it: --between :",
            RecordWarning,
            stacklevel=3,
        )
    if len(parts) == 1 and start == 0 and not clipped.any():
        return [record]
    return [record.select(np.flatnonzero(~clipped[part]) + part.start) for part in parts]


def _trim_motion(record: PistonRecord) -> PistonRecord:
    """Motion from its release to a knock, or to where the noise rules."""
    record = cut_at_release(record)
    if active_inputs(record):
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
            f"a swing that grows suddenly, at {times} s, was knocked or released anew: the longest part "
            f"without that, from {start:.4g} to {stop:.4g} s, is taken; to keep all: --between :",
            RecordWarning,
            stacklevel=3,
        )
        record = record.between(start, stop)
    return cut_noise_tail(record)


def _free_motion_slices(record: PistonRecord) -> list[slice]:
    """Return the samples of each free motion, with the hold before it."""
    total = slice(0, len(record))
    if len(record) < LEAST_SAMPLES:
        return [total]
    time = record.time
    swing = _displacement_from_equilibrium(record)
    away = np.abs(swing)
    largest = float(away.max())
    half, gaps = _half_period_and_restarts(time, swing)
    if half is None:
        return [total]
    small = away < _SMALL * largest
    tops = {k: _top_sample_of_lift(time, away, small, k, half) for k in gaps}
    anew = [k for k in gaps if tops[k] or _starts_suddenly(time, away, k, half)]
    starts = [0]
    for first, last in _find_holds(record, away, half):
        anew = [k for k in anew if not first - _count_samples_before(time, first, _PAUSE * half) <= k <= last]
        starts.append(first)
    starts += [tops[k] or _onset_sample(time, small, k, half) for k in anew]
    ends = np.append(time[starts := sorted(set(starts))], time[-1])
    starts = [k for k, long in zip(starts, np.diff(ends) > _LEAST_HALVES * half, strict=True) if long]
    if not starts:
        return [total]
    stops = [_end_of_undisturbed_motion(time, swing, small, k, half) for k in starts[1:]] + [len(record)]
    if len(starts) > 1 and not _is_oscillating(away[: stops[0]], _LARGE * largest):
        starts, stops = starts[1:], stops[1:]
    parts = [
        slice(start, stop) for start, stop in zip(starts, stops, strict=True) if stop - start >= LEAST_SAMPLES
    ]
    noise = _SIGMAS * noise_level(swing, time)
    return parts if parts and all(_decays(time[part], swing[part], noise) for part in parts) else [total]


def _decays(time: Float[np.ndarray, "n"], swing: Float[np.ndarray, "n"], noise: float) -> bool:
    """Return whether a motion is largest at first and hardly grows again, as noise does."""
    _, extremes = _half_cycle_extremes(time, swing, max(noise, _SMALL * float(np.abs(swing).max())))
    size = 0.5 * np.abs(np.diff(extremes))
    if len(size) < 2:
        return True
    grows = size[1:] > _STEADY * size[:-1]
    return bool(size[0] * _STEADY >= size.max() and grows.mean() <= _RARELY)


def _displacement_from_equilibrium(record: PistonRecord) -> np.ndarray:
    """Displacement (n,) from the level of the record's end passed most often: part of it may be held."""
    levels = [np.median(record.height[-max(1, len(record) // part) :]) for part in _ENDS]
    swings = [np.asarray(record.height - level) for level in levels]
    counts = [len(zero_crossing_times(record.time, swing, _SMALL * np.abs(swing).max())) for swing in swings]
    return swings[int(np.argmax(counts))]


def _half_period_and_restarts(time: np.ndarray, swing: np.ndarray) -> tuple[float | None, list[int]]:
    """Time from one passage through rest to the next, and samples of a motion after a pause."""
    largest, noise = float(np.abs(swing).max()), noise_level(swing, time)
    passages = zero_crossing_times(time, swing, _SMALL * largest)
    if len(passages) < _LEAST_PASSAGES or noise > _NOISIEST * largest:
        return None, []
    half = float(np.median(np.diff(passages)))
    away = np.abs(swing)
    large = np.flatnonzero(away > _LARGE * largest)
    small = away < _SMALL * largest
    before, after = large[:-1], large[1:]
    calm = np.concatenate([[0], np.cumsum(small)])
    passes = (after > before + 1) & (calm[after] > calm[before])
    mostly = (calm[after] - calm[before]) > _CALM * (after - before)
    anew = passes & mostly & (time[after] - time[before] > _PAUSE * half)
    return half, [int(k) for k in after[anew]]


def _starts_suddenly(time: np.ndarray, away: np.ndarray, start: int, half: float) -> bool:
    """Return True where it was calm for a period before; beats grow from swing to swing."""
    edges = np.searchsorted(time, time[start] + half * np.array([*_BEFORE, *_AFTER]))
    before, first, next_ = (
        float(away[begin:end].max(initial=0.0))
        for begin, end in ((edges[0], edges[1]), (start, edges[2]), (edges[2], edges[3]))
    )
    return bool(before < 1.5 * _SMALL * away.max() and next_ < _STEADY * first)


def _count_samples_before(time: np.ndarray, before: int, duration: float) -> int:
    """Count the samples of a time before one of them."""
    return before - int(np.searchsorted(time, time[before] - duration))


def _onset_sample(time: np.ndarray, small: np.ndarray, start: int, half: float) -> int:
    """Sample at which a motion leaves a calm; a jump starts where it lands."""
    calm = int(np.flatnonzero(small[:start])[-1])
    return start if start - calm <= 2 else calm - _count_samples_before(time, calm, half)


def _top_sample_of_lift(
    time: np.ndarray, away: np.ndarray, small: np.ndarray, start: int, half: float
) -> int:
    """Sample at which a slow rise from a calm turns into a decay; 0 where a motion starts otherwise."""
    calm = int(np.flatnonzero(small[:start])[-1])
    end = start + int(np.argmax(small[start:])) if small[start:].any() else len(time)
    top = calm + int(np.argmax(away[calm:end]))
    if end == len(time) or time[end] - time[top] > _FALLS * half or time[top] - time[calm] < _SLOW * half:
        return 0
    edges = np.searchsorted(time, [time[calm] + half * _BEFORE[0], time[end] + half * _AFTER[1]])
    before, behind = float(away[edges[0] : calm].max(initial=0.0)), float(away[end : edges[1]].max())
    return top if before < 1.5 * _SMALL * away.max() and behind < _STEADY * away[top] else 0


def _end_of_undisturbed_motion(
    time: np.ndarray, swing: np.ndarray, small: np.ndarray, start: int, half: float
) -> int:
    """Sample behind the last one that what sets the next motion off has not touched."""
    calm = np.flatnonzero(small[:start])
    if not len(calm):
        return start
    stop = int(calm[-1])
    if start - stop <= 2:  # a jump
        return start
    # from its beginning a lift goes to one side
    other = np.flatnonzero(swing[:stop] * np.sign(swing[start]) < 0.0)
    stop = int(other[-1]) if len(other) else stop
    return stop - _count_samples_before(time, stop, _LEFT * half)


def _find_holds(record: PistonRecord, away: np.ndarray, half: float) -> list[tuple[int, int]]:
    """First and last samples of large displacements that stand still, and then fall."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

    time, largest = record.time, float(away.max())
    width = int(_STILL * half / float(np.median(np.diff(time))))
    if width < 5 or width >= len(time):
        return []
    count = max(1, width // 8)
    mean = uniform_filter1d(record.height, count)
    noise = noise_level(record.height, time) / np.sqrt(count)
    extent = maximum_filter1d(mean, width) - minimum_filter1d(mean, width)
    still = (extent < _FLAT * largest + _SIGMAS * noise) & (away > _LARGE * largest)
    holds: list[tuple[int, int]] = []
    for begin, end in mask_runs(still):
        first, last = max(0, begin - width // 4), min(len(time) - 1, end + width // 2)
        together = bool(holds) and first - holds[-1][1] < width  # noise cuts a hold in two
        holds.append((holds.pop()[0] if together else first, last))
    ends = [int(np.searchsorted(time, time[last] + _FALLS * half)) for _, last in holds]
    return [
        hold
        for hold, end in zip(holds, ends, strict=True)
        if away[hold[1] : end].min(initial=np.inf) < _SMALL * largest
    ]


def _is_oscillating(away: np.ndarray, least: float) -> bool:
    """Return whether a displacement of a least size is large, and small between, several times."""
    largest = max(least, float(away.max(initial=0.0)))
    kinds = np.where(away > _LARGE * largest, 1, np.where(away < _SMALL * largest, -1, 0))
    kinds = kinds[kinds != 0]
    return bool((np.diff(kinds) > 0).sum() + (kinds[:1] > 0).sum() >= _MINIMUM_LARGE_HALF_CYCLES)


def _knock_times(record: PistonRecord) -> list[tuple[float, float]]:
    """Return the times of the extremes before and after each sudden growth of a free oscillation [s]."""
    if len(record) < LEAST_SAMPLES:
        return []
    time = record.time
    swing = _displacement_from_equilibrium(record)
    half, _ = _half_period_and_restarts(time, swing)
    if half is None:
        return []
    from scipy.ndimage import uniform_filter1d

    count = max(1, int(_SMOOTHED * half / float(np.median(np.diff(time)))))
    noise = _SIGMAS * noise_level(swing, time) / np.sqrt(count)
    swing = uniform_filter1d(swing, count)
    times, extremes = _half_cycle_extremes(time, swing, max(noise, _SEEN * float(np.abs(swing).max())))
    size, middle = 0.5 * np.abs(np.diff(extremes)), 0.5 * (extremes[1:] + extremes[:-1])
    grows = (size[1:] > _STEADY * size[:-1]) & (size[1:] - size[:-1] > noise / np.sqrt(2.0))
    if len(size) < 2 * _LEAST_PERIODS or grows.mean() > _RARELY:
        return []
    knocks = []
    for before, after in mask_runs(grows):
        if size[after] <= _GROWN * size[before]:
            continue
        if after - before > _SUDDEN:  # a drive or a beat
            return []
        if (np.abs(middle[[before, after]]) > _CENTRED * size[[before, after]]).any():
            return []
        # the first and last half cycles may be cut by the record's ends
        if before > 0 and after < len(size) - 1:
            knocks.append((float(times[before]), float(times[after + 1])))
    return [] if knocks and _beats(time, swing, half, knocks) else knocks


def _beats(time: np.ndarray, swing: np.ndarray, half: float, knocks: list[tuple[float, float]]) -> bool:
    """Return whether two modes that decay go on through all supposed knocks."""
    # Their sum repeats a linear recurrence of order four (Prony 1795), which a knock breaks.
    edges = np.arange(time[0], time[-1], 2.0 * half / _RECURRENT)
    firsts = np.searchsorted(time, edges)
    counts = np.diff(np.append(firsts, len(time)))
    if counts.min() < 1:
        return False
    means = np.add.reduceat(swing, firsts) / counts
    windows = np.lib.stride_tricks.sliding_window_view(means, _ORDER + 1)
    known, wanted = np.column_stack([windows[:, :-1], np.ones(len(windows))]), windows[:, -1]
    left = np.abs(wanted - known @ np.linalg.lstsq(known, wanted, rcond=None)[0])
    here = edges[_ORDER:]
    within = np.any([(here >= before) & (here <= after + half) for before, after in knocks], axis=0)
    return bool(left[within].max(initial=0.0) <= _BROKEN * np.sqrt((left[~within] ** 2).mean()))


def _half_cycle_extremes(
    time: Float[np.ndarray, "n"], swing: Float[np.ndarray, "n"], least: float
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Return times [s] and values of the largest displacement of each half cycle beyond a least one."""
    beyond = np.flatnonzero(np.abs(swing) > least)
    firsts = np.flatnonzero(np.diff(np.sign(swing[beyond]), prepend=0.0))
    parts = np.split(beyond, firsts[1:]) if len(firsts) else []
    tops = np.array([part[np.argmax(np.abs(swing[part]))] for part in parts], dtype=int)
    return time[tops], swing[tops]


_LEAST_SWING, _NOISES = 0.01, 4.0
"""Amplitude that a swing must have, over the greatest one, and in noise levels."""
_MOST_BLOCKS = 60
"""Swings of a record, above which several together are one block."""
_FEWEST_SWINGS = 10
"""Whole swings of a motion; half swings are taken where there are fewer."""
# One swing has no standard error.
_FEWEST_TESTED = 2


def find_whole_cycles(
    time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"], moving_samples: int
) -> tuple[slice, ...]:
    """Return the samples of the whole swings above the noise; time [s], height [m, rad]."""
    # The errors of two halves of a cycle are alike. Few cycles are halved, or too few parts remain for a
    # standard error; more than `_MOST_BLOCKS` parts tell no more of it.
    swing = height[:moving_samples] - height[-len(height) // 3 :].mean()
    largest = float(np.abs(swing).max())
    least = max(_LEAST_SWING * largest, _NOISES * noise_level(height, time))
    passages = zero_crossing_times(time[:moving_samples], swing, min(least, 0.5 * largest))
    passages = passages[::2] if len(passages) > 2 * _FEWEST_SWINGS else passages
    passages = passages[:: max(1, -(-len(passages) // _MOST_BLOCKS))]
    edges = np.searchsorted(time[:moving_samples], passages)
    return tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(edges) if b > a)


def choose_held_out_cycles(
    time: Float[np.ndarray, "n"], height: Float[np.ndarray, "n"], fraction: float, moving_samples: int
) -> tuple[slice, ...]:
    """Return the samples of a fraction of the whole swings, evenly spread; time [s], height [m, rad]."""
    # The first one is not among them: it fixes the initial state.
    swings = find_whole_cycles(time, height, moving_samples)
    passed = np.floor(fraction * np.arange(len(swings) + 1) + 0.5 + 1e-9)
    chosen = tuple(swing for swing, step in zip(swings, np.diff(passed), strict=True) if step > 0.0)
    chosen = chosen[1:] if chosen[:1] == swings[:1] else chosen
    return chosen if len(chosen) >= _FEWEST_TESTED else ()


class PredictionErrorEstimate(NamedTuple):
    """Error of a law on swings that it has not seen, over the rms swing of the record."""

    value: float
    at_rest: float  # of a piston that stays at rest
    standard_error: float | None  # by its difference between swings; None of one


def prediction_error_on_cycles(
    residuals: Float[np.ndarray, "n"],
    displacement: Float[np.ndarray, "n"],
    swings: Sequence[slice],
    rms_swing: float,
) -> PredictionErrorEstimate:
    """Return the test error of a law, with its standard error; residuals [m, rad]."""
    # Squared errors are summed, so each swing counts by its size. The standard error is of their ratio to the
    # swings' own squares (a wrong law) or lengths (noise), whichever scatters less (ratio estimator, Cochran
    # 1977, Sampling Techniques, ch. 6).
    counts = np.array([swing.stop - swing.start for swing in swings])
    lost = np.array([float((residuals[swing] ** 2).sum()) for swing in swings])
    at_stake = np.array([float((displacement[swing] ** 2).sum()) for swing in swings])
    total, several = float(counts.sum()), len(swings)
    value, at_rest = (math.sqrt(squares.sum() / total) / rms_swing for squares in (lost, at_stake))
    if several < 2 or not 0.0 < value < math.inf or not at_rest > 0.0:
        return PredictionErrorEstimate(value, at_rest, None)
    left = [lost - size * lost.sum() / size.sum() for size in (at_stake, counts)]
    spread = math.sqrt(several / (several - 1) * min(float(part @ part) for part in left)) / total
    return PredictionErrorEstimate(value, at_rest, spread / (2.0 * value * rms_swing**2))
