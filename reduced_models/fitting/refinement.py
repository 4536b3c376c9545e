"""Refine the best start of a search on fine grids, and compare it with a fit to accelerations.

From the best start the law is fitted to all samples, on grids that are refined until the solution agrees
with the adaptive solver. If the fit ends in another minimum than the start, the law is also fitted over
times that grow from half a cycle. The better fit is compared with a second fit. The second fit starts from
known parameters, or from a fit to the accelerations in the record, which requires no solution of the
equation. The fit of a driven law is repeated with shifted inputs, in order to report inputs that are early
or late.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.shared.array_types import Bool, Float, Int
from granular.shared.errors import InputError, quote
from reduced_models.fitting.fit_data import FitData
from reduced_models.fitting.levenberg_marquardt import TIE, Normal, agreeing_cost_limit
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.residuals import DIVERGED_RESIDUAL, residual_costs_and_weights
from reduced_models.fitting.start_values import (
    StartDrawsNearValues,
    append_initial_state,
    fit_to_accelerations,
    search_entries_from_draws,
)
from reduced_models.fitting.uncertainty import rest_height_period_and_damping
from reduced_models.laws.linearization import NoOscillationReason
from reduced_models.laws.solution import observed_signal, solve_law
from reduced_models.laws.symmetry import canonical_parameters
from reduced_models.records.inputs import STROKE, TIME, input_column

_FIRST_REFIT_CYCLES, _HORIZON_GROWTH = 0.5, math.sqrt(2.0)
"""A fit on fine grids covers this number of cycles at first; each step multiplies the fitted time by this
factor. With these values, 26 of 26 starts with errors of 1e-3 lead to the fit of a chaotic motion between two
wells. With two cycles and a factor of 2, only 23 of the 26 starts do."""
SOLVER_LIMIT, RESIDUAL_SHARE = 1e-6, 0.05
"""The error of the fitted solution may reach the first fraction of the amplitude, or the second fraction of
the residual's standard deviation, whichever is larger."""
# Steps of a grid: 8,192 periods at `FINE_STEPS`.
MAXIMUM_STEPS = 2**19
_SAME_MINIMUM_COST_RATIO = 2.0  # multiple of the cost of the fit
_PARABOLA_TOLERANCE = 0.5  # maximum relative difference of a cost from the parabola about a fit
COMPARISON_TOLERANCE = 1e-4  # relative tolerance of the cost of a fit that is only compared
_HELD_OUT_TOLERANCE, _MAXIMUM_HELD_OUT_STEPS, _UNDETERMINED_STRENGTH = 1e-8, 4, 1e-10
"""Settings of the fit that is tested on held-out cycles: relative tolerance of the cost, and maximum number
of steps. A direction is undetermined if its singular value, relative to the largest, is below the third."""
_NEAR_ALIAS_FRACTION = 0.4  # fraction of half the sampling rate; below it no start is near its mirror image
_SAME_VECTOR_TOLERANCE = 0.05  # relative difference of entries up to which two search vectors are the same
# Cost ratio below which a fit is better. The margin of 1 % is a hundred times `COMPARISON_TOLERANCE`, so an
# unfinished fit does not count as a different fit.
BETTER_COST_RATIO = 0.99


class SearchedStarts(NamedTuple):
    """Search vectors that a search has reached from its starts."""

    theta: Float[np.ndarray, "s q"]
    costs: Float[np.ndarray, "s"]
    origins: Int[np.ndarray, "s"]  # the same number for starts that deviate slightly from one another

    def agreeing_start_and_origin_counts(self, agreeing: Bool[np.ndarray, "s"]) -> tuple[int, int]:
        """Return the number of starts in a mask, and the number of clearly different starts among them."""
        return int(agreeing.sum()), len(np.unique(self.origins[agreeing]))


@dataclasses.dataclass(frozen=True, eq=False)
class SearchResult:
    """A fit problem and the current state of its solution."""

    problem: FitProblem
    trained: Float[np.ndarray, "q"]  # search vector fitted without the held-out cycles
    theta: Float[np.ndarray, "q"]  # fitted to all samples; before verification to the training stretch
    converged: int  # number of starts that led to this fit
    independent: int  # number of these starts with different origins
    cost: float  # cost of the training residuals; infinite if the solution diverges
    coarse_cost: float  # the same for the means on the search's coarse grid
    collocation: str = "none"
    solver_errors: tuple[float, ...] = ()  # differences from the adaptive solution, in amplitudes

    def with_other_training_fit(self, problem: FitProblem, trained: Float[np.ndarray, "q"]) -> SearchResult:
        """Return the result with another fit to the training segments."""
        return dataclasses.replace(self, problem=problem, trained=trained, theta=trained)


