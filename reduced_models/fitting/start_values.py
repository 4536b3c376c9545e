"""Find start values of a law's parameters from its start function or from a record's accelerations.

A law that is given by its equation alone has no start function. The record is then smoothed by local
cubics, which give height, velocity and acceleration at some times. Parameters are fitted to these
accelerations, starting from random draws in units made of the record's time and length scales
(gradient matching; Ramsay et al. 2007, doi:10.1111/j.1467-9868.2007.00610.x). Hidden states
are not recorded, but the motion that drives them is. For trial parameters the hidden states are
integrated along the smoothed motion of the first cycles, and the resulting accelerations are compared with
the record's.
The fit that solves the equation of motion starts from the values found in this way.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float, Int
from reduced_models.fitting.fit_data import FitData
from reduced_models.fitting.levenberg_marquardt import (
    Normal,
    NormalPrior,
    SearchBounds,
    levenberg_marquardt_vectors_and_costs,
)
from reduced_models.fitting.parameter import Pairs, SearchUnknowns
from reduced_models.fitting.wide_starts import draws_with_closest_solutions
from reduced_models.laws.equation import compile_observation, compile_rates
from reduced_models.laws.law import Law
from reduced_models.laws.symmetry import canonical_parameters
from reduced_models.records.derivatives import fit_local_cubics
from reduced_models.records.first_guesses import MINIMUM_CROSSINGS, FirstGuesses, spectral_peak_frequencies
from reduced_models.records.inputs import TIME, input_column, interpolate_inputs

_NODE_COUNT, _MAXIMUM_NODES = 160, 320
_DRAW_COUNT = 96  # a frequency in the law has a narrow minimum, which few of the draws reach
_COLLOCATION_DRAW_COUNT = 1
_MAXIMUM_STEPS = 20  # maximum number of steps in the fit of a draw to the accelerations
_EQUAL_DRAWS = 0.01  # relative difference of parameters below which fits to accelerations are equal
_REPEATED_START_SPREAD = 0.05  # spread of the logarithm of repeated start values
# Draws whose mean is a parameter's unit: a single one may be near zero, which makes the prior too narrow.
_UNIT_DRAW_COUNT = 16
_ACCEPTED_COST_RATIO = 4.0  # multiple of the smallest mean square, up to which a start is kept
_GIVEN_VALUE_SPREAD = 0.1  # largest spread of the logarithm of given start values
_SMALLEST_SPREAD = 1e-3  # of accurate start values: the fit of a chaotic motion may fail from one of them

# Of a law with hidden states:
_HIDDEN_CYCLES, _NODES_PER_CYCLE = 6.0, 32
_FREQUENCY_RATIO = 2.0  # ratio of the frequency of a further coordinate's motion to the slowest frequency
_HIDDEN_ROUNDS, _HIDDEN_DRAW_COUNT, _RETAINED_DRAWS = 8, 4096, 48
_HIDDEN_TRIALS = 40
_DIFFERENCE_STEP = 1e-6  # step of the logarithms for derivatives
_RIDGE = 1e-9  # added to the diagonal of normal equations to keep them regular
_LARGEST_STATE = 1e6


class StartDraws(NamedTuple):
    """Random start values of a law's parameters and of its coordinates other than the first."""

    values: dict[str, Float[np.ndarray, "count"]]  # by name
    origins: Int[np.ndarray, "count"]  # the same number for starts that deviate slightly from one another


@dataclasses.dataclass(frozen=True, eq=False)
class StartDrawsNearValues:
    """Function that draws start values around known parameters; the first draw is these parameters."""

    values: Mapping[str, float]

    def __call__(self, _: FirstGuesses, random: np.random.Generator, count: int) -> dict[str, np.ndarray]:
        """Draw start values (count,) of each parameter."""
        spread = np.append(0.0, np.geomspace(_SMALLEST_SPREAD, _GIVEN_VALUE_SPREAD, count - 1))
        return {
            name: value * np.exp(spread * random.normal(size=count)) for name, value in self.values.items()
        }


