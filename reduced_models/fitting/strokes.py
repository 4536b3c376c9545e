"""Start vectors of a fit along a prescribed stroke, which solves for no motion.

Most parameters stand in a force as factors; for random draws of the others these follow from linear
least squares. The best draws start the search.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.residuals import residual_function
from reduced_models.fitting.start_values import parameters_linear_in
from reduced_models.fitting.unknowns import Unknowns

if TYPE_CHECKING:
    from jaxtyping import Float

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
