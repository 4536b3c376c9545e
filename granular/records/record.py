"""The piston record: motion as plain arrays in SI, from a run or a file."""

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
"""Unit of a plotted coordinate, and the factor that converts from SI."""
_MIN_SAMPLES = 2
_INTEGRALS = {VELOCITY: 1, ACCELERATION: 2}
"""Columns that give the motion without a position, and how many times each must be integrated."""


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
        Time [s], strictly increasing, and height [m]; two samples or more.
    velocity, force : float64 (n,) or None
        Velocity [m/s], and force of the grains on the piston, positive upwards [N].
    extra : mapping of str to float64 (n,)
        Further columns, such as the inputs of a law.
    coordinate_unit : "m" or "rad"
        Unit of ``height``; with ``"rad"`` it is an angle, and the velocity is in rad/s.
    deviations : mapping of str to float64 (m, n)
        Change of a column for each of m independent parameters of its calibration, if this parameter is wrong
        by one standard uncertainty. Fits widen their confidence intervals accordingly.
    measured : str
        Column to which laws are fitted: ``"height"``; ``"force"`` for a prescribed stroke; ``"velocity"`` or
        ``"acceleration"`` without a position, with a high-passed integral as ``height`` for initial guesses.
    source : RecordSource or None
        File (with digest and calibration) or scene of the record, and notes on its samples.
    complete : bool
        True if fits use all samples, including clipped ones and spikes. Set for files read with ``between``.

    Raises
    ------
    RecordError
        For fewer than two samples, unequal lengths, non-finite values, times not increasing, unknown units.

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
            raise RecordError(f"coordinate_unit = {quote(self.coordinate_unit)} is unknown; use 'm' or 'rad'")
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
            problem = "occurs twice" if before == after else f"comes after {before:g} s"
            raise RecordError(
                f"time of sample {sample}, {after:g} s, {problem}; times must increase: sort the samples, "
                "and average samples at equal times (for a file: --sort)"
            )

    def _validated_column(self, name: str, values: np.ndarray) -> np.ndarray:
        array, samples = numbers_in_si(name, values), len(np.atleast_1d(self.time))
        if array.shape != (samples,):
            raise RecordError(
                f"{sanitize(name)}: has the shape {array.shape}; give {samples} values, one per time"
            )
        if samples < _MIN_SAMPLES:
            raise RecordError(f"{sanitize(name)}: {samples} samples; a record needs {_MIN_SAMPLES} or more")
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
        """Return `columns` as a pandas DataFrame, with `units` in ``attrs["units"]``.

        Returns
        -------
        pandas.DataFrame
            One row per sample, in SI units.

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
        """Plot the height [mm] or angle [rad], integrated if it was not measured, against time [s].

        Parameters
        ----------
        ax : Axes, optional
            Axes to draw on; new axes by default.

        Returns
        -------
        Axes
            Axes with the plot.
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
        """Read a record from a file of an instrument or a program.

        The file may be a LabVIEW measurement, or CSV or similar text in any encoding. Text may
        have preambles, rows of units, decimal commas, missing samples, dates and times of day. The suffix
        selects Parquet, workbooks (``.xlsx``, ``.ods``), TDMS, MATLAB, universal files, MDF or TOML.

        The roles of columns follow from their names (``time``, ``t``, ``Zeit``, ...; ``height``, ``z``,
        ``displacement``, ``angle``, ...) and units (``height [mm]``, ``height_mm``, ...); without a unit,
        SI is assumed. A `RecordWarning` reports guesses and changes to the samples.

        Parameters
        ----------
        path : str or Path
            File to read.
        units : mapping of str to str, optional
            Units of columns by name; they replace the units in the file.
        **options
            The fields of `granular.records.options.ReadOptions`: ``columns``, ``decimal``, ``skip``,
            ``sheet``, ``flip``, ``between``, ``scale``, ``zero``, ``calibration``, ``rate``, ``sort``;
            ``release`` has no effect here, since only `reduced_models.read_record` uses it.

        Returns
        -------
        PistonRecord
            Record with time [s], height [m] or angle [rad], and the other columns of the file.

        Raises
        ------
        RecordError
            If an option is not valid, the file or a library for it is missing, or the file cannot be read.
        """
        return cls._read_file(Path(path), None, units, options)

    @classmethod
    def from_csv(
        cls, path: str | Path, units: Mapping[str, str] | None = None, **options: Any
    ) -> PistonRecord:
        """Read a record from a file that is read as text whatever its suffix; see `from_file`.

        Parameters
        ----------
        path : str or Path
            File to read.
        units : mapping of str to str, optional
            Units of columns by name; they replace the units in the file.
        **options
            Options of `from_file`.

        Returns
        -------
        PistonRecord
            Record with time [s], height [m] or angle [rad], and the other columns of the file.

        Raises
        ------
        RecordError
            If an option is not valid, or the text holds no valid table; the message gives line and column.
        """
        from granular.records.formats import TEXT

        return cls._read_file(Path(path), TEXT, units, options)

    @classmethod
    def from_parquet(
        cls, path: str | Path, units: Mapping[str, str] | None = None, **options: Any
    ) -> PistonRecord:
        """Read a record from a Parquet file (needs the extra ``parquet``); see `from_file`.

        A unit follows the name, ``height [mm]``, or is given in the metadata of the field as ``units``
        (or ``unit``).

        Parameters
        ----------
        path : str or Path
            File to read.
        units : mapping of str to str, optional
            Units of columns by name; they replace the units in the file.
        **options
            Options of `from_file`.

        Returns
        -------
        PistonRecord
            Record with time [s], height [m] or angle [rad], and the other columns of the file.

        Raises
        ------
        RecordError
            If an option is not valid, the file is not Parquet, or pyarrow is not installed.
        """
        from granular.records.formats import PARQUET

        return cls._read_file(Path(path), PARQUET, units, options)

    @classmethod
    def from_table(cls, table: Any, units: Mapping[str, str] | None = None, **options: Any) -> PistonRecord:
        """Make a record from a DataFrame, an xarray object, or a mapping of names to arrays.

        Names and units are interpreted as in a file; see `from_file`.

        Parameters
        ----------
        table : DataFrame, xarray object or mapping
            Table with columns of time and height, n values each.
        units : mapping of str to str, optional
            Units of columns by name; they replace the units in the table.
        **options
            Options of `from_file`.

        Returns
        -------
        PistonRecord
            Record with time [s], height [m] or angle [rad], and the other columns of the table.

        Raises
        ------
        RecordError
            If ``table`` is not a table or holds no record, or an option is not valid.

        Examples
        --------
        >>> from reduced_models import PistonRecord
        >>> len(PistonRecord.from_table({"time": [0.0, 0.1, 0.2], "height [mm]": [61.0, 60.0, 61.0]}))
        3
        """
        from granular.records.interpret import interpret_sheet
        from granular.records.sheet import sheet_from_table

        interpretation = interpret_sheet(
            sheet_from_table(table), options_from_plain({"units": units or {}, **options})
        )
        if interpretation.notes:
            warnings.warn("; ".join(interpretation.notes), RecordWarning, stacklevel=2)
        return cls.from_interpreted_columns(interpretation)

    @classmethod
    def _read_file(
        cls,
        path: Path,
        file_format: FileFormat | None,
        units: Mapping[str, str] | None,
        options: dict[str, Any],
    ) -> PistonRecord:
        from granular.records.formats import interpret_record_file

        read_options = options_from_plain({"units": units or {}, **options})
        interpretation = interpret_record_file(path, read_options, file_format)
        try:
            record = cls.from_interpreted_columns(interpretation)
        except RecordError as error:
            raise RecordError(f"{sanitize(path)}: {error}") from None
        record = dataclasses.replace(record, source=source_of_file(path, read_options, interpretation.notes))
        if interpretation.notes:
            warnings.warn(f"{sanitize(path)}: {'; '.join(interpretation.notes)}", RecordWarning, stacklevel=3)
        return record

    @classmethod
    def from_interpreted_columns(cls, interpretation: SheetInterpretation) -> PistonRecord:
        """Make a record from interpreted columns; see `granular.records`.

        Parameters
        ----------
        interpretation : SheetInterpretation
            Columns of a file with roles and units.

        Returns
        -------
        PistonRecord
            Record in SI units.

        Raises
        ------
        RecordError
            If the columns do not form a record, or a stroke is given without a force.
        """
        record = cls.from_columns(interpretation.columns)
        if interpretation.prescribed and record.force is None:
            raise RecordError("a stroke needs a measured force; give the column of the force, force=...")
        measured = "force" if interpretation.prescribed else record.measured
        return dataclasses.replace(
            record,
            coordinate_unit=interpretation.coordinate_unit,
            deviations=interpretation.deviations,
            measured=measured,
        )

    def to_csv(self, path: str | Path) -> None:
        """Write `columns` to a CSV file, from which `from_csv` restores exactly the same numbers.

        If the record has no position, `from_csv` needs the name of the velocity or acceleration in
        ``columns``. The file contains neither ``deviations`` nor ``measured``.

        Parameters
        ----------
        path : str or Path
            File to write; an existing file is replaced.

        Raises
        ------
        InputError
            If the file cannot be written; an existing file is kept.
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
        """Write `columns` to a Parquet file for `from_parquet`; the restrictions of `to_csv` apply.

        Parameters
        ----------
        path : str or Path
            File to write; an existing file is replaced.

        Raises
        ------
        RecordError
            If pyarrow is not installed.
        InputError
            If the file cannot be written; an existing file is kept.
        """
        from granular.records.binary import write_parquet

        write_parquet(Path(path), self.columns, self.units)

    @property
    def units(self) -> dict[str, str]:
        """SI units of time, height, velocity and force, as a dict by name, even if a column is missing."""
        return {**UNITS, "height": self.coordinate_unit, "velocity": f"{self.coordinate_unit}/s"}

    @property
    def coordinate(self) -> str:
        """Name of the coordinate: "height", or "angle"."""
        return COORDINATES[self.coordinate_unit]

    @property
    def signal(self) -> np.ndarray:
        """Values of the measured quantity, float64 (n,), in `signal_unit`."""
        return self.columns[self.measured] if self.measured in (*_INTEGRALS, "force") else self.height

    @property
    def signal_unit(self) -> str:
        """SI unit of `signal`, such as "m", or "m/s^2" for an acceleration."""
        if self.measured == "force":
            return UNITS["force"]
        return self.units["height"] + ("", "/s", "/s^2")[_INTEGRALS.get(self.measured, 0)]

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns as a dict of float64 (n,) in SI by name; an integrated height is omitted."""
        standard = {name: getattr(self, name) for name in UNITS if getattr(self, name) is not None}
        if self.measured in _INTEGRALS:
            del standard["height"]
        return standard | dict(self.extra)

    @classmethod
    def from_columns(cls, columns: Mapping[str, Sequence[float] | np.ndarray]) -> PistonRecord:
        """Make a record from columns in SI units; columns with other names become ``extra``.

        Parameters
        ----------
        columns : mapping of str to array (n,)
            Columns in SI; ``time`` and one of ``height``, ``velocity`` and ``acceleration`` are needed.

        Returns
        -------
        PistonRecord
            Record whose ``measured`` is the name of the given motion.

        Raises
        ------
        RecordError
            If ``time`` or the motion is missing, or the values do not form a `PistonRecord`.
        """
        measured = next((name for name in ("height", *_INTEGRALS) if name in columns), "height")
        for name in ("time", measured):
            if name not in columns:
                raise RecordError(
                    f"the column {quote(name)} is missing; give time, and height, velocity or acceleration"
                )
        standard = {name: columns[name] for name in UNITS if name in columns}
        extra = {name: values for name, values in columns.items() if name not in UNITS}
        standard.setdefault("height", np.zeros(np.shape(columns["time"])))
        record = cls(**standard, extra=extra, measured=measured)  # type: ignore[arg-type]  # by names
        if measured == "height":
            return record
        height = integrate_without_drift(record.time, record.signal, _INTEGRALS[measured])
        return dataclasses.replace(record, height=height)

    def between(self, start: float, stop: float) -> PistonRecord:
        """Return the samples with start <= time <= stop [s].

        Parameters
        ----------
        start, stop : float
            First and last time [s].

        Returns
        -------
        PistonRecord
            Part of the record; its times are kept as they are.

        Raises
        ------
        RecordError
            If fewer than two samples lie between the limits, or a limit is NaN.

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
            Mask that is True for the samples to keep, or increasing indices of these samples.

        Returns
        -------
        PistonRecord
            Record with these samples; its times are kept as they are.

        Raises
        ------
        RecordError
            If fewer than two samples are selected, or their times do not increase.
        IndexError
            If the record has no such samples.
        """
        standard = {name: getattr(self, name)[samples] for name in UNITS if getattr(self, name) is not None}
        extra = {key: values[samples] for key, values in self.extra.items()}
        deviations = {key: values[:, samples] for key, values in self.deviations.items()}
        return dataclasses.replace(self, **standard, extra=extra, deviations=deviations)

    def first(self, count: int) -> PistonRecord:
        """Return the first ``count`` samples.

        Parameters
        ----------
        count : int
            Number of samples, 2 or more; the complete record if it has fewer.

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
        """Return the record in the coordinate z = (height - shift)/scale.

        Parameters
        ----------
        shift, scale : float
            Height at z = 0, and height per unit of z, which must not be 0; both in m, or in rad for an angle.

        Returns
        -------
        PistonRecord
            Record with z and dz/dt [1/s] as height and velocity; `units` and all else are unchanged.

        Raises
        ------
        RecordError
            If z is not finite, for example if the scale is 0.

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
