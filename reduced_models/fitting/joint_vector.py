"""How several records share one search vector."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from reduced_models.least_squares.levenberg_marquardt import Normal
from reduced_models.least_squares.unknowns import Unknowns


class JointVector(NamedTuple):
    """Where the search vector of each record lies in the joint one.

    Attributes
    ----------
    size : int
        Of the joint vector: what is shared once, then what each record has of its own.
    places : tuple of int (p,)
        One a record.
    """

    size: int
    places: tuple[np.ndarray, ...]

    def joined(self, vector: np.ndarray) -> np.ndarray:
        """The joint vector of records that all have this one."""
        return self.merged([vector] * len(self.places))

    def merged(self, vectors: Sequence[np.ndarray]) -> np.ndarray:
        """The joint vector of those of the records; what is shared is that of the first one."""
        found = np.empty((*vectors[0].shape[:-1], self.size))
        for vector, here in zip(reversed(vectors), reversed(self.places), strict=True):
            found[..., here] = vector
        return found


def joint_vector(unknowns: Unknowns, records: int, own: Sequence[str]) -> JointVector:
    """The vector of some records that share all parameters but their ``own`` and the start."""
    names = unknowns.law.parameters
    free, length = unknowns.free, len(unknowns.prior)
    private = [k for k in range(length) if k >= free or (k < len(names) and names[k] in own)]
    shared = [k for k in range(length) if k not in private]
    places = []
    for record in range(records):
        here = np.empty(length, dtype=int)
        here[shared] = np.arange(len(shared))
        here[private] = len(shared) + record * len(private) + np.arange(len(private))
        places.append(here)
    return JointVector(len(shared) + records * len(private), tuple(places))


def joint_normal(normals: Sequence[Normal], vector: JointVector) -> Normal:
    """The normal equations of all records as those of the joint search vector."""

    def normal(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count = len(theta)
        cost, gradient = np.zeros(count), np.zeros((count, vector.size))
        matrix = np.zeros((count, vector.size, vector.size))
        for each, here in zip(normals, vector.places, strict=True):
            own_cost, own_gradient, own_matrix = each(theta[:, here])
            cost += np.asarray(own_cost)
            gradient[:, here] += np.asarray(own_gradient)
            matrix[:, here[:, None], here] += np.asarray(own_matrix)
        return cost, gradient, matrix

    return normal
