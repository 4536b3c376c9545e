"""Roles of the columns of a sheet: time, coordinate and further quantities."""

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
    NOT_TIME_WORDS,
    PREFERRED,
    SYNONYMS,
    TIME,
    VELOCITY,
    dimension_of,
    guess_column_role,
    guess_role_without_axis,
    has_dimension_of_any,
    is_logarithmic_unit,
    is_unit,
    normalize_column_name,
    normalize_unit,
    si_unit_of_role,
)
from granular.records.options import ANGLE, ROLES, STROKE, ReadOptions
from granular.records.sheet import Column, Sheet
from granular.shared.errors import RecordError, quote, sanitize, unknown_word_message

ROLES_FROM_NAMES = (TIME, HEIGHT, VELOCITY, FORCE)
"""Roles that may be guessed from names; the user must give the columns of other roles."""
_MAX_SHOWN = 20
_MAX_NAME_CHARACTERS = 40
_COMPARABLE_MOTION = 0.1
"""Minimum standard deviation of a possible coordinate, as a fraction of the largest one of all candidates."""
_MIN_STEPS = 10
"""Minimum number of samples for which a column with equal steps is taken as a possible time."""
_INDEX = re.compile(r"(unnamed|index level|level) \d+|index")
"""Names that pandas gives to a column of row numbers; such a column may also have no name."""
_NAME_WITH_NUMBER = re.compile(r"(.+) \(([1-9]\d{0,4})\)")
"""Pattern of a name with a column number, for names that occur more than once in a file."""
_MAGNITUDE = re.compile(r"abs|total|magnitude|betrag")
"""Words for the magnitude of a vector, which oscillates at twice the frequency of the components."""
_STEP_TOLERANCE = 0.01
"""Time steps count as equal if each deviates from the median by less than this fraction."""
_RATES_OF_CHANGE = {VELOCITY: ("m/s", "rad/s"), ACCELERATION: ("m/s^2", "rad/s^2")}

Roles = dict[str, Column]


def assign_roles_and_calibrations(
    sheet: Sheet, options: ReadOptions, notes: list[str]
) -> tuple[Roles, dict[str, Calibration]]:
    """Assign columns to roles by the options, by name, or by elimination; also return calibrations."""
    chosen = {role: _find_named_column(sheet, column) for role, column in options.columns.items()}
    for alias in [name for name in (ANGLE, STROKE) if name in chosen]:
        if HEIGHT in chosen:
            raise RecordError(f"columns: both height and {alias} are given; give only one of them")
        chosen[HEIGHT] = chosen.pop(alias)
    if options.rate is not None and TIME not in chosen:
        lengths = [len(column.values) for column in sheet.columns if column.values is not None]
        chosen[TIME] = Column("", "s", np.arange(max(lengths, default=0)) / float(options.rate))
    calibrations = _calibrations_by_role(sheet, chosen, options.calibrations())
    raw_unit = calibrations[HEIGHT].raw_unit if HEIGHT in calibrations else None
    fitting = [
        item
        for item in _columns_without_role(sheet, chosen)
        if item.unit and normalize_unit(item.unit) == raw_unit
    ]
    if HEIGHT not in chosen and len(fitting) == 1:
        chosen[HEIGHT] = fitting[0]
    _choose_columns_by_name(sheet, chosen, notes)
    if TIME not in chosen:
        _choose_time_column(sheet, chosen, notes)
    if HEIGHT not in chosen:
        _choose_height_column(sheet, chosen, options, notes)
    return chosen, calibrations


def choose_motion_role(chosen: Mapping[str, object]) -> str:
    """Return the role of the column that gives the motion: the coordinate, or else its derivative."""
    return next(role for role in (HEIGHT, VELOCITY, ACCELERATION) if role in chosen)


def find_time_column(sheet: Sheet) -> Column:
    """Find the column of times by its name or by its values."""
    chosen: Roles = {}
    _choose_columns_by_name(sheet, chosen, [])
    if TIME not in chosen:
        _choose_time_column(sheet, chosen, [])
    return chosen[TIME]


def is_row_number_column(sheet: Sheet, column: Column) -> bool:
    """Return True for row numbers as pandas and R write them, in an index or a nameless first column."""
    if not sheet.header or column.values is None or column.timestamp_kind:
        return False
    named = _INDEX.fullmatch(normalize_column_name(column.name)) is not None
    if not named and (column.name or column is not sheet.columns[0]):
        return False
    steps = np.diff(column.values)
    integers = bool((column.values == np.round(column.values)).all())
    return integers and len(steps) > 0 and bool((steps >= 1.0).all()) and float(np.median(steps)) == 1.0


