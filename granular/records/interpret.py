"""Interpretation of the columns of a sheet: time, coordinate and further columns, in SI."""

from __future__ import annotations

import collections
import dataclasses
import shlex
from collections.abc import Mapping

import numpy as np

from granular.records.calibration import Calibration
from granular.records.headings import (
    ACCELERATION,
    ANGLE_UNITS,
    ANGLES,
    FORCE,
    HEIGHT,
    TIME,
    VELOCITY,
    CoordinateUnit,
    dimension_of,
    example_unit,
    is_logarithmic_unit,
    normalize_column_name,
    normalize_unit,
    role_unit_size_and_dimension,
    si_unit_of_role,
)
from granular.records.options import ANGLE, STROKE, ReadOptions
from granular.records.roles import (
    assign_roles_and_calibrations,
    choose_motion_role,
    is_row_number_column,
    is_unambiguous_column,
)
from granular.records.sheet import IN_MEMORY, Column, Sheet
from granular.schema.units import unit_size
from granular.shared.array_types import Float
from granular.shared.errors import RecordError, SceneError, quote, sanitize, unknown_word_message

_ROUNDED_FRACTION = 0.2
"""If more than this fraction of successive times are equal, the times are taken as rounded to clock ticks."""
_MAX_RADIANS = 7.0
"""Angle above which a column without a unit is taken as degrees: slightly more than 2 pi."""
_EPOCHS = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_YEAR_2000, _YEAR_2100 = 946684800.0, 4102444800.0
_ROW = " row"
"""Name of a temporary column with each sample's row in the file, used while dropping and sorting samples."""
_MIN_SAMPLES = 20
_LONG_STEP, _LONG_EXTENT, _LARGE_HEIGHT = 0.5, 1.0, 10.0
"""Time step [s], range [m] and largest height [m] above which a note reports that the unit is missing."""
_MAX_SHOWN = 20
_SHORTEST_STEP = 1e-12
_ABSURD = 1e6
"""Largest value for which a note on a missing unit is added; larger values cause an error later."""
_MIN_CORRELATION = 0.3
"""Minimum correlation of the velocity with the slope of the height, which even noisy columns exceed."""

Arrays = dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class SheetInterpretation:
    """Columns of a sheet in SI, with notes on guesses and changes."""

    columns: dict[str, np.ndarray]  # (n,) in SI, by role or name
    source: dict[str, str]  # name in the file of each role
    units: dict[str, str]  # unit of each role in the file
    coordinate_unit: CoordinateUnit
    form: str
    notes: tuple[str, ...]  # guesses and changes, with the options that override them
    omitted_columns: tuple[str, ...]  # columns with text or gaps
    deviations: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)  # (m, n), see `Calibration`
    prescribed: bool = False  # the height is a prescribed stroke; the force is measured


