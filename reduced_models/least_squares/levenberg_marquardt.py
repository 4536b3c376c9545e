"""A batched Levenberg-Marquardt search: many starts side by side, with a prior and bounds."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Normal = Callable[[np.ndarray], Any]
"""From search vectors (s, p) to costs (s,), gradients (s, p) and matrices (s, p, p)."""

TIE = 1e-7
"""Residuals below this, in amplitudes, are not told apart."""
_MOST_TRIALS = 120
_PATIENCE = 3  # trials without a gain after which a start counts as done
_AGREE = 0.01  # costs that differ by less than this fraction are those of the same fit
_ENOUGH = 0.9  # share of the starts that lead to the best fit, behind which a search ends
_DAMPING = (1e-6, 1e12)  # a weaker one would only have to be raised again in a bent valley


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


class Batch(NamedTuple):
    """A batch of search vectors with what the normal equations say there."""

    theta: np.ndarray
    cost: np.ndarray
    gradient: np.ndarray
    matrix: np.ndarray


def search(
    normal: Normal,
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
    best = _batch(normal, np.clip(start, *bounds))
    dampings = np.full(len(start), damping)
    idle = np.zeros(len(start), dtype=int)
    for _ in range(trials):
        precision = best.cost[:, None] / prior.samples * prior.precision
        moved = best.theta - _step(best, start, precision, dampings, bounds)
        trial = _batch(normal, np.clip(moved, *bounds))
        total = best.cost + (precision * (best.theta - start) ** 2).sum(axis=1)
        trial_total = trial.cost + (precision * (trial.theta - start) ** 2).sum(axis=1)
        better = trial_total < total
        small = np.abs(total - trial_total) <= tolerance * total
        idle = np.where(better & ~small, 0, idle + 1)
        best = Batch(*map(functools.partial(_chosen, better), trial, best))
        dampings = np.clip(np.where(better, 0.1 * dampings, 10.0 * dampings), *_DAMPING)
        resting = idle >= _PATIENCE
        agreeing = resting & (best.cost <= agreement(best.cost, prior.samples))
        if resting.all() or agreeing.sum() >= _ENOUGH * len(start):
            break
    return best.theta, best.cost


def agreement(cost: np.ndarray, samples: float) -> float:
    """The cost up to which starts have led to the best fit."""
    return float((1.0 + _AGREE) * cost.min() + samples * TIE**2)


def _batch(normal: Normal, theta: np.ndarray) -> Batch:
    return Batch(theta, *map(np.asarray, normal(theta)))


def _step(
    batch: Batch, start: np.ndarray, precision: np.ndarray, damping: np.ndarray, bounds: Bounds
) -> np.ndarray:
    """The damped Gauss-Newton steps of a batch, subtracted from its vectors."""
    identity = np.eye(start.shape[1])
    full = batch.matrix + precision[:, :, None] * identity
    diagonal = np.maximum(np.einsum("sii->si", full), 1e-300)
    damped = full + (damping[:, None] * diagonal)[:, :, None] * identity
    slope = batch.gradient + precision * (batch.theta - start)
    resting = ((batch.theta <= bounds.low) & (slope > 0.0)) | (
        (batch.theta >= bounds.high) & (slope < 0.0)
    )
    damped = np.where(resting[:, :, None] | resting[:, None, :], identity, damped)
    slope = np.where(resting, 0.0, slope)
    return np.asarray(np.linalg.solve(damped, slope[:, :, None])[:, :, 0])


def _chosen(better: np.ndarray, trial: np.ndarray, former: np.ndarray) -> np.ndarray:
    return np.where(better.reshape(-1, *[1] * (trial.ndim - 1)), trial, former)
