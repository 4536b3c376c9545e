"""The release in a record: what stands still before it moves is no part of the motion.

A recorder that a trigger or a hand starts writes down the hold first. The hold obeys another law
than the motion: a swing that is fitted through it comes out too slow and too much damped.

A hold differs from a slow start by its end. From a hold the displacement grows immediately, with
the square of the time since the release or faster: carried back from two of its levels, this square
starts at the release, and from two higher ones not later. A motion that grows by and by, as that
from an unstable rest or at a resonance, has no such moment; one that starts at a turning point has
it at the record's own start; and one that starts shortly before a turning point is curved where a
hold is straight.
"""

from __future__ import annotations

import math
import warnings

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import RecordWarning
from reduced_models.records.derivatives import noise_level, spectral_peak_frequency
from reduced_models.records.first_guesses import LEAST_SAMPLES
from reduced_models.records.inputs import column_names, input_column

# Levels of the growth, over the largest displacement (a full stroke): lowest, ratio, highest. A cosine
# reaches 0.05 and 0.2 of it within 4 % of the time of a square. With 0.1, or 0.8, holds of a tenth of a
# period are missed, and a logistic growth is taken for a release.
_LOWEST, _RATIO, _HIGHEST = 0.05, 4.0, 0.6
# The lowest level that noise may ask for: four standard deviations. The highest is six times it, 0.84; from
# 0.167 on it would be beyond the largest displacement.
_NOISIEST = 0.14
# Shortest hold over the rise to the highest level. On made records 0.5 misses holds of a tenth of a period,
# 0.2 does the same as 0.3, and 0.1 finds holds of a twentieth too.
_SHORTEST = 0.3
# Fraction of the time between the first two levels by which the higher ones may put the release later. By 0.5
# logistic growth and the way down from a hump are taken for releases, by 0.1 nothing changes.
_LATER = 0.25
# Curvature of a hold over that of the motion: at most, and what noise may make of it (0.2: holds of a tenth
# of a period under 2 % of noise are missed).
_STRAIGHT, _SEEN = 0.1, 0.6
_SIGMAS = 4.0
_CHANGED, _ACTS = 0.1, 0.25
"""Shares of a further column's range: a change at the release, and one that drives a motion."""
_LASTS = 0.1
"""Part of a record in which a column that drives it is away from its middle."""
_HUM, _SLOW = 5.0, 0.01
"""Times the motion's frequency, and fraction of a column's power below that, with less of which it hums. A
drive at 2 (parametric) or 3 times (superharmonic) the motion's frequency still is one."""
_DRIVES = ("force", "base", "drive", "input")
"""Words in names of columns that may drive a motion; others, as a temperature, may drift in a hold."""


def cut_at_release(record: PistonRecord) -> PistonRecord:
    """Cut a record at its release, where it stands still before it moves.

    A hold is told by its end, as `reduced_models.records.release` says: the displacement then grows
    with the square of the time since the release, or faster. Nothing is cut where a column that is
    named as a force, base, drive or input acts in the hold, nor in much noise.

    Parameters
    ----------
    record : PistonRecord
        Record that may begin with a hold.

    Returns
    -------
    PistonRecord
        Record from the release on, at its own times [s], with all its columns; the same object where it
        does not stand still first or has fewer than 20 samples.

    Warns
    -----
    RecordWarning
        If the record is cut: until when it stands still.

    Examples
    --------
    >>> import numpy as np
    >>> from reduced_models import PistonRecord, cut_at_release
    >>> time = np.linspace(0.0, 2.0, 2000)
    >>> record = PistonRecord(time, 0.06 + 1e-3 * np.exp(-0.8 * time) * np.cos(21.8 * time))
    >>> cut_at_release(record) is record  # it swings from its start on
    True
    """
    start = release_sample(record)
    if start == 0:
        return record
    until = round(float(record.time[start]), 9)
    warnings.warn(
        f"the record stands still until {until:.4g} s and is cut there, at the release; to keep "
        "all of it: --between :",
        RecordWarning,
        stacklevel=2,
    )
    return record.between(float(record.time[start]), math.inf)