def interpret_sheet(sheet: Sheet, options: ReadOptions) -> SheetInterpretation:
    """Interpret the columns of a sheet: their roles, their units, and their values in SI."""
    notes = list(sheet.notes)
    chosen, calibrations = assign_roles_and_calibrations(sheet, options, notes)
    _check_duplicate_names(sheet, chosen, options)
    units = _units_by_role(sheet, chosen, options)
    raw = {role: require_numeric_values(sheet, role, column) for role, column in chosen.items()}
    motion = choose_motion_role(chosen)
    coordinate_unit: CoordinateUnit = "m"
    if HEIGHT not in calibrations and motion == HEIGHT:
        angle_requested = ANGLE in options.columns
        coordinate_unit = _choose_coordinate_unit(chosen[HEIGHT], raw[HEIGHT], units, notes, angle_requested)
    elif HEIGHT in calibrations:
        coordinate_unit = "rad" if calibrations[HEIGHT].unit == "rad" else "m"
    elif dimension_of(units.get(motion), motion) == unit_size(si_unit_of_role(motion, "rad"))[1]:
        coordinate_unit = "rad"
    converted: Arrays = {}
    deviations: Arrays = {}
    for role, numbers in raw.items():
        if role in calibrations:
            converted[role], deviations[role] = _calibrated_values_and_deviations(
                role, numbers, units, calibrations[role], notes
            )
        elif role == HEIGHT and units.get(role) == "1" and "1" in options.units.values():
            converted[role] = numbers
            notes.append(
                "the height has no unit, so lengths printed as m are in the unknown unit of the file; "
                "frequency and damping ratio do not depend on the unit"
            )
        else:
            converted[role] = numbers * _unit_size_in_role(role, units.get(role), coordinate_unit)
    _convert_epoch_times(converted, chosen[TIME], notes)
    _note_large_values_without_unit(sheet, converted, chosen, units, notes)
    _note_velocity_unlike_slope(converted, notes)
    _note_stroke_taken_as_free(chosen, options, notes)
    if options.flip:
        motion_roles = (HEIGHT, VELOCITY, ACCELERATION)
        converted |= {role: -converted[role] for role in motion_roles if role in converted}
    others, omitted_columns = _remaining_and_omitted_columns(sheet, chosen)
    columns = converted | {_ROW: np.arange(len(converted[TIME]))} | others
    columns = _drop_samples_then_columns_with_gaps(sheet, columns, chosen, notes, omitted_columns, motion)
    if options.sort:
        order = np.argsort(columns[TIME], kind="stable")
        columns = {name: numbers[order] for name, numbers in columns.items()}
    columns[TIME] = spread_rounded_times(columns[TIME], notes)
    doubles = np.flatnonzero(np.diff(columns[TIME]) == 0.0)
    if len(doubles) and not options.sort:
        raise RecordError(_repeated_times_text(sheet, columns, doubles))
    if len(doubles):
        columns = _average_samples_at_equal_times(columns)
        notes.append(
            f"samples at equal times are replaced by their mean, which removes {len(doubles)} samples"
        )
    if options.between is not None:
        start, stop = options.between
        inside = (columns[TIME] >= start) & (columns[TIME] <= stop)
        columns = {name: numbers[inside] for name, numbers in columns.items()}
    rows = columns.pop(_ROW)
    return SheetInterpretation(
        columns,
        {role: column.name for role, column in chosen.items()},
        {role: units.get(role) or si_unit_of_role(role) for role in chosen},
        coordinate_unit,
        sheet.form,
        tuple(notes),
        tuple(omitted_columns),
        {role: values[:, rows] for role, values in deviations.items() if role in columns and len(values)},
        STROKE in options.columns,
    )


