"""Start values of a law, from its own function or accelerations in the record, and start vectors.

For a law that is known by its equation alone the record is smoothed by local cubics, which give
height, velocity and acceleration at some times; parameters are then fitted to the accelerations,
from random draws in units that the record's own time and lengths make (gradient matching; Ramsay et
al. 2007, doi:10.1111/j.1467-9868.2007.00610.x). Hidden states are not in a record, but what drives
them is: for trial parameters they are carried along the smoothed motion of the first swings, and
the accelerations that follow are compared. The result only starts the fit through the equation of
motion.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from reduced_models.fitting.fit_data import FitData
from reduced_models.fitting.levenberg_marquardt import Bounds, Normal, Prior, levenberg_marquardt
from reduced_models.fitting.parameter import Pairs, Unknowns
from reduced_models.laws.equation import compile_observation, compile_rates
from reduced_models.laws.law import Law, Starts
from reduced_models.laws.symmetry import canonical_parameters
from reduced_models.records.derivatives import fit_local_cubics
from reduced_models.records.first_guesses import LEAST_CROSSINGS, FirstGuesses, spectral_peaks
from reduced_models.records.inputs import TIME, input_column, interpolate_inputs

_NODES, _MOST_NODES = 160, 320
_DRAWS = 96  # a frequency in the law has a narrow valley, that few of them fall into
_OTHER_DRAWS = 1
_STEPS = 20  # of a draw, at most
_SPREAD = 0.05  # of the logarithm of repeated start values
_TYPICAL = 16  # draws whose mean is a parameter's unit: one may be near zero, and the prior then narrow
_GOOD = 4.0  # times the least mean square: a start that is kept
_NEAR = 0.1  # spread of the logarithm of start values that are given

# Of a law with hidden states:
_SWINGS, _NODES_PER_CYCLE = 6.0, 32
_FASTER = 2.0  # motions of further coordinates than the slowest
_ROUNDS, _HIDDEN_DRAWS, _RETAINED = 8, 4096, 48
_TRIALS = 40
_STEP = 1e-6  # of the logarithms, for slopes
_TINY = 1e-9  # of normal equations, which keeps them regular
_FAR = 1e6


def start_values(
    law: Law,
    guess: FirstGuesses,
    record: PistonRecord,
    random: np.random.Generator,
    count: int,
    bounds: Pairs | None = None,
) -> dict[str, np.ndarray]:
    """Random start values (count,) of a law's parameters, and of further coordinates by their names."""
    if law.start is not None:
        return law.start(dataclasses.replace(guess, given=_fixed_by_bounds(bounds)), random, count)
    if law.hidden:
        draws = _hidden_starts(
            law,
            guess,
            record,
            lambda size: _random_draws(law, guess, random, size, bounds),
            _fixed_by_bounds(bounds),
        )
    else:
        drawn = _random_draws(law, guess, random, _DRAWS, bounds)
        for name in drive_frequencies(law):
            if name not in _fixed_by_bounds(bounds):
                _draw_wave_frequencies(law, drawn[:, law.parameters.index(name)], record, random)
        draws = _fit_draws_to_accelerations(law, guess, record, drawn, bounds)
    if law.observations:
        _fit_parameters_of_observations(law, guess, record, draws, _fixed_by_bounds(bounds))
    chosen = draws[np.arange(count) % len(draws)]
    # The best as it is: a frequency in the law may be known to far less than the spread.
    spread = _SPREAD * (np.arange(count) > 0)
    chosen = chosen * np.exp(spread[:, None] * random.normal(size=chosen.shape))
    return {name: chosen[:, k].copy() for k, name in enumerate((*law.parameters, *law.other_coordinates))}


