"""Find the release in a record; the hold before the release is not part of the motion.

A recorder that is started by a trigger or by hand records the hold first. The moving part is then held, so a
fit that includes the hold gives too low a frequency and too much damping.

A hold and a slow start differ in the growth of the displacement. After a hold, the displacement grows as the
square of the time since the release, or faster. The release time is therefore the vertex of a parabola
through the times at which two levels are crossed. A second parabola, through two higher levels, is a check.
If its vertex is clearly later, the motion grows gradually, from an unstable equilibrium or at a resonance,
and there is no release. If a motion starts at a turning point, the vertex is at the start of the record.
Shortly before a turning point a motion is curved, whereas a hold is straight.
"""

from __future__ import annotations

import math
import warnings

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import RecordWarning
from reduced_models.records.derivatives import noise_standard_deviation, spectral_peak_frequency
from reduced_models.records.first_guesses import LEAST_SAMPLES
from reduced_models.records.inputs import input_column, input_column_names

# Levels of the growth, over the maximum displacement (a full stroke): lowest, ratio, highest. A cosine
# reaches 0.05 and 0.2 of it at the times of a parabola, to 4 %. With 0.1, or 0.8, holds of a tenth of a
# period are missed, and logistic growth is taken for a release.
_LOWEST_LEVEL, _LEVEL_RATIO, _HIGHEST_LEVEL = 0.05, 4.0, 0.6
# Maximum of the lowest level, which noise may raise to four standard deviations. The highest level is six
# times it, 0.84; from 0.167 on it would exceed the maximum displacement.
_MAXIMUM_LOWEST_LEVEL = 0.14
# Shortest hold over the rise time to the highest level. In simulated records 0.5 misses holds of a tenth of a
# period, 0.2 gives the same as 0.3, and 0.1 finds holds of a twentieth too.
_MINIMUM_HOLD = 0.3
# Fraction of the time between the first two levels by which the higher ones may give a later release. With
# 0.5 logistic growth and the descent from a hump are taken for releases; with 0.1 nothing changes.
_LATER_RELEASE = 0.25
# Maximum curvature of a hold over the curvature of the motion, and maximum of its standard error due to noise
# (0.2: holds of a tenth of a period with 2 % noise are missed).
_STRAIGHT_CURVATURE, _CURVATURE_ERROR = 0.1, 0.6
_LEVEL_SIGMAS = 4.0
_CHANGED_FRACTION, _DRIVE_FRACTION = 0.1, 0.25
"""Fractions of the range of a column. A change above `_CHANGED_FRACTION` marks a release; a change above
`_DRIVE_FRACTION` shows a drive."""
_MINIMUM_DRIVE_FRACTION = 0.1
"""Minimum fraction of a record between the first and the last sample in which a drive acts."""
_HUM_RATIO, _SLOW_POWER = 5.0, 0.01
"""A column counts as hum, not as a drive, if less than `_SLOW_POWER` of its power lies below `_HUM_RATIO`
times the motion's frequency. Parametric and superharmonic drives (at 2 or 3 times this frequency) do not."""
_DRIVE_WORDS = ("force", "base", "drive", "input")
"""Only columns with one of these words in their name count as drives; a temperature does not."""


def cut_at_release(record: PistonRecord) -> PistonRecord:
    """Cut off the start of a record before the release, if the motion begins from rest.

    A hold is recognised by its end (see `reduced_models.records.release`): the displacement then
    grows as the square of the time since the release, or faster. Nothing is cut if a column whose
    name contains force, base, drive or input acts during the hold, or if the noise is strong.

    Parameters
    ----------
    record : PistonRecord
        Record that may begin with a hold.

    Returns
    -------
    PistonRecord
        Record from the release on, with unchanged times [s] and all columns; the same object if the
        record does not begin at rest or has fewer than 20 samples.

    Warns
    -----
    RecordWarning
        If the record is cut; the warning gives the end of the hold.

    Examples
    --------
    >>> import numpy as np
    >>> from reduced_models import PistonRecord, cut_at_release
    >>> time = np.linspace(0.0, 2.0, 2000)
    >>> record = PistonRecord(time, 0.06 + 1e-3 * np.exp(-0.8 * time) * np.cos(21.8 * time))
    >>> cut_at_release(record) is record  # it oscillates from its start on
    True
    """
    start = release_sample_index(record)
    if start == 0:
        return record
    until = round(float(record.time[start]), 9)
    warnings.warn(
        f"the record is at rest until {until:.4g} s and is cut there, at the release; to keep "
        "all of it: --between :",
        RecordWarning,
        stacklevel=2,
    )
    return record.between(float(record.time[start]), math.inf)