def _calibrated_values_and_deviations(
    role: str, numbers: np.ndarray, units: dict[str, str], calibration: Calibration, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Return a sensor's calibrated values (n,), and their deviations (m, n) as from `Calibration.apply`."""
    unit = units.get(role)
    units[role] = unit or calibration.raw_unit or "1"
    known = numbers[np.isfinite(numbers)]
    low, high = calibration.raw_range
    if len(known) and (known.min() < low or known.max() > high):
        notes.append(
            f"{role} ranges from {known.min():.4g} to {known.max():.4g} {units[role]}, beyond the "
            f"calibration points ({low:.4g} to {high:.4g})"
        )
    return calibration.apply(numbers, unit)


def _check_duplicate_names(sheet: Sheet, chosen: Mapping[str, Column], options: ReadOptions) -> None:
    """Raise an error if a chosen column shares its name with others and was not chosen by number."""
    names = [column.name.lower() for column in sheet.columns]
    for role, column in chosen.items():
        name = column.name.lower()
        numbers = [str(k) for k, item in enumerate(names, start=1) if item == name]
        alias = next((word for word in (ANGLE, STROKE) if role == HEIGHT and word in options.columns), role)
        if (
            name
            and len(numbers) > 1
            and not is_unambiguous_column(sheet, str(options.columns.get(alias, "")))
        ):
            listed = f"{', '.join(numbers[:-1])} and {numbers[-1]}"
            choices = " or ".join(f"--columns {alias}={number}" for number in numbers[:_MAX_SHOWN])
            raise RecordError(
                f"the name {quote(name)} occurs twice, in columns {listed}; give a column number: {choices}"
            )


# Units -----------------------------------------------------------------------------------------


def _units_by_role(sheet: Sheet, chosen: Mapping[str, Column], options: ReadOptions) -> dict[str, str]:
    """Return the unit of each role: as given by the user, or else by the file."""
    requested = {name.strip().lower(): unit for name, unit in options.units.items()}
    known = {*(column.name.lower() for column in sheet.columns if column.name), *chosen}
    for alias in {ANGLE, STROKE} & {*requested} - known:
        requested[HEIGHT] = requested.pop(alias)
    for name in requested:
        if name not in known and not any(column.has_name(name) for column in sheet.columns):
            raise RecordError(unknown_word_message(name, sorted(known), "column"))
    result = {}
    for role, column in chosen.items():
        by_name = next((requested[name] for name in requested if column.has_name(name)), column.unit)
        unit = "s" if column.timestamp_kind and role == TIME else requested.get(role, by_name)
        if unit is not None:
            result[role] = normalize_unit(unit)
    return result


def _choose_coordinate_unit(
    column: Column, values: np.ndarray, units: dict[str, str], notes: list[str], angle_requested: bool
) -> CoordinateUnit:
    """Return the coordinate's unit; without one, the largest angle decides between rad and deg."""
    unit = units.get(HEIGHT)
    if unit in ANGLE_UNITS:
        return "rad"
    if angle_requested and unit is not None:
        raise RecordError(
            f"the angle {quote(column.name)} has the unit {quote(unit)}, which is not a unit of angle; give "
            "deg or rad (--units angle=deg), or the sensor's scale (--scale '360 deg/2048 counts')"
        )
    if unit is not None or not (angle_requested or normalize_column_name(column.name) in ANGLES):
        return "m"
    largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    units[HEIGHT], other = ("deg", "rad") if largest > _MAX_RADIANS else ("rad", "deg")
    notes.append(
        f"{quote(column.name)} reaches {largest:.3g}, so it is taken as an angle in {units[HEIGHT]} "
        f"(for {other}: --units height={other}; for a height: --units height=m)"
    )
    return "rad"


def _unit_size_in_role(role: str, unit: str | None, coordinate_unit: CoordinateUnit) -> float:
    """Return the size in SI of a role's unit; 1 for an unknown unit of an input."""
    if unit is None:
        return 1.0
    si_unit = si_unit_of_role(role, coordinate_unit)
    example = example_unit(role)
    scale = f"2.5 {example}/{sanitize(unit, 12)}"
    remedy = (
        f"give the right unit (--units {role}={example}); for a sensor, give its scale (--scale "
        f"{shlex.quote(scale if role == HEIGHT else f'{role}={scale}')})"
    )
    try:
        size, dimension = role_unit_size_and_dimension(role, unit)
    except SceneError as error:
        if not si_unit:
            return 1.0
        if is_logarithmic_unit(unit):
            raise RecordError(
                f"{role} is in {quote(unit)}, a logarithmic level: write the amplitude, 10^(level/20), to "
                f"the file instead, or give another column (--columns {role}=NAME)"
            ) from None
        raise RecordError(f"{role}: {error}; if {quote(unit)} is not the unit, {remedy}") from None
    if si_unit and dimension[3] != 0:
        plain = f", or use plain numbers (--units {role}=1)" if role == HEIGHT else ""
        raise RecordError(
            f"{role} has the unit {quote(unit)} of a sensor's output; if this unit is wrong, {remedy}{plain}"
        )
    if si_unit and dimension != unit_size(si_unit)[1]:
        raise RecordError(
            f"{role}: the unit {quote(unit)} does not fit; a unit like {si_unit} is needed: give "
            f"another column (--columns {role}=NAME) or the right unit (--units {role}={example})"
        )
    return size


def _convert_epoch_times(converted: Arrays, column: Column, notes: list[str]) -> None:
    """Convert times since 1970, which are recognized by their size, to seconds since the first sample."""
    if column.timestamp_kind or column.unit is not None:
        return
    known = converted[TIME][np.isfinite(converted[TIME])]
    first = float(known[0]) if len(known) else 0.0
    for name, size in _EPOCHS.items():
        if _YEAR_2000 / size <= first <= _YEAR_2100 / size:
            converted[TIME] = (converted[TIME] - first) * size
            notes.append(
                f"times are {name} since 1970 and are shifted to begin at 0 s (to keep them: --units time=s)"
            )
            return


# Notes -------------------------------------------------------------------------------------------


def _note_large_values_without_unit(
    sheet: Sheet, converted: Arrays, chosen: Mapping[str, Column], units: Mapping[str, str], notes: list[str]
) -> None:
    """Add a note if numbers without a unit, taken as SI, are large for a laboratory record."""
    if HEIGHT not in converted:
        return
    if sheet.form in IN_MEMORY and (chosen[TIME].name, chosen[HEIGHT].name) == (TIME, HEIGHT):
        return  # these names imply the units of a record
    times, heights = (converted[role][np.isfinite(converted[role])] for role in (TIME, HEIGHT))
    if min(len(times), len(heights)) < _MIN_SAMPLES:
        return
    if TIME not in units and not chosen[TIME].timestamp_kind and chosen[TIME].name:
        usual = float(np.median(np.abs(np.diff(times))))
        if _LONG_STEP <= usual <= _ABSURD:
            notes.append(
                f"{quote(chosen[TIME].name)} has no unit and is taken as s, one sample per "
                f"{usual:.3g} s (for ms: --units time=ms)"
            )
    if HEIGHT not in units and chosen[HEIGHT].name:
        extent, largest = float(np.ptp(heights)), float(np.abs(heights).max())
        if extent <= _ABSURD and (extent >= _LONG_EXTENT or largest >= _LARGE_HEIGHT):
            notes.append(
                f"{quote(chosen[HEIGHT].name)} has no unit and is taken as m: its range is {extent:.3g} m, "
                f"its maximum {largest:.3g} m (for mm: --units height=mm)"
            )


def _note_velocity_unlike_slope(converted: Arrays, notes: list[str]) -> None:
    """Add a note if the velocity does not correlate with the slope of the height."""
    if VELOCITY not in converted or HEIGHT not in converted:
        return
    columns = np.array([converted[TIME], converted[HEIGHT], converted[VELOCITY]])
    time, height, velocity = columns[:, np.isfinite(columns).all(axis=0)]
    if len(time) < _MIN_SAMPLES or not (np.diff(time) > 0.0).all():
        return
    # there is no slope if time steps are below the resolution of a float, or heights near its maximum
    with np.errstate(all="ignore"):
        slope = np.gradient(height, time)
        if not np.isfinite(slope).all() or not 0.0 < float(slope.std()) * float(velocity.std()) < np.inf:
            return
        agreement = float(np.corrcoef(slope, velocity)[0, 1])
    if agreement < _MIN_CORRELATION:
        notes.append(
            f"the velocity does not follow the slope of the height (correlation {agreement:.2f}): "
            "if the columns are misnamed, give the right ones (--columns height=NAME,velocity=NAME)"
        )


def _note_stroke_taken_as_free(chosen: Mapping[str, Column], options: ReadOptions, notes: list[str]) -> None:
    """Add a note if a column named stroke is taken as a free motion although a force was recorded."""
    if not {HEIGHT, FORCE} <= {*chosen} or not {HEIGHT, STROKE, ANGLE}.isdisjoint(options.columns):
        return
    stroke, force = (chosen[role].name for role in (HEIGHT, FORCE))
    if normalize_column_name(stroke) == STROKE:
        pairs = shlex.quote(f"stroke={stroke},force={force}")
        notes.append(
            f"the column {quote(stroke)} is taken as a free motion; if it is prescribed, give "
            f"columns={{'stroke': {quote(stroke)}, 'force': {quote(force)}}} (--columns {pairs})"
        )


# Values ----------------------------------------------------------------------------------------


def require_numeric_values(sheet: Sheet, role: str, column: Column) -> Float[np.ndarray, "n"]:
    """Return the numbers of a column; raise an error for text and infinite values."""
    if column.values is None:
        if column.first_invalid is None:
            raise RecordError(f"the column of {role} holds no numbers; write numbers to it")
        row, cell = column.first_invalid
        raise RecordError(
            f"{role} of {sheet.describe_row(row)} is {quote(cell)}, not a number; correct or remove it"
        )
    infinite = np.isinf(column.values)
    if infinite.any():
        row = int(np.argmax(infinite))
        raise RecordError(
            f"{role} of {sheet.describe_row(row)} is {column.values[row]:g}; values must be "
            "finite: drop such samples"
        )
    return column.values


def _remaining_and_omitted_columns(sheet: Sheet, chosen: Mapping[str, Column]) -> tuple[Arrays, list[str]]:
    """Return a dict of the numeric columns without a role, and the names of the non-numeric columns."""
    counts = collections.Counter([*(column.name.lower() for column in sheet.columns), *chosen])
    others: Arrays = {}
    omitted_columns = []
    for number, column in enumerate(sheet.columns, start=1):
        name = column.name.lower()
        if not name or column in chosen.values() or is_row_number_column(sheet, column):
            continue
        if column.values is None:
            omitted_columns.append(column.name)
        else:
            others[name if counts[name] == 1 else f"{name} ({number})"] = column.values
    return others, omitted_columns


def _drop_samples_then_columns_with_gaps(
    sheet: Sheet,
    columns: Arrays,
    chosen: Mapping[str, Column],
    notes: list[str],
    omitted_columns: list[str],
    motion: str,
) -> Arrays:
    """Drop samples without a time or a coordinate, and then columns that still have gaps."""
    complete = np.isfinite(columns[TIME]) & np.isfinite(columns[motion])
    dropped = int((~complete).sum())
    if dropped:
        first = sheet.describe_row(int(np.argmin(complete)))
        and_others = " and others" if dropped > 1 else ""
        notes.append(
            f"{dropped} of {len(complete)} samples have no time or {motion} and are dropped: "
            f"{first}{and_others}"
        )
        columns = {name: values[complete] for name, values in columns.items()}
    gaps = [name for name, values in columns.items() if not np.isfinite(values).all()]
    omitted_columns += gaps
    notes += [f"{name} has gaps and is omitted" for name in gaps if name in chosen]
    return {name: values for name, values in columns.items() if name not in gaps}


def _repeated_times_text(sheet: Sheet, columns: Arrays, doubles: np.ndarray) -> str:
    """Write the error text for repeated times, with a remedy for each cause."""
    time, first = columns[TIME], int(doubles[0]) + 1
    # the slope is fitted to all times, since the first and the last may be late by a whole block of samples
    rate = 1.0 / max(float(np.polyfit(np.arange(len(time)), time - time[0], 1)[0]), _SHORTEST_STEP)
    return (
        f"time of {sheet.describe_row(int(columns[_ROW][first]))}, {time[first]:g} s, occurs twice, as do "
        f"{len(doubles) - 1} others: if the samples are equally spaced but the clock is too coarse, give the "
        f"sampling rate (--rate '{rate:.5g} Hz'); otherwise average samples at equal times (--sort)"
    )


def _average_samples_at_equal_times(columns: Arrays) -> Arrays:
    """Average samples at equal times; the average keeps the row number of its first sample."""
    firsts = np.flatnonzero(np.diff(columns[TIME], prepend=-np.inf) > 0.0)
    counts = np.diff(np.append(firsts, len(columns[TIME])))
    return {
        name: values[firsts] if name in (TIME, _ROW) else np.add.reduceat(values, firsts) / counts
        for name, values in columns.items()
    }


def spread_rounded_times(time: Float[np.ndarray, "n"], notes: list[str]) -> Float[np.ndarray, "n"]:
    """Distribute times [s] that are rounded to clock ticks evenly between the ticks."""
    repeated = np.diff(time) == 0.0
    if not repeated.any() or (np.diff(time) < 0.0).any() or repeated.mean() < _ROUNDED_FRACTION:
        return time
    firsts = np.flatnonzero(np.concatenate([[True], ~repeated]))
    ticks, counts = time[firsts], np.diff(firsts)
    if len(firsts) < 3:
        return time
    usual = np.median(np.diff(ticks))
    even = np.abs(np.diff(ticks) - usual) < 0.01 * usual
    if even.mean() <= 0.8 or counts.max() > 2 * np.median(counts) + 1:
        return time
    # No tick follows the last group of equal times; it is spread with the mean density of the others.
    rate = (firsts[-1] - firsts[0]) / (ticks[-1] - ticks[0])
    end = ticks[-1] + (len(time) - firsts[-1]) / rate
    notes.append(
        f"times are rounded to {usual:.3g} s: samples at equal times are spread evenly up to the next time"
    )
    return np.asarray(np.interp(np.arange(len(time), dtype=float), [*firsts, len(time)], [*ticks, end]))
