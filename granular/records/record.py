"""The piston record: its motion as plain arrays in SI, from a run or from a file."""

from __future__ import annotations

import csv
import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from granular.records.headings import ACCELERATION, COORDINATES, VELOCITY, CoordinateUnit
from granular.records.integration import integrate_without_drift
from granular.records.options import RecordSource, options_from_plain, source_of_file
from granular.records.sheet import numbers_in_si
from granular.shared.errors import RecordError, RecordWarning, quote, sanitize
from granular.shared.files import write_atomically

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

    from granular.records.formats import FileFormat
    from granular.records.interpret import SheetInterpretation

UNITS = {"time": "s", "height": "m", "velocity": "m/s", "force": "N"}
DRAWN_UNITS = {"m": ("mm", 1e3), "rad": ("rad", 1.0)}
"""Units in which a coordinate is drawn, and how many of them its own unit is."""
_LEAST_SAMPLES = 2
_INTEGRALS = {VELOCITY: 1, ACCELERATION: 2}
"""Columns that tell of a motion without a position, and how often they are integrated."""


class PandasOrXarray(Protocol):
    """A Series or DataFrame of pandas, or a DataArray or Dataset of xarray."""

    def equals(self, other: Any, /) -> bool:
        """Return True for an object of the same kind that holds the same numbers."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class PistonRecord:
    """The motion of a piston.

    Attributes
    ----------
    time, height : float64 (n,)
        [s], strictly increasing; [m]. At least two samples.
    velocity, force : float64 (n,) or None
        [m/s]; the force of the grains on the piston, upwards [N].
    extra : mapping of str to float64 (n,)
        Further columns, as they were given.
    coordinate_unit : "m" or "rad"
        Unit of ``height``, which is an angle where it is rad; its velocity is in rad/s then.
    deviations : mapping of str to float64 (m, n)
        Independent deviations of columns that a sensor's calibration leaves open, of one standard
        uncertainty each; they widen the intervals of what is fitted. Not checked.
    measured : str
        Column that was measured and that fits compare: ``"height"``, or ``"velocity"`` or
        ``"acceleration"`` of a record without a position. Its ``height`` is then their integral about zero,
        without what is slow, for first guesses. ``"force"`` where the height is a prescribed stroke.
    source : RecordSource or None
        File (with its digest and calibration) or scene that it comes from, and notes on its samples.
    complete : bool
        Whether fits keep clipped samples and spikes too; True of a file read with ``between``.

    Raises
    ------
    RecordError
        For fewer than two samples, other lengths, values that are not finite, times that do not grow, or
        another unit.

    Examples
    --------
    >>> from reduced_models import PistonRecord
    >>> record = PistonRecord([0.0, 0.1, 0.2], [0.061, 0.060, 0.061])
    >>> len(record), float(record.time[-1])
    (3, 0.2)
    """

    time: np.ndarray
    height: np.ndarray
    velocity: np.ndarray | None = None
    force: np.ndarray | None = None
    extra: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    coordinate_unit: CoordinateUnit = "m"
    deviations: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    measured: str = "height"
    source: RecordSource | None = None
    complete: bool = False

    def __post_init__(self) -> None:
        if self.coordinate_unit not in COORDINATES:
            raise RecordError(f"coordinate_unit = {quote(self.coordinate_unit)}; give 'm' or 'rad'")
        for name in UNITS:
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, self._validated_column(name, values))
        extra = {key: self._validated_column(key, values) for key, values in self.extra.items()}
        object.__setattr__(self, "extra", extra)
        later = np.diff(self.time) > 0.0
        if not later.all():
            sample = int(np.argmin(later)) + 1
            before, after = self.time[sample - 1], self.time[sample]
            what = "is there twice" if before == after else f"comes after {before:g} s"
            raise RecordError(
                f"time of sample {sample}, {after:g} s, {what}; times must increase: sort the samples, "
                "and take the mean of those of one time (of a file: --sort)"
            )

    def _validated_column(self, name: str, values: np.ndarray) -> np.ndarray:
        array, samples = numbers_in_si(name, values), len(np.atleast_1d(self.time))
        if array.shape != (samples,):
            raise RecordError(
                f"{sanitize(name)}: has the shape {array.shape}; give {samples} values, as times"
            )
        if samples < _LEAST_SAMPLES:
            raise RecordError(f"{sanitize(name)}: {samples} samples; at least {_LEAST_SAMPLES} make a record")
        if not np.isfinite(array).all():
            sample = int(np.argmin(np.isfinite(array)))
            raise RecordError(
                f"{sanitize(name)} of sample {sample} is {array[sample]}; values must be finite: "
                "drop such samples"
            )
        array.flags.writeable = False
        return array

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        unit = self.units["height"]
        others = ", ".join(name for name in self.columns if name not in ("time", "height"))
        return (
            f"PistonRecord of {len(self)} samples from {self.time[0]:.6g} to {self.time[-1]:.6g} s, "
            f"{self.coordinate} from {self.height.min():.6g} to {self.height.max():.6g} "
            + (f"{unit}; also {others}" if others else unit)
        )

    def to_dataframe(self) -> pandas.DataFrame:
        """Table of `columns` for pandas, with `units` in ``attrs["units"]``.

        Returns
        -------
        pandas.DataFrame
            One row a sample, in SI units.

        Examples
        --------
        >>> from reduced_models import PistonRecord
        >>> list(PistonRecord([0.0, 0.1, 0.2], [0.061, 0.060, 0.061]).to_dataframe().columns)
        ['time', 'height']
        """
        import pandas

        table = pandas.DataFrame(self.columns)
        table.attrs["units"] = self.units
        return table

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the height [mm], or the angle [rad], over time [s]; an integrated one where none was measured.

        Parameters
        ----------
        ax : Axes, optional
            Axes to draw on; new ones if not given.

        Returns
        -------
        Axes
            Axes that hold the drawing.
        """
        from granular.shared.plotting import axes_or_new

        ax = axes_or_new(ax)
        unit, factor = DRAWN_UNITS[self.coordinate_unit]
        ax.plot(self.time, factor * self.height)
        ax.set(xlabel="time [s]", ylabel=f"{self.coordinate} [{unit}]")
        return ax

    @classmethod
    def from_file(
        cls, path: str | Path, units: Mapping[str, str] | None = None, **options: Any
    ) -> PistonRecord:
        """Read a record from a file, as an instrument or a program writes it.

        CSV and its kin in any encoding, with preambles, rows of units, decimal commas, lost samples, dates
        and times of day; LabVIEW measurements; and by their endings Parquet (``.parquet``, ``.pq``),
        workbooks (``.xlsx``, ``.ods``), TDMS and MATLAB files. A ``record.toml`` says how another is read.

        Which column is what follows from names (``time``, ``t``, ``Zeit``, ...; ``height``, ``z``,
        ``displacement``, ``angle``, ...) and from units (``height [mm]``, ``height_mm``, ...); SI
        where there is none. A `RecordWarning` says what is guessed, and what is done to the samples.

        Parameters
        ----------
        path : str or Path
            File to read.
        units : mapping of str to str, optional
            Units of columns by their names, instead of those in the file.
        **options
            The fields of `granular.records.options.ReadOptions`: ``columns``, ``decimal``, ``skip``,
            ``sheet``, ``flip``, ``between``, ``scale``, ``zero``, ``calibration``, ``rate``, ``sort``;
            ``release`` does nothing here, as `reduced_models.read_record` alone heeds it.

        Returns
        -------
        PistonRecord
            Record with time [s], height [m] or angle [rad], and what else the file holds.

        Raises
        ------
        RecordError
            If an option does not fit, or the file or a library for it is missing, or it cannot be read.
        """
        return cls._read_file(Path(path), None, units, options)

    @classmethod
    def from_csv(
        cls, path: str | Path, units: Mapping[str, str] | None = None, **options: Any
    ) -> PistonRecord:
        """Read a record from a file of text, whatever its name; see `from_file`.

        Parameters
        ----------
        path : str or Path
            File to read.
        units : mapping of str to str, optional
            Units of columns by their names, instead of those in the file.
        **options
            Options of `from_file`.

        Returns
        -------
        PistonRecord
            Record with time [s], height [m] or angle [rad], and what else the file holds.

        Raises
        ------
        RecordError
            If an option does not fit, or the file cannot be read as such; the message names line and column.
        """
        from granular.records.formats import TEXT

        return cls._read_file(Path(path), TEXT, units, options)

    @classmethod
    def from_parquet(
        cls, path: str | Path, units: Mapping[str, str] | None = None, **options: Any
    ) -> PistonRecord:
        """Read a record from a Parquet file (needs the extra ``parquet``); see `from_file`.

        A unit stands behind a name, ``height [mm]``, or in the metadata of its field as ``units``
        (or ``unit``).

        Parameters
        ----------
        path : str or Path
            File to read.
        units : mapping of str to str, optional
            Units of columns by their names, instead of those in the file.
        **options
            Options of `from_file`.

        Returns
        -------
        PistonRecord
            Record with time [s], height [m] or angle [rad], and what else the file holds.

        Raises
        ------
        RecordError
            If an option does not fit, the file cannot be read as such, or pyarrow is not there.
        """
        from granular.records.formats import PARQUET

        return cls._read_file(Path(path), PARQUET, units, options)

    @classmethod
    def from_table(cls, table: Any, units: Mapping[str, str] | None = None, **options: Any) -> PistonRecord:
        """Record in a DataFrame, an xarray object, or a mapping of names to arrays.

        Names and units are read as those of a file; see `from_file`.

        Parameters
        ----------
        table : DataFrame, xarray object or mapping
            Table with columns of time and height, n values each.
        units : mapping of str to str, optional
            Units of columns by their names, instead of those in the table.
        **options
            Options of `from_file`.

        Returns
        -------
        PistonRecord
            Record with time [s], height [m] or angle [rad], and what else the table holds.

        Raises
        ------
        RecordError
            If it is no table, holds no record, or an option does not fit.

        Examples
        --------
        >>> from reduced_models import PistonRecord
        >>> len(PistonRecord.from_table({"time": [0.0, 0.1, 0.2], "height [mm]": [61.0, 60.0, 61.0]}))
        3
        """
        from granular.records.interpret import interpret_sheet
        from granular.records.sheet import sheet_from_table

        seen = interpret_sheet(sheet_from_table(table), options_from_plain({"units": units or {}, **options}))
        if seen.notes:
            warnings.warn("; ".join(seen.notes), RecordWarning, stacklevel=2)
        return cls.from_interpreted_columns(seen)

    @classmethod
    def _read_file(
        cls, path: Path, form: FileFormat | None, units: Mapping[str, str] | None, options: dict[str, Any]
    ) -> PistonRecord:
        from granular.records.formats import interpret_record_file

        said = options_from_plain({"units": units or {}, **options})
        meaning = interpret_record_file(path, said, form)
        try:
            record = cls.from_interpreted_columns(meaning)
        except RecordError as error:
            raise RecordError(f"{sanitize(path)}: {error}") from None
        record = dataclasses.replace(record, source=source_of_file(path, said, meaning.notes))
        if meaning.notes:
            warnings.warn(f"{sanitize(path)}: {'; '.join(meaning.notes)}", RecordWarning, stacklevel=3)
        return record

    @classmethod
    def from_interpreted_columns(cls, meaning: SheetInterpretation) -> PistonRecord:
        """Make a record of columns whose roles and units were found; see `granular.records`.

        Parameters
        ----------
        meaning : SheetInterpretation
            Columns of a file with their roles and units.

        Returns
        -------
        PistonRecord
            Record in SI units.

        Raises
        ------
        RecordError
            If they make none, or a stroke has no force with it.
        """
        record = cls.from_columns(meaning.columns)
        if meaning.prescribed and record.force is None:
            raise RecordError("a stroke is of a record with a measured force; name its column, force=...")
        measured = "force" if meaning.prescribed else record.measured
        return dataclasses.replace(
            record, coordinate_unit=meaning.coordinate_unit, deviations=meaning.deviations, measured=measured
        )

    def to_csv(self, path: str | Path) -> None:
        """Write `columns` to a CSV file, whose numbers `from_csv` reads back to the same bits.

        A record without a position is read with ``columns`` that name its velocity or acceleration;
        ``deviations`` and a ``measured`` force are not written.

        Parameters
        ----------
        path : str or Path
            File to write; one that is there is replaced.

        Raises
        ------
        InputError
            If it cannot be written; what was there before still stands.
        """
        columns = {
            f"{name} [{self.units[name]}]" if name in UNITS else name: values
            for name, values in self.columns.items()
        }
        with (
            write_atomically(Path(path), overwrite=True) as part,
            part.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))

    def to_parquet(self, path: str | Path) -> None:
        """Write `columns` to a Parquet file, whose numbers `from_parquet` reads back; limits as of `to_csv`.

        Parameters
        ----------
        path : str or Path
            File to write; one that is there is replaced.

        Raises
        ------
        RecordError
            If pyarrow is not there.
        InputError
            If it cannot be written; what was there before still stands.
        """
        from granular.records.binary import write_parquet

        write_parquet(Path(path), self.columns, self.units)

    @property
    def units(self) -> dict[str, str]:
        """SI units of time, height, velocity and force, a dict by names, also of those that are not there."""
        return {**UNITS, "height": self.coordinate_unit, "velocity": f"{self.coordinate_unit}/s"}

    @property
    def coordinate(self) -> str:
        """Name of the coordinate: "height", or "angle"."""
        return COORDINATES[self.coordinate_unit]

    @property
    def signal(self) -> np.ndarray:
        """Measured quantity, float64 (n,), in `signal_unit`."""
        return self.columns[self.measured] if self.measured in (*_INTEGRALS, "force") else self.height

    @property
    def signal_unit(self) -> str:
        """SI unit of `signal`, such as "m" or, of an acceleration, "m/s^2"."""
        if self.measured == "force":
            return UNITS["force"]
        return self.units["height"] + ("", "/s", "/s^2")[_INTEGRALS.get(self.measured, 0)]

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns, a dict of float64 (n,) in SI by names; a height that was integrated is none."""
        own = {name: getattr(self, name) for name in UNITS if getattr(self, name) is not None}
        if self.measured in _INTEGRALS:
            del own["height"]
        return own | dict(self.extra)

    @classmethod
    def from_columns(cls, columns: Mapping[str, Sequence[float] | np.ndarray]) -> PistonRecord:
        """Make a record of columns in SI units; those that are none of its own are further ones.

        Parameters
        ----------
        columns : mapping of str to array (n,)
            Columns in SI; ``time`` and ``height``, or ``velocity`` or ``acceleration`` for it, are needed.

        Returns
        -------
        PistonRecord
            Record whose ``measured`` names the column of the motion that was given.

        Raises
        ------
        RecordError
            If ``time`` or the motion is missing, or the values make no `PistonRecord`.
        """
        measured = next((name for name in ("height", *_INTEGRALS) if name in columns), "height")
        for name in ("time", measured):
            if name not in columns:
                raise RecordError(
                    f"there is no column {quote(name)}; give time, and height, velocity or acceleration"
                )
        own = {name: columns[name] for name in UNITS if name in columns}
        extra = {name: values for name, values in columns.items() if name not in UNITS}
        own.setdefault("height", np.zeros(np.shape(columns["time"])))
        record = cls(**own, extra=extra, measured=measured)  # type: ignore[arg-type]  # by names
        if measured == "height":
            return record
        height = integrate_without_drift(record.time, record.signal, _INTEGRALS[measured])
        return dataclasses.replace(record, height=height)

    def between(self, start: float, stop: float) -> PistonRecord:
        """Return the samples with start <= time <= stop [s].

        Parameters
        ----------
        start, stop : float
            Least and greatest time [s].

        Returns
        -------
        PistonRecord
            Part of the record; its times are kept as they are.

        Raises
        ------
        RecordError
            If fewer than two samples lie between, as where a limit is NaN.

        Examples
        --------
        >>> from reduced_models import PistonRecord
        >>> len(PistonRecord([0.0, 0.1, 0.2], [0.061, 0.060, 0.061]).between(0.1, 0.2))
        2
        """
        return self.select((self.time >= start) & (self.time <= stop))

    def select(self, samples: np.ndarray | slice) -> PistonRecord:
        """Return some of the samples.

        Parameters
        ----------
        samples : bool (n,), int (m,) or slice
            True for the samples that are kept, or their indices, increasing.

        Returns
        -------
        PistonRecord
            Record with these samples; its times are kept as they are.

        Raises
        ------
        RecordError
            If there are fewer than two, or they do not increase in time.
        IndexError
            If the record has no such samples.
        """
        own = {name: getattr(self, name)[samples] for name in UNITS if getattr(self, name) is not None}
        extra = {key: values[samples] for key, values in self.extra.items()}
        deviations = {key: values[:, samples] for key, values in self.deviations.items()}
        return dataclasses.replace(self, **own, extra=extra, deviations=deviations)

    def first(self, count: int) -> PistonRecord:
        """First ``count`` samples.

        Parameters
        ----------
        count : int
            Number of samples, at least 2; all where the record has fewer.

        Returns
        -------
        PistonRecord
            Beginning of the record.

        Raises
        ------
        RecordError
            If ``count`` is below 2.
        """
        return self.select(slice(max(count, 0)))

    def with_time_from_zero(self) -> PistonRecord:
        """Return the same record with times that start at 0.

        Returns
        -------
        PistonRecord
            Record that begins at time 0.

        Examples
        --------
        >>> from reduced_models import PistonRecord
        >>> PistonRecord([5.0, 6.0], [0.061, 0.060]).with_time_from_zero().time.tolist()
        [0.0, 1.0]
        """
        return dataclasses.replace(self, time=self.time - self.time[0])

    def mapped(self, shift: float, scale: float) -> PistonRecord:
        """Record in the coordinate z = (height - shift)/scale.

        Parameters
        ----------
        shift, scale : float
            Height at z = 0, and height per unit of z, which is not 0 [m]; of an angle [rad].

        Returns
        -------
        PistonRecord
            Record with z and dz/dt [1/s] for height and velocity, whatever `units` says; all else is kept.

        Raises
        ------
        RecordError
            If z is not finite, as where the scale is 0.

        Examples
        --------
        >>> from reduced_models import PistonRecord
        >>> PistonRecord([0.0, 1.0], [0.06, 0.05]).mapped(0.05, 0.01).height.round(6).tolist()
        [1.0, 0.0]
        """
        velocity = None if self.velocity is None else self.velocity / scale
        deviations = {
            name: values / scale if name == "height" else values for name, values in self.deviations.items()
        }
        return dataclasses.replace(
            self, height=(self.height - shift) / scale, velocity=velocity, deviations=deviations
        )
