"""Levenberg-Marquardt minimisation from many starts simultaneously, with a prior and bounds.

Entries of the search vector are scaled so that the normal matrix has a unit diagonal. The damping is raised
or lowered tenfold (Marquardt 1963, doi:10.1137/0111030). The iteration is plain NumPy because compiling its
few operations took longer than most searches.
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
"""Function of search vectors (s, p) that returns costs (s,), gradients (s, p) and matrices (s, p, p)."""

TIE = 1e-7
"""Rms residuals count as equal if they differ by less than this fraction of the amplitude."""
_MAXIMUM_TRIALS = 120
_PATIENCE = 3
_AGREEMENT = 0.01  # relative difference of costs below which two starts have led to the same fit
_SETTLED_FRACTION = 0.9  # fraction of the starts that must reach the best fit for a search to end
_PROMISING_COST_RATIO = 4.0  # multiple of the lowest cost: a search does not wait for starts above it
_MAXIMUM_INVERSE_DAMPING, _MINIMUM_INVERSE_DAMPING = 1e6, 1e-12  # inverse damping
_NEGLIGIBLE_GAIN = 0.01  # fraction of the tolerance: a smaller predicted decrease is not worth a trial
# Inverse damping that hardly shortens a step: the predicted decrease is then the maximum possible.
_NEARLY_UNDAMPED = 1e4
# Factors of the inverse damping after a good trial and after a failed one.
_GROWTH_FACTOR, _SHRINK_FACTOR = 10.0, 0.1
_GOOD_TRIAL_RATIO = 0.25  # minimum decrease, as a fraction of the decrease that the quadratic model predicts


_DEADLINE: contextvars.ContextVar[tuple[float, str]] = contextvars.ContextVar("end", default=(math.inf, ""))


def spent_budget_text(budget: float) -> str:
    """Return the message of a fit or discovery that did not finish within a budget [s] of processor time."""
    return (
        f"not finished within the budget of {budget:g} s of processor time; to increase it: "
        f"budget={5.0 * budget:g} (--budget {5.0 * budget:g})"
    )


@contextlib.contextmanager
def time_budget(seconds: float, text: str) -> Iterator[None]:
    """Limit the processor time [s] in a ``with`` block; searches beyond the limit raise `TimeBudgetError`."""
    # Processor time, so that other work on the machine does not change the results. Of nested budgets the
    # first to end counts.
    token = _DEADLINE.set(min(_DEADLINE.get(), (time.process_time() + seconds, text)))
    try:
        yield
    finally:
        _DEADLINE.reset(token)


def _check_time_budget() -> None:
    end, text = _DEADLINE.get()
    if time.process_time() > end:
        raise TimeBudgetError(text)


class NormalPrior(NamedTuple):
    """A normal prior centred on the starting point of a search."""

    precision: Float[np.ndarray, "p"]  # precision of each entry, in units of the information of one sample
    samples: float  # number of samples, whose mean square defines that unit


class SearchBounds(NamedTuple):
    """Lower and upper bounds (p,) of a search vector; an entry is held if its two bounds are equal."""

    low: np.ndarray
    high: np.ndarray


Point = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Search vectors (s, p) with their costs (s,), gradients (s, p) and matrices (s, p, p)."""


