"""A time and one other column of a file: what shakes a host, for instance."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from granular.readers.meaning import checked, spread
from granular.readers.names import ACCELERATION, FORCE, TIME, plain_unit, role_of
from granular.readers.opening import open_sheet
from granular.readers.reading import Reading
from granular.readers.roles import is_of, time_of
from granular.readers.sheet import Column, Sheet
from granular.schema.units import unit_size
from granular.shared.errors import RecordError, RecordWarning, SceneError
from granular.shared.messages import quoted, visible

_ROLES = {"N": FORCE, "m/s^2": ACCELERATION}
"""What a column is called whose numbers have a unit."""
_MOST_SHOWN = 20


def read_series(path: Path, unit: str) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and numbers of a file, read as a laboratory record is.

    Parameters
    ----------
    path : Path
    unit : str
        That the numbers are converted to, where the file says another one of its kind.

    Returns
    -------
    times, numbers : float64 (n,)

    Raises
    ------
    RecordError
        If it cannot be read as such; the message names the file, and the line.
    """
    sheet = open_sheet(path, Reading())
    try:
        time = time_of(sheet)
        other = _other(sheet, time, unit)
        name = visible(other.name) or f"column {sheet.columns.index(other) + 1}"
        times = checked(sheet, TIME, time) * _size(TIME, time, "s")
        values = checked(sheet, name, other) * _size(name, other, unit)
    except RecordError as error:
        raise RecordError(f"{visible(path)}: {error}") from None
    here, notes = np.isfinite(times) & np.isfinite(values), list(sheet.notes)
    if not here.all():
        first = sheet.place(int(np.argmin(here)))
        notes.append(f"{(~here).sum()} of {len(here)} samples are lost and left out: {first} first")
    times = spread(times[here], notes)
    if notes:
        warnings.warn(f"{visible(path)}: {'; '.join(notes)}", RecordWarning, stacklevel=2)
    return times, values[here]


def _other(sheet: Sheet, time: Column, unit: str) -> Column:
    """The only column beside the time, of that unit, or of that name; without names the next."""
    others = [one for one in sheet.columns if one is not time]
    choices: Sequence[list[Column]] = (
        others,
        [one for one in others if one.unit is not None and is_of(one.unit, unit)],
        [one for one in others if role_of(one.name) == _ROLES.get(unit, "")],
        [] if any(one.name for one in others) else others[:1],
    )
    found = next((some for some in choices if len(some) == 1), None)
    if found is None:
        names = ", ".join(quoted(one.name) for one in others[:_MOST_SHOWN])
        raise RecordError(
            f"holds {len(others)} columns beside the time ({names}); leave one, or write its unit "
            f"behind its name, such as 'value [{unit}]'"
        )
    return found[0]


def _size(name: str, column: Column, wanted: str) -> float:
    """What the numbers of a column are multiplied by; those without a unit stay as they are."""
    if column.unit is None or column.clock:
        return 1.0
    try:
        size, dimension = unit_size(plain_unit(column.unit))
    except SceneError as error:
        raise RecordError(f"{name}: {error}") from None
    if dimension not in (unit_size(wanted)[1], unit_size("1")[1]):
        raise RecordError(
            f"{name}: the unit {quoted(column.unit)} does not fit; one of {wanted} is wanted: "
            "correct it, or convert the numbers"
        )
    return size
