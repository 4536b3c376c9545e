"""The search of a fit: many starts, over horizons that double.

Whoever fits all of a long record together falls into the valleys in which the solution gains or
loses a whole swing. Here the first two swings are fitted, then four, eight, sixteen, until all of
the training stretch is seen: at each doubling, the phase at the new end is known to a fraction of a
swing from what was fitted before. The search sees means of the samples on coarse grids.

Start vectors of a fit along a prescribed stroke, which solves for no motion.

Most parameters stand in a force as factors; for random draws of the others these follow from linear
least squares. The best draws start the search.
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

_DRAWS = 1024
_LOW, _HIGH = -4.0, 2.0  # logarithm of what is drawn, over its natural size
_NEAR = 0.1  # spread of the logarithm of values that are given
_LEAST = 1e-3  # of the signal: least part of a factor that is above zero
_TINY = 1e-12  # of a natural size: a positive factor that is nearly zero
_POWERS = {
    "m": (1, 0, 0), "1/m": (-1, 0, 0), "m/s": (0, 1, 0), "s/m": (0, -1, 0), "s": (1, -1, 0),
    "1/s": (-1, 1, 0), "rad/s": (-1, 1, 0), "1": (0, 0, 0), "N": (0, 0, 1), "N/m": (-1, 0, 1),
    "N s/m": (0, -1, 1), "kg": (1, -2, 1),
}  # fmt: skip
"""Powers of half a stroke, of its largest speed and of the signal that make a unit."""


def stroke_start_vectors(problem: FitProblem) -> tuple[tuple[float, ...], Float[np.ndarray, "s q"]]:
    """Units of the parameters, and search vectors in them: the best of many draws."""
    random, unknowns, law = np.random.default_rng(problem.seed), problem.unknowns, problem.law
    low, high = problem.edges
    # Records have entries of their own for some parameters.
    names = {
        int(k): name for data in problem.data for k, name in zip(data.entries, law.parameters, strict=False)
    }
    open_ones = [k for k in names if low[k] < high[k]]
    known = {str(symbol) for rate in law.parsed_equation.rates for symbol in rate.free_symbols}
    linear = parameters_linear_in(law.parsed_equation.observations[unknowns.observation], law, known)
    factors = [k for k in open_ones if names[k] in linear and names[k] not in problem.start]
    drawn = [k for k in open_ones if k not in factors]
    logs = np.array([names.get(k) in law.positive for k in range(len(low))])
    values = _drawn_values(problem, unknowns, {k: names[k] for k in drawn}, len(low), random)
    held = low == high
    values[:, held] = np.where(logs, np.exp(np.where(logs, low, 0.0)), low)[held]
    sizes = np.ones(len(low))
    sizes[factors] = [_natural_size(unknowns, names[k]) for k in factors]
    values[:, factors] = np.where(logs, _TINY * sizes, 0.0)[factors]

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
        least = _LEAST * np.linalg.norm(left[:, draw]) / scale
        steps = np.where(logs[factors], np.maximum(steps, least), steps)
        values[draw, factors] += sizes[factors] * steps
    order = np.argsort((residuals(values) ** 2).sum(axis=0), kind="stable")
    values = values[order[np.arange(problem.starts) % len(order)]]
    best = np.abs(values[0, : len(low)])
    units = np.where(logs | (best == 0.0) | ~np.isin(np.arange(len(low)), list(names)), 1.0, best)
    theta = np.where(logs, np.log(np.where(logs, values, 1.0)), values / units)
    return tuple(units[problem.data[0].entries[: len(law.parameters)]]), theta


def _natural_size(unknowns: Unknowns, name: str, random: np.random.Generator | None = None) -> float:
    """Natural size of a parameter by its unit; of one without a unit a random one, or 1."""
    powers = _POWERS.get(unknowns.law.units.get(name, ""))
    if powers is None:
        powers = (0, 0, 0) if random is None else (*random.integers(-1, 2, 2), 0)
    scales = (unknowns.amplitude, unknowns.speed, unknowns.signal)
    return float(math.prod(scale**power for scale, power in zip(scales, powers, strict=True)))


def _drawn_values(
    problem: FitProblem, unknowns: Unknowns, drawn: Mapping[int, str], size: int, random: np.random.Generator
) -> np.ndarray:
    """Values (draws, size) of some entries about their natural sizes, or near given values."""
    from scipy.stats.qmc import LatinHypercube

    count = max(_DRAWS, problem.starts) if drawn else 1
    values = np.zeros((count, size))
    cube = LatinHypercube(max(1, len(drawn)), rng=random).random(count)
    for (k, name), column in zip(drawn.items(), cube.T, strict=False):
        if name in problem.start:
            spread = _NEAR * random.normal(size=count) * (np.arange(count) > 0)
            values[:, k] = problem.start[name] * np.exp(spread)
            continue
        sizes = np.array([_natural_size(unknowns, name, random) for _ in range(count)])
        values[:, k] = sizes * np.exp(_LOW + (_HIGH - _LOW) * column)
        if name not in unknowns.law.positive:
            values[:, k] *= random.choice([-1.0, 1.0], count)
    return values


_TRIALS, _TOLERANCE = 60, 1e-4  # of all horizons but the last: what lags behind loses its phase
# Steps over which all starts are followed, 512 periods; behind them, the best one.
_MOST_COARSE = 2**13
_STROKE_SAMPLES = 1200  # of all strokes that a search sees
_THIN = 2.0  # samples a coarse step, above which their means are fitted
_MOST_NUMBERS = 2**26
"""Starts times grid points times unknowns, which stand in memory four times: two gigabytes."""


def multistart_search(problem: FitProblem) -> SearchResult:
    """Fit the training stretches from random starts."""
    problem = problem.with_scales(scale_unknowns(problem.largest_amplitude_data))
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
    for swings in _horizons_in_cycles(problem):
        first, last = swings == FIRST_HORIZON_CYCLES, math.isinf(swings)
        normal, prior = coarse_normal_equations(problem, swings)
        if problem.law.start is None and not first:
            # Starts of a law known by its equation come from all of the record; two swings may not show, for
            # example, the frequency of a slow input.
            worse = np.asarray(normal(start)[0]) < np.asarray(normal(theta)[0])
            theta = np.where(worse[:, None], start, theta)
        waiting = promising_starts(costs, prior.samples) if costs.any() else None
        if last:
            theta, costs = levenberg_marquardt(normal, theta, prior, bounds=problem.edges, waiting=waiting)
        else:
            theta, costs = levenberg_marquardt(
                normal, theta, prior, _TOLERANCE, problem.edges, trials=_TRIALS, waiting=waiting
            )
    return theta, costs


def _check_memory(starts: int, points: int, unknowns: int) -> None:
    """Refuse a search that needs more memory than a laboratory's computer has to spare."""
    most = _MOST_NUMBERS // (points * unknowns)
    if starts > max(most, 16):
        raise InputError(
            f"starts = {starts}; at most {most} fit into memory for {unknowns} unknowns and a "
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
    shared = [k for k, name in enumerate(names) if name not in problem.data[0].own]
    vectors[0] = vectors[0].copy()
    vectors[0][:, shared] = of_largest_amplitude[:, shared]
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
        seen = means.step * (means.point + means.fraction) <= swings * data.guess.shortest_cycle_period
        weight = means.weight * seen
        total += float((weight**2).sum())
        normals.append(normal_equations(data.unknowns, means.with_weights(weight), data.loss))
    return problem.sum_of_normal_equations(normals), problem.prior(total)


def _horizons_in_cycles(problem: FitProblem) -> Iterator[float]:
    """Swings that a search sees one after the other; infinitely many are all of them."""
    # Doubling finds the best fit of records whose period changes with amplitude; two swings and then
    # everything does not.
    most = max(data.record.time[-1] / data.guess.shortest_cycle_period for data in problem.data)
    swings = FIRST_HORIZON_CYCLES
    while swings < most:
        yield swings
        swings *= 2.0
    yield math.inf
