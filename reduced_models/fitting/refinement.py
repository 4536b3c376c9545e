"""The end of a fit: all samples, fine grids, and the adaptive solution as their judge."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.shared.errors import InputError
from granular.shared.messages import quoted
from reduced_models.fitting.joint_vector import JointVector, joint_normal
from reduced_models.laws.solution import Solution, solution
from reduced_models.least_squares.levenberg_marquardt import Bounds, Prior, search
from reduced_models.least_squares.residuals import BLOWN_UP, GriddedRecord
from reduced_models.least_squares.unknowns import Unknowns
from reduced_models.records.inputs import column

SOLVER_LIMIT, SOLVER_SHARE = 1e-6, 0.05
"""Greatest error of the fitted solution, in amplitudes and in standard deviations of the residual;
the larger of the two counts."""

FINEST = 2**19
"""Steps of a grid."""
_PATIENCE = 2  # trials without a gain, of a search that starts near its end
_NEAR = 1e-6  # first damping of a search that starts near its end


@dataclasses.dataclass(frozen=True, eq=False)
class JointRecords:
    """Some records, each on its grid, that one search vector describes.

    Attributes
    ----------
    grids : tuple of GriddedRecord
        All of the same unknowns.
    vector : JointVector
    bounds : Bounds
        Of the joint search vector.
    """

    grids: tuple[GriddedRecord, ...]
    vector: JointVector
    bounds: Bounds

    @property
    def unknowns(self) -> Unknowns:
        """Law and scales."""
        return self.grids[0].unknowns

    @property
    def held(self) -> np.ndarray:
        """Which entries (p,) of the joint search vector are given."""
        return np.asarray(self.bounds.low == self.bounds.high)

    def residuals(self, theta: np.ndarray) -> list[np.ndarray]:
        """Residuals (n,) of each record, in amplitudes."""
        places = self.vector.places
        return [grid.residuals(theta[here]) for grid, here in zip(self.grids, places, strict=True)]

    def normal_matrix(self, theta: np.ndarray) -> np.ndarray:
        """J'J (p, p) of all samples."""
        normal = joint_normal([grid.normal() for grid in self.grids], self.vector)
        return np.asarray(normal(theta[None])[2][0])

    def sharpened(
        self, theta: np.ndarray, counts: Sequence[int], tolerance: float = 1e-11
    ) -> np.ndarray:
        """The search vector that fits the first samples of each record best, from one near it."""
        normals = [grid.normal(count) for grid, count in zip(self.grids, counts, strict=True)]
        prior = Prior(self.vector.joined(self.unknowns.prior), float(sum(counts)))
        normal = joint_normal(normals, self.vector)
        found, _ = search(
            normal, theta[None], prior, tolerance, self.bounds, damping=_NEAR, patience=_PATIENCE
        )
        return np.asarray(found[0])


@dataclasses.dataclass(frozen=True, eq=False)
class JudgedFit:
    """A fit whose solution was judged.

    Attributes
    ----------
    joint : JointRecords
    trained, theta : float64 (p,)
        Search vectors that fit the training stretches, and all of the records.
    solver_errors : tuple of float
        Greatest difference to the adaptive solution of each record, in amplitudes.
    """

    joint: JointRecords
    trained: np.ndarray
    theta: np.ndarray
    solver_errors: tuple[float, ...]


def judged_fit(joint: JointRecords, trained: np.ndarray, training: Sequence[int]) -> JudgedFit:
    """Fit all of the records, from a vector that fits training stretches of so many samples.

    Grids are refined until their solutions agree with the adaptive ones.

    Raises
    ------
    InputError
        If a solution does not stay finite or cannot be followed, even on the finest grid.
    """
    name = joint.unknowns.law.name
    lengths = [len(grid.record) for grid in joint.grids]
    while True:
        whole = lengths == list(training)
        theta = trained if whole else joint.sharpened(trained, lengths)
        residuals = joint.residuals(theta)
        if any((np.abs(each) >= BLOWN_UP).any() for each in residuals):
            raise InputError(
                f"no start led to a solution of {quoted(name)} that stays finite over the record; "
                "try "
                "another law, more starts or a shorter record"
            )
        judged = [
            _judged(grid, residual, theta[here])
            for grid, residual, here in zip(
                joint.grids, residuals, joint.vector.places, strict=True
            )
        ]
        if all(one.error <= one.limit for one in judged):
            return JudgedFit(joint, trained, theta, tuple(one.error for one in judged))
        joint = _refined(joint, judged)
        trained = joint.sharpened(trained, training)


class _Judged(NamedTuple):
    """What the adaptive solution says of one on a grid, in amplitudes."""

    error: float
    limit: float
    complete: bool


def _judged(grid: GriddedRecord, residuals: np.ndarray, theta: np.ndarray) -> _Judged:
    judge = _adaptive_solution(grid, theta)
    error = _solver_error(grid, residuals, theta, judge)
    limit = max(SOLVER_LIMIT, SOLVER_SHARE * float(residuals.std()))
    return _Judged(error, limit, judge.ending == "complete")


def _refined(joint: JointRecords, judged: Sequence[_Judged]) -> JointRecords:
    """The same records on finer grids, where they are needed."""
    grids = []
    for grid, one in zip(joint.grids, judged, strict=True):
        finer = grid.grid if one.error <= one.limit else grid.grid.finer
        if finer.steps > FINEST or not one.complete:
            cause = f"is off by {one.error:.2g} amplitudes on a grid of {grid.grid.steps} steps"
            if not one.complete:
                cause = "cannot be followed by the adaptive solver"
            raise InputError(
                f"the fitted solution of {quoted(grid.unknowns.law.name)} {cause}; the limit is "
                f"{SOLVER_LIMIT:g}: fit a shorter record, as of chaos, or a law that is less stiff"
            )
        grids.append(grid if finer == grid.grid else grid.on(finer))
    return dataclasses.replace(joint, grids=tuple(grids))


def _adaptive_solution(grid: GriddedRecord, theta: np.ndarray) -> Solution:
    unknowns, record = grid.unknowns, grid.record
    values, _, scale, z0, v0, hidden = unknowns.physical(theta)
    size = unknowns.amplitude / scale
    inputs = [column(record, name) for name in unknowns.law.inputs]
    how = grid.interpolation
    return solution(unknowns.law, record.time, z0, v0, values, size, inputs, hidden, how)


def _solver_error(
    grid: GriddedRecord, residuals: np.ndarray, theta: np.ndarray, judge: Solution
) -> float:
    """Greatest difference of two solutions in amplitudes; infinite where one is not finite."""
    unknowns = grid.unknowns
    _, shift, scale, *_ = unknowns.physical(theta)
    fitted = grid.record.height + residuals * unknowns.amplitude
    error = float(np.abs(shift + scale * judge.z - fitted).max()) / unknowns.amplitude
    return error if math.isfinite(error) else math.inf
