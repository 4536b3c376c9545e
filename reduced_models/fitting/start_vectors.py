"""The unknowns of a fit, and random start vectors of their search."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from granular.shared.errors import InputError
from reduced_models.fitting.problem import Pairs, TrainingData
from reduced_models.fitting.start_values import start_values
from reduced_models.laws.height_map import HeightMap
from reduced_models.laws.law import Law, SwingForm
from reduced_models.least_squares.unknowns import Unknowns
from reduced_models.records.first_guesses import LEAST_CROSSINGS, FirstGuesses

_NEAR = 0.1  # spread of the logarithm of start values that are given


def unknowns_of(law: Law, height_map: HeightMap | None, data: TrainingData) -> Unknowns:
    """Unknowns of a law, scaled by what a glance at a record tells; no map is a fitted one."""
    guess = data.guess
    given = height_map or HeightMap(guess.rest, guess.amplitude)
    seen = guess.seen_as(given.shift, given.scale)
    # A rest level near zero says nothing of a parameter's size: the amplitude counts too.
    away = dataclasses.replace(
        seen, rest=abs(seen.rest) + seen.amplitude, crossings=max(seen.crossings, LEAST_CROSSINGS)
    )
    seen_record = data.look.mapped(given.shift, given.scale)
    typical = start_values(law, away, seen_record, np.random.default_rng(0), 1)
    units = tuple(
        1.0 if name in law.positive else abs(float(typical[name][0])) or 1.0
        for name in law.parameters
    )
    speed = guess.amplitude * guess.frequency
    return Unknowns(law, height_map, units, guess.rest, guess.amplitude, speed)


def start_vectors(
    unknowns: Unknowns,
    data: TrainingData,
    count: int,
    random: np.random.Generator,
    near: Mapping[str, float] | None = None,
    bounds: Pairs | None = None,
) -> np.ndarray:
    """Start vectors (count, p) of a search, from a record and its first guesses.

    Parameters in ``near`` are looked for about the values there, the first time at them; those with
    equal ``bounds`` are known.
    """
    if unknowns.map is not None:
        shift, scale = unknowns.map.shift, unknowns.map.scale
        seen = data.guess.seen_as(shift, scale)
        mapped = data.look.mapped(shift, scale)
        draws = start_values(unknowns.law, seen, mapped, random, count, bounds)
    else:
        draws = _mapped_draws(unknowns, data.guess, count, random)
    for name, value in (near or {}).items():
        spread = _NEAR * random.normal(size=count) * (np.arange(count) > 0)
        positive = name in unknowns.law.positive or value != 0.0
        unit = unknowns.units[unknowns.law.parameters.index(name)]
        draws[name] = value * np.exp(spread) if positive else spread * unit
    return with_initial_state(unknowns, data.guess, free_entries(unknowns, draws))


def with_initial_state(unknowns: Unknowns, guess: FirstGuesses, free: np.ndarray) -> np.ndarray:
    """Parameters and map (count, k) with the initial state of a record behind them."""
    count = len(free)
    height = np.full(count, (guess.height - unknowns.rest) / unknowns.amplitude)
    velocity = np.full(count, guess.velocity / unknowns.speed)
    return np.column_stack([free, height, velocity, np.zeros((count, len(unknowns.law.hidden)))])


def free_entries(unknowns: Unknowns, draws: Mapping[str, np.ndarray]) -> np.ndarray:
    """Entries (count, k) of search vectors, initial states left out, of parameters and map."""
    found = [
        np.log(draws[name]) if name in unknowns.law.positive else draws[name] / unit
        for name, unit in zip(unknowns.law.parameters, unknowns.units, strict=True)
    ]
    if unknowns.map is None:
        found += [draws["shift"], np.log(draws["scale"])]
    return np.stack(found, axis=1)


def swing_draws(
    form: SwingForm, data: TrainingData, count: int, random: np.random.Generator
) -> dict[str, np.ndarray] | None:
    """Random parameters (count,) of a swing form; None where it does not hold for the record."""
    guess = data.guess
    swing = (data.look.height - guess.rest) / guess.amplitude
    seen = guess.seen_as(guess.rest, guess.amplitude)
    return form.start(data.look.time, swing, seen, random, count)


def swing_unknowns(
    unknowns: Unknowns, form: SwingForm, draws: Mapping[str, np.ndarray]
) -> Unknowns:
    """The unknowns of a swing form, in units that some draws tell."""
    units = tuple(
        1.0 if name in form.law.positive else float(np.abs(draws[name]).mean()) or 1.0
        for name in form.law.parameters
    )
    swing = HeightMap(unknowns.rest, unknowns.amplitude)
    return dataclasses.replace(unknowns, law=form.law, map=swing, units=units)


def _mapped_draws(
    unknowns: Unknowns, guess: FirstGuesses, count: int, random: np.random.Generator
) -> dict[str, np.ndarray]:
    """Parameters with a shift (from the rest level) and a scale, both in amplitudes."""
    seen = guess.seen_as(guess.rest, guess.amplitude)
    start = unknowns.law.start
    if start is None:
        raise InputError(
            f"the law {unknowns.law.name!r} has a map and does not say where to start a fit; give "
            "it a start function, or the map"
        )
    scale = np.exp(random.uniform(-1.5, 1.5, count))
    shift = -scale * random.uniform(-2.0, 4.0, count)
    each = [start(seen.seen_as(shift[k], scale[k]), random, 1) for k in range(count)]
    draws = {
        name: np.array([float(draw[name][0]) for draw in each]) for name in unknowns.law.parameters
    }
    return draws | {"shift": shift, "scale": scale}
