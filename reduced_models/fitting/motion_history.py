"""Hidden states at the start of a record, from the motion before it.

What a hysteretic or a visco-elastic part has been through is seen in the record before the stretch
that is fitted: its hidden states are carried along that motion as it was measured, from zero at its
beginning, which they forget on the way. Where they end depends on the parameters, so that fit and
hidden states take turns until neither changes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeGuard

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.message_text import quote
from reduced_models.fitting.fit_data import FitData
from reduced_models.fitting.options import Initial
from reduced_models.fitting.refinement import SearchResult
from reduced_models.fitting.start_values import acceleration_function
from reduced_models.laws.law import Law
from reduced_models.records.derivatives import fit_local_cubics
from reduced_models.records.inputs import TIME, column_names, input_column, interpolate_inputs

_NODES_A_SWING = 128
_GAP = 1.5  # samples between a history and its record
_ROUNDS = 20
_SAME = 1e-7  # change of a search vector that is none


def is_motion_history(initial: Initial | None) -> TypeGuard[PistonRecord | Sequence[PistonRecord]]:
    """Tell a motion before the record from other starts."""
    if isinstance(initial, Sequence) and not isinstance(initial, str) and initial:
        return all(isinstance(entry, PistonRecord) for entry in initial)
    return isinstance(initial, PistonRecord)


def prepend_histories(
    law: Law, histories: PistonRecord | Sequence[PistonRecord], records: Sequence[PistonRecord]
) -> list[PistonRecord]:
    """Each record with its history before it, from time 0 at the record's own start."""
    given = [histories] if isinstance(histories, PistonRecord) else list(histories)
    if not law.hidden:
        raise InputError(
            f"the law {quote(law.name)} has no hidden state, so what was before its record does "
            "not matter; leave initial out"
        )
    if len(given) != len(records):
        raise InputError(f"initial: {len(given)} motions for {len(records)} records; give one before each")
    return [_prepend_history(history, record) for history, record in zip(given, records, strict=True)]


def _prepend_history(history: PistonRecord, record: PistonRecord) -> PistonRecord:
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
            "initial: the motion before and the record have different columns; cut both from one record"
        )
    parts = {
        name: np.concatenate([history.columns[name][before], values])
        for name, values in record.columns.items()
        if name in history.columns
    }
    return PistonRecord.from_columns(parts | {"time": parts["time"] - begin})


def fit_with_histories(result: SearchResult, histories: Sequence[PistonRecord]) -> SearchResult:
    """Fit with hidden states held where the records' histories end."""
    problem, theta = result.problem, result.trained
    first = len(problem.law.parameters) + 2
    for _ in range(_ROUNDS):
        former, theta = theta, theta.copy()
        moved = []
        for data, history in zip(problem.data, histories, strict=True):
            states = _states_at_history_end(data, theta[data.entries], history)
            theta[data.entries[first : first + len(states)]] = states
            hidden = dict(zip(problem.law.hidden, map(float, states), strict=True))
            moved.append(dataclasses.replace(data, initial={**data.initial, **hidden}))
        problem = problem.with_data(moved)
        theta = problem.refit(theta, problem.training, tolerance=1e-10)
        if np.abs(theta - former).max() <= _SAME * max(1.0, np.abs(theta).max()):
            break
    return result.with_training_fit(problem, theta)


def _states_at_history_end(data: FitData, theta: np.ndarray, history: PistonRecord) -> np.ndarray:
    """Hidden states (h,) where a history ends, which is at time 0."""
    law, period = data.unknowns.law, data.guess.period
    values = data.unknowns.physical_values(theta)[0]
    start = float(history.time[0])
    nodes = np.linspace(start, 0.0, max(_NODES_A_SWING, round(-_NODES_A_SWING * start / period)))
    motion = fit_local_cubics(history.time, history.height, period, nodes)
    motion = motion[:, motion[3] <= 0.0]
    columns = [history.time if name == TIME else input_column(history, name) for name in law.inputs]
    drive = interpolate_inputs(history.time, columns, motion[3])
    return np.asarray(acceleration_function(law, motion, drive)(np.array(values)[:, None])[1][-1, :, 0])
