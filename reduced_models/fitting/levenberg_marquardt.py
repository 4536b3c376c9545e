"""Levenberg-Marquardt for many starts side by side, with a prior and bounds.

Entries are scaled to a unit diagonal of the normal matrix, and the damping changes tenfold (Marquardt
1963, doi:10.1137/0111030). The batch is stepped in NumPy: compiling the few operations of a step took
longer than most searches.
"""

from __future__ import annotations

import contextlib
import contextvars
import math
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from granular.shared.array_types import Bool, Float
from granular.shared.errors import TimeBudgetError

Normal = Callable[[np.ndarray], Any]
"""Map from search vectors (s, p) to costs (s,), gradients (s, p) and matrices (s, p, p)."""

TIE = 1e-7
"""Residuals below this, in amplitudes, are not told apart."""
_MOST_TRIALS = 120
_PATIENCE = 3
_AGREE = 0.01  # costs that differ by less than this fraction are those of the same fit
_ENOUGH = 0.9  # fraction of the starts that lead to the best fit, behind which a search ends
_IN_THE_RUNNING = 4.0  # times the least cost: starts above it are not waited for
_LONGEST, _SHORTEST = 1e6, 1e-12  # steps: one over the damping
_VAIN = 0.01  # of the tolerance: a promise below it is not worth a trial
_LONG = 1e4  # steps that damping hardly shortens: what they promise is what there is to gain
_FAR, _NEAR = 10.0, 0.1  # factors of the step's length behind a good trial and a vain one
_GOOD = 0.25  # of the saving that the quadratic model promises


_END: contextvars.ContextVar[tuple[float, str]] = contextvars.ContextVar("end", default=(math.inf, ""))


def spent_budget_text(budget: float) -> str:
    """Say of a law or a discovery that it came too late for a budget, and how to give more; budget [s]."""
    return (
        f"not done when the budget of {budget:g} s of processor was spent; for more: "
        f"budget={5.0 * budget:g} (--budget {5.0 * budget:g})"
    )


@contextlib.contextmanager
def time_budget(seconds: float, words: str) -> Iterator[None]:
    """Let searches begun within it end with `TimeBudgetError` after so much processor time; seconds [s]."""
    # Processor time, so that other work on the machine does not change the results; of nested budgets the one
    # that ends first counts.
    token = _END.set(min(_END.get(), (time.process_time() + seconds, words)))
    try:
        yield
    finally:
        _END.reset(token)


def _check_budget() -> None:
    end, words = _END.get()
    if time.process_time() > end:
        raise TimeBudgetError(words)


class Prior(NamedTuple):
    """A normal prior about the start of a search."""

    precision: Float[np.ndarray, "p"]  # of each entry, in the information of one sample
    samples: float  # whose mean square is the unit of that information


class Bounds(NamedTuple):
    """Least and greatest values (p,) of the entries of a search vector; equal ones hold it."""

    low: np.ndarray
    high: np.ndarray


Point = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Search vectors (s, p) with their costs (s,), gradients (s, p) and matrices (s, p, p)."""


@np.errstate(over="ignore", invalid="ignore")  # of starts that blow up
def levenberg_marquardt(
    normal: Normal,
    start: Float[np.ndarray, "s p"],
    prior: Prior,
    tolerance: float = 1e-6,
    bounds: Bounds | None = None,
    *,
    trials: int = _MOST_TRIALS,
    damping: float = 1e-2,
    waiting: Bool[np.ndarray, "s"] | None = None,
    patience: int = _PATIENCE,
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt on a batch."""
    if bounds is None:
        bounds = Bounds(np.full(start.shape[1], -np.inf), np.full(start.shape[1], np.inf))
    # Each start has its own where one has: profiles hold another entry in each.
    bounds = Bounds(*(np.broadcast_to(edge, start.shape) for edge in bounds))
    wanted = np.ones(len(start), dtype=bool) if waiting is None else waiting
    _check_budget()
    best = _evaluate_point(normal, np.clip(start, *bounds))
    sizes = np.full(len(start), 1.0 / damping)
    idle = np.zeros(len(start), dtype=int)
    for _ in range(trials):
        _check_budget()
        theta, cost = best[:2]
        precision = cost[:, None] / prior.samples * prior.precision
        model = _quadratic_model(best, start, precision)
        moved, gain = _next_vectors(model, theta, sizes, bounds)
        total = cost + (precision * (theta - start) ** 2).sum(axis=1)
        idle = np.where((gain <= _VAIN * tolerance * total) & (sizes >= _LONG), patience, idle)
        if _starts_have_settled(idle >= patience, wanted, cost, prior.samples):
            break
        trial = _evaluate_point(normal, moved)
        trial_total = trial[1] + (precision * (moved - start) ** 2).sum(axis=1)
        better = trial_total < total
        step = (moved - theta) / model.scale
        promised = 2.0 * (model.slope * step).sum(axis=1) + _form(model.matrix, step)
        good = better & (trial_total - total < _GOOD * promised)
        factors = np.where(good, _FAR, np.where(trial_total <= total, 1.0, _NEAR))
        sizes = np.clip(factors * sizes, _SHORTEST, _LONGEST)
        small = np.abs(total - trial_total) <= tolerance * total
        idle = np.where(better & ~small, 0, idle + 1)
        theta, cost, gradient, matrix = (
            np.where(better.reshape(-1, *[1] * (after.ndim - 1)), after, before)
            for after, before in zip(trial, best, strict=True)
        )
        best = theta, cost, gradient, matrix
        if _starts_have_settled(idle >= patience, wanted, cost, prior.samples):
            break
    return best[:2]


