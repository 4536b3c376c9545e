"""Measurement files of ASAM, MF4 and the older MDF, read by asammdf."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from granular.records.binary import Content, check_number_count, read_in_limited_process
from granular.records.formats import FileFormat
from granular.records.instruments import sheet_of_channels
from granular.records.options import ReadOptions
from granular.records.sheet import Sheet, convert_parsing_errors
from granular.shared.errors import RecordError, quote

__all__ = ["MEASUREMENT"]

_TIME = 1
"""Kind of a group's master channel that holds times [s] since the start of the measurement."""

_NO_BUS_MESSAGES: dict[str, Any] = {"process_bus_logging": False}  # an option that asammdf's types lack


def read_measurement(content: bytes, options: ReadOptions) -> Sheet:
    """Read the channels of all groups; the times of all groups are measured from the same moment."""
    return sheet_of_channels(read_in_limited_process(list_groups, content), options, "MDF measurement file")


def list_groups(content: bytes) -> Content:
    """List the numeric channels of all groups in physical units, with notes."""
    channels: list[dict[str, Any]] = []
    arrays: list[np.ndarray] = []
    notes: list[str] = []
    with convert_parsing_errors("an MDF file", "asammdf", "mf4"):
        from asammdf import MDF

        file = MDF(io.BytesIO(content), **_NO_BUS_MESSAGES)
        numbers = 0
        for group, about in file.virtual_groups.items():
            indices = [
                (None, part, index)
                for part, channel_indices in file.included_channels(group)[group].items()
                for index in channel_indices
            ]
            numbers += (len(indices) + 1) * about.cycles_nr
            check_number_count(numbers)
            if indices and about.cycles_nr:
                _list_channels(file, group, indices, channels, arrays, notes)
    if not channels:
        raise RecordError("; ".join(["holds no numeric channel with times", *notes, "export it again"]))
    return [channels, notes], arrays


def _list_channels(
    file: Any,
    group: int,
    indices: list[tuple[None, int, int]],
    channels: list[dict[str, Any]],
    arrays: list[np.ndarray],
    notes: list[str],
) -> None:
    """Add the numeric channels of a group and the group's times to the lists."""
    times = np.asarray(file.get_master(group))
    signals = file.select(indices, copy_master=False)
    master, kind = signals[0].master_metadata or ("", 0)
    if group not in file.masters_db or kind != _TIME:
        notes.append(
            f"the group of {quote(signals[0].name)} is recorded over {quote(master)} instead of "
            "time, and is dropped"
        )
        return
    if len(times) < len(signals[0].samples):  # the others of the library's samples are arbitrary
        notes.append(f"the group of {quote(signals[0].name)} is truncated: its last samples are missing")
    start = len(arrays)
    arrays.append(times)
    for signal in signals:
        values, invalid = signal.samples[: len(times)], signal.invalidation_bits
        if values.ndim == 1 and values.dtype.kind in "iuf":
            if invalid is not None:
                values = np.where(np.asarray(invalid[: len(times)], dtype=bool), np.nan, values)
            channels.append({"name": signal.name, "unit": signal.unit, "times": start, "values": len(arrays)})
            arrays.append(values)


MEASUREMENT = FileFormat(read_measurement)
