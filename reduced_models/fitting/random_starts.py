"""Random start vectors of a search."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from reduced_models.fitting.start_values import drawn
from reduced_models.fitting.unknowns import Problem
from reduced_models.laws.law import SwingForm
from reduced_models.models.model import HeightMap
from reduced_models.records.first_guesses import Estimates


def start_vectors(
    problem: Problem,
    guess: Estimates,
    record: PistonRecord,
    count: int,
    random: np.random.Generator,
) -> np.ndarray:
    """Start vectors (count, p) of a search, from a record and its first guesses."""
    if problem.map is not None:
        shift, scale = problem.map.shift, problem.map.scale
        seen = guess.seen_as(shift, scale)
        draws = drawn(problem.law, seen, record.mapped(shift, scale), random, count)
    else:
        draws = _mapped_draws(problem, guess, count, random)
    return started(problem, guess, free_entries(problem, draws))


def started(problem: Problem, guess: Estimates, free: np.ndarray) -> np.ndarray:
    """Parameters and map (count, k) with the initial state of a record behind them."""
    count = len(free)
    height = np.full(count, (guess.height - problem.rest) / problem.amplitude)
    velocity = np.full(count, guess.velocity / problem.speed)
    return np.column_stack([free, height, velocity])


def free_entries(problem: Problem, draws: Mapping[str, np.ndarray]) -> np.ndarray:
    """Entries (count, k) of search vectors, initial states left out, of parameters and map."""
    found = [
        np.log(draws[name]) if name in problem.law.positive else draws[name] / unit
        for name, unit in zip(problem.law.parameters, problem.units, strict=True)
    ]
    if problem.map is None:
        found += [draws["shift"], np.log(draws["scale"])]
    return np.stack(found, axis=1)


def swing_draws(
    form: SwingForm,
    guess: Estimates,
    record: PistonRecord,
    count: int,
    random: np.random.Generator,
) -> dict[str, np.ndarray] | None:
    """Random parameters (count,) of a swing form; None where it does not hold for the record."""
    swing = (record.height - guess.rest) / guess.amplitude
    seen = guess.seen_as(guess.rest, guess.amplitude)
    return form.start(record.time, swing, seen, random, count)


def swing_problem(problem: Problem, form: SwingForm, draws: Mapping[str, np.ndarray]) -> Problem:
    """The problem of a swing form, in units that some draws tell."""
    units = tuple(
        1.0 if name in form.law.positive else float(np.abs(draws[name]).mean()) or 1.0
        for name in form.law.parameters
    )
    swing = HeightMap(problem.rest, problem.amplitude)
    return dataclasses.replace(problem, law=form.law, map=swing, units=units)


def _mapped_draws(
    problem: Problem, guess: Estimates, count: int, random: np.random.Generator
) -> dict[str, np.ndarray]:
    """Parameters with a shift (from the rest level) and a scale, both in amplitudes."""
    seen = guess.seen_as(guess.rest, guess.amplitude)
    start = problem.law.start
    if start is None:
        raise InputError(
            f"the law {problem.law.name!r} has a map and does not say where to start a fit; give "
            "it a start function, or the map"
        )
    scale = np.exp(random.uniform(-1.5, 1.5, count))
    shift = -scale * random.uniform(-2.0, 4.0, count)
    each = [start(seen.seen_as(shift[k], scale[k]), random, 1) for k in range(count)]
    draws = {
        name: np.array([float(draw[name][0]) for draw in each]) for name in problem.law.parameters
    }
    return draws | {"shift": shift, "scale": scale}
