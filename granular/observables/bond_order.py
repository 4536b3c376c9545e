"""Bond-orientational order: Psi6 of each grain and of the bed, its susceptibility, g6(r), g6(t)."""

from __future__ import annotations

import numpy as np

from granular.observables.correlation import (
    PairDistanceFunction,
    check_bin_edges,
    default_bin_edges,
    mean_over_pairs,
    sum_pair_products,
)
from granular.observables.displacement import check_lags, check_periods
from granular.observables.frame import check_frames, observable, sum_by_index
from granular.observables.voronoi import VoronoiCells, check_cells, voronoi_cells
from granular.shared.errors import InputError


def local_psi6(positions: np.ndarray, cells: VoronoiCells | None = None) -> np.ndarray:
    """Complex bond order of each grain, mean over its Voronoi neighbours of exp(6 i theta).

    theta is the angle of the bond against the x axis (Nelson and Halperin, Phys. Rev. B 19, 2457,
    1979).

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent ones.
    cells : VoronoiCells, optional
        Voronoi cells of the same positions, if known.

    Returns
    -------
    complex128 (n,)
        Order of each grain, without unit, at most 1 in size. NaN for absent grains and for grains
        without neighbours. Grains at the rim have a value too; see ``cells.interior``.

    Raises
    ------
    InputError
        If the positions have another shape than (n, 2), or the cells are of another number of grains.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import local_psi6
    >>> float(np.nanmax(np.abs(local_psi6(places))).round(3))
    1.0
    """
    positions, cells = check_cells(positions, cells)
    i, j = cells.neighbours.T
    arm = positions[j] - positions[i]
    bond = arm[:, 0] + 1j * arm[:, 1]
    # exp(6 i theta) is the same from both ends of a bond.
    turn = (bond / np.abs(bond)) ** 6
    total = sum_by_index(i, turn, len(positions)) + sum_by_index(j, turn, len(positions))
    known = cells.sides > 0
    local = np.full(len(positions), complex(np.nan, np.nan))
    local[known] = total[known] / cells.sides[known]
    return local


def psi6(positions: np.ndarray, cells: VoronoiCells | None = None) -> float:
    """Psi6 = mean of |local Psi6| over the grains with an interior cell [D, eq. 4.28].

    It is 1 for a perfect hexagonal arrangement, whatever its orientations.

    Parameters
    ----------
    positions : float64 (n, 2)
        Positions of the grains [m]; NaN for absent ones.
    cells : VoronoiCells, optional
        Voronoi cells of these positions, where they are known already.

    Returns
    -------
    float
        Order parameter from 0 to 1, without unit; NaN without interior cells.

    Raises
    ------
    InputError
        If the positions have another shape than (n, 2), or the cells are of another number of grains.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import psi6
    >>> round(psi6(places), 3)
    1.0
    """
    positions, cells = check_cells(positions, cells)
    sizes = np.abs(local_psi6(positions, cells)[cells.interior])
    return float(sizes.mean()) if len(sizes) else np.nan


def global_psi6(positions: np.ndarray, cells: VoronoiCells | None = None) -> complex:
    """Mean of the complex local Psi6 over the grains with an interior cell.

    Its size is 1 only where all hexagons have the same orientation (Nelson and Halperin, Phys. Rev.
    B 19, 2457, 1979).

    Parameters
    ----------
    positions : float64 (n, 2)
        Positions of the grains [m]; NaN for absent ones.
    cells : VoronoiCells, optional
        Voronoi cells of these positions, where they are known already.

    Returns
    -------
    complex
        Complex order parameter, without unit, at most 1 in size; NaN without interior cells.

    Raises
    ------
    InputError
        If the positions have another shape than (n, 2), or the cells are of another number of grains.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import global_psi6
    >>> round(abs(global_psi6(places)), 3)
    1.0
    """
    positions, cells = check_cells(positions, cells)
    values = local_psi6(positions, cells)[cells.interior]
    return complex(values.mean()) if len(values) else complex(np.nan, np.nan)


@observable("1", "correlation of bond orientation g6(r)")
def bond_correlation(
    positions: np.ndarray, edges: np.ndarray | None = None, cells: VoronoiCells | None = None
) -> PairDistanceFunction:
    """Bond correlation g6(r) = Re <psi6*(0) psi6(r)>, the mean over pairs at the distance r.

    It is constant in a crystal, falls algebraically in the hexatic phase and exponentially in a
    liquid (Nelson and Halperin, Phys. Rev. B 19, 2457, 1979). A mean over pairs needs no correction
    at the rim. Only grains with an interior Voronoi cell count.

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.
    edges : float (k + 1,), optional
        Edges of the bins [m]; as for `radial_distribution` if not given.
    cells : VoronoiCells, optional
        Voronoi cells of the same positions, if known.

    Returns
    -------
    PairDistanceFunction
        Mean of each bin (k,), without unit, NaN in bins without pairs, and the number of its pairs.

    Raises
    ------
    InputError
        If the positions have another shape, the cells are of another number of grains, the edges do not
        increase from 0 m or more, or fewer than two grains have an interior cell.
    """
    positions, cells = check_cells(positions, cells)
    edges = default_bin_edges(positions) if edges is None else check_bin_edges(edges)
    inside = np.flatnonzero(cells.interior)
    if len(inside) < 2:
        raise InputError(f"{len(inside)} grains have an interior cell; g6(r) needs at least 2")
    points, order = positions[inside], local_psi6(positions, cells)[inside]
    products = sum_pair_products(points, order.real, edges) + sum_pair_products(points, order.imag, edges)
    return mean_over_pairs(points, products, edges)


@observable("1", "relaxation of bond orientation g6(t)")
def bond_relaxation(
    frames: np.ndarray, lags: np.ndarray | None = None, periods: tuple[float, float] | None = None
) -> np.ndarray:
    """Bond relaxation g6(t) = Re <psi6*(0) psi6(t)> of a grain, over grains and frames.

    It is constant in a crystal, falls algebraically in the hexatic phase and exponentially in a
    liquid (Zahn and Maret, Phys. Rev. Lett. 85, 3656, 2000). Grains count that have an interior
    cell in both frames.

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions of the grains in each frame [m]; NaN for absent grains.
    lags : int (k,), optional
        Numbers of frames, 1 to f - 1; about 30 at even ratios if not given.
    periods : (float, float), optional
        Sides of a periodic cell [m], above 0, into which positions are brought back. Neighbours are
        looked for within it, not across its sides.

    Returns
    -------
    float64 (k,)
        Correlation at each lag, without unit.

    Raises
    ------
    InputError
        If a shape, lag or period does not fit, there are fewer than two frames, or no grain has an
        interior cell in both of two frames that lie a lag apart.
    """
    frames = check_frames(frames, least=2)
    lags = check_lags(lags, len(frames))
    orders = np.full(frames.shape[:2], complex(np.nan, np.nan))
    for k, positions in enumerate(frames if periods is None else np.mod(frames, check_periods(periods))):
        cells = voronoi_cells(positions)
        orders[k, cells.interior] = local_psi6(positions, cells)[cells.interior]
    result = []
    for lag in lags:
        products = (orders[:-lag].conj() * orders[lag:]).real
        products = products[np.isfinite(products)]
        if not len(products):
            raise InputError(f"no grain has interior cells {lag} frames apart; take shorter lags")
        result.append(products.mean())
    return np.array(result)
