"""The fit on fine grids: the best start refined, compared with accelerations, and judged.

The best of a search is fitted to all samples, on grids that are refined until the solution agrees
with the adaptive one. Next to it stands the fit that starts from accelerations in the record, which
solves nothing. A driven fit is refined once more with its input shifted, to name one that comes late.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from granular.shared.array_types import Float
from granular.shared.errors import InputError, quote
from reduced_models.fitting.fit_data import FitData
from reduced_models.fitting.levenberg_marquardt import TIE, Normal, agreeing_cost_limit
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.residuals import BLOWN_UP, cost_and_weight
from reduced_models.fitting.start_values import (
    append_initial_state,
    fit_to_accelerations,
    search_entries_from_draws,
)
from reduced_models.fitting.uncertainty import small_motion_figures
from reduced_models.laws.linearization import NoOscillation
from reduced_models.laws.solution import observed_signal, solve_law
from reduced_models.laws.symmetry import canonical_parameters
from reduced_models.records.inputs import STROKE, TIME, input_column

FIRST_HORIZON_CYCLES = 2.0
"""Swings that a search sees first."""
SOLVER_LIMIT, SOLVER_SHARE = 1e-6, 0.05
"""Greatest error of the fitted solution, in amplitudes and in standard deviations of the residual;
the larger of the two counts."""
# Steps of a grid: 8,192 periods at `FINE_STEPS`.
FINEST = 2**19
_SAME_VALLEY = 2.0  # times the cost of the fit
_PARABOLA = 0.5  # relative difference of a cost from the parabola about a fit, at most
_TELLING = 1e-4  # of a cost: tolerance of a fit that is only compared
_JUDGED, _STEPS, _OPEN = 1e-8, 4, 1e-10
"""Tolerance of the fit that is judged, of its cost; its steps at most, and the strength, over the
greatest, of directions that are open to it."""
_NEAR_ALIAS = 0.4  # of half the sampling rate, below which no start comes near its mirror image
_SAME = 0.05  # of the entries of a search vector, up to which two are the same
# Of a cost: a hundred times `_TELLING`, so that a fit that has only not ended is no other one.
_BETTER = 0.99


@dataclasses.dataclass(frozen=True, eq=False)
class SearchResult:
    """A problem, and where its fit stands."""

    problem: FitProblem
    trained: Float[np.ndarray, "q"]  # search vector without the test swings
    theta: Float[np.ndarray, "q"]  # that of all samples; before verification both are of the training
    converged: int  # starts that led to this fit
    cost: float  # of the training residuals; infinite if the solution diverges
    coarse_cost: float  # the same of the means on the search's coarse grid
    collocation: str = "none"
    solver_errors: tuple[float, ...] = ()  # against the adaptive solution, in amplitudes

    def with_training_fit(self, problem: FitProblem, trained: Float[np.ndarray, "q"]) -> SearchResult:
        """Return the result with another fit to the training stretches."""
        return dataclasses.replace(self, problem=problem, trained=trained, theta=trained)


def refine_best_start(
    problem: FitProblem, coarse: FitProblem, vectors: tuple[np.ndarray, np.ndarray]
) -> SearchResult:
    """Fit on fine grids from the best start of a search, compared with the fit to accelerations."""
    _, costs = vectors
    count = sum(problem.training)
    first = _best_of_equals(problem, vectors)
    best = _refit_from_time(problem, first, [float(data.record.time[-1]) for data in coarse.data])
    cost, coarse_cost = _training_cost(problem, best), float(costs.min())
    other = _collocation_fit(problem, best, cost)
    collocation = "none"
    if other is best:
        collocation = "same"
    elif other is not None:
        tie = count * TIE**2
        other_cost = _training_cost(problem, other)
        collocation = "same" if other_cost * _BETTER <= cost + tie else "worse"
        if other_cost + tie < _BETTER * cost:
            coarse_cost *= other_cost / cost
            best = problem.refit(other, problem.training)
            cost, collocation = _training_cost(problem, best), "better"
    limit = agreeing_cost_limit(np.array([coarse_cost]), count)
    converged = int((costs <= limit).sum())
    return SearchResult(problem, best, best, converged, cost, coarse_cost, collocation)


def _best_of_equals(problem: FitProblem, vectors: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Vector of the least cost on a fine grid, of those that are equal on a coarse one.

    A coarse grid fits motions that decay within a step or two, which no solution has.
    """
    thetas, costs = vectors
    limit = agreeing_cost_limit(costs, sum(problem.training))
    equal = [thetas[k] for k in np.argsort(costs, kind="stable") if costs[k] <= limit]
    distinct = equal[:1]
    for theta in equal[1:]:
        if not any(np.allclose(theta, other, rtol=_SAME, atol=_SAME) for other in distinct):
            distinct.append(theta)
    candidates = [_canonical_vector(problem, theta) for theta in distinct]
    slow = [theta for theta in candidates if not _is_alias(problem, theta)]
    candidates = slow or candidates
    if len(candidates) == 1:
        return candidates[0]
    return min(candidates, key=lambda theta: _training_cost(problem, theta))


