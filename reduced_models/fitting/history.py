"""Hidden states at the start of a record, from the motion before it.

What a hysteretic or a visco-elastic part has been through is seen in the record before the stretch
that is fitted: its hidden states are carried along that motion as it was measured, from zero at its
beginning, which they forget on the way. Where they end depends on the parameters, so that fit and
hidden states take turns until neither changes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from reduced_models.fitting.case import Data
from reduced_models.fitting.hidden_starts import along
from reduced_models.fitting.refinement import JointRecords
from reduced_models.fitting.smoothing import smoothed
from reduced_models.laws.law import Law
from reduced_models.least_squares.levenberg_marquardt import Bounds
from reduced_models.records.inputs import TIME, column, column_names, drive_at

_NODES_A_SWING = 128
_GAP = 1.5  # samples between a history and its record
_ROUNDS = 20
_SAME = 1e-7  # change of a search vector that is none


def checked_histories(
    law: Law, histories: PistonRecord | Sequence[PistonRecord], records: Sequence[PistonRecord]
) -> list[PistonRecord]:
    """Each record with its history before it, from time 0 at the record's own start.

    Raises
    ------
    InputError
        If the law has no hidden state, or a history does not end where its record begins.
    """
    given = [histories] if isinstance(histories, PistonRecord) else list(histories)
    if not law.hidden:
        raise InputError(
            f"the law {quoted(law.name)} has no hidden state, so what was before its record does "
            "not matter; leave initial out"
        )
    if len(given) != len(records):
        raise InputError(
            f"initial: {len(given)} motions for {len(records)} records; give one before each"
        )
    return [_joined(one, record) for one, record in zip(given, records, strict=True)]


def _joined(history: PistonRecord, record: PistonRecord) -> PistonRecord:
    begin, end = float(record.time[0]), float(history.time[-1])
    step = float(record.time[-1] - begin) / (len(record) - 1)
    before = history.time < begin
    if not -0.5 * step <= begin - end <= _GAP * step or before.sum() < 2:
        raise InputError(
            f"initial: the motion before ends at {end:.6g} s, and the record begins at {begin:.6g} "
            "s; cut both from one record, as record.between(0, 5) and record.between(5, 20)"
        )
    if column_names(history) != column_names(record):
        raise InputError(
            "initial: the motion before and the record have different columns; cut both from one "
            "record"
        )
    parts = {
        name: np.concatenate([history.columns[name][before], values])
        for name, values in record.columns.items()
        if name in history.columns
    }
    return PistonRecord.from_columns(parts | {"time": parts["time"] - begin})


def with_histories(
    joint: JointRecords,
    theta: np.ndarray,
    data: Sequence[Data],
    histories: Sequence[PistonRecord],
) -> tuple[JointRecords, np.ndarray]:
    """The records with hidden states held where their histories end, and the fit to them."""
    counts = [len(one.training) for one in data]
    unknowns = joint.unknowns
    hidden = slice(unknowns.free + 2, None)
    for _ in range(_ROUNDS):
        former, theta = theta, theta.copy()
        low, high = joint.bounds.low.copy(), joint.bounds.high.copy()
        for one, history, here in zip(data, histories, joint.vector.places, strict=True):
            found = _at_the_end(joint, theta[here], history, one.guess.period)
            place = here[hidden]
            theta[place] = low[place] = high[place] = found
        joint = dataclasses.replace(joint, bounds=Bounds(low, high))
        theta = joint.sharpened(theta, counts, tolerance=1e-10)
        if np.abs(theta - former).max() <= _SAME * max(1.0, np.abs(theta).max()):
            break
    return joint, theta


def _at_the_end(
    joint: JointRecords, theta: np.ndarray, history: PistonRecord, period: float
) -> np.ndarray:
    """Hidden states (h,) where a history ends, which is at time 0."""
    unknowns = joint.unknowns
    law = unknowns.law
    values, shift, scale, *_ = unknowns.physical(theta)
    start = float(history.time[0])
    nodes = np.linspace(start, 0.0, max(_NODES_A_SWING, round(-_NODES_A_SWING * start / period)))
    motion = smoothed(history.mapped(shift, scale), period, nodes)
    kept = motion.time <= 0.0
    motion = motion._replace(
        height=motion.height[kept], velocity=motion.velocity[kept],
        acceleration=motion.acceleration[kept], time=motion.time[kept],
    )  # fmt: skip
    columns = [history.time if name == TIME else column(history, name) for name in law.inputs]
    drive = drive_at(history.time, columns, motion.time)
    return np.asarray(along(law, motion, drive)(np.array(values)[:, None]).hidden[:, 0])