@np.errstate(over="ignore", invalid="ignore")  # in starts that diverge
def levenberg_marquardt_vectors_and_costs(
    normal: Normal,
    start: Float[np.ndarray, "s p"],
    prior: NormalPrior,
    tolerance: float = 1e-6,
    bounds: SearchBounds | None = None,
    *,
    trials: int = _MAXIMUM_TRIALS,
    damping: float = 1e-2,
    waiting: Bool[np.ndarray, "s"] | None = None,
    patience: int = _PATIENCE,
) -> tuple[np.ndarray, np.ndarray]:
    """Minimise from a batch of start vectors; return the final search vectors (s, p) and costs (s,)."""
    if bounds is None:
        bounds = SearchBounds(np.full(start.shape[1], -np.inf), np.full(start.shape[1], np.inf))
    # Bounds may differ between starts: profiles hold a different entry in each.
    bounds = SearchBounds(*(np.broadcast_to(edge, start.shape) for edge in bounds))
    awaited = np.ones(len(start), dtype=bool) if waiting is None else waiting
    _check_time_budget()
    best = _evaluate_point(normal, np.clip(start, *bounds))
    inverse_damping = np.full(len(start), 1.0 / damping)
    idle = np.zeros(len(start), dtype=int)
    for _ in range(trials):
        _check_time_budget()
        theta, cost = best[:2]
        precision = cost[:, None] / prior.samples * prior.precision
        model = _quadratic_model(best, start, precision)
        moved, gain = _next_vectors_and_cost_decreases(model, theta, inverse_damping, bounds)
        total = cost + (precision * (theta - start) ** 2).sum(axis=1)
        idle = np.where(
            (gain <= _NEGLIGIBLE_GAIN * tolerance * total) & (inverse_damping >= _NEARLY_UNDAMPED),
            patience,
            idle,
        )
        if _starts_have_settled(idle >= patience, awaited, cost, prior.samples):
            break
        trial = _evaluate_point(normal, moved)
        trial_total = trial[1] + (precision * (moved - start) ** 2).sum(axis=1)
        better = trial_total < total
        step = (moved - theta) / model.scale
        predicted_change = 2.0 * (model.slope * step).sum(axis=1) + _quadratic_form(model.matrix, step)
        good = better & (trial_total - total < _GOOD_TRIAL_RATIO * predicted_change)
        factors = np.where(good, _GROWTH_FACTOR, np.where(trial_total <= total, 1.0, _SHRINK_FACTOR))
        inverse_damping = np.clip(
            factors * inverse_damping, _MINIMUM_INVERSE_DAMPING, _MAXIMUM_INVERSE_DAMPING
        )
        small = np.abs(total - trial_total) <= tolerance * total
        idle = np.where(better & ~small, 0, idle + 1)
        theta, cost, gradient, matrix = (
            np.where(better.reshape(-1, *[1] * (after.ndim - 1)), after, before)
            for after, before in zip(trial, best, strict=True)
        )
        best = theta, cost, gradient, matrix
        if _starts_have_settled(idle >= patience, awaited, cost, prior.samples):
            break
    return best[:2]


def _starts_have_settled(at_rest: np.ndarray, awaited: np.ndarray, cost: np.ndarray, samples: float) -> bool:
    """Return whether all awaited starts have converged, or nine tenths of all have reached the best fit."""
    # The last few starts may follow a curved valley for as long as all others together.
    agreeing = at_rest & (cost <= agreeing_cost_limit(cost, samples))
    return bool((at_rest | ~awaited).all() or agreeing.sum() >= _SETTLED_FRACTION * len(cost))


def agreeing_cost_limit(cost: Float[np.ndarray, "s"], samples: float) -> float:
    """Return the cost up to which a start counts as having reached the best fit."""
    return float((1.0 + _AGREEMENT) * cost.min() + samples * TIE**2)


def promising_start_mask(cost: Float[np.ndarray, "s"], samples: float) -> Bool[np.ndarray, "s"]:
    """Return a mask of the starts that may still lead to the best fit."""
    return np.asarray(cost <= _PROMISING_COST_RATIO * cost.min() + samples * TIE**2)


def _evaluate_point(normal: Normal, theta: np.ndarray) -> Point:
    cost, gradient, matrix = map(np.asarray, normal(theta))
    return theta, cost, gradient, matrix


class _QuadraticModel(NamedTuple):
    """Quadratic model of half the cost, in entries scaled to a unit diagonal."""

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


def _next_vectors_and_cost_decreases(
    model: _QuadraticModel,
    theta: Float[np.ndarray, "s p"],
    inverse_damping: Float[np.ndarray, "s"],
    bounds: SearchBounds,
) -> tuple[Float[np.ndarray, "s p"], Float[np.ndarray, "s"]]:
    """Return the next search vectors within the bounds, and the cost decreases that the model predicts."""
    slope, matrix, scale = model
    at_rest = (
        ((theta <= bounds.low) & (slope >= 0.0))
        | ((theta >= bounds.high) & (slope <= 0.0))
        | (bounds.low == bounds.high)
    )
    identity = np.eye(theta.shape[1])
    matrix = np.where(at_rest[:, :, None] | at_rest[:, None, :], identity, matrix)
    slope = np.where(at_rest, 0.0, slope)
    damped = matrix + identity / inverse_damping[:, None, None]
    step = -np.linalg.solve(damped, slope[:, :, None])[:, :, 0]
    gain = -2.0 * (slope * step).sum(axis=1) - _quadratic_form(matrix, step)
    moved = np.clip(theta + scale * step, *bounds)
    return np.where(np.isfinite(moved), moved, theta), gain


def _quadratic_form(
    matrix: Float[np.ndarray, "s p p"], step: Float[np.ndarray, "s p"]
) -> Float[np.ndarray, "s"]:
    return np.einsum("sp,spq,sq->s", step, matrix, step)
