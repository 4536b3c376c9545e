"""Instructions of a user on reading a file, where the guess is wrong or is to be repeated.

It is said in a call, or in a *description*, ``record.toml``, which names the file by a path from
itself, upwards too, or by an absolute path. Of a file that does not lie below its description, no
error shows what is in it: who wrote the description need not be who may read that file.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import hashlib
import math
import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from granular.records.calibration import KEYS
from granular.schema.units import si_value
from granular.shared.errors import RecordError, SceneError, quote, sanitize, unknown_word_message
from granular.shared.files import read_toml, write_text

T = TypeVar("T")

FILE = "file"
"""Key of the file that is described, as a path from the description."""
_MISSPELT = 0.8
"""Similarity to a role from which on a name is no input's, but that role misspelt."""
_MAX_BYTES = 2**20
"""Longest description; a scene, which may be longer, is not read to see that it is none."""
ALL = "all"
"""All releases of a record."""
ANGLE = "angle"
"""Name of the height's column in ``columns`` and ``units`` if it is an angle."""
STROKE = "stroke"
"""Role of ``columns`` for the height's column where it is prescribed, and the force is measured."""
ROLES = ("time", "height", "velocity", "force", "acceleration", "base_height", "base_acceleration")
"""Columns of a record that have a meaning."""


_KINDS: tuple[tuple[tuple[str, ...], Any, str], ...] = (
    (("columns", "units", "calibration"), Mapping, "give names and values"),
    (("flip", "sort"), bool, "give true or false"),
    (("sheet",), str | None, "give a name"),
    (("scale", "zero"), str | Mapping | None, "give a text with units"),
)
"""Types of options, and what to say where another is given."""