def _fit_parameters_of_observations(
    law: Law, guess: FirstGuesses, record: PistonRecord, draws: np.ndarray, fixed: Collection[str]
) -> None:
    """Set parameters that stand in observations alone by linear least squares along the smoothed record."""
    import sympy

    parsed = law.parsed_equation
    z, v, _, nodes = fit_local_cubics(record.time, record.height, guess.period, _NODES)
    drive = interpolate_inputs(record.time, [input_column(record, name) for name in law.inputs], nodes)
    states = (z, v, *np.zeros((len(law.hidden), len(z))), *drive.T)
    known = set().union(*(rate.free_symbols for rate in parsed.rates))
    for name, expression in parsed.observations.items():
        linear = parameters_linear_in(expression, law, (*fixed, *map(str, known)))
        mine = [law.parameters.index(item) for item in linear if expression.has(sympy.Symbol(item))]
        if not mine:
            continue
        observe = compile_observation(law.equation, law.inputs, name, "numpy")
        seen = np.interp(nodes, record.time, record.columns.get(name, record.height))
        for draw in draws:
            draw[mine] = 0.0
            units = np.eye(len(draw))[mine]
            with np.errstate(all="ignore"):
                still = np.broadcast_to(observe(*states, *draw[: len(law.parameters)]), seen.shape)
                slopes = [observe(*states, *(draw + unit)[: len(law.parameters)]) - still for unit in units]
            matrix = np.reshape(
                np.nan_to_num([np.broadcast_to(item, seen.shape) for item in slopes]), (-1, len(seen))
            )
            values = np.linalg.lstsq(matrix.T, np.nan_to_num(seen - still), rcond=_TINY)[0]
            positive = [law.parameters[k] in law.positive for k in mine]
            draw[mine] = np.where(positive, np.maximum(np.abs(values), _TINY), values)


def parameters_linear_in(expression: Any, law: Law, others: Collection[str]) -> list[str]:
    """Parameters in which an expression is linear together, without some others."""
    import sympy

    chosen: list[sympy.Symbol] = []
    for name in law.parameters:
        symbol = sympy.Symbol(name)
        if name not in others and not expression.diff(symbol).has(symbol, *chosen):
            chosen.append(symbol)
    return [symbol.name for symbol in chosen]


def drive_frequencies(law: Law) -> tuple[str, ...]:
    """Parameters that are angular frequencies of a drive: factors of the time in a sine or cosine."""
    import sympy

    parsed, time = law.parsed_equation, sympy.Symbol(TIME)
    waves = [wave for rate in parsed.rates for wave in rate.atoms(sympy.sin, sympy.cos)]
    slopes = {str(wave.args[0].diff(time)) for wave in waves}
    return tuple(name for name in law.parameters if name in slopes)


def _draw_wave_frequencies(
    law: Law, values: Float[np.ndarray, "d"], record: PistonRecord, random: np.random.Generator
) -> None:
    """Set frequencies to lines of the record's spectrum; where waves multiply states, also to distances."""
    # A drive is a line of its own; a wave that multiplies the coordinate parts its lines by its frequency.
    peaks = spectral_peaks(record.time, record.height)
    lines = random.choice(peaks, len(values))
    if not _waves_multiply_states(law):
        values[:] = lines
        return
    apart = np.abs(lines - random.choice(peaks, len(values)))
    turn = random.permutation(len(values)) % 3
    values[turn == 0] = lines[turn == 0]
    chosen = (turn == 1) & (apart > 0.0)
    values[chosen] = apart[chosen]


