"""Instructions of a user on reading a file, where the guess is wrong or is to be repeated.

It is said in a call, or in a *description*, ``record.toml``, which names the file by a path from
itself, upwards too, or by a whole path. Of a file that does not lie below its description, no error
shows what is in it: who wrote the description need not be who may read that file.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from granular.schema.sections import unknown
from granular.schema.units import si_value
from granular.shared.errors import RecordError, SceneError
from granular.shared.files import read_toml, write_text
from granular.shared.messages import quote, sanitize

T = TypeVar("T")

FILE = "file"
"""Key of the file that is described, as a path from the description."""
_MAX_BYTES = 2**20
"""Of a description; a scene, which may be longer, is not read to see that it is none."""
ROLES = ("time", "height", "velocity", "force")
"""Columns of a record that have a meaning."""


@dataclasses.dataclass(frozen=True)
class ReadOptions:
    """Instructions on reading a file. What is not said is guessed.

    Attributes
    ----------
    columns : mapping of str to str
        Which column is the time, the height (or any other coordinate), the velocity, the force: by
        its name in the file, or by its number from 1.
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
    scale, zero : str or None
        Calibration of the height's column, such as ``"2.4894 mm/V"`` and ``"2.513 V"``; see
        `granular.readers.calibration`.
    rate : str, float or None
        Samples a second [Hz] of a file without times.
    sort : bool
        Whether rows are put in the order of their times.

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
    scale: str | None = None
    zero: str | None = None
    rate: str | float | None = None
    sort: bool = False

    def __post_init__(self) -> None:
        for name in ("columns", "units"):
            if not isinstance(getattr(self, name), Mapping):
                raise RecordError(f"{name} = {quote(getattr(self, name))}; give names and values")
        for role, column in self.columns.items():
            if role not in ROLES:
                raise RecordError(f"columns: {unknown(str(role), ROLES, 'column of a record')}")
            if isinstance(column, bool) or not isinstance(column, str | int):
                raise RecordError(f"columns: {role} = {quote(column)}; give a name or a number")
        for role, unit in self.units.items():
            if not isinstance(unit, str):
                raise RecordError(f"units: {quote(role)} = {quote(unit)}; give a unit in words")
        if self.decimal not in (None, ".", ","):
            raise RecordError(f"decimal = {quote(self.decimal)}; give '.' or ','")
        if isinstance(self.skip, bool) or not isinstance(self.skip, int) or self.skip < 0:
            raise RecordError(f"skip = {quote(self.skip)}; give a number of lines")
        for name in ("flip", "sort"):
            if not isinstance(getattr(self, name), bool):
                raise RecordError(f"{name} = {quote(getattr(self, name))}; give true or false")
        for name in ("scale", "zero"):
            if not isinstance(getattr(self, name), str | None):
                raise RecordError(f"{name} = {quote(getattr(self, name))}; give a text with units")
        if self.zero is not None and self.scale is None:
            raise RecordError("zero without scale; give both, such as scale = '2.4894 mm/V'")
        if self.rate is not None:
            object.__setattr__(self, "rate", _sampling_rate(self.rate))
        if self.sheet is not None and not isinstance(self.sheet, str):
            raise RecordError(f"sheet = {quote(self.sheet)}; give a name")
        if self.between is not None:
            object.__setattr__(self, "between", _time_range(self.between))

    def merge(self, more: ReadOptions) -> ReadOptions:
        """Return these options, overridden by those that are given in another."""
        plain, over = self.to_plain(), more.to_plain()
        both = {key: {**plain.get(key, {}), **over.get(key, {})} for key in ("columns", "units")}
        return options_from_plain({**plain, **over, **both})

    def select_table(self, tables: Mapping[str, T], kind: str) -> Mapping[str, T]:
        """Table of a file that ``sheet`` names; all where it names none.

        Raises
        ------
        RecordError
            If there is none of that name.
        """
        if self.sheet is None:
            return tables
        if self.sheet not in tables:
            names = ", ".join(map(quote, tables))
            raise RecordError(f"no {kind} {quote(self.sheet)}; found: {names}")
        return {self.sheet: tables[self.sheet]}

    def to_plain(self) -> dict[str, Any]:
        """Instructions as plain data."""
        plain = {
            "columns": dict(self.columns), "units": dict(self.units), "decimal": self.decimal,
            "skip": self.skip, "sheet": self.sheet, "flip": self.flip,
            "between": None if self.between is None else list(self.between), "scale": self.scale,
            "zero": self.zero, "rate": self.rate, "sort": self.sort,
        }  # fmt: skip
        return {key: value for key, value in plain.items() if value not in (None, {}, 0, False)}