@dataclasses.dataclass(frozen=True)
class ReadOptions:
    """Instructions on reading a file. What is not said is guessed.

    Attributes
    ----------
    columns : mapping of str to str
        Which column is the time, the height (or any other coordinate), the angle, the stroke (a
        height that is prescribed, of a record whose force is measured), the velocity, the force,
        the acceleration, and height or acceleration of the base: by its name in the file, or by its
        number from 1. Any other name calls a column so, as an input of a law.
    units : mapping of str to str
        Units by those names, or by names in the file.
    decimal : str or None
        ``"."`` or ``","``.
    skip : int
        Lines at the head of the file that are no part of the table.
    sheet : str or None
        Of a workbook, or the variable of a MATLAB file.
    flip : bool
        Whether the coordinate grows downwards, as the distance from a sensor above does.
    between : tuple of float or None
        The samples from this time to that one [s].
    scale, zero : str, mapping of str to str, or None
        Calibration of the height's column, such as ``"2.4894 mm/V"`` and ``"2.513 V"``, or of
        several by their roles or names; see `granular.records.calibration`.
    calibration : mapping of str to any
        The same with its other forms, ``coefficients`` or ``points``, of the height or by columns;
        as in a description, where ``points`` names a file.
    release : int, str or None
        Which of several releases is the record, from 1, or ``"all"`` for all of them; heeded where
        the motion in a record is looked for (`reduced_models.records.free_motion`).
    rate : str, float or None
        Samples a second [Hz] of a file without times.
    sort : bool
        Whether rows are put in the order of their times, those of one time as their mean.

    Raises
    ------
    RecordError
        If a key or a value is none of these.
    """

    columns: Mapping[str, str | int] = dataclasses.field(default_factory=dict)
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    decimal: str | None = None
    skip: int = 0
    sheet: str | None = None
    flip: bool = False
    between: tuple[float, float] | None = None
    scale: str | Mapping[str, str] | None = None
    zero: str | Mapping[str, str] | None = None
    calibration: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    release: int | str | None = None
    rate: str | float | None = None
    sort: bool = False

    def __post_init__(self) -> None:
        for names, kind, advice in _KINDS:
            for name in names:
                self._require(name, isinstance(getattr(self, name), kind), advice)
        self._require("decimal", self.decimal in (None, ".", ","), "give '.' or ','")
        lines = not isinstance(self.skip, bool) and isinstance(self.skip, int) and self.skip >= 0
        self._require("skip", lines, "give a number of lines")
        for role, column in self.columns.items():
            _check_role(str(role))
            if isinstance(column, bool) or not isinstance(column, str | int):
                raise RecordError(f"columns: {role} = {quote(column)}; give a name or a number")
        for role, unit in self.units.items():
            if not isinstance(unit, str):
                raise RecordError(f"units: {quote(role)} = {quote(unit)}; give a unit in words")
        self.calibrations()
        if self.release not in (None, ALL):
            number = str(self.release)
            fits = number.isdigit() and int(number) > 0 and self.between is None
            self._require("release", fits, "give a number from 1, or 'all', and no times (between) with it")
            object.__setattr__(self, "release", int(number))
        if self.rate is not None:
            object.__setattr__(self, "rate", _parse_sampling_rate(self.rate))
        if self.between is not None:
            object.__setattr__(self, "between", _parse_time_range(self.between))

    def _require(self, name: str, fits: bool, advice: str) -> None:
        if not fits:
            raise RecordError(f"{name} = {quote(getattr(self, name))}; {advice}")

    def merge(self, more: ReadOptions) -> ReadOptions:
        """Combine these options with others, which go before them."""
        plain, over = self.to_plain(), more.to_plain()
        both = {key: {**plain.get(key, {}), **over.get(key, {})} for key in ("columns", "units")}
        calibrations = self.calibrations()
        for column, given in more.calibrations().items():
            before = calibrations.get(column, {})
            same = all(key in before or key == "zero" for key in given)
            calibrations[column] = {**before, **given} if same else given
        given = {"scale": None, "zero": None, "calibration": calibrations}
        return ReadOptions(**{**plain, **over, **both, **given})

    def calibrations(self) -> dict[str, dict[str, Any]]:
        """Collect what is said of the calibration of each column, by its role or name."""
        result: dict[str, dict[str, Any]] = {}
        for name in ("scale", "zero"):
            given = getattr(self, name)
            for column, text in ({"height": given} if isinstance(given, str) else given or {}).items():
                result.setdefault(_calibration_key(column), {})[name] = text
        of_height = {key: value for key, value in self.calibration.items() if key in KEYS}
        of_columns = [(column, given) for column, given in self.calibration.items() if column not in KEYS]
        for column, given in (*of_columns, *[("height", of_height)] * bool(of_height)):
            if not isinstance(given, Mapping):
                raise RecordError(
                    f"calibration: {unknown_word_message(str(column), KEYS, 'key')}; or give a table for a "
                    "column"
                )
            result.setdefault(_calibration_key(column), {}).update(given)
        return result

    def select_table(self, tables: Mapping[str, T], kind: str) -> Mapping[str, T]:
        """Select the table of a file that ``sheet`` names; all where it names none."""
        if self.sheet is None:
            return tables
        if self.sheet not in tables:
            names = ", ".join(map(quote, tables))
            raise RecordError(f"no {kind} {quote(self.sheet)}; found: {names}")
        return {self.sheet: tables[self.sheet]}

    def to_plain(self) -> dict[str, Any]:
        """Convert the options to plain data, without those that are not given."""
        calibrations = self.calibrations()
        of_height = calibrations.get("height", {})
        short = list(calibrations) == ["height"] and set(of_height) <= {"scale", "zero"}
        plain = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        plain |= {
            "columns": dict(self.columns),
            "units": dict(self.units),
            "between": None if self.between is None else list(self.between),
            **{key: of_height.get(key) if short else None for key in ("scale", "zero")},
            "calibration": {} if short else calibrations,
        }
        return {key: value for key, value in plain.items() if value not in (None, {}, 0, False)}


def note_on_other_tables(kind: str, names: Sequence[str]) -> str:
    """Note that the first of several tables of a file is read, and how another one is."""
    return (
        f"the {kind} {quote(names[0])}, the first of {len(names)}, is read (another: --sheet "
        f"{shlex.quote(sanitize(names[1]))})"
    )


def options_from_plain(plain: Mapping[str, Any]) -> ReadOptions:
    """Make options of the plain data of `ReadOptions.to_plain`."""
    known = tuple(field.name for field in dataclasses.fields(ReadOptions))
    for key in plain:
        if key not in known:
            raise RecordError(unknown_word_message(str(key), known, "key of a record"))
    return ReadOptions(**plain)


def _check_role(role: str) -> None:
    """Refuse a name that is no role, and is no plain word for an input or nearly a role."""
    known = (*ROLES, ANGLE, STROKE)
    misspelt = difflib.get_close_matches(role, known, 1, _MISSPELT)
    if role not in known and (misspelt or not role.isidentifier()):
        raise RecordError(f"columns: {unknown_word_message(role, known, 'column of a record')}")


