"""Compile the residuals of a law's solution on a record, and their normal equations.

One compiled loop computes the solutions and sensitivities of all starts together. A diverging solution
takes as long as any other.

The signal of a sensor follows from the solution: between two grid points the coordinate is the quintic that
matches height, velocity and acceleration at both points; the measured quantity is a derivative of the
quintic. A filter is linear: its state after a step is the propagated previous state (a matrix
exponential) plus the response to the step's polynomial, which is exact however stiff the filter is.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from reduced_models.fitting.levenberg_marquardt import Normal
from reduced_models.fitting.parameter import SearchUnknowns, gain_offset_and_filter_state, physical_values
from reduced_models.jax_setup import Compiled, jax
from reduced_models.laws.equation import PROGRAMS, compile_observation, compile_rates, parse_equation
from reduced_models.laws.solution import (
    CHUNK,
    count_grid_steps,
    hermite_quintic,
    padded_array_length,
    padded_step_count,
    round_up_to_chunks,
    solve_on_grid,
    states_at_samples,
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
from reduced_models.records.sensor import Sensor, continuous_sensor_filter_matrices, filter_by_sensor

jnp = jax.numpy

# Degree of the polynomial between grid points: three values at each end determine a quintic.
_DEGREE = 5


class SensorSignalTables(NamedTuple):
    """Coefficients that turn a solution on a grid into a sensor's signal."""

    weights: Float[np.ndarray, "n c"]  # weights of the coefficients of each sample's step
    base: Float[np.ndarray, "n"]  # signal due to the motion of the base
    state_weights: Float[np.ndarray, "n m"]  # weights of the filter's state before the step
    advance: Float[np.ndarray, "m m"]  # propagator of the state over a step
    advance_input: Float[np.ndarray, "m c"]  # contribution of a step's coefficients to the state


def tabulate_sensor_signal_coefficients(
    sensor: Sensor, grid: StepGrid, fraction: Float[np.ndarray, "n"], base: Float[np.ndarray, "n"]
) -> SensorSignalTables:
    """Tabulate the coefficients that turn a solution on a grid into a sensor's signal at the samples."""
    # Matrix exponentials solve the filter without a time-step error (Van Loan 1978,
    # doi:10.1109/TAC.1978.1101743).
    from scipy.linalg import expm

    size = _DEGREE + 1 - sensor.derivative_order
    states, inputs, output, through = continuous_sensor_filter_matrices(sensor, grid.step)
    count = len(states)
    # The derivatives of the step's polynomial form a chain of integrators that drives the state.
    chain = np.zeros((count + size, count + size))
    chain[:count, :count], chain[:count, count : count + 1] = states, inputs
    chain[count:, count:] = np.eye(size, k=1)
    distinct, position = np.unique(np.append(np.round(fraction, 12), 1.0), return_inverse=True)
    derivatives = np.array([math.factorial(k) for k in range(size)], dtype=float)
    moved = expm(distinct[:, None, None] * chain)
    read = np.concatenate([output, [through], np.zeros(size - 1)])
    rows = np.einsum("i,nij->nj", read, moved)
    last = moved[position[-1]]
    return SensorSignalTables(
        rows[position[:-1], count:] * derivatives,
        base,
        rows[position[:-1], :count],
        last[:count, :count],
        last[:count, count:] * derivatives,
    )


def solution_signal(
    grid: tuple[Any, Any, Any],
    step: Any,
    point: Any,
    derivative: int,
    tables: SensorSignalTables,
    states: Any,
) -> Any:
    """Return the signal (n, s), divided by the gain, of s solutions on a grid; ``step`` is in seconds."""
    z, v, a = grid[0], step * grid[1], step**2 * grid[2]
    # Quintic in units of the step, from height, velocity and acceleration at both ends of each step.
    z0, v0, a0, z1, v1, a1 = (item[part] for part in (slice(-1), slice(1, None)) for item in (z, v, a))
    ahead, turn, bend = z1 - z0 - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
    coefficients = [
        z0,
        v0,
        0.5 * a0,
        10.0 * ahead - 4.0 * turn + 0.5 * bend,
        -15.0 * ahead + 7.0 * turn - bend,
        6.0 * ahead - 3.0 * turn + 0.5 * bend,
    ]
    for _ in range(derivative):
        coefficients = [k * item / step for k, item in enumerate(coefficients)][1:]
    steps = jnp.stack(coefficients)
    result = jnp.einsum("nc,cns->ns", tables.weights, steps[:, point]) + tables.base[:, None]
    if not tables.advance.shape[0]:
        return result

    def advance(state: Any, step_coefficients: Any) -> tuple[Any, Any]:
        added = jnp.einsum("mc,cs->ms", tables.advance_input, step_coefficients)
        return jnp.einsum("mk,ks->ms", tables.advance, state) + added, state

    every = jax.lax.scan(advance, states, steps.transpose(1, 0, 2))[1]
    return result + jnp.einsum("nm,nms->ns", tables.state_weights, every[point])


