"""Roles of the columns of a sheet: the time, the coordinate, and what goes with it."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from granular.records.calibration import Calibration, parse_calibration
from granular.records.headings import (
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
    dimension_of,
    guess_column_role,
    has_dimension_of,
    is_level,
    is_unit,
    normalize_column_name,
    normalize_unit,
    role_of_component,
    si_unit_of_role,
)
from granular.records.options import ANGLE, ROLES, STROKE, ReadOptions
from granular.records.sheet import Column, Sheet
from granular.shared.errors import RecordError, quote, sanitize, unknown_word_message

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
_NUMBERED = re.compile(r"(.+) \(([1-9]\d{0,4})\)")
"""Name and number of a further column whose name stands twice in a file."""
_SIZE = re.compile(r"abs|total|magnitude|betrag")
"""Words for the size of a vector, whose frequency is twice that of its components."""
_UNEVEN = 0.01
"""Relative deviation of steps from their median from which on they are not those of a clock."""
_RATES_OF_CHANGE = {VELOCITY: ("m/s", "rad/s"), ACCELERATION: ("m/s^2", "rad/s^2")}

Roles = dict[str, Column]


def assign_roles(
    sheet: Sheet, options: ReadOptions, notes: list[str]
) -> tuple[Roles, dict[str, Calibration]]:
    """Assign each role to a column: as the user says, by its name, or to the only one that fits."""
    chosen = {role: _find_named_column(sheet, column) for role, column in options.columns.items()}
    for alias in [name for name in (ANGLE, STROKE) if name in chosen]:
        if HEIGHT in chosen:
            raise RecordError(f"columns: both height and {alias} are given; give one of them")
        chosen[HEIGHT] = chosen.pop(alias)
    if options.rate is not None and TIME not in chosen:
        lengths = [len(column.values) for column in sheet.columns if column.values is not None]
        chosen[TIME] = Column("", "s", np.arange(max(lengths, default=0)) / float(options.rate))
    calibrations = _calibrations_by_role(sheet, chosen, options.calibrations())
    raw_unit = calibrations[HEIGHT].raw_unit if HEIGHT in calibrations else None
    fitting = [item for item in _free(sheet, chosen) if item.unit and normalize_unit(item.unit) == raw_unit]
    if HEIGHT not in chosen and len(fitting) == 1:
        chosen[HEIGHT] = fitting[0]
    _choose_columns_by_name(sheet, chosen, notes)
    if TIME not in chosen:
        _choose_time_column(sheet, chosen, notes)
    if HEIGHT not in chosen:
        _choose_height_column(sheet, chosen, options, notes)
    return chosen, calibrations


def motion_role(chosen: Mapping[str, object]) -> str:
    """Role of the column that tells the motion: the coordinate, or else its derivative."""
    return next(role for role in (HEIGHT, VELOCITY, ACCELERATION) if role in chosen)


def find_time_column(sheet: Sheet) -> Column:
    """Find the column of times of a sheet, by its name or its values."""
    chosen: Roles = {}
    _choose_columns_by_name(sheet, chosen, [])
    if TIME not in chosen:
        _choose_time_column(sheet, chosen, [])
    return chosen[TIME]


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


def columns_option(sheet: Sheet, role: str, column: Column) -> str:
    """Option of the command line that gives a column a role: by its name, or by its number."""
    name = column.name
    alone = sum(item.is_called(name) for item in sheet.columns) == 1
    plain = alone and not name.isdigit() and len(name) <= _LONGEST_NAME and sanitize(name) == name
    word = name if plain else sheet.columns.index(column) + 1
    return f"--columns {shlex.quote(f'{role}={word}')}"


def is_alone(sheet: Sheet, said: str) -> bool:
    """Return True for a column's number, or a name that only one column has."""
    numbered = said.isdigit() or _NUMBERED.fullmatch(said) is not None
    return numbered or sum(item.is_called(said) for item in sheet.columns) == 1


def _free(sheet: Sheet, chosen: Roles) -> list[Column]:
    """Columns that have no role yet."""
    return [column for column in sheet.columns if column not in chosen.values()]


def _find_named_column(sheet: Sheet, wanted: str | int) -> Column:
    columns = sheet.columns
    if isinstance(wanted, int) or wanted.isdigit():
        if not 1 <= int(wanted) <= len(columns):
            raise RecordError(f"there is no column {int(wanted)}; give a number from 1 to {len(columns)}")
        return columns[int(wanted) - 1]
    numbered = _NUMBERED.fullmatch(wanted)  # as further columns of one name are called
    further = [] if numbered is None else columns[int(numbered[2]) - 1 : int(numbered[2])]
    called = [column for column in columns if column.is_called(wanted)]
    called += [column for column in further if numbered and column.is_called(numbered[1])]
    if not called:
        names = [column.name for column in columns if column.name] or _column_numbers(sheet)
        raise RecordError(unknown_word_message(wanted, names, "column"))
    return called[0]


