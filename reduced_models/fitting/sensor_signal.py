"""Signal of a sensor at the samples, from a solution on a uniform grid, as compiled code takes it.

Between grid points the coordinate is the quintic that fits height, velocity and acceleration at
both; the quantity is a derivative of it. A filter is linear, and its state behind a step is that
before it, moved by a matrix exponential, and what the step's polynomial adds (exact, however stiff
the filter is): all of these are numbers that the times alone tell.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from granular.shared.array_types import Float
from reduced_models.jax_setup import jax
from reduced_models.records.inputs import StepGrid
from reduced_models.records.sensor import Sensor, filter_matrices

jnp = jax.numpy

# Of the polynomial between grid points: six values, three at each end, fix a quintic.
_DEGREE = 5


class SensorSignalTables(NamedTuple):
    """Numbers that turn a solution on a grid into a sensor's signal."""

    weights: Float[np.ndarray, "n c"]  # of the coefficients of each sample's step
    base: Float[np.ndarray, "n"]  # signal by the motion of the base
    state_weights: Float[np.ndarray, "n m"]  # of the filter's state before the step
    advance: Float[np.ndarray, "m m"]  # of that state over a step
    advance_input: Float[np.ndarray, "m c"]  # what a step's coefficients add to it


def sensor_signal_tables(
    sensor: Sensor, grid: StepGrid, fraction: Float[np.ndarray, "n"], base: Float[np.ndarray, "n"]
) -> SensorSignalTables:
    """Tables that turn a solution on a grid into a sensor's signal at the samples."""
    # Matrix exponentials solve the filter without error of time steps (Van Loan 1978,
    # doi:10.1109/TAC.1978.1101743).
    size = _DEGREE + 1 - sensor.derivative_order
    states, inputs, output, through = filter_matrices(sensor, grid.step)
    count = len(states)
    # The derivatives of the step's polynomial follow each other in a chain, which drives the state.
    chain = np.zeros((count + size, count + size))
    chain[:count, :count], chain[:count, count : count + 1] = states, inputs
    chain[count:, count:] = np.eye(size, k=1)
    distinct, position = np.unique(np.append(np.round(fraction, 12), 1.0), return_inverse=True)
    derivatives = np.array([math.factorial(k) for k in range(size)], dtype=float)
    moved = _matrix_exponentials(chain, distinct)
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


def _matrix_exponentials(matrix: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Matrix exponentials (n, k, k) at some times."""
    from scipy.linalg import expm

    return np.asarray(expm(times[:, None, None] * matrix))


def solution_signal(
    grid: tuple[Any, Any, Any],
    step: Any,
    point: Any,
    derivative: int,
    tables: SensorSignalTables,
    states: Any,
) -> Any:
    """Signal (n, s) per gain of solutions on a grid, (points, s) each; step [s] (for JAX)."""
    z, v, a = grid[0], step * grid[1], step**2 * grid[2]
    # Quintic, in steps, through height, velocity and acceleration at both ends of each step.
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