def _calibration_key(name: object) -> str:
    """Name of a column, or its role, as the keys of a calibration have it."""
    key = str(name).strip().lower()
    return "height" if key in (ANGLE, STROKE) else key


def _parse_sampling_rate(rate: Any) -> float:
    try:
        value = si_value(str(rate), "Hz")
    except SceneError as error:
        raise RecordError(f"rate = {quote(rate)}: {error}; such as '610.35 Hz'") from None
    if not 0.0 < value < math.inf:
        raise RecordError(f"rate = {value:g} Hz; give a number above 0")
    return value


def _parse_time_range(times: Any) -> tuple[float, float]:
    try:
        start, stop = (float(time) for time in times)
    except (TypeError, ValueError):
        raise RecordError(f"between = {quote(times)}; give two times, such as 0.5:6") from None
    if not start < stop or math.isnan(start):
        raise RecordError(f"between = {start:g} to {stop:g} s; give the earlier time first")
    return start, stop


# Descriptions ----------------------------------------------------------------------------------


def is_record_description(path: Path) -> bool:
    """Tell a TOML file that describes a record; a scene has no key ``file``."""
    if path.suffix != ".toml" or not path.is_file() or path.stat().st_size > _MAX_BYTES:
        return False
    return FILE in read_toml(path)


def read_record_description(path: Path) -> tuple[Path, ReadOptions]:
    """Read the description of a record: the file that it names, and the options to read it with."""
    plain = dict(read_toml(path))
    name = plain.pop(FILE, None)
    if not isinstance(name, str):
        raise RecordError(f"{sanitize(path)}: file = {quote(name)}; give the name of a file")
    try:
        options = options_from_plain(plain)
    except RecordError as error:
        raise RecordError(f"{sanitize(path)}: {error}") from None
    return path.parent / name, _map_point_files(options, lambda file: str(path.parent / file))


def _map_point_files(options: ReadOptions, change: Callable[[str], str]) -> ReadOptions:
    """Change the names of the files of calibration points."""
    every = options.calibrations()
    named = {
        column: {**given, "points": change(given["points"])}
        for column, given in every.items()
        if isinstance(given.get("points"), str)
    }
    return options.merge(ReadOptions(calibration=named)) if named else options


@contextlib.contextmanager
def name_description_in_errors(path: Path, file: Path) -> Iterator[None]:
    """Give the context in which the file that a description names is read."""
    try:
        yield
    except RecordError:
        if not _is_in_other_folder(path, file):
            raise
        raise RecordError(
            f"{sanitize(path)}: {FILE} = {quote(str(file))} cannot be read as a record; as it does "
            "not lie below the description, no more is said: read it itself"
        ) from None


def _is_in_other_folder(path: Path, file: Path) -> bool:
    try:
        return file != path and file.is_file() and not file.resolve().is_relative_to(path.parent.resolve())
    except OSError:  # a name that no file can have
        return False


def described_file(path: Path, options: ReadOptions) -> tuple[Path, ReadOptions]:
    """File that a path is of, or that its description names, and the options to read it with."""
    if not is_record_description(path):
        return path, options
    file, described = read_record_description(path)
    return file, described.merge(options)


@dataclasses.dataclass(frozen=True)
class RecordSource:
    """File or scene behind a record, and notes on what was guessed, cut or repaired."""

    name: str  # empty if the record was made of arrays
    scene: str = ""
    digest: str = ""
    calibration: str = ""
    notes: tuple[str, ...] = ()


def source_of_file(path: Path, options: ReadOptions, notes: tuple[str, ...]) -> RecordSource:
    """Source of a record that was read from a file, or from that which a description names."""
    file, merged = described_file(path, options)
    calibrations = []
    for column, given in merged.calibrations().items():
        words = ", ".join(f"{key} {value}" for key, value in given.items())
        words = "a straight line through points" if "points" in given else words
        calibrations.append(words if column == "height" else f"{column} {words}")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    return RecordSource(file.name, digest=digest, calibration="; ".join(calibrations), notes=notes)


def write_record_description(path: Path, file: Path, options: ReadOptions) -> None:
    """Write a description of a record, with the path from it to the file."""
    import tomli_w

    where = path.resolve().parent

    def relative(name: str | Path) -> str:
        try:
            return Path(os.path.relpath(Path(name).resolve(), where)).as_posix()
        except ValueError:  # on another drive
            return Path(name).resolve().as_posix()

    plain: dict[str, Any] = {FILE: relative(file), **_map_point_files(options, relative).to_plain()}
    write_text(path, tomli_w.dumps(plain))
