"""The piston record: its motion as plain arrays in SI, from a run or from a CSV file."""

from __future__ import annotations

import csv
import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from granular.errors import RecordError, SceneError
from granular.schema import unknown
from granular.units import unit_size

UNITS = {"time": "s", "height": "m", "velocity": "m/s", "force": "N"}
_HEADER = re.compile(r"\s*([^\[\(]*?)\s*(?:[\[\(]\s*([^\]\)]*?)\s*[\]\)])?\s*")
_LEAST_SAMPLES = 2
_LONGEST_SHOWN = 80  # characters of a path in a message


@dataclasses.dataclass(frozen=True, eq=False)
class PistonRecord:
    """The motion of a piston.

    Attributes
    ----------
    time, height : float64 (n,)
        [s], strictly increasing; [m].
    velocity, force : float64 (n,) or None
        [m/s]; the force on the piston, upwards [N].
    extra : mapping of str to float64 (n,)
        Further columns, as they were given.

    Raises
    ------
    RecordError
        For fewer than two samples, lengths that differ, values that are not finite, or times that
        do not increase.
    """

    time: np.ndarray
    height: np.ndarray
    velocity: np.ndarray | None = None
    force: np.ndarray | None = None
    extra: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in UNITS:
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, self._checked(name, values))
        object.__setattr__(
            self, "extra", {key: self._checked(key, values) for key, values in self.extra.items()}
        )
        later = np.diff(self.time) > 0.0
        if not later.all():
            sample = int(np.argmin(later)) + 1
            before, after = self.time[sample - 1], self.time[sample]
            what = "is there twice" if before == after else f"comes after {before:g} s"
            raise RecordError(
                f"time of sample {sample}, {after:g} s, {what}; times must increase: sort the "
                "samples and drop doubles"
            )

    def _checked(self, name: str, values: np.ndarray) -> np.ndarray:
        try:
            array = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise RecordError(f"{name}: holds something that is not a number") from None
        if array.ndim != 1 or len(array) != len(np.atleast_1d(self.time)):
            raise RecordError(
                f"{name}: has the shape {array.shape}; one value a sample of time, "
                f"{len(np.atleast_1d(self.time))}, is wanted"
            )
        if len(array) < _LEAST_SAMPLES:
            raise RecordError(
                f"{name}: {len(array)} samples; at least {_LEAST_SAMPLES} make a record"
            )
        if not np.isfinite(array).all():
            sample = int(np.argmin(np.isfinite(array)))
            raise RecordError(
                f"{name} of sample {sample} is {array[sample]}; values must be finite: drop such "
                "samples"
            )
        array.flags.writeable = False
        return array

    def __len__(self) -> int:
        return len(self.time)

    @classmethod
    def from_csv(cls, path: str | Path, units: Mapping[str, str] | None = None) -> PistonRecord:
        """Read a record from a CSV file.

        Parameters
        ----------
        path : str or Path
            A file with a header line that names the columns ``time`` and ``height``, and
            ``velocity``, ``force`` and others where they are there. A unit may stand behind each
            name: ``height [mm]``; SI without. Commas, semicolons or tabs separate; a name that
            holds one of them stands in double quotes. ``time``, ``height``, ``velocity`` and
            ``force`` must hold finite numbers in every line; any other column that does not, and
            any without a name, is left out.
        units : mapping of str to str, optional
            Units of the columns, instead of those in the header.

        Raises
        ------
        RecordError
            If the file cannot be read as such; the message names line and column.
        """
        table = _read_table(Path(path))
        columns = table.cells
        for name in units or {}:
            if name not in columns:
                raise RecordError(unknown(name, tuple(columns), "column"))
        for name in ("time", "height"):
            if name not in columns:
                found = ", ".join(map(repr, columns)) or "none with a name"
                raise RecordError(
                    f"{path}: no column {name!r}; found: {found}; name the columns in the first "
                    "line, such as 'time [s], height [mm]'"
                )
        written = table.units | dict(units or {})
        values = {
            name: numbers * _size(name, written.get(name))
            for name, cells in columns.items()
            if (numbers := _numbers(Path(path), name, cells)) is not None
        }
        try:
            return cls(
                time=values.pop("time"),
                height=values.pop("height"),
                velocity=values.pop("velocity", None),
                force=values.pop("force", None),
                extra=values,
            )
        except RecordError as error:
            raise RecordError(f"{path}: {error}") from None

    def to_csv(self, path: str | Path) -> None:
        """Write the record to a CSV file that `from_csv` reads back to the same bits."""
        columns = {
            f"{name} [{unit}]": getattr(self, name)
            for name, unit in UNITS.items()
            if getattr(self, name) is not None
        } | dict(self.extra)
        with Path(path).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))

    def between(self, start: float, stop: float) -> PistonRecord:
        """The samples with start <= time <= stop [s]."""
        return self._chosen((self.time >= start) & (self.time <= stop))

    def first(self, count: int) -> PistonRecord:
        """The first ``count`` samples."""
        return self._chosen(slice(count))

    def from_zero(self) -> PistonRecord:
        """The same record with times that start at 0."""
        return dataclasses.replace(self, time=self.time - self.time[0])

    def mapped(self, shift: float, scale: float) -> PistonRecord:
        """The record of (height - shift)/scale."""
        velocity = None if self.velocity is None else self.velocity / scale
        return dataclasses.replace(self, height=(self.height - shift) / scale, velocity=velocity)

    def _chosen(self, samples: np.ndarray | slice) -> PistonRecord:
        return PistonRecord(
            self.time[samples],
            self.height[samples],
            None if self.velocity is None else self.velocity[samples],
            None if self.force is None else self.force[samples],
            {key: values[samples] for key, values in self.extra.items()},
        )


