"""Options for reading a file. An option that is not given is guessed.

Options are given in a call or in a *description*, a file such as ``record.toml``. A description names the
data file by an absolute path or by a path relative to the description, which may lead to a parent folder.
If the data file is outside the description's folder, errors do not quote its content: the author of the
description may not be permitted to read it.
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
"""Key under which a description gives the path of the data file."""
_MISSPELT = 0.8
"""Similarity to a role above which a name is refused as a misspelt role."""
_MAX_BYTES = 2**20
"""Maximum size of a description [bytes]; a larger TOML file is not searched for the key ``file``."""
ALL = "all"
"""Value of the option ``release`` that selects all releases of a record."""
ANGLE = "angle"
"""Key in ``columns`` and ``units`` for an angle as the coordinate, in place of the height."""
STROKE = "stroke"
"""Key in ``columns`` for a prescribed height with a measured force, in place of the height."""
ROLES = ("time", "height", "velocity", "force", "acceleration", "base_height", "base_acceleration")
"""Roles of columns."""


_KINDS: tuple[tuple[tuple[str, ...], Any, str], ...] = (
    (("columns", "units", "calibration"), Mapping, "give names and values"),
    (("flip", "sort"), bool, "give true or false"),
    (("sheet",), str | None, "give a name"),
    (("scale", "zero"), str | Mapping | None, "give a string with units"),
)
"""Names of options, the type of their values, and the advice in the error for a value of another type."""


@dataclasses.dataclass(frozen=True)
class ReadOptions:
    """Options for reading a file; options that are not given are guessed.

    Attributes
    ----------
    columns : mapping of str to str
        Column of each role, by its name in the file or its number from 1. Roles are ``time``,
        ``height`` (or any other coordinate), ``angle``, ``stroke`` (a prescribed height in a record
        with a measured force), ``velocity``, ``force``, ``acceleration``, ``base_height`` and
        ``base_acceleration``. Any other key names a column as an input of a law.
    units : mapping of str to str
        Units by role, or by name in the file.
    decimal : str or None
        ``"."`` or ``","``.
    skip : int
        Number of lines to skip at the beginning of the file.
    sheet : str or None
        Sheet of a workbook, variable of a MATLAB file, or group of a TDMS file.
    flip : bool
        True if the coordinate increases downwards, such as the distance from a sensor above the piston.
    between : tuple of float or None
        First and last time of the samples to keep [s].
    scale, zero : str, mapping of str to str, or None
        Linear calibration of the height, such as ``"2.4894 mm/V"`` and ``"2.513 V"``. A mapping gives it for
        several columns, by role or name. See `granular.records.calibration`.
    calibration : mapping of str to any
        Calibration of the height by ``coefficients`` or ``points``, or a mapping of columns to such
        calibrations. In a description ``points`` is the name of a file.
    release : int, str or None
        Number (from 1) of the release to use, or ``"all"``. This option acts only when free motion is
        extracted from a record (`reduced_models.records.free_motion`).
    rate : str, float or None
        Sampling rate [Hz] of a file without times.
    sort : bool
        True to sort rows by time and to average rows at equal times.

    Raises
    ------
    RecordError
        If a key or a value is not valid.
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
                raise RecordError(f"columns: {role} = {quote(column)} is not valid; give a name or a number")
        for role, unit in self.units.items():
            if not isinstance(unit, str):
                raise RecordError(f"units: {quote(role)} = {quote(unit)} is not a string; quote the unit")
        self.calibrations()
        if self.release not in (None, ALL):
            number = str(self.release)
            fits = number.isdigit() and int(number) > 0 and self.between is None
            self._require(
                "release", fits, "give a number from 1, or 'all', and do not combine it with between"
            )
            object.__setattr__(self, "release", int(number))
        if self.rate is not None:
            object.__setattr__(self, "rate", _parse_sampling_rate(self.rate))
        if self.between is not None:
            object.__setattr__(self, "between", _parse_time_range(self.between))

    def _require(self, name: str, fits: bool, advice: str) -> None:
        if not fits:
            raise RecordError(f"{name} = {quote(getattr(self, name))} is not valid; {advice}")

    def merge(self, overrides: ReadOptions) -> ReadOptions:
        """Combine these options with others, which take precedence."""
        plain, over = self.to_plain(), overrides.to_plain()
        merged = {key: {**plain.get(key, {}), **over.get(key, {})} for key in ("columns", "units")}
        calibrations = self.calibrations()
        for column, given in overrides.calibrations().items():
            before = calibrations.get(column, {})
            same_form = all(key in before or key == "zero" for key in given)
            calibrations[column] = {**before, **given} if same_form else given
        given = {"scale": None, "zero": None, "calibration": calibrations}
        return ReadOptions(**{**plain, **over, **merged, **given})

    def calibrations(self) -> dict[str, dict[str, Any]]:
        """Collect the calibration of each column, by role or name."""
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
                    f"calibration: {unknown_word_message(str(column), KEYS, 'key')}; for a column, give a "
                    "table of these keys"
                )
            result.setdefault(_calibration_key(column), {}).update(given)
        return result

    def select_table(self, tables: Mapping[str, T], kind: str) -> Mapping[str, T]:
        """Select the table named by ``sheet``, or all tables if it is None."""
        if self.sheet is None:
            return tables
        if self.sheet not in tables:
            names = ", ".join(map(quote, tables))
            raise RecordError(f"has no {kind} {quote(self.sheet)}; give one of: {names}")
        return {self.sheet: tables[self.sheet]}

    def to_plain(self) -> dict[str, Any]:
        """Convert the options to plain data; an option that has its default value is omitted."""
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
    """Return a note that only the first of several tables is read, with advice on choosing another one."""
    return (
        f"the {kind} {quote(names[0])}, the first of {len(names)}, is read (to read another: --sheet "
        f"{shlex.quote(sanitize(names[1]))})"
    )