def _is_alias(problem: FitProblem, theta: np.ndarray) -> bool:
    """Tell whether a vector's small oscillation is faster than half the sampling rate of a record."""
    for data in problem.data:
        if data.guess.frequency < _NEAR_ALIAS * data.guess.fastest:
            continue
        figures = small_motion_figures(problem.unknowns, theta[data.entries])
        if not isinstance(figures, NoOscillation) and math.tau / figures[1] > data.guess.fastest:
            return True
    return False


def _canonical_vector(problem: FitProblem, theta: np.ndarray) -> np.ndarray:
    """Search vector that means the same, its angles and signs in their canonical form."""
    unknowns, first = problem.unknowns, problem.data[0]
    saved = {*first.own, *problem.bounds}
    theta = theta.copy()
    names, here = unknowns.law.parameters, first.entries
    values = dict(zip(names, unknowns.physical_values(theta[here])[0], strict=True))
    moved = canonical_parameters(unknowns.law, values, saved)
    for entry, name, unit in zip(here, names, unknowns.units, strict=False):
        if moved[name] != values[name]:
            theta[entry] = moved[name] / unit
    return theta


def _training_cost(problem: FitProblem, theta: np.ndarray) -> float:
    """Cost of the training stretches; infinite where the solution diverges."""
    total = 0.0
    for data, residuals in zip(problem.data, problem.residuals(theta), strict=True):
        left = residuals[: data.training]
        if (np.abs(left) >= BLOWN_UP).any():
            return math.inf
        weighted = left * data.weights[: data.training]
        total += float(cost_and_weight(weighted, data.loss.compiled_arguments, np)[0].sum())
    return total


def _refit_from_time(
    problem: FitProblem, theta: np.ndarray, reached: Sequence[float], tolerance: float = 1e-11
) -> np.ndarray:
    """Fit the training stretches on fine grids, from a time on that a search vector has seen."""
    times = [data.record.time[: data.training] for data in problem.data]
    fraction = min(end / float(time[-1]) for end, time in zip(reached, times, strict=True))
    while fraction < 0.999:
        counts = [max(4, int(np.searchsorted(time, fraction * time[-1]))) for time in times]
        theta = problem.refit(theta, counts, tolerance=max(tolerance, 1e-6))
        fraction *= 2.0
    return problem.refit(theta, problem.training, tolerance=tolerance)


def _collocation_fit(problem: FitProblem, theta: np.ndarray, cost: float) -> np.ndarray | None:
    """Fit that starts from accelerations in the leading record; None where there are none."""
    unknowns, largest_amplitude_data = problem.unknowns, problem.largest_amplitude_data
    law = unknowns.law
    if law.hidden or law.prescribed or problem.data[0].own or law.parsed_equation.line is not None:
        return None
    values = np.array(unknowns.physical_values(theta[problem.data[0].entries])[0])
    matched = fit_to_accelerations(
        unknowns.law,
        largest_amplitude_data.guess,
        largest_amplitude_data.look,
        values,
        largest_amplitude_data.bounds,
    )
    free = search_entries_from_draws(
        unknowns, {name: matched[None, k] for k, name in enumerate(unknowns.law.parameters)}
    )
    starts = [append_initial_state(data, free) for data in problem.data]
    start = np.clip(problem.joint_vector(starts)[0], *problem.edges)
    if not np.isfinite(start).all():
        return None
    # Next to the fit's own start of the motion: what lies in its valley need not go far.
    adjacent = theta.copy()
    count = len(unknowns.law.parameters)
    for data in problem.data:
        here = data.entries[:count]
        adjacent[here] = start[here]
    risen = _training_cost(problem, adjacent) - cost
    if _agrees_with_parabola(problem.normal_equations(problem.training), theta, adjacent, risen):
        return theta
    if risen <= (_SAME_VALLEY - 1.0) * cost:
        return problem.refit(adjacent, problem.training, tolerance=_TELLING)
    reached = [FIRST_HORIZON_CYCLES * data.guess.shortest_cycle_period for data in problem.data]
    return _refit_from_time(problem, start, reached, _TELLING)


