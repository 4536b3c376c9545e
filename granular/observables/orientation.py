"""The correlation of bond orientation g6(r)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.bond_order import local_psi6
from granular.observables.correlation_of_run import (
    in_each_frame,
    mean_of_frames,
    mean_per_pair,
    on_distance,
)
from granular.observables.frames import checked_positions
from granular.observables.pairs_in_bins import (
    binned_pairs,
    binned_products,
    checked_edges,
    default_edges,
)
from granular.observables.voronoi import VoronoiCells, voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


class BondCorrelation(NamedTuple):
    """g6(r) in bins (lower edge, upper edge].

    Attributes
    ----------
    edges : float (k + 1,)
        [m]
    g6 : float (k,)
        NaN in bins without pairs.
    pairs : int (k,)
        Pairs i < j of grains with an interior cell.
    """

    edges: np.ndarray
    g6: np.ndarray
    pairs: np.ndarray


def bond_correlation(
    positions: np.ndarray, edges: np.ndarray | None = None, cells: VoronoiCells | None = None
) -> BondCorrelation:
    """g6(r) = Re <psi6*(0) psi6(r)>, the mean over pairs of grains at the distance r.

    It is constant in a crystal, falls algebraically in the hexatic phase and exponentially in a
    liquid (Nelson and Halperin, Phys. Rev. B 19, 2457, 1979). A mean over pairs needs no correction
    at the rim. Only grains with an interior Voronoi cell count.

    Parameters
    ----------
    positions : float (n, 2)
        [m]; NaN for absent grains.
    edges : float (k + 1,), optional
        Of the bins [m]; as for `radial_distribution` if not given.
    cells : VoronoiCells, optional
        Of the same positions, where they are there already.

    Raises
    ------
    InputError
        If the edges do not increase, or fewer than two grains have an interior cell.
    """
    positions = checked_positions(positions)
    edges = default_edges(positions) if edges is None else checked_edges(edges)
    cells = voronoi_cells(positions) if cells is None else cells
    inside = np.flatnonzero(cells.interior)
    if len(inside) < 2:
        raise InputError(f"{len(inside)} grains have an interior cell; g6(r) needs at least 2")
    points, order = positions[inside], local_psi6(positions, cells)[inside]
    products = binned_products(points, order.real, edges) + binned_products(
        points, order.imag, edges
    )
    pairs = binned_pairs(points, edges)
    return BondCorrelation(edges, mean_per_pair(products, pairs), pairs)


def bond_correlation_of_run(
    run: Trajectory,
    edges: np.ndarray | None = None,
    start: float = 0.0,
    stop: float = np.inf,
) -> xarray.DataArray:
    """g6(r) over all pairs of the frames with start <= time <= stop [s].

    Returns
    -------
    xarray.DataArray
        On ``distance``, the middle of the bins [m].

    Raises
    ------
    InputError
        As `bond_correlation`, and where there is no such frame.
    """
    found = in_each_frame(bond_correlation, run, edges, start, stop)
    values = mean_of_frames([one.g6 for one in found], [one.pairs for one in found])
    return on_distance(values, found[0].edges, "correlation of bond orientation g6(r)")
