"""What the columns of a sheet are taken for: a time, a coordinate, and what goes with it."""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from granular.readers.names import (
    ACCELERATION,
    FORCE,
    HEIGHT,
    SYNONYMS,
    TIME,
    VELOCITY,
    bare,
    plain_unit,
    role_of,
)
from granular.readers.reading import OWN, Reading
from granular.readers.sheet import Column, Sheet
from granular.scene.schema import unknown
from granular.scene.units import unit_size
from granular.shared.errors import RecordError, SceneError
from granular.shared.messages import quoted

SI = {TIME: "s", HEIGHT: "m", VELOCITY: "m/s", FORCE: "N"}
"""Of the columns that have a meaning; of an angle rad and rad/s instead of m and m/s."""

TICK = 0.2
"""Share of equal neighbours from which on times are taken for rounded to a clock's tick."""

_MOST_SHOWN = 20


@dataclasses.dataclass(frozen=True)
class Meaning:
    """Columns in SI, and how they came about.

    Attributes
    ----------
    columns : dict of str to float64 (n,)
        ``time`` and ``height``, ``velocity`` and ``force`` where they are there, and the others.
    source : dict of str to str
        The name in the file of each column that has a meaning.
    units : dict of str to str
        The unit that each of them was read in.
    angle : bool
        Whether the coordinate is an angle [rad].
    form : str
        What the file is.
    notes : tuple of str
        What was guessed or done, and how to say it otherwise.
    left_out : tuple of str
        Columns that do not hold numbers everywhere.
    """

    columns: dict[str, np.ndarray]
    source: dict[str, str]
    units: dict[str, str]
    angle: bool
    form: str
    notes: tuple[str, ...]
    left_out: tuple[str, ...]


def meaning_of(sheet: Sheet, reading: Reading) -> Meaning:
    """What a sheet says, by what the user says of it and else by its names and units.

    Raises
    ------
    RecordError
        If there is no time or no coordinate, a unit does not fit, or a value is no number.
    """
    notes = list(sheet.notes)
    chosen = _chosen(sheet, reading, notes)
    _check_doubles(sheet, chosen, reading)
    units = _units(sheet, chosen, reading)
    angle = _is_angle(units.get(HEIGHT))
    values = {role: _checked(sheet, role, column) for role, column in chosen.items()}
    own = {role: numbers * _size(role, units.get(role), angle) for role, numbers in values.items()}
    if reading.flip:
        own |= {role: -own[role] for role in (HEIGHT, VELOCITY) if role in own}
    others, left_out = _others(sheet, chosen)
    own, others = _without_gaps(sheet, own, others, notes, left_out)
    own[TIME] = _spread(own[TIME], notes)
    every = own | others
    if reading.between is not None:
        start, stop = reading.between
        inside = (own[TIME] >= start) & (own[TIME] <= stop)
        every = {name: numbers[inside] for name, numbers in every.items()}
    return Meaning(
        every, {role: column.name for role, column in chosen.items()},
        {role: units.get(role) or SI[role] for role in chosen}, angle, sheet.form, tuple(notes),
        tuple(left_out),
    )  # fmt: skip


def _check_doubles(sheet: Sheet, chosen: Mapping[str, Column], reading: Reading) -> None:
    """Refuse to choose between columns of one name, unless the user says a number."""
    names = [column.name.lower() for column in sheet.columns]
    for role, column in chosen.items():
        name = column.name.lower()
        places = [k for k, one in enumerate(names, start=1) if one == name]
        if name and len(places) > 1 and not str(reading.columns.get(role, "")).isdigit():
            listed = ", ".join(map(str, places[:-1])) + f" and {places[-1]}"
            raise RecordError(
                f"the column {quoted(name)} is there twice, in columns {listed}; names "
                f"must differ, or say which it is (columns: {role}={places[-1]})"
            )


# Which column is what --------------------------------------------------------------------------


def _chosen(sheet: Sheet, reading: Reading, notes: list[str]) -> dict[str, Column]:
    chosen = {role: _said(sheet, column) for role, column in reading.columns.items()}
    _choose_by_name(sheet, chosen, notes)
    if TIME not in chosen:
        _choose_time(sheet, chosen, notes)
    if HEIGHT not in chosen:
        _choose_height(sheet, chosen, notes)
    return chosen


def _said(sheet: Sheet, wanted: str | int) -> Column:
    if isinstance(wanted, int) or wanted.isdigit():
        number = int(wanted)
        if not 1 <= number <= len(sheet.columns):
            raise RecordError(
                f"there is no column {number}; give a number from 1 to {len(sheet.columns)}"
            )
        return sheet.columns[number - 1]
    for column in sheet.columns:
        if column.name.lower() == wanted.strip().lower():
            return column
    raise RecordError(unknown(wanted, [one.name for one in sheet.columns if one.name], "column"))


