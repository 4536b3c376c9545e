"""The search of a fit: many starts, over horizons that double.

A fit of a long record all together ends in local minima in which the solution gains or loses a
whole cycle. Here the first two cycles are fitted, then four, eight, sixteen, until the whole
training stretch is included: at each doubling the previous fit gives the phase at the new end to a
fraction of a cycle. The search compares means of the samples on coarse grids.

A fit along a prescribed stroke solves no equation of motion. Most of its parameters are factors in
the force, so for random draws of the others they follow from linear least squares. The best draws
start the search.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import InputError
from reduced_models.fitting.fit_data import COARSE_STEPS, FitData
from reduced_models.fitting.levenberg_marquardt import Normal, Prior, levenberg_marquardt, promising_starts
from reduced_models.fitting.parameter import Unknowns
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.refinement import FIRST_HORIZON_CYCLES, SearchResult, refine_best_start
from reduced_models.fitting.residuals import (
    Loss,
    grid_over_record,
    means_on_grid,
    normal_equations,
    residual_function,
)
from reduced_models.fitting.start_values import parameters_linear_in, scale_unknowns, start_vectors
from reduced_models.laws.law import Law
from reduced_models.laws.solution import compile_solution_ahead, padded_step_count
from reduced_models.records.inputs import StepGrid, has_inputs_besides_time

_DRAW_COUNT = 1024
_LOG_DRAW_MINIMUM, _LOG_DRAW_MAXIMUM = -4.0, 2.0  # logarithm of a drawn value over its natural size
_GIVEN_VALUE_SPREAD = 0.1  # spread of the logarithm of given values
_MINIMUM_FACTOR_SHARE = 1e-3  # of the signal: minimum contribution of a positive factor
_NEARLY_ZERO = 1e-12  # of a natural size: a positive factor that is nearly zero
_UNIT_EXPONENTS = {
    "m": (1, 0, 0), "1/m": (-1, 0, 0), "m/s": (0, 1, 0), "s/m": (0, -1, 0), "s": (1, -1, 0),
    "1/s": (-1, 1, 0), "rad/s": (-1, 1, 0), "1": (0, 0, 0), "N": (0, 0, 1), "N/m": (-1, 0, 1),
    "N s/m": (0, -1, 1), "kg": (1, -2, 1),
}  # fmt: skip
"""Exponents of half the stroke, its maximum speed and the signal whose product has each unit."""


def stroke_start_vectors(problem: FitProblem) -> tuple[tuple[float, ...], Float[np.ndarray, "s q"]]:
    """Units of the parameters, and search vectors in them: the best of many draws."""
    random, unknowns, law = np.random.default_rng(problem.seed), problem.unknowns, problem.law
    low, high = problem.edges
    # Some parameters have a separate entry for each record.
    names = {
        int(k): name for data in problem.data for k, name in zip(data.entries, law.parameters, strict=False)
    }
    free_entries = [k for k in names if low[k] < high[k]]
    known = {str(symbol) for rate in law.parsed_equation.rates for symbol in rate.free_symbols}
    linear = parameters_linear_in(law.parsed_equation.observations[unknowns.observation], law, known)
    factors = [k for k in free_entries if names[k] in linear and names[k] not in problem.start]
    drawn = [k for k in free_entries if k not in factors]
    logs = np.array([names.get(k) in law.positive for k in range(len(low))])
    values = _drawn_values(problem, unknowns, {k: names[k] for k in drawn}, len(low), random)
    held = low == high
    values[:, held] = np.where(logs, np.exp(np.where(logs, low, 0.0)), low)[held]
    sizes = np.ones(len(low))
    sizes[factors] = [_natural_size(unknowns, names[k]) for k in factors]
    values[:, factors] = np.where(logs, _NEARLY_ZERO * sizes, 0.0)[factors]

    def residuals(values: np.ndarray) -> np.ndarray:
        vectors = np.clip(np.where(logs, np.log(np.where(logs, values, 1.0)), values), low, high)
        left = [
            residual_function(data.unknowns, "several")(
                vectors[:, data.entries], data.samples, data.unknowns.scales
            )
            for data in problem.data
        ]
        return np.nan_to_num(np.concatenate(left), nan=1e9, posinf=1e9, neginf=-1e9)

    left, columns = residuals(values), []
    for k in factors:
        changed = values.copy()
        changed[:, k] += sizes[k]
        columns.append(residuals(changed) - left)
    for draw in range(len(values) if factors else 0):
        matrix = np.stack([column[:, draw] for column in columns], axis=1)
        scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
        steps = -np.linalg.lstsq(matrix / scale, left[:, draw], rcond=1e-9)[0] / scale
        least = _MINIMUM_FACTOR_SHARE * np.linalg.norm(left[:, draw]) / scale
        steps = np.where(logs[factors], np.maximum(steps, least), steps)
        values[draw, factors] += sizes[factors] * steps
    order = np.argsort((residuals(values) ** 2).sum(axis=0), kind="stable")
    values = values[order[np.arange(problem.starts) % len(order)]]
    best = np.abs(values[0, : len(low)])
    units = np.where(logs | (best == 0.0) | ~np.isin(np.arange(len(low)), list(names)), 1.0, best)
    theta = np.where(logs, np.log(np.where(logs, values, 1.0)), values / units)
    return tuple(units[problem.data[0].entries[: len(law.parameters)]]), theta


def _natural_size(unknowns: Unknowns, name: str, random: np.random.Generator | None = None) -> float:
    """Natural size of a parameter from its unit; without a unit a random one, or 1."""
    powers = _UNIT_EXPONENTS.get(unknowns.law.units.get(name, ""))
    if powers is None:
        powers = (0, 0, 0) if random is None else (*random.integers(-1, 2, 2), 0)
    scales = (unknowns.amplitude, unknowns.speed, unknowns.signal)
    return float(math.prod(scale**power for scale, power in zip(scales, powers, strict=True)))


def _drawn_values(
    problem: FitProblem, unknowns: Unknowns, drawn: Mapping[int, str], size: int, random: np.random.Generator
) -> np.ndarray:
    """Values (draws, size) of some entries about their natural sizes, or near given values."""
    from scipy.stats.qmc import LatinHypercube

    count = max(_DRAW_COUNT, problem.starts) if drawn else 1
    values = np.zeros((count, size))
    cube = LatinHypercube(max(1, len(drawn)), rng=random).random(count)
    for (k, name), column in zip(drawn.items(), cube.T, strict=False):
        if name in problem.start:
            spread = _GIVEN_VALUE_SPREAD * random.normal(size=count) * (np.arange(count) > 0)
            values[:, k] = problem.start[name] * np.exp(spread)
            continue
        sizes = np.array([_natural_size(unknowns, name, random) for _ in range(count)])
        values[:, k] = sizes * np.exp(_LOG_DRAW_MINIMUM + (_LOG_DRAW_MAXIMUM - _LOG_DRAW_MINIMUM) * column)
        if name not in unknowns.law.positive:
            values[:, k] *= random.choice([-1.0, 1.0], count)
    return values


# Of all horizons but the last: a start that lags behind loses its phase.
_HORIZON_TRIALS, _HORIZON_TOLERANCE = 60, 1e-4
# Steps over which all starts are followed, 512 periods; beyond them only the best one is.
_MAXIMUM_COARSE_STEPS = 2**13
_STROKE_SAMPLES = 1200  # of all strokes together that the search compares
_MINIMUM_SAMPLES_PER_STEP = 2.0  # samples per coarse step above which their means are fitted
_MAXIMUM_NUMBERS = 2**26
"""Maximum of starts times grid points times unknowns; memory holds four copies, 2 GB in all."""


def multistart_search(problem: FitProblem) -> SearchResult:
    """Fit the training stretches from random starts."""
    problem = problem.with_scales(scale_unknowns(problem.largest_amplitude_data))
    sample_stride = max(1, sum(problem.training) // _STROKE_SAMPLES) if problem.law.prescribed else 1
    coarse = problem.with_data(_coarse_data(data, sample_stride) for data in problem.data)
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
    """Compile to disk the programs with which a law without inputs is fitted to a record of few periods."""
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
    """Search vectors (s, p) that random starts of a law lead to, and their costs (s,)."""
    theta = start = problem.joint_vector(_start_vectors(problem))
    costs = np.zeros(problem.starts)
    for cycle_count in _horizons_in_cycles(problem):
        first, last = cycle_count == FIRST_HORIZON_CYCLES, math.isinf(cycle_count)
        normal, prior = coarse_normal_equations(problem, cycle_count)
        if problem.law.start is None and not first:
            # Starts of a law given by its equation come from the whole record; two cycles may not show, for
            # example, the frequency of a slow input.
            worse = np.asarray(normal(start)[0]) < np.asarray(normal(theta)[0])
            theta = np.where(worse[:, None], start, theta)
        waiting = promising_starts(costs, prior.samples) if costs.any() else None
        if last:
            theta, costs = levenberg_marquardt(normal, theta, prior, bounds=problem.edges, waiting=waiting)
        else:
            theta, costs = levenberg_marquardt(
                normal,
                theta,
                prior,
                _HORIZON_TOLERANCE,
                problem.edges,
                trials=_HORIZON_TRIALS,
                waiting=waiting,
            )
    return theta, costs


def _check_memory(starts: int, points: int, unknowns: int) -> None:
    """Refuse a search that needs more memory than a laboratory computer can spare."""
    maximum = _MAXIMUM_NUMBERS // (points * unknowns)
    if starts > max(maximum, 16):
        raise InputError(
            f"starts = {starts}; memory holds at most {maximum} for {unknowns} unknowns and a "
            f"record that needs {points} steps: give fewer, or a shorter record"
        )


def _start_vectors(problem: FitProblem) -> list[np.ndarray]:
    """Start vectors (starts, p) of each record; the shared ones are of the largest amplitude."""
    vectors = [
        start_vectors(data, problem.starts, np.random.default_rng(problem.seed), problem.start)
        for data in problem.data
    ]
    of_largest_amplitude = vectors[problem.data.index(problem.largest_amplitude_data)]
    names = problem.law.parameters
    shared = [k for k, name in enumerate(names) if name not in problem.data[0].per_record]
    vectors[0] = vectors[0].copy()
    vectors[0][:, shared] = of_largest_amplitude[:, shared]
    return vectors


def _coarse_data(data: FitData, sample_stride: int) -> FitData:
    """Means of a training stretch, of each n-th sample or of its first part, on a coarse grid."""
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


def coarse_normal_equations(problem: FitProblem, cycle_count: float) -> tuple[Normal, Prior]:
    """Return the normal equations of the first cycles of coarse records, with the prior."""
    normals, total = [], 0.0
    for data in problem.data:
        means = data.samples
        seen = means.step * (means.point + means.fraction) <= cycle_count * data.guess.shortest_cycle_period
        weight = means.weight * seen
        total += float((weight**2).sum())
        normals.append(normal_equations(data.unknowns, means.with_weights(weight), data.loss))
    return problem.sum_of_normal_equations(normals), problem.prior(total)


def _horizons_in_cycles(problem: FitProblem) -> Iterator[float]:
    """Numbers of cycles that the search fits one after another; infinity for the whole record."""
    # Doubling finds the best fit even if the period changes with amplitude; two cycles followed by the whole
    # record do not.
    maximum = max(data.record.time[-1] / data.guess.shortest_cycle_period for data in problem.data)
    cycle_count = FIRST_HORIZON_CYCLES
    while cycle_count < maximum:
        yield cycle_count
        cycle_count *= 2.0
    yield math.inf
