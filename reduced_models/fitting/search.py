"""The search of a fit: many starts, over horizons that double.

Whoever fits all of a long record together falls into the valleys in which the solution gains or
loses a whole swing. Here the first two swings are fitted, then four, eight, sixteen, until all of
the training stretch is seen: at each doubling, the phase at the new end is known to a fraction of a
swing from what was fitted before. The search sees means of the samples on coarse grids.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import InputError
from reduced_models.fitting.fit_data import COARSE_STEPS, FitData
from reduced_models.fitting.levenberg_marquardt import Normal, Prior, levenberg_marquardt, promising_starts
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.refinement import FIRST_SWINGS, SearchResult, refine_best_start
from reduced_models.fitting.residuals import Loss, normal_equations, residual_function
from reduced_models.fitting.samples import grid_over_record, means_on_grid
from reduced_models.fitting.start_values import scale_unknowns, start_vectors
from reduced_models.fitting.strokes import stroke_start_vectors
from reduced_models.fitting.unknowns import Unknowns
from reduced_models.laws.law import Law
from reduced_models.laws.solution import compile_solution_ahead, padded_step_count
from reduced_models.records.inputs import StepGrid, has_inputs_besides_time

_TRIALS, _TOLERANCE = 60, 1e-4  # of all horizons but the last: what lags behind loses its phase
# Steps over which all starts are followed, 512 periods; behind them, the best one.
_MOST_COARSE = 2**13
_STROKE_SAMPLES = 1200  # of all strokes that a search sees
_THIN = 2.0  # samples a coarse step, above which their means are fitted
_MOST_NUMBERS = 2**26
"""Starts times grid points times unknowns, which stand in memory four times: two gigabytes."""


def multistart_search(problem: FitProblem) -> SearchResult:
    """Fit the training stretches from random starts."""
    problem = problem.with_scales(scale_unknowns(problem.largest_swing_record))
    every = max(1, sum(problem.training) // _STROKE_SAMPLES) if problem.law.prescribed else 1
    coarse = problem.with_data(_coarse_data(data, every) for data in problem.data)
    points = max(len(data.samples.weight) for data in coarse.data)
    _check_memory(problem.starts, points, len(problem.unknowns.prior))
    if problem.law.prescribed:
        units, theta = stroke_start_vectors(coarse)
        unknowns = dataclasses.replace(problem.unknowns, units=units)
        problem, coarse = problem.with_scales(unknowns), coarse.with_scales(unknowns)
        normal, prior = coarse_normal_equations(coarse, math.inf)
        vectors = levenberg_marquardt(normal, theta, prior, bounds=coarse.edges)
    else:
        vectors = _search_over_horizons(coarse)
    return refine_best_start(problem, coarse, vectors)


def compile_fit_ahead(law: Law, starts: int) -> None:
    """Put programs on disk that a fit of a law without inputs needs for a record of few periods."""
    points = padded_step_count(0) + 1
    still = PistonRecord(np.arange(float(points)), np.zeros(points))
    samples = means_on_grid(still, StepGrid(1.0, points - 1), (), "spline", np.ones(points))
    unknowns = Unknowns(law, (1.0,) * len(law.parameters), 0.0, 1.0, 1.0)
    theta = np.zeros((starts, len(unknowns.prior)))
    residual_function(unknowns, "normal").compile_ahead(
        theta, samples, unknowns.scales, Loss().compiled_arguments
    )
    compile_solution_ahead(law)


def _search_over_horizons(problem: FitProblem) -> tuple[np.ndarray, np.ndarray]:
    """Search vectors (s, p) that random starts of a law lead to, and what they cost (s,)."""
    theta = start = problem.joint_vector(_start_vectors(problem))
    costs = np.zeros(problem.starts)
    for swings in _horizons_in_swings(problem):
        first, last = swings == FIRST_SWINGS, math.isinf(swings)
        normal, prior = coarse_normal_equations(problem, swings)
        if problem.law.start is None and not first:
            theta = _keep_better_starts(normal, theta, start)
        waiting = promising_starts(costs, prior.samples) if costs.any() else None
        if last:
            theta, costs = levenberg_marquardt(normal, theta, prior, bounds=problem.edges, waiting=waiting)
        else:
            theta, costs = levenberg_marquardt(
                normal, theta, prior, _TOLERANCE, problem.edges, trials=_TRIALS, waiting=waiting
            )
    return theta, costs


def _keep_better_starts(normal: Normal, theta: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Search vectors after fewer swings, or the starts themselves where these fit better."""
    # Starts of a law known by its equation come from all of the record; two swings may not show, for example,
    # the frequency of a slow input.
    worse = np.asarray(normal(start)[0]) < np.asarray(normal(theta)[0])
    return np.where(worse[:, None], start, theta)


