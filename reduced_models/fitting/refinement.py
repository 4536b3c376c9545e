"""The end of a fit: all samples, fine grids, and the adaptive solution as their judge."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from reduced_models.fitting.search import (
    BLOWN_UP,
    Bounds,
    Equations,
    Prior,
    Samples,
    equations,
    samples_on_grid,
    search,
)
from reduced_models.fitting.search_vector import Layout, Normal, joint_normal
from reduced_models.fitting.unknowns import Problem, compiled_physical
from reduced_models.laws.solution import Motion, finer_grid, motion
from reduced_models.records.inputs import column, drive_on_grid

SOLVER_LIMIT, SOLVER_SHARE = 1e-6, 0.05
"""Greatest error of the fitted solution, in amplitudes and in standard deviations of the residual;
the larger of the two counts."""

_NEAR = 1e-6  # first damping of a search that starts near its end


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

    def normal(self, count: int | None = None) -> Normal:
        """The normal equations of the first ``count`` samples, or of all."""
        weight = np.zeros_like(self.samples.weight)
        weight[: len(self.record) if count is None else count] = 1.0
        return self.equations.of(self.samples._replace(weight=weight), self.problem.scales)

    def with_heights(self, height: np.ndarray) -> Grid:
        """The same with other heights (n,)."""
        padded = self.samples.height.copy()
        padded[: len(height)] = height
        record = dataclasses.replace(self.record, height=height)
        samples = self.samples._replace(height=padded)
        return dataclasses.replace(self, record=record, samples=samples)


def problem_equations(problem: Problem) -> Equations:
    """The compiled equations of a problem."""
    reads = compiled_physical(problem.logarithmic, problem.map is None)
    return equations(problem.law.equation, problem.law.inputs, reads)


def grid_of(problem: Problem, record: PistonRecord, steps: int) -> Grid:
    """All of a record that starts at time 0, on a grid."""
    drive = drive_on_grid(record, problem.law.inputs, steps)
    samples = samples_on_grid(record.time, record.height, steps, drive)
    return Grid(problem, record, steps, problem_equations(problem), samples)


@dataclasses.dataclass(frozen=True, eq=False)
class Joint:
    """Some records, each on its grid, that one search vector describes.

    Attributes
    ----------
    grids : tuple of Grid
        All of the same problem.
    layout : Layout
    bounds : Bounds
        Of the joint search vector.
    """

    grids: tuple[Grid, ...]
    layout: Layout
    bounds: Bounds

    @property
    def problem(self) -> Problem:
        """Law and scales."""
        return self.grids[0].problem

    def residuals(self, theta: np.ndarray) -> list[np.ndarray]:
        """Residuals (n,) of each record, in amplitudes."""
        places = self.layout.places
        return [grid.residuals(theta[here]) for grid, here in zip(self.grids, places, strict=True)]

    def normal_matrix(self, theta: np.ndarray) -> np.ndarray:
        """J'J (p, p) of all samples."""
        normal = joint_normal([grid.normal() for grid in self.grids], self.layout)
        return np.asarray(normal(theta[None])[2][0])

    def sharpened(
        self, theta: np.ndarray, counts: Sequence[int], tolerance: float = 1e-11
    ) -> np.ndarray:
        """The search vector that fits the first samples of each record best, from one near it."""
        normals = [grid.normal(count) for grid, count in zip(self.grids, counts, strict=True)]
        prior = Prior(self.layout.joined(self.problem.prior), float(sum(counts)))
        normal = joint_normal(normals, self.layout)
        found, _ = search(normal, theta[None], prior, tolerance, self.bounds, damping=_NEAR)
        return np.asarray(found[0])


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """A fit whose solution was judged.

    Attributes
    ----------
    joint : Joint
    trained, theta : float64 (p,)
        Search vectors that fit the training stretches, and all of the records.
    solver_errors : tuple of float
        Greatest difference to the adaptive solution of each record, in amplitudes.
    """

    joint: Joint
    trained: np.ndarray
    theta: np.ndarray
    solver_errors: tuple[float, ...]


def solution(joint: Joint, trained: np.ndarray, training: Sequence[int]) -> Solution:
    """Fit all of the records, from a vector that fits training stretches of so many samples.

    Grids are refined until their solutions agree with the adaptive ones.

    Raises
    ------
    InputError
        If a solution does not stay finite or cannot be followed, even on the finest grid.
    """
    name = joint.problem.law.name
    lengths = [len(grid.record) for grid in joint.grids]
    while True:
        whole = lengths == list(training)
        theta = trained if whole else joint.sharpened(trained, lengths)
        residuals = joint.residuals(theta)
        if any((np.abs(each) >= BLOWN_UP).any() for each in residuals):
            raise InputError(
                f"no start led to a solution of {name!r} that stays finite over the record; try "
                "another law, more starts or a shorter record"
            )
        judged = [
            _judged(grid, residual, theta[here])
            for grid, residual, here in zip(
                joint.grids, residuals, joint.layout.places, strict=True
            )
        ]
        if all(one.error <= one.limit for one in judged):
            return Solution(joint, trained, theta, tuple(one.error for one in judged))
        joint = _refined(joint, judged)
        trained = joint.sharpened(trained, training)


class _Judged(NamedTuple):
    """What the adaptive solution says of one on a grid, in amplitudes."""

    error: float
    limit: float
    complete: bool


def _judged(grid: Grid, residuals: np.ndarray, theta: np.ndarray) -> _Judged:
    judge = _adaptive_motion(grid, theta)
    error = _solver_error(grid, residuals, theta, judge)
    limit = max(SOLVER_LIMIT, SOLVER_SHARE * float(residuals.std()))
    return _Judged(error, limit, judge.ending == "complete")


def _refined(joint: Joint, judged: Sequence[_Judged]) -> Joint:
    """The same records on finer grids, where they are needed."""
    grids = []
    for grid, one in zip(joint.grids, judged, strict=True):
        steps = grid.steps if one.error <= one.limit else finer_grid(grid.steps)
        if steps is None or not one.complete:
            cause = f"is off by {one.error:.2g} amplitudes on a grid of {grid.steps} steps"
            if not one.complete:
                cause = "cannot be followed by the adaptive solver"
            raise InputError(
                f"the fitted solution of {grid.problem.law.name!r} {cause}; the limit is "
                f"{SOLVER_LIMIT:g}: fit a shorter record, or a law that is less stiff"
            )
        grids.append(grid_of(grid.problem, grid.record, steps))
    return dataclasses.replace(joint, grids=tuple(grids))


def _adaptive_motion(grid: Grid, theta: np.ndarray) -> Motion:
    problem, record = grid.problem, grid.record
    values, _, scale, z0, v0 = problem.physical(theta)
    size = problem.amplitude / scale
    inputs = [column(record, name) for name in problem.law.inputs]
    return motion(problem.law, record.time, z0, v0, values, size, inputs)


def _solver_error(grid: Grid, residuals: np.ndarray, theta: np.ndarray, judge: Motion) -> float:
    """Greatest difference of two solutions in amplitudes; infinite where one is not finite."""
    problem = grid.problem
    _, shift, scale, _, _ = problem.physical(theta)
    fitted = grid.record.height + residuals * problem.amplitude
    error = float(np.abs(shift + scale * judge.z - fitted).max()) / problem.amplitude
    return error if math.isfinite(error) else math.inf
