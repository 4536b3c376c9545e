"""Many random starts at once: a batched Levenberg-Marquardt search on a coarse view of a record.

The record is averaged onto a uniform grid with a few points a swing, the law is stepped along it
with the classical Runge-Kutta method, and all starts (with their sensitivities) go through the
same compiled loop side by side. A solution that blows up costs no more than one that does not.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from reduced_models.jax_setup import jax
from reduced_models.law import compiled_rate

jnp = jax.numpy

POINTS_A_SWING = 32
"""Grid points of a period: the error of the Runge-Kutta step is then below 1e-4 of the swing."""
MOST_POINTS = 4096
_SIZES = (128, 256, 512, 1024, 2048, MOST_POINTS)
_BLOWN_UP = 1e3
_PATIENCE = 4  # trials without a gain after which a start counts as done


def coarse_grid(
    time: np.ndarray, height: np.ndarray, period: float
) -> tuple[float, np.ndarray, np.ndarray]:
    """Step [s], heights and weights of a coarse view of a record that starts at time 0.

    Heights are means over one step around each grid point; where no sample falls, the weight is 0.
    """
    points = int(np.clip(POINTS_A_SWING * time[-1] / period, 16, MOST_POINTS - 1)) + 1
    step = float(time[-1]) / (points - 1)
    size = next(one for one in _SIZES if one >= points)
    place = np.rint(time / step).astype(int)
    count = np.bincount(place, minlength=size)[:size].astype(float)
    # The mean of the samples' offsets is taken out with the local slope, to first order.
    slope = np.gradient(height, time) if len(time) > 2 else np.zeros_like(height)
    level = height - slope * (time - place * step)
    total = np.bincount(place, weights=level, minlength=size)[:size]
    heights = np.divide(total, count, out=np.zeros(size), where=count > 0)
    return step, heights, np.sqrt(count)


@functools.cache
def normal_equations(equation: str, physical: Callable[..., Any], size: int) -> Callable[..., Any]:
    """Compiled cost, gradient J'r and matrix J'J of a batch of search vectors."""
    rate = compiled_rate(equation)

    def residual(theta: Any, step: Any, heights: Any, weights: Any, scales: Any) -> Any:
        values, shift, scale, z0, v0 = physical(theta, scales)

        def slope(z: Any, v: Any) -> Any:
            return v, rate(z, v, *values)

        def advance(state: Any, _: Any) -> Any:
            z, v = state
            a1, b1 = slope(z, v)
            a2, b2 = slope(z + 0.5 * step * a1, v + 0.5 * step * b1)
            a3, b3 = slope(z + 0.5 * step * a2, v + 0.5 * step * b2)
            a4, b4 = slope(z + step * a3, v + step * b3)
            later = (
                z + step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
                v + step / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4),
            )
            return later, z

        _, z = jax.lax.scan(advance, (z0, v0), None, length=size)
        miss = (shift + scale * z - heights) / scales[1]
        return weights * jnp.where(jnp.abs(miss) < _BLOWN_UP, miss, _BLOWN_UP)

    def equations(theta: Any, *data: Any) -> Any:
        def twice(vector: Any) -> Any:
            miss = residual(vector, *data)
            return miss, miss

        jacobian, miss = jax.jacfwd(twice, has_aux=True)(theta)
        jacobian = jnp.where(jnp.isfinite(jacobian), jacobian, 0.0)
        return miss @ miss, jacobian.T @ miss, jacobian.T @ jacobian

    return jax.jit(jax.vmap(equations, in_axes=(0, None, None, None, None)))


def search(
    equations: Callable[..., Any],
    theta: np.ndarray,
    pulled: np.ndarray,
    samples: float,
    most: int,
    tolerance: float = 1e-6,
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt on a batch.

    Parameters
    ----------
    equations : callable
        From search vectors (s, p) to costs (s,), gradients (s, p) and matrices (s, p, p).
    theta : float64 (s, p)
        Start vectors.
    pulled : float64 (p,)
        How strongly each entry is pulled to its start, in units of what one sample weighs: it
        keeps a flat direction from running away.
    samples : float
        Number of samples behind the cost.
    most : int
        Most trials.
    tolerance : float
        Stop when no trial changes a cost by this fraction any more.

    Returns
    -------
    theta, cost : float64 (s, p), (s,)
    """
    start = theta
    damping = np.full(len(theta), 1e-2)
    cost, gradient, matrix = (np.asarray(one) for one in equations(theta))
    idle = np.zeros(len(theta), dtype=int)
    identity = np.eye(theta.shape[1])
    for _ in range(most):
        pull = cost[:, None] / samples * pulled
        full = matrix + pull[:, :, None] * identity
        diagonal = np.maximum(np.einsum("sii->si", full), 1e-300)
        lifted = full + (damping[:, None] * diagonal)[:, :, None] * identity
        slope = gradient + pull * (theta - start)
        trial = theta - np.linalg.solve(lifted, slope[:, :, None])[:, :, 0]
        trial_cost, trial_gradient, trial_matrix = (np.asarray(one) for one in equations(trial))
        total = cost + (pull * (theta - start) ** 2).sum(axis=1)
        trial_total = trial_cost + (pull * (trial - start) ** 2).sum(axis=1)
        better = trial_total < total
        small = np.abs(total - trial_total) <= tolerance * total
        idle = np.where(better & ~small, 0, idle + 1)
        theta = np.where(better[:, None], trial, theta)
        cost = np.where(better, trial_cost, cost)
        gradient = np.where(better[:, None], trial_gradient, gradient)
        matrix = np.where(better[:, None, None], trial_matrix, matrix)
        damping = np.clip(np.where(better, 0.2 * damping, 5.0 * damping), 1e-12, 1e12)
        if (idle >= _PATIENCE).all():
            break
    return theta, cost
