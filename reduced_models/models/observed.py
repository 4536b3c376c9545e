"""Observations of a model along a record: the signal of its law, and cycles of its force."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from granular.run.piston_record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.message_text import quote
from reduced_models.least_squares.residuals import GriddedRecord, record_on_grid, residual_function
from reduced_models.least_squares.samples import grid_over_record
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.harmonic_cycle import HarmonicCycle
from reduced_models.models.roll_out import search_vector_of_model
from reduced_models.records.derivatives import derivatives
from reduced_models.records.first_guesses import first_guesses
from reduced_models.records.inputs import STROKE, with_stroke_columns

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.axes import Axes


_STEPS = 64  # of a period
_SOLVED, _MOST_STEPS = 1e-9, 2**21  # of the signal: change by half the step that is enough
_NODES, _TURNS = 400, 3
"""Samples of a harmonic cycle, and cycles after which hidden states are taken to repeat."""
_STEP = 1e-5  # of a parameter, over its standard deviation, for slopes
_ALIKE = 0.05  # relative difference of amplitudes and frequencies of cycles that are one row
_MOST_ROWS = 12


def observed_signal(model: FittedLaw, record: PistonRecord) -> Float[np.ndarray, "n"]:
    """Signal of the model's observation at the times of a record, as its sensor shows it."""
    grid, theta = _gridded_model(model, record)
    signal = grid.fitted_signal(theta)
    while model.law.hidden or not model.law.prescribed:
        if 2 * grid.grid.steps > _MOST_STEPS:
            raise InputError(
                f"the law {quote(model.law.name)} changes too fast for {_MOST_STEPS} steps over the record; "
                "take a shorter one"
            )
        grid = grid.on_grid(grid.grid.finer)
        before, signal = signal, grid.fitted_signal(theta)
        if np.abs(signal - before).max() <= _SOLVED * max(float(np.ptp(signal)), 1e-300):
            break
    return signal


def _gridded_model(model: FittedLaw, record: PistonRecord) -> tuple[GriddedRecord, np.ndarray]:
    """Record on a grid, its heights zero in place of the signal, and the model's search vector."""
    total = record.with_time_from_zero()
    guess = first_guesses(total.time, total.height)
    unknowns, theta = search_vector_of_model(model, guess)
    if model.law.prescribed:
        total = with_stroke_columns(total)
        count = unknowns.parameter_and_map_count
        theta[count : count + 2] = 0.0
    low, high = model.domain.get(model.observation, (-1.0, 1.0))
    unknowns = dataclasses.replace(
        unknowns, sensor=model.sensor, observation=model.observation, signal=max(high - low, 1e-300)
    )
    total = dataclasses.replace(total, height=np.zeros(len(total)))
    steps = grid_over_record(total, model.law.inputs, guess.period, _STEPS * model.law.step_ratio)
    return record_on_grid(unknowns, total, steps, model.input_interpolation), theta


def plot_loops(model: FittedLaw, record: PistonRecord | None, ax: Axes) -> Axes:
    """Draw what is observed along a record's stroke, measured and by the law, over the stroke [mm]."""
    if record is None:
        raise InputError(f"the record prescribes the motion of the law {quote(model.law.name)}; give one")
    stroke, name = 1e3 * record.height, model.observation
    if name in record.columns:
        ax.plot(stroke, record.columns[name], ".", markersize=2, label="measured")
    ax.plot(stroke, observed_signal(model, record), label=model.law.name)
    ax.set(xlabel="stroke [mm]", ylabel=f"{name} [N]" if name == "force" else name)
    ax.legend()
    return ax


