"""Roles of the columns of a sheet: the time, the coordinate, and what goes with it."""

from __future__ import annotations

import re
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
    NO_TIMES,
    PREFERRED,
    SYNONYMS,
    TIME,
    VELOCITY,
    guess_column_role,
    is_unit,
    normalize_column_name,
    normalize_unit,
    role_of_component,
)
from granular.readers.read_options import ANGLE, ROLES, STROKE, ReadOptions
from granular.readers.role_units import SI, is_level
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
_INDEX = re.compile(r"(unnamed|index level|level) \d+|index")
"""Names, besides none, of a column that numbers the rows: as pandas writes and reads it."""
NUMBERED = re.compile(r"(.+) \(([1-9]\d{0,4})\)")
"""Name and number of a further column whose name stands twice in a file."""
_SIZE = re.compile(r"abs|total|magnitude|betrag")
"""Words for the size of a vector, whose frequency is twice that of its components."""
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
        if column.is_called(wanted):
            return column
    numbered = NUMBERED.fullmatch(wanted)  # as further columns of one name are called
    here = [] if numbered is None else sheet.columns[int(numbered[2]) - 1 : int(numbered[2])]
    if numbered is not None and here and here[0].is_called(numbered[1]):
        return here[0]
    names = [column.name for column in sheet.columns if column.name] or _column_numbers(sheet)
    raise RecordError(unknown_word_message(wanted, names, "column"))


def _column_numbers(sheet: Sheet) -> list[str]:
    return [str(number) for number in range(1, len(sheet.columns) + 1)]


def is_index(sheet: Sheet, column: Column) -> bool:
    """Tell a column that numbers the rows, as pandas and R write it: the first if nameless, or so called."""
    if not sheet.header or column.values is None or column.clock:
        return False
    named = _INDEX.fullmatch(normalize_column_name(column.name)) is not None
    if not named and (column.name or column is not sheet.columns[0]):
        return False
    steps = np.diff(column.values)
    integers = bool((column.values == np.round(column.values)).all())
    return integers and len(steps) > 0 and bool((steps >= 1.0).all()) and float(np.median(steps)) == 1.0


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
            result = _put_moving_column_first(sheet, result)
        if not result:
            continue
        chosen[role] = result[0]
        taken.append(id(result[0]))
        if len(result) > 1 and result[0].name.lower() != role:
            others = ", ".join(quote(item.name) for item in result[1:_MOST_SHOWN])
            another = columns_option(sheet, role, result[1])
            notes.append(f"{role} is the column {quote(result[0].name)}, not {others} (another: {another})")


def _put_moving_column_first(sheet: Sheet, candidates: list[Column]) -> list[Column]:
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
        raise RecordError(_ambiguous_columns_text(sheet, HEIGHT, moving))
    if len(moving) != 1 or _is_increasing(moving[0]):  # it may be the time
        return candidates
    still = [item for item in candidates if item is not moving[0]]
    return [*moving, *still]


def _ambiguous_columns_text(sheet: Sheet, role: str, columns: Sequence[Column]) -> str:
    """Return the words of an error that leaves the choice between columns, with each option."""
    shown = columns[:_MOST_SHOWN]
    names = " or ".join(quote(item.name) if item.name else _numbered(sheet, item) for item in shown)
    options = " or ".join(columns_option(sheet, role, item) for item in shown)
    return f"{role} may be {names}; say which: {options}"


def _numbered(sheet: Sheet, column: Column) -> str:
    return f"column {sheet.columns.index(column) + 1}"