def release_sample_index(record: PistonRecord) -> int:
    """Return the index of the sample at the release; 0 if the record does not begin at rest."""
    # The parabola through two levels of the growth starts at the release (see the module).
    if len(record) < LEAST_SAMPLES:
        return 0
    time = record.time - record.time[0]
    result = _release_time_and_rise_time(time, record.height)
    if result is None:
        return 0
    release_time, rise = result
    start, early = (int(np.searchsorted(time, since)) for since in (release_time, release_time - rise))
    further = {name: input_column(record, name) for name in input_column_names(record)}
    if any(_input_acts_before_release(time, name, values, early) for name, values in further.items()):
        return 0
    return min(
        [start, *(_sample_index_of_column_change(values, early, start) for values in further.values())]
    )


def _release_time_and_rise_time(time: np.ndarray, height: np.ndarray) -> tuple[float, float] | None:
    """Return the time at which a height begins to differ from its initial level, and its rise time."""
    level = float(np.median(height[:5]))
    for _ in range(2):  # the longer the hold is known to be, the better its level
        displacement = np.abs(height - level)
        first, last = (
            int(np.argmax(displacement >= x * displacement.max()))
            for x in (_LEVEL_RATIO * _LOWEST_LEVEL, _HIGHEST_LEVEL)
        )
        level = float(np.median(height[: max(5, first // 2)]))
    averaged_samples = 2 * (max(last - first, 0) // 8) + 1
    padded = np.pad(height, averaged_samples // 2, mode="edge")
    displacement = np.abs(
        np.convolve(padded, np.ones(averaged_samples) / averaged_samples, mode="valid") - level
    )
    largest = float(displacement.max())
    if not largest > 0.0:
        return None
    steps = np.abs(np.diff(height))
    rounding = float(steps[steps > 1e-9 * largest].min(initial=largest))
    noise = math.hypot(noise_standard_deviation(height, time), rounding / math.sqrt(12.0))
    averaged_noise = noise / math.sqrt(averaged_samples)
    low = max(_LOWEST_LEVEL, _LEVEL_SIGMAS * averaged_noise / largest, 1.6 * rounding / largest)
    if low > _MAXIMUM_LOWEST_LEVEL:
        return None
    levels = largest * np.array([low, _LEVEL_RATIO * low, max(_HIGHEST_LEVEL, 1.5 * _LEVEL_RATIO * low)])
    times = _level_passage_times(time, displacement, levels)
    if times is None:
        return None
    since = _onset_of_quadratic_growth(times[:2], levels[:2])
    rise = times[2] - since
    slack = _LATER_RELEASE + 2.0 * _LEVEL_SIGMAS * averaged_noise / (levels[1] - levels[0])
    if _onset_of_quadratic_growth(times[1:], levels[1:]) > since + slack * (times[1] - times[0]):
        return None
    if since < _MINIMUM_HOLD * rise or not _is_straight_within_noise(
        time[time < since], height[time < since], levels[2] / rise**2, noise
    ):
        return None
    return _fit_onset_of_motion(time, height, (since, times[0]), times[2]), float(rise)


def _level_passage_times(time: np.ndarray, displacement: np.ndarray, levels: np.ndarray) -> np.ndarray | None:
    """Return the times at which a monotonic displacement passes three levels."""
    first, last = (int(np.argmax(displacement >= x)) for x in levels[1:])
    still = np.flatnonzero(displacement[:first] < levels[0])
    if len(still) < 4:
        return None
    misfits = int(still[-1]) + 1
    if (
        displacement[:misfits].max() > 1.5 * levels[0]
        or displacement[misfits:last].min(initial=math.inf) < levels[0] / 2
    ):
        return None
    here = [slice(k - 1, k + 1) for k in (misfits, first, last)]
    return np.array([np.interp(x, displacement[k], time[k]) for x, k in zip(levels, here, strict=True)])


def _onset_of_quadratic_growth(times: np.ndarray, levels: np.ndarray) -> float:
    """Return the time of the vertex of a parabola, given the times at which it crosses two levels."""
    ratio = math.sqrt(levels[1] / levels[0])
    return float((ratio * times[0] - times[1]) / (ratio - 1.0))


def _is_straight_within_noise(time: np.ndarray, height: np.ndarray, curvature: float, noise: float) -> bool:
    """Return whether a height's curvature is within the noise or far below the curvature of the motion."""
    if len(time) < 4:
        return False
    x = (time - time.mean()) / (duration := float(np.ptp(time)))
    fitted = np.polyfit(x, height, 2)
    sigma = max(noise, float((height - np.polyval(fitted, x)).std()))
    # Standard errors for n evenly spaced samples: sigma sqrt(180/n)/T^2 of the quadratic coefficient, and
    # less than sigma sqrt(12/n)/T of a slope.
    error = 3.0 * sigma * math.sqrt(180.0 / len(time)) / duration**2
    if error <= _CURVATURE_ERROR * curvature:
        return bool(abs(fitted[0]) / duration**2 <= max(error, _STRAIGHT_CURVATURE * curvature))
    # In a short hold, noise hides the curvature near a turning point sooner than the slope.
    error = 3.0 * sigma * math.sqrt(12.0 / len(time)) / duration
    slope = abs(np.polyfit(x, height, 1)[0]) / duration
    return bool(slope <= error <= _CURVATURE_ERROR * curvature * duration)


def _fit_onset_of_motion(
    time: np.ndarray, height: np.ndarray, between: tuple[float, float], end: float
) -> float:
    """Return the release time, between limits, for which a constant followed by a cubic fits best."""
    low, high = between
    here = (time >= 2.0 * low - end) & (time <= end)
    release_times = np.linspace(low, high, 41)
    misfits = []
    for release_time in release_times:
        since = np.maximum(time[here] - release_time, 0.0) / (end - low)
        terms = since[:, None] ** np.arange(4)
        rest = height[here] - terms @ np.linalg.lstsq(terms, height[here], rcond=None)[0]
        misfits.append(rest @ rest)
    return float(release_times[np.argmin(misfits)])


def active_input_names(record: PistonRecord) -> list[str]:
    """Return the columns whose names denote drives and that act during a large part of the record."""
    names = []
    for name in input_column_names(record):
        values = input_column(record, name)
        away = np.abs(values - np.median(values))
        if not any(word in name.lower() for word in _DRIVE_WORDS) or not away.any():
            continue
        # The maximum of n samples of noise is near sqrt(2 ln n) standard deviations, and exceeds it by one
        # more in fewer than 1 of 100 records.
        largest = (1.0 + math.sqrt(2.0 * math.log(len(values)))) * noise_standard_deviation(
            values, record.time
        )
        acts = away > max(_CHANGED_FRACTION * float(away.max()), largest)
        # pulses act in few samples, but drive the motion from the first to the last of them
        between = np.flatnonzero(acts)
        lasts = len(between) > 0 and between[-1] - between[0] > _MINIMUM_DRIVE_FRACTION * len(values)
        if lasts and not _varies_much_faster_than_motion(record.time, values, record.height):
            names.append(name)
    return names


def _varies_much_faster_than_motion(time: np.ndarray, values: np.ndarray, height: np.ndarray) -> bool:
    """Return whether a column, apart from noise, has only components much faster than the motion."""
    count, duration = len(time), float(time[-1] - time[0])
    even = np.interp(np.linspace(time[0], time[-1], count), time, values / np.abs(values).max())
    window = np.hanning(count)
    power = np.abs(np.fft.rfft((even - even.mean()) * window)) ** 2
    frequency = spectral_peak_frequency(time, height - height.mean()) / math.tau
    slow = power[: math.ceil(_HUM_RATIO * frequency * duration)]
    white = (noise_standard_deviation(values, time) / np.abs(values).max()) ** 2 * float((window**2).sum())
    return bool(slow.sum() < _SLOW_POWER * power.sum() + 2.0 * white * len(slow))


def _input_acts_before_release(time: np.ndarray, name: str, values: np.ndarray, early: int) -> bool:
    """Return whether a column whose name denotes a drive acts well before the release."""
    extent = float(np.ptp(values))
    if early == 0 or extent == 0.0 or not any(word in name.lower() for word in _DRIVE_WORDS):
        return False
    return (
        float(np.ptp(values[:early]))
        > _DRIVE_FRACTION * extent
        > 5.0 * noise_standard_deviation(values, time)
    )


def _sample_index_of_column_change(values: np.ndarray, early: int, start: int) -> int:
    """Return the sample shortly before a release at which a column changes, or else ``start``."""
    if early < 4:
        return start
    away = np.abs(values[:start] - np.median(values[:early]))
    changed = away[early:] > max(1.5 * float(away[:early].max()), _CHANGED_FRACTION * float(np.ptp(values)))
    return early + int(np.argmax(changed)) if changed.any() else start
