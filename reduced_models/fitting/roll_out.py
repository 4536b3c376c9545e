"""Prediction of a record by a model, from the record's initial state alone."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from reduced_models.fitting.fit_data import FitData
from reduced_models.fitting.levenberg_marquardt import (
    NormalPrior,
    SearchBounds,
    levenberg_marquardt_vectors_and_costs,
)
from reduced_models.fitting.parameter import SearchUnknowns
from reduced_models.fitting.residuals import DIVERGED_RESIDUAL, grid_over_record, rms
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.records.first_guesses import FirstGuesses, first_guesses
from reduced_models.records.free_motion import find_cycles_above_noise, prediction_error_on_cycles
from reduced_models.records.sensor import sensor_of_column
from reduced_models.records.sensor_artefacts import count_samples_in_motion

_STEPS_PER_PERIOD = 128  # per period
START_PERIODS = 1.0
"""Number of periods, from the record's start on, to which the initial height and velocity are fitted."""


class RollOut(NamedTuple):
    """Prediction of a record by a model.

    Attributes
    ----------
    motion : PistonRecord
        Predicted motion at the record's times, up to the time at which it diverges.
    error : float
        Rms difference of the heights over the whole record [m]; infinite if the prediction diverges.
    relative : float
        ``error`` divided by the rms displacement of the record.
    at_rest : float
        ``relative`` for a piston that stays at the model's equilibrium, or at the mean height of the
        record if the model has no equilibrium.
    standard_error : float or None
        Standard error of ``relative``, from the scatter between cycles; None if the prediction diverges.
    """

    motion: PistonRecord
    error: float
    relative: float
    at_rest: float
    standard_error: float | None = None