def options_from_plain(plain: Mapping[str, Any]) -> ReadOptions:
    """Make options from plain data, such as those from `ReadOptions.to_plain`."""
    known = tuple(field.name for field in dataclasses.fields(ReadOptions))
    for key in plain:
        if key not in known:
            raise RecordError(unknown_word_message(str(key), known, "key of a record"))
    return ReadOptions(**plain)


def _check_role(role: str) -> None:
    """Raise an error for a misspelt role, and for a name that is neither a role nor valid for an input."""
    known = (*ROLES, ANGLE, STROKE)
    misspelt = difflib.get_close_matches(role, known, 1, _MISSPELT)
    if role not in known and (misspelt or not role.isidentifier()):
        raise RecordError(f"columns: {unknown_word_message(role, known, 'column of a record')}")


def _calibration_key(name: object) -> str:
    """Return the key of a column's calibration: the column's name or role in lower case."""
    key = str(name).strip().lower()
    return "height" if key in (ANGLE, STROKE) else key


def _parse_sampling_rate(rate: Any) -> float:
    try:
        value = si_value(str(rate), "Hz")
    except SceneError as error:
        raise RecordError(f"rate = {quote(rate)}: {error}; give a rate such as '610.35 Hz'") from None
    if not 0.0 < value < math.inf:
        raise RecordError(f"rate = {value:g} Hz is outside the limits; give a number above 0")
    return value


def _parse_time_range(times: Any) -> tuple[float, float]:
    try:
        start, stop = (float(time) for time in times)
    except (TypeError, ValueError):
        raise RecordError(f"between = {quote(times)} is not two times; give two, such as 0.5:6") from None
    if not start < stop or math.isnan(start):
        raise RecordError(f"between = {start:g} to {stop:g} s is not increasing; give the earlier time first")
    return start, stop


