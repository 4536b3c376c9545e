"""From a solution to a model: what was found, how good it is, and what is to be doubted."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from reduced_models.estimates import noise_level
from reduced_models.model import HeightMap, Quality, ReducedModel
from reduced_models.refinement import Solution
from reduced_models.search import BLOWN_UP
from reduced_models.uncertainty import interval_analysis

FEW = 0.25
"""Share of the starts that must lead to the best fit before it is taken without a note."""
NOISE_TIMES, NOTABLE = 3.0, 0.05
"""A residual above so many noise levels, and above this share of the swing, is noted."""


class Training(NamedTuple):
    """What a model was trained on, and how the search went.

    Attributes
    ----------
    samples : int
        Of the training stretch.
    stop : float
        End of that stretch, since the record's start [s].
    starts, converged : int
        Random starts, and how many of them led to the best fit.
    """

    samples: int
    stop: float
    starts: int
    converged: int


def model_of(solution: Solution, training: Training, confidence: float) -> ReducedModel:
    """The reduced model of a solution, with intervals, quality and notes."""
    grid, theta = solution.grid, solution.theta
    problem, record = grid.problem, grid.record
    values, shift, scale, z0, v0 = problem.physical(theta)
    height_map = HeightMap(float(shift), float(scale), fitted=problem.map is None)
    residuals = grid.residuals(theta)
    analysis = interval_analysis(problem, theta, grid.normal_matrix(theta), residuals, confidence)
    quality = _quality(solution, training)
    speeds = np.gradient(record.height, record.time)
    return ReducedModel(
        law=problem.law,
        parameters=dict(zip(problem.law.parameters, map(float, values), strict=True)),
        intervals=analysis.intervals,
        confidence=confidence,
        map=height_map,
        initial=(float(height_map.to_height(z0)), float(v0 * scale)),
        at_rest=analysis.at_rest,
        quality=quality,
        undetermined=analysis.undetermined,
        domain={
            "height": (float(record.height.min()), float(record.height.max())),
            "velocity": (float(speeds.min()), float(speeds.max())),
        },
        notes=_notes(quality),
    )


def _quality(solution: Solution, training: Training) -> Quality:
    record = solution.grid.record
    swing = float(record.height.std())
    residual = _rms(solution.grid.residuals(solution.theta)) * solution.grid.problem.amplitude
    held_out = len(record) - training.samples >= 2
    error, resting = _holdout_errors(solution, training.samples) if held_out else (None, None)
    return Quality(
        residual=residual,
        relative=residual / swing,
        holdout=error,
        holdout_from=training.stop if held_out else None,
        starts=training.starts,
        converged=training.converged,
        samples=len(record),
        solver_error=solution.solver_error,
        holdout_at_rest=resting,
        noise=noise_level(record.height),
    )


def _holdout_errors(solution: Solution, training: int) -> tuple[float, float]:
    """Errors over the held-out stretch, of the roll-out and of a piston that stays at rest.

    Neither has seen that stretch; both count in the rms swing of the record.
    """
    grid = solution.grid
    swing, rest = float(grid.record.height.std()), grid.problem.rest
    residuals = grid.residuals(solution.trained)[training:]
    resting = _rms(grid.record.height[training:] - rest) / swing
    if (np.abs(residuals) >= BLOWN_UP).any():
        return math.inf, resting
    return _rms(residuals) * grid.problem.amplitude / swing, resting


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def _notes(quality: Quality) -> tuple[str, ...]:
    notes = []
    if quality.converged < FEW * quality.starts:
        notes.append(
            f"only {quality.converged} of {quality.starts} random starts led to this fit, so there "
            "may be a better one; try more starts"
        )
    if quality.residual > NOISE_TIMES * quality.noise and quality.relative > NOTABLE:
        ratio = quality.residual / quality.noise if quality.noise > 0.0 else math.inf
        notes.append(
            f"the residual is {100 * quality.relative:.2g} % of the swing and {ratio:.2g} times "
            "the record's noise, so the law or "
            "the fit is not right; try another law or more starts"
        )
    if quality.holdout == math.inf:
        notes.append(
            "fitted to its training stretch only, the law blows up in the held-out stretch"
        )
    return tuple(notes)
