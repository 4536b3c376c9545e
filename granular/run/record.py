"""The piston record: its motion as plain arrays in SI, from a run or from a file."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Mapping, Sequence
from decimal import Decimal
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from granular.scene.schema import unknown
from granular.scene.units import unit_size
from granular.shared.errors import RecordError, SceneError
from granular.shared.files import replacing
from granular.shared.messages import quoted, visible
from granular.shared.tables import PARQUET, Table, read_csv, read_parquet, write_parquet

UNITS = {"time": "s", "height": "m", "velocity": "m/s", "force": "N"}
_LEAST_SAMPLES = 2
_MOST_SHOWN = 20  # names of columns in a message


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
        array = _numbers(name, values)
        if array.ndim != 1 or len(array) != len(np.atleast_1d(self.time)):
            raise RecordError(
                f"{visible(name)}: has the shape {array.shape}; one value a sample of time, "
                f"{len(np.atleast_1d(self.time))}, is wanted"
            )
        if len(array) < _LEAST_SAMPLES:
            raise RecordError(
                f"{visible(name)}: {len(array)} samples; at least {_LEAST_SAMPLES} make a record"
            )
        if not np.isfinite(array).all():
            sample = int(np.argmin(np.isfinite(array)))
            raise RecordError(
                f"{visible(name)} of sample {sample} is {array[sample]}; values must be finite: "
                "drop such samples"
            )
        array.flags.writeable = False
        return array

    def __len__(self) -> int:
        return len(self.time)

    @classmethod
    def from_file(cls, path: str | Path, units: Mapping[str, str] | None = None) -> PistonRecord:
        """Read a record from a Parquet file (``.parquet``, ``.pq``), or from a CSV file.

        Raises
        ------
        RecordError
            As `from_csv` and `from_parquet`.
        """
        parquet = Path(path).suffix.lower() in PARQUET
        return cls.from_parquet(path, units) if parquet else cls.from_csv(path, units)

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
        return cls._of_table(Path(path), read_csv(Path(path), tuple(UNITS)), units or {})

    @classmethod
    def from_parquet(cls, path: str | Path, units: Mapping[str, str] | None = None) -> PistonRecord:
        """Read a record from a Parquet file (needs the extra ``parquet``).

        Parameters
        ----------
        path : str or Path
            A file with the columns that `from_csv` reads. A unit stands behind a name,
            ``height [mm]``, or in the metadata of its field as ``units`` (or ``unit``); SI without.
            ``time``, ``height``, ``velocity`` and ``force`` must hold finite numbers in every row;
            any other column that does not is left out.
        units : mapping of str to str, optional
            Units of the columns, instead of those in the file.

        Raises
        ------
        RecordError
            If the file cannot be read as such, or pyarrow is not there.
        """
        return cls._of_table(Path(path), read_parquet(Path(path), tuple(UNITS)), units or {})

    @classmethod
    def _of_table(cls, path: Path, table: Table, units: Mapping[str, str]) -> PistonRecord:
        for name in units:
            if name not in table.names:
                raise RecordError(unknown(name, table.names, "column"))
        for name in ("time", "height"):
            if name not in table.names:
                found = ", ".join(map(quoted, table.names[:_MOST_SHOWN])) or "none with a name"
                raise RecordError(
                    f"{visible(path)}: no column {quoted(name)}; found: {found}; {table.remedy}"
                )
        written = table.units | dict(units)
        values = {
            name: numbers * _size(name, written.get(name))
            for name, numbers in table.columns.items()
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
            raise RecordError(f"{visible(path)}: {error}") from None

    def to_csv(self, path: str | Path) -> None:
        """Write the record to a CSV file that `from_csv` reads back to the same bits.

        Raises
        ------
        InputError
            If it cannot be written; what was there before still stands.
        """
        columns = {
            f"{name} [{UNITS[name]}]" if name in UNITS else name: values
            for name, values in self.columns.items()
        }
        with (
            replacing(Path(path), overwrite=True) as part,
            part.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))

    def to_parquet(self, path: str | Path) -> None:
        """Write the record to a Parquet file that `from_parquet` reads back to the same bits.

        Raises
        ------
        RecordError
            If pyarrow is not there.
        InputError
            If it cannot be written; what was there before still stands.
        """
        write_parquet(Path(path), self.columns, UNITS)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns by their names."""
        own = {name: getattr(self, name) for name in UNITS if getattr(self, name) is not None}
        return own | dict(self.extra)

    @classmethod
    def from_columns(cls, columns: Mapping[str, Sequence[float] | np.ndarray]) -> PistonRecord:
        """The record of such columns; those that are none of its own are further ones.

        Raises
        ------
        RecordError
            If ``time`` or ``height`` is missing, or the values make no record.
        """
        for name in ("time", "height"):
            if name not in columns:
                raise RecordError(
                    f"there is no column {quoted(name)}; a record needs time and height"
                )
        own = {name: columns[name] for name in UNITS if name in columns}
        extra = {name: values for name, values in columns.items() if name not in UNITS}
        return cls(**own, extra=extra)  # type: ignore[arg-type]

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


def _numbers(name: str, values: Any) -> np.ndarray:
    """A copy of values in double precision: neither truth values, texts nor complex numbers."""
    try:
        given = np.asarray(values)
        if given.dtype.kind not in "iufO" or np.ma.is_masked(values):
            raise TypeError
        if given.dtype.kind == "O" and not all(
            isinstance(one, Real | Decimal) for one in given.flat
        ):
            raise TypeError
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise RecordError(
            f"{visible(name)}: holds something that is not a number; give finite real numbers"
        ) from None


def _size(name: str, unit: str | None) -> float:
    wanted = UNITS.get(name)
    if unit is None or wanted is None:
        return 1.0
    try:
        size, dimension = unit_size(unit)
    except SceneError as error:
        raise RecordError(f"{name}: {error}") from None
    if dimension != unit_size(wanted)[1]:
        raise RecordError(
            f"{name}: the unit {quoted(unit)} does not fit; one of {wanted} is wanted"
        )
    return size
