"""Search for the best fit from many random starts, over fitted times that double.

A direct fit of a long record ends in local minima in which the solution gains or loses a whole cycle.
Here the first two cycles are fitted, then four, eight, sixteen, until the whole training segment is
included. At each doubling the previous fit predicts the phase at the new end to a fraction of a cycle.
The search compares means of the samples on coarse grids.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import InputError
from reduced_models.fitting.fit_data import COARSE_STEPS, FitData
from reduced_models.fitting.levenberg_marquardt import (
    Normal,
    NormalPrior,
    levenberg_marquardt_vectors_and_costs,
    promising_start_mask,
)
from reduced_models.fitting.parameter import SearchUnknowns
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.refinement import SearchedStarts, SearchResult, refine_best_start
from reduced_models.fitting.residuals import (
    ResidualLoss,
    average_samples_on_grid,
    compiled_residuals_or_normal_equations,
    grid_over_record,
    make_normal_equations,
)
from reduced_models.fitting.start_values import make_start_vectors, unknowns_with_typical_scales
from reduced_models.fitting.stroke_starts import NestedLaw, StrokeStartDraws, nested_laws
from reduced_models.fitting.whole_records import choose_by_whole_records
from reduced_models.laws.law import Law
from reduced_models.laws.solution import compile_solution_ahead, padded_step_count
from reduced_models.records.inputs import StepGrid, has_inputs_besides_time

_FIRST_HORIZON_CYCLES = 2.0
_STROKE_HORIZON = 8.0  # number of cycles beyond which the complete stroke is fitted
_STROKE_TRIALS, _STROKE_TOLERANCE = 25, 1e-3  # limits of a fit to parts of a stroke
# Limits of the fit over every horizon but the last: a start that is not followed closely loses its phase.
_HORIZON_TRIALS, _HORIZON_TOLERANCE = 60, 1e-4
# Steps over which all starts are followed, 512 periods; beyond them only the best start is followed.
_MAXIMUM_COARSE_STEPS = 2**13
_STROKE_SAMPLES = 1200  # number of compared samples of all strokes together
_MINIMUM_SAMPLES_PER_STEP = 2.0  # samples per coarse step above which their means are fitted
_MAXIMUM_NUMBERS = 2**26
"""Maximum product of starts, grid points and unknowns: four arrays of this size take 2 GB."""


def multistart_search(problem: FitProblem) -> SearchResult:
    """Fit the training segments from random starts."""
    problem = problem.with_scales(unknowns_with_typical_scales(problem.largest_amplitude_data))
    sample_stride = (
        max(1, sum(problem.training_sample_counts) // _STROKE_SAMPLES) if problem.law.prescribed else 1
    )
    coarse = problem.with_data(_data_on_coarse_grid(data, sample_stride) for data in problem.data)
    points = max(len(data.samples.weight) for data in coarse.data)
    _check_memory(problem.starts, points, len(problem.unknowns.prior_precisions))
    if problem.law.prescribed:
        start = StrokeStartDraws.draw_for_problem(coarse)
        problem, coarse = problem.with_scales(start.unknowns), coarse.with_scales(start.unknowns)
        searched = _searched_starts_along_strokes(coarse, start)
    else:
        searched = _searched_starts_over_horizons(coarse)
    return choose_by_whole_records(refine_best_start(problem, coarse, searched), coarse, searched)


def compile_fit_ahead(law: Law, starts: int) -> None:
    """Compile to disk the programs that fit a law without inputs to a record of few periods."""
    points = padded_step_count(0) + 1
    still = PistonRecord(np.arange(float(points)), np.zeros(points))
    samples = average_samples_on_grid(still, StepGrid(1.0, points - 1), (), "spline", np.ones(points))
    unknowns = SearchUnknowns(law, (1.0,) * len(law.parameters), 0.0, 1.0, 1.0)
    theta = np.zeros((starts, len(unknowns.prior_precisions)))
    compiled_residuals_or_normal_equations(unknowns, "normal").compile_ahead(
        theta, samples, unknowns.scales, ResidualLoss().compiled_arguments
    )
    compile_solution_ahead(law)


def _searched_starts_along_strokes(problem: FitProblem, start: StrokeStartDraws) -> SearchedStarts:
    """Search for the force law's parameters along prescribed strokes."""
    stages = nested_laws(problem)
    normal, prior = make_coarse_normal_equations_and_prior(problem, math.inf)
    theta, origins = (
        _fit_lengthening_parts_of_strokes(problem, start.theta),
        _group_numbers_of_equal_rows(start.theta),
    )
    if stages:
        # Half of the starts come from fits of smaller laws, the others from draws of the law itself.
        grown = start.best_draws_as_search_vectors(stages[0].problem_with_held_parameters(problem))
        grown_origins = len(origins) + _group_numbers_of_equal_rows(grown)
        for smaller, larger in itertools.pairwise((*stages, NestedLaw({}))):
            grown = _fit_lengthening_parts_of_strokes(smaller.problem_with_held_parameters(problem), grown)
            released = [name for name in smaller.held if name not in larger.held]
            grown = start.start_vectors_of_larger_law(
                larger.problem_with_held_parameters(problem), released, grown
            )
        orders = [np.argsort(np.asarray(normal(rows)[0]), kind="stable") for rows in (grown, theta)]
        both = [rows[order] for rows, order in zip((grown, theta), orders, strict=True)]
        theta = np.stack(both, axis=1).reshape(-1, theta.shape[1])[: len(theta)]
        of_both = [rows[order] for rows, order in zip((grown_origins, origins), orders, strict=True)]
        origins = np.stack(of_both, axis=1).ravel()[: len(theta)]
    return SearchedStarts(
        *levenberg_marquardt_vectors_and_costs(normal, theta, prior, bounds=problem.search_bounds), origins
    )


