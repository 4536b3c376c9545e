"""Predict the signal of a sensor at the times of a record, and force cycles along a harmonic stroke."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.blocks import align_columns
from granular.shared.errors import InputError, quote
from reduced_models.laws.solution import observed_signal, solve_law
from reduced_models.models.at_rest import HarmonicCycle
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.prediction import interval_half_widths
from reduced_models.records.derivatives import derivatives
from reduced_models.records.inputs import STROKE, input_column, with_stroke_columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_NODES, _TURNS = 400, 3
"""Number of samples per harmonic cycle, and number of simulated cycles; only the last cycle is evaluated."""
_ALIKE = 0.05  # maximum relative difference of amplitude and frequency of cycles averaged in one row
_NEAR = 0.1  # maximum distance of their centres, relative to the amplitude
_MOST_ROWS = 12
CYCLE_COLUMNS = (
    "amplitude [mm]",
    "frequency [Hz]",
    "",
    "loss per cycle [J]",
    "stiffness [N/m]",
    "damping [N s/m]",
)


def simulate_observation(model: FittedLaw, record: PistonRecord) -> Float[np.ndarray, "n"]:
    """Return the signal of the model's sensor at the times of a record."""
    values = list(model.all_parameters.values())
    hidden = [model.hidden.get(name, 0.0) for name in model.law.hidden]
    signal = _observed_signal_with_values(model, record, values, hidden)
    sensor = model.sensor
    return signal if sensor is None else sensor.nominal_gain * signal + sensor.nominal_offset


def _observed_signal_with_values(
    model: FittedLaw, record: PistonRecord, values: Sequence[float], hidden: Sequence[float]
) -> np.ndarray:
    """Return the observed quantity, without gain and offset, for given parameters and hidden states."""
    law, given = model.law, with_stroke_columns(record) if model.law.prescribed else record
    inputs = [input_column(given, name) for name in law.inputs]
    size = float(np.ptp(model.domain.get("height", (0.0, 1.0))))
    how = model.input_interpolation
    solution = solve_law(law, record.time, *model.initial, values, size, inputs, hidden, how)
    if solution.ending != "complete":
        raise InputError(
            f"the solution of the law {quote(law.name)} does not reach the end of the record: the solution "
            "diverges, or is too fast for the samples; give a record with more samples"
        )
    return observed_signal(law, model.observation, solution, values, inputs)


def plot_force_loops(model: FittedLaw, record: PistonRecord | None, ax: Axes) -> Axes:
    """Draw the measured and the modelled quantity against the stroke [mm]."""
    if record is None:
        raise InputError(
            f"the law {quote(model.law.name)} needs a record that prescribes its motion; pass such a record"
        )
    stroke, name = 1e3 * record.height, model.observation
    if name in record.columns:
        ax.plot(stroke, record.columns[name], ".", markersize=2, label="measured")
    ax.plot(stroke, simulate_observation(model, record), label=model.law.name)
    ax.set(xlabel="stroke [mm]", ylabel=f"{name} [N]" if name == "force" else name)
    ax.legend()
    return ax


def simulate_force_cycle(
    model: FittedLaw, amplitude: float, frequency: float | None, centre: float | None = None
) -> HarmonicCycle:
    """Return the steady force cycle for a harmonic stroke; lengths are in m, ``frequency`` in rad/s."""
    # First Fourier coefficients of the force in phase with stroke and velocity (Krylov and Bogoliubov 1947,
    # Introduction to Non-Linear Mechanics). Hidden states start at zero; the last cycle counts as steady.
    for name, value in (("amplitude", amplitude), ("frequency", frequency)):
        if value is None or not 0.0 < value < math.inf:
            raise InputError(f"{name} = {value}; give a number above 0")
    assert frequency is not None
    columns = [name for name in model.law.inputs if name not in STROKE]
    if columns:
        raise InputError(
            f"the law has the inputs {', '.join(columns)}, so its cycles depend on the record; compute the "
            "signal with .simulate_signal(record)"
        )
    if centre is None and "height" not in model.domain:
        raise InputError("the model has no range of heights; give centre, the middle of the stroke [m]")
    middle = sum(model.domain["height"]) / 2.0 if centre is None else centre
    time = np.arange(_TURNS * _NODES + 1) * (2.0 * math.pi / (_NODES * frequency))
    wave, turn = np.sin(frequency * time), np.cos(frequency * time)
    stroke = PistonRecord(time, middle + amplitude * wave, velocity=amplitude * frequency * turn)
    last = slice(-_NODES, None)

    def stiffness_damping_and_energy(model: FittedLaw) -> np.ndarray:
        still, values = [0.0] * len(model.law.hidden), list(model.all_parameters.values())
        force = _observed_signal_with_values(model, stroke, values, still)[last]
        stiffness = 2.0 / (_NODES * amplitude) * (wave[last] @ force)
        damping = 2.0 / (_NODES * amplitude * frequency) * (turn[last] @ force)
        return np.array([stiffness, damping, math.pi * frequency * amplitude**2 * damping])

    here = stiffness_damping_and_energy(model)
    errors = interval_half_widths(model, stiffness_damping_and_energy, here)
    assert errors is not None
    stiffness, damping, energy = map(float, here)
    sure = tuple(map(float, errors))
    return HarmonicCycle(amplitude, frequency, middle, stiffness, damping, energy, sure)