def release_sample(record: PistonRecord) -> int:
    """Index of the sample at which a resting record starts to move; 0 where it never rests."""
    # Carried back from two of its levels, the square of the growth starts at the release (see the module).
    if len(record) < LEAST_SAMPLES:
        return 0
    time = record.time - record.time[0]
    result = _find_release(time, record.height)
    if result is None:
        return 0
    moment, rise = result
    start, early = (int(np.searchsorted(time, since)) for since in (moment, moment - rise))
    further = {name: input_column(record, name) for name in column_names(record)}
    if any(_input_acts_before_release(time, name, values, early) for name, values in further.items()):
        return 0
    return min([start, *(_sample_of_column_change(values, early, start) for values in further.values())])


def _find_release(time: np.ndarray, height: np.ndarray) -> tuple[float, float] | None:
    """Moment at which a height leaves the level of its start, and how long it then rises."""
    level = float(np.median(height[:5]))
    for _ in range(2):  # the longer the hold is known to be, the better its level
        displacement = np.abs(height - level)
        first, last = (
            int(np.argmax(displacement >= x * displacement.max())) for x in (_RATIO * _LOWEST, _HIGHEST)
        )
        level = float(np.median(height[: max(5, first // 2)]))
    together = 2 * (max(last - first, 0) // 8) + 1
    padded = np.pad(height, together // 2, mode="edge")
    displacement = np.abs(np.convolve(padded, np.ones(together) / together, mode="valid") - level)
    largest = float(displacement.max())
    if not largest > 0.0:
        return None
    steps = np.abs(np.diff(height))
    rounding = float(steps[steps > 1e-9 * largest].min(initial=largest))
    noise = math.hypot(noise_level(height, time), rounding / math.sqrt(12.0))
    left_noise = noise / math.sqrt(together)
    low = max(_LOWEST, _SIGMAS * left_noise / largest, 1.6 * rounding / largest)
    if low > _NOISIEST:
        return None
    levels = largest * np.array([low, _RATIO * low, max(_HIGHEST, 1.5 * _RATIO * low)])
    times = _level_passage_times(time, displacement, levels)
    if times is None:
        return None
    since = _onset_of_quadratic_growth(times[:2], levels[:2])
    rise = times[2] - since
    slack = _LATER + 2.0 * _SIGMAS * left_noise / (levels[1] - levels[0])
    if _onset_of_quadratic_growth(times[1:], levels[1:]) > since + slack * (times[1] - times[0]):
        return None
    if since < _SHORTEST * rise or not _is_straight_within_noise(
        time[time < since], height[time < since], levels[2] / rise**2, noise
    ):
        return None
    return _onset_of_motion(time, height, (since, times[0]), times[2]), float(rise)


def _level_passage_times(time: np.ndarray, displacement: np.ndarray, levels: np.ndarray) -> np.ndarray | None:
    """Return the times at which a monotonic displacement passes three levels."""
    first, last = (int(np.argmax(displacement >= x)) for x in levels[1:])
    still = np.flatnonzero(displacement[:first] < levels[0])
    if len(still) < 4:
        return None
    left = int(still[-1]) + 1
    if (
        displacement[:left].max() > 1.5 * levels[0]
        or displacement[left:last].min(initial=math.inf) < levels[0] / 2
    ):
        return None
    here = [slice(k - 1, k + 1) for k in (left, first, last)]
    return np.array([np.interp(x, displacement[k], time[k]) for x, k in zip(levels, here, strict=True)])


def _onset_of_quadratic_growth(times: np.ndarray, levels: np.ndarray) -> float:
    """Time at which a square that passes two levels starts."""
    ratio = math.sqrt(levels[1] / levels[0])
    return float((ratio * times[0] - times[1]) / (ratio - 1.0))


def _is_straight_within_noise(time: np.ndarray, height: np.ndarray, curvature: float, noise: float) -> bool:
    """Return whether a height is straight within noise, where the motion has that curvature."""
    if len(time) < 4:
        return False
    x = (time - time.mean()) / (duration := float(np.ptp(time)))
    fitted = np.polyfit(x, height, 2)
    sigma = max(noise, float((height - np.polyval(fitted, x)).std()))
    # Standard errors over n even samples: sigma sqrt(180/n)/T^2 of a curvature's coefficient, and below sigma
    # sqrt(12/n)/T of a slope.
    error = 3.0 * sigma * math.sqrt(180.0 / len(time)) / duration**2
    if error <= _SEEN * curvature:
        return bool(abs(fitted[0]) / duration**2 <= max(error, _STRAIGHT * curvature))
    # In a short hold noise hides a turning point's curvature sooner than its slope.
    error = 3.0 * sigma * math.sqrt(12.0 / len(time)) / duration
    slope = abs(np.polyfit(x, height, 1)[0]) / duration
    return bool(slope <= error <= _SEEN * curvature * duration)


def _onset_of_motion(time: np.ndarray, height: np.ndarray, between: tuple[float, float], end: float) -> float:
    """Moment between two from which on a level best goes over into a cubic motion."""
    low, high = between
    here = (time >= 2.0 * low - end) & (time <= end)
    moments = np.linspace(low, high, 41)
    left = []
    for moment in moments:
        since = np.maximum(time[here] - moment, 0.0) / (end - low)
        terms = since[:, None] ** np.arange(4)
        rest = height[here] - terms @ np.linalg.lstsq(terms, height[here], rcond=None)[0]
        left.append(rest @ rest)
    return float(moments[np.argmin(left)])


def active_inputs(record: PistonRecord) -> list[str]:
    """Names of the columns that drive the motion, by their names, in more than a short part of a record."""
    names = []
    for name in column_names(record):
        values = input_column(record, name)
        away = np.abs(values - np.median(values))
        if not any(word in name.lower() for word in _DRIVES) or not away.any():
            continue
        # The largest of n samples of noise is near sqrt(2 ln n) standard deviations, and beyond one more in
        # fewer than 1 of 100 records.
        largest = (1.0 + math.sqrt(2.0 * math.log(len(values)))) * noise_level(values, record.time)
        acts = away > max(_CHANGED * float(away.max()), largest)
        # pulses act in few samples, and drive from the first of them to the last
        between = np.flatnonzero(acts)
        lasts = len(between) > 0 and between[-1] - between[0] > _LASTS * len(values)
        if lasts and not _is_hum(record.time, values, record.height):
            names.append(name)
    return names


def _is_hum(time: np.ndarray, values: np.ndarray, height: np.ndarray) -> bool:
    """Return whether a column holds, but for noise, only what is much faster than the motion."""
    count, duration = len(time), float(time[-1] - time[0])
    even = np.interp(np.linspace(time[0], time[-1], count), time, values / np.abs(values).max())
    window = np.hanning(count)
    power = np.abs(np.fft.rfft((even - even.mean()) * window)) ** 2
    frequency = spectral_peak_frequency(time, height - height.mean()) / math.tau
    slow = power[: math.ceil(_HUM * frequency * duration)]
    white = (noise_level(values, time) / np.abs(values).max()) ** 2 * float((window**2).sum())
    return bool(slow.sum() < _SLOW * power.sum() + 2.0 * white * len(slow))


def _input_acts_before_release(time: np.ndarray, name: str, values: np.ndarray, early: int) -> bool:
    """Return whether a column is a drive, by its name, and acts well before the release."""
    extent = float(np.ptp(values))
    if early == 0 or extent == 0.0 or not any(word in name.lower() for word in _DRIVES):
        return False
    return float(np.ptp(values[:early])) > _ACTS * extent > 5.0 * noise_level(values, time)


def _sample_of_column_change(values: np.ndarray, early: int, start: int) -> int:
    """Sample shortly before a release at which a column changes: what set the motion off."""
    if early < 4:
        return start
    away = np.abs(values[:start] - np.median(values[:early]))
    changed = away[early:] > max(1.5 * float(away[:early].max()), _CHANGED * float(np.ptp(values)))
    return early + int(np.argmax(changed)) if changed.any() else start
