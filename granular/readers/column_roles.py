"""Roles of the columns of a sheet: the time, the coordinate, and what goes with it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from granular.readers.calibration import Calibration, parse_calibration
from granular.readers.column_headers import (
    ACCELERATION,
    ANGLES,
    CHANNEL,
    COUNTERS,
    FORCE,
    HEIGHT,
    LOADS,
    PREFERRED,
    SYNONYMS,
    TIME,
    VELOCITY,
    guess_column_role,
    normalize_column_name,
    normalize_unit,
)
from granular.readers.read_options import ANGLE, ROLES, STROKE, ReadOptions
from granular.readers.role_units import SI
from granular.readers.sheet import Column, Sheet
from granular.schema.field_kinds import unknown_word_message
from granular.schema.units import unit_size
from granular.shared.errors import RecordError, SceneError
from granular.shared.message_text import quote, sanitize

NAMED = (TIME, HEIGHT, VELOCITY, FORCE)
"""Roles that a column's name gives it; the others are said."""
_MOST_SHOWN = 20
_LONGEST_NAME = 40
_ALIKE = 0.1
"""Fraction of the largest swing from which on another column of its unit moves alike."""
_LEAST_STEPS = 10
"""Samples from which on even steps tell that two columns may be the time."""
_UNEVEN = 0.01
"""Relative deviation of steps from their median from which on they are not those of a clock."""


def assign_roles(
    sheet: Sheet, options: ReadOptions, notes: list[str]
) -> tuple[dict[str, Column], dict[str, Calibration]]:
    """Assign each role to a column: as the user says, by its name, or to the only one that fits."""
    chosen = {role: _find_named_column(sheet, column) for role, column in options.columns.items()}
    for alias in [name for name in (ANGLE, STROKE) if name in chosen]:
        if HEIGHT in chosen:
            raise RecordError(f"columns: both height and {alias} are given; give one of them")
        chosen[HEIGHT] = chosen.pop(alias)
    if options.rate is not None and TIME not in chosen:
        chosen[TIME] = _evenly_spaced_times(sheet, float(options.rate))
    calibrations = _calibrations_by_role(sheet, chosen, options.calibrations())
    if HEIGHT in calibrations and calibrations[HEIGHT].raw_unit is not None:
        _choose_height_by_unit(sheet, chosen, str(calibrations[HEIGHT].raw_unit))
    _choose_columns_by_name(sheet, chosen, notes)
    if TIME not in chosen:
        _choose_time_column(sheet, chosen, notes)
    if HEIGHT not in chosen:
        _choose_height_column(sheet, chosen, options, notes)
    return chosen, calibrations


def motion_role(chosen: Mapping[str, object]) -> str:
    """Role of the column that tells the motion: the coordinate, or else its derivative."""
    return next(role for role in (HEIGHT, VELOCITY, ACCELERATION) if role in chosen)


def _calibrations_by_role(
    sheet: Sheet, chosen: dict[str, Column], given: Mapping[str, Mapping[str, Any]]
) -> dict[str, Calibration]:
    """Return the calibration of each role; a column that is named gets one where it has none."""
    by_role: dict[str, dict[str, Any]] = {}
    for key, said in given.items():
        role: str | None = key
        if key not in ROLES and key not in chosen:
            column = _find_named_column(sheet, key)
            role = next((role for role, taken in chosen.items() if taken is column), None)
            guess = guess_column_role(column.name)
            if role is None and guess in NAMED and guess not in chosen:
                role = guess
            if role is None and HEIGHT not in chosen and _is_height_calibration(said):
                role = HEIGHT
            role = role or column.name.lower()
            chosen[role] = column
        by_role.setdefault(str(role), {}).update(said)
    return {role: parse_calibration(role, said) for role, said in by_role.items()}


def _is_height_calibration(said: Mapping[str, Any]) -> bool:
    try:
        parse_calibration(HEIGHT, said)
    except RecordError:
        return False
    return True