def _choose_by_name(sheet: Sheet, chosen: dict[str, Column], notes: list[str]) -> None:
    taken = list(map(id, chosen.values()))
    called: dict[str, list[Column]] = {}
    for one in sheet.columns:
        if not one.channel:
            called.setdefault(bare(one.name), []).append(one)
    for role in (role for role in OWN if role not in chosen):
        found = [
            one for word in SYNONYMS[role] for one in called.get(word, []) if id(one) not in taken
        ]
        if role in (HEIGHT, VELOCITY):
            found = [one for one in found if one.name.lower() == role or _fits(one, role)]
        if not found:
            continue
        chosen[role] = found[0]
        taken.append(id(found[0]))
        if len(found) > 1 and found[0].name.lower() != role:
            others = ", ".join(quoted(one.name) for one in found[1:_MOST_SHOWN])
            notes.append(
                f"{role} is the column {quoted(found[0].name)}, not {others} (columns: {role}=...)"
            )


def _fits(column: Column, role: str) -> bool:
    """Whether a column's unit, if it has one, is one of the role's."""
    if column.unit is None:
        return True
    try:
        dimension = unit_size(plain_unit(column.unit))[1]
    except SceneError:
        return True  # said when it is used
    return dimension in (unit_size(SI[role])[1], unit_size("rad" if role == HEIGHT else "1/s")[1])


def _choose_time(sheet: Sheet, chosen: dict[str, Column], notes: list[str]) -> None:
    """Dates and times of day, else the first column that increases, where no name says more."""
    taken = list(map(id, chosen.values()))
    free = [one for one in sheet.columns if id(one) not in taken and one.values is not None]
    stamps = [one for one in free if one.clock]
    timed = [one for one in free if one.unit and _is_of(one.unit, "s") and _increases(one)]
    nameless = [one for one in free if not one.name and _increases(one)]
    found = (stamps or timed or nameless)[:1]
    if not found:
        raise RecordError(
            f"no column 'time'; found: {_names(sheet)}; name the columns in the first line, such "
            "as 'time [s], height [mm]', or say which is which (columns: time=NAME)"
        )
    chosen[TIME] = found[0]
    if not stamps and not timed:
        number = sheet.columns.index(found[0]) + 1
        notes.append(f"there are no names: time is column {number}, in s (columns: time=...)")


def _is_acceleration(column: Column) -> bool:
    if column.channel:
        return False
    if role_of(column.name) == ACCELERATION:
        return True
    return column.unit is not None and _is_of(column.unit, "m/s^2")


def _is_of(unit: str, wanted: str) -> bool:
    """Whether a unit has the dimension of another."""
    try:
        return unit_size(plain_unit(unit))[1] == unit_size(wanted)[1]
    except SceneError:
        return False


def _increases(column: Column) -> bool:
    assert column.values is not None
    known = column.values[np.isfinite(column.values)]
    return len(known) > 1 and bool((np.diff(known) >= 0.0).all()) and known[-1] > known[0]


def _choose_height(sheet: Sheet, chosen: dict[str, Column], notes: list[str]) -> None:
    """The only other column of numbers, or of those without names the next."""
    taken = list(map(id, chosen.values()))
    free = [
        one for one in sheet.columns
        if id(one) not in taken and one.values is not None and np.isfinite(one.values).any()
    ]  # fmt: skip
    _check_channels(free)
    lengths = [one for one in free if _fits(one, HEIGHT) and role_of(one.name) in (None, HEIGHT)]
    nameless = [one for one in lengths if not one.name]
    found = lengths if len(lengths) == 1 else nameless[:1]
    if not found:
        accelerations = [one for one in free if _is_acceleration(one)]
        if accelerations and not lengths:
            raise RecordError(
                f"no column 'height', only the acceleration {quoted(accelerations[0].name)}: twice "
                "integrated, its offset grows with the square of the time; record a position"
            )
        raise RecordError(
            f"no column 'height'; found: {_names(sheet)}; name the columns in the first line, such "
            "as 'time [s], height [mm]', or say which is which (columns: height=NAME)"
        )
    chosen[HEIGHT] = found[0]
    if found[0].name:
        notes.append(
            f"height is the column {quoted(found[0].name)}, the only other one of numbers "
            "(columns: height=..., and flip if it grows downwards)"
        )
    else:
        number = sheet.columns.index(found[0]) + 1
        notes.append(f"height is column {number}, in m (columns: height=..., units: height=mm)")


def _check_channels(columns: Sequence[Column]) -> None:
    """Refuse to guess which input of an instrument the height was connected to."""
    names = [one.name for one in columns if one.channel]
    if names and len(names) == len(columns):
        raise RecordError(
            f"no column 'height', only channels: {', '.join(map(quoted, names))}; say which it is "
            f"and its unit (columns: height={names[0]}, units: height=mm)"
        )


def _names(sheet: Sheet) -> str:
    names = [one.name.lower() for one in sheet.columns if one.name]
    return ", ".join(map(quoted, names[:_MOST_SHOWN])) or "none with a name"


# Units -----------------------------------------------------------------------------------------


