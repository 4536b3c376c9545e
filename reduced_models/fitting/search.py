"""Least squares through a law's equation: a batched Levenberg-Marquardt search.

All starts, with their sensitivities, go through the same compiled loop side by side. A solution
that blows up costs no more than one that does not.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from reduced_models.jax_setup import jax
from reduced_models.laws.law import compiled_field, parse
from reduced_models.laws.solution import between, on_grid
from reduced_models.records.inputs import STAGE_TIMES

jnp = jax.numpy

BLOWN_UP = 1e3
"""Residual of a sample that a solution does not reach, in amplitudes."""
_MOST_TRIALS = 120
_PATIENCE = 3  # trials without a gain after which a start counts as done
TIE = 1e-7
"""Residuals below this, in amplitudes, are not told apart."""
_AGREE = 0.01  # costs that differ by less than this fraction are those of the same fit
_ENOUGH = 0.9  # share of the starts that lead to the best fit, behind which a search ends
_DAMPING = (1e-6, 1e12)  # a weaker one would only have to be raised again in a bent valley


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

    def residuals(vectors: Any, samples: Any, scales: Any) -> Any:
        """Residuals (n, s) of search vectors that are columns (p, s)."""
        step, place, share, height, weight, drive = samples
        values, shift, scale, z0, v0 = physical(vectors, scales)
        start = (z0, v0, *(jnp.zeros_like(z0) for _ in range(hidden)))
        grid = on_grid(field, start, values, drive, step)
        z = between(*grid, step, place, share[:, None])
        found = (shift + scale * z - height[:, None]) / scales[1]
        return weight[:, None] * jnp.where(jnp.abs(found) < BLOWN_UP, found, BLOWN_UP)

    def residual(theta: Any, samples: Any, scales: Any) -> Any:
        return residuals(theta[:, None], samples, scales)[:, 0]

    def normal(theta: Any, samples: Any, scales: Any) -> Any:
        # Starts side by side in the last axis, directions before them: that vectorises best.
        vectors = theta.T
        directions = jnp.eye(len(vectors))[:, :, None] * jnp.ones_like(vectors)

        def slope(direction: Any) -> Any:
            return jax.jvp(lambda each: residuals(each, samples, scales), (vectors,), (direction,))

        left, jacobian = jax.vmap(slope, out_axes=(None, 0))(directions)
        jacobian = jnp.where(jnp.isfinite(jacobian), jacobian, 0.0)
        return (
            (left**2).sum(axis=0),
            jnp.einsum("pns,ns->sp", jacobian, left),
            jnp.einsum("pns,qns->spq", jacobian, jacobian),
        )

    return Equations(jax.jit(normal), jax.jit(residual))


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
    *,
    trials: int = _MOST_TRIALS,
    damping: float = 1e-2,
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt on a batch.

    It ends when nine tenths of the batch have come to rest at the same least cost, or all of it
    somewhere: the last few may follow a bent valley for as long as all the others together.

    Parameters
    ----------
    normal : callable
        From search vectors (s, p) to costs (s,), gradients (s, p) and matrices (s, p, p).
    start : float64 (s, p)
        Start vectors.
    prior : Prior
        About the start vectors.
    tolerance : float
        A start comes to rest when no trial changes its cost by this fraction any more.
    bounds : Bounds, optional
        An entry that lies at its bound and would leave it rests there for the step (projected
        Levenberg-Marquardt; Kanzow, Yamashita, Fukushima 2004, doi:10.1016/j.cam.2004.02.013).
    trials : int
        At most.
    damping : float
        Of the first step, in the diagonal of the matrix.

    Returns
    -------
    theta, cost : float64 (s, p), (s,)
    """
    if bounds is None:
        bounds = Bounds(np.full(start.shape[1], -np.inf), np.full(start.shape[1], np.inf))
    best = _point(normal, np.clip(start, *bounds))
    dampings = np.full(len(start), damping)
    idle = np.zeros(len(start), dtype=int)
    for _ in range(trials):
        precision = best.cost[:, None] / prior.samples * prior.precision
        moved = best.theta - _step(best, start, precision, dampings, bounds)
        trial = _point(normal, np.clip(moved, *bounds))
        total = best.cost + (precision * (best.theta - start) ** 2).sum(axis=1)
        trial_total = trial.cost + (precision * (trial.theta - start) ** 2).sum(axis=1)
        better = trial_total < total
        small = np.abs(total - trial_total) <= tolerance * total
        idle = np.where(better & ~small, 0, idle + 1)
        best = Point(*map(functools.partial(_chosen, better), trial, best))
        dampings = np.clip(np.where(better, 0.1 * dampings, 10.0 * dampings), *_DAMPING)
        resting = idle >= _PATIENCE
        agreeing = resting & (best.cost <= agreement(best.cost, prior.samples))
        if resting.all() or agreeing.sum() >= _ENOUGH * len(start):
            break
    return best.theta, best.cost


def agreement(cost: np.ndarray, samples: float) -> float:
    """The cost up to which starts have led to the best fit."""
    return float((1.0 + _AGREE) * cost.min() + samples * TIE**2)


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
