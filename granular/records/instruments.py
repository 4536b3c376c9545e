"""Files of instruments: LabVIEW text (.lvm) and TDMS, waveforms of Rigol oscilloscopes."""

from __future__ import annotations

import datetime
import functools
import io
import itertools
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from granular.records.binary import Content, check_number_count, read_in_limited_process
from granular.records.headings import (
    ACCELERATION,
    HEIGHT,
    TIME,
    VELOCITY,
    guess_column_role,
    is_unit,
    name_and_unit,
)
from granular.records.options import ANGLE, STROKE, ReadOptions, note_on_other_tables
from granular.records.sheet import Column, Sheet, convert_parsing_errors
from granular.records.text import read_delimited
from granular.shared.array_types import Float
from granular.shared.errors import RecordError, quote

_END = "***End_of_Header***"
_X_VALUE = "x_value"
LABVIEW = re.compile(r"\s*LabVIEW Measurement")
"""First words of a LabVIEW measurement file (.lvm)."""
RIGOL = re.compile(r"X(,[^,\r\n]+)+,Start,Increment,?\s*[\r\n]+Sequence,")
"""First two lines in files of the oscilloscope series DS1000Z, DS2000 and DS4000."""


def read_labview(text: str, options: ReadOptions) -> Sheet:
    """Read the first segment of a LabVIEW measurement file (.lvm); times in s."""
    lines = re.split(r"\r\n|\r|\n", text)
    ends = [k for k, line in enumerate(lines) if line.strip().startswith(_END)]
    if not ends:
        raise RecordError(f"has no line {_END}; write the measurement again")
    separator = "," if any(line.startswith("Separator,") for line in lines[: ends[0]]) else "\t"
    file_header = _header_entries(lines[: ends[0]], separator)
    decimal = options.decimal or file_header.get("Decimal_Separator", ["."])[0]
    without_times = file_header.get("X_Columns", [""])[0] == "No"
    header = _header_entries(lines[ends[0] + 1 : ends[1]], separator) if len(ends) > 1 else {}
    begin = ends[:2][-1] + 1
    later = next((k for k in range(begin + 1, len(lines)) if lines[k].startswith("Channels")), None)
    body = "\n".join([*[""] * begin, *lines[begin:later]])
    if without_times:  # the lines begin with the separator
        body = re.sub(r"(?m)^(?=[\t,])", "0", body)
    sheet = read_delimited(body, decimal, 0)
    sheet.form = "LabVIEW measurement"
    if later is not None:
        sheet.notes.append(f"segments from line {later + 1} on are not read")
    labels = header.get("Y_Unit_Label", [])[: len(sheet.columns) - 1]
    for column, label in itertools.zip_longest(sheet.columns[1:], labels):
        column.name, unit = name_and_unit(column.heading, label, sheet.notes)
        column.unit = unit if label or is_unit(unit or "") else None
    channels, times = [], None
    sampling_times = functools.cache(_evenly_spaced_times)  # one array for channels that share a clock
    for number, column in enumerate(sheet.columns):
        name = column.name.lower()
        start = _channel_start_delay(header, number if name == _X_VALUE else number - 1)
        if name == _X_VALUE:
            times = column.values if column.values is None or start == 0.0 else column.values + start
        elif name != "comment" and column.values is not None:
            if without_times:
                # National Instruments, Specification for the LabVIEW Measurement File (.lvm), 2020.
                first, step = (_header_number(header, key, number - 1, decimal) for key in ("X0", "Delta_X"))
                times = sampling_times(first + start, step, len(column.values))
            if times is not None:
                channels.append(SampledChannel(column, times))
    if channels:
        sheet.columns = interpolate_channels_to_motion_times(channels, options, sheet.notes)
    return sheet


def _channel_start_delay(header: dict[str, list[str]], channel: int) -> float:
    """Return the delay [s] of a channel's start after the first channel's start; 0 if no start is given."""
    days, times = header.get("Date", []), header.get("Time", [])
    try:
        first, start = (
            datetime.datetime.fromisoformat(f"{days[k].replace('/', '-')} {times[k].replace(',', '.')}")
            for k in (0, channel)
        )
    except (IndexError, ValueError):
        return 0.0
    return (start - first).total_seconds()


def _header_entries(lines: list[str], separator: str) -> dict[str, list[str]]:
    rows = [line.strip().split(separator) for line in lines]
    return {name: [value.strip() for value in values] or [""] for name, *values in rows}


def _header_number(header: dict[str, list[str]], name: str, channel: int, decimal: str) -> float:
    entries = header.get(name, [""])
    text = entries[min(channel, len(entries) - 1)].replace(decimal, ".")
    try:
        return float(text)
    except ValueError:
        raise RecordError(
            f"{name} is {quote(text)}, not a number, and the file has no times; export it with times"
        ) from None


