"""The motion in a record: what the sensor lost, and what was done before and after, is no part."""

from __future__ import annotations

import warnings

import numpy as np

from granular.readers.options import ALL
from granular.run.record import PistonRecord
from granular.shared.errors import RecordError, RecordWarning
from reduced_models.records.free_motions import free_motions, knock_times
from reduced_models.records.release import cut_at_release, has_active_input
from reduced_models.records.sensor_limits import clipped_samples, cut_noise_tail, drop_lost_samples


def find_motion(record: PistonRecord, release: int | str | None = None) -> PistonRecord:
    """Return a free motion in a record, from its release on.

    Left out are samples that the sensor lost or clipped, further releases, what was done before
    the release, what follows a knock, and the end that is lost in the sensor's noise.

    Parameters
    ----------
    record : PistonRecord
        Record as an instrument wrote it.
    release : int or str, optional
        Which of several, from 1; the first if not given. Of all of them, `find_motions`.

    Returns
    -------
    PistonRecord
        Its motion; the record itself where all of it is one.

    Raises
    ------
    RecordError
        If there are fewer releases, or all are asked for.

    Warns
    -----
    RecordWarning
        If something is left out: what, where, and how to keep it.
    """
    if release == ALL:
        raise RecordError(
            "release = 'all' where one motion is taken; give its number, or take them together "
            "with fit, compare or discover"
        )
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


def find_motions(record: PistonRecord) -> list[PistonRecord]:
    """Return all free motions in a record; see `find_motion`.

    Parameters
    ----------
    record : PistonRecord
        Record as an instrument wrote it.

    Returns
    -------
    list of PistonRecord
        One for each release.

    Warns
    -----
    RecordWarning
        If something is left out.
    """
    return [_trim_motion(motion) for motion in _cut_free_motions(record)]


def _cut_free_motions(record: PistonRecord) -> list[PistonRecord]:
    """Free motions of a record, each with what stands still before it."""
    record = drop_lost_samples(record)
    # a hold that is clipped tells a release all the same
    clipped = clipped_samples(record)
    # what is driven may stand still between two moves without being released
    parts = free_motions(record, holds=not has_active_input(record))
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
    if has_active_input(record):
        return record
    if impacts := knock_times(record):
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
