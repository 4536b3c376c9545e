"""Cells of tables: numbers, lost samples, and dates and times of day as seconds."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np

LOST = (
    "",
    "nan",
    "NaN",
    "NAN",
    "na",
    "NA",
    "n/a",
    "N/A",
    "#N/A",
    "null",
    "NULL",
    "None",
    "-",
    "--",
    "---",
    "?",
)
"""Spellings of a missing sample in programs' files."""

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?inf(inity)?", re.ASCII | re.I)
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?(Z|[+-]\d\d:?\d\d)?", re.ASCII)
_CLOCK = re.compile(
    r"(?:\d{1,4}[./-]\d{1,2}[./-]\d{1,4},?[ ])?"  # a day in any order, which tells no more than midnights
    r"(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:[.,]\d+)?)(?: ?([AP])M)?",
    re.ASCII | re.I,
)
_GROUPED = re.compile(r"[+-]?\d{1,3}(\.\d{3})+,\d+", re.ASCII)
"""A number with decimal comma and points between its thousands."""
_DAY = 86400.0


def is_timestamp(cell: str) -> bool:
    """Tell a date with a time (ISO 8601), or a time of day."""
    return ":" in cell and (_DATE.fullmatch(cell) or _CLOCK.fullmatch(cell)) is not None


def is_number(cell: str, decimal: str) -> bool:
    """Tell a number, a date or a time of day."""
    if decimal == ",":
        if "." in cell:
            return _GROUPED.fullmatch(cell) is not None or is_timestamp(cell)
        cell = cell.replace(",", ".", 1)
    return _NUMBER.fullmatch(cell) is not None or is_timestamp(cell)


def parse_number(cell: str, decimal: str) -> float:
    """Convert a cell that holds a number to its value."""
    return float(cell.replace(".", "").replace(",", ".") if decimal == "," else cell)


def parse_timestamps(cells: Sequence[str], lost: Collection[str]) -> tuple[np.ndarray, str] | None:
    """Convert dates or times of day to seconds since the first one [s]."""
    known = [cell for cell in cells if cell not in lost]
    if not known:
        return None
    if all(_DATE.fullmatch(cell) for cell in known):
        values, kind = _parse_dates(known), "date"
    elif all(_CLOCK.fullmatch(cell) for cell in known):
        values, kind = _parse_clock_times(known), "clock"
    else:
        return None
    seconds = np.full(len(cells), np.nan)
    seconds[[cell not in lost for cell in cells]] = values
    return seconds, kind


def _parse_dates(cells: Sequence[str]) -> np.ndarray | float:
    import pandas

    try:
        stamps = pandas.to_datetime([cell.replace(",", ".") for cell in cells], utc=True, format="ISO8601")
    except ValueError:  # a month 13
        return float("nan")
    nanoseconds = stamps.tz_convert(None).to_numpy().astype("datetime64[ns]").astype(np.int64)
    return np.asarray((nanoseconds - nanoseconds[0]) * 1e-9)


def _parse_clock_times(cells: Sequence[str]) -> np.ndarray:
    values = []
    for cell in cells:
        match = _CLOCK.fullmatch(cell)
        assert match is not None
        hours, minutes, seconds, half = match.groups()
        hour = float(hours or 0.0)
        if half:  # 12 AM is midnight
            hour = hour % 12.0 + (12.0 if half in "Pp" else 0.0)
        values.append(3600.0 * hour + 60.0 * float(minutes) + float(seconds.replace(",", ".")))
    times = np.array(values)
    # A time of day that falls back by more than half a day has passed midnight.
    midnights = np.cumsum(np.diff(times, prepend=times[0]) < -0.5 * _DAY)
    return np.asarray(times + _DAY * midnights - times[0])
