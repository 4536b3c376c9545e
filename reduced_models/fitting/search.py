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

from granular.run.piston_record import PistonRecord
from granular.shared.errors import InputError
from reduced_models.fitting.joint_records import (
    JointRecords,
    joint_normal_equations,
    joint_vector,
    joint_vector_entries,
)
from reduced_models.fitting.levenberg_marquardt import (
    Bounds,
    Normal,
    Prior,
    levenberg_marquardt,
    promising_starts,
)
from reduced_models.fitting.problem import FitProblem, TrainingData
from reduced_models.fitting.refinement import (
    COARSE_STEPS,
    FIRST_SWINGS,
    SearchResult,
    fine_grids_over_records,
    refine_best_start,
)
from reduced_models.fitting.residuals import GriddedRecord, Loss, normal_equations, residual_function
from reduced_models.fitting.samples import grid_over_record, means_on_grid, samples_on_grid
from reduced_models.fitting.start_values import scale_unknowns, start_vectors, unknowns_of_data
from reduced_models.fitting.strokes import stroke_start_vectors
from reduced_models.fitting.unknowns import Unknowns, theta_bounds
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
    # First of all: a record with too many periods is refused before any search.
    fine_grids_over_records(problem)
    unknowns = scale_unknowns(problem.law, problem.largest_swing_record, problem.sensor)
    joint = _coarse_records(problem, unknowns)
    points = max(len(grid.samples.weight) for grid in joint.grids)
    _check_memory(problem.starts, points, len(joint.entries[0]))
    if problem.law.prescribed:
        units, theta = stroke_start_vectors(problem, joint)
        joint = _coarse_records(problem, dataclasses.replace(unknowns, units=units))
        normal, prior = coarse_normal_equations(problem, joint, math.inf)
        vectors = levenberg_marquardt(normal, theta, prior, bounds=joint.bounds)
    else:
        vectors = _search_over_horizons(problem, joint)
    return refine_best_start(problem, joint, vectors)


def compile_fit_ahead(law: Law, starts: int) -> None:
    """Put programs on disk that a fit of a law without inputs needs for a record of few periods."""
    points = padded_step_count(0) + 1
    still = PistonRecord(np.arange(float(points)), np.zeros(points))
    samples = means_on_grid(still, StepGrid(1.0, points - 1), (), "spline")
    unknowns = Unknowns(law, (1.0,) * len(law.parameters), 0.0, 1.0, 1.0)
    theta = np.zeros((starts, len(unknowns.prior)))
    residual_function(unknowns, "normal").compile_ahead(
        theta, samples, unknowns.scales, Loss().compiled_arguments
    )
    compile_solution_ahead(law)


def _coarse_records(problem: FitProblem, unknowns: Unknowns) -> JointRecords:
    """Coarse records of a problem, with the bounds of their joint search vector."""
    every = [unknowns_of_data(unknowns, data) for data in problem.data]
    records = joint_vector_entries(unknowns, 1 + problem.data[-1].number, problem.own)
    entries = tuple(records[data.number] for data in problem.data)
    edges = [theta_bounds(unknowns, problem.bounds_of_record(data), problem.initial) for data in problem.data]
    bounds = Bounds(*(joint_vector(side, entries) for side in zip(*edges, strict=True)))
    grids = (_coarse_record(own, problem, data) for own, data in zip(every, problem.data, strict=True))
    return JointRecords(tuple(grids), entries, bounds)