def _waves_multiply_states(law: Law) -> bool:
    import sympy

    time = sympy.Symbol(TIME)
    return any(
        rate.diff(symbol).has(time)
        for rate in law.parsed_equation.rates
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
    """Parameters (p,) of a law without hidden states from accelerations in a record alone."""
    units = np.where(np.abs(values) > 0.0, values, 1.0)
    draws = _random_draws(law, guess, np.random.default_rng(0), _OTHER_DRAWS, bounds)
    return np.asarray(_fit_draws_to_accelerations(law, guess, record, np.vstack([units, draws]), bounds)[0])


def start_values_near(values: dict[str, float]) -> Starts:
    """Start values of a law about parameters that are known roughly."""

    def start(_: FirstGuesses, random: np.random.Generator, count: int) -> dict[str, np.ndarray]:
        return {name: value * np.exp(_NEAR * random.normal(size=count)) for name, value in values.items()}

    return start


def _random_draws(
    law: Law, guess: FirstGuesses, random: np.random.Generator, count: int, bounds: Pairs | None = None
) -> np.ndarray:
    """Values (count, p) in powers of the record's own time and lengths."""
    shape = (count, len(law.parameters))
    guess = _guess_in_coordinate(law, guess)
    level = max(abs(guess.rest), 1e-3 * guess.amplitude)
    length = np.where(random.uniform(size=shape) < 0.7, guess.amplitude, level)
    size = guess.frequency ** random.integers(0, 3, shape) * length ** random.integers(-2, 2, shape)
    draws = size * np.exp(random.uniform(-1.5, 1.5, shape))
    positive = np.array([name in law.positive for name in law.parameters])
    draws = np.where(positive | (random.uniform(size=shape) < 0.7), draws, -draws)
    values = canonical_parameters(law, dict(zip(law.parameters, draws.T, strict=True)), bounds=bounds)
    values |= {name: np.full(count, value) for name, value in _fixed_by_bounds(bounds).items()}
    return np.stack([values[name] for name in law.parameters], axis=1)


def _guess_in_coordinate(law: Law, guess: FirstGuesses) -> FirstGuesses:
    """Level and size of the motion in the coordinate of the law's text, where that gives them as numbers."""
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
    """Draws after a fit of the accelerations, the best one first, the poor ones left out."""
    from scipy.optimize import least_squares

    motion = fit_local_cubics(record.time, record.height, guess.period, _NODES)
    # Of a long record with few samples a swing it is all of them.
    z, v, a, nodes = motion[:, :: math.ceil(motion.shape[1] / _MOST_NODES)]
    drive = interpolate_inputs(record.time, [input_column(record, name) for name in law.inputs], nodes)
    field = compile_rates(law.equation, law.inputs, "numpy")
    scale = max(float(np.abs(a).max()), 1e-300)
    logarithmic = np.array([name in law.positive for name in law.parameters])

    held = _fixed_by_bounds(bounds)
    free = np.array([name not in held for name in law.parameters])

    def moved(x: np.ndarray, unit: np.ndarray) -> np.ndarray:
        full = np.zeros(len(free))
        full[free] = x
        return unit * np.where(logarithmic, np.exp(np.clip(full, -50.0, 50.0)), 1.0 + full)

    def residuals(x: np.ndarray, unit: np.ndarray) -> np.ndarray:
        values = moved(x, unit)
        with np.errstate(all="ignore"):
            result = (field(z, v, *drive.T, *values)[0] - a) / scale
        return np.broadcast_to(np.nan_to_num(np.clip(result, -1e6, 1e6), nan=1e6), a.shape)

    results = []
    for unit in draws:
        solution = least_squares(
            residuals,
            np.zeros(free.sum()),
            args=(unit,),
            x_scale="jac",
            max_nfev=_STEPS * (1 + int(free.sum())),
            method="lm",
        )
        results.append((float(solution.cost), moved(solution.x, unit)))
    results.sort(key=lambda pair: pair[0])
    good = np.array([values for cost, values in results if cost <= _GOOD * results[0][0] + 1e-12])
    # Draws that mean the same end at either sign and turns apart: which of them rounding puts first
    # must not tell where a search starts, nor bounds cut off the sign that it starts from.
    home = canonical_parameters(law, dict(zip(law.parameters, good.T, strict=True)), bounds=bounds)
    return np.stack([home[name] for name in law.parameters], axis=1)


def _fixed_by_bounds(bounds: Pairs | None) -> dict[str, float]:
    """Parameters that bounds leave one value."""
    return {name: low for name, (low, high) in (bounds or {}).items() if low == high}


def _hidden_starts(
    law: Law,
    guess: FirstGuesses,
    record: PistonRecord,
    draw: Callable[[int], np.ndarray],
    fixed: Collection[str],
) -> np.ndarray:
    """Parameters and starts of further coordinates (k, p), the best first, from draws of parameters."""
    end = min(float(record.time[-1]), _SWINGS * guess.period)
    # A further coordinate has a faster motion: wide windows would smooth it, and long steps of Heun's method
    # add energy to it.
    period = guess.period / (_FASTER if law.other_coordinates else 1.0)
    nodes = np.linspace(0.0, end, max(48, round(_NODES_PER_CYCLE * end / period)))
    motion = fit_local_cubics(record.time, record.height, period, nodes)
    acceleration, times = motion[2:]
    drive = interpolate_inputs(record.time, [input_column(record, name) for name in law.inputs], times)
    carried, count = acceleration_function(law, motion, drive), len(law.parameters)
    others = [law.hidden.index(name) for name in law.other_coordinates]
    columns = []
    for name in law.observations if others else ():
        if name != "height":
            seen = interpolate_inputs(record.time, [input_column(record, name)], times)[:, 0]
            columns.append((name, seen, max(float(np.abs(seen - seen.mean()).max()), 1e-300)))
    scale = max(float(np.abs(acceleration).max()), 1e-300)
    target = acceleration[:, None]

    def misfits(values: np.ndarray) -> np.ndarray:
        """Differences (n, m) for parameters (m, p), in units of the greatest acceleration."""
        start = np.zeros((len(law.hidden), len(values)))
        start[others] = values[:, count:].T
        accelerations, path = carried(values[:, :count].T, start)
        result = (accelerations - target) / scale
        for name, seen, size in columns:
            observe = compile_observation(law.equation, law.inputs, name, "numpy")
            states = (*motion[:2, :, None], *path.swapaxes(0, 1), *drive.T[:, :, None])
            with np.errstate(all="ignore"):
                left = (observe(*states, *values[:, :count].T) - seen[:, None]) / size
            result = np.vstack([result, np.broadcast_to(left, accelerations.shape)])
        return np.nan_to_num(np.clip(result, -_FAR, _FAR), nan=_FAR)

    scales = np.array([guess.amplitude, guess.amplitude * guess.frequency] * (len(others) // 2))

    def with_fitted_states(parameters: np.ndarray) -> np.ndarray:
        """Draws with the starts of further coordinates by least squares, which a linear law is linear in."""
        values = np.hstack([parameters, np.zeros((len(parameters), len(others)))])
        if not others:
            return values
        left = misfits(values)
        slopes = []
        for k, size in enumerate(scales):
            values[:, count + k] = size
            slopes.append(misfits(values) - left)
            values[:, count + k] = 0.0
        normal = np.einsum("anm,bnm->mab", slopes, slopes)
        size = 1.0 + np.trace(normal, axis1=1, axis2=2)
        normal += _TINY * np.eye(len(scales)) * size[:, None, None]
        steps = np.linalg.solve(normal, -np.einsum("anm,nm->ma", slopes, left)[..., None])[..., 0]
        values[:, count:] = np.where(np.abs(steps) < _FAR, steps, 1.0) * scales
        return values

    best = np.empty((0, count + len(others)))
    for _ in range(_ROUNDS):
        drawn = np.vstack([best, with_fitted_states(draw(_HIDDEN_DRAWS))])
        order = np.argsort((misfits(drawn) ** 2).sum(axis=0))
        best = drawn[order[:_RETAINED]]
    held = np.isin((*law.parameters, *law.other_coordinates), list(fixed))
    output, cost = levenberg_marquardt(
        _acceleration_normal_equations(best, misfits),
        np.zeros_like(best),
        Prior(np.full(best.shape[1], 0.01), float(len(nodes) * (1 + len(columns)))),
        1e-4,
        Bounds(np.where(held, 0.0, -np.inf), np.where(held, 0.0, np.inf)),
        trials=_TRIALS,
    )
    values = best * np.exp(np.clip(output, -50.0, 50.0))
    order = np.argsort(cost)
    good = order[cost[order] <= _GOOD * cost[order[0]] + 1e-12]
    return np.asarray(values[good])


def acceleration_function(
    law: Law, motion: Float[np.ndarray, "4 n"], drive: Float[np.ndarray, "n inputs"]
) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Return a function of parameters: accelerations along rows z, z', z'', time [s], and hidden states."""
    # Of parameters (p, m) and hidden states (h, m), at zero if not given, to accelerations (n, m) and hidden
    # states (n, h, m). Heun's method along a motion that is known, at its nodes alone.
    field = compile_rates(law.equation, law.inputs, "numpy")
    z, v, _, time = motion

    def carried(values: np.ndarray, start: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
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
                    ahead = np.clip(hidden + step * slope, -_FAR, _FAR)
                    late = np.array(rates(k + 1, ahead)[1:])
                    moved = hidden + 0.5 * step * (slope + late)
                    hidden = np.nan_to_num(np.clip(moved, -_FAR, _FAR))
        return result, path

    return carried


def _acceleration_normal_equations(units: np.ndarray, misfits: Callable[[np.ndarray], np.ndarray]) -> Normal:
    """Return the normal equations of logarithms (m, p) of factors of the units, by differences."""

    def normal(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count, size = theta.shape
        moved = np.repeat(theta[None], size + 1, axis=0)
        moved[np.arange(1, size + 1), :, np.arange(size)] += _STEP
        values = units * np.exp(np.clip(moved, -50.0, 50.0))
        left = misfits(values.reshape(-1, size)).reshape(-1, size + 1, count)
        slopes = (left[:, 1:] - left[:, :1]) / _STEP
        here = left[:, 0]
        return (
            (here**2).sum(axis=0),
            np.einsum("nps,ns->sp", slopes, here),
            np.einsum("nps,nqs->spq", slopes, slopes),
        )

    return normal


def scale_unknowns(data: FitData) -> Unknowns:
    """Unknowns of a law, whose parameters are scaled by what a glance at a record tells."""
    law, guess = data.unknowns.law, data.guess
    if law.prescribed:  # whose draws tell the units
        return data.unknowns
    # A rest level near zero says nothing of a parameter's size: the amplitude counts too.
    away = dataclasses.replace(
        guess, rest=abs(guess.rest) + guess.amplitude, crossings=max(guess.crossings, LEAST_CROSSINGS)
    )
    typical = start_values(law, away, data.look, np.random.default_rng(0), _TYPICAL)
    units = tuple(
        1.0 if name in law.positive else float(np.abs(typical[name]).mean()) or 1.0 for name in law.parameters
    )
    return dataclasses.replace(data.unknowns, units=units)


def start_vectors(
    data: FitData, count: int, random: np.random.Generator, near: Mapping[str, float]
) -> Float[np.ndarray, "count p"]:
    """Start vectors (count, p) of a search, from a record and its first guesses."""
    unknowns = data.unknowns
    draws = start_values(unknowns.law, data.guess, data.look, random, count, data.bounds)
    for name, value in near.items():
        spread = _NEAR * random.normal(size=count) * (np.arange(count) > 0)
        positive = name in unknowns.law.positive or value != 0.0
        unit = unknowns.units[unknowns.law.parameters.index(name)]
        draws[name] = value * np.exp(spread) if positive else spread * unit
    return append_initial_state(data, search_entries_from_draws(unknowns, draws), draws)


def append_initial_state(
    data: FitData, free: Float[np.ndarray, "count k"], states: Mapping[str, np.ndarray] | None = None
) -> Float[np.ndarray, "count p"]:
    """Parameters (count, k) with the initial state of record and sensor behind them."""
    count, guess, unknowns = len(free), data.guess, data.unknowns
    height = np.full(count, (guess.height - unknowns.rest) / unknowns.amplitude)
    velocity = np.full(count, guess.velocity / unknowns.speed)
    sensor = np.tile(_sensor_start(unknowns, data.record.height[: data.training]), (count, 1))
    still = np.zeros(count)
    hidden = np.reshape([(states or {}).get(name, still) for name in unknowns.law.hidden], (-1, count)).T
    return np.column_stack([free, height, velocity, hidden, sensor])


def _sensor_start(unknowns: Unknowns, signal: np.ndarray) -> list[float]:
    """Entries of a sensor: the nominal gain, the signal's mean, and a filter that has settled."""
    sensor = unknowns.sensor
    if sensor is None:
        return []
    gain_is_open, offset_is_open = unknowns.open_gain_and_offset
    mean = float(signal.mean()) if sensor.offset == "free" else sensor.nominal_offset
    first = float(signal[0] - mean) / unknowns.signal * sensor.derivative_sign
    states = [first if sensor.low_pass is not None else 0.0, 0.0][: sensor.filter_order]
    offset = (mean - sensor.nominal_offset) / unknowns.signal
    return [1.0] * gain_is_open + [offset] * offset_is_open + states


def search_entries_from_draws(
    unknowns: Unknowns, draws: Mapping[str, np.ndarray]
) -> Float[np.ndarray, "count k"]:
    """Entries (count, k) of search vectors, without initial states, of parameters."""
    # A law that may be below zero draws either sign, also where limits keep it above.
    result = [
        np.log(np.abs(draws[name])) if name in unknowns.law.positive else draws[name] / unit
        for name, unit in zip(unknowns.law.parameters, unknowns.units, strict=True)
    ]
    return np.stack(result, axis=1)
