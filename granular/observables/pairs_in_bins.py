"""Counting the pairs of grains by their distance, without listing them."""

from __future__ import annotations

import numpy as np

from granular.observables.frames import spanned_box
from granular.shared.errors import InputError

FARTHEST = 10.0
"""Default of the greatest distance, in mean spacings: farther, large beds would be slow."""

BINS = 100


def checked_edges(edges: np.ndarray) -> np.ndarray:
    """Bin edges as float64 (k + 1,).

    Raises
    ------
    InputError
        If they do not increase from at least 0.
    """
    array = np.asarray(edges, dtype=np.float64)
    if array.ndim != 1 or len(array) < 2 or not (np.diff(array) > 0.0).all() or array[0] < 0.0:
        raise InputError(
            "edges must be at least two distances that increase from 0 m up; sort them"
        )
    return array


def default_edges(positions: np.ndarray) -> np.ndarray:
    """`BINS` bins up to half the shorter side of the box, or `FARTHEST` mean spacings.

    Raises
    ------
    InputError
        If the grains span no box.
    """
    low, high = spanned_box(positions)
    sides = high - low
    if not (sides > 0.0).all():
        raise InputError("the grains span no box; at least two grains not in a row are needed")
    count = int(np.isfinite(positions).all(axis=1).sum())
    spacing = float(np.sqrt(np.prod(sides) / count))
    return np.linspace(0.0, min(0.5 * float(sides.min()), FARTHEST * spacing), BINS + 1)


def spanning(frames: np.ndarray) -> list[np.ndarray]:
    """The frames (k, n, 2) whose grains span a box: what a cell that empties ends with does not.

    Raises
    ------
    InputError
        If none does.
    """
    found = []
    for one in frames:
        present = one[np.isfinite(one).all(axis=1)]
        if len(present) > 1 and (np.ptp(present, axis=0) > 0.0).all():
            found.append(one)
    if not found:
        raise InputError("in no frame do the grains span a box; give frames with more grains")
    return found


def binned_pairs(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Pairs i < j in each bin (lower edge, upper edge], int (k,)."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    return np.diff(tree.count_neighbors(tree, edges)) // 2


def binned_products(points: np.ndarray, values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Sum of v_i v_j over the pairs i < j of each bin (lower edge, upper edge], float (k,)."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    sums = tree.count_neighbors(tree, edges, weights=(values, values), cumulative=False)
    return np.asarray(0.5 * sums[1:])