def read_tdms(content: bytes, options: ReadOptions) -> Sheet:
    """Read the group of a LabVIEW TDMS file that ``sheet`` names, or else the first group with samples."""
    (groups, notes), arrays = read_in_limited_process(list_channels, content)
    selected = options.select_table(groups, "group")
    filled = {name: channels for name, channels in selected.items() if channels}
    if not filled:
        raise RecordError("holds no channel with samples; export it again")
    name, channels = next(iter(filled.items()))
    if len(filled) > 1:
        notes.append(note_on_other_tables("group", list(filled)))
    timed = [channel for channel in channels if channel["step"]]
    if any(guess_column_role(channel["name"]) == TIME for channel in channels):
        timed = []
    length = len(arrays[(timed or channels)[0]["values"]])
    columns, times = [], []
    sampling_times = functools.cache(_evenly_spaced_times)
    for channel in channels:
        values = arrays[channel["values"]]
        if channel not in timed and len(values) != length:
            notes.append(f"{quote(channel['name'])} has {len(values)} samples, not {length}, and is dropped")
            continue
        columns.append(_column_of_channel(channel, values, notes))
        if timed:
            waveform, first = channel if channel["step"] else timed[0], timed[0]
            both_known = None not in (waveform["start"], first["start"])
            delay = float(waveform["start"] - first["start"]) * 1e-6 if both_known else 0.0
            times.append(sampling_times(delay + waveform["offset"], waveform["step"], len(values)))
    if timed:
        columns = interpolate_channels_to_motion_times(
            list(map(SampledChannel, columns, times)), options, notes
        )
    return Sheet(columns, None, True, f"group {quote(name)} of a TDMS file", notes)


def list_channels(content: bytes) -> Content:
    """List the numeric channels of each group of a TDMS file, with their start times in us, and notes."""
    arrays: list[np.ndarray] = []
    groups: dict[str, list[dict[str, Any]]] = {}
    with convert_parsing_errors("a TDMS file", "npTDMS", "labview"):
        from nptdms import TdmsFile

        file = TdmsFile.read(io.BytesIO(content))
        for group in file.groups():
            groups[group.name] = []
            for channel in group.channels():
                values, given = np.asarray(channel[:]), channel.properties
                if len(values) and values.dtype.kind in "iuf":
                    start = given.get("wf_start_time")
                    plain = {
                        "name": channel.name,
                        "unit": given.get("unit_string"),
                        "step": float(given.get("wf_increment", 0.0)),
                        "offset": float(given.get("wf_start_offset", 0.0)),
                        "start": None if start is None else int(np.datetime64(start, "us").astype(np.int64)),
                        "values": len(arrays),
                    }
                    groups[group.name].append(plain)
                    arrays.append(values)
    check_number_count(sum(array.size for array in arrays))
    cut = "its last segment is incomplete; the samples present in it are read"
    return [groups, [cut] if file.file_status.incomplete_final_segment else []], arrays


# Rigol -----------------------------------------------------------------------------------------


def read_rigol(text: str) -> Sheet:
    """Read the channels of a Rigol waveform; sample n is at ``Start`` + n ``Increment`` [s]."""
    names, entries = (line.rstrip(",").split(",") for line in text.splitlines()[:2])
    channels = names[1:-2]
    if len(entries) != len(names):
        raise RecordError(
            f"line 2 has {len(entries)} entries, but line 1 has {len(names)}; save the file again"
        )
    first, step = _parse_header_start_or_increment(entries[-2]), _parse_header_start_or_increment(entries[-1])
    sheet = read_delimited(text, ".", 2)
    if len(sheet.columns) != len(channels) + 1:
        raise RecordError(
            f"line 3 has {len(sheet.columns)} values for {len(channels) + 1} columns; save the file again"
        )
    sequence, *values = (column.values for column in sheet.columns)
    if sequence is None:
        raise RecordError("a sample number in the first column is not a number; save the file again")
    times = Column(TIME, "s", np.asarray(first + step * sequence))
    sheet.columns = [times, *map(Column, channels, entries[1:-2], values)]
    sheet.header, sheet.form = True, "waveform of a Rigol oscilloscope"
    return sheet


