"""Interpolate the inputs of a law, which are columns of a record, between the samples."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import RecordError, quote
from reduced_models.records.derivatives import derivatives, is_evenly_sampled

STAGE_TIMES = (0.0, 1 / 3, 2 / 3, 1 / 3, 5 / 6, 1 / 6, 1.0)
"""Times of the stages of the Runge-Kutta method, as fractions of a grid step."""

TIME = "t"
"""Name of the input that is the time since a record's start; any law may use it."""

STROKE = ("z", "z'", "z''")
"""Names of a law's inputs for a prescribed stroke: displacement, velocity and acceleration."""

Interpolation = Literal["spline", "linear", "previous", "band-limited"]
INTERPOLATIONS: tuple[Interpolation, ...] = ("spline", "linear", "previous", "band-limited")
"""Interpolation of an input between its samples: by a cubic spline with two continuous derivatives, by
straight lines, by the last value (zero-order hold), or without components above half the sampling rate.
"""
_TAPS = 24  # samples on each side of a band-limited value
# Upsampling of a band-limited input before its spline: the error is 1e-4 of a tone at 0.6 of half the
# sampling rate, 5e-4 at 0.8.
_UPSAMPLING = 4
# Shape parameter of the window: the error is 1e-4 of a tone up to 0.8 of half the sampling rate, 1.4e-3 at
# 0.9.
_KAISER_SHAPE = 8.0


class StepGrid(NamedTuple):
    """Uniform time steps of a numerical solution."""

    step: float  # [s]
    steps: int

    @property
    def finer(self) -> StepGrid:
        """Grid with twice as many steps for the same duration."""
        return StepGrid(0.5 * self.step, 2 * self.steps)


def input_column(record: PistonRecord, name: str) -> Float[np.ndarray, "n"]:
    """Return the record's column for a law's input; ``time`` [s] is measured from the first sample."""
    result = record.extra.get(name, record.force if name == "force" else None)
    if result is None and name == TIME:
        return record.time - record.time[0]
    if result is None:
        available = ", ".join(map(repr, input_column_names(record))) or "none"
        raise RecordError(
            f"the law has the input {quote(name)}, but the record has no column of that name; its columns: "
            f"{available}; add the column or use another name"
        )
    return result


def input_column_names(record: PistonRecord) -> tuple[str, ...]:
    """Return the names of the columns of a record that a law can use as inputs."""
    return (*(["force"] if record.force is not None else []), *record.extra)


def with_stroke_columns(record: PistonRecord) -> PistonRecord:
    """Add smoothed height, velocity and acceleration to the record of a prescribed stroke."""
    smooth = derivatives(record)
    velocity = smooth.velocity if record.velocity is None else record.velocity
    columns = (smooth.height, velocity, smooth.acceleration)
    return dataclasses.replace(record, extra={**record.extra, **dict(zip(STROKE, columns, strict=True))})


def has_inputs_besides_time(names: Sequence[str]) -> bool:
    """Return whether there are inputs other than the time, which needs no interpolation."""
    return any(name != TIME for name in names)


def inputs_on_grid(
    record: PistonRecord, names: tuple[str, ...], grid: StepGrid, interpolation: Interpolation = "spline"
) -> Float[np.ndarray, "steps+1 stages inputs"]:
    """Interpolate the inputs of a law at the stage times of all Runge-Kutta steps."""
    nodes = grid.step * (np.arange(grid.steps + 1)[:, None] + np.array(STAGE_TIMES))
    columns = [input_column(record, name) for name in names]
    if interpolation == "previous" and columns:
        # A whole step lies in the sampling interval of its midpoint.
        middle = grid.step * (np.arange(grid.steps + 1) + 0.5)
        held = interpolate_inputs(record.time, columns, middle, interpolation)
        result = np.repeat(held[:, None], len(STAGE_TIMES), axis=1)
        for index in (k for k, name in enumerate(names) if name == TIME):
            result[:, :, index] = nodes
        return result
    return interpolate_inputs(record.time, columns, nodes, interpolation)


def interpolate_inputs(
    time: Float[np.ndarray, "n"],
    columns: list[np.ndarray],
    times: np.ndarray,
    interpolation: Interpolation = "spline",
) -> np.ndarray:
    """Interpolate columns at the given times."""
    if not columns:
        return np.zeros((*times.shape, 0))
    inside = np.clip(times, time[0], time[-1])
    return np.stack([_interpolate_column(time, column, inside, interpolation) for column in columns], axis=-1)


class PiecewiseCubics(NamedTuple):
    """Columns as cubics a + b s + c s^2 + d s^3 in the time s after each sample."""

    length: Float[np.ndarray, "n-1"]  # lengths of the intervals [s]
    cubics: Float[np.ndarray, "n-1 4 columns"]


def piecewise_cubics(
    time: Float[np.ndarray, "n"], columns: list[np.ndarray], interpolation: Interpolation = "spline"
) -> PiecewiseCubics:
    """Return cubics between samples; for ``"band-limited"``, between additional interpolated samples."""
    length = np.diff(time)
    if interpolation == "band-limited" and columns:
        fraction = np.arange(_UPSAMPLING) / _UPSAMPLING
        fine = np.append((time[:-1, None] + length[:, None] * fraction).ravel(), time[-1])
        columns = [_interpolate_column(time, column, fine, interpolation) for column in columns]
        time, length = fine, np.diff(fine)
    cubics = np.zeros((len(length), 4, len(columns)))
    for k, values in enumerate(columns):
        cubics[:, 0, k] = values[:-1]
        if interpolation == "linear":
            cubics[:, 1, k] = np.diff(values) / length
        elif interpolation != "previous":
            from scipy.interpolate import CubicSpline

            cubics[:, :, k] = CubicSpline(time, values).c[::-1].T
    return PiecewiseCubics(length, cubics)


def _interpolate_column(
    time: np.ndarray, values: np.ndarray, times: np.ndarray, interpolation: Interpolation
) -> np.ndarray:
    if interpolation == "linear":
        return np.interp(times, time, values)
    if interpolation == "previous":
        index = np.searchsorted(time, times, side="right") - 1
        return np.asarray(values[np.clip(index, 0, len(time) - 1)])
    if interpolation == "band-limited" and is_evenly_sampled(time) and len(time) > _TAPS:
        return _interpolate_band_limited(time, values, times)
    from scipy.interpolate import CubicSpline

    # With two or three samples the spline is of lower degree.
    return np.asarray(CubicSpline(time, values)(times))


def _interpolate_band_limited(time: np.ndarray, values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Interpolate by sinc functions with a Kaiser window (Kaiser 1974); the ends are mirrored."""
    # Mirrored through the end points, so that value and slope are continuous; a truncated series would ring
    # over `_TAPS` samples.
    step = float(time[-1] - time[0]) / (len(time) - 1)
    before = 2.0 * values[0] - values[_TAPS:0:-1]
    after = 2.0 * values[-1] - values[-2 : -_TAPS - 2 : -1]
    padded = np.concatenate([before, values, after])
    flat = (times.ravel() - time[0]) / step + _TAPS
    result = np.zeros(len(flat))
    index = np.floor(flat).astype(np.int64)
    for tap in range(1 - _TAPS, _TAPS + 1):
        here = np.clip(index + tap, 0, len(padded) - 1)
        distance = flat - (index + tap)
        inside = np.maximum(1.0 - (distance / _TAPS) ** 2, 0.0)
        result += (
            padded[here] * np.sinc(distance) * np.i0(_KAISER_SHAPE * np.sqrt(inside)) / np.i0(_KAISER_SHAPE)
        )
    return result.reshape(times.shape)
