"""Levenberg-Marquardt for many starts side by side, with a prior and bounds.

Steps, and how far they may go, are optimistix's: its damped Newton descent and its trust region,
on entries that are scaled to a unit diagonal of the normal matrix (Marquardt 1963,
doi:10.1137/0111030). The loop is stepped from here, so that what is compiled does not depend on
the law.
"""

from __future__ import annotations

import contextlib
import contextvars
import functools
import math
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import lineax
import numpy as np
import optimistix

from granular.shared.errors import TimeBudgetError
from reduced_models.jax_setup import jax, jit

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

jnp = jax.numpy

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
_SHARED_STARTS, _SHARED_ENTRIES = 16, 8  # multiples that a batch and its vectors are filled up to
# A step is taken whenever the cost falls; the damping changes tenfold, as Marquardt's (1963).
_TRUST: optimistix.ClassicalTrustRegion[Any] = optimistix.ClassicalTrustRegion(
    high_cutoff=0.25, low_cutoff=0.0, high_constant=10.0, low_constant=0.1
)
_DESCENT: optimistix.DampedNewtonDescent[Any] = optimistix.DampedNewtonDescent(
    linear_solver=lineax.Cholesky()
)


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
        moved, gain = _padded_call(_next_vectors, best, start, precision, sizes, bounds)
        moved = np.where(np.isfinite(moved), moved, theta)
        total = cost + (precision * (theta - start) ** 2).sum(axis=1)
        idle = np.where((gain <= _VAIN * tolerance * total) & (sizes >= _LONG), patience, idle)
        if _starts_have_settled(idle >= patience, wanted, cost, prior.samples):
            break
        trial = _evaluate_point(normal, moved)
        trial_total = trial[1] + (precision * (moved - start) ** 2).sum(axis=1)
        better, sizes = _padded_call(_judge_steps, best, start, precision, sizes, moved, total, trial_total)
        sizes = np.clip(sizes, _SHORTEST, _LONGEST)
        small = np.abs(total - trial_total) <= tolerance * total
        idle = np.where(better & ~small, 0, idle + 1)
        theta, cost, gradient, matrix = map(functools.partial(_select_rows, better), trial, best)
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


def _padded_call(function: Callable[..., Any], *arguments: Any) -> list[np.ndarray]:
    """Results of a compiled function, padded so that batches of similar size share its code."""
    # Padding entries are between equal bounds, zero and zero, where they change no other.
    starts, entries = arguments[0][0].shape
    rows = 1 if starts == 1 else _SHARED_STARTS * math.ceil(starts / _SHARED_STARTS)
    columns = _SHARED_ENTRIES * math.ceil(entries / _SHARED_ENTRIES)
    sizes = rows, columns, columns

    def fill(array: np.ndarray) -> np.ndarray:
        result = np.zeros(sizes[: array.ndim])
        result[tuple(map(slice, array.shape))] = array
        return result

    results = map(np.asarray, function(*jax.tree.map(fill, arguments)))
    return [result[tuple(map(slice, (starts, entries)[: result.ndim]))] for result in results]


def _evaluate_point(normal: Normal, theta: np.ndarray) -> Point:
    cost, gradient, matrix = map(np.asarray, normal(theta))
    return theta, cost, gradient, matrix


def _scale_coefficients(
    best: Point, start: jax.Array, precision: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Slope and matrix of a search vector's half cost in scaled entries, and their scale."""
    theta, _, gradient, matrix = best
    full = jnp.asarray(matrix) + jnp.diag(precision)
    scale = 1.0 / jnp.sqrt(jnp.maximum(jnp.diag(full), 1e-300))
    slope = jnp.asarray(gradient) + precision * (theta - start)
    return scale * slope, full * jnp.outer(scale, scale), scale


def _quadratic_model(half_cost: Any, slope: jax.Array, matrix: jax.Array) -> Any:
    """Cost, slope and matrix at a point, as optimistix takes them."""
    operator = lineax.MatrixLinearOperator(matrix, lineax.positive_semidefinite_tag)
    return optimistix.FunctionInfo.EvalGradHessian(half_cost, slope, operator)


@jit
@jax.vmap
def _next_vectors(
    best: Point, start: jax.Array, precision: jax.Array, size: jax.Array, bounds: Bounds
) -> tuple[jax.Array, jax.Array]:
    """Next search vectors, within the bounds, and what of the cost they promise to save."""
    theta, cost, *_ = best
    slope, matrix, scale = _scale_coefficients(best, start, precision)
    resting = (
        ((theta <= bounds.low) & (slope >= 0.0))
        | ((theta >= bounds.high) & (slope <= 0.0))
        | (bounds.low == bounds.high)
    )
    identity = jnp.eye(len(slope))
    matrix = jnp.where(resting[:, None] | resting[None, :], identity, matrix)
    slope = jnp.where(resting, 0.0, slope)
    point = _quadratic_model(0.5 * cost, slope, matrix)
    state = _DESCENT.query(slope, point, _DESCENT.init(slope, point))
    step, _ = _DESCENT.step(size, state)
    gain = -2.0 * slope @ step - step @ matrix @ step
    return jnp.clip(theta + scale * step, bounds.low, bounds.high), gain


@jit
@jax.vmap
def _judge_steps(
    best: Point,
    start: jax.Array,
    precision: jax.Array,
    size: jax.Array,
    moved: jax.Array,
    total: jax.Array,
    trial_total: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Decide whether steps are accepted, and return the size of the next ones."""
    slope, matrix, scale = _scale_coefficients(best, start, precision)
    here = _quadratic_model(0.5 * total, slope, matrix)
    there = optimistix.FunctionInfo.Eval(0.5 * trial_total)
    state = _TRUST.init(slope, here)
    state = type(state)(step_size=size)
    origin = jnp.zeros_like(slope)
    length, accepted, _, _ = _TRUST.step(
        jnp.array(False), origin, (moved - best[0]) / scale, here, there, state
    )
    return accepted & (trial_total < total), length


def _select_rows(better: np.ndarray, trial: np.ndarray, former: np.ndarray) -> np.ndarray:
    return np.where(better.reshape(-1, *[1] * (trial.ndim - 1)), trial, former)
