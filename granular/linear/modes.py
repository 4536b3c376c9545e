"""Normal modes of a bed without damping, and their density."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from granular.linear.equilibrium import Equilibrium
from granular.shared.array_types import Float

LOWEST = 40
"""Modes of a bed whose matrices are not full."""

BELOW = 1e-3
"""Shift of the search for them, below zero, over the largest stiffness of a coordinate and its mass."""


@dataclasses.dataclass(frozen=True, eq=False)
class NormalModes:
    """Normal modes of small motions without damping.

    Attributes
    ----------
    squared_angular_frequencies : float64 (k,)
        Rising; negative where the state is unstable [1/s^2].
    shapes : float64 (q, k)
        Displacements of all coordinates in each mode, of modal mass 1 kg [m].
    frequencies : float64 (k,)
        [Hz]; NaN where unstable.
    """

    squared_angular_frequencies: Float[np.ndarray, "k"]
    shapes: Float[np.ndarray, "q k"]

    @property
    def frequencies(self) -> Float[np.ndarray, "k"]:
        """Frequencies [Hz]; NaN where unstable."""
        squares = self.squared_angular_frequencies
        return np.where(squares >= 0.0, np.sqrt(np.abs(squares)) / (2.0 * math.pi), np.nan)


def normal_modes(rest: Equilibrium, count: int | None = None) -> NormalModes:
    """Find the lowest normal modes of a bed, without its damping.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed.
    count : int, optional
        Number of modes; without, all of a bed of at most `granular.linear.pencil.DENSE` coordinates, and 40
        of a larger one.

    Returns
    -------
    NormalModes
        Solutions of K u = omega^2 M u.
    """
    pencil = rest.pencil
    if pencil.has_all_modes:
        from scipy.linalg import eigh

        last = pencil.bed.size if count is None else min(count, pencil.bed.size)
        return NormalModes(*eigh(pencil.full_stiffness, pencil.mass.toarray(), subset_by_index=[0, last - 1]))
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import LinearOperator, eigsh

    shape = (pencil.bed.size, pencil.bed.size)
    undamped = dataclasses.replace(pencil, damping=csc_matrix(shape), damping_is_diagonal=True)
    scale = float(np.abs(pencil.stiffness.diagonal()).max() / pencil.mass.diagonal().max())
    # Below zero, since the shifts of a periodic cell have no stiffness.
    sigma = -BELOW * scale
    inverse = LinearOperator(shape, lambda u: undamped.solve(math.sqrt(-sigma), u.reshape(-1, 1))[:, 0])
    product = LinearOperator(shape, lambda u: pencil.times(0.0, u.ravel()))
    return NormalModes(*eigsh(product, count or LOWEST, M=pencil.mass, sigma=sigma, OPinv=inverse, tol=1e-8))
