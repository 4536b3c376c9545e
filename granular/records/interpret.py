"""Interpretation of the columns of a sheet: a time, a coordinate, and what goes with it."""

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
    is_level,
    normalize_column_name,
    normalize_unit,
    role_unit_size,
    si_unit_of_role,
)
from granular.records.options import ANGLE, STROKE, ReadOptions
from granular.records.roles import assign_roles, is_alone, is_index, motion_role
from granular.records.sheet import IN_MEMORY, Column, Sheet
from granular.schema.units import unit_size
from granular.shared.array_types import Float
from granular.shared.errors import RecordError, SceneError, quote, sanitize, unknown_word_message

_TICK = 0.2
"""Fraction of equal neighbours from which on times are taken for rounded to a clock's tick."""
_TURN = 7.0
"""Angle beyond which a column without a unit is in degrees: a little more than 2 pi."""
_EPOCHS = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_YEAR_2000, _YEAR_2100 = 946684800.0, 4102444800.0
_ROW = " row"
"""Column of a sample's row in the file while samples are left out and sorted; no file has it."""
_LEAST_SAMPLES = 20
_LONG_STEP, _LONG_WAY, _HIGH = 0.5, 1.0, 10.0
"""Step [s], extent and height [m] from which on numbers without a unit are noted."""
_MOST_SHOWN = 20
_SHORTEST_STEP = 1e-12
_ABSURD = 1e6
"""Value from which on an error says more."""
_AGREEMENT = 0.3
"""Correlation of a velocity with the height's slope; noise on both leaves more than that."""

Arrays = dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class SheetInterpretation:
    """Columns in SI, and how they came about."""

    columns: dict[str, np.ndarray]  # (n,) in SI, by roles or names
    source: dict[str, str]  # name in the file of each role
    units: dict[str, str]  # unit that each role was read in
    coordinate_unit: CoordinateUnit
    form: str
    notes: tuple[str, ...]  # what was guessed or done, and how to say it otherwise
    left_out: tuple[str, ...]  # columns that are not numbers everywhere
    deviations: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)  # (m, n), see `Calibration`
    prescribed: bool = False  # a stroke, along which a force was measured


def interpret_sheet(sheet: Sheet, options: ReadOptions) -> SheetInterpretation:
    """Interpret the columns of a sheet: their roles, their units, and their values in SI."""
    notes = list(sheet.notes)
    chosen, calibrations = assign_roles(sheet, options, notes)
    _check_duplicate_names(sheet, chosen, options)
    units = _units_by_role(sheet, chosen, options)
    raw = {role: require_numeric_values(sheet, role, column) for role, column in chosen.items()}
    motion = motion_role(chosen)
    coordinate_unit: CoordinateUnit = "m"
    if HEIGHT not in calibrations and motion == HEIGHT:
        said = ANGLE in options.columns
        coordinate_unit = _unit_of_coordinate(chosen[HEIGHT], raw[HEIGHT], units, notes, said)
    elif HEIGHT in calibrations:
        coordinate_unit = "rad" if calibrations[HEIGHT].unit == "rad" else "m"
    elif dimension_of(units.get(motion), motion) == unit_size(si_unit_of_role(motion, "rad"))[1]:
        coordinate_unit = "rad"
    own: Arrays = {}
    deviations: Arrays = {}
    for role, numbers in raw.items():
        if role in calibrations:
            own[role], deviations[role] = _calibrated(role, numbers, units, calibrations[role], notes)
        elif role == HEIGHT and units.get(role) == "1" and "1" in options.units.values():
            own[role] = numbers
            notes.append(
                "the height is a pure number: what is called m is its own unit; a frequency and a "
                "damping ratio need no other"
            )
        else:
            own[role] = numbers * _unit_size_in_role(role, units.get(role), coordinate_unit)
    _convert_epoch_times(own, chosen[TIME], notes)
    _note_large_values_without_unit(sheet, own, chosen, units, notes)
    _note_velocity_unlike_slope(own, notes)
    _note_stroke_taken_as_free(chosen, options, notes)
    if options.flip:
        own |= {role: -own[role] for role in (HEIGHT, VELOCITY, ACCELERATION) if role in own}
    others, left_out = _remaining_columns(sheet, chosen)
    every = own | {_ROW: np.arange(len(own[TIME]))} | others
    every = _without_incomplete_samples(sheet, every, chosen, notes, left_out, motion)
    if options.sort:
        order = np.argsort(every[TIME], kind="stable")
        every = {name: numbers[order] for name, numbers in every.items()}
    every[TIME] = spread_rounded_times(every[TIME], notes)
    doubles = np.flatnonzero(np.diff(every[TIME]) == 0.0)
    if len(doubles) and not options.sort:
        raise RecordError(_doubled_times_text(sheet, every, doubles))
    if len(doubles):
        every = _mean_of_equal_times(every)
        notes.append(f"samples of equal times are replaced by their mean: {len(doubles)} are fewer")
    if options.between is not None:
        start, stop = options.between
        inside = (every[TIME] >= start) & (every[TIME] <= stop)
        every = {name: numbers[inside] for name, numbers in every.items()}
    rows = every.pop(_ROW)
    return SheetInterpretation(
        every,
        {role: column.name for role, column in chosen.items()},
        {role: units.get(role) or si_unit_of_role(role) for role in chosen},
        coordinate_unit,
        sheet.form,
        tuple(notes),
        tuple(left_out),
        {role: left[:, rows] for role, left in deviations.items() if role in every and len(left)},
        STROKE in options.columns,
    )


