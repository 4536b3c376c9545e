"""Universal files (SDRC): data sets 58 and 58b over time, read by pyuff."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granular.records.binary import Content, read_in_limited_process
from granular.records.formats import FileFormat
from granular.records.headings import (
    dimension_of,
    guess_column_role,
    has_dimension_of_any,
    normalize_unit,
    split_header_into_name_and_unit,
)
from granular.records.instruments import sheet_of_channels
from granular.records.options import ReadOptions
from granular.records.sheet import Sheet, convert_parsing_errors
from granular.schema.units import unit_size
from granular.shared.errors import RecordError, quote

__all__ = ["UNIVERSAL"]

_FUNCTION, _UNITS = 58, 164
"""Types of data sets in a universal file: 58 holds a measured function, 164 holds the file's units."""
_UNKNOWN, _GENERAL, _TIME = 0, 1, 17
"""Codes for the quantity on the abscissa."""
_TIME_RESPONSE = 1
_OTHER_MACHINES = (1, 3)
"""Codes of binary number formats that pyuff cannot convert to IEEE 754."""
_QUANTITIES = {
    8: ("displacement", "length", "m"),
    9: ("force", "force", "N"),
    11: ("velocity", "length", "m/s"),
    12: ("acceleration", "length", "m/s^2"),
    13: ("force", "force", "N"),
}
"""For each code of a quantity on the ordinate: name, name of its unit in data set 164, and SI unit."""
_AXES = {1: "X", 2: "Y", 3: "Z"}


def read_universal(content: bytes, options: ReadOptions) -> Sheet:
    """Read the functions of time in a universal file as columns."""
    return sheet_of_channels(read_in_limited_process(list_functions, content), options, "universal file")


def list_functions(content: bytes) -> Content:
    """List the functions of time [s] in a universal file, with notes."""
    arrays: list[np.ndarray] = []
    notes: list[str] = []
    with (
        convert_parsing_errors("a universal file", "pyuff", "uff"),
        tempfile.TemporaryDirectory(prefix="universal-") as folder,
    ):
        import pyuff

        path = Path(folder) / "file.uff"  # pyuff reads named files only
        path.write_bytes(content)
        file = pyuff.UFF(str(path))
        kinds = [int(kind) for kind in file.get_set_types()]
        functions = [file.read_sets(number) for number, kind in enumerate(kinds) if kind == _FUNCTION]
        timed = [item for item in functions if _time_unit(item) and np.isrealobj(item["data"])]
        if not timed:
            kinds_text = ", ".join(str(kind) for kind in dict.fromkeys(kinds)) or "none that is complete"
            raise RecordError(
                f"holds no data set {_FUNCTION} with real values over time; data sets found: {kinds_text}; "
                "export the time record"
            )
        if len(timed) < len(functions):
            notes.append(
                f"{len(functions) - len(timed)} of {len(functions)} functions do not depend on "
                "time and are dropped"
            )
        if not content.rstrip(b"\0 \t\r\n").endswith(b"-1"):
            notes.append("its last data set is incomplete and is not read")
        units = [file.read_sets(number) for number, kind in enumerate(kinds) if kind == _UNITS]
        return [[_channel_of_function(item, units, arrays, notes) for item in timed], notes], arrays


def _channel_of_function(
    function: Mapping[str, Any], units: list[Mapping[str, Any]], arrays: list[np.ndarray], notes: list[str]
) -> dict[str, Any]:
    """Describe a function by name and unit, and add its times and values to the arrays."""
    name, heading = _name_and_heading(function)
    if function["binary"] and function["fp_format"] in _OTHER_MACHINES:
        raise RecordError(f"{quote(name)} holds numbers of a VAX or IBM machine; export it in IEEE format")
    given = int(function["num_pts"])
    count = min(given, len(function["data"]))  # a line feed after binary data counts as a number
    if 0 < count < given:
        notes.append(f"{quote(name)} ends after {count} of {given} samples")
    times = (_time_unit(function) or 1.0) * function["x"][:count]
    values = function["data"][:count]
    label = _header_text(function, "abscissa_axis_units_lab")
    if label and _unit_in_label(label) is None:
        notes.append(f"{quote(name)}: {quote(label)} is not a known unit of time, and is taken as s")
    unit = _header_text(function, "ordinate_axis_units_lab")
    quantity = _QUANTITIES.get(function["ordinate_spec_data_type"])
    if not unit and units and quantity and abs(function["rsp_dir"]) in _AXES:
        values, unit = values / units[-1][quantity[1]], quantity[2]
    arrays += [times, values]
    return {
        "name": name,
        "heading": heading,
        "unit": unit,
        "times": len(arrays) - 2,
        "values": len(arrays) - 1,
    }


def _time_unit(function: Mapping[str, Any]) -> float | None:
    """Return the size [s] of the unit of the abscissa; None if the abscissa is not a time."""
    label, kind = _header_text(function, "abscissa_axis_units_lab"), function["abscissa_spec_data_type"]
    unit = _unit_in_label(label)
    if unit is not None:
        return unit_size(normalize_unit(unit))[0] if has_dimension_of_any(unit, "s") else None
    is_response = function["func_type"] == _TIME_RESPONSE and kind in (_UNKNOWN, _GENERAL)
    return 1.0 if kind == _TIME or (is_response and not label) else None


def _unit_in_label(label: str) -> str | None:
    """Return the known unit that a label is or contains, as in ``Time (ms)``."""
    units = (label, split_header_into_name_and_unit(label)[1])
    return next((unit for unit in units if unit and dimension_of(unit) is not None), None)


def _name_and_heading(function: Mapping[str, Any]) -> tuple[str, str]:
    """Return a function's name, which includes its quantity, and its heading in the file."""
    node, axis = function["rsp_node"], int(function["rsp_dir"])
    location = f"node {node} {'-' if axis < 0 else '+'}{_AXES.get(abs(axis), abs(axis))}"
    labels = (_header_text(function, key) for key in ("id1", "rsp_ent_name", "ordinate_axis_lab"))
    heading = next(filter(None, labels), location)
    quantity = _QUANTITIES.get(function["ordinate_spec_data_type"])
    if quantity is None or guess_column_role(heading):
        return heading, heading
    return f"{quantity[0]} ({heading})", heading


def _header_text(function: Mapping[str, Any], key: str) -> str:
    text = str(function.get(key) or "").strip()
    return "" if text.upper() == "NONE" else text


UNIVERSAL = FileFormat(read_universal)