def _agrees_with_parabola(normal: Normal, theta: np.ndarray, adjacent: np.ndarray, risen: float) -> bool:
    """Check that cost and slope at a point are about those of the parabola about a fit."""
    # In another valley the cost may agree by chance; the slope, which falls towards that valley, does not
    # too.
    away = adjacent - theta
    foreseen = float(away @ np.asarray(normal(theta[None])[2][0]) @ away)
    slope = float(away @ np.asarray(normal(adjacent[None])[1][0]))
    return all(abs(value - foreseen) <= _PARABOLA * foreseen for value in (risen, slope))


def solve_on_verified_grids(result: SearchResult) -> SearchResult:
    """Fit all of the records, on grids whose solutions agree with the adaptive ones."""
    problem, trained = result.problem, result.trained
    lengths = [len(data.record) for data in problem.data]
    while True:
        theta = trained if lengths == list(problem.training) else problem.refit(trained, lengths)
        residuals = problem.residuals(theta)
        if any((np.abs(left) >= BLOWN_UP).any() for left in residuals):
            raise InputError(
                f"no start led to a solution of {quote(problem.law.name)} that stays "
                "finite over the record; try another law, more starts or a shorter record"
            )
        errors, grids = [], []
        for data, left in zip(problem.data, residuals, strict=True):
            error, limit, complete = _solver_error(data, left, theta[data.entries])
            errors.append(error)
            grids.append(data if error <= limit else _refine_grid(data, error, complete=complete))
        if all(new is old for new, old in zip(grids, problem.data, strict=True)):
            if any(data.held_out_cycles for data in problem.data):
                trained = _refit_to_masked_samples(problem, theta)
            return dataclasses.replace(
                result, problem=problem, trained=trained, theta=theta, solver_errors=tuple(errors)
            )
        problem = problem.with_data(grids)
        trained = problem.refit(trained, problem.training)


def _refit_to_masked_samples(problem: FitProblem, theta: np.ndarray) -> np.ndarray:
    """Fit without the test swings from a fit to all, by Gauss-Newton steps; by a search where they fail."""
    masks = [data.training_mask for data in problem.data]
    normal, free = problem.normal_equations(masks), ~problem.held_entries
    cost, gradient, matrix = (np.asarray(item)[0] for item in normal(theta[None]))
    for _ in range(_STEPS):
        scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix)[free], 1e-300))
        scaled = matrix[np.ix_(free, free)] * np.outer(scale, scale)
        step = np.zeros_like(theta)
        # Along what the samples leave open it stays where it is.
        step[free] = scale * np.linalg.lstsq(scaled, scale * gradient[free], rcond=_OPEN)[0]
        if gradient @ step <= _JUDGED * cost:
            return theta
        moved = np.clip(theta - step, *problem.edges)
        trial = tuple(np.asarray(item)[0] for item in normal(moved[None]))
        if not trial[0] < cost:
            break
        theta, (cost, gradient, matrix) = moved, trial
    return problem.refit(theta, masks, tolerance=_JUDGED)


