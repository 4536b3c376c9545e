"""A law of the force on a prescribed stroke, with its numbers: forces, loops, and what they dissipate."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.run.piston_record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.files import write_json
from reduced_models.laws.force_law import ForceLaw
from reduced_models.least_squares.stroke import compiled_force_function, stroke_of_record
from reduced_models.models.quality import Quality
from reduced_models.records.derivatives import derivatives

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_NODES, _TURNS = 400, 3
"""Samples of a harmonic cycle, and cycles after which hidden states are taken to repeat."""
_STEP = 1e-5  # of a parameter, over its standard deviation, for slopes
_ALIKE = 0.05  # relative difference of amplitudes and frequencies of cycles that are one row
_MOST_ROWS = 12


class ForceCycle(NamedTuple):
    """A cycle of a stroke: energy that it takes, and the stiffness and the damping that it shows.

    Attributes
    ----------
    amplitude, frequency : float
        [m], [Hz]
    loss : float
        Area of its loop [J].
    stiffness : float
        In-phase force over the stroke [N/m].
    damping : float
        Of the dashpot that takes as much energy [N s/m].
    errors : (float, float, float)
        Half-widths of the intervals of the three.
    cycles : int
        Number of cycles that were measured; 0 of a law.
    """

    amplitude: float
    frequency: float
    loss: float
    stiffness: float
    damping: float
    errors: tuple[float, float, float]
    cycles: int = 0


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class ForceModel:
    """A law of a force with numbers.

    Attributes
    ----------
    law : ForceLaw
        Law of the force that moves the coordinate upwards.
    parameters : mapping of str to float
        In the units of ``law.units``.
    intervals : mapping of str to (float, float)
        Confidence intervals of the parameters, in their units; of no width for a given one.
    confidence : float
        Confidence level of the intervals, between 0 and 1.
    quantile : float
        Half-width of an interval over the standard deviation.
    covariance : float64 (p, p)
        Covariance of the parameters, in their order and units.
    quality : Quality
        Quality of the fit; its residual and noise are in N.
    cycles : tuple of ForceCycle
        As measured: cycles of the records that are alike are one.
    domain : mapping of str to (float, float)
        Range of heights [m] and velocities [m/s] seen.
    hidden : mapping of str to float
        Hidden states at the first record's start, in the law's units.
    sign : float
        Sign of the measured force, 1 or -1; -1 where it is the reaction of what is moved.
    notes : tuple of str
        Warnings in plain words.
    provenance : mapping of str to str
        Data and fit that the model comes from.
    """

    law: ForceLaw
    parameters: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    confidence: float
    quantile: float
    covariance: np.ndarray
    quality: Quality
    cycles: tuple[ForceCycle, ...] = ()
    domain: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    hidden: Mapping[str, float] = dataclasses.field(default_factory=dict)
    sign: float = 1.0
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def text(self) -> str:
        """Equation with the fitted numbers, to five digits, and the rates of hidden states."""
        return self.law.text(self.parameters)

    def forces(self, record: PistonRecord) -> np.ndarray:
        """Return the forces along the stroke of a record, with the sign of the measured ones.

        The stroke is smoothed first; hidden states start as at the start of the first record fitted.

        Parameters
        ----------
        record : PistonRecord
            Stroke, heights (n,) [m], with the columns that are inputs of the law; n is 20 or more.

        Returns
        -------
        float64 (n,)
            Forces [N], without the gain and offset of a load cell.

        Raises
        ------
        RecordError
            If the record has fewer than 20 samples, or lacks an input of the law.
        """
        values = np.array([self.parameters[name] for name in self.law.parameters])
        start = np.array([self.hidden.get(name, 0.0) for name in self.law.hidden])
        return self.sign * self._forces_with_values(record, values[:, None], start[:, None])[:, 0]

    def _forces_with_values(self, record: PistonRecord, values: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Return forces (n, s) by values (p, s), from hidden states (h, s)."""
        field = self.law.acceleration_law
        function = compiled_force_function(field.equation, field.inputs)
        return np.asarray(function(tuple(values), start, stroke_of_record(record, field)))

    def residuals(self, record: PistonRecord) -> np.ndarray:
        """Measured forces less those of the law, `forces`.

        Parameters
        ----------
        record : PistonRecord
            Stroke, heights (n,) [m], with the measured forces (n,) [N]; n is 20 or more.

        Returns
        -------
        float64 (n,)
            Residuals [N].

        Raises
        ------
        InputError
            If the record holds no force.
        RecordError
            If the record has fewer than 20 samples, or lacks an input of the law.
        """
        if record.force is None:
            raise InputError("the record holds no force; give one with a column force")
        return record.force - self.forces(record)

    def harmonic_cycle(self, amplitude: float, frequency: float, centre: float | None = None) -> ForceCycle:
        """Steady harmonic cycle by the law, with what the parameters' errors leave open.

        The stiffness and the damping are the first Fourier coefficients of the force, along the stroke
        and the velocity (Krylov and Bogoliubov 1947, Introduction to Non-Linear Mechanics). Hidden
        states start at zero; the third cycle is taken for the steady one.

        Parameters
        ----------
        amplitude : float
            Half of the stroke [m].
        frequency : float
            Cycles a second [Hz], no angular frequency.
        centre : float, optional
            Height of its middle [m]; that of the range of heights seen if not given.

        Returns
        -------
        ForceCycle
            Energy [J], stiffness [N/m] and damping [N s/m] of the force that moves the stroke, with
            the half-widths of their intervals (zero where all parameters are given).

        Raises
        ------
        InputError
            If amplitude or frequency is not above zero and finite, the law has inputs, or the centre
            is not finite, or not given while the model has no range of heights.
        """
        for name, value in (("amplitude", amplitude), ("frequency", frequency)):
            if not 0.0 < value < math.inf:
                raise InputError(f"{name} = {value}; give a number above 0")
        if self.law.inputs:
            raise InputError(
                f"the law has the inputs {', '.join(self.law.inputs)}; take cycles from .forces(record)"
            )
        if centre is None and "height" not in self.domain:
            raise InputError("the model has no range of heights; give centre, the middle of the stroke")
        middle = sum(self.domain["height"]) / 2.0 if centre is None else centre
        omega = 2.0 * math.pi * frequency
        time = np.arange(_TURNS * _NODES + 1) / (_NODES * frequency)
        phase = omega * time
        record = PistonRecord(
            time, middle + amplitude * np.sin(phase), velocity=amplitude * omega * np.cos(phase)
        )
        values = np.array([self.parameters[name] for name in self.law.parameters])
        steps = _STEP * np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        batch = np.column_stack([values, values[:, None] + np.diag(steps)])
        last = slice(-_NODES, None)
        still = np.zeros((len(self.law.hidden), batch.shape[1]))
        forces = self._forces_with_values(record, batch, still)[last]
        damping, stiffness = (
            2.0 / (_NODES * size) * (wave[last] @ forces)
            for size, wave in ((amplitude * omega, np.cos(phase)), (amplitude, np.sin(phase)))
        )
        figures = np.stack([math.pi * omega * amplitude**2 * damping, stiffness, damping])
        open_ones = steps > 0.0
        slopes = (figures[:, 1:] - figures[:, :1])[:, open_ones] / steps[open_ones]
        covariance = self.covariance[np.ix_(open_ones, open_ones)]
        spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, covariance, slopes), 0.0))
        loss, stiff, damp = map(float, figures[:, 0])
        first, second, third = map(float, self.quantile * spread)
        return ForceCycle(amplitude, frequency, loss, stiff, damp, (first, second, third))

    def plot(self, record: PistonRecord, ax: Axes | None = None) -> Axes:
        """Draw the loops of a record, force [N] over stroke [mm], and those of the law.

        Parameters
        ----------
        record : PistonRecord
            Stroke, heights (n,) [m], and forces (n,) [N]; without a force the law's loops alone.
        ax : Axes, optional
            Axes to draw on; new ones if not given.

        Returns
        -------
        Axes
            Axes that hold the drawing.

        Raises
        ------
        RecordError
            If the record has fewer than 20 samples, or lacks an input of the law.
        """
        from granular.shared.plotting import axes_or_new

        ax = axes_or_new(ax)
        if record.force is not None:
            ax.plot(1e3 * record.height, record.force, ".", markersize=2, label="measured")
        ax.plot(1e3 * record.height, self.forces(record), label=self.law.name)
        ax.set(xlabel="stroke [mm]", ylabel="force [N]")
        ax.legend()
        return ax

    def __repr__(self) -> str:
        return f"ForceModel {self.law.name!r}: {self.text}"

    def __str__(self) -> str:
        lines = [f"{self.law.name}: {self.law.equation}", f"  {self.text}"]
        for name, value in self.parameters.items():
            unit = self.law.units.get(name, "")
            low, high = self.intervals[name]
            known = f"[{low:.5g}, {high:.5g}]" if low < high else "(fixed in the fit)"
            lines.append(f"  {name} = {value:.5g} {unit}".rstrip() + f"  {known}")
        quality = self.quality
        led = f"; {quality.converged} of {quality.starts} starts led here" if quality.starts > 1 else ""
        lines.append(
            f"  residual {quality.residual:.3g} N ({100.0 * quality.relative:.3g} % of the rms force), "
            f"noise {quality.noise:.3g} N{led}"
        )
        if quality.test_error is not None:
            lines.append(f"  test error {100.0 * quality.test_error:.3g} % of the rms force")
        lines += [f"  {line}" for line in self._cycle_table()]
        lines += [f"  note: {note}" for note in self.notes]
        return "\n".join(lines)

    def _cycle_table(self) -> list[str]:
        """Cycles as measured, with those of the law."""
        rows = []
        for cycle in self.cycles[:_MOST_ROWS]:
            rows.append(_cycle_row(cycle, f"{cycle.amplitude:13.3g} {cycle.frequency:14.4g}", "measured"))
            if not self.law.inputs:
                rows.append(
                    _cycle_row(self.harmonic_cycle(cycle.amplitude, cycle.frequency), " " * 28, "law")
                )
        head = f"{'amplitude [m]':>13} {'frequency [Hz]':>14} {'':8} {'loss per cycle [J]':>22}"
        return [f"{head} {'stiffness [N/m]':>22} {'damping [N s/m]':>22}", *rows] if rows else []

    def to_plain(self) -> dict[str, Any]:
        """Model as plain data (numbers, texts, lists).

        Returns
        -------
        dict
            The attributes in their units, of the law its name, equation and units, and with
            ``cycles_by_law`` the cycles by the law (none where it has inputs). Numbers may be NaN or
            infinite.
        """
        law = self.law
        by_law = (
            []
            if law.inputs
            else [self.harmonic_cycle(item.amplitude, item.frequency) for item in self.cycles]
        )
        return {
            "law": {"name": law.name, "equation": law.equation, "units": dict(law.units)},
            "parameters": dict(self.parameters),
            "intervals": {name: list(pair) for name, pair in self.intervals.items()},
            "confidence": self.confidence,
            "covariance": self.covariance.tolist(),
            "quality": dataclasses.asdict(self.quality),
            "cycles": [item._asdict() for item in self.cycles],
            "cycles_by_law": [item._asdict() for item in by_law],
            "domain": {name: list(pair) for name, pair in self.domain.items()},
            "hidden": dict(self.hidden),
            "sign": self.sign,
            "notes": list(self.notes),
            "provenance": dict(self.provenance),
        }

    def save(self, path: str | Path) -> None:
        """Write the plain data of `to_plain` as JSON; NaN and infinite numbers become null.

        Parameters
        ----------
        path : str or Path
            JSON file to write; one that exists is replaced.

        Raises
        ------
        InputError
            If the directory does not exist, or the file cannot be written.
        """
        write_json(Path(path), self.to_plain())


