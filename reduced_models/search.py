"""Least squares through a law's equation: a batched Levenberg-Marquardt search.

All starts, with their sensitivities, go through the same compiled loop side by side. A solution
that blows up costs no more than one that does not.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from reduced_models.inputs import STAGE_TIMES
from reduced_models.jax_setup import jax
from reduced_models.law import compiled_field, parse
from reduced_models.rollout import between, on_grid

jnp = jax.numpy

BLOWN_UP = 1e3
"""Residual of a sample that a solution does not reach, in amplitudes."""
_MOST_TRIALS = 120
_PATIENCE = 4  # trials without a gain after which a start counts as done


class Samples(NamedTuple):
    """Data on a grid, as the compiled code takes them.

    Attributes
    ----------
    step : float
        Of the grid [s].
    place, share : int (n,), float (n,)
        Grid point before each sample, and how far behind it, in steps.
    height, weight : float (n,)
        [m]; weights multiply the residuals.
    drive : float (steps + 1, stages, inputs)
        Inputs of the law at the stages of the grid's steps.
    """

    step: float
    place: np.ndarray
    share: np.ndarray
    height: np.ndarray
    weight: np.ndarray
    drive: np.ndarray


def _undriven(steps: int) -> np.ndarray:
    return np.zeros((steps + 1, len(STAGE_TIMES), 0))


def samples_on_grid(
    time: np.ndarray, height: np.ndarray, steps: int, drive: np.ndarray | None = None
) -> Samples:
    """Every sample of a record that starts at time 0, on a grid over all of it."""
    step = float(time[-1]) / steps
    place = np.minimum((time / step).astype(np.int64), steps - 1)
    count = len(time)
    size = padded_size(count)
    whole, share, heights, weight = np.zeros(size, np.int64), *np.zeros((3, size))
    drive = _undriven(steps) if drive is None else drive
    out = Samples(step, whole, share, heights, weight, drive)
    out.place[:count], out.share[:count] = place, time / step - place
    out.height[:count], out.weight[:count] = height, 1.0
    return out


def means_on_grid(
    time: np.ndarray, height: np.ndarray, steps: int, drive: np.ndarray | None = None
) -> Samples:
    """Means of the samples around each grid point, weighted by how many there are."""
    step = float(time[-1]) / steps
    near = np.rint(time / step).astype(np.int64)
    count = np.bincount(near, minlength=steps + 1).astype(float)
    # The mean place of the samples is not the grid point: the slope takes that out.
    level = height - np.gradient(height, time) * (time - near * step)
    total = np.bincount(near, weights=level, minlength=steps + 1)
    means = np.divide(total, count, out=np.zeros(steps + 1), where=count > 0)
    place = np.minimum(np.arange(steps + 1), steps - 1)
    share = np.arange(steps + 1.0) - place
    drive = _undriven(steps) if drive is None else drive
    return Samples(step, place, share, means, np.sqrt(count), drive)


def padded_size(count: int) -> int:
    """Room for samples: few sizes, so that records share compiled code."""
    size = 256
    while size < count:
        size = size * 3 // 2 if size & (size - 1) == 0 else size // 3 * 4
    return size


class Equations(NamedTuple):
    """Compiled functions of search vectors.

    Attributes
    ----------
    normal : callable
        (theta (s, p), samples, scales) -> cost (s,), gradient J'r (s, p), matrix J'J (s, p, p).
    residual : callable
        (theta (p,), samples, scales) -> weighted residuals (n,), in amplitudes.
    """

    normal: Callable[..., Any]
    residual: Callable[..., Any]

    def of(self, samples: Samples, scales: np.ndarray) -> Callable[[np.ndarray], Any]:
        """The normal equations of given data."""
        return lambda theta: self.normal(theta, samples, scales)


@functools.cache
def equations(equation: str, inputs: tuple[str, ...], physical: Callable[..., Any]) -> Equations:
    """The compiled equations of a law."""
    field = compiled_field(equation, inputs)
    hidden = len(parse(equation, inputs).hidden)

    def residual(theta: Any, samples: Any, scales: Any) -> Any:
        step, place, share, height, weight, drive = samples
        values, shift, scale, z0, v0 = physical(theta, scales)
        start = (z0, v0, *(jnp.zeros_like(z0) for _ in range(hidden)))
        grid = on_grid(field, start, values, drive, step)
        residuals = (shift + scale * between(*grid, step, place, share) - height) / scales[1]
        return weight * jnp.where(jnp.abs(residuals) < BLOWN_UP, residuals, BLOWN_UP)

    def normal(theta: Any, samples: Any, scales: Any) -> Any:
        def twice(vector: Any) -> Any:
            residuals = residual(vector, samples, scales)
            return residuals, residuals

        jacobian, residuals = jax.jacfwd(twice, has_aux=True)(theta)
        jacobian = jnp.where(jnp.isfinite(jacobian), jacobian, 0.0)
        return residuals @ residuals, jacobian.T @ residuals, jacobian.T @ jacobian

    return Equations(jax.jit(jax.vmap(normal, in_axes=(0, None, None))), jax.jit(residual))


class Prior(NamedTuple):
    """A normal prior about the start of a search.

    Attributes
    ----------
    precision : float64 (p,)
        Of each entry, in units of what one sample weighs.
    samples : float
        Number of samples behind a cost.
    """

    precision: np.ndarray
    samples: float


class Bounds(NamedTuple):
    """Least and greatest values (p,) of the entries of a search vector."""

    low: np.ndarray
    high: np.ndarray


class Point(NamedTuple):
    """A batch of search vectors with what the normal equations say there."""

    theta: np.ndarray
    cost: np.ndarray
    gradient: np.ndarray
    matrix: np.ndarray


def search(
    normal: Callable[[np.ndarray], Any],
    start: np.ndarray,
    prior: Prior,
    tolerance: float = 1e-6,
    bounds: Bounds | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt on a batch.

    Parameters
    ----------
    normal : callable
        From search vectors (s, p) to costs (s,), gradients (s, p) and matrices (s, p, p).
    start : float64 (s, p)
        Start vectors.
    prior : Prior
        About the start vectors.
    tolerance : float
        Stop when no trial changes a cost by this fraction any more.
    bounds : Bounds, optional
        An entry that lies at its bound and would leave it rests there for the step (projected
        Levenberg-Marquardt; Kanzow, Yamashita, Fukushima 2004, doi:10.1016/j.cam.2004.02.013).

    Returns
    -------
    theta, cost : float64 (s, p), (s,)
    """
    if bounds is None:
        bounds = Bounds(np.full(start.shape[1], -np.inf), np.full(start.shape[1], np.inf))
    best = _point(normal, np.clip(start, *bounds))
    damping = np.full(len(start), 1e-2)
    idle = np.zeros(len(start), dtype=int)
    for _ in range(_MOST_TRIALS):
        precision = best.cost[:, None] / prior.samples * prior.precision
        moved = best.theta - _step(best, start, precision, damping, bounds)
        trial = _point(normal, np.clip(moved, *bounds))
        total = best.cost + (precision * (best.theta - start) ** 2).sum(axis=1)
        trial_total = trial.cost + (precision * (trial.theta - start) ** 2).sum(axis=1)
        better = trial_total < total
        small = np.abs(total - trial_total) <= tolerance * total
        idle = np.where(better & ~small, 0, idle + 1)
        best = Point(*map(functools.partial(_chosen, better), trial, best))
        damping = np.clip(np.where(better, 0.2 * damping, 5.0 * damping), 1e-12, 1e12)
        if (idle >= _PATIENCE).all():
            break
    return best.theta, best.cost