def _refine_grid(data: FitData, error: float, *, complete: bool) -> FitData:
    """Record on twice as many steps, because its solution is off by an error."""
    finer = data.grid.finer
    if finer.steps > FINEST or not complete:
        cause = f"is off by {error:.2g} amplitudes on a grid of {data.grid.steps} steps"
        if not complete:
            cause = "cannot be followed by the adaptive solver"
        law = data.unknowns.law
        remedy = "fit a shorter record, as of chaos, or a law that is less stiff"
        if "sign(" in law.equation:
            remedy = (
                "write tanh(z'/v) with a small speed v for sign(z'), which jumps, or take the dry friction "
                "of the laws coulomb and viscous-coulomb (--law viscous-coulomb)"
            )
        raise InputError(
            f"the fitted solution of {quote(law.name)} {cause}; the limit is {SOLVER_LIMIT:g}: {remedy}"
        )
    return dataclasses.replace(data, grid=finer)


def _solver_error(data: FitData, residuals: np.ndarray, theta: np.ndarray) -> tuple[float, float, bool]:
    """Greatest difference to the adaptive solution in amplitudes, its limit, and completeness."""
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
    limit = max(SOLVER_LIMIT, SOLVER_SHARE * float(residuals.std()))
    # NaN of a solution that blows up compares false with every limit: it counts as infinite.
    return error if math.isfinite(error) else math.inf, limit, reference.ending == "complete"


_HALF = 0.5  # of the residual, that a delay must take away to be named
_DELAYS = np.array([-0.2, -0.1, -0.05, -0.02, 0.0, 0.02, 0.05, 0.1, 0.2])
"""Delays of an input that are tried [periods]; further away the phase of a steady drive repeats."""
_FINE = 0.01  # period: delays tried about the best of them


def delay_remarks(problem: FitProblem, theta: np.ndarray, k: int) -> tuple[str, ...]:
    """Name inputs of a record that come early or late by a time that takes away half of its residual."""
    data, period = problem.data[k], math.tau / problem.data[k].guess.frequency
    before = float(np.linalg.norm(data.linearised_residuals(theta[data.entries])[0]))
    remarks = []
    for name in problem.law.inputs:
        if name in (TIME, *STROKE):
            continue

        def left(delay: float, here: np.ndarray, name: str = name) -> float:
            moved = _with_shifted_input(data, name, delay)
            residuals, slopes = moved.linearised_residuals(here[data.entries])
            by_parameters = slopes @ np.linalg.lstsq(slopes, residuals, rcond=None)[0]
            return float(np.linalg.norm(residuals - by_parameters))

        tried = [left(delay * period, theta) for delay in _DELAYS]
        best = int(np.argmin(tried))
        if tried[best] > _HALF * before or best in (0, len(_DELAYS) - 1):
            continue
        about = slice(best - 1, best + 2)
        delay, again = _parabola_minimum(_DELAYS[about] * period, np.array(tried[about]) ** 2), theta
        for _ in range(4):  # about the parameters that follow from the first
            others = list(problem.data)
            others[k] = _with_shifted_input(data, name, delay)
            counts = [len(item.record) for item in others]
            again = problem.with_data(others).refit(again, counts, tolerance=1e-6)
            near = delay + _FINE * period * np.array([-1.0, 0.0, 1.0])
            delay = _parabola_minimum(near, np.array([left(value, again) for value in near]) ** 2)
        moved = _with_shifted_input(data, name, delay)
        after = float(np.linalg.norm(moved.linearised_residuals(again[data.entries])[0]))
        if after < _HALF * before:
            remarks.append(
                f"{name} comes {abs(delay):.2g} s {'late' if delay > 0.0 else 'early'}: shifted by that, the "
                f"residual would be {after / before:.2g} of what it is; align the column with the motion"
            )
    return tuple(remarks)


def _with_shifted_input(data: FitData, name: str, delay: float) -> FitData:
    """Return the data with an input moved back by a delay [s]."""
    time, column = data.record.time, input_column(data.record, name)
    return data.with_column_deviation(name, np.interp(time + delay, time, column) - column)


def _parabola_minimum(x: np.ndarray, y: np.ndarray) -> float:
    """Place of the least value of a parabola through three points."""
    middle = np.polynomial.Polynomial.fit(x, y, 2)
    slope = middle.deriv()
    bend = float(slope.deriv()(0.0))
    return float(np.clip(slope.roots()[0].real, x[0], x[-1])) if bend > 0.0 else float(x[int(y.argmin())])