def refine_best_start(problem: FitProblem, coarse: FitProblem, searched: SearchedStarts) -> SearchResult:
    """Fit on fine grids, starting from the best start of a search; compare with the fit to accelerations."""
    costs = searched.costs
    count = sum(problem.training_sample_counts)
    first = _best_on_fine_grid(problem, searched)
    best = refit_over_growing_times(problem, first, [float(data.record.time[-1]) for data in coarse.data])
    fitted, coarse_cost = best, float(costs.min())
    best = _fit_again_from_first_cycles(problem, first, fitted)
    cost = _cost_of_training_segments(problem, best)
    if best is not fitted:  # on the coarse grid no start has been followed to this fit
        coarse_cost *= cost / _cost_of_training_segments(problem, fitted)
    other = _fit_from_accelerations(problem, best, cost)
    collocation = "none"
    if other is best:
        collocation = "same"
    elif other is not None:
        tie = count * TIE**2
        other_cost = _cost_of_training_segments(problem, other)
        collocation = "same" if other_cost * BETTER_COST_RATIO <= cost + tie else "worse"
        if other_cost + tie < BETTER_COST_RATIO * cost:
            coarse_cost *= other_cost / cost
            best = problem.refit(other, problem.training_sample_counts)
            cost, collocation = _cost_of_training_segments(problem, best), "better"
    if isinstance(problem.law.start, StartDrawsNearValues):
        collocation = "none"  # the second fit started from given values, not from accelerations
    limit = agreeing_cost_limit(np.array([coarse_cost]), count)
    return SearchResult(
        problem,
        best,
        best,
        *searched.agreeing_start_and_origin_counts(costs <= limit),
        cost,
        coarse_cost,
        collocation,
    )