def columns_option(sheet: Sheet, role: str, column: Column) -> str:
    """Option of the command line that gives a column a role: by its name, or by its number."""
    name = column.name
    alone = sum(item.is_called(name) for item in sheet.columns) == 1
    plain = alone and not name.isdigit() and len(name) <= _LONGEST_NAME and sanitize(name) == name
    word = name if plain else sheet.columns.index(column) + 1
    return f"--columns {shlex.quote(f'{role}={word}')}"


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
    index = [column for column in free if is_index(sheet, column)]
    free = [column for column in free if column not in index]
    stamps = [item for item in free if item.clock]
    timed = [
        item for item in free if item.unit and has_same_dimension(item.unit, "s") and _is_increasing(item)
    ]
    nameless = [item for item in free if not item.name and _is_increasing(item)]
    even = [item for item in nameless if _has_even_steps(item)]
    if not stamps and not timed and len(even) > 1 and _count_finite_values(even[0]) >= _LEAST_STEPS:
        raise RecordError(_ambiguous_columns_text(sheet, TIME, even))
    result = (stamps or timed or even or nameless)[:1]
    if not result:
        raise RecordError(
            f"no column 'time'; found: {_column_names_text(sheet)}; "
            f"{_advice_on_naming_time(sheet, free, index)}"
        )
    chosen[TIME] = result[0]
    if not stamps and not timed:
        notes.append(f"there are no names: time is {_numbered(sheet, result[0])}, in s (--units time=ms)")


def _advice_on_naming_time(sheet: Sheet, free: Sequence[Column], index: Sequence[Column]) -> str:
    """Return what to say of the time, by the columns that are there."""
    counted = [*index, *(item for item in free if normalize_column_name(item.name) in COUNTERS)]
    even = [
        item
        for item in sheet.columns
        if item.name and item.values is not None and item not in counted and _has_even_steps(item)
    ]
    maybe = [item for item in even if _may_be_time(item)]
    if maybe:
        return (
            f"{quote(maybe[0].name)} rises in even steps: if it is the time, say so and its unit, such as "
            f"{columns_option(sheet, TIME, maybe[0])} --units time=s"
        )
    if counted:
        name = quote(counted[0].name) if counted[0].name else _numbered(sheet, counted[0])
        return f"{name} counts samples: give how many there are in a second (--rate '100 Hz')"
    if even:
        unit = f" [{sanitize(even[0].unit)}]" if even[0].unit else ""
        return (
            f"{quote(even[0].name)}{unit} rises in even steps and is no time, as of a spectrum or a curve: "
            "bring the motion over time"
        )
    example = "time=NAME" if any(item.name for item in sheet.columns) else "time=1,height=2"
    return (
        "name the columns in the first line, such as 'time [s], height [mm]', or say which is "
        f"which (--columns {example}), or how many samples there are in a second (--rate '100 Hz')"
    )


def _may_be_time(column: Column) -> bool:
    """Return False for a column of another quantity, by its unit or its name; a letter alone may be any."""
    if column.unit is not None and is_unit(column.unit):
        return has_same_dimension(column.unit, "s")
    name = normalize_column_name(column.name)
    return len(name) == 1 or not (guess_column_role(name) or NO_TIMES.intersection(name.split()))


def _has_even_steps(column: Column) -> bool:
    """Return True where a column rises in steps of one size, as sampled times do."""
    if not _is_increasing(column):
        return False
    assert column.values is not None
    steps = np.diff(column.values[np.isfinite(column.values)])
    return bool(np.abs(steps - np.median(steps)).max() <= _UNEVEN * np.median(steps))


def _columns_of_quantity(columns: Sequence[Column], role: str, units: Sequence[str]) -> list[Column]:
    """Columns of a quantity by name or unit, the one that scatters most first; a vector's size is last."""
    fitting = [
        item
        for item in columns
        if not item.channel
        and (
            role_of_component(item.name) == role
            or (item.unit is not None and any(has_same_dimension(item.unit, unit) for unit in units))
        )
    ]
    return sorted(
        fitting, key=lambda item: (bool(_SIZE.search(item.name.lower())), -_standard_deviation(item))
    )


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
    free = [column for column in free if not is_index(sheet, column)]
    _refuse_to_guess_channel(sheet, free)
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
            raise RecordError(_ambiguous_columns_text(sheet, HEIGHT, lengths))
        if not {VELOCITY, ACCELERATION}.isdisjoint(options.columns):
            notes.append(
                f"there is no position: a law is fitted to the {motion_role(chosen)}, which tells "
                "no level of rest (--columns height=NAME for a position)"
            )
            return
        raise RecordError(_no_coordinate_text(sheet, free))
    chosen[HEIGHT] = result[0]
    if result[0].name:
        notes.append(
            f"height is the column {quote(result[0].name)}, the only other one of numbers "
            f"({'' if result[0].unit else '--units height=mm; '}--flip if it grows downwards)"
        )
    else:
        unit = normalize_unit(result[0].unit or "m")
        notes.append(f"height is {_numbered(sheet, result[0])}, in {unit} (--units height=mm)")


