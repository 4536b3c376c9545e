"""Whether vectors, such as the forces on the grains, have a direction that they prefer."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.shared.errors import InputError


class Directions(NamedTuple):
    """Order of the directions of vectors: 0 for none, 1 where all point alike.

    Attributes
    ----------
    polar, axial : float
        |mean of exp(i theta)|, and |mean of exp(2 i theta)|, which takes a vector and its opposite
        for the same: chains of forces would make it large.
    polar_p, axial_p : float
        Probability of an order this great in vectors without any, by Rayleigh's test.
    vectors : int
    """

    polar: float
    axial: float
    polar_p: float
    axial_p: float
    vectors: int


def direction_order(vectors: np.ndarray) -> Directions:
    """The order of the directions of vectors (n, 2), of whatever length.

    Vectors that are NaN or 0 are left out. The probability is exp(-n R^2) with the first correction
    for few vectors (Mardia and Jupp, Directional Statistics, 2000, sect. 6.3.1).

    Raises
    ------
    InputError
        If no vector is left, or the shape is another one.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import direction_order
    >>> found = direction_order(np.array([[1.0, 0.0]] * 20))
    >>> found
    Directions(polar=1.0, axial=1.0, polar_p=0.0, axial_p=0.0, vectors=20)
    """
    array = np.asarray(vectors, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"vectors have the shape {array.shape}; (n, 2) is wanted")
    array = array[np.isfinite(array).all(axis=1) & (array != 0.0).any(axis=1)]
    if not len(array):
        raise InputError("0 vectors; at least 1 that is not 0 has a direction")
    angle = np.arctan2(array[:, 1], array[:, 0])
    polar, axial = (float(abs(np.exp(1j * k * angle).mean())) for k in (1, 2))
    count = len(array)
    return Directions(polar, axial, _rayleigh(polar, count), _rayleigh(axial, count), count)


def _rayleigh(order: float, count: int) -> float:
    z = count * order**2
    return float(np.clip(np.exp(-z) * (1.0 + (2.0 * z - z * z) / (4.0 * count)), 0.0, 1.0))