# Descriptions ----------------------------------------------------------------------------------


def is_record_description(path: Path) -> bool:
    """Return True for a TOML file that describes a record: it has a key ``file``, unlike a scene."""
    if path.suffix != ".toml" or not path.is_file() or path.stat().st_size > _MAX_BYTES:
        return False
    return FILE in read_toml(path)


def read_described_path_and_options(path: Path) -> tuple[Path, ReadOptions]:
    """Read the description of a record; return the path of its file and the options."""
    plain = dict(read_toml(path))
    name = plain.pop(FILE, None)
    if not isinstance(name, str):
        raise RecordError(f"{sanitize(path)}: file = {quote(name)} is not a string; give the name of a file")
    try:
        options = options_from_plain(plain)
    except RecordError as error:
        raise RecordError(f"{sanitize(path)}: {error}") from None
    return path.parent / name, _options_with_changed_point_files(
        options, lambda file: str(path.parent / file)
    )


def _options_with_changed_point_files(options: ReadOptions, change: Callable[[str], str]) -> ReadOptions:
    """Return options in which ``change`` is applied to the path of each file with calibration points."""
    calibrations = options.calibrations()
    changed = {
        column: {**given, "points": change(given["points"])}
        for column, given in calibrations.items()
        if isinstance(given.get("points"), str)
    }
    return options.merge(ReadOptions(calibration=changed)) if changed else options


@contextlib.contextmanager
def name_description_in_errors(path: Path, file: Path) -> Iterator[None]:
    """Put the description's path in errors; hide the content of data files outside the folder of ``path``."""
    try:
        yield
    except RecordError:
        if not _is_in_other_folder(path, file):
            raise
        raise RecordError(
            f"{sanitize(path)}: {FILE} = {quote(str(file))} cannot be read as a record; it lies "
            "outside the description's folder, so details are withheld: read the file directly to see them"
        ) from None


def _is_in_other_folder(path: Path, file: Path) -> bool:
    try:
        return file != path and file.is_file() and not file.resolve().is_relative_to(path.parent.resolve())
    except OSError:  # a name that no file can have
        return False


def described_file_and_options(path: Path, options: ReadOptions) -> tuple[Path, ReadOptions]:
    """Return the data file and the merged options for a path, which may be a description."""
    if not is_record_description(path):
        return path, options
    file, described = read_described_path_and_options(path)
    return file, described.merge(options)


@dataclasses.dataclass(frozen=True)
class RecordSource:
    """Source of a record, with notes on guesses, cuts and repairs."""

    name: str  # empty if the record was made from arrays
    scene: str = ""
    digest: str = ""
    calibration: str = ""
    notes: tuple[str, ...] = ()


def source_of_file(path: Path, options: ReadOptions, notes: tuple[str, ...]) -> RecordSource:
    """Return the source of a record that was read from a file or through a description."""
    file, merged = described_file_and_options(path, options)
    calibrations = []
    for column, given in merged.calibrations().items():
        words = ", ".join(f"{key} {value}" for key, value in given.items())
        words = "a straight line through points" if "points" in given else words
        calibrations.append(words if column == "height" else f"{column} {words}")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    return RecordSource(file.name, digest=digest, calibration="; ".join(calibrations), notes=notes)


def write_record_description(path: Path, file: Path, options: ReadOptions) -> None:
    """Write a description of a record; it gives the file's path relative to the description."""
    import tomli_w

    folder = path.resolve().parent

    def path_relative_to_description(name: str | Path) -> str:
        try:
            return Path(os.path.relpath(Path(name).resolve(), folder)).as_posix()
        except ValueError:  # on another drive
            return Path(name).resolve().as_posix()

    plain: dict[str, Any] = {
        FILE: path_relative_to_description(file),
        **_options_with_changed_point_files(options, path_relative_to_description).to_plain(),
    }
    write_text(path, tomli_w.dumps(plain))