def _fit_again_from_first_cycles(problem: FitProblem, start: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """If the start lies in another minimum, fit again over growing horizons; return the better fit."""
    # Chaotic motions amplify the coarse grid's error, so that a fit to the complete record from there ends
    # in a local minimum.
    cost = _cost_of_training_segments(problem, fitted)
    cost_increase = _cost_of_training_segments(problem, start) - cost
    normal = problem.make_normal_equations(problem.training_sample_counts)
    stuck = bool((fitted == start).all())
    if not stuck and _agrees_with_parabola(normal, fitted, start, cost_increase):
        return fitted
    other = refit_over_growing_times(problem, start, _ends_of_first_horizons(problem))
    return other if _cost_of_training_segments(problem, other) < BETTER_COST_RATIO * cost else fitted


def distinct_vectors(vectors: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the vectors, without any vector that nearly equals an earlier vector."""
    distinct = list(vectors[:1])
    for theta in vectors[1:]:
        if not any(
            np.allclose(theta, other, rtol=_SAME_VECTOR_TOLERANCE, atol=_SAME_VECTOR_TOLERANCE)
            for other in distinct
        ):
            distinct.append(theta)
    return distinct


def _best_on_fine_grid(problem: FitProblem, searched: SearchedStarts) -> np.ndarray:
    """Among vectors with equal cost on the coarse grid, return the best on a fine grid."""
    # On a coarse grid, motions that decay within a step or two can fit, although no solution has them.
    thetas, costs, _ = searched
    limit = agreeing_cost_limit(costs, sum(problem.training_sample_counts))
    equal = [thetas[k] for k in np.argsort(costs, kind="stable") if costs[k] <= limit]
    candidates = [_canonical_vector(problem, theta) for theta in distinct_vectors(equal)]
    slow = [theta for theta in candidates if not _oscillates_above_half_sampling_rate(problem, theta)]
    candidates = slow or candidates
    if len(candidates) == 1:
        return candidates[0]
    return min(candidates, key=lambda theta: _cost_of_training_segments(problem, theta))


def _oscillates_above_half_sampling_rate(problem: FitProblem, theta: np.ndarray) -> bool:
    """Return whether a vector's small oscillation is faster than half the sampling rate of a record."""
    for data in problem.data:
        if data.guess.frequency < _NEAR_ALIAS_FRACTION * data.guess.fastest:
            continue
        figures = rest_height_period_and_damping(problem.unknowns, theta[data.joint_vector_indices])
        if not isinstance(figures, NoOscillationReason) and math.tau / figures[1] > data.guess.fastest:
            return True
    return False


def _canonical_vector(problem: FitProblem, theta: np.ndarray) -> np.ndarray:
    """Return an equivalent search vector whose angles and signs have their canonical form."""
    unknowns, first = problem.unknowns, problem.data[0]
    saved = {*first.per_record, *problem.bounds}
    theta = theta.copy()
    names, here = unknowns.law.parameters, first.joint_vector_indices
    values = dict(zip(names, unknowns.physical_values(theta[here])[0], strict=True))
    moved = canonical_parameters(unknowns.law, values, saved)
    for entry, name, unit in zip(here, names, unknowns.units, strict=False):
        if moved[name] != values[name]:
            theta[entry] = moved[name] / unit
    return theta


def _cost_of_training_segments(problem: FitProblem, theta: np.ndarray) -> float:
    return cost_of_first_samples(problem, theta, problem.training_sample_counts)


def cost_of_first_samples(problem: FitProblem, theta: np.ndarray, counts: Sequence[int]) -> float:
    """Return the cost of the first samples of all records; infinite if the solution diverges."""
    total = 0.0
    for data, residuals, count in zip(problem.data, problem.residuals(theta), counts, strict=True):
        left = residuals[:count]
        if (np.abs(left) >= DIVERGED_RESIDUAL).any():
            return math.inf
        weighted = left * data.weights[:count]
        total += float(residual_costs_and_weights(weighted, data.loss.compiled_arguments, np)[0].sum())
    return total


def refit_over_growing_times(
    problem: FitProblem, theta: np.ndarray, reached: Sequence[float], tolerance: float = 1e-11
) -> np.ndarray:
    """Fit the training segments on fine grids, over times that grow from the time already fitted."""
    times = [data.record.time[: data.training] for data in problem.data]
    fraction = min(end / float(time[-1]) for end, time in zip(reached, times, strict=True))
    while fraction < 0.999:
        counts = [max(4, int(np.searchsorted(time, fraction * time[-1]))) for time in times]
        theta = problem.refit(theta, counts, tolerance=max(tolerance, 1e-6))
        fraction *= _HORIZON_GROWTH
    return problem.refit(theta, problem.training_sample_counts, tolerance=tolerance)


def _fit_from_accelerations(problem: FitProblem, theta: np.ndarray, cost: float) -> np.ndarray | None:
    """Refit from known parameters or a fit to accelerations; None if neither is possible for the law."""
    unknowns, largest_amplitude_data = problem.unknowns, problem.largest_amplitude_data
    law = unknowns.law
    if law.hidden or law.prescribed or problem.data[0].per_record or law.parsed_equation.line is not None:
        return None
    if isinstance(law.start, StartDrawsNearValues):  # more accurate than a fit to accelerations
        matched = np.array([law.start.values[name] for name in law.parameters])
    else:
        matched = fit_to_accelerations(
            law,
            largest_amplitude_data.guess,
            largest_amplitude_data.clipped_motion,
            np.array(unknowns.physical_values(theta[problem.data[0].joint_vector_indices])[0]),
            largest_amplitude_data.bounds,
        )
    free = search_entries_from_draws(
        unknowns, {name: matched[None, k] for k, name in enumerate(unknowns.law.parameters)}
    )
    starts = [append_initial_state(data, free) for data in problem.data]
    start = np.clip(problem.joint_vector(starts)[0], *problem.search_bounds)
    if not np.isfinite(start).all():
        return None
    # With the initial state of the first fit: a start in the same minimum is then close to it.
    adjacent = theta.copy()
    count = len(unknowns.law.parameters)
    for data in problem.data:
        here = data.joint_vector_indices[:count]
        adjacent[here] = start[here]
    cost_increase = _cost_of_training_segments(problem, adjacent) - cost
    if _agrees_with_parabola(
        problem.make_normal_equations(problem.training_sample_counts), theta, adjacent, cost_increase
    ):
        return theta
    if cost_increase <= (_SAME_MINIMUM_COST_RATIO - 1.0) * cost:
        return problem.refit(adjacent, problem.training_sample_counts, tolerance=COMPARISON_TOLERANCE)
    return refit_over_growing_times(problem, start, _ends_of_first_horizons(problem), COMPARISON_TOLERANCE)


def _ends_of_first_horizons(problem: FitProblem) -> list[float]:
    """Return for each record the time [s] at which the first part that is fitted on fine grids ends."""
    return [_FIRST_REFIT_CYCLES * data.guess.shortest_cycle_period for data in problem.data]


def _agrees_with_parabola(
    normal: Normal, theta: np.ndarray, adjacent: np.ndarray, cost_increase: float
) -> bool:
    """Return whether cost and slope at ``adjacent`` agree with a parabola whose minimum is ``theta``."""
    # In another minimum's valley the cost may agree by chance, but then the slope, which points to that
    # minimum, does not.
    away = adjacent - theta
    predicted = float(away @ np.asarray(normal(theta[None])[2][0]) @ away)
    slope = float(away @ np.asarray(normal(adjacent[None])[1][0]))
    return all(abs(value - predicted) <= _PARABOLA_TOLERANCE * predicted for value in (cost_increase, slope))


def fit_on_verified_grids(result: SearchResult) -> SearchResult:
    """Fit the whole records on grids whose solutions agree with the adaptive solver."""
    problem, trained = result.problem, result.trained
    lengths = [len(data.record) for data in problem.data]
    while True:
        theta = (
            trained if lengths == list(problem.training_sample_counts) else problem.refit(trained, lengths)
        )
        residuals = problem.residuals(theta)
        if any((np.abs(left) >= DIVERGED_RESIDUAL).any() for left in residuals):
            raise InputError(
                f"from every random start the solution of {quote(problem.law.name)} diverges within the "
                "record; try another law, more starts or a shorter record"
            )
        errors, grids = [], []
        for data, left in zip(problem.data, residuals, strict=True):
            error, limit, complete = _solver_error_limit_and_completeness(
                data, left, theta[data.joint_vector_indices]
            )
            errors.append(error)
            grids.append(
                data if error <= limit else _data_with_doubled_grid_steps(data, error, complete=complete)
            )
        if all(new is old for new, old in zip(grids, problem.data, strict=True)):
            if any(data.held_out_cycles for data in problem.data):
                trained = _refit_to_masked_samples(problem, theta)
            return dataclasses.replace(
                result, problem=problem, trained=trained, theta=theta, solver_errors=tuple(errors)
            )
        problem = problem.with_data(grids)
        trained = problem.refit(trained, problem.training_sample_counts)


def _refit_to_masked_samples(problem: FitProblem, theta: np.ndarray) -> np.ndarray:
    """Refit without the held-out cycles, by Gauss-Newton from a fit to all samples, or else by a search."""
    masks = [data.training_mask for data in problem.data]
    normal, free = problem.make_normal_equations(masks), ~problem.held_entry_mask
    cost, gradient, matrix = (np.asarray(item)[0] for item in normal(theta[None]))
    for _ in range(_MAXIMUM_HELD_OUT_STEPS):
        scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix)[free], 1e-300))
        scaled = matrix[np.ix_(free, free)] * np.outer(scale, scale)
        step = np.zeros_like(theta)
        # Along undetermined directions the vector stays unchanged.
        step[free] = scale * np.linalg.lstsq(scaled, scale * gradient[free], rcond=_UNDETERMINED_STRENGTH)[0]
        if gradient @ step <= _HELD_OUT_TOLERANCE * cost:
            return theta
        moved = np.clip(theta - step, *problem.search_bounds)
        trial = tuple(np.asarray(item)[0] for item in normal(moved[None]))
        if not trial[0] < cost:
            break
        theta, (cost, gradient, matrix) = moved, trial
    return problem.refit(theta, masks, tolerance=_HELD_OUT_TOLERANCE)


