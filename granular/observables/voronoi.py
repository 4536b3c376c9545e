"""Voronoi cells of the grains, and the fractions of pentagons, hexagons and heptagons.

Only cells entirely inside the bounding box of the grain centres are counted, as in [D, 4.2.4, Algorithm 4.3];
such cells are called interior.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.observables.frame import bounding_box, checked_vectors, present_grain_mask, present_positions
from granular.shared.array_types import Bool, Float, Int
from granular.shared.errors import InputError

SHORTEST_SIDE = 1e-9
"""Side length, in mean spacings, below which a side is attributed to rounding and not counted."""

INSIDE = 1e-12
"""Corners outside the box by up to this fraction of its size count as inside, to allow for rounding."""


class VoronoiCells(NamedTuple):
    """The Voronoi diagram of n grains, as arrays."""

    sides: Int[np.ndarray, "n"]  # number of sides of each cell (= neighbours); 0 if absent
    area: Float[np.ndarray, "n"]  # area of each interior cell [m^2], NaN for other cells
    side_squares: Float[
        np.ndarray, "n"
    ]  # sum of squared sides of each interior cell [m^2], NaN for other cells
    interior: Bool[np.ndarray, "n"]  # whether the cell lies entirely in the bounding box of the centres
    neighbours: Int[np.ndarray, "m 2"]  # pairs of neighbours, each once
    triangles: Int[np.ndarray, "t 3"]  # Delaunay triangles
    corners: Float[
        np.ndarray, "t 2"
    ]  # circumcentres of the triangles, which are the corners of the cells [m]


class PolygonFractions(NamedTuple):
    """Fractions of the interior cells by their number of sides; they add up to 1."""

    pentagons: float
    hexagons: float
    heptagons: float
    others: float
    cells: int

    @property
    def by_name(self) -> dict[str, float]:
        """The fractions by name: pentagons, hexagons, heptagons, others; NaN without interior cells."""
        return dict(zip(self._fields[:4], self[:4], strict=True))


def voronoi_cells(positions: np.ndarray) -> VoronoiCells:
    """Voronoi cells of the grains.

    If four or more grains lie on one circle, as in a square lattice, cells have sides of zero length. These
    sides are not counted, and the grains that share them are not neighbours. If grains are at exactly the
    same point, only one of them has a cell. Fewer than three grains, or grains in a line, have no interior
    cells and no neighbours.

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.

    Returns
    -------
    VoronoiCells
        Number of sides of each cell (n,), 0 for absent grains; area (n,) [m^2] and sum of the squared sides
        (n,) [m^2], both NaN for cells that are not interior. Also a mask (n,) of interior cells, pairs of
        neighbours (m, 2), Delaunay triangles (t, 3), and their circumcentres (t, 2) [m], which are the
        corners of the cells.

    Raises
    ------
    InputError
        If the positions do not have the shape (n, 2).

    Notes
    -----
    The corners of the Voronoi cells are the circumcentres of the Delaunay triangles [D, 4.2.3.1]; the
    Delaunay triangulation is computed by Qhull (Barber, Dobkin, Huhdanpaa, ACM Trans. Math. Software 22, 469,
    1996).

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import voronoi_cells
    >>> cells = voronoi_cells(places)
    >>> int(cells.interior.sum())
    64
    """
    positions = checked_vectors(positions)
    points = present_positions(positions)
    triangles, across = _delaunay_triangles_and_neighbours(points)
    # Convert to the numbering of all grains, including absent ones.
    triangles = np.flatnonzero(present_grain_mask(positions))[triangles]
    corners = circumcentres(positions, triangles)
    pairs, lengths, outer = _neighbour_pairs_and_sides(triangles, across, corners)
    spacing = np.sqrt(np.prod(np.ptp(points, axis=0)) / len(points)) if len(points) else 0.0
    neighbouring = outer | ~(lengths <= SHORTEST_SIDE * spacing)
    interior = _interior_cell_mask(positions, triangles, corners, pairs[outer])

    gap = np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1)
    # Each side forms a triangle of height gap/2 with its grain.
    area, squares = (
        np.where(
            interior,
            _sum_pair_values_per_grain(pairs, np.where(outer, 0.0, pair_values), len(positions)),
            np.nan,
        )
        for pair_values in (gap * lengths / 4.0, lengths**2)
    )
    sides = np.bincount(pairs[neighbouring].ravel(), minlength=len(positions))
    return VoronoiCells(sides, area, squares, interior, pairs[neighbouring], triangles, corners)


def checked_positions_and_cells(
    positions: Float[np.ndarray, "n 2"], cells: VoronoiCells | None
) -> tuple[Float[np.ndarray, "n 2"], VoronoiCells]:
    """Check positions [m], and compute their Voronoi cells or check the number of grains of given cells."""
    positions = checked_vectors(positions)
    if cells is None:
        cells = voronoi_cells(positions)
    if len(cells.sides) != len(positions):
        raise InputError(
            f"there are Voronoi cells of {len(cells.sides)} grains for {len(positions)} positions; pass "
            "the cells of these positions"
        )
    return positions, cells


def polygon_fractions(cells: VoronoiCells) -> PolygonFractions:
    """Fractions of pentagons, hexagons, heptagons and all others among interior cells [D, 4.2.4].

    Parameters
    ----------
    cells : VoronoiCells
        Voronoi cells of the grains.

    Returns
    -------
    PolygonFractions
        Four dimensionless fractions with the sum 1, or NaN without interior cells; and ``cells``, the number
        of interior cells.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import polygon_fractions, voronoi_cells
    >>> float(polygon_fractions(voronoi_cells(places)).hexagons)
    1.0
    """
    sides = cells.sides[cells.interior]
    if not len(sides):
        return PolygonFractions(np.nan, np.nan, np.nan, np.nan, 0)
    five, six, seven = (int(np.count_nonzero(sides == k)) for k in (5, 6, 7))
    total = len(sides)
    rest = total - five - six - seven
    return PolygonFractions(five / total, six / total, seven / total, rest / total, total)


def cell_polygons(cells: VoronoiCells) -> dict[int, np.ndarray]:
    """Corners of every interior Voronoi cell, counter-clockwise [D, 4.2.3.1].

    Parameters
    ----------
    cells : VoronoiCells
        Voronoi cells of the grains.

    Returns
    -------
    dict of int to array
        Corners [m] of each interior cell, float64 (k, 2), by the grain's index; empty without interior cells.
        If four or more grains lie on one circle, their common corner is repeated.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import cell_polygons, voronoi_cells
    >>> corners = cell_polygons(voronoi_cells(places))
    >>> {len(one) for one in corners.values()}
    {6}
    """
    triangles_around: dict[int, list[int]] = {int(i): [] for i in np.flatnonzero(cells.interior)}
    for triangle, grains in enumerate(cells.triangles.tolist()):
        for grain in grains:
            if grain in triangles_around:
                triangles_around[grain].append(triangle)
    polygons = {}
    for grain, around_grain in triangles_around.items():
        corners = cells.corners[around_grain]
        # The cell is convex: its corners are ordered by angle about their mean.
        arms = corners - corners.mean(axis=0)
        polygons[grain] = corners[np.argsort(np.arctan2(arms[:, 1], arms[:, 0]))]
    return polygons


def _delaunay_triangles_and_neighbours(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Delaunay triangles (t, 3), and the adjacent triangle across each side (t, 3), -1 if none."""
    from scipy.spatial import Delaunay, QhullError

    empty = np.empty((0, 3), dtype=np.intp)
    if len(points) < 3:
        return empty, empty
    # Positions relative to the mean lose the fewest bits when they are squared.
    centred = points - points.mean(axis=0)
    try:
        mesh = Delaunay(centred)
    except QhullError:
        return empty, empty
    return mesh.simplices.astype(np.intp), mesh.neighbors.astype(np.intp)