def _evenly_spaced_times(sheet: Sheet, rate: float) -> Column:
    """Column of times at a rate [Hz], which the file does not hold."""
    lengths = [len(column.values) for column in sheet.columns if column.values is not None]
    return Column("", "s", np.arange(max(lengths, default=0)) / rate)


def _choose_height_by_unit(sheet: Sheet, chosen: dict[str, Column], unit: str) -> None:
    """Take the only column in the unit of a calibration for the height, where no name says more."""
    taken = list(map(id, chosen.values()))
    fitting = [
        column
        for column in sheet.columns
        if id(column) not in taken and column.unit and normalize_unit(column.unit) == unit
    ]
    if HEIGHT not in chosen and len(fitting) == 1:
        chosen[HEIGHT] = fitting[0]


def find_time_column(sheet: Sheet) -> Column:
    """Find the column of times of a sheet, by its name or its values."""
    chosen: dict[str, Column] = {}
    _choose_columns_by_name(sheet, chosen, [])
    if TIME not in chosen:
        _choose_time_column(sheet, chosen, [])
    return chosen[TIME]


def _find_named_column(sheet: Sheet, wanted: str | int) -> Column:
    if isinstance(wanted, int) or wanted.isdigit():
        number = int(wanted)
        if not 1 <= number <= len(sheet.columns):
            raise RecordError(f"there is no column {number}; give a number from 1 to {len(sheet.columns)}")
        return sheet.columns[number - 1]
    for column in sheet.columns:
        if column.name.lower() == wanted.strip().lower():
            return column
    raise RecordError(
        unknown_word_message(wanted, [column.name for column in sheet.columns if column.name], "column")
    )


def _choose_columns_by_name(sheet: Sheet, chosen: dict[str, Column], notes: list[str]) -> None:
    taken = list(map(id, chosen.values()))
    called: dict[str, list[Column]] = {}
    for column in sheet.columns:
        if not column.channel:
            called.setdefault(normalize_column_name(column.name), []).append(column)
    for role in (role for role in NAMED if role not in chosen):
        result = [item for word in SYNONYMS[role] for item in called.get(word, []) if id(item) not in taken]
        if role in (HEIGHT, VELOCITY):
            result = [item for item in result if item.name.lower() == role or _unit_fits_role(item, role)]
        if role == FORCE and not result:
            loads = [item for word in LOADS for item in called.get(word, [])]
            result = [item for item in loads if item.unit and has_same_dimension(item.unit, "N")]
        if role == HEIGHT:
            result = _put_moving_column_first(result)
        if not result:
            continue
        chosen[role] = result[0]
        taken.append(id(result[0]))
        if len(result) > 1 and result[0].name.lower() != role:
            others = ", ".join(quote(item.name) for item in result[1:_MOST_SHOWN])
            notes.append(f"{role} is the column {quote(result[0].name)}, not {others} (columns: {role}=...)")


def _put_moving_column_first(candidates: list[Column]) -> list[Column]:
    """Columns that may be the coordinate, the one that moves first; refused if several do."""
    if not candidates or normalize_column_name(candidates[0].name) in PREFERRED:
        return candidates
    moving = [item for item in candidates if _standard_deviation(item) > 0.0]
    if not moving:  # another column may be it
        return []
    kinds = {(item.unit, normalize_column_name(item.name) in ANGLES) for item in moving}
    if len(kinds) == 1:
        largest = max(map(_standard_deviation, moving))
        moving = [item for item in moving if _standard_deviation(item) > _ALIKE * largest]
    names = {item.name.lower() for item in candidates}
    if len(moving) > 1 and len(names) == len(candidates):  # two of a name are said as such
        raise RecordError(_ambiguous_columns_text(HEIGHT, [item.name for item in moving]))
    if len(moving) != 1 or _is_increasing(moving[0]):  # it may be the time
        return candidates
    still = [item for item in candidates if item is not moving[0]]
    return [*moving, *still]