def _data_with_doubled_grid_steps(data: FitData, error: float, *, complete: bool) -> FitData:
    """Return the data on a grid of twice as many steps, because the solution's error is too large."""
    finer = data.grid.finer
    if finer.steps > MAXIMUM_STEPS or not complete:
        cause = f"has an error of {error:.2g} amplitudes on a grid of {data.grid.steps} steps"
        if not complete:
            cause = "cannot be computed by the adaptive solver"
        law = data.unknowns.law
        remedy = "fit a shorter record (if the motion is chaotic) or a law that is less stiff"
        if "sign(" in law.equation:
            remedy = (
                "sign(z') jumps: replace it by tanh(z'/v) with a small speed v, or use the dry friction "
                "of the laws coulomb and viscous-coulomb (--law viscous-coulomb)"
            )
        raise InputError(
            f"the fitted solution of {quote(law.name)} {cause}; the maximum error is "
            f"{SOLVER_LIMIT:g} amplitudes or, if larger, {100.0 * RESIDUAL_SHARE:g} % of the residual; "
            f"{remedy}"
        )
    return dataclasses.replace(data, grid=finer)


def _solver_error_limit_and_completeness(
    data: FitData, residuals: np.ndarray, theta: np.ndarray
) -> tuple[float, float, bool]:
    """Return the solution's error against the adaptive solver, its limit, and whether the solver finished."""
    unknowns, record, law = data.unknowns, data.record, data.unknowns.law
    values, z0, v0, hidden = unknowns.physical_values(theta)
    inputs = [input_column(record, name) for name in law.inputs]
    reference = solve_law(
        law, record.time, z0, v0, values, unknowns.amplitude, inputs, hidden, data.interpolation
    )
    if law.prescribed:
        signal = observed_signal(law, unknowns.observation, reference, values, inputs)
        gain, offset = (1.0, 0.0) if unknowns.sensor is None else unknowns.gain_and_offset(theta)
        missed = (gain * signal + offset - record.height) / unknowns.residual_unit - residuals
    elif unknowns.compares_heights:
        fitted = record.height + unknowns.residual_unit * residuals
        missed = (reference.z - fitted) / unknowns.amplitude
    else:
        missed = (reference.z - data.fitted_heights(theta)) / unknowns.amplitude
    error = float(np.abs(missed).max())
    limit = max(SOLVER_LIMIT, RESIDUAL_SHARE * float(residuals.std()))
    # A diverging solution gives NaN, which compares false with every limit: it counts as infinite.
    return error if math.isfinite(error) else math.inf, limit, reference.ending == "complete"