def _starts_have_settled(resting: np.ndarray, wanted: np.ndarray, cost: np.ndarray, samples: float) -> bool:
    """Return whether all that are wanted rest, or nine tenths of them at the same least cost."""
    # The last few starts may follow a bent valley for as long as all others together.
    agreeing = resting & (cost <= agreeing_cost_limit(cost, samples))
    return bool((resting | ~wanted).all() or agreeing.sum() >= _ENOUGH * len(cost))


def agreeing_cost_limit(cost: Float[np.ndarray, "s"], samples: float) -> float:
    """Cost up to which starts have led to the best fit."""
    return float((1.0 + _AGREE) * cost.min() + samples * TIE**2)


def promising_starts(cost: Float[np.ndarray, "s"], samples: float) -> Bool[np.ndarray, "s"]:
    """Mask of the starts that may still lead to the best fit."""
    return np.asarray(cost <= _IN_THE_RUNNING * cost.min() + samples * TIE**2)


def _evaluate_point(normal: Normal, theta: np.ndarray) -> Point:
    cost, gradient, matrix = map(np.asarray, normal(theta))
    return theta, cost, gradient, matrix


class _QuadraticModel(NamedTuple):
    """Half cost about search vectors, in entries that are scaled to a unit diagonal."""

    slope: Float[np.ndarray, "s p"]
    matrix: Float[np.ndarray, "s p p"]
    scale: Float[np.ndarray, "s p"]


def _quadratic_model(
    best: Point, start: Float[np.ndarray, "s p"], precision: Float[np.ndarray, "s p"]
) -> _QuadraticModel:
    theta, _, gradient, matrix = best
    full = matrix + precision[:, :, None] * np.eye(theta.shape[1])
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(full, axis1=1, axis2=2), 1e-300))
    slope = scale * (gradient + precision * (theta - start))
    return _QuadraticModel(slope, full * scale[:, :, None] * scale[:, None, :], scale)


def _next_vectors(
    model: _QuadraticModel, theta: Float[np.ndarray, "s p"], sizes: Float[np.ndarray, "s"], bounds: Bounds
) -> tuple[Float[np.ndarray, "s p"], Float[np.ndarray, "s"]]:
    """Next search vectors, within the bounds, and the part of the cost that they promise to save."""
    slope, matrix, scale = model
    resting = (
        ((theta <= bounds.low) & (slope >= 0.0))
        | ((theta >= bounds.high) & (slope <= 0.0))
        | (bounds.low == bounds.high)
    )
    identity = np.eye(theta.shape[1])
    matrix = np.where(resting[:, :, None] | resting[:, None, :], identity, matrix)
    slope = np.where(resting, 0.0, slope)
    damped = matrix + identity / sizes[:, None, None]
    step = -np.linalg.solve(damped, slope[:, :, None])[:, :, 0]
    gain = -2.0 * (slope * step).sum(axis=1) - _form(matrix, step)
    moved = np.clip(theta + scale * step, *bounds)
    return np.where(np.isfinite(moved), moved, theta), gain


def _form(matrix: Float[np.ndarray, "s p p"], step: Float[np.ndarray, "s p"]) -> Float[np.ndarray, "s"]:
    return np.einsum("sp,spq,sq->s", step, matrix, step)