def roll_out(model: FittedLaw, record: PistonRecord) -> RollOut:
    """Predict a record from its initial state alone.

    Initial height and velocity are fitted to the heights of the record's first period by least squares
    (see `levenberg_marquardt`). The model's parameters stay unchanged, and its hidden states start at
    zero. The rest of the record is predicted. Along a prescribed stroke nothing is fitted; the signal
    that the law observes is predicted instead of the heights.

    Parameters
    ----------
    model : FittedLaw
        Law with values of its parameters.
    record : PistonRecord
        Record to predict, with n >= 20 times [s] and heights [m] and the columns of the law's
        inputs.

    Returns
    -------
    RollOut
        Predicted motion (n,) [m] (for a sensor: signal in its unit), its rms error, and the ratio of
        this error to the rms displacement with a standard error; also the ratio for a piston at
        rest. If the solution diverges, the motion ends early (with 2 or more samples), ``error`` and
        ``relative`` are infinite and ``standard_error`` is None.

    Raises
    ------
    RecordError
        If the record has fewer than 20 samples, does not move, lasts more periods than can be computed,
        has heights or times beyond the computable range, or lacks an input of the law or the column
        that it observes.

    Examples
    --------
    >>> import numpy as np
    >>> from reduced_models import PistonRecord
    >>> time = np.linspace(0.0, 2.0, 2000)
    >>> record = PistonRecord(time, 0.06 + 1e-3 * np.exp(-0.8 * time) * np.cos(21.8 * time))
    >>> from reduced_models import fit, roll_out
    >>> roll_out(fit(record, law="linear"), record).relative < 1e-6
    True
    """
    total = record.with_time_from_zero()
    if model.law.prescribed:
        return _predict_signal_along_stroke(model, record)
    guess = first_guesses(total.time, total.height)
    law, (unknowns, theta) = model.law, unknowns_and_search_vector_of_model(model, guess)
    first = len(law.parameters)  # index of the first entry of the initial state
    theta[first:] = 0.0
    theta[first : first + 2] = (
        (guess.height - guess.rest) / guess.amplitude,
        guess.velocity / unknowns.speed,
    )
    reading = model.sensor or (sensor_of_column(model.observation) if model.observation else None)
    if reading is not None:
        signal = reading.signal(total.columns)
        size = max(float(np.abs(signal - signal.mean()).max()), 1e-300)
        unknowns = dataclasses.replace(
            unknowns, sensor=model.sensor, observation=model.observation, signal=size
        )
        theta = np.append(theta, np.zeros(unknowns.sensor_entry_count))
        total = dataclasses.replace(total, height=signal)
    start_samples = max(4, int(np.searchsorted(total.time, START_PERIODS * guess.period)))
    grid = grid_over_record(total, law.inputs, guess.period, _STEPS_PER_PERIOD * law.step_ratio)
    weights, how = np.ones(len(total)), model.input_interpolation
    data = FitData(unknowns, total, grid, weights, total, guess, start_samples, how)
    held = np.ones(len(theta), dtype=bool)
    held[first : first + 2] = False
    for name in law.other_coordinates:
        held[first + 2 + law.hidden.index(name)] = False
    held[len(held) - unknowns.sensor_entry_count :] = False
    bounds = SearchBounds(np.where(held, theta, -np.inf), np.where(held, theta, np.inf))
    prior = NormalPrior(unknowns.prior_precisions, float(start_samples))
    theta = levenberg_marquardt_vectors_and_costs(
        data.make_normal_equations(start_samples), theta[None], prior, 1e-9, bounds
    )[0][0]
    residuals = data.residuals(theta)
    diverged = ~(np.abs(residuals) < DIVERGED_RESIDUAL)
    unit = unknowns.residual_unit
    height = total.height + unit * residuals
    height = np.where(np.maximum.accumulate(diverged), np.nan, height)
    error = math.inf if diverged.any() else unit * rms(residuals)
    rest = guess.rest if model.at_rest is None else model.at_rest.height
    if reading is not None:
        rest = float(total.height.mean())
    rms_displacement = float(total.height.std())
    count = max(int(np.isfinite(height).cumprod().sum()), 2)
    motion = PistonRecord(record.time[:count], np.nan_to_num(height[:count]))
    at_rest = rms(total.height - rest) / rms_displacement
    spread = None
    if not diverged.any():
        misfit = unit * residuals
        cycles = find_cycles_above_noise(total.time, total.height, count_samples_in_motion(total))
        spread = prediction_error_on_cycles(
            misfit, total.height - rest, cycles, rms_displacement
        ).standard_error
    return RollOut(motion, error, error / rms_displacement, at_rest, spread)


def _predict_signal_along_stroke(model: Any, record: PistonRecord) -> RollOut:
    """Predict the signal of a law along a record's stroke, without any fit."""
    residuals = model.residuals(record)
    signal = model.simulate_signal(record)
    size = float((signal + residuals).std())
    error = rms(residuals)
    return RollOut(PistonRecord(record.time, signal), error, error / size, 1.0)


def unknowns_and_search_vector_of_model(
    model: FittedLaw, guess: FirstGuesses | None, unknowns: SearchUnknowns | None = None
) -> tuple[SearchUnknowns, Float[np.ndarray, "p"]]:
    """Return the unknowns that define the scales of a search vector, and the model's search vector."""
    law, values = model.law, list(model.all_parameters.values())
    logs = [name in law.positive for name in law.parameters]
    if unknowns is None:
        assert guess is not None
        units = tuple(1.0 if log else abs(value) or 1.0 for log, value in zip(logs, values, strict=True))
        speed = guess.amplitude * guess.frequency
        unknowns = SearchUnknowns(law, units, guess.rest, guess.amplitude, speed)
    start = [
        math.log(value) if log else value / unit
        for log, value, unit in zip(logs, values, unknowns.units, strict=True)
    ]
    start += [
        (model.initial[0] - unknowns.rest) / unknowns.amplitude,
        model.initial[1] / unknowns.speed,
        *(model.hidden.get(name, 0.0) for name in law.hidden),
    ]
    return unknowns, np.array(start)
