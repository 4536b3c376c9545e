"""Some records that one search vector describes: what they share once, then what each has alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from reduced_models.fitting.levenberg_marquardt import Bounds, Normal, Prior, levenberg_marquardt
from reduced_models.fitting.residuals import GriddedRecord, Selection
from reduced_models.fitting.unknowns import Unknowns

if TYPE_CHECKING:
    from jaxtyping import Float

Entries = tuple[np.ndarray, ...]
"""Entries (p,) of the joint search vector that are the search vector of each record."""

_PATIENCE = 2  # trials without a gain, of a search that starts near its end
_NEAR = 1e-6  # first damping of a search that starts near its end


def joint_vector_entries(unknowns: Unknowns, records: int, own: Sequence[str]) -> Entries:
    """Entries of records that share all parameters but their ``own``, and the state at the start."""
    names = unknowns.law.parameters
    free, length = len(names), len(unknowns.prior)
    private = [k for k in range(length) if k >= free or (k < len(names) and names[k] in own)]
    shared = [k for k in range(length) if k not in private]
    entries = []
    for record in range(records):
        here = np.empty(length, dtype=int)
        here[shared] = np.arange(len(shared))
        here[private] = len(shared) + record * len(private) + np.arange(len(private))
        entries.append(here)
    return tuple(entries)


def joint_vector(vectors: Sequence[np.ndarray], entries: Entries) -> Float[np.ndarray, "... q"]:
    """Joint search vector of the search vectors of some records; shared entries are the first's."""
    joint = np.empty((*vectors[0].shape[:-1], _vector_size(entries)))
    for vector, here in zip(reversed(vectors), reversed(entries), strict=True):
        joint[..., here] = vector
    return joint


def joint_normal_equations(normals: Sequence[Normal], entries: Entries) -> Normal:
    """Return the normal equations of all records as those of the joint search vector."""
    size = _vector_size(entries)

    def normal_equations(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count = len(theta)
        cost, gradient = np.zeros(count), np.zeros((count, size))
        matrix = np.zeros((count, size, size))
        for own, here in zip(normals, entries, strict=True):
            cost_of_record, gradient_of_record, matrix_of_record = own(theta[:, here])
            cost += np.asarray(cost_of_record)
            gradient[:, here] += np.asarray(gradient_of_record)
            matrix[:, here[:, None], here] += np.asarray(matrix_of_record)
        return cost, gradient, matrix

    return normal_equations


def _vector_size(entries: Entries) -> int:
    return 1 + max(int(here.max()) for here in entries)


@dataclasses.dataclass(frozen=True, eq=False)
class JointRecords:
    """Some records, each on its grid, that one search vector describes."""

    grids: tuple[GriddedRecord, ...]
    entries: Entries  # of the joint search vector, for each record
    bounds: Bounds

    @property
    def unknowns(self) -> Unknowns:
        """Law and scales."""
        return self.grids[0].unknowns

    @property
    def held_entries(self) -> np.ndarray:
        """Entries (q,) of the joint search vector that are given, as a mask."""
        return np.asarray(self.bounds.low == self.bounds.high)

    def prior(self, samples: float) -> Prior:
        """Prior about a start, for costs of so many samples."""
        return Prior(joint_vector([self.unknowns.prior] * len(self.grids), self.entries), samples)

    def residuals(self, theta: Float[np.ndarray, "q"]) -> list[np.ndarray]:
        """Residuals (n,) of each record, in amplitudes."""
        return [grid.residuals(theta[here]) for grid, here in zip(self.grids, self.entries, strict=True)]

    def linearised_residuals(self, theta: Float[np.ndarray, "q"]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Weighted residuals (n,) of each record without drift, and their derivatives (n, p)."""
        return [
            grid.linearised_residuals(theta[here])
            for grid, here in zip(self.grids, self.entries, strict=True)
        ]

    def normal_equations(self, selections: Sequence[Selection] | None = None) -> Normal:
        """Return the normal equations of some samples of each record, or of all."""
        chosen = selections or [None] * len(self.grids)
        normals = [grid.normal_equations(here) for grid, here in zip(self.grids, chosen, strict=True)]
        return joint_normal_equations(normals, self.entries)

    def normal_matrix(self, theta: Float[np.ndarray, "q"]) -> Float[np.ndarray, "q q"]:
        """Matrix J'J of all samples of all records."""
        return np.asarray(self.normal_equations()(theta[None])[2][0])

    def refit(
        self, theta: Float[np.ndarray, "q"], selections: Sequence[int | np.ndarray], tolerance: float = 1e-11
    ) -> Float[np.ndarray, "q"]:
        """Fit some samples of each record, from a search vector (q,) near the fit."""
        theta, _ = levenberg_marquardt(
            self.normal_equations(selections),
            theta[None],
            self.prior(float(sum(np.sum(here) for here in selections))),
            tolerance,
            self.bounds,
            damping=_NEAR,
            patience=_PATIENCE,
        )
        return np.asarray(theta[0])