def option_text_for_column(sheet: Sheet, role: str, column: Column) -> str:
    """Return the command-line option that assigns a role to a column, by the column's name or number."""
    name = column.name
    unique = sum(item.has_name(name) for item in sheet.columns) == 1
    plain = unique and not name.isdigit() and len(name) <= _MAX_NAME_CHARACTERS and sanitize(name) == name
    word = name if plain else sheet.columns.index(column) + 1
    return f"--columns {shlex.quote(f'{role}={word}')}"


def is_unambiguous_column(sheet: Sheet, column: str) -> bool:
    """Return True if a column is given by its number, or by a name that only one column has."""
    numbered = column.isdigit() or _NAME_WITH_NUMBER.fullmatch(column) is not None
    return numbered or sum(item.has_name(column) for item in sheet.columns) == 1


def _columns_without_role(sheet: Sheet, chosen: Roles) -> list[Column]:
    """List the columns without a role."""
    return [column for column in sheet.columns if column not in chosen.values()]


def _find_named_column(sheet: Sheet, requested: str | int) -> Column:
    columns = sheet.columns
    if isinstance(requested, int) or requested.isdigit():
        if not 1 <= int(requested) <= len(columns):
            raise RecordError(f"column {int(requested)} does not exist; give one from 1 to {len(columns)}")
        return columns[int(requested) - 1]
    numbered = _NAME_WITH_NUMBER.fullmatch(requested)  # the form for further columns of equal name
    further = [] if numbered is None else columns[int(numbered[2]) - 1 : int(numbered[2])]
    matches = [column for column in columns if column.has_name(requested)]
    matches += [column for column in further if numbered and column.has_name(numbered[1])]
    if not matches:
        names = [column.name for column in columns if column.name] or _column_number_texts(sheet)
        raise RecordError(unknown_word_message(requested, names, "column"))
    return matches[0]


def _column_number_texts(sheet: Sheet) -> list[str]:
    return [str(number) for number in range(1, len(sheet.columns) + 1)]


def _calibrations_by_role(
    sheet: Sheet, chosen: Roles, given: Mapping[str, Mapping[str, Any]]
) -> dict[str, Calibration]:
    """Return the calibration of each role; a calibrated column without a role is first assigned one."""
    by_role: dict[str, dict[str, Any]] = {}
    for key, calibration in given.items():
        role: str | None = key
        if key not in ROLES and key not in chosen:
            column = _find_named_column(sheet, key)
            role = next((role for role, taken in chosen.items() if taken is column), None)
            guess = guess_column_role(column.name)
            if role is None and guess in ROLES_FROM_NAMES and guess not in chosen:
                role = guess
            if role is None and HEIGHT not in chosen and _is_height_calibration(calibration):
                role = HEIGHT
            role = role or column.name.lower()
            chosen[role] = column
        by_role.setdefault(str(role), {}).update(calibration)
    return {role: parse_calibration(role, calibration) for role, calibration in by_role.items()}


def _is_height_calibration(calibration: Mapping[str, Any]) -> bool:
    try:
        parse_calibration(HEIGHT, calibration)
    except RecordError:
        return False
    return True


# By names ----------------------------------------------------------------------------------------


def _choose_columns_by_name(sheet: Sheet, chosen: Roles, notes: list[str]) -> None:
    by_name: dict[str, list[Column]] = {}
    for column in sheet.columns:
        if not column.is_channel:
            by_name.setdefault(normalize_column_name(column.name), []).append(column)
    for role in (role for role in ROLES_FROM_NAMES if role not in chosen):
        named = (item for word in SYNONYMS[role] for item in by_name.get(word, []))
        result = [item for item in named if item not in chosen.values()]
        if role in (HEIGHT, VELOCITY):
            result = [item for item in result if item.name.lower() == role or _unit_fits_role(item, role)]
        if role == FORCE and not result:
            loads = [item for word in LOADS for item in by_name.get(word, [])]
            result = [item for item in loads if has_dimension_of_any(item.unit, "N")]
        if role == HEIGHT:
            result = _move_varying_column_first(sheet, result)
        if not result:
            continue
        chosen[role] = result[0]
        if len(result) > 1 and result[0].name.lower() != role:
            others = ", ".join(quote(item.name) for item in result[1:_MAX_SHOWN])
            another = option_text_for_column(sheet, role, result[1])
            notes.append(
                f"{role} is the column {quote(result[0].name)}, not {others} (to choose another: {another})"
            )