def circumcentres(
    points: Float[np.ndarray, "n 2"], triangles: Int[np.ndarray, "t 3"]
) -> Float[np.ndarray, "t 2"]:
    """Centres [m] of the circles through the three corners of each triangle."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    p, q = b - a, c - a
    twice = 2.0 * (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    pp, qq = (p**2).sum(axis=1), (q**2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (q[:, 1] * pp - p[:, 1] * qq) / twice
        y = (p[:, 0] * qq - q[:, 0] * pp) / twice
    return a + np.stack([x, y], axis=1)


def _neighbour_pairs_and_sides(
    triangles: np.ndarray, across: np.ndarray, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return neighbour pairs (m, 2), lengths (m,) of the sides between them, and a mask of infinite sides."""
    triangle = np.repeat(np.arange(len(triangles)), 3)
    opposite = across.ravel()
    pairs = np.stack([triangles[:, [1, 2, 0]].ravel(), triangles[:, [2, 0, 1]].ravel()], axis=1)
    first_occurrence = (opposite < 0) | (triangle < opposite)
    triangle, opposite, pairs = (
        triangle[first_occurrence],
        opposite[first_occurrence],
        pairs[first_occurrence],
    )
    outer = opposite < 0
    with np.errstate(invalid="ignore"):
        lengths = np.linalg.norm(corners[triangle] - corners[opposite], axis=1)
    return pairs, np.where(outer, np.inf, lengths), outer


def _interior_cell_mask(
    points: np.ndarray, triangles: np.ndarray, corners: np.ndarray, rim: np.ndarray
) -> np.ndarray:
    """Return a mask (n,) of the bounded cells whose corners all lie inside the box of the centres."""
    inside = np.zeros(len(points), dtype=bool)
    if not len(triangles):
        return inside
    low, high = bounding_box(points)
    margin = INSIDE * (high - low).max()
    within = ((corners >= low - margin) & (corners <= high + margin)).all(axis=1)
    inside[triangles.ravel()] = True
    inside[triangles[~within].ravel()] = False
    inside[rim.ravel()] = False
    return inside


def _sum_pair_values_per_grain(pairs: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """For each grain, sum the values of the pairs to which it belongs; return the sums (count,)."""
    return np.asarray(
        np.bincount(pairs[:, 0], values, minlength=count) + np.bincount(pairs[:, 1], values, minlength=count)
    )


def hexagon_regularity(cells: VoronoiCells) -> np.ndarray:
    """Regularity of each interior hexagon: 1 for a regular hexagon, less than 1 otherwise.

    Parameters
    ----------
    cells : VoronoiCells
        Voronoi cells of the grains.

    Returns
    -------
    float64 (n,)
        4/sqrt(3) * area / (sum of the squares of the sides) [D, eq. 4.25], dimensionless; NaN for all cells
        except interior hexagons, because the maximum of this expression is 1 only for hexagons.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import hexagon_regularity, voronoi_cells
    >>> float(np.nanmean(hexagon_regularity(voronoi_cells(places))).round(3))
    1.0
    """
    hexagon = cells.interior & (cells.sides == 6)
    regularity = np.full(len(cells.sides), np.nan)
    regularity[hexagon] = 4.0 / np.sqrt(3.0) * cells.area[hexagon] / cells.side_squares[hexagon]
    return regularity