def options_from_plain(plain: Mapping[str, Any]) -> ReadOptions:
    """Make options of the plain data of `ReadOptions.to_plain`.

    Raises
    ------
    RecordError
        If a key is unknown, or a value does not fit.
    """
    known = tuple(field.name for field in dataclasses.fields(ReadOptions))
    for key in plain:
        if key not in known:
            raise RecordError(unknown(str(key), known, "key of a record"))
    return ReadOptions(**plain)


def _sampling_rate(rate: Any) -> float:
    try:
        value = si_value(str(rate), "Hz")
    except SceneError as error:
        raise RecordError(f"rate = {quote(rate)}: {error}") from None
    if not 0.0 < value < math.inf:
        raise RecordError(f"rate = {value:g} Hz; give a number above 0")
    return value


def _time_range(times: Any) -> tuple[float, float]:
    try:
        start, stop = (float(time) for time in times)
    except (TypeError, ValueError):
        raise RecordError(f"between = {quote(times)}; give two times, such as 0.5:6") from None
    if not start < stop or math.isnan(start):
        raise RecordError(f"between = {start:g} to {stop:g} s; give the earlier time first")
    return start, stop


# Descriptions ----------------------------------------------------------------------------------


def is_description(path: Path) -> bool:
    """Return True for a file that describes a record; a scene has no key ``file``."""
    if path.suffix != ".toml" or not path.is_file() or path.stat().st_size > _MAX_BYTES:
        return False
    return FILE in read_toml(path)


def read_description(path: Path) -> tuple[Path, ReadOptions]:
    """Return the file that a description names, and the options to read it with.

    Raises
    ------
    RecordError
        If it names none, or a key or a value is none of a `ReadOptions`.
    """
    plain = dict(read_toml(path))
    name = plain.pop(FILE, None)
    if not isinstance(name, str):
        raise RecordError(f"{sanitize(path)}: file = {quote(name)}; give the name of a file")
    try:
        return path.parent / name, options_from_plain(plain)
    except RecordError as error:
        raise RecordError(f"{sanitize(path)}: {error}") from None


@contextlib.contextmanager
def describing(path: Path, file: Path) -> Iterator[None]:
    """Context in which the file that a description names is read; the module says of errors."""
    try:
        yield
    except RecordError:
        if not _is_elsewhere(path, file):
            raise
        raise RecordError(
            f"{sanitize(path)}: {FILE} = {quote(str(file))} cannot be read as a record; as it does "
            "not lie below the description, no more is said: read it itself"
        ) from None


def _is_elsewhere(path: Path, file: Path) -> bool:
    try:
        return file.is_file() and not file.resolve().is_relative_to(path.parent.resolve())
    except OSError:  # a name that no file can have
        return False


def write_description(path: Path, file: Path, options: ReadOptions) -> None:
    """Write a description, with the path from it to the file.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    import tomli_w

    where = path.resolve().parent
    try:
        name = Path(os.path.relpath(file.resolve(), where))
    except ValueError:  # on another drive
        name = file.resolve()
    plain: dict[str, Any] = {FILE: name.as_posix(), **options.to_plain()}
    write_text(path, tomli_w.dumps(plain))