def draw_start_values(
    law: Law,
    guess: FirstGuesses,
    record: PistonRecord,
    random: np.random.Generator,
    count: int,
    bounds: Pairs | None = None,
) -> StartDraws:
    """Draw start values of a law's parameters and of its coordinates other than the first.

    For a law given by its equation alone, half of the starts are wide draws (see `wide_starts`), except if
    the law has hidden states or a scaled coordinate.
    """
    if law.start is not None:
        values = law.start(dataclasses.replace(guess, given=_values_fixed_by_bounds(bounds)), random, count)
        return StartDraws(values, np.arange(count) * (not isinstance(law.start, StartDrawsNearValues)))
    if law.hidden:
        draws = _search_parameters_and_hidden_states(
            law,
            guess,
            record,
            lambda size: _draw_parameters_in_record_scales(law, guess, random, size, bounds),
            _values_fixed_by_bounds(bounds),
        )
    else:
        drawn = _draw_parameters_in_record_scales(law, guess, random, _DRAW_COUNT, bounds)
        for name in drive_frequency_names(law):
            if name not in _values_fixed_by_bounds(bounds):
                _draw_wave_frequencies(law, drawn[:, law.parameters.index(name)], record, random)
        draws = _fit_draws_to_accelerations(law, guess, record, drawn, bounds)
    # The best draw stays unchanged: it may give a frequency in the law far more precisely than the spread.
    repeated = np.arange(count) % len(draws)
    chosen, origins = draws[repeated], _group_numbers_of_nearly_equal_rows(draws)[repeated]
    spread = _REPEATED_START_SPREAD * (np.arange(count) > 0)
    chosen = chosen * np.exp(spread[:, None] * random.normal(size=chosen.shape))
    if count > 1 and not law.hidden and law.parsed_equation.line is None:
        chosen[1::2] = _wide_draws(law, guess, record, random, count // 2, bounds)
        origins[1::2] = len(draws) + np.arange(count // 2)
    if law.observations:
        _fit_parameters_of_observations(law, guess, record, chosen, _values_fixed_by_bounds(bounds))
    names = (*law.parameters, *law.other_coordinates)
    return StartDraws({name: chosen[:, k].copy() for k, name in enumerate(names)}, origins)


def _group_numbers_of_nearly_equal_rows(rows: np.ndarray) -> np.ndarray:
    """Return a number for each row (s,), the same for rows that are nearly equal."""
    limits = _EQUAL_DRAWS * np.abs(rows).max(axis=0)
    numbers = np.arange(len(rows))
    for k in range(1, len(rows)):
        equal = np.flatnonzero((np.abs(rows[:k] - rows[k]) <= limits).all(axis=1))
        numbers[k] = numbers[equal[0]] if len(equal) else k
    return numbers


def _wide_draws(
    law: Law,
    guess: FirstGuesses,
    record: PistonRecord,
    random: np.random.Generator,
    count: int,
    bounds: Pairs | None,
) -> np.ndarray:
    """Return draws (count, p) chosen by their solutions; see `reduced_models.fitting.wide_starts`."""
    fixed = _values_fixed_by_bounds(bounds)

    def canonical_draws(draws: np.ndarray) -> np.ndarray:
        for name in drive_frequency_names(law):
            _draw_wave_frequencies(law, draws[:, law.parameters.index(name)], record, random)
        values = canonical_parameters(law, dict(zip(law.parameters, draws.T, strict=True)), bounds=bounds)
        values |= {name: np.full(len(draws), value) for name, value in fixed.items()}
        return np.stack([values[name] for name in law.parameters], axis=1)

    draws = draws_with_closest_solutions(law, guess, record, random, count, canonical_draws)
    return draws[np.arange(count) % len(draws)]


def _fit_parameters_of_observations(
    law: Law, guess: FirstGuesses, record: PistonRecord, draws: np.ndarray, fixed: Collection[str]
) -> None:
    """Set parameters that occur only in the observations, by linear least squares on the smoothed record."""
    import sympy

    parsed = law.parsed_equation
    z, v, _, nodes = fit_local_cubics(record.time, record.height, guess.period, _NODE_COUNT)
    drive = interpolate_inputs(record.time, [input_column(record, name) for name in law.inputs], nodes)
    states = (z, v, *np.zeros((len(law.hidden), len(z))), *drive.T)
    known = set().union(*(rate.free_symbols for rate in parsed.acceleration_and_hidden_rates))
    for name, expression in parsed.observations.items():
        linear = parameters_linear_in(expression, law, (*fixed, *map(str, known)))
        parameter_indices = [
            law.parameters.index(item) for item in linear if expression.has(sympy.Symbol(item))
        ]
        if not parameter_indices:
            continue
        observe = compile_observation(law.equation, law.inputs, name, "numpy")
        seen = np.interp(nodes, record.time, record.columns.get(name, record.height))
        for draw in draws:
            draw[parameter_indices] = 0.0
            units = np.eye(len(draw))[parameter_indices]
            with np.errstate(all="ignore"):
                still = np.broadcast_to(observe(*states, *draw[: len(law.parameters)]), seen.shape)
                slopes = [observe(*states, *(draw + unit)[: len(law.parameters)]) - still for unit in units]
            matrix = np.reshape(
                np.nan_to_num([np.broadcast_to(item, seen.shape) for item in slopes]), (-1, len(seen))
            )
            values = np.linalg.lstsq(matrix.T, np.nan_to_num(seen - still), rcond=_RIDGE)[0]
            positive = [law.parameters[k] in law.positive for k in parameter_indices]
            draw[parameter_indices] = np.where(positive, np.maximum(np.abs(values), _RIDGE), values)


def parameters_linear_in(expression: Any, law: Law, others: Collection[str]) -> list[str]:
    """Return the parameters in which an expression is jointly linear, except ``others``."""
    import sympy

    chosen: list[sympy.Symbol] = []
    for name in law.parameters:
        symbol = sympy.Symbol(name)
        if name not in others and not expression.diff(symbol).has(symbol, *chosen):
            chosen.append(symbol)
    return [symbol.name for symbol in chosen]


def drive_frequency_names(law: Law) -> tuple[str, ...]:
    """Return the angular frequencies of drives: parameters that multiply the time in a sine or cosine."""
    import sympy

    parsed, time = law.parsed_equation, sympy.Symbol(TIME)
    waves = [
        wave for rate in parsed.acceleration_and_hidden_rates for wave in rate.atoms(sympy.sin, sympy.cos)
    ]
    slopes = {str(wave.args[0].diff(time)) for wave in waves}
    return tuple(name for name in law.parameters if name in slopes)


def _draw_wave_frequencies(
    law: Law, values: Float[np.ndarray, "d"], record: PistonRecord, random: np.random.Generator
) -> None:
    """Draw drive frequencies from spectral lines, or from their spacings if a drive modulates the motion."""
    # An additive drive shows as a separate line; a wave that multiplies the coordinate shows as sidebands
    # spaced by its frequency.
    peaks = spectral_peak_frequencies(record.time, record.height)
    lines = random.choice(peaks, len(values))
    if not _is_parametrically_excited(law):
        values[:] = lines
        return
    apart = np.abs(lines - random.choice(peaks, len(values)))
    turn = random.permutation(len(values)) % 3
    values[turn == 0] = lines[turn == 0]
    chosen = (turn == 1) & (apart > 0.0)
    values[chosen] = apart[chosen]


def _is_parametrically_excited(law: Law) -> bool:
    import sympy

    time = sympy.Symbol(TIME)
    return any(
        rate.diff(symbol).has(time)
        for rate in law.parsed_equation.acceleration_and_hidden_rates
        for symbol in rate.free_symbols - {time}
        if symbol.name not in law.parameters
    )


def fit_to_accelerations(
    law: Law,
    guess: FirstGuesses,
    record: PistonRecord,
    values: Float[np.ndarray, "p"],
    bounds: Pairs | None = None,
) -> Float[np.ndarray, "p"]:
    """Fit a law without hidden states to the accelerations in a record alone; return parameters (p,)."""
    units = np.where(np.abs(values) > 0.0, values, 1.0)
    draws = _draw_parameters_in_record_scales(
        law, guess, np.random.default_rng(0), _COLLOCATION_DRAW_COUNT, bounds
    )
    return np.asarray(_fit_draws_to_accelerations(law, guess, record, np.vstack([units, draws]), bounds)[0])


def _draw_parameters_in_record_scales(
    law: Law, guess: FirstGuesses, random: np.random.Generator, count: int, bounds: Pairs | None = None
) -> np.ndarray:
    """Draw values (count, p) as products of powers of the record's time and length scales."""
    shape = (count, len(law.parameters))
    guess = _guess_in_coordinate_of_law(law, guess)
    level = max(abs(guess.rest), 1e-3 * guess.amplitude)
    length = np.where(random.uniform(size=shape) < 0.7, guess.amplitude, level)
    size = guess.frequency ** random.integers(0, 3, shape) * length ** random.integers(-2, 2, shape)
    draws = size * np.exp(random.uniform(-1.5, 1.5, shape))
    positive = np.array([name in law.positive for name in law.parameters])
    draws = np.where(positive | (random.uniform(size=shape) < 0.7), draws, -draws)
    values = canonical_parameters(law, dict(zip(law.parameters, draws.T, strict=True)), bounds=bounds)
    values |= {name: np.full(count, value) for name, value in _values_fixed_by_bounds(bounds).items()}
    return np.stack([values[name] for name in law.parameters], axis=1)


def _guess_in_coordinate_of_law(law: Law, guess: FirstGuesses) -> FirstGuesses:
    """Convert a guess from heights to the law's coordinate, if its shift and scale are constants."""
    line = law.parsed_equation.line
    if line is None or any(item.free_symbols for item in line):
        return guess
    shift, scale = map(float, line)
    return dataclasses.replace(
        guess, rest=(guess.rest - shift) / scale, amplitude=guess.amplitude / abs(scale)
    )


def _fit_draws_to_accelerations(
    law: Law, guess: FirstGuesses, record: PistonRecord, draws: np.ndarray, bounds: Pairs | None = None
) -> np.ndarray:
    """Fit draws to the accelerations; return the fits of small error, best first."""
    from scipy.optimize import least_squares

    motion = fit_local_cubics(record.time, record.height, guess.period, _NODE_COUNT)
    # A long record with few samples per cycle would otherwise keep all samples as nodes.
    z, v, a, nodes = motion[:, :: math.ceil(motion.shape[1] / _MAXIMUM_NODES)]
    drive = interpolate_inputs(record.time, [input_column(record, name) for name in law.inputs], nodes)
    field = compile_rates(law.equation, law.inputs, "numpy")
    scale = max(float(np.abs(a).max()), 1e-300)
    logarithmic = np.array([name in law.positive for name in law.parameters])

    held = _values_fixed_by_bounds(bounds)
    free = np.array([name not in held for name in law.parameters])

    def parameters_after_step(x: np.ndarray, unit: np.ndarray) -> np.ndarray:
        full = np.zeros(len(free))
        full[free] = x
        return unit * np.where(logarithmic, np.exp(np.clip(full, -50.0, 50.0)), 1.0 + full)

    def acceleration_residuals(x: np.ndarray, unit: np.ndarray) -> np.ndarray:
        values = parameters_after_step(x, unit)
        with np.errstate(all="ignore"):
            result = (field(z, v, *drive.T, *values)[0] - a) / scale
        return np.broadcast_to(np.nan_to_num(np.clip(result, -1e6, 1e6), nan=1e6), a.shape)

    results = []
    for unit in draws:
        solution = least_squares(
            acceleration_residuals,
            np.zeros(free.sum()),
            args=(unit,),
            x_scale="jac",
            max_nfev=_MAXIMUM_STEPS * (1 + int(free.sum())),
            method="lm",
        )
        results.append((float(solution.cost), parameters_after_step(solution.x, unit)))
    results.sort(key=lambda pair: pair[0])
    good = np.array(
        [values for cost, values in results if cost <= _ACCEPTED_COST_RATIO * results[0][0] + 1e-12]
    )
    # Equivalent draws end with either sign or whole turns apart. Rounding decides which comes first; that
    # must not decide where the search starts, and bounds must not cut off the sign it starts from.
    canonical = canonical_parameters(law, dict(zip(law.parameters, good.T, strict=True)), bounds=bounds)
    return np.stack([canonical[name] for name in law.parameters], axis=1)


def _values_fixed_by_bounds(bounds: Pairs | None) -> dict[str, float]:
    """Return the values of the parameters whose two bounds are equal."""
    return {name: low for name, (low, high) in (bounds or {}).items() if low == high}


def _search_parameters_and_hidden_states(
    law: Law,
    guess: FirstGuesses,
    record: PistonRecord,
    draw: Callable[[int], np.ndarray],
    fixed: Collection[str],
) -> np.ndarray:
    """Search parameters and initial states of all other coordinates; return rows (k, p), best first."""
    end = min(float(record.time[-1]), _HIDDEN_CYCLES * guess.period)
    # A further coordinate moves faster: wide windows would smooth it out, and long steps of Heun's method
    # would add energy to it.
    period = guess.period / (_FREQUENCY_RATIO if law.other_coordinates else 1.0)
    nodes = np.linspace(0.0, end, max(48, round(_NODES_PER_CYCLE * end / period)))
    motion = fit_local_cubics(record.time, record.height, period, nodes)
    acceleration, times = motion[2:]
    drive = interpolate_inputs(record.time, [input_column(record, name) for name in law.inputs], times)
    accelerations_and_hidden_states, count = (
        make_acceleration_function(law, motion, drive),
        len(law.parameters),
    )
    others = [law.hidden.index(name) for name in law.other_coordinates]
    columns = []
    for name in law.observations if others else ():
        if name != "height":
            seen = interpolate_inputs(record.time, [input_column(record, name)], times)[:, 0]
            columns.append((name, seen, max(float(np.abs(seen - seen.mean()).max()), 1e-300)))
    scale = max(float(np.abs(acceleration).max()), 1e-300)
    target = acceleration[:, None]

    def scaled_deviations(values: np.ndarray) -> np.ndarray:
        """Return errors (n, m) of the accelerations for parameters (m, p), over the maximum acceleration."""
        start = np.zeros((len(law.hidden), len(values)))
        start[others] = values[:, count:].T
        accelerations, path = accelerations_and_hidden_states(values[:, :count].T, start)
        result = (accelerations - target) / scale
        for name, seen, size in columns:
            observe = compile_observation(law.equation, law.inputs, name, "numpy")
            states = (*motion[:2, :, None], *path.swapaxes(0, 1), *drive.T[:, :, None])
            with np.errstate(all="ignore"):
                left = (observe(*states, *values[:, :count].T) - seen[:, None]) / size
            result = np.vstack([result, np.broadcast_to(left, accelerations.shape)])
        return np.nan_to_num(np.clip(result, -_LARGEST_STATE, _LARGEST_STATE), nan=_LARGEST_STATE)

    scales = np.array([guess.amplitude, guess.amplitude * guess.frequency] * (len(others) // 2))

    def with_fitted_states(parameters: np.ndarray) -> np.ndarray:
        """Append initial states of all other coordinates, from least squares (exact for a linear law)."""
        values = np.hstack([parameters, np.zeros((len(parameters), len(others)))])
        if not others:
            return values
        left = scaled_deviations(values)
        slopes = []
        for k, size in enumerate(scales):
            values[:, count + k] = size
            slopes.append(scaled_deviations(values) - left)
            values[:, count + k] = 0.0
        normal = np.einsum("anm,bnm->mab", slopes, slopes)
        size = 1.0 + np.trace(normal, axis1=1, axis2=2)
        normal += _RIDGE * np.eye(len(scales)) * size[:, None, None]
        steps = np.linalg.solve(normal, -np.einsum("anm,nm->ma", slopes, left)[..., None])[..., 0]
        values[:, count:] = np.where(np.abs(steps) < _LARGEST_STATE, steps, 1.0) * scales
        return values

    best = np.empty((0, count + len(others)))
    for _ in range(_HIDDEN_ROUNDS):
        drawn = np.vstack([best, with_fitted_states(draw(_HIDDEN_DRAW_COUNT))])
        order = np.argsort((scaled_deviations(drawn) ** 2).sum(axis=0))
        best = drawn[order[:_RETAINED_DRAWS]]
    held = np.isin((*law.parameters, *law.other_coordinates), list(fixed))
    output, cost = levenberg_marquardt_vectors_and_costs(
        _make_acceleration_normal_equations(best, scaled_deviations),
        np.zeros_like(best),
        NormalPrior(np.full(best.shape[1], 0.01), float(len(nodes) * (1 + len(columns)))),
        1e-4,
        SearchBounds(np.where(held, 0.0, -np.inf), np.where(held, 0.0, np.inf)),
        trials=_HIDDEN_TRIALS,
    )
    values = best * np.exp(np.clip(output, -50.0, 50.0))
    order = np.argsort(cost)
    good = order[cost[order] <= _ACCEPTED_COST_RATIO * cost[order[0]] + 1e-12]
    return np.asarray(values[good])


def make_acceleration_function(
    law: Law, motion: Float[np.ndarray, "4 n"], drive: Float[np.ndarray, "n inputs"]
) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Return a function of parameters that gives accelerations and hidden states along a known motion."""
    # The rows of the motion are z, z', z'' and time [s]. The function maps parameters (p, m) and initial
    # hidden states (h, m), zero if not given, to accelerations (n, m) and hidden states (n, h, m). It uses
    # Heun's method with one step from node to node of the known motion.
    field = compile_rates(law.equation, law.inputs, "numpy")
    z, v, _, time = motion

    def accelerations_and_hidden_states(
        values: np.ndarray, start: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        count = values.shape[1]
        hidden = np.zeros((len(law.hidden), count)) if start is None else start
        result, path = np.empty((len(time), count)), np.empty((len(time), *hidden.shape))

        def rates(k: int, states: np.ndarray) -> Any:
            rows = field(z[k], v[k], *states, *drive[k], *values)
            return [np.broadcast_to(row, count) for row in rows]

        with np.errstate(all="ignore"):
            for k in range(len(time)):
                path[k] = hidden
                result[k], *here = rates(k, hidden)
                if k + 1 < len(time):
                    step = time[k + 1] - time[k]
                    slope = np.array(here)
                    ahead = np.clip(hidden + step * slope, -_LARGEST_STATE, _LARGEST_STATE)
                    late = np.array(rates(k + 1, ahead)[1:])
                    moved = hidden + 0.5 * step * (slope + late)
                    hidden = np.nan_to_num(np.clip(moved, -_LARGEST_STATE, _LARGEST_STATE))
        return result, path

    return accelerations_and_hidden_states


def _make_acceleration_normal_equations(
    units: np.ndarray, scaled_deviations: Callable[[np.ndarray], np.ndarray]
) -> Normal:
    """Return normal equations, from finite differences, for logarithms (m, p) of parameter / unit."""

    def normal_equations_at(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count, size = theta.shape
        moved = np.repeat(theta[None], size + 1, axis=0)
        moved[np.arange(1, size + 1), :, np.arange(size)] += _DIFFERENCE_STEP
        values = units * np.exp(np.clip(moved, -50.0, 50.0))
        left = scaled_deviations(values.reshape(-1, size)).reshape(-1, size + 1, count)
        slopes = (left[:, 1:] - left[:, :1]) / _DIFFERENCE_STEP
        here = left[:, 0]
        return (
            (here**2).sum(axis=0),
            np.einsum("nps,ns->sp", slopes, here),
            np.einsum("nps,nqs->spq", slopes, slopes),
        )

    return normal_equations_at


def unknowns_with_typical_scales(data: FitData) -> SearchUnknowns:
    """Return the unknowns of a law, with its parameters scaled by typical start values for a record."""
    law, guess = data.unknowns.law, data.guess
    if law.prescribed:  # its draws give the units
        return data.unknowns
    # An equilibrium height near zero does not scale a parameter, so the amplitude is added.
    scaled_guess = dataclasses.replace(
        guess, rest=abs(guess.rest) + guess.amplitude, crossings=max(guess.crossings, MINIMUM_CROSSINGS)
    )
    random, count = np.random.default_rng(0), _UNIT_DRAW_COUNT
    typical = draw_start_values(law, scaled_guess, data.clipped_motion, random, count).values
    units = tuple(
        1.0 if name in law.positive else float(np.abs(typical[name]).mean()) or 1.0 for name in law.parameters
    )
    return dataclasses.replace(data.unknowns, units=units)


class StartVectors(NamedTuple):
    """Start vectors of a search."""

    theta: Float[np.ndarray, "count p"]
    origins: Int[np.ndarray, "count"]  # the same number for starts that deviate slightly from one another


def make_start_vectors(
    data: FitData, count: int, random: np.random.Generator, near: Mapping[str, float]
) -> StartVectors:
    """Return start vectors of a search, from a record and its first guesses."""
    unknowns = data.unknowns
    draws, origins = draw_start_values(
        unknowns.law, data.guess, data.clipped_motion, random, count, data.bounds
    )
    for name, value in near.items():
        spread = _GIVEN_VALUE_SPREAD * random.normal(size=count) * (np.arange(count) > 0)
        positive = name in unknowns.law.positive or value != 0.0
        unit = unknowns.units[unknowns.law.parameters.index(name)]
        draws[name] = value * np.exp(spread) if positive else spread * unit
    if {*unknowns.law.parameters} <= {*near, *_values_fixed_by_bounds(data.bounds)}:
        origins = np.zeros(count, dtype=int)
    theta = append_initial_state(data, search_entries_from_draws(unknowns, draws), draws)
    return StartVectors(theta, origins)


def append_initial_state(
    data: FitData, free: Float[np.ndarray, "count k"], states: Mapping[str, np.ndarray] | None = None
) -> Float[np.ndarray, "count p"]:
    """Append to parameters (count, k) the initial state of the record and the entries of the sensor."""
    count, guess, unknowns = len(free), data.guess, data.unknowns
    height = np.full(count, (guess.height - unknowns.rest) / unknowns.amplitude)
    velocity = np.full(count, guess.velocity / unknowns.speed)
    sensor = np.tile(_sensor_start_entries(unknowns, data.record.height[: data.training]), (count, 1))
    still = np.zeros(count)
    hidden = np.reshape([(states or {}).get(name, still) for name in unknowns.law.hidden], (-1, count)).T
    return np.column_stack([free, height, velocity, hidden, sensor])


def _sensor_start_entries(unknowns: SearchUnknowns, signal: np.ndarray) -> list[float]:
    """Return a sensor's start entries: nominal gain, mean signal as offset, and a steady filter state."""
    sensor = unknowns.sensor
    if sensor is None:
        return []
    gain_is_open, offset_is_open = unknowns.gain_and_offset_are_entries
    mean = float(signal.mean()) if sensor.offset == "free" else sensor.nominal_offset
    first = float(signal[0] - mean) / unknowns.signal * sensor.derivative_sign_in_signal
    states = [first if sensor.low_pass is not None else 0.0, 0.0][: sensor.filter_order]
    offset = (mean - sensor.nominal_offset) / unknowns.signal
    return [1.0] * gain_is_open + [offset] * offset_is_open + states


def search_entries_from_draws(
    unknowns: SearchUnknowns, draws: Mapping[str, np.ndarray]
) -> Float[np.ndarray, "count k"]:
    """Convert draws of parameters into entries (count, k) of search vectors, without initial states."""
    # A parameter that the law lets be negative is drawn with either sign, even if limits keep it positive.
    result = [
        np.log(np.abs(draws[name])) if name in unknowns.law.positive else draws[name] / unit
        for name, unit in zip(unknowns.law.parameters, unknowns.units, strict=True)
    ]
    return np.stack(result, axis=1)