def _cycle_row(cycle: ForceCycle, where: str, kind: str) -> str:
    figures = (cycle.loss, cycle.stiffness, cycle.damping)
    pairs = (
        f"{value:.4g}" + (f" +- {error:.2g}" if math.isfinite(error) else "")
        for value, error in zip(figures, cycle.errors, strict=True)
    )
    return f"{where} {kind:8} " + " ".join(f"{pair:>22}" for pair in pairs)


def stroke_cycles(records: Sequence[PistonRecord], forces: Sequence[np.ndarray]) -> tuple[ForceCycle, ...]:
    """Cycles of strokes as they were measured, those alike as one, the smallest first; forces [N]."""
    # Errors are two standard deviations of a mean.
    every = [row for pair in zip(records, forces, strict=True) for row in _cycles_of_record(*pair)]
    groups: list[list[np.ndarray]] = []
    for row in every:
        alike = [group for group in groups if np.allclose(group[0][:2], row[:2], rtol=_ALIKE, atol=0.0)]
        if alike:
            alike[0].append(row)
        else:
            groups.append([row])
    cycles = []
    for group in groups:
        rows = np.array(group)
        mean = rows.mean(axis=0)
        scatter = rows[:, 2:].std(axis=0, ddof=1) if len(rows) > 1 else np.full(3, math.nan)
        amplitude, frequency, loss, stiffness, damping = map(float, mean)
        first, second, third = map(float, 2.0 / math.sqrt(len(rows)) * scatter)
        cycles.append(
            ForceCycle(amplitude, frequency, loss, stiffness, damping, (first, second, third), len(rows))
        )
    return tuple(sorted(cycles))