def _size(name: str, unit: str | None) -> float:
    wanted = UNITS.get(name)
    if unit is None or wanted is None:
        return 1.0
    try:
        size, dimension = unit_size(unit)
    except SceneError as error:
        raise RecordError(f"{name}: {error}") from None
    if dimension != unit_size(wanted)[1]:
        raise RecordError(f"{name}: the unit {unit!r} does not fit; one of {wanted} is wanted")
    return size


class _Table(NamedTuple):
    """A CSV file taken apart: the cells of each named column, and the units in the header."""

    cells: dict[str, list[str]]
    units: dict[str, str]


def _read_table(path: Path) -> _Table:
    lines = [line for line in _read_text(path).splitlines() if line.strip()]
    lines = [line for line in lines if not line.startswith("#")]
    if not lines:
        raise RecordError(f"{path}: is empty; a header and samples are wanted")
    try:
        delimiter = max(",;\t", key=lambda mark: len(_rows(lines[:1], mark)[0]))
        header, *rows = _rows(lines, delimiter)
    except csv.Error as error:
        raise RecordError(f"{path}: cannot be read as CSV: {error}") from None
    named = [_name_and_unit(cell) for cell in header]
    names = [name for name, _ in named]
    for name in filter(None, names):
        if names.count(name) > 1:
            raise RecordError(f"{path}: the column {name!r} is there twice; names must differ")
    for index, cells in enumerate(rows):
        if len(cells) != len(names):
            raise RecordError(
                f"{path}: sample {index} has {len(cells)} values for {len(names)} columns; "
                "separate all lines like the first"
            )
    return _Table(
        {name: [cells[k] for cells in rows] for k, name in enumerate(names) if name},
        {name: unit for name, unit in named if name and unit},
    )


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise RecordError(f"there is no file {str(path)!r}; check the path") from None
    except OSError as error:
        name = str(path) if len(str(path)) < _LONGEST_SHOWN else f"{str(path)[:_LONGEST_SHOWN]}..."
        raise RecordError(f"{name}: cannot be read: {error.strerror}; check the path") from None
    except UnicodeDecodeError as error:
        raise RecordError(f"{path}: cannot be read as text: {error}; save it as UTF-8") from None


def _rows(lines: list[str], delimiter: str) -> list[list[str]]:
    return list(csv.reader(lines, delimiter=delimiter, skipinitialspace=True))


def _name_and_unit(cell: str) -> tuple[str, str | None]:
    """Name and unit of a column; a header that is not ``name [unit]`` is a name as a whole."""
    match = _HEADER.fullmatch(cell)
    return (match[1].lower(), match[2] or None) if match else (cell.strip().lower(), None)


def _numbers(path: Path, name: str, cells: list[str]) -> np.ndarray | None:
    """The values of a column; None for a further column that holds something else."""
    values = np.empty(len(cells))
    for index, cell in enumerate(cells):
        try:
            values[index] = float(cell)
        except ValueError:
            if name not in UNITS:
                return None
            raise RecordError(
                f"{path}: {name} of sample {index} is {cell!r}, not a number; correct or drop it"
            ) from None
    return values if name in UNITS or np.isfinite(values).all() else None