def _calibrated(
    role: str, numbers: np.ndarray, units: dict[str, str], calibration: Calibration, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Values (n,) of a sensor's numbers, and their deviations (m, n)."""
    unit = units.get(role)
    units[role] = unit or calibration.raw_unit or "1"
    known = numbers[np.isfinite(numbers)]
    low, high = calibration.inside
    if len(known) and (known.min() < low or known.max() > high):
        notes.append(
            f"{role} goes from {known.min():.4g} to {known.max():.4g} {units[role]}, beyond the "
            f"calibration's points ({low:.4g} to {high:.4g})"
        )
    return calibration.apply(numbers, unit)


def _check_duplicate_names(sheet: Sheet, chosen: Mapping[str, Column], options: ReadOptions) -> None:
    """Refuse to choose between columns of one name, unless the user says a number."""
    names = [column.name.lower() for column in sheet.columns]
    for role, column in chosen.items():
        name = column.name.lower()
        numbers = [str(k) for k, item in enumerate(names, start=1) if item == name]
        alias = next((word for word in (ANGLE, STROKE) if role == HEIGHT and word in options.columns), role)
        if name and len(numbers) > 1 and not is_alone(sheet, str(options.columns.get(alias, ""))):
            listed = f"{', '.join(numbers[:-1])} and {numbers[-1]}"
            choices = " or ".join(f"--columns {alias}={number}" for number in numbers[:_MOST_SHOWN])
            raise RecordError(
                f"the column {quote(name)} is there twice, in columns {listed}; say which it is: {choices}"
            )


# Units -----------------------------------------------------------------------------------------


def _units_by_role(sheet: Sheet, chosen: Mapping[str, Column], options: ReadOptions) -> dict[str, str]:
    """Return the unit of each role: as the user says, else as in the file."""
    said = {name.strip().lower(): unit for name, unit in options.units.items()}
    known = {*(column.name.lower() for column in sheet.columns if column.name), *chosen}
    for alias in {ANGLE, STROKE} & {*said} - known:
        said[HEIGHT] = said.pop(alias)
    for name in said:
        if name not in known and not any(column.is_called(name) for column in sheet.columns):
            raise RecordError(unknown_word_message(name, sorted(known), "column"))
    result = {}
    for role, column in chosen.items():
        by_name = next((said[name] for name in said if column.is_called(name)), column.unit)
        unit = "s" if column.clock and role == TIME else said.get(role, by_name)
        if unit is not None:
            result[role] = normalize_unit(unit)
    return result


def _unit_of_coordinate(
    column: Column, values: np.ndarray, units: dict[str, str], notes: list[str], said: bool
) -> CoordinateUnit:
    """Tell an angle by its unit; one by its name alone is taken for radians or degrees."""
    unit = units.get(HEIGHT)
    if unit in ANGLE_UNITS:
        return "rad"
    if said and unit is not None:
        raise RecordError(
            f"the angle {quote(column.name)} has the unit {quote(unit)}; give deg or rad "
            "(--units angle=deg), or its scale (--scale '360 deg/2048 counts')"
        )
    if unit is not None or not (said or normalize_column_name(column.name) in ANGLES):
        return "m"
    known = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    units[HEIGHT], other = ("deg", "rad") if known > _TURN else ("rad", "deg")
    notes.append(
        f"{quote(column.name)} goes to {known:.3g}, so it is taken for an angle in {units[HEIGHT]} "
        f"(--units height={other}, or --units height=m for a height)"
    )
    return "rad"


def _unit_size_in_role(role: str, unit: str | None, coordinate_unit: CoordinateUnit) -> float:
    """SI size of a unit in a role; that of an input's is 1 where it is unknown."""
    if unit is None:
        return 1.0
    wanted = si_unit_of_role(role, coordinate_unit)
    example = example_unit(role)
    scale = f"2.5 {example}/{sanitize(unit, 12)}"
    of_sensor = (
        f"say so (--units {role}={example}); of a sensor, give the scale (--scale "
        f"{shlex.quote(scale if role == HEIGHT else f'{role}={scale}')})"
    )
    try:
        size, dimension = role_unit_size(role, unit)
    except SceneError as error:
        if not wanted:
            return 1.0
        if is_level(unit):
            raise RecordError(
                f"{role} is in {quote(unit)}, a logarithmic level: write its amplitude, 10^(level/20), in "
                f"the file, or name another column (--columns {role}=NAME)"
            ) from None
        raise RecordError(
            f"{role}: {error}; if {quote(unit)} is no unit, or another is meant, {of_sensor}"
        ) from None
    if wanted and dimension[3] != 0:
        plain = f", or take plain numbers (--units {role}=1)" if role == HEIGHT else ""
        raise RecordError(f"{role} has the unit {quote(unit)}; if it is another, {of_sensor}{plain}")
    if wanted and dimension != unit_size(wanted)[1]:
        raise RecordError(
            f"{role}: the unit {quote(unit)} does not fit; one of {wanted} is wanted: name "
            f"another column (--columns {role}=NAME) or its unit (--units {role}={example})"
        )
    return size


def _convert_epoch_times(own: Arrays, column: Column, notes: list[str]) -> None:
    """Turn times since 1970, told by their size, into seconds since the first sample."""
    if column.clock or column.unit is not None:
        return
    known = own[TIME][np.isfinite(own[TIME])]
    first = float(known[0]) if len(known) else 0.0
    for name, size in _EPOCHS.items():
        if _YEAR_2000 / size <= first <= _YEAR_2100 / size:
            own[TIME] = (own[TIME] - first) * size
            notes.append(f"times are {name} since 1970; they begin at 0 s here (--units time=s)")
            return


# Notes -------------------------------------------------------------------------------------------


def _note_large_values_without_unit(
    sheet: Sheet, own: Arrays, chosen: Mapping[str, Column], units: Mapping[str, str], notes: list[str]
) -> None:
    """Note numbers without a unit that are large for those of a laboratory in SI."""
    if HEIGHT not in own:
        return
    if sheet.form in IN_MEMORY and (chosen[TIME].name, chosen[HEIGHT].name) == (TIME, HEIGHT):
        return  # who names the columns of a table as a record does means its units
    times, heights = (own[role][np.isfinite(own[role])] for role in (TIME, HEIGHT))
    if min(len(times), len(heights)) < _LEAST_SAMPLES:
        return
    if TIME not in units and not chosen[TIME].clock and chosen[TIME].name:
        usual = float(np.median(np.abs(np.diff(times))))
        if _LONG_STEP <= usual <= _ABSURD:
            notes.append(
                f"{quote(chosen[TIME].name)} has no unit and is taken for s, a sample each "
                f"{usual:.3g} s (--units time=ms)"
            )
    if HEIGHT not in units and chosen[HEIGHT].name:
        extent, largest = float(np.ptp(heights)), float(np.abs(heights).max())
        if extent <= _ABSURD and (extent >= _LONG_WAY or largest >= _HIGH):
            notes.append(
                f"{quote(chosen[HEIGHT].name)} has no unit and is taken for m, over {extent:.3g} m "
                f"up to {largest:.3g} m (--units height=mm)"
            )


def _note_velocity_unlike_slope(own: Arrays, notes: list[str]) -> None:
    """Note a velocity that is not the slope of the height."""
    if VELOCITY not in own or HEIGHT not in own:
        return
    columns = np.array([own[TIME], own[HEIGHT], own[VELOCITY]])
    time, height, velocity = columns[:, np.isfinite(columns).all(axis=0)]
    if len(time) < _LEAST_SAMPLES or not (np.diff(time) > 0.0).all():
        return
    # times that differ by less than a float resolves, and heights near its end, have no slope
    with np.errstate(all="ignore"):
        slope = np.gradient(height, time)
        if not np.isfinite(slope).all() or not 0.0 < float(slope.std()) * float(velocity.std()) < np.inf:
            return
        agreement = float(np.corrcoef(slope, velocity)[0, 1])
    if agreement < _AGREEMENT:
        notes.append(
            f"the velocity does not follow the slope of the height (correlation {agreement:.2f}): "
            "if these are not what they are called, say so (--columns height=NAME,velocity=NAME)"
        )


def _note_stroke_taken_as_free(chosen: Mapping[str, Column], options: ReadOptions, notes: list[str]) -> None:
    """Note a column that is called a stroke, next to a force, and was not said to be prescribed."""
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
    """Return the numbers of a column, and refuse one that holds anything else."""
    if column.values is None:
        if column.wrong is None:
            raise RecordError(f"{role} holds no numbers; write it as numbers")
        row, cell = column.wrong
        raise RecordError(
            f"{role} of {sheet.describe_row(row)} is {quote(cell)}, not a number; correct or drop it"
        )
    infinite = np.isinf(column.values)
    if infinite.any():
        row = int(np.argmax(infinite))
        raise RecordError(
            f"{role} of {sheet.describe_row(row)} is {column.values[row]:g}; values must be "
            "finite: drop such samples"
        )
    return column.values


def _remaining_columns(sheet: Sheet, chosen: Mapping[str, Column]) -> tuple[Arrays, list[str]]:
    """Further columns of numbers by their names, and the names of those that are left out."""
    counts = collections.Counter([*(column.name.lower() for column in sheet.columns), *chosen])
    others: Arrays = {}
    left_out = []
    for number, column in enumerate(sheet.columns, start=1):
        name = column.name.lower()
        if not name or column in chosen.values() or is_index(sheet, column):
            continue
        if column.values is None:
            left_out.append(column.name)
        else:
            others[name if counts[name] == 1 else f"{name} ({number})"] = column.values
    return others, left_out


def _without_incomplete_samples(
    sheet: Sheet,
    columns: Arrays,
    chosen: Mapping[str, Column],
    notes: list[str],
    left_out: list[str],
    motion: str,
) -> Arrays:
    """Drop samples without time or motion, and then other columns that have gaps."""
    here = np.isfinite(columns[TIME]) & np.isfinite(columns[motion])
    lost = int((~here).sum())
    if lost:
        first = sheet.describe_row(int(np.argmin(here)))
        others_too = " and others" if lost > 1 else ""
        notes.append(
            f"{lost} of {len(here)} samples have no time or {motion} and are left out: {first}{others_too}"
        )
        columns = {name: values[here] for name, values in columns.items()}
    gaps = [name for name, values in columns.items() if not np.isfinite(values).all()]
    left_out += gaps
    notes += [f"{name} has gaps and is left out" for name in gaps if name in chosen]
    return {name: values for name, values in columns.items() if name not in gaps}


def _doubled_times_text(sheet: Sheet, columns: Arrays, doubles: np.ndarray) -> str:
    """Return the words of an error where times are there twice, with a remedy for each cause."""
    time, first = columns[TIME], int(doubles[0]) + 1
    # by all times, as the first and the last may be late by a whole block of samples
    rate = 1.0 / max(float(np.polyfit(np.arange(len(time)), time - time[0], 1)[0]), _SHORTEST_STEP)
    return (
        f"time of {sheet.describe_row(int(columns[_ROW][first]))}, {time[first]:g} s, is there twice, and "
        f"{len(doubles) - 1} others are: if the clock is coarser than even samples, give their rate (--rate "
        f"'{rate:.5g} Hz'); else take the mean of samples of one time (--sort)"
    )


def _mean_of_equal_times(columns: Arrays) -> Arrays:
    """Columns with one row for each time, their mean there; the row in the file is the first one's."""
    firsts = np.flatnonzero(np.diff(columns[TIME], prepend=-np.inf) > 0.0)
    counts = np.diff(np.append(firsts, len(columns[TIME])))
    return {
        name: values[firsts] if name in (TIME, _ROW) else np.add.reduceat(values, firsts) / counts
        for name, values in columns.items()
    }


def spread_rounded_times(time: Float[np.ndarray, "n"], notes: list[str]) -> Float[np.ndarray, "n"]:
    """Spread times that a clock has rounded to its tick evenly between its ticks [s]; time [s]."""
    same = np.diff(time) == 0.0
    if not same.any() or (np.diff(time) < 0.0).any() or same.mean() < _TICK:
        return time
    firsts = np.flatnonzero(np.concatenate([[True], ~same]))
    ticks, counts = time[firsts], np.diff(firsts)
    if len(firsts) < 3:
        return time
    usual = np.median(np.diff(ticks))
    even = np.abs(np.diff(ticks) - usual) < 0.01 * usual
    if even.mean() <= 0.8 or counts.max() > 2 * np.median(counts) + 1:
        return time
    # The last run has no tick behind it: it is as dense as the others.
    rate = (firsts[-1] - firsts[0]) / (ticks[-1] - ticks[0])
    end = ticks[-1] + (len(time) - firsts[-1]) / rate
    notes.append(f"times are rounded to {usual:.3g} s: samples of one tick are spread evenly up to the next")
    return np.asarray(np.interp(np.arange(len(time), dtype=float), [*firsts, len(time)], [*ticks, end]))