def _move_varying_column_first(sheet: Sheet, candidates: list[Column]) -> list[Column]:
    """Move the only varying candidate for the coordinate to the front; raise an error if several vary."""
    if not candidates or normalize_column_name(candidates[0].name) in PREFERRED:
        return candidates
    spreads = {item: _standard_deviation(item) for item in candidates}
    moving = [item for item in candidates if spreads[item] > 0.0]
    if not moving:  # another column may be the coordinate
        return []
    if len({(item.unit, normalize_column_name(item.name) in ANGLES) for item in moving}) == 1:
        moving = [item for item in moving if spreads[item] > _COMPARABLE_MOTION * max(spreads.values())]
    names = {item.name.lower() for item in candidates}
    if len(moving) > 1 and len(names) == len(candidates):  # equal names have a separate error
        raise RecordError(_ambiguous_columns_text(sheet, HEIGHT, moving))
    if len(moving) != 1 or _is_increasing(moving[0]):  # an increasing column may be the time
        return candidates
    return [*moving, *(item for item in candidates if item is not moving[0])]


def _unit_fits_role(column: Column, role: str) -> bool:
    """Return True if a column has no unit, or a unit that suits the role."""
    dimension = dimension_of(column.unit)
    if (
        dimension is None or dimension[3] != 0
    ):  # unknown, or of a sensor: refused later, when the column is used
        return True
    return has_dimension_of_any(column.unit, si_unit_of_role(role), "rad" if role == HEIGHT else "1/s")


def _ambiguous_columns_text(sheet: Sheet, role: str, columns: Sequence[Column]) -> str:
    """Write the error text for an ambiguous role, with the command-line option for each column."""
    shown = columns[:_MAX_SHOWN]
    names = " or ".join(_name_or_number(sheet, item) for item in shown)
    options = " or ".join(option_text_for_column(sheet, role, item) for item in shown)
    return f"{role} may be {names}; choose one: {options}"


def _name_or_number(sheet: Sheet, column: Column) -> str:
    return quote(column.name) if column.name else f"column {sheet.columns.index(column) + 1}"


def _standard_deviation(column: Column) -> float:
    return float(column.finite_values.std()) if len(column.finite_values) else 0.0


def _is_increasing(column: Column) -> bool:
    known = column.finite_values
    return len(known) > 1 and bool((np.diff(known) >= 0.0).all()) and bool(known[-1] > known[0])


def _has_even_steps(column: Column) -> bool:
    """Return True if a column increases in equal steps, like sampled times."""
    if not _is_increasing(column):
        return False
    steps = np.diff(column.finite_values)
    return bool(np.abs(steps - np.median(steps)).max() <= _STEP_TOLERANCE * np.median(steps))


# By values ---------------------------------------------------------------------------------------


def _choose_time_column(sheet: Sheet, chosen: Roles, notes: list[str]) -> None:
    """Choose the column of dates or times of day, or else the first increasing column without a name."""
    numeric = [column for column in _columns_without_role(sheet, chosen) if column.values is not None]
    index = [column for column in numeric if is_row_number_column(sheet, column)]
    free = [column for column in numeric if column not in index]
    timed = [item for item in free if item.timestamp_kind] or [
        item for item in free if has_dimension_of_any(item.unit, "s") and _is_increasing(item)
    ]
    nameless = [item for item in free if not item.name and _is_increasing(item)]
    even = [item for item in nameless if _has_even_steps(item)]
    if not timed and len(even) > 1 and len(even[0].finite_values) >= _MIN_STEPS:
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
        notes.append(f"columns have no names: {number} is taken as the time, in s (for ms: --units time=ms)")


def _advice_on_naming_time(sheet: Sheet, counted: Sequence[Column]) -> str:
    """Return advice on how to give the time; ``counted`` are the columns that count samples."""
    even = [item for item in sheet.columns if item.name and item not in counted and _has_even_steps(item)]
    maybe = next(filter(_may_be_time, even), None)
    if maybe is not None:
        return (
            f"{quote(maybe.name)} increases in equal steps: if it is the time, give this column and its "
            f"unit, such as {option_text_for_column(sheet, TIME, maybe)} --units time=s"
        )
    if counted:
        name = _name_or_number(sheet, counted[0])
        return f"{name} counts samples: give the sampling rate (--rate '100 Hz')"
    if even:
        unit = f" [{sanitize(even[0].unit)}]" if even[0].unit else ""
        return (
            f"{quote(even[0].name)}{unit} increases in equal steps but is not a time, as in a spectrum or a "
            "curve: give the motion as a function of time"
        )
    example = "time=NAME" if any(item.name for item in sheet.columns) else "time=1,height=2"
    return (
        "name the columns in the first line, such as 'time [s], height [mm]', or give them "
        f"by option (--columns {example}), or give the sampling rate (--rate '100 Hz')"
    )


def _may_be_time(column: Column) -> bool:
    """Return False if unit or name shows that a column is not a time; a single letter may mean time."""
    if column.unit is not None and is_unit(column.unit):
        return has_dimension_of_any(column.unit, "s")
    name = normalize_column_name(column.name)
    return len(name) == 1 or not (guess_column_role(name) or NOT_TIME_WORDS.intersection(name.split()))