def _ambiguous_columns_text(role: str, names: Sequence[str | int]) -> str:
    """Return the words of an error that leaves the choice between columns, with each option."""
    shown = [sanitize(name, _LONGEST_NAME) for name in names[:_MOST_SHOWN]]
    columns = " or ".join(f"column {name}" if name.isdigit() else quote(name) for name in shown)
    options = " or ".join(f"--columns {shlex.quote(f'{role}={name}')}" for name in shown)
    return f"{role} may be {columns}; say which: {options}"


def _count_finite_values(column: Column) -> int:
    return 0 if column.values is None else int(np.isfinite(column.values).sum())


def _standard_deviation(column: Column) -> float:
    if column.values is None:
        return 0.0
    known = column.values[np.isfinite(column.values)]
    return float(known.std()) if len(known) else 0.0


def _unit_fits_role(column: Column, role: str) -> bool:
    """Return True where a column's unit, if it has one, is one of the role's."""
    if column.unit is None:
        return True
    try:
        dimension = unit_size(normalize_unit(column.unit))[1]
    except SceneError:
        return True  # said when it is used
    wanted = (unit_size(SI[role])[1], unit_size("rad" if role == HEIGHT else "1/s")[1])
    return dimension in wanted or dimension[3] != 0  # of a sensor: said when it is used


def _choose_time_column(sheet: Sheet, chosen: dict[str, Column], notes: list[str]) -> None:
    """Dates and times of day, else the first column that increases, where no name says more."""
    taken = list(map(id, chosen.values()))
    free = [column for column in sheet.columns if id(column) not in taken and column.values is not None]
    stamps = [item for item in free if item.clock]
    timed = [
        item for item in free if item.unit and has_same_dimension(item.unit, "s") and _is_increasing(item)
    ]
    nameless = [item for item in free if not item.name and _is_increasing(item)]
    even = [item for item in nameless if not _has_uneven_steps(item)]
    if not stamps and not timed and len(even) > 1 and _count_finite_values(even[0]) >= _LEAST_STEPS:
        raise RecordError(_ambiguous_columns_text(TIME, [sheet.columns.index(item) + 1 for item in even]))
    result = (stamps or timed or even or nameless)[:1]
    if not result:
        raise RecordError(
            f"no column 'time'; found: {_column_names_text(sheet)}; {_advice_on_naming_time(free)}"
        )
    chosen[TIME] = result[0]
    if not stamps and not timed:
        number = sheet.columns.index(result[0]) + 1
        notes.append(f"there are no names: time is column {number}, in s (columns: time=...)")


def _advice_on_naming_time(free: Sequence[Column]) -> str:
    """Return what to say of the time, by the columns that are there."""
    counted = [item for item in free if normalize_column_name(item.name) in COUNTERS]
    if counted:
        return (
            f"{quote(counted[0].name)} counts samples: give how many there are in a second (rate: '100 Hz')"
        )
    even = [item for item in free if item.name and _is_increasing(item) and not _has_uneven_steps(item)]
    if even:
        return (
            f"{quote(even[0].name)} rises in even steps: if it is the time, say so and its unit "
            f"(columns: time={sanitize(even[0].name, _LONGEST_NAME)}, units: time=s)"
        )
    return (
        "name the columns in the first line, such as 'time [s], height [mm]', or say which is "
        "which (columns: time=NAME), or how many samples there are in a second (rate: '100 Hz')"
    )


def _has_uneven_steps(column: Column) -> bool:
    """Return True unless a column's steps are all alike, as those of a sampled time are."""
    assert column.values is not None
    steps = np.diff(column.values[np.isfinite(column.values)])
    return bool(np.abs(steps - np.median(steps)).max() > _UNEVEN * np.median(steps))


def _is_acceleration_column(column: Column) -> bool:
    if column.channel:
        return False
    if guess_column_role(column.name) == ACCELERATION:
        return True
    return column.unit is not None and has_same_dimension(column.unit, "m/s^2")


def has_same_dimension(unit: str, wanted: str) -> bool:
    """Compare the physical dimensions of two units."""
    try:
        return unit_size(normalize_unit(unit))[1] == unit_size(wanted)[1]
    except SceneError:
        return False