def _units(sheet: Sheet, chosen: Mapping[str, Column], reading: Reading) -> dict[str, str]:
    """The unit of each role: as said, by its name or by that in the file, else as in the file."""
    said = {name.strip().lower(): unit for name, unit in reading.units.items()}
    known = {*(one.name.lower() for one in sheet.columns if one.name), *chosen}
    for name in said:
        if name not in known:
            raise RecordError(unknown(name, sorted(known), "column"))
    found = {}
    for role, column in chosen.items():
        unit = said.get(role, said.get(column.name.lower(), column.unit))
        if column.clock and role == TIME:
            unit = "s"
        if unit is not None:
            found[role] = plain_unit(unit)
    return found


def _is_angle(unit: str | None) -> bool:
    return unit is not None and unit in ("deg", "rad", "mrad")


def _size(role: str, unit: str | None, angle: bool) -> float:
    wanted = SI[role]
    if angle and role in (HEIGHT, VELOCITY):
        wanted = {HEIGHT: "rad", VELOCITY: "rad/s"}[role]
    if unit is None:
        return 1.0
    try:
        size, dimension = unit_size(unit)
    except SceneError as error:
        raise RecordError(
            f"{role}: {error}; if it is another, say so (units: {role}=...)"
        ) from None
    if dimension != unit_size(wanted)[1]:
        raise RecordError(
            f"{role}: the unit {quoted(unit)} does not fit; one of {wanted} is wanted: name "
            f"another column (columns: {role}=...) or its unit (units: {role}=...)"
        )
    return size


# Values ----------------------------------------------------------------------------------------


def _checked(sheet: Sheet, role: str, column: Column) -> np.ndarray:
    if column.values is None:
        if column.wrong is None:
            raise RecordError(f"{role} holds no numbers; write it as numbers")
        row, cell = column.wrong
        raise RecordError(
            f"{role} of {sheet.place(row)} is {quoted(cell)}, not a number; correct or drop it"
        )
    infinite = np.isinf(column.values)
    if infinite.any():
        row = int(np.argmax(infinite))
        raise RecordError(
            f"{role} of {sheet.place(row)} is {column.values[row]:g}; values must be finite: drop "
            "such samples"
        )
    return column.values


def _others(sheet: Sheet, chosen: Mapping[str, Column]) -> tuple[dict[str, np.ndarray], list[str]]:
    taken = list(map(id, chosen.values()))
    names = [one.name.lower() for one in sheet.columns]
    counts = collections.Counter(names)
    others: dict[str, np.ndarray] = {}
    left_out = []
    for number, (name, column) in enumerate(zip(names, sheet.columns, strict=True), start=1):
        if not name or id(column) in taken:
            continue
        if column.values is None:
            left_out.append(column.name)
        else:
            others[name if counts[name] == 1 else f"{name} ({number})"] = column.values
    return others, left_out


def _without_gaps(
    sheet: Sheet,
    own: dict[str, np.ndarray],
    others: dict[str, np.ndarray],
    notes: list[str],
    left_out: list[str],
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Samples without time or height go; other columns with gaps in what is left go whole."""
    here = np.isfinite(own[TIME]) & np.isfinite(own[HEIGHT])
    lost = int((~here).sum())
    if lost:
        first = sheet.place(int(np.argmin(here)))
        others_too = " and others" if lost > 1 else ""
        notes.append(
            f"{lost} of {len(here)} samples have no time or height and are left out: {first}"
            f"{others_too}"
        )
    kept: dict[str, dict[str, np.ndarray]] = {"own": {}, "others": {}}
    for kind, columns in (("own", own), ("others", others)):
        for name, values in columns.items():
            left = values[here] if lost else values
            if np.isfinite(left).all():
                kept[kind][name] = left
            else:
                left_out.append(name)
                if kind == "own":
                    notes.append(f"{name} has gaps and is left out")
    return kept["own"], kept["others"]


def _is_clock(steps: np.ndarray, counts: np.ndarray) -> bool:
    """Whether most ticks are as long as the others, and none holds far more samples."""
    usual = np.median(steps)
    even = np.abs(steps - usual) < 0.01 * usual
    return bool(even.mean() > 0.8 and counts.max() <= 2 * np.median(counts) + 1)


def _spread(time: np.ndarray, notes: Sequence[str] | list[str]) -> np.ndarray:
    """Times that a clock has rounded to its tick, spread evenly between its ticks.

    Equal neighbours are samples of one tick: each run of them is spread up to the next tick.
    """
    steps = np.diff(time)
    same = steps == 0.0
    if not same.any() or (steps < 0.0).any() or same.mean() < TICK:
        return time
    firsts = np.flatnonzero(np.concatenate([[True], ~same]))
    ticks = time[firsts]
    if len(firsts) < 3 or not _is_clock(np.diff(ticks), np.diff(firsts)):
        return time
    # The last run has no tick behind it: it is as dense as the others.
    rate = (firsts[-1] - firsts[0]) / (ticks[-1] - ticks[0])
    places = np.arange(len(time), dtype=float)
    end = ticks[-1] + (len(time) - firsts[-1]) / rate
    assert isinstance(notes, list)
    notes.append(
        f"times are rounded to {np.median(np.diff(ticks)):.3g} s: samples of one tick are spread "
        "evenly up to the next"
    )
    return np.asarray(np.interp(places, [*firsts, len(time)], [*ticks, end]))