def _parse_header_start_or_increment(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RecordError(
            f"line 2 ends with {quote(text)} instead of start and increment in seconds; save the file again"
        )
    return value


# Channels with clocks ----------------------------------------------------------------------------

_MOTION = (HEIGHT, ANGLE, STROKE, VELOCITY, ACCELERATION)
_TIME_TOLERANCE = 1e-3
"""Two times that differ by less than this fraction of the sampling interval count as equal."""
_MIN_SAMPLES = 2


def _evenly_spaced_times(first: float, step: float, count: int) -> Float[np.ndarray, "n"]:
    return first + step * np.arange(count)


class SampledChannel(NamedTuple):
    """Channel of an instrument, with the times of its samples [s]."""

    column: Column
    times: Float[np.ndarray, "n"]


def sheet_of_channels(content: Content, options: ReadOptions, form: str) -> Sheet:
    """Make a sheet from channels; each refers by index to the arrays of its times [s] and values."""
    (channels, notes), arrays = content
    sampled = [
        SampledChannel(
            _column_of_channel(channel, arrays[channel["values"]], notes), arrays[channel["times"]]
        )
        for channel in channels
    ]
    sampled = _drop_channels_without_samples(sampled, options, notes)
    return Sheet(interpolate_channels_to_motion_times(sampled, options, notes), None, True, form, notes)


def _drop_channels_without_samples(
    channels: Sequence[SampledChannel], options: ReadOptions, notes: list[str]
) -> list[SampledChannel]:
    """Drop channels without samples; raise an error if no channel is left that can be the motion."""
    filled = [channel for channel in channels if len(channel.times)]
    empty = [channel.column.name for channel in channels if not len(channel.times)]
    notes += [f"{quote(name)} has no samples and is dropped" for name in empty]
    roles = {*options.columns, *(guess_column_role(channel.column.name) for channel in filled)}
    # otherwise a channel of another quantity might be taken for the height
    lost = roles.isdisjoint(_MOTION) and HEIGHT in map(guess_column_role, empty)
    if lost or not filled:
        raise RecordError("; ".join(["holds no motion with samples", *notes, "export it again"]))
    return filled


def _column_of_channel(channel: Mapping[str, Any], values: np.ndarray, notes: list[str]) -> Column:
    """Make the column of a channel; a separate label of the unit takes precedence over a unit in the name."""
    name, unit = name_and_unit(channel["name"], channel["unit"], notes)
    unit = unit if channel["unit"] or is_unit(unit or "") else None
    heading = channel.get("heading", channel["name"])
    return Column(name, unit, np.asarray(values, dtype=np.float64), heading=heading)


def interpolate_channels_to_motion_times(
    channels: Sequence[SampledChannel], options: ReadOptions, notes: list[str]
) -> list[Column]:
    """Interpolate all channels to the times of the motion at which channels with a role have samples."""
    motion = _choose_motion_channel(channels, options)
    times = motion.times
    common = np.isfinite(times)
    finite = times[common]
    tolerance = _TIME_TOLERANCE * float(np.median(np.diff(finite))) if len(finite) > 1 else 0.0
    for column, channel_times in channels:
        if channel_times is times or (
            len(channel_times) == len(times)
            and np.allclose(channel_times, times, rtol=0.0, atol=tolerance, equal_nan=True)
        ):
            continue
        assert column.values is not None
        known = np.isfinite(channel_times) & np.isfinite(column.values)
        values = np.full(len(times), np.nan)
        if known.any():
            known_times = channel_times[known]
            inside = (times >= known_times[0] - tolerance) & (times <= known_times[-1] + tolerance)
            values[inside] = np.interp(times[inside], known_times, column.values[known])
        column.values = values
        if not _has_role(column, options):
            continue
        together = common & np.isfinite(values)
        if together.sum() < _MIN_SAMPLES:
            notes.append(f"{quote(column.name)} has no samples during the motion")
            continue
        delay = float(channel_times[np.isfinite(channel_times)][0] - finite[0])
        notes.append(_note_on_clock(column.name, motion.column.name, delay, tolerance))
        if together.sum() < common.sum():
            notes[-1] += "; the record is cut to the times common to both"
        common = together
    columns = [Column(TIME, "s", times), *(column for column, _ in channels)]
    if not common.all():
        for column in columns:
            assert column.values is not None
            column.values = column.values[common]
    return columns


def _choose_motion_channel(channels: Sequence[SampledChannel], options: ReadOptions) -> SampledChannel:
    """Choose the channel of the coordinate by the options, or else by its name, or else the first one."""
    for requested in (str(options.columns[role]) for role in _MOTION if role in options.columns):
        for number, channel in enumerate(channels, start=2):  # the times are column 1
            if channel.column.has_name(requested) or requested == str(number):
                return channel
    named = (channel for channel in channels if guess_column_role(channel.column.name) == HEIGHT)
    return next(named, channels[0])


def _has_role(column: Column, options: ReadOptions) -> bool:
    return guess_column_role(column.name) is not None or any(
        column.has_name(str(requested)) for requested in options.columns.values()
    )


def _note_on_clock(name: str, other: str, delay: float, tolerance: float) -> str:
    start = f"starts {abs(delay):.4g} s {'after' if delay > 0.0 else 'before'} {quote(other)}"
    difference = start if abs(delay) > tolerance else f"is sampled at other times than {quote(other)}"
    return f"{quote(name)} {difference}, and is interpolated to the times of {quote(other)}"