def _group_numbers_of_equal_rows(rows: np.ndarray) -> np.ndarray:
    """Return a number for each row (s, p), the same for equal rows."""
    return np.unique(rows, axis=0, return_inverse=True)[1].ravel()


def _fit_lengthening_parts_of_strokes(problem: FitProblem, theta: np.ndarray) -> np.ndarray:
    """Fit parts of the strokes, each twice as long as the one before; return search vectors (s, p)."""
    # Hidden states forget their initial values, so a few cycles determine a law in less computing time.
    horizons = [count for count in _horizons_in_cycles(problem) if count <= _STROKE_HORIZON]
    for cycle_count in horizons if problem.law.hidden else ():
        start, (normal, prior) = theta, make_coarse_normal_equations_and_prior(problem, cycle_count)
        moved = levenberg_marquardt_vectors_and_costs(
            normal, start, prior, _STROKE_TOLERANCE, problem.search_bounds, trials=_STROKE_TRIALS
        )[0]
        normal = make_coarse_normal_equations_and_prior(problem, 2.0 * cycle_count)[0]
        worse = np.asarray(normal(start)[0]) < np.asarray(normal(moved)[0])
        theta = np.where(worse[:, None], start, moved)
    return theta


def _searched_starts_over_horizons(problem: FitProblem) -> SearchedStarts:
    """Search from random starts over fitted times that double."""
    vectors, origins = _start_vectors_and_origins(problem)
    theta = start = problem.joint_vector(vectors)
    costs = np.zeros(problem.starts)
    for cycle_count in _horizons_in_cycles(problem):
        first, last = cycle_count == _FIRST_HORIZON_CYCLES, math.isinf(cycle_count)
        normal, prior = make_coarse_normal_equations_and_prior(problem, cycle_count)
        if problem.law.start is None and not first:
            # Starts of a law given by its equation come from the whole record; two cycles may not show, for
            # example, the frequency of a slow input.
            worse = np.asarray(normal(start)[0]) < np.asarray(normal(theta)[0])
            theta = np.where(worse[:, None], start, theta)
        waiting = promising_start_mask(costs, prior.samples) if costs.any() else None
        if last:
            theta, costs = levenberg_marquardt_vectors_and_costs(
                normal, theta, prior, bounds=problem.search_bounds, waiting=waiting
            )
        else:
            theta, costs = levenberg_marquardt_vectors_and_costs(
                normal,
                theta,
                prior,
                _HORIZON_TOLERANCE,
                problem.search_bounds,
                trials=_HORIZON_TRIALS,
                waiting=waiting,
            )
    return SearchedStarts(theta, costs, origins)


