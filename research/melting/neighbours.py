"""Neighbours in a periodic cell, and their bond order."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.observables.voronoi import voronoi_cells

MARGIN = 4.0
"""Margin of periodic images around the cell, in mean spacings, larger than any Voronoi cell of these
layers."""


class VoronoiNeighbours(NamedTuple):
    """Voronoi neighbours of n grains.

    Attributes
    ----------
    first, second : int (m,)
        Every pair of neighbours, in both directions.
    way : float (m, 2)
        Displacement from the first to the nearest image of the second [m].
    sides : int (n,)
        Number of neighbours.
    """

    first: np.ndarray
    second: np.ndarray
    way: np.ndarray
    sides: np.ndarray


def nearest_image_displacements(way: np.ndarray, periods: tuple[float, float]) -> np.ndarray:
    """Return displacements (..., 2) to the nearest images."""
    return np.asarray(way - periods * np.round(way / periods))


def periodic_voronoi_neighbours(positions: np.ndarray, periods: tuple[float, float]) -> VoronoiNeighbours:
    """Return the Voronoi neighbours in a periodic cell.

    Parameters
    ----------
    positions : float (n, 2)
        [m]
    periods : (float, float)
        Width and height of the cell [m].
    """
    inside, count = np.mod(positions, periods), len(positions)
    margin = MARGIN * np.sqrt(periods[0] * periods[1] / count)
    places, owners = [inside], [np.arange(count)]
    for column in (-1, 0, 1):
        for row in (-1, 0, 1):
            image = inside + np.array([column, row]) * periods
            near = ((image > -margin) & (image < np.array(periods) + margin)).all(axis=1)
            if (column or row) and near.any():
                places.append(image[near])
                owners.append(np.flatnonzero(near))
    owner, index = np.concatenate(owners), np.concatenate(places)
    pairs = voronoi_cells(index).neighbours
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    pairs = pairs[pairs[:, 0] < count]
    way = index[pairs[:, 1]] - index[pairs[:, 0]]
    sides = np.bincount(pairs[:, 0], minlength=count)
    return VoronoiNeighbours(pairs[:, 0], owner[pairs[:, 1]], way, sides)


def local_psi6(result: VoronoiNeighbours) -> np.ndarray:
    """Return psi6 of each grain, complex (n,): the mean of exp(6 i phi) over its bonds."""
    angle = np.arctan2(result.way[:, 1], result.way[:, 0])
    turned, count = np.exp(6j * angle), len(result.sides)
    real = np.bincount(result.first, turned.real, minlength=count)
    imaginary = np.bincount(result.first, turned.imag, minlength=count)
    return np.asarray((real + 1j * imaginary) / np.maximum(result.sides, 1))


def bond_correlation_sums_and_counts(
    positions: np.ndarray,
    order: np.ndarray,
    periods: tuple[float, float],
    edges: np.ndarray,
    origins: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return sums of Re psi6*(0) psi6(r) over pairs of some grains with all, and their numbers.

    Parameters
    ----------
    positions : float (n, 2)
        [m]
    order : complex (n,)
    periods : (float, float)
        [m]
    edges : float (b + 1,)
        Edges of the bins of r, up to half the shorter side [m].
    origins : int (k,)
        Grains at the origin.

    Returns
    -------
    sums, numbers : float (b,)
    """
    way = nearest_image_displacements(positions[None] - positions[origins, None], periods)
    r = np.hypot(way[..., 0], way[..., 1]).ravel()
    both = (order[origins, None].conj() * order[None]).real.ravel()
    far = r > 0.0
    sums = np.histogram(r[far], edges, weights=both[far])[0]
    return sums, np.histogram(r[far], edges)[0].astype(float)