def force_cycle(
    model: FittedLaw, amplitude: float, frequency: float | None, centre: float | None = None
) -> HarmonicCycle:
    """Steady cycle of a force along a harmonic stroke; amplitude, centre [m], frequency [rad/s]."""
    # First Fourier coefficients of the force along the stroke and the velocity (Krylov and Bogoliubov 1947,
    # Introduction to Non-Linear Mechanics). Hidden states start at zero; the last cycle is the steady one.
    for name, value in (("amplitude", amplitude), ("frequency", frequency)):
        if value is None or not 0.0 < value < math.inf:
            raise InputError(f"{name} = {value}; give a number above 0")
    assert frequency is not None
    columns = [name for name in model.law.inputs if name not in STROKE]
    if columns:
        raise InputError(
            f"the law has the inputs {', '.join(columns)}; take cycles from .simulate_signal(record)"
        )
    if centre is None and "height" not in model.domain:
        raise InputError("the model has no range of heights; give centre, the middle of the stroke")
    middle = sum(model.domain["height"]) / 2.0 if centre is None else centre
    time = np.arange(_TURNS * _NODES + 1) * (2.0 * math.pi / (_NODES * frequency))
    wave, turn = np.sin(frequency * time), np.cos(frequency * time)
    stroke = PistonRecord(time, middle + amplitude * wave, velocity=amplitude * frequency * turn)
    plain: FittedLaw = dataclasses.replace(cast("Any", model), hidden={}, sensor=None)
    grid, theta = _gridded_model(plain, stroke)
    count = len(model.law.parameters)
    spread = np.sqrt(np.maximum(np.diag(model.covariance)[:count], 0.0))
    values = np.array([model.parameters[name] for name in model.law.parameters])
    logs = np.array([name in model.law.positive for name in model.law.parameters])
    steps = _STEP * spread / np.where(logs, values, grid.unknowns.units)
    batch = np.vstack([theta, theta + np.hstack([np.diag(steps), np.zeros((count, len(theta) - count))])])
    left = residual_function(grid.unknowns, "several")(batch, grid.samples, grid.unknowns.scales)
    forces = grid.unknowns.residual_unit * np.asarray(left)[: len(time)][-_NODES:]
    last = slice(-_NODES, None)
    stiffness = 2.0 / (_NODES * amplitude) * (wave[last] @ forces)
    damping = 2.0 / (_NODES * amplitude * frequency) * (turn[last] @ forces)
    figures = np.stack([stiffness, damping, math.pi * frequency * amplitude**2 * damping])
    slopes = (figures[:, 1:] - figures[:, :1]) / np.where(spread > 0.0, _STEP * spread, np.inf)
    variance = np.einsum("ij,jk,ik->i", slopes, model.covariance[:count, :count], slopes)
    errors = model.quantile * np.sqrt(np.maximum(variance, 0.0))
    stiff, damp, energy = map(float, figures[:, 0])
    return HarmonicCycle(amplitude, frequency, middle, stiff, damp, energy, tuple(map(float, errors)))


def measured_and_lawful_cycles(model: FittedLaw) -> list[tuple[HarmonicCycle, HarmonicCycle | None]]:
    """Cycles of the force as measured, each with the law's; of a law with inputs there is none."""
    by_law = set(model.law.inputs) <= set(STROKE)
    return [
        (cycle, force_cycle(model, cycle.amplitude, cycle.frequency) if by_law else None)
        for cycle in model.cycles[:_MOST_ROWS]
    ]


def cycle_table(model: FittedLaw) -> list[str]:
    """Cycles of the force as measured, with those of the law, as lines."""
    rows = []
    for cycle, law in measured_and_lawful_cycles(model):
        hertz = cycle.frequency / (2.0 * math.pi)
        rows.append(_cycle_row(cycle, f"{cycle.amplitude:13.3g} {hertz:14.4g}", "measured"))
        if law is not None:
            rows.append(_cycle_row(law, " " * 28, "law"))
    head = f"{'amplitude [m]':>13} {'frequency [Hz]':>14} {'':8} {'loss per cycle [J]':>22}"
    return [f"{head} {'stiffness [N/m]':>22} {'damping [N s/m]':>22}", *rows] if rows else []


def _cycle_row(cycle: HarmonicCycle, start: str, kind: str) -> str:
    figures = (cycle.energy, cycle.stiffness, cycle.damping)
    stiffness, damping, energy = cycle.errors
    pairs = (
        f"{value:.4g}" + (f" +- {error:.2g}" if math.isfinite(error) else "")
        for value, error in zip(figures, (energy, stiffness, damping), strict=True)
    )
    return f"{start} {kind:8} " + " ".join(f"{pair:>22}" for pair in pairs)


def stroke_cycles(records: Sequence[PistonRecord], forces: Sequence[np.ndarray]) -> tuple[HarmonicCycle, ...]:
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
        scatter = rows[:, 3:].std(axis=0, ddof=1) if len(rows) > 1 else np.full(3, math.nan)
        errors = tuple(map(float, 2.0 / math.sqrt(len(rows)) * scatter))
        amplitude, frequency, centre, stiffness, damping, energy = map(float, rows.mean(axis=0))
        cycles.append(
            HarmonicCycle(amplitude, frequency, centre, stiffness, damping, energy, errors, len(rows))
        )
    return tuple(sorted(cycles))


def _cycles_of_record(record: PistonRecord, force: np.ndarray) -> list[np.ndarray]:
    """Amplitude, frequency, centre, stiffness, damping and energy of each whole cycle of a stroke."""
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
        energy = np.trapezoid(force[part] * velocity[part], time[part])
        stiffness = np.trapezoid((force[part] - force[part].mean()) * swing, time[part])
        stiffness /= np.trapezoid(swing**2, time[part])
        damping = energy * period / (2.0 * math.pi**2 * amplitude**2)
        rows.append(np.array([amplitude, 2.0 * math.pi / period, z[part].mean(), stiffness, damping, energy]))
    return rows
