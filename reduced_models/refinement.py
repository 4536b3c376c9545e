"""The end of a fit: all samples, a fine grid, and diffrax as the judge of its solution."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from granular.errors import InputError
from granular.record import PistonRecord
from reduced_models.problem import Problem, compiled_physical
from reduced_models.rollout import Motion, finer_grid, motion
from reduced_models.search import (
    BLOWN_UP,
    Equations,
    Prior,
    Samples,
    equations,
    samples_on_grid,
    search,
)

SOLVER_LIMIT, SOLVER_SHARE = 1e-6, 0.05
"""Greatest error of the fitted solution, in amplitudes and in standard deviations of the residual;
the larger of the two counts."""


@dataclasses.dataclass(frozen=True, eq=False)
class Grid:
    """A record on a grid, with the compiled equations of a problem.

    Attributes
    ----------
    problem : Problem
    record : PistonRecord
        That starts at time 0.
    steps : int
    equations : Equations
    samples : Samples
    """

    problem: Problem
    record: PistonRecord
    steps: int
    equations: Equations
    samples: Samples

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        """Residuals (n,) of all samples, in amplitudes."""
        found = self.equations.residual(theta, self.samples, self.problem.scales)
        return np.asarray(found)[: len(self.record)]

    def normal_matrix(self, theta: np.ndarray) -> np.ndarray:
        """J'J (p, p) of all samples."""
        found = self.equations.normal(theta[None], self.samples, self.problem.scales)
        return np.asarray(found[2])[0]

    def sharpened(self, theta: np.ndarray, count: int) -> np.ndarray:
        """The search vector that fits the first ``count`` samples best, from one near it."""
        weight = np.zeros_like(self.samples.weight)
        weight[:count] = 1.0
        normal = self.equations.of(self.samples._replace(weight=weight), self.problem.scales)
        prior = Prior(self.problem.prior, float(count))
        return np.asarray(search(normal, theta[None], prior, tolerance=1e-11)[0][0])


def problem_equations(problem: Problem, steps: int) -> Equations:
    """The compiled equations of a problem on a grid of that many steps."""
    reads = compiled_physical(problem.logarithmic, problem.map is None)
    return equations(problem.law.equation, reads, steps)


def grid_of(problem: Problem, record: PistonRecord, steps: int) -> Grid:
    """All of a record that starts at time 0, on a grid."""
    samples = samples_on_grid(record.time, record.height, steps)
    return Grid(problem, record, steps, problem_equations(problem, steps), samples)


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """A fit whose solution was judged.

    Attributes
    ----------
    grid : Grid
    trained, theta : float64 (p,)
        Search vectors that fit the training stretch, and all of the record.
    solver_error : float
        Greatest difference to the adaptive solution, in amplitudes.
    """

    grid: Grid
    trained: np.ndarray
    theta: np.ndarray
    solver_error: float


def solution(grid: Grid, trained: np.ndarray, training: int) -> Solution:
    """Fit all of a record, from a vector that fits its training stretch of so many samples.

    The grid is refined until its solution agrees with the adaptive one.

    Raises
    ------
    InputError
        If the solution does not stay finite or cannot be followed, even on the finest grid.
    """
    name = grid.problem.law.name
    while True:
        whole = training == len(grid.record)
        theta = trained if whole else grid.sharpened(trained, len(grid.record))
        residuals = grid.residuals(theta)
        if (np.abs(residuals) >= BLOWN_UP).any():
            raise InputError(
                f"no start led to a solution of {name!r} that stays finite over the record; try "
                "another law, more starts or a shorter record"
            )
        judge = _adaptive_motion(grid, theta)
        error = _solver_error(grid, residuals, theta, judge)
        if error <= max(SOLVER_LIMIT, SOLVER_SHARE * float(residuals.std())):
            return Solution(grid, trained, theta, error)
        steps = finer_grid(grid.steps)
        if steps is None or judge.ending != "complete":
            cause = f"is off by {error:.2g} amplitudes on a grid of {grid.steps} steps"
            if judge.ending != "complete":
                cause = "cannot be followed by the adaptive solver"
            raise InputError(
                f"the fitted solution of {name!r} {cause}; the limit is {SOLVER_LIMIT:g}: fit a "
                "shorter record, or a law that is less stiff"
            )
        grid = grid_of(grid.problem, grid.record, steps)
        trained = grid.sharpened(trained, training)


def _adaptive_motion(grid: Grid, theta: np.ndarray) -> Motion:
    problem = grid.problem
    values, _, scale, z0, v0 = problem.physical(theta)
    size = problem.amplitude / scale
    return motion(problem.law, grid.record.time, z0, v0, values, size)


def _solver_error(grid: Grid, residuals: np.ndarray, theta: np.ndarray, judge: Motion) -> float:
    """Greatest difference of two solutions in amplitudes; infinite where one is not finite."""
    problem = grid.problem
    _, shift, scale, _, _ = problem.physical(theta)
    fitted = grid.record.height + residuals * problem.amplitude
    error = float(np.abs(shift + scale * judge.z - fitted).max()) / problem.amplitude
    return error if math.isfinite(error) else math.inf