MINIMUM_SAMPLE_LENGTH = 1024
"""Minimum length of arrays of samples; see `reduced_models.laws.solution.padded_array_length`."""


class SamplesOnGrid(NamedTuple):
    """Samples and their grid, in the form that the compiled code uses."""

    step: float  # [s]
    point: np.ndarray  # index of the grid point before each sample, int (n,)
    fraction: np.ndarray  # fraction of a step from that point to the sample, float (n,)
    height: Float[np.ndarray, "n"]  # [m]
    weight: Float[np.ndarray, "n"]  # multiplies the residuals
    drive: Float[np.ndarray, "points stages inputs"]
    inputs: Float[np.ndarray, "n inputs"]  # at the samples
    chunks: int  # number of chunks of the grid that are solved
    sensor: SensorSignalTables | None = None

    def with_weights(self, weight: Float[np.ndarray, "n"]) -> SamplesOnGrid:
        """Return the samples with other weights; the solution ends after the last nonzero weight."""
        used = self.point[weight > 0.0]
        last = int(used.max()) + 1 if len(used) else 1
        return self._replace(weight=weight, chunks=min(-(-last // CHUNK), self.chunks))

    def through_sensor(self, sensor: Sensor, record: PistonRecord, grid: StepGrid) -> SamplesOnGrid:
        """Return the same samples for a sensor whose signal is the record's height column."""
        behind = filter_by_sensor(sensor, record.time, sensor.base_motion(record.columns))
        base = np.interp(self.step * (self.point + self.fraction), record.time, behind)
        return self._replace(sensor=tabulate_sensor_signal_coefficients(sensor, grid, self.fraction, base))


def grid_over_record(
    record: PistonRecord,
    names: tuple[str, ...],
    period: float,
    per_period: int,
    how: Interpolation = "spline",
) -> StepGrid:
    """Return a grid over a record that begins at time 0, with at least ``per_period`` steps in a period."""
    # Steps of a driven law end at evenly spaced samples, since its inputs are smooth only between them.
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


def locate_samples_on_grid(
    record: PistonRecord,
    grid: StepGrid,
    names: tuple[str, ...],
    how: Interpolation,
    weights: Float[np.ndarray, "n"],
) -> SamplesOnGrid:
    """Locate all samples of a record that begins at time 0 on a grid."""
    count = len(record)
    steps = record.time / grid.step
    # The tolerance keeps rounding from assigning a sample on a grid point to the point before.
    point = np.minimum((steps + 1e-9).astype(np.int64), grid.steps - 1)
    size = padded_array_length(count, MINIMUM_SAMPLE_LENGTH)
    grid_points, fractions, heights, weight = np.zeros(size, np.int64), *np.zeros((3, size))
    grid_points[:count], fractions[:count] = point, steps - point
    heights[:count], weight[:count] = record.height, weights
    drive = _padded_inputs(record, grid, names, how)
    inputs = np.zeros((size, len(names)))
    for k, name in enumerate(names):
        inputs[:count, k] = column = input_column(record, name)
        inputs[count:, k] = column[-1]
    return SamplesOnGrid(
        grid.step, grid_points, fractions, heights, weight, drive, inputs, grid.steps // CHUNK
    )


def average_samples_on_grid(
    record: PistonRecord,
    grid: StepGrid,
    names: tuple[str, ...],
    how: Interpolation,
    weights: Float[np.ndarray, "n"],
) -> SamplesOnGrid:
    """Return weighted means of the samples around each grid point; they keep the samples' total weight."""
    time, height = record.time, record.height
    points = padded_step_count(grid.steps) + 1
    near = np.rint(time / grid.step).astype(np.int64)
    squares = weights**2
    total = np.bincount(near, weights=squares, minlength=points)
    # The mean time of the samples differs from the grid point; the local slope corrects for it.
    level = height - np.gradient(height, time) * (time - near * grid.step)
    sums = np.bincount(near, weights=level * squares, minlength=points)
    means = np.divide(sums, total, out=np.zeros(points), where=total > 0)
    point = np.minimum(np.arange(points), points - 2)
    fraction = np.arange(points) - point.astype(float)
    drive = _padded_inputs(record, grid, names, how)
    return SamplesOnGrid(
        grid.step, point, fraction, means, np.sqrt(total), drive, drive[:, 0], grid.steps // CHUNK
    )


def _padded_inputs(
    record: PistonRecord, grid: StepGrid, names: tuple[str, ...], how: Interpolation
) -> np.ndarray:
    points = padded_step_count(grid.steps) + 1
    drive = np.zeros((points, len(STAGE_TIMES), len(names)))
    if names:
        drive[: grid.steps + 1] = inputs_on_grid(record, names, grid, how)
    return drive


LossName = Literal["linear", "soft_l1", "huber"]
LOSSES: tuple[LossName, ...] = ("linear", "soft_l1", "huber")

DIVERGED_RESIDUAL = 1e3
"""Residual, in units of the amplitude, of a sample at which the solution has diverged."""


class ResidualLoss(NamedTuple):
    """Loss function of the residuals, given by its name and scale."""

    name: LossName = "linear"
    scale: float = math.inf  # in amplitudes

    @property
    def compiled_arguments(self) -> np.ndarray:
        """Scale and kind of the loss, as arguments of the compiled code."""
        huber = self.name == "huber"
        return np.array([self.scale if self.name != "linear" else np.inf, float(huber)])


def residual_costs_and_weights(residuals: Any, loss: Any, np_: Any) -> tuple[Any, Any]:
    """Return costs of residuals r, and weights w such that the derivative of each cost is 2 w r."""
    # Huber (1964, doi:10.1214/aoms/1177703732), and SciPy's `soft_l1`, 2 (sqrt(1 + r^2) - 1).
    size = np_.abs(residuals)
    root = np_.sqrt(1.0 + (residuals / loss[0]) ** 2)
    soft = 2.0 * residuals**2 / (1.0 + root)
    # With an infinite scale both are the square.
    far = size > loss[0]
    reach = np_.where(far, loss[0], size)
    huber = reach * (2.0 * size - reach)
    weight = np_.where(far, reach / np_.where(far, size, 1.0), 1.0)
    return np_.where(loss[1] > 0.0, huber, soft), np_.where(loss[1] > 0.0, weight, 1.0 / root)


def half_cost_curvature(residuals: Float[np.ndarray, "n"], loss: ResidualLoss) -> Float[np.ndarray, "n"]:
    """Return half the second derivative (n,) of the cost of residuals."""
    if loss.name == "linear":
        return np.ones_like(residuals)
    if loss.name == "huber":
        return (np.abs(residuals) <= loss.scale).astype(float)
    return np.asarray((1.0 + (residuals / loss.scale) ** 2) ** -1.5)


def rms(values: Float[np.ndarray, "n"]) -> float:
    """Return the root mean square."""
    return float(np.sqrt((values**2).mean()))


def remove_random_walk(residuals: Float[np.ndarray, "n ..."], gain: float) -> Float[np.ndarray, "n ..."]:
    """Subtract from each residual (n, ...) the exponentially smoothed value of the previous residuals."""
    # The steady-state Kalman filter of a random walk in white noise (Muth 1960,
    # doi:10.1080/01621459.1960.10482064).
    if gain == 0.0:
        return residuals
    from scipy.signal import lfilter  # its import takes longer than a small fit

    return np.asarray(lfilter([1.0, -1.0], [1.0, gain - 1.0], residuals, axis=0))


Kind = Literal["normal", "linear", "residual", "several"]


class ComparedSignalForm(NamedTuple):
    """Properties of the fitted signal; the residual code is compiled for each combination of them."""

    observation: str  # compared observation of the law; empty if a sensor measures a derivative of the height
    derivative: int
    is_open: tuple[bool, bool]
    entry_count: int  # number of the sensor's entries, at the end of the search vector


def compiled_residuals_or_normal_equations(unknowns: SearchUnknowns, kind: Kind) -> Compiled[..., Any]:
    """Return compiled code for normal equations of search vectors, or for residuals with derivatives."""
    # "normal": (theta (s, p), samples, scales, loss) -> costs (s,), gradients J'r (s, p), matrices J'J (s, p,
    # p). "linear": (theta (p,), samples, scales) -> weighted residuals (n,) and derivatives (p, n).
    # "several": (theta (s, p), samples, scales) -> weighted residuals (n, s).
    law = unknowns.law
    sensor = None
    if not unknowns.compares_heights:
        order = 0 if unknowns.sensor is None else unknowns.sensor.derivative_order
        open_entries = unknowns.gain_and_offset_are_entries
        sensor = ComparedSignalForm(unknowns.observation, order, open_entries, unknowns.sensor_entry_count)
    return _compile_residuals(kind, law.equation, law.inputs, unknowns.parameters_are_logarithmic, sensor)


def make_normal_equations(unknowns: SearchUnknowns, samples: SamplesOnGrid, loss: ResidualLoss) -> Normal:
    """Return the normal equations of samples, for many search vectors simultaneously."""
    function, scales = compiled_residuals_or_normal_equations(unknowns, "normal"), unknowns.scales
    return lambda theta: function(theta, samples, scales, loss.compiled_arguments)


@functools.lru_cache(maxsize=3 * PROGRAMS)
def _compile_residuals(
    kind: Kind,
    equation: str,
    inputs: tuple[str, ...],
    logarithmic: tuple[bool, ...],
    sensor: ComparedSignalForm | None,
) -> Compiled[..., Any]:
    field, parsed = compile_rates(equation, inputs), parse_equation(equation, inputs)
    prescribed, observe = parsed.acceleration is None, None
    if sensor is not None and sensor.observation:
        observe = compile_observation(equation, inputs, sensor.observation)

    def observed_signal(motion: Any, values: Any, samples: SamplesOnGrid) -> jax.Array:
        """Return the values (n, s) of the law's observed quantity at the samples."""
        start = motion[2:] if prescribed else motion
        states: list[jax.Array] = []
        if start:
            grid = solve_on_grid(
                field, start, values, samples.drive, samples.step, samples.chunks,
                prescribed=prescribed, every_state=True,
            )  # fmt: skip
            states = states_at_samples(
                grid, samples.step, samples.point, samples.fraction[:, None], prescribed=prescribed
            )
        given = tuple(jnp.asarray(samples.inputs).T[:, :, None])
        assert observe is not None
        return jnp.broadcast_to(observe(*states, *given, *values), (len(samples.point), *motion[0].shape))

    def residuals(vectors: jax.Array, samples: SamplesOnGrid, scales: jax.Array) -> jax.Array:
        """Return residuals (n, s) of the search vectors in the columns of an array (p, s)."""
        step, point, fraction, height, weight, drive, _, chunks, tables = samples
        split = len(vectors) - (0 if sensor is None else sensor.entry_count)
        values, z0, v0, hidden = physical_values(vectors[:split], scales, logarithmic, jnp)
        if sensor is None:
            grid = solve_on_grid(field, (z0, v0, *hidden), values, drive, step, chunks)
            z = hermite_quintic(grid[:, 0], grid[:, 1], grid[:, 2], step, point, fraction[:, None])
            result = (z - height[:, None]) / scales[1]
        else:
            gain, offset, states = gain_offset_and_filter_state(vectors[split:], scales, sensor.is_open)
            if sensor.observation:
                signal = observed_signal((z0, v0, *hidden), values, samples)
            else:
                assert tables is not None
                grid = solve_on_grid(field, (z0, v0, *hidden), values, drive, step, chunks)
                motion = (grid[:, 0], grid[:, 1], grid[:, 2])
                signal = solution_signal(motion, step, point, sensor.derivative, tables, states)
            result = (gain * signal + offset - height[:, None]) / scales[-3]
        return jnp.where(jnp.abs(result) < DIVERGED_RESIDUAL, result, DIVERGED_RESIDUAL) * weight[:, None]

    def residuals_and_derivatives(
        theta: jax.Array, samples: SamplesOnGrid, scales: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Return residuals (n, s) of search vectors (s, p), and their derivatives (p, n, s)."""
        # Starts in the last axis and directions before them vectorise best.
        vectors = theta.T
        directions = jnp.eye(len(vectors))[:, :, None] * jnp.ones_like(vectors)

        def residuals_and_derivative_along(direction: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.jvp(lambda value: residuals(value, samples, scales), (vectors,), (direction,))

        left, jacobian = jax.vmap(residuals_and_derivative_along, out_axes=(None, 0))(directions)
        return left, jnp.where(jnp.isfinite(jacobian), jacobian, 0.0)

    def residuals_of_one_vector(theta: jax.Array, samples: SamplesOnGrid, scales: jax.Array) -> jax.Array:
        return residuals(theta[:, None], samples, scales)[:, 0]

    def residuals_of_several_vectors(
        theta: jax.Array, samples: SamplesOnGrid, scales: jax.Array
    ) -> jax.Array:
        return residuals(theta.T, samples, scales)

    def residuals_and_derivatives_of_one_vector(
        theta: jax.Array, samples: SamplesOnGrid, scales: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        left, jacobian = residuals_and_derivatives(theta[None], samples, scales)
        return left[:, 0], jacobian[:, :, 0]

    def normal_equations(
        theta: jax.Array, samples: SamplesOnGrid, scales: jax.Array, loss: jax.Array
    ) -> tuple[jax.Array, ...]:
        left, jacobian = residuals_and_derivatives(theta, samples, scales)
        cost, weight = residual_costs_and_weights(left, loss, jnp)
        return (
            cost.sum(axis=0),
            jnp.einsum("pns,ns->sp", jacobian, weight * left),
            jnp.einsum("pns,qns->spq", weight * jacobian, jacobian),
        )

    functions: dict[Kind, Callable[..., Any]] = {
        "normal": normal_equations,
        "linear": residuals_and_derivatives_of_one_vector,
        "residual": residuals_of_one_vector,
        "several": residuals_of_several_vectors,
    }
    return Compiled(functions[kind], (equation, inputs, logarithmic, sensor))
