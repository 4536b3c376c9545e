"""Overview of a record's file: columns, sampling, noise and a plot in characters."""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.records.formats import interpret_record_file
from granular.records.interpret import SheetInterpretation
from granular.records.options import ReadOptions
from granular.records.record import PistonRecord
from granular.shared.errors import RecordError, RecordWarning, sanitize
from reduced_models.records.derivatives import noise_standard_deviation, sensor_rounding_step
from reduced_models.records.free_motion import find_free_motion
from reduced_models.records.sensor_artefacts import end_time_of_motion
from reduced_models.records.sources import options_with_description

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GAP_RATIO = 2.5
"""A time step longer than this multiple of the usual one is a gap."""
_WIDTH, _ROWS = 68, 12


@dataclasses.dataclass(frozen=True)
class RecordOverview:
    """Record with the properties that a user should check before a fit.

    Attributes
    ----------
    record : PistonRecord
    meaning : SheetInterpretation
        Role of each column.
    rate : float
        Sampling rate [1/s].
    gaps : int
        Number of gaps: time steps longer than 2.5 times the usual step.
    noise : float
        Standard deviation of the coordinate's white noise, in its unit.
    level : float or None
        Rounding step of the sensor, in the coordinate's unit; None if it does not round.
    useful : float
        Time [s] after which the displacement is hardly larger than the noise.
    """

    record: PistonRecord
    meaning: SheetInterpretation
    rate: float
    gaps: int
    noise: float
    level: float | None
    useful: float

    def to_plain(self) -> dict[str, Any]:
        """Return the interpretation of the file and its properties as plain data."""
        record = self.record
        return {
            "form": self.meaning.form,
            "columns": dict(self.meaning.source),
            "units": dict(self.meaning.units),
            "further_columns": sorted(record.extra),
            "left_out": list(self.meaning.omitted_columns),
            "notes": list(self.meaning.notes),
            "samples": len(record),
            "from": float(record.time[0]),
            "until": float(record.time[-1]),
            "rate": self.rate,
            "gaps": self.gaps,
            "least": float(record.signal.min()),
            "greatest": float(record.signal.max()),
            "unit": record.signal_unit,
            "noise": self.noise,
            "level": self.level,
            "useful": self.useful,
        }

    def __str__(self) -> str:
        record, unit = self.record, self.record.signal_unit
        low, high = record.signal.min(), record.signal.max()
        quantity = "coordinate" if record.measured in ("height", "force") else record.measured
        lines = [f"read as {self.meaning.form}"]
        for role, name in self.meaning.source.items():
            lines.append(
                f"  {role:9} from {sanitize(name) or 'a column without a name'} [{self.meaning.units[role]}]"
            )
        if record.extra:
            lines.append(f"  further   {', '.join(map(sanitize, sorted(record.extra)))}")
        if self.meaning.omitted_columns:
            lines.append(f"  omitted   {', '.join(map(sanitize, self.meaning.omitted_columns))}: no numbers")
        start, stop = record.time[0], record.time[-1]
        lines += [
            f"{len(record)} samples from {start:.4g} to {stop:.4g} s, {self.rate:.4g} a second"
            + (f", {self.gaps} gaps" if self.gaps else ""),
            f"{quantity} from {low:.5g} to {high:.5g} {unit}, noise {self.noise:.2g} {unit}"
            + (f"; the sensor rounds to {self.level:.2g} {unit}" if self.level else ""),
            f"the motion is above the noise until {self.useful:.4g} s",
        ]
        lines += [f"note: {sanitize(note)}" for note in self.meaning.notes]
        return "\n".join([*lines, "", *_plot_motion_in_characters(record)])


def overview_of_record_file(path: str | Path, options: ReadOptions | None = None) -> RecordOverview:
    """Read a file, and return the record with its interpretation and properties."""
    path, options = Path(path), options or ReadOptions()
    meaning = interpret_record_file(path, options)
    try:
        record = PistonRecord.from_interpreted_columns(meaning)
    except RecordError as error:
        raise RecordError(f"{sanitize(path)}: {error}") from None
    stated = options_with_description(path, options)
    if stated.between is None:
        with warnings.catch_warnings(record=True, action="always", category=RecordWarning) as caught:
            record = find_free_motion(record, stated.release)
        notes = (*meaning.notes, *(str(warning.message) for warning in caught))
        meaning = dataclasses.replace(meaning, notes=notes)
    steps = np.diff(record.time)
    usual = float(np.median(steps))
    noise = noise_standard_deviation(record.signal, record.time) if len(record) > 8 else 0.0
    return RecordOverview(
        record,
        meaning,
        1.0 / usual,
        int((steps > GAP_RATIO * usual).sum()),
        float(noise),
        sensor_rounding_step(record.signal) or None,
        end_time_of_motion(record),
    )


def _plot_motion_in_characters(record: PistonRecord) -> list[str]:
    """Plot the motion in characters, for a terminal."""
    signal = record.signal
    extent = float(np.ptp(signal)) or 1.0
    position = (record.time - record.time[0]) / (record.time[-1] - record.time[0])
    columns = np.minimum((position * _WIDTH).astype(int), _WIDTH - 1)
    rows = ((signal - signal.min()) / extent * (_ROWS - 1)).round().astype(int)
    counts = np.zeros((_ROWS, _WIDTH), dtype=int)
    np.add.at(counts, (rows, columns), 1)
    return ["".join("*" if count else " " for count in row).rstrip() for row in counts[::-1]]


def plot_overview(overview: RecordOverview) -> Figure:
    """Plot the motion [m or rad] against time [s]; mark the time after which it is lost in the noise."""
    from granular.shared.plotting import COLOURS, GREY, figure

    with figure(width=7.0, height=3.0) as (drawing, axes):
        record = overview.record
        axes.plot(record.time, record.signal, color=COLOURS[0], linewidth=1)
        axes.axvline(overview.useful, color=GREY, linestyle=":")
        axes.set(xlabel="time [s]", ylabel=f"{record.measured} [{record.signal_unit}]")
        axes.set_title("right of the dotted line the motion is within the noise", fontsize=9)
        return drawing