def _point(normal: Callable[[np.ndarray], Any], theta: np.ndarray) -> Point:
    return Point(theta, *map(np.asarray, normal(theta)))


def _step(
    point: Point, start: np.ndarray, precision: np.ndarray, damping: np.ndarray, bounds: Bounds
) -> np.ndarray:
    """The damped Gauss-Newton steps of a batch, subtracted from its vectors."""
    identity = np.eye(start.shape[1])
    full = point.matrix + precision[:, :, None] * identity
    diagonal = np.maximum(np.einsum("sii->si", full), 1e-300)
    damped = full + (damping[:, None] * diagonal)[:, :, None] * identity
    slope = point.gradient + precision * (point.theta - start)
    resting = ((point.theta <= bounds.low) & (slope > 0.0)) | (
        (point.theta >= bounds.high) & (slope < 0.0)
    )
    damped = np.where(resting[:, :, None] | resting[:, None, :], identity, damped)
    slope = np.where(resting, 0.0, slope)
    return np.asarray(np.linalg.solve(damped, slope[:, :, None])[:, :, 0])


def _chosen(better: np.ndarray, trial: np.ndarray, former: np.ndarray) -> np.ndarray:
    return np.where(better.reshape(-1, *[1] * (trial.ndim - 1)), trial, former)
