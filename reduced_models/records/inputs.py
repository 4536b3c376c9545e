"""Known functions of time that drive a law: columns of a record, read between its samples.

Between samples an input follows a monotone piecewise cubic (Fritsch & Carlson 1980,
doi:10.1137/0717021), which does not overshoot where the input jumps.
"""

from __future__ import annotations

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import RecordError
from granular.shared.messages import quoted

STAGE_TIMES = (0.0, 1 / 3, 2 / 3, 1 / 3, 5 / 6, 1 / 6, 1.0)
"""Of the stages of a step of the grid's Runge-Kutta method, in steps."""


def column(record: PistonRecord, name: str) -> np.ndarray:
    """The column (n,) of a record that an input names.

    Raises
    ------
    RecordError
        If the record has no such column.
    """
    found = record.force if name == "force" else record.extra.get(name)
    if found is None:
        there = ", ".join(map(repr, column_names(record))) or "none"
        raise RecordError(
            f"the law has the input {quoted(name)}, and the record no column of that name; found: "
            f"{there}; add the column or name another one"
        )
    return found


def column_names(record: PistonRecord) -> tuple[str, ...]:
    """Names of the columns of a record that a law can have as inputs."""
    return (*(["force"] if record.force is not None else []), *record.extra)


def drive_on_grid(record: PistonRecord, names: tuple[str, ...], steps: int) -> np.ndarray:
    """Inputs (steps + 1, stages, inputs) of a record that starts at time 0, on a grid over it."""
    step = float(record.time[-1]) / steps
    times = step * (np.arange(steps + 1)[:, None] + np.array(STAGE_TIMES))
    return drive_at(record.time, [column(record, name) for name in names], times)


def drive_at(time: np.ndarray, columns: list[np.ndarray], times: np.ndarray) -> np.ndarray:
    """Columns that are known at ``time`` (n,), at other ``times`` (...): (..., columns)."""
    if not columns:
        return np.zeros((*times.shape, 0))
    from scipy.interpolate import PchipInterpolator

    inside = np.minimum(times, time[-1])
    return np.stack([PchipInterpolator(time, each)(inside) for each in columns], axis=-1)
