"""Waveforms of Rigol oscilloscopes that say a start and an increment instead of times."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from granular.readers.delimited import read_delimited
from granular.readers.names import TIME
from granular.readers.sheet import Column, Sheet
from granular.shared.errors import RecordError
from granular.shared.messages import quoted, visible

_HEAD = re.compile(r"X(,[^,\r\n]+)+,Start,Increment,?\s*[\r\n]+Sequence,")


def is_rigol(text: str) -> bool:
    """Whether a text is such a waveform."""
    return _HEAD.match(text) is not None


def read_rigol(path: Path, text: str) -> Sheet:
    """The channels of a waveform; sample n is at ``Start`` + n ``Increment``.

    The layout is that of files of the DS1000Z, DS2000 and DS4000.

    Raises
    ------
    RecordError
        If start or increment is no number, or there are no samples.
    """
    names, said = (line.rstrip(",").split(",") for line in text.splitlines()[:2])
    channels = names[1:-2]
    if len(said) != len(names):
        raise RecordError(
            f"{visible(path)}: line 2 has {len(said)} entries, line 1 {len(names)}; save it anew"
        )
    first, step = _number(path, said[-2]), _number(path, said[-1])
    sheet = read_delimited(path, text, ".", 2)
    if len(sheet.columns) != len(channels) + 1:
        raise RecordError(
            f"{visible(path)}: line 3 has {len(sheet.columns)} values for {len(channels) + 1} "
            "columns; save it anew"
        )
    sequence, *values = (column.values for column in sheet.columns)
    if sequence is None:
        raise RecordError(f"{visible(path)}: the numbers of samples are none; save it anew")
    sheet.columns = [
        Column(TIME, "s", np.asarray(first + step * sequence)),
        *map(Column, channels, said[1:-2], values),
    ]
    sheet.header, sheet.form = True, "waveform of a Rigol oscilloscope"
    return sheet


def _number(path: Path, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RecordError(
            f"{visible(path)}: line 2 ends with {quoted(text)}, where start and increment in "
            "seconds are wanted; save it anew"
        )
    return value