def _cycles_of_record(record: PistonRecord, force: np.ndarray) -> list[np.ndarray]:
    """Amplitude, frequency, loss, stiffness and damping of each whole cycle of a stroke."""
    smooth = derivatives(record)
    time, z, velocity = record.time, smooth.height, smooth.velocity
    middle, half = 0.5 * (z.max() + z.min()), 0.25 * np.ptp(z)
    # A passage upwards through the middle counts after one through a quarter below it.
    starts, armed = [], False
    for k in range(1, len(z)):
        armed |= z[k] < middle - 0.5 * half
        if armed and z[k - 1] < middle <= z[k]:
            starts.append(k)
            armed = False
    rows = []
    for first, last in itertools.pairwise(starts):
        part = slice(first, last + 1)
        period = time[last] - time[first]
        swing, amplitude = z[part] - z[part].mean(), 0.5 * np.ptp(z[part])
        loss = np.trapezoid(force[part] * velocity[part], time[part])
        stiffness = np.trapezoid((force[part] - force[part].mean()) * swing, time[part])
        stiffness /= np.trapezoid(swing**2, time[part])
        damping = loss * period / (2.0 * math.pi**2 * amplitude**2)
        rows.append(np.array([amplitude, 1.0 / period, loss, stiffness, damping]))
    return rows
