"""The problem that a fit solves: the data of its records, and all that is asked.

One search vector describes all records: what they share once, then what each has alone.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from reduced_models.fitting.fit_data import FitData, Selection
from reduced_models.fitting.levenberg_marquardt import Bounds, Normal, Prior, levenberg_marquardt
from reduced_models.fitting.unknowns import Pairs, Unknowns
from reduced_models.laws.law import Law

if TYPE_CHECKING:
    from jaxtyping import Float

Intervals = Literal["linear", "profile"]

_PATIENCE = 2  # trials without a gain, of a search that starts near its end
_NEAR = 1e-6  # first damping of a search that starts near its end


@dataclasses.dataclass(frozen=True, eq=False)
class FitProblem:
    """Data to fit together, and what is asked; see `reduced_models.fitting.fit.fit`."""

    data: tuple[FitData, ...]
    bounds: Pairs = dataclasses.field(default_factory=dict)  # of all records
    start: Mapping[str, float] = dataclasses.field(default_factory=dict)  # where parameters are looked for
    known_noise: bool = False
    starts: int = 1
    confidence: float = 0.95
    intervals: Intervals = "linear"
    seed: int = 0
    notes: tuple[str, ...] = ()  # on the data
    untold: tuple[str, ...] = ()  # by the signal; level: height of rest, size: size of the motion

    @property
    def unknowns(self) -> Unknowns:
        """Scales of what records share."""
        return self.data[0].unknowns

    @property
    def law(self) -> Law:
        """Law that is fitted."""
        return self.unknowns.law

    @property
    def largest_swing_record(self) -> FitData:
        """The record that swings the furthest."""
        return max(self.data, key=lambda data: data.guess.amplitude)

    @property
    def training(self) -> tuple[int, ...]:
        """Number of samples of each training stretch."""
        return tuple(data.training for data in self.data)

    def with_data(self, data: Iterable[FitData]) -> FitProblem:
        """Return the same of other data."""
        return dataclasses.replace(self, data=tuple(data))

    def with_scales(self, unknowns: Unknowns) -> FitProblem:
        """Return the same in common scales; what a law observes has the size of its own signal."""
        return self.with_data(
            dataclasses.replace(
                data,
                unknowns=dataclasses.replace(
                    unknowns, observation=data.unknowns.observation, signal=data.unknowns.signal
                )
                if data.unknowns.observation
                else unknowns,
            )
            for data in self.data
        )

    @functools.cached_property
    def edges(self) -> Bounds:
        """Least and greatest entries (q,) of the search vector, equal where they are held."""
        edges = [data.edges for data in self.data]
        return Bounds(*(self.joint_vector(side) for side in zip(*edges, strict=True)))

    @property
    def held_entries(self) -> np.ndarray:
        """Entries (q,) of the search vector that are given, as a mask."""
        return np.asarray(self.edges.low == self.edges.high)

    def joint_vector(self, vectors: Sequence[np.ndarray]) -> Float[np.ndarray, "... q"]:
        """Search vector of the vectors of each record; shared entries are the first's."""
        result = np.empty((*vectors[0].shape[:-1], self._size))
        for vector, data in zip(reversed(vectors), reversed(self.data), strict=True):
            result[..., data.entries] = vector
        return result

    @property
    def _size(self) -> int:
        return 1 + max(int(data.entries.max()) for data in self.data)

    def prior(self, samples: float) -> Prior:
        """Prior about a start, for costs of so many samples."""
        return Prior(self.joint_vector([self.unknowns.prior] * len(self.data)), samples)

    def residuals(self, theta: Float[np.ndarray, "q"]) -> list[np.ndarray]:
        """Residuals (n,) of each record, in amplitudes."""
        return [data.residuals(theta[data.entries]) for data in self.data]

    def sum_of_normal_equations(self, normals: Sequence[Normal]) -> Normal:
        """Return the normal equations of all records, of those of each."""
        size = self._size

        def normal_equations(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            count = len(theta)
            cost, gradient = np.zeros(count), np.zeros((count, size))
            matrix = np.zeros((count, size, size))
            for data, own in zip(self.data, normals, strict=True):
                here = data.entries
                cost_of_record, gradient_of_record, matrix_of_record = map(np.asarray, own(theta[:, here]))
                cost += cost_of_record
                gradient[:, here] += gradient_of_record
                matrix[:, here[:, None], here] += matrix_of_record
            return cost, gradient, matrix

        return normal_equations

    def normal_equations(self, selections: Sequence[Selection] | None = None) -> Normal:
        """Return the normal equations of some samples of each record, or of all."""
        chosen = selections or [None] * len(self.data)
        normals = [data.normal_equations(here) for data, here in zip(self.data, chosen, strict=True)]
        return self.sum_of_normal_equations(normals)

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
            self.edges,
            damping=_NEAR,
            patience=_PATIENCE,
        )
        return np.asarray(theta[0])