def _column_numbers(sheet: Sheet) -> list[str]:
    return [str(number) for number in range(1, len(sheet.columns) + 1)]


def _calibrations_by_role(
    sheet: Sheet, chosen: Roles, given: Mapping[str, Mapping[str, Any]]
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


# By names ----------------------------------------------------------------------------------------


def _choose_columns_by_name(sheet: Sheet, chosen: Roles, notes: list[str]) -> None:
    called: dict[str, list[Column]] = {}
    for column in sheet.columns:
        if not column.channel:
            called.setdefault(normalize_column_name(column.name), []).append(column)
    for role in (role for role in NAMED if role not in chosen):
        named = (item for word in SYNONYMS[role] for item in called.get(word, []))
        result = [item for item in named if item not in chosen.values()]
        if role in (HEIGHT, VELOCITY):
            result = [item for item in result if item.name.lower() == role or _unit_fits_role(item, role)]
        if role == FORCE and not result:
            loads = [item for word in LOADS for item in called.get(word, [])]
            result = [item for item in loads if has_dimension_of(item.unit, "N")]
        if role == HEIGHT:
            result = _put_moving_column_first(sheet, result)
        if not result:
            continue
        chosen[role] = result[0]
        if len(result) > 1 and result[0].name.lower() != role:
            others = ", ".join(quote(item.name) for item in result[1:_MOST_SHOWN])
            another = columns_option(sheet, role, result[1])
            notes.append(f"{role} is the column {quote(result[0].name)}, not {others} (another: {another})")


def _put_moving_column_first(sheet: Sheet, candidates: list[Column]) -> list[Column]:
    """Columns that may be the coordinate, the one that moves first; refused if several do."""
    if not candidates or normalize_column_name(candidates[0].name) in PREFERRED:
        return candidates
    spreads = {item: _standard_deviation(item) for item in candidates}
    moving = [item for item in candidates if spreads[item] > 0.0]
    if not moving:  # another column may be it
        return []
    if len({(item.unit, normalize_column_name(item.name) in ANGLES) for item in moving}) == 1:
        moving = [item for item in moving if spreads[item] > _ALIKE * max(spreads.values())]
    names = {item.name.lower() for item in candidates}
    if len(moving) > 1 and len(names) == len(candidates):  # two of a name are said as such
        raise RecordError(_ambiguous_columns_text(sheet, HEIGHT, moving))
    if len(moving) != 1 or _is_increasing(moving[0]):  # it may be the time
        return candidates
    return [*moving, *(item for item in candidates if item is not moving[0])]


def _unit_fits_role(column: Column, role: str) -> bool:
    """Return True where a column's unit, if it has one, is one of the role's."""
    dimension = dimension_of(column.unit)
    if dimension is None or dimension[3] != 0:  # unknown, or of a sensor: said when it is used
        return True
    return has_dimension_of(column.unit, si_unit_of_role(role), "rad" if role == HEIGHT else "1/s")


def _ambiguous_columns_text(sheet: Sheet, role: str, columns: Sequence[Column]) -> str:
    """Return the words of an error that leaves the choice between columns, with each option."""
    shown = columns[:_MOST_SHOWN]
    names = " or ".join(_name_or_number(sheet, item) for item in shown)
    options = " or ".join(columns_option(sheet, role, item) for item in shown)
    return f"{role} may be {names}; say which: {options}"


def _name_or_number(sheet: Sheet, column: Column) -> str:
    return quote(column.name) if column.name else f"column {sheet.columns.index(column) + 1}"


def _standard_deviation(column: Column) -> float:
    return float(column.known.std()) if len(column.known) else 0.0


def _is_increasing(column: Column) -> bool:
    known = column.known
    return len(known) > 1 and bool((np.diff(known) >= 0.0).all()) and bool(known[-1] > known[0])


def _has_even_steps(column: Column) -> bool:
    """Return True where a column rises in steps of one size, as sampled times do."""
    if not _is_increasing(column):
        return False
    steps = np.diff(column.known)
    return bool(np.abs(steps - np.median(steps)).max() <= _UNEVEN * np.median(steps))


# By values ---------------------------------------------------------------------------------------


def _choose_time_column(sheet: Sheet, chosen: Roles, notes: list[str]) -> None:
    """Dates and times of day, else the first column that increases, where no name says more."""
    numeric = [column for column in _free(sheet, chosen) if column.values is not None]
    index = [column for column in numeric if is_index(sheet, column)]
    free = [column for column in numeric if column not in index]
    timed = [item for item in free if item.clock] or [
        item for item in free if has_dimension_of(item.unit, "s") and _is_increasing(item)
    ]
    nameless = [item for item in free if not item.name and _is_increasing(item)]
    even = [item for item in nameless if _has_even_steps(item)]
    if not timed and len(even) > 1 and len(even[0].known) >= _LEAST_STEPS:
        raise RecordError(_ambiguous_columns_text(sheet, TIME, even))
    result = timed or even or nameless
    if not result:
        counted = [*index, *(item for item in free if normalize_column_name(item.name) in COUNTERS)]
        raise RecordError(
            f"no column 'time'; found: {_column_names_text(sheet)}; {_advice_on_naming_time(sheet, counted)}"
        )
    chosen[TIME] = result[0]
    if not timed:
        number = _name_or_number(sheet, result[0])
        notes.append(f"there are no names: time is {number}, in s (--units time=ms)")


def _advice_on_naming_time(sheet: Sheet, counted: Sequence[Column]) -> str:
    """Return what to say of the time, by the columns that are there; some count samples."""
    even = [item for item in sheet.columns if item.name and item not in counted and _has_even_steps(item)]
    maybe = next(filter(_may_be_time, even), None)
    if maybe is not None:
        return (
            f"{quote(maybe.name)} rises in even steps: if it is the time, say so and its unit, such as "
            f"{columns_option(sheet, TIME, maybe)} --units time=s"
        )
    if counted:
        name = _name_or_number(sheet, counted[0])
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
        return has_dimension_of(column.unit, "s")
    name = normalize_column_name(column.name)
    return len(name) == 1 or not (guess_column_role(name) or NO_TIMES.intersection(name.split()))


def _choose_height_column(sheet: Sheet, chosen: Roles, options: ReadOptions, notes: list[str]) -> None:
    """Only other column of numbers, or of those without names the next."""
    free = [item for item in _free(sheet, chosen) if len(item.known) and not is_index(sheet, item)]
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
    if not result and len(lengths) > 1:
        raise RecordError(_ambiguous_columns_text(sheet, HEIGHT, lengths))
    if not result and not {VELOCITY, ACCELERATION}.isdisjoint(options.columns):
        notes.append(
            f"there is no position: a law is fitted to the {motion_role(chosen)}, which tells "
            "no level of rest (--columns height=NAME for a position)"
        )
        return
    if not result:
        raise RecordError(_no_coordinate_text(sheet, free))
    height = chosen[HEIGHT] = result[0]
    if height.name:
        notes.append(
            f"height is the column {quote(height.name)}, the only other one of numbers "
            f"({'' if height.unit else '--units height=mm; '}--flip if it grows downwards)"
        )
    else:
        unit = normalize_unit(height.unit or "m")
        notes.append(f"height is {_name_or_number(sheet, height)}, in {unit} (--units height=mm)")


def _no_coordinate_text(sheet: Sheet, free: Sequence[Column]) -> str:
    """Return the words of an error where no column can be the coordinate."""
    accelerations = _columns_of_rate(free, ACCELERATION)
    if accelerations:
        return (
            f"no column 'height', only the acceleration {quote(accelerations[0].name)}: twice integrated, "
            "its offset grows with the square of the time; record a position, or fit a law to the "
            f"acceleration itself ({_options_in_turn(sheet, ACCELERATION, accelerations)})"
        )
    sensors = [item for item in free if item.unit and _is_sensor_unit(normalize_unit(item.unit))]
    velocities = _columns_of_rate([item for item in sheet.columns if item.values is not None], VELOCITY)
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


def _columns_of_rate(columns: Sequence[Column], role: str) -> list[Column]:
    """Columns of a velocity or acceleration, the one that scatters most first; a vector's size is last."""
    fitting = [
        item
        for item in columns
        if not item.channel
        and (role_of_component(item.name) == role or has_dimension_of(item.unit, *_RATES_OF_CHANGE[role]))
    ]
    return sorted(
        fitting, key=lambda item: (bool(_SIZE.search(item.name.lower())), -_standard_deviation(item))
    )


def _options_in_turn(sheet: Sheet, role: str, columns: Sequence[Column]) -> str:
    """Options for each of some columns, the one that scatters most first."""
    first, *others = [columns_option(sheet, role, item) for item in columns[:_MOST_SHOWN]]
    return f"{first}, which scatters most, or {' or '.join(others)}" if others else first


def _is_sensor_unit(unit: str) -> bool:
    """Return True for a unit of what sensors give: electrical, a pressure, or unknown."""
    dimension = dimension_of(unit)
    return not is_level(unit) and (dimension is None or dimension[3] != 0 or has_dimension_of(unit, "Pa"))


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
