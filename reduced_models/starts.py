"""Random start vectors of a search."""

from __future__ import annotations

import numpy as np

from granular.errors import InputError
from granular.record import PistonRecord
from reduced_models.estimates import Estimates
from reduced_models.matching import drawn
from reduced_models.problem import Problem


def start_vectors(
    problem: Problem,
    guess: Estimates,
    record: PistonRecord,
    count: int,
    random: np.random.Generator,
) -> np.ndarray:
    """Start vectors (count, p) of a search, from a record and its first guesses."""
    law = problem.law
    if problem.map is not None:
        shift, scale = problem.map.shift, problem.map.scale
        seen = guess.seen_as(shift, scale)
        draws = drawn(law, seen, record.mapped(shift, scale), random, count)
        mapping: list[np.ndarray] = []
    else:
        draws = _mapped_draws(problem, guess, record, count, random)
        mapping = [draws["shift"], np.log(draws["scale"])]
    parameters = [
        np.log(draws[name]) if name in law.positive else draws[name] / unit
        for name, unit in zip(law.parameters, problem.units, strict=True)
    ]
    height = np.full(count, (guess.height - guess.rest) / guess.amplitude)
    velocity = np.full(count, guess.velocity / problem.speed)
    return np.stack([*parameters, *mapping, height, velocity], axis=1)


def _mapped_draws(
    problem: Problem,
    guess: Estimates,
    record: PistonRecord,
    count: int,
    random: np.random.Generator,
) -> dict[str, np.ndarray]:
    """Parameters with a shift (from the rest level) and a scale, both in amplitudes."""
    seen = guess.seen_as(guess.rest, guess.amplitude)
    if problem.law.mapped_start is not None:
        swing = (record.height - guess.rest) / guess.amplitude
        found = problem.law.mapped_start(record.time, swing, seen, random, count)
        if found is not None:
            return found
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
