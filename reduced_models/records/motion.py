"""The motion in a record: what a sensor cut off, and further releases, are no part of it."""

from __future__ import annotations

import warnings

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import RecordWarning
from reduced_models.records.first_guesses import LEAST_SAMPLES
from reduced_models.records.release import cut_at_release

_LEAST_CLIPPED = 6
"""Samples at a sensor's limit from which on a record is clipped."""
_RUN = 3
"""Of these in a row: two may be the same by chance of rounding."""
_END = 5
"""Part of a record, at its end, whose middle is the level of rest: a fifth."""
_LARGE, _SMALL = 0.4, 0.16
"""Displacements over the largest one that count as large and as small."""
_BEFORE = (2.5, 0.6)
"""Start and end, in half periods before a release, of the time in which nothing moves much."""
_PAUSE, _CALM, _LEAST_GAPS = 6.0, 0.4, 3
"""Time without a large displacement before another release, in those between two peaks; fraction of
it with small ones; and number of such times from which on they can be told apart."""


def find_motion(record: PistonRecord) -> PistonRecord:
    """Return the first free motion in a record, without clipped samples and from its release on.

    Parameters
    ----------
    record : PistonRecord
        Record as an instrument wrote it.

    Returns
    -------
    PistonRecord
        Its motion; the record itself where all of it is one.

    Warns
    -----
    RecordWarning
        If something is left out: what, where, and how to keep it.
    """
    record = _without_clipped(record)
    starts = _release_samples(record)
    if len(starts) > 1 and starts[1] >= LEAST_SAMPLES:
        times = ", ".join(f"{record.time[k]:.4g}" for k in starts)
        end = float(record.time[starts[1] - 1])
        warnings.warn(
            f"the record holds {len(starts)} releases, at {times} s, and the first is taken; for "
            f"another: --between {record.time[starts[1]]:.4g}:",
            RecordWarning,
            stacklevel=2,
        )
        record = record.between(float(record.time[0]), end)
    return cut_at_release(record)


def _without_clipped(record: PistonRecord) -> PistonRecord:
    """Leave out the samples at the limits of a sensor, where runs of them stand at a peak."""
    height = record.height
    at_limit = np.zeros(len(height), dtype=bool)
    several = False
    for limit in (height.min(), height.max()):
        here = height == limit
        edges = np.flatnonzero(np.diff(np.concatenate([[False], here, [False]]).astype(int)))
        lengths = edges[1::2] - edges[::2]
        long = lengths >= _RUN
        # A hold is one long run; peaks that are cut off are several.
        several |= bool(long.sum() >= 2 and lengths[long].sum() >= _LEAST_CLIPPED)
        if long.any():
            at_limit |= here
    at_limit &= several
    if not at_limit.any() or (~at_limit).sum() < LEAST_SAMPLES:
        return record
    warnings.warn(
        f"{int(at_limit.sum())} samples stand at the limit of the sensor (clipped) and are left "
        "out; to keep them: --between :",
        RecordWarning,
        stacklevel=3,
    )
    return record.select(~at_limit)


def _release_samples(record: PistonRecord) -> list[int]:
    """Return the samples at which a motion is started anew, the first one included.

    While it swings, the displacement is large again after each half period; before another release
    it is small for several.
    """
    if len(record) < LEAST_SAMPLES:
        return [0]
    # A hold may be longer than the motion: the level of rest is that of the record's end.
    level = np.median(record.height[-(len(record) // _END) :])
    away = np.abs(record.height - level)
    large = np.flatnonzero(away > _LARGE * away.max())
    small = away < _SMALL * away.max()
    before, after = large[:-1], large[1:]
    calm = np.concatenate([[0], np.cumsum(small)])
    passes = (after > before + 1) & (calm[after] > calm[before])
    gaps = (record.time[after] - record.time[before])[passes]
    if len(gaps) < _LEAST_GAPS:
        return [0]
    half_period = float(np.median(np.sort(gaps)[: (len(gaps) + 1) // 2]))
    mostly = (calm[after] - calm[before]) > _CALM * (after - before)
    anew = passes & mostly & (record.time[after] - record.time[before] > _PAUSE * half_period)
    return [
        0,
        *(int(k) for k in after[anew] if _starts_suddenly(record.time, away, k, half_period)),
    ]


def _starts_suddenly(time: np.ndarray, away: np.ndarray, start: int, half_period: float) -> bool:
    """Return True where it was calm for a period before; beats grow from swing to swing."""
    period = slice(*np.searchsorted(time, time[start] - half_period * np.array(_BEFORE)))
    return bool(away[period].max(initial=0.0) < 1.5 * _SMALL * away.max())