def _no_coordinate_text(sheet: Sheet, free: Sequence[Column]) -> str:
    """Return the words of an error where no column can be the coordinate."""
    accelerations = _columns_of_quantity(free, ACCELERATION, ("m/s^2", "rad/s^2"))
    if accelerations:
        return (
            f"no column 'height', only the acceleration {quote(accelerations[0].name)}: twice integrated, "
            "its offset grows with the square of the time; record a position, or fit a law to the "
            f"acceleration itself ({_options_in_turn(sheet, ACCELERATION, accelerations)})"
        )
    sensors = [item for item in free if item.unit and _is_sensor_unit(normalize_unit(item.unit))]
    numeric = [item for item in sheet.columns if item.values is not None]
    velocities = _columns_of_quantity(numeric, VELOCITY, ("m/s", "rad/s"))
    if velocities and not sensors:
        return (
            f"no column 'height', only the velocity {quote(velocities[0].name)}; record a position, or fit a "
            f"law to the velocity itself ({_options_in_turn(sheet, VELOCITY, velocities)})"
        )
    advice = (
        f"; of a sensor in {quote(sensors[0].unit)}, say which it is and its scale, such as "
        f"{columns_option(sheet, HEIGHT, sensors[0])} --scale '2.5 mm/{sanitize(sensors[0].unit)}'"
        if sensors
        else ""
    )
    return (
        f"no column 'height'; found: {_column_names_text(sheet)}; name the columns in the first line, "
        "such as 'time [s], height [mm]', or say which is which (--columns height=NAME)" + advice
    )


def _options_in_turn(sheet: Sheet, role: str, columns: Sequence[Column]) -> str:
    """Options for each of some columns, the one that scatters most first."""
    options = [columns_option(sheet, role, item) for item in columns[:_MOST_SHOWN]]
    others = "".join(f" or {option}" for option in options[1:])
    return f"{options[0]}, which scatters most,{others}" if others else options[0]


def _is_sensor_unit(unit: str) -> bool:
    """Return True for a unit of what sensors give: electrical, a pressure, or unknown."""
    if is_level(unit):
        return False
    try:
        dimension = unit_size(unit)[1]
    except SceneError:
        return True
    return dimension[3] != 0 or dimension == unit_size("Pa")[1]


def _refuse_to_guess_channel(sheet: Sheet, columns: Sequence[Column]) -> None:
    """Refuse to guess which input of an instrument the height was connected to."""
    channels = [
        column
        for column in columns
        if column.channel or (not column.unit and CHANNEL.fullmatch(normalize_column_name(column.name)))
    ]
    if channels and len(channels) == len(columns):
        names = ", ".join(quote(column.name) for column in channels[:_MOST_SHOWN])
        raise RecordError(
            f"no column 'height', only channels: {names}; say which it is and its unit, such as "
            f"{columns_option(sheet, HEIGHT, channels[0])} --units height=mm"
        )


def _column_names_text(sheet: Sheet) -> str:
    names = [column.name.lower() for column in sheet.columns if column.name]
    numbers = _column_numbers(sheet)[:_MOST_SHOWN]
    return ", ".join(map(quote, names[:_MOST_SHOWN])) or f"columns {', '.join(numbers)}, none with a name"