_REPORTED_RESIDUAL_RATIO = 0.5  # fraction of the residual that a reported delay must remove
_DELAYS = np.array([-0.2, -0.1, -0.05, -0.02, 0.0, 0.02, 0.05, 0.1, 0.2])
"""Trial delays of an input [periods]. Longer delays of a periodic drive only repeat the phase."""
_FINE_DELAY = 0.01  # spacing of delays about the best one, in periods


def input_delay_remarks(problem: FitProblem, theta: np.ndarray, k: int) -> tuple[str, ...]:
    """Report each input for which a shift in time would more than halve the residual."""
    data, period = problem.data[k], math.tau / problem.data[k].guess.frequency
    before = float(
        np.linalg.norm(data.weighted_residuals_and_derivatives(theta[data.joint_vector_indices])[0])
    )
    remarks = []
    for name in problem.law.inputs:
        if name in (TIME, *STROKE):
            continue

        def refitted_residual_norm_without_delay(delay: float, here: np.ndarray, name: str = name) -> float:
            moved = _data_with_delay_removed(data, name, delay)
            residuals, slopes = moved.weighted_residuals_and_derivatives(here[data.joint_vector_indices])
            by_parameters = slopes @ np.linalg.lstsq(slopes, residuals, rcond=None)[0]
            return float(np.linalg.norm(residuals - by_parameters))

        tried = [refitted_residual_norm_without_delay(delay * period, theta) for delay in _DELAYS]
        best = int(np.argmin(tried))
        if tried[best] > _REPORTED_RESIDUAL_RATIO * before or best in (0, len(_DELAYS) - 1):
            continue
        about = slice(best - 1, best + 2)
        delay, again = _parabola_minimum(_DELAYS[about] * period, np.array(tried[about]) ** 2), theta
        for _ in range(4):  # with the parameters refitted to each delay
            others = list(problem.data)
            others[k] = _data_with_delay_removed(data, name, delay)
            counts = [len(item.record) for item in others]
            again = problem.with_data(others).refit(again, counts, tolerance=1e-6)
            near = delay + _FINE_DELAY * period * np.array([-1.0, 0.0, 1.0])
            delay = _parabola_minimum(
                near, np.array([refitted_residual_norm_without_delay(value, again) for value in near]) ** 2
            )
        moved = _data_with_delay_removed(data, name, delay)
        after = float(
            np.linalg.norm(moved.weighted_residuals_and_derivatives(again[data.joint_vector_indices])[0])
        )
        if after < _REPORTED_RESIDUAL_RATIO * before:
            remarks.append(
                f"{name} is {abs(delay):.2g} s {'late' if delay > 0.0 else 'early'}; with corrected times "
                f"the residual would be {after / before:.2g} times as large; align the column with the motion"
            )
    return tuple(remarks)


def _data_with_delay_removed(data: FitData, name: str, delay: float) -> FitData:
    """Return the data with an input advanced by a delay [s]."""
    time, column = data.record.time, input_column(data.record, name)
    return data.with_column_shifted_by(name, np.interp(time + delay, time, column) - column)


def _parabola_minimum(x: np.ndarray, y: np.ndarray) -> float:
    """Return the position of the minimum of a parabola through three points."""
    middle = np.polynomial.Polynomial.fit(x, y, 2)
    slope = middle.deriv()
    bend = float(slope.deriv()(0.0))
    return float(np.clip(slope.roots()[0].real, x[0], x[-1])) if bend > 0.0 else float(x[int(y.argmin())])
