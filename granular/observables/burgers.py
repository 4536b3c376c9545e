"""Burgers circuits: the lattice vector that each bond stands for, and what circuits fail to close.

Lattice vectors are pairs of whole numbers (m, n) for m a1 + n a2, with a1 at an angle of reference
and a2 60 degrees from it.
"""

from __future__ import annotations

import numpy as np

SIX = np.array([[1, 0], [0, 1], [-1, 1], [-1, 0], [0, -1], [1, -1]])
"""Nearest neighbours in the lattice, counter-clockwise from a1."""


def lattice_bonds(arms: np.ndarray, angle: float) -> np.ndarray:
    """The nearest neighbour's vector whose direction is next to that of each arm, int (k, 2)."""
    # An arm and its opposite get opposite vectors, to the last bit: one of them is looked at.
    back = (arms[:, 1] < 0.0) | ((arms[:, 1] == 0.0) & (arms[:, 0] < 0.0))
    x, y = np.where(back[:, None], -arms, arms).T
    place = np.round((np.arctan2(y, x) - angle) / (np.pi / 3.0)).astype(int) % 6
    return np.where(back[:, None], -SIX[place], SIX[place])


def in_space(vectors: np.ndarray, angle: float, spacing: float) -> np.ndarray:
    """Lattice vectors (..., 2) as vectors in the plane, in the unit of the spacing."""
    turned = angle + np.pi / 3.0
    basis = np.array([[np.cos(angle), np.sin(angle)], [np.cos(turned), np.sin(turned)]])
    return np.asarray(spacing * (np.asarray(vectors) @ basis))


def norm_squared(vectors: np.ndarray) -> np.ndarray:
    """m^2 + m n + n^2, the square of the length over the spacing."""
    m, n = np.moveaxis(np.asarray(vectors), -1, 0)
    return np.asarray(m * m + m * n + n * n)


def counter_clockwise(triangles: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """The triangles (t, 3), each with its corners in counter-clockwise order."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    left = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    turned = triangles.copy()
    turned[left < 0.0] = turned[left < 0.0][:, [0, 2, 1]]
    return turned


def edges_of(triangles: np.ndarray) -> np.ndarray:
    """The three edges of each triangle, from corner to corner (t, 3, 2)."""
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1)


def burgers_vectors(triangles: np.ndarray, positions: np.ndarray, angle: float) -> np.ndarray:
    """Burgers vector in each counter-clockwise triangle, int (t, 2).

    Minus the sum of the lattice vectors of its edges: the integral of du over the circuit, u being
    the displacement from the perfect lattice (FS/RH, Hirth and Lothe 1982). Triangles of a strained
    lattice have none, and that of a region is the sum over its triangles.
    """
    edges = edges_of(triangles).reshape(-1, 2)
    bonds = lattice_bonds(positions[edges[:, 1]] - positions[edges[:, 0]], angle)
    return np.asarray(-bonds.reshape(-1, 3, 2).sum(axis=1))


def grains_in_excess(triangles: np.ndarray, positions: np.ndarray, angle: float) -> float:
    """Grains in a region more than lattice sites: -1 for a vacancy, 1 for an interstitial.

    A region of t triangles with n grains inside and k at its rim has t = 2 n + k - 2, and one in
    the lattice with the same rim an area of n + k/2 - 1 cells (Pick's theorem). The rim's lattice
    vectors must close.
    """
    edges = edges_of(triangles).reshape(-1, 2)
    have = {(int(i), int(j)) for i, j in edges}
    rim = {i: j for i, j in have if (j, i) not in have}
    area = 0.0
    while rim:
        start = here = next(iter(rim))
        place = np.zeros(2)
        while here in rim:
            there = rim.pop(here)
            bond = lattice_bonds((positions[there] - positions[here])[None], angle)[0]
            area += 0.5 * float(place[0] * bond[1] - place[1] * bond[0])
            place, here = place + bond, there
            if here == start:
                break
    return 0.5 * len(triangles) - area