def _is_increasing(column: Column) -> bool:
    assert column.values is not None
    known = column.values[np.isfinite(column.values)]
    return len(known) > 1 and bool((np.diff(known) >= 0.0).all()) and known[-1] > known[0]


def _choose_height_column(
    sheet: Sheet, chosen: dict[str, Column], options: ReadOptions, notes: list[str]
) -> None:
    """Only other column of numbers, or of those without names the next."""
    taken = list(map(id, chosen.values()))
    free = [
        column
        for column in sheet.columns
        if id(column) not in taken and column.values is not None and np.isfinite(column.values).any()
    ]
    _refuse_to_guess_channel(free)
    lengths = [
        item
        for item in free
        if _unit_fits_role(item, HEIGHT)
        and guess_column_role(item.name) in (None, HEIGHT)
        and normalize_column_name(item.name) not in COUNTERS
    ]
    nameless = [length for length in lengths if not length.name]
    result = lengths if len(lengths) == 1 else nameless[:1]
    if not result:
        if len(lengths) > 1:
            raise RecordError(_ambiguous_columns_text(HEIGHT, [item.name for item in lengths]))
        if not {VELOCITY, ACCELERATION}.isdisjoint(options.columns):
            notes.append(
                f"there is no position: a law is fitted to the {motion_role(chosen)}, which tells "
                "no level of rest (columns: height=... for a position)"
            )
            return
        raise RecordError(_no_coordinate_text(sheet, free))
    chosen[HEIGHT] = result[0]
    if result[0].name:
        notes.append(
            f"height is the column {quote(result[0].name)}, the only other one of numbers "
            f"(columns: height=..., {'' if result[0].unit else 'units: height=..., '}and flip if "
            "it grows downwards)"
        )
    else:
        number = sheet.columns.index(result[0]) + 1
        unit = normalize_unit(result[0].unit or "m")
        notes.append(f"height is column {number}, in {unit} (columns: height=..., units: height=mm)")


def _no_coordinate_text(sheet: Sheet, free: Sequence[Column]) -> str:
    """Return the words of an error where no column can be the coordinate."""
    accelerations = [item for item in free if _is_acceleration_column(item)]
    if accelerations:
        name = quote(accelerations[0].name)
        return (
            f"no column 'height', only the acceleration {name}: twice integrated, its offset grows "
            f"with the square of the time; record a position, or fit a law to the acceleration "
            f"itself (columns: acceleration={sanitize(accelerations[0].name, _LONGEST_NAME)})"
        )
    sensors = [item for item in free if item.unit and _is_sensor_unit(normalize_unit(item.unit))]
    advice = (
        f"; of a sensor in {quote(sensors[0].unit)}, say which it is and its scale (columns: "
        f"height={sanitize(sensors[0].name, _LONGEST_NAME)}, scale: '2.5 mm/{sensors[0].unit}')"
        if sensors
        else ""
    )
    return (
        f"no column 'height'; found: {_column_names_text(sheet)}; name the columns in the first line, "
        "such as 'time [s], height [mm]', or say which is which (columns: height=NAME)" + advice
    )


def _is_sensor_unit(unit: str) -> bool:
    """Return True for a unit of what sensors give: electrical, a pressure, or unknown."""
    try:
        dimension = unit_size(unit)[1]
    except SceneError:
        return True
    return dimension[3] != 0 or dimension == unit_size("Pa")[1]


def _refuse_to_guess_channel(columns: Sequence[Column]) -> None:
    """Refuse to guess which input of an instrument the height was connected to."""
    names = [
        column.name
        for column in columns
        if column.channel or (not column.unit and CHANNEL.fullmatch(normalize_column_name(column.name)))
    ]
    if names and len(names) == len(columns):
        raise RecordError(
            f"no column 'height', only channels: {', '.join(map(quote, names))}; say which it is "
            f"and its unit (columns: height={names[0]}, units: height=mm)"
        )


def _column_names_text(sheet: Sheet) -> str:
    names = [column.name.lower() for column in sheet.columns if column.name]
    return ", ".join(map(quote, names[:_MOST_SHOWN])) or "none with a name"