def _check_memory(starts: int, points: int, unknowns: int) -> None:
    """Raise an error if a search needs more than 2 GB of memory."""
    maximum = _MAXIMUM_NUMBERS // (points * unknowns)
    if starts > max(maximum, 16):
        raise InputError(
            f"starts = {starts}, but memory suffices for {maximum} starts of {unknowns} unknowns on a "
            f"record that needs {points} steps; give fewer starts, or a shorter record"
        )


def _start_vectors_and_origins(problem: FitProblem) -> tuple[list[np.ndarray], np.ndarray]:
    """Return each record's start vectors (starts, p), and a group number for each start.

    Nearly equal starts have the same group number.

    Shared entries come from the record of largest amplitude.
    """
    starts = [
        make_start_vectors(data, problem.starts, np.random.default_rng(problem.seed), problem.start)
        for data in problem.data
    ]
    vectors = [item.theta for item in starts]
    largest = problem.data.index(problem.largest_amplitude_data)
    of_largest_amplitude = vectors[largest]
    names = problem.law.parameters
    shared = [k for k, name in enumerate(names) if name not in problem.data[0].per_record]
    vectors[0] = vectors[0].copy()
    vectors[0][:, shared] = of_largest_amplitude[:, shared]
    return vectors, starts[largest].origins


def _data_on_coarse_grid(data: FitData, sample_stride: int) -> FitData:
    """Put every n-th sample of a training segment on a coarse grid; cut off a very long segment."""
    law, how, seen = data.unknowns.law, data.interpolation, slice(0, data.training, sample_stride)
    training, weights = data.record.select(seen), data.weights[seen]
    wanted = law.step_ratio * COARSE_STEPS
    period = data.guess.shortest_start_period
    grid = grid_over_record(training, law.inputs, period, wanted, how)
    if grid.steps > _MAXIMUM_COARSE_STEPS:
        count = int(np.searchsorted(training.time, grid.step * _MAXIMUM_COARSE_STEPS, side="right"))
        training = training.first(count)
        grid = grid_over_record(training, law.inputs, period, wanted, how)
    # A mean of few samples is moved to its grid point by the slope between them. If they are far apart the
    # error of the slope is as large as the noise, and doubling the horizon then loses the phase.
    dense = has_inputs_besides_time(law.inputs) or len(training) > _MINIMUM_SAMPLES_PER_STEP * grid.steps
    return dataclasses.replace(
        data,
        record=training,
        grid=grid,
        weights=weights[: len(training)],
        training=len(training),
        means=dense and not law.prescribed,
    )


def make_coarse_normal_equations_and_prior(
    problem: FitProblem, cycle_count: float
) -> tuple[Normal, NormalPrior]:
    """Return normal equations and prior of the first cycles of records on coarse grids."""
    normals, total = [], 0.0
    for data in problem.data:
        means = data.samples
        seen = means.step * (means.point + means.fraction) <= cycle_count * data.guess.shortest_cycle_period
        weight = means.weight * seen
        total += float((weight**2).sum())
        normals.append(make_normal_equations(data.unknowns, means.with_weights(weight), data.loss))
    return problem.make_sum_of_normal_equations(normals), problem.prior(total)


def _horizons_in_cycles(problem: FitProblem) -> Iterator[float]:
    """Yield the numbers of cycles that the search fits in turn; infinity means the complete record."""
    # Doubling finds the best fit even if the period changes with amplitude; two cycles followed by the whole
    # record do not.
    maximum = max(data.record.time[-1] / data.guess.shortest_cycle_period for data in problem.data)
    cycle_count = _FIRST_HORIZON_CYCLES
    while cycle_count < maximum:
        yield cycle_count
        cycle_count *= 2.0
    yield math.inf
