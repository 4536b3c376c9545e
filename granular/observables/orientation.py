"""Order of bonds: axial order of directions, the correlation g6(r) and g6(t)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.bond_order import local_psi6
from granular.observables.correlation import (
    binned_pairs,
    binned_products,
    checked_edges,
    default_edges,
    in_each_frame,
    mean_of_frames,
    mean_per_pair,
    on_distance,
)
from granular.observables.displacement import checked_frames, checked_lags, over_lags_of_run
from granular.observables.frames import checked_positions
from granular.observables.voronoi import VoronoiCells, voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


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


def bond_relaxation(frames: np.ndarray, lags: np.ndarray | None = None) -> np.ndarray:
    """g6(t) = Re <psi6*(0) psi6(t)> of one grain, over grains and frames (k,).

    It is constant in a crystal, falls algebraically in the hexatic phase and exponentially in a
    liquid (Zahn and Maret, Phys. Rev. Lett. 85, 3656, 2000). Grains count that have an interior
    cell in both frames.

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions [m]; NaN for absent grains.
    lags : int (k,), optional
        Numbers of frames; about 30 at even ratios if not given.

    Raises
    ------
    InputError
        If a shape or lag does not fit, or no grain has an interior cell in two such frames.
    """
    frames = checked_frames(frames)
    lags = checked_lags(lags, len(frames))
    orders = np.full(frames.shape[:2], complex(np.nan, np.nan))
    for k, one in enumerate(frames):
        cells = voronoi_cells(one)
        orders[k, cells.interior] = local_psi6(one, cells)[cells.interior]
    found = []
    for lag in lags:
        products = (orders[:-lag].conj() * orders[lag:]).real
        products = products[np.isfinite(products)]
        if not len(products):
            raise InputError(f"no grain has interior cells {lag} frames apart; take shorter lags")
        found.append(products.mean())
    return np.array(found)


def bond_relaxation_of_run(
    run: Trajectory, start: float = 0.0, stop: float = np.inf
) -> xarray.DataArray:
    """`bond_relaxation` over the frames with start <= time <= stop [s], on ``lag`` [s].

    Raises
    ------
    InputError
        As `bond_relaxation`, and if the frames are not evenly spaced in time.
    """

    def measure(frames: np.ndarray, lags: np.ndarray) -> np.ndarray:
        return bond_relaxation(run.scene.cell.inside(frames), lags)

    return over_lags_of_run(run, measure, start, stop, "1", "relaxation of bond orientation g6(t)")