def measured_cycles_with_cycles_of_law(model: FittedLaw) -> list[tuple[HarmonicCycle, HarmonicCycle | None]]:
    """Return the measured force cycles, each with the law's cycle (None if the law has inputs)."""
    by_law = set(model.law.inputs) <= set(STROKE)
    return [
        (
            cycle,
            simulate_force_cycle(model, cycle.amplitude, cycle.frequency, cycle.centre) if by_law else None,
        )
        for cycle in model.cycles[:_MOST_ROWS]
    ]


def force_cycle_rows(model: FittedLaw) -> list[tuple[str, ...]]:
    """Return rows of the table of measured and modelled force cycles, with the columns `CYCLE_COLUMNS`."""
    rows = []
    for measured_and_lawful in measured_cycles_with_cycles_of_law(model):
        for kind, cycle in zip(("measured", "law"), measured_and_lawful, strict=True):
            if cycle is not None:
                stiffness, damping, energy = cycle.errors
                pairs = ((cycle.energy, energy), (cycle.stiffness, stiffness), (cycle.damping, damping))
                cells = (
                    f"{value:.4g}" + (f" ± {error:.2g}" if math.isfinite(error) and error > 0.0 else "")
                    for value, error in pairs
                )
                start = (f"{1e3 * cycle.amplitude:.4g}", f"{cycle.frequency / (2.0 * math.pi):.4g}", kind)
                rows.append((*start, *cells))
    return rows


def force_cycle_lines(model: FittedLaw) -> list[str]:
    """Return the lines of the table of force cycles; empty without cycles."""
    rows = force_cycle_rows(model)
    return [f"  {line}" for line in align_columns([CYCLE_COLUMNS, *rows]).splitlines()] if rows else []


def measure_stroke_cycles(
    records: Sequence[PistonRecord], forces: Sequence[np.ndarray]
) -> tuple[HarmonicCycle, ...]:
    """Return the measured cycles of strokes, smallest first, with similar cycles averaged; forces in N."""
    # Errors are two standard errors of the mean.
    every = [row for pair in zip(records, forces, strict=True) for row in _measure_cycles_of_record(*pair)]
    groups: list[list[np.ndarray]] = []
    for row in every:
        alike = [
            group
            for group in groups
            if abs(group[0][2] - row[2]) < _NEAR * group[0][0]
            and np.allclose(group[0][:2], row[:2], rtol=_ALIKE, atol=0.0)
        ]
        if alike:
            alike[0].append(row)
        else:
            groups.append([row])
    cycles = []
    for group in groups:
        rows = np.array(group)
        scatter = rows[:, 3:].std(axis=0, ddof=1) if len(rows) > 1 else np.full(3, math.nan)
        errors = tuple(map(float, 2.0 / math.sqrt(len(rows)) * scatter))
        amplitude, frequency, centre, stiffness, damping, energy = map(float, rows.mean(axis=0))
        cycles.append(
            HarmonicCycle(amplitude, frequency, centre, stiffness, damping, energy, errors, len(rows))
        )
    return tuple(sorted(cycles))


def _measure_cycles_of_record(record: PistonRecord, force: np.ndarray) -> list[np.ndarray]:
    """Return amplitude, frequency, centre, stiffness, damping and energy of each complete stroke cycle."""
    smooth = derivatives(record)
    time, z, velocity = record.time, smooth.height, smooth.velocity
    middle, half = 0.5 * (z.max() + z.min()), 0.25 * np.ptp(z)
    # An upward crossing of the middle counts only after a crossing of the level a quarter below it.
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
        energy = np.trapezoid(force[part] * velocity[part], time[part])
        stiffness = np.trapezoid((force[part] - force[part].mean()) * swing, time[part])
        stiffness /= np.trapezoid(swing**2, time[part])
        damping = energy * period / (2.0 * math.pi**2 * amplitude**2)
        rows.append(np.array([amplitude, 2.0 * math.pi / period, z[part].mean(), stiffness, damping, energy]))
    return rows
