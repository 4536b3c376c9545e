"""Draw start values over wide ranges, and keep draws whose solutions follow the start of a record.

If a law is wrong for a record, all fits to accelerations may end in one minimum, although the solution
fits better with other parameters. For a law given by its equation alone, the solutions of random draws
over a few cycles are therefore also compared with the record.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from reduced_models.fitting.natural_sizes import natural_sizes
from reduced_models.fitting.residuals import rms
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import FirstGuesses
from reduced_models.records.inputs import TIME, input_column, interpolate_inputs

_DRAW_COUNT = 2048
_LOW, _HIGH = -4.0, 1.5  # logarithm of the ratio of a drawn value to its natural size
_POSITIVE = 0.7  # fraction of positive draws of a parameter that may have either sign
_CYCLES, _STEPS_PER_CYCLE = 3.0, 32  # of the solutions that are compared
_MAXIMUM_STEPS = 1024
_LARGEST_STATE = 1e6  # in amplitudes


def draws_with_closest_solutions(
    law: Law,
    guess: FirstGuesses,
    record: PistonRecord,
    random: np.random.Generator,
    count: int,
    canonical_draws: Callable[[np.ndarray], np.ndarray],
) -> Float[np.ndarray, "count p"]:
    """Return the draws whose solutions are nearest to the record, best first.

    ``canonical_draws`` brings draws (n, p) to their canonical form, with fixed parameters at their values.
    """
    draws = _draw_about_natural_sizes(law, guess, record, random)
    _move_equilibria_to_levels(
        law, draws, guess.rest + guess.amplitude * random.uniform(-1.0, 1.0, _DRAW_COUNT)
    )
    draws = canonical_draws(draws)
    order = np.argsort(_solution_misfits(law, guess, record, draws), kind="stable")
    return draws[order[:count]]


def _draw_about_natural_sizes(
    law: Law, guess: FirstGuesses, record: PistonRecord, random: np.random.Generator
) -> np.ndarray:
    signals = {name: rms(input_column(record, name)) or 1.0 for name in law.inputs if name != TIME}
    speed = guess.amplitude * guess.frequency
    sizes = natural_sizes(law.parsed_equation, guess.amplitude, speed, signals)
    shape = (_DRAW_COUNT, len(law.parameters))
    draws = np.exp(random.uniform(_LOW, _HIGH, shape)) * [sizes[name] for name in law.parameters]
    positive = np.array([name in law.positive for name in law.parameters])
    return np.where(positive | (random.uniform(size=shape) < _POSITIVE), draws, -draws)


def _move_equilibria_to_levels(law: Law, draws: np.ndarray, levels: Float[np.ndarray, "n"]) -> None:
    """Shift the coordinate's origin, or else a constant force, to give draws the equilibria ``levels``."""
    import sympy

    parsed, inputs = law.parsed_equation, len(law.inputs)
    acceleration = parsed.acceleration
    states = {parsed.symbol_z, parsed.symbol_v, *map(sympy.Symbol, (TIME, *law.inputs))}
    slopes = {name: acceleration.diff(sympy.Symbol(name)) for name in law.parameters}
    for k, name in enumerate(law.parameters):
        if name in parsed.height_parameters:
            draws[:, k] = levels
            return
    field = compile_rates(law.equation, law.inputs, "numpy")
    still = np.zeros_like(levels)
    for k, name in enumerate(law.parameters):
        if slopes[name] != 0 and not slopes[name].free_symbols & states and name not in law.positive:
            with np.errstate(all="ignore"):
                draws[:, k] = 0.0
                first = field(levels, still, *[still] * inputs, *draws.T)[0]
                draws[:, k] = 1.0
                second = field(levels, still, *[still] * inputs, *draws.T)[0]
                draws[:, k] = np.nan_to_num(-first / (second - first), posinf=0.0, neginf=0.0)
            return


def _solution_misfits(
    law: Law, guess: FirstGuesses, record: PistonRecord, draws: Float[np.ndarray, "n p"]
) -> Float[np.ndarray, "n"]:
    """Return sums (n,) of squared deviations from the record's first cycles, in squared amplitudes."""
    duration = min(float(record.time[-1]), _CYCLES * guess.period)
    steps = min(_MAXIMUM_STEPS, math.ceil(law.step_ratio * _STEPS_PER_CYCLE * duration / guess.period))
    times = np.linspace(0.0, duration, 2 * steps + 1)
    inputs = [input_column(record, name) for name in law.inputs]
    drive = interpolate_inputs(record.time, inputs, times)
    seen = np.interp(times[::2], record.time, record.height)
    field = compile_rates(law.equation, law.inputs, "numpy")
    limit = _LARGEST_STATE * guess.amplitude

    def rates(node: int, states: np.ndarray) -> np.ndarray:
        acceleration = field(*states, *drive[node], *draws.T)[0]
        return np.stack([states[1], np.broadcast_to(acceleration, len(draws))])

    states = np.empty((2, len(draws)))
    states[0], states[1] = guess.height, guess.velocity
    step, misfit = times[-1] / steps, np.zeros(len(draws))
    with np.errstate(all="ignore"):
        for k in range(steps):  # classical Runge-Kutta method
            first = rates(2 * k, states)
            second = rates(2 * k + 1, states + 0.5 * step * first)
            third = rates(2 * k + 1, states + 0.5 * step * second)
            last = rates(2 * k + 2, states + step * third)
            states = states + step / 6.0 * (first + 2.0 * second + 2.0 * third + last)
            states = np.nan_to_num(np.clip(states, -limit, limit), nan=limit)
            misfit += ((states[0] - seen[k + 1]) / guess.amplitude) ** 2
    return misfit
