"""Samples of a record on the uniform grid of a solution, as compiled code takes them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from reduced_models.fitting.sensor_signal import SensorSignalTables, sensor_signal_tables
from reduced_models.laws.solution import (
    CHUNK,
    count_grid_steps,
    padded_length,
    padded_step_count,
    round_up_to_chunks,
)
from reduced_models.records.derivatives import is_evenly_sampled
from reduced_models.records.inputs import (
    STAGE_TIMES,
    Interpolation,
    StepGrid,
    has_inputs_besides_time,
    input_column,
    inputs_on_grid,
)
from reduced_models.records.sensor import Sensor
from reduced_models.records.sensor_filter import filter_by_sensor

if TYPE_CHECKING:
    from jaxtyping import Float

LEAST_SAMPLES = 1024
"""Least length of arrays of samples; see `reduced_models.laws.solution.padded_length`."""


class Samples(NamedTuple):
    """Data on a grid, as the compiled code takes them."""

    step: float  # [s]
    point: np.ndarray  # of the grid before each sample, int (n,)
    fraction: np.ndarray  # of a step by which the sample is behind it, float (n,)
    height: Float[np.ndarray, "n"]  # [m]
    weight: Float[np.ndarray, "n"]  # multiplies the residuals
    drive: Float[np.ndarray, "points stages inputs"]
    inputs: Float[np.ndarray, "n inputs"]  # at the samples
    chunks: int  # of the grid that are solved
    sensor: SensorSignalTables | None = None

    def with_weights(self, weight: Float[np.ndarray, "n"]) -> Samples:
        """Return the same with other weights; the solution ends behind the last that is not zero."""
        used = self.point[weight > 0.0]
        last = int(used.max()) + 1 if len(used) else 1
        return self._replace(weight=weight, chunks=min(-(-last // CHUNK), self.chunks))

    def through_sensor(self, sensor: Sensor, record: PistonRecord, grid: StepGrid) -> Samples:
        """Return the same for a sensor whose signal the record has for its height."""
        behind = filter_by_sensor(sensor, record.time, sensor.base_motion(record.columns))
        base = np.interp(self.step * (self.point + self.fraction), record.time, behind)
        return self._replace(sensor=sensor_signal_tables(sensor, grid, self.fraction, base))


def grid_over_record(
    record: PistonRecord,
    names: tuple[str, ...],
    period: float,
    per_period: int,
    how: Interpolation = "spline",
) -> StepGrid:
    """Grid over a record that starts at time 0, with at least so many steps a period [s]."""
    # Even samples of a driven law end steps: between them its inputs are smooth, at them they are not.
    duration = float(record.time[-1])
    wanted = count_grid_steps(duration, period, per_period)
    if not (has_inputs_besides_time(names) and is_evenly_sampled(record.time)):
        return StepGrid(duration / wanted, wanted)
    sample = duration / (len(record) - 1)
    fraction = wanted / (len(record) - 1)
    smooth = how in ("spline", "band-limited")
    several = 2.0 ** math.floor(math.log2(1.0 / fraction)) if smooth and fraction < 1.0 else 1.0
    step = sample * several / max(1, math.ceil(fraction))
    return StepGrid(step, round_up_to_chunks(duration / step * (1.0 - 1e-12)))


def samples_on_grid(
    record: PistonRecord,
    grid: StepGrid,
    names: tuple[str, ...],
    how: Interpolation,
    weights: Float[np.ndarray, "n"],
) -> Samples:
    """Every sample of a record that starts at time 0, on a grid over all of it."""
    count = len(record)
    steps = record.time / grid.step
    # Rounding is not to put a sample that lies on a grid point behind the one before.
    point = np.minimum((steps + 1e-9).astype(np.int64), grid.steps - 1)
    size = padded_length(count, LEAST_SAMPLES)
    grid_points, fractions, heights, weight = np.zeros(size, np.int64), *np.zeros((3, size))
    grid_points[:count], fractions[:count] = point, steps - point
    heights[:count], weight[:count] = record.height, weights
    drive = _padded_drive(record, grid, names, how)
    inputs = np.zeros((size, len(names)))
    for k, name in enumerate(names):
        inputs[:count, k] = column = input_column(record, name)
        inputs[count:, k] = column[-1]
    return Samples(grid.step, grid_points, fractions, heights, weight, drive, inputs, grid.steps // CHUNK)


def means_on_grid(
    record: PistonRecord,
    grid: StepGrid,
    names: tuple[str, ...],
    how: Interpolation,
    weights: Float[np.ndarray, "n"],
) -> Samples:
    """Weighted means of the samples around each grid point, weighted by how many there are."""
    time, height = record.time, record.height
    points = padded_step_count(grid.steps) + 1
    near = np.rint(time / grid.step).astype(np.int64)
    squares = weights**2
    total = np.bincount(near, weights=squares, minlength=points)
    # The mean time of the samples is not the grid point: the slope takes that out.
    level = height - np.gradient(height, time) * (time - near * grid.step)
    sums = np.bincount(near, weights=level * squares, minlength=points)
    means = np.divide(sums, total, out=np.zeros(points), where=total > 0)
    point = np.minimum(np.arange(points), points - 2)
    fraction = np.arange(points) - point.astype(float)
    drive = _padded_drive(record, grid, names, how)
    return Samples(grid.step, point, fraction, means, np.sqrt(total), drive, drive[:, 0], grid.steps // CHUNK)


def _padded_drive(
    record: PistonRecord, grid: StepGrid, names: tuple[str, ...], how: Interpolation
) -> np.ndarray:
    points = padded_step_count(grid.steps) + 1
    drive = np.zeros((points, len(STAGE_TIMES), len(names)))
    if names:
        drive[: grid.steps + 1] = inputs_on_grid(record, names, grid, how)
    return drive
