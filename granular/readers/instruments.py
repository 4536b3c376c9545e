"""Measurements of instruments: LabVIEW's text (.lvm) and TDMS, waveforms of Rigol oscilloscopes."""

from __future__ import annotations

import io
import math
import re

import numpy as np

from granular.readers.column_headers import TIME
from granular.readers.delimited import read_delimited
from granular.readers.read_options import ReadOptions
from granular.readers.sheet import Column, Sheet, report_parsing_errors
from granular.shared.errors import RecordError
from granular.shared.message_text import quote

_END = "***End_of_Header***"


def is_labview(text: str) -> bool:
    """Tell the text of a LabVIEW measurement file (.lvm) by its first words."""
    return text.lstrip().startswith("LabVIEW Measurement")


def read_labview(text: str, options: ReadOptions) -> Sheet:
    """Read the first segment of a LabVIEW measurement file (.lvm) [s]."""
    lines = re.split(r"\r\n|\r|\n", text)
    ends = [k for k, line in enumerate(lines) if line.strip().startswith(_END)]
    if not ends:
        raise RecordError(f"has no line {_END}; write the measurement anew")
    mark = "," if any(line.startswith("Separator,") for line in lines[: ends[0]]) else "\t"
    file_head = _header_entries(lines[: ends[0]], mark)
    decimal = options.decimal or file_head.get("Decimal_Separator", ["."])[0]
    head = _header_entries(lines[ends[0] + 1 : ends[1]], mark) if len(ends) > 1 else {}
    begin = ends[1] + 1 if len(ends) > 1 else ends[0] + 1
    later = next((k for k in range(begin + 1, len(lines)) if lines[k].startswith("Channels")), None)
    notes = []
    if later is not None:
        notes.append(f"segments from line {later + 1} on are left out")
    body = "\n".join([*[""] * begin, *lines[begin:later]])
    sheet = read_delimited(_select_sample_lines(body, file_head), decimal, 0)
    sheet.form, sheet.notes = "LabVIEW measurement", [*sheet.notes, *notes]
    channels = [column for column in sheet.columns if column.name.lower() not in ("x_value", "comment")]
    for column, unit in zip(channels, head.get("Y_Unit_Label", []), strict=False):
        column.unit = column.unit or unit or None
    _name_time_columns(sheet)
    if file_head.get("X_Columns", [""])[0] == "No":
        # National Instruments, Specification for the LabVIEW Measurement File (.lvm), 2020.
        step = _header_number(head, "Delta_X", decimal)
        first = _header_number(head, "X0", decimal)
        count = 0 if sheet.lines is None else len(sheet.lines)
        sheet.columns = [column for column in sheet.columns if column.name != TIME]
        sheet.columns.insert(0, Column(TIME, "s", first + step * np.arange(count)))
    return sheet


def _name_time_columns(sheet: Sheet) -> None:
    """Name ``X_Value`` as the time; each channel may have one if all agree."""
    times = [column for column in sheet.columns if column.name.lower() == "x_value"]
    for column in times:
        column.name, column.unit = TIME, "s"
    for column in times[1:]:
        if not _times_agree(times[0], column):
            number = sheet.columns.index(column) + 1
            raise RecordError(
                f"column {number} holds other times than the first; export the "
                "channels with one column of times, or each in a file of its own"
            )
        sheet.columns.remove(column)


def _times_agree(first: Column, second: Column) -> bool:
    if first.values is None or second.values is None:
        return False
    return np.array_equal(first.values, second.values, equal_nan=True)


def _select_sample_lines(body: str, head: dict[str, list[str]]) -> str:
    """Return lines that begin with a number; without times they begin with the separator."""
    if head.get("X_Columns", [""])[0] != "No":
        return body
    return re.sub(r"(?m)^(?=[\t,])", "0", body)


def _header_entries(lines: list[str], mark: str) -> dict[str, list[str]]:
    entries = {}
    for line in lines:
        name, *values = line.strip().split(mark)
        entries[name] = [value.strip() for value in values] or [""]
    return entries


def _header_number(head: dict[str, list[str]], name: str, decimal: str) -> float:
    text = head.get(name, [""])[0].replace(decimal, ".")
    try:
        return float(text)
    except ValueError:
        raise RecordError(
            f"{name} is {quote(text)}, not a number, and there is no column of times; export with times"
        ) from None


def read_tdms(content: bytes, options: ReadOptions) -> Sheet:
    """Read a group of a TDMS file of LabVIEW: the first with samples, or that which ``sheet`` names."""
    with report_parsing_errors("a TDMS file", "npTDMS", "labview"):
        from nptdms import TdmsFile

        file = TdmsFile.read(io.BytesIO(content))
        groups = {group.name: group.channels() for group in file.groups()}
    candidates = options.select_table(groups, "group")
    name, channels = next(
        ((name, some) for name, some in candidates.items() if some and len(some[0])), ("", [])
    )
    if not channels:
        raise RecordError("holds no channel with samples; export it anew")
    columns = [
        Column(
            channel.name,
            channel.properties.get("unit_string") or None,
            np.asarray(channel[:], dtype=np.float64),
        )
        for channel in channels
        if len(channel) == len(channels[0]) and np.asarray(channel[:]).dtype.kind in "iuf"
    ]
    step = channels[0].properties.get("wf_increment")
    if step and not any(column.name.lower() == TIME for column in columns):
        first = channels[0].properties.get("wf_start_offset", 0.0)
        columns.insert(0, Column(TIME, "s", first + step * np.arange(len(channels[0]))))
    return Sheet(columns, None, True, f"group {quote(name)} of a TDMS file")


# Rigol -----------------------------------------------------------------------------------------

# First two lines in files of the series DS1000Z, DS2000 and DS4000.
_HEAD = re.compile(r"X(,[^,\r\n]+)+,Start,Increment,?\s*[\r\n]+Sequence,")


def is_rigol(text: str) -> bool:
    """Tell the text of a waveform that a Rigol oscilloscope saved, by its first lines."""
    return _HEAD.match(text) is not None


def read_rigol(text: str) -> Sheet:
    """Read the channels of a Rigol waveform; sample n is at ``Start`` + n ``Increment`` [s]."""
    names, said = (line.rstrip(",").split(",") for line in text.splitlines()[:2])
    channels = names[1:-2]
    if len(said) != len(names):
        raise RecordError(f"line 2 has {len(said)} entries, line 1 {len(names)}; save it anew")
    first, step = _parse_seconds(said[-2]), _parse_seconds(said[-1])
    sheet = read_delimited(text, ".", 2)
    if len(sheet.columns) != len(channels) + 1:
        raise RecordError(
            f"line 3 has {len(sheet.columns)} values for {len(channels) + 1} columns; save it anew"
        )
    sequence, *values = (column.values for column in sheet.columns)
    if sequence is None:
        raise RecordError("the numbers of samples are none; save it anew")
    sheet.columns = [
        Column(TIME, "s", np.asarray(first + step * sequence)),
        *map(Column, channels, said[1:-2], values),
    ]
    sheet.header, sheet.form = True, "waveform of a Rigol oscilloscope"
    return sheet


def _parse_seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RecordError(
            f"line 2 ends with {quote(text)}, where start and increment in seconds are wanted; save it anew"
        )
    return value