def _choose_height_column(sheet: Sheet, chosen: Roles, options: ReadOptions, notes: list[str]) -> None:
    """Choose the height: the only other numeric column, or, if columns have no names, the next one."""
    numeric = [
        item
        for item in _columns_without_role(sheet, chosen)
        if len(item.finite_values) and not is_row_number_column(sheet, item)
    ]
    _refuse_to_guess_channel(sheet, numeric)
    lengths = [
        item
        for item in numeric
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
            f"the record has no position: a law is fitted to the {choose_motion_role(chosen)}, so the "
            "equilibrium height remains unknown (for a position: --columns height=NAME)"
        )
        return
    if not result:
        raise RecordError(_no_coordinate_text(sheet, numeric))
    height = chosen[HEIGHT] = result[0]
    if height.name:
        notes.append(
            f"height is the column {quote(height.name)}, the only other numeric column "
            f"({'' if height.unit else 'for mm: --units height=mm; '}--flip if it increases downwards)"
        )
    else:
        unit = normalize_unit(height.unit or "m")
        notes.append(f"height is {_name_or_number(sheet, height)}, in {unit} (for mm: --units height=mm)")


def _no_coordinate_text(sheet: Sheet, free: Sequence[Column]) -> str:
    """Write the error text for a file in which no column can be the coordinate."""
    accelerations = _velocity_or_acceleration_columns(free, ACCELERATION)
    if accelerations:
        return (
            f"no column 'height', only the acceleration {quote(accelerations[0].name)}: a position "
            "integrated from it would drift with the square of time; record a position, or fit a "
            "law to the acceleration itself "
            f"({_text_of_column_options(sheet, ACCELERATION, accelerations)})"
        )
    sensors = [item for item in free if item.unit and _is_sensor_unit(normalize_unit(item.unit))]
    velocities = _velocity_or_acceleration_columns(
        [item for item in sheet.columns if item.values is not None], VELOCITY
    )
    if velocities and not sensors:
        return (
            f"no column 'height', only the velocity {quote(velocities[0].name)}; record a position, or fit a "
            f"law to the velocity itself ({_text_of_column_options(sheet, VELOCITY, velocities)})"
        )
    advice = (
        f"; for a sensor in {quote(sensors[0].unit)}, give its column and scale, such as "
        f"{option_text_for_column(sheet, HEIGHT, sensors[0])} --scale '2.5 mm/{sanitize(sensors[0].unit)}'"
        if sensors
        else ""
    )
    return (
        f"no column 'height'; found: {_column_names_text(sheet)}; name the columns in the first line, "
        "such as 'time [s], height [mm]', or give them by option (--columns height=NAME)" + advice
    )


def _velocity_or_acceleration_columns(columns: Sequence[Column], role: str) -> list[Column]:
    """List the columns of a velocity or acceleration by decreasing standard deviation, magnitudes last."""
    fitting = [
        item
        for item in columns
        if not item.is_channel
        and (
            guess_role_without_axis(item.name) == role
            or has_dimension_of_any(item.unit, *_RATES_OF_CHANGE[role])
        )
    ]
    return sorted(
        fitting, key=lambda item: (bool(_MAGNITUDE.search(item.name.lower())), -_standard_deviation(item))
    )


def _text_of_column_options(sheet: Sheet, role: str, columns: Sequence[Column]) -> str:
    """Write the option for each column, beginning with the column that varies most."""
    first, *others = [option_text_for_column(sheet, role, item) for item in columns[:_MAX_SHOWN]]
    return f"{first}, which varies most, or {' or '.join(others)}" if others else first


def _is_sensor_unit(unit: str) -> bool:
    """Return True for a unit that a sensor's output may have: electrical, of pressure, or unknown."""
    dimension = dimension_of(unit)
    return not is_logarithmic_unit(unit) and (
        dimension is None or dimension[3] != 0 or has_dimension_of_any(unit, "Pa")
    )


def _refuse_to_guess_channel(sheet: Sheet, columns: Sequence[Column]) -> None:
    """Raise an error if all columns are inputs of an instrument, any of which may be the height."""
    channels = [
        column
        for column in columns
        if column.is_channel or (not column.unit and CHANNEL.fullmatch(normalize_column_name(column.name)))
    ]
    if channels and len(channels) == len(columns):
        names = ", ".join(quote(column.name) for column in channels[:_MAX_SHOWN])
        raise RecordError(
            f"no column 'height', only channels: {names}; give the height's channel and unit, such as "
            f"{option_text_for_column(sheet, HEIGHT, channels[0])} --units height=mm"
        )


def _column_names_text(sheet: Sheet) -> str:
    names = [column.name.lower() for column in sheet.columns if column.name]
    numbers = _column_number_texts(sheet)[:_MAX_SHOWN]
    return ", ".join(map(quote, names[:_MAX_SHOWN])) or f"columns {', '.join(numbers)}, none with a name"