def _check_memory(starts: int, points: int, unknowns: int) -> None:
    """Refuse a search that needs more memory than a laboratory's computer has to spare."""
    most = _MOST_NUMBERS // (points * unknowns)
    if starts > max(most, 16):
        raise InputError(
            f"starts = {starts}; at most {most} fit into memory for {unknowns} unknowns and a "
            f"record that needs {points} steps: give fewer, or a shorter record"
        )


def _start_vectors(problem: FitProblem) -> list[np.ndarray]:
    """Start vectors (starts, p) of each record; the first one's parameters are the largest_swing_record's."""
    vectors = [
        start_vectors(data, problem.starts, np.random.default_rng(problem.seed), problem.start)
        for data in problem.data
    ]
    largest_swing_record = vectors[problem.data.index(problem.largest_swing_record)]
    names = problem.law.parameters
    shared = [k for k, name in enumerate(names) if name not in problem.data[0].own]
    vectors[0] = vectors[0].copy()
    vectors[0][:, shared] = largest_swing_record[:, shared]
    return vectors


def _coarse_data(data: FitData, every: int) -> FitData:
    """Means of a training stretch, each so many samples, or of its first part, on a coarse grid."""
    law, how, seen = data.unknowns.law, data.interpolation, slice(0, data.training, every)
    training, weights = data.record.select(seen), data.weights[seen]
    wanted = law.step_ratio * COARSE_STEPS
    period = data.guess.shortest_start_period
    grid = grid_over_record(training, law.inputs, period, wanted, how)
    if grid.steps > _MOST_COARSE:
        count = int(np.searchsorted(training.time, grid.step * _MOST_COARSE, side="right"))
        training = training.first(count)
        grid = grid_over_record(training, law.inputs, period, wanted, how)
    # A mean of few samples is moved to its grid point by the slope between them, which is off
    # where they are far apart: by as much as the noise, which the doubling does not survive.
    dense = has_inputs_besides_time(law.inputs) or len(training) > _THIN * grid.steps
    return dataclasses.replace(
        data,
        record=training,
        grid=grid,
        weights=weights[: len(training)],
        training=len(training),
        means=dense and not law.prescribed,
    )


def coarse_normal_equations(problem: FitProblem, swings: float) -> tuple[Normal, Prior]:
    """Return the normal equations of the first swings of coarse records, with the prior."""
    normals, total = [], 0.0
    for data in problem.data:
        means = data.samples
        seen = means.step * (means.point + means.fraction) <= swings * data.guess.shortest_swing_period
        weight = means.weight * seen
        total += float((weight**2).sum())
        normals.append(normal_equations(data.unknowns, means.with_weights(weight), data.loss))
    return problem.sum_of_normal_equations(normals), problem.prior(total)


def _horizons_in_swings(problem: FitProblem) -> Iterator[float]:
    """Swings that a search sees one after the other; infinitely many are all of them."""
    # Doubling finds the best fit of records whose period changes with amplitude; two swings and then
    # everything does not.
    most = max(data.record.time[-1] / data.guess.shortest_swing_period for data in problem.data)
    swings = FIRST_SWINGS
    while swings < most:
        yield swings
        swings *= 2.0
    yield math.inf