def _search_over_horizons(problem: FitProblem, joint: JointRecords) -> tuple[np.ndarray, np.ndarray]:
    """Search vectors (s, p) that random starts of a law lead to, and what they cost (s,)."""
    theta = start = joint_vector(_start_vectors(problem, joint.unknowns), joint.entries)
    costs = np.zeros(problem.starts)
    for swings in _horizons_in_swings(problem, joint):
        first, last = swings == FIRST_SWINGS, math.isinf(swings)
        normal, prior = coarse_normal_equations(problem, joint, swings)
        if problem.law.start is None and not first:
            theta = _keep_better_starts(normal, theta, start)
        waiting = promising_starts(costs, prior.samples) if costs.any() else None
        if last:
            theta, costs = levenberg_marquardt(normal, theta, prior, bounds=joint.bounds, waiting=waiting)
        else:
            theta, costs = levenberg_marquardt(
                normal, theta, prior, _TOLERANCE, joint.bounds, trials=_TRIALS, waiting=waiting
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


def _start_vectors(problem: FitProblem, unknowns: Unknowns) -> list[np.ndarray]:
    """Start vectors (starts, p) of each record; the first one's parameters are the largest_swing_record's."""
    vectors = [
        start_vectors(
            unknowns,
            data,
            problem.starts,
            np.random.default_rng(problem.seed),
            problem.start,
            problem.bounds_of_record(data),
        )
        for data in problem.data
    ]
    largest_swing_record = vectors[problem.data.index(problem.largest_swing_record)]
    shared = slice(0, len(unknowns.law.parameters))
    vectors[0] = vectors[0].copy()
    keep = [unknowns.law.parameters.index(name) for name in problem.own]
    own = vectors[0][:, keep].copy()
    vectors[0][:, shared] = largest_swing_record[:, shared]
    vectors[0][:, keep] = own
    return vectors


def _coarse_record(unknowns: Unknowns, problem: FitProblem, data: TrainingData) -> GriddedRecord:
    """Means of a training stretch, or of its first part, on a coarse grid."""
    training, law, how = data.training, unknowns.law, problem.interpolation
    weights = data.weights[: len(training)]
    if law.prescribed:
        every = max(1, sum(problem.samples) // _STROKE_SAMPLES)
        training, weights = training.select(slice(None, None, every)), weights[::every]
    wanted = law.step_ratio * COARSE_STEPS
    period = data.guess.shortest_start_period
    grid = grid_over_record(training, law.inputs, period, wanted, how)
    if grid.steps > _MOST_COARSE:
        count = int(np.searchsorted(training.time, grid.step * _MOST_COARSE, side="right"))
        training = training.first(count)
        grid = grid_over_record(training, law.inputs, period, wanted, how)
    weights = weights[: len(training)]
    if not law.prescribed and (has_inputs_besides_time(law.inputs) or len(training) > _THIN * grid.steps):
        samples = means_on_grid(training, grid, law.inputs, how, weights)
    else:
        # A mean of few samples is moved to its grid point by the slope between them, which is off
        # where they are far apart: by as much as the noise, which the doubling does not survive.
        samples = samples_on_grid(training, grid, law.inputs, how)
        padded = np.zeros_like(samples.weight)
        padded[: len(training)] = weights
        samples = samples.with_weights(padded)
    samples = samples.through_sensor(unknowns.sensor_of_motion, training, grid)
    loss = problem.loss_of_record(data, unknowns.residual_unit)
    return GriddedRecord(unknowns, training, grid, samples, how, weights, loss)


def coarse_normal_equations(problem: FitProblem, joint: JointRecords, swings: float) -> tuple[Normal, Prior]:
    """Return the normal equations of the first swings of coarse records, with the prior."""
    normals, total = [], 0.0
    for data, grid in zip(problem.data, joint.grids, strict=True):
        means = grid.samples
        seen = means.step * (means.point + means.fraction) <= swings * data.guess.shortest_swing_period
        weight = means.weight * seen
        total += float((weight**2).sum())
        normals.append(normal_equations(grid.unknowns, means.with_weights(weight), grid.loss))
    return joint_normal_equations(normals, joint.entries), joint.prior(total)


def _horizons_in_swings(problem: FitProblem, joint: JointRecords) -> Iterator[float]:
    """Swings that a search sees one after the other; infinitely many are all of them."""
    # Doubling finds the best fit of records whose period changes with amplitude; two swings and then
    # everything does not.
    ends = [float(grid.record.time[-1]) for grid in joint.grids]
    most = max(end / data.guess.shortest_swing_period for end, data in zip(ends, problem.data, strict=True))
    swings = FIRST_SWINGS
    while swings < most:
        yield swings
        swings *= 2.0
    yield math.inf
