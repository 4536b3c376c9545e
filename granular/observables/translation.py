"""The correlation of translational order g_T(r)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.correlation_of_run import (
    in_each_frame,
    mean_of_frames,
    mean_per_pair,
    on_distance,
)
from granular.observables.frames import present_positions
from granular.observables.pairs_in_bins import (
    binned_pairs,
    binned_products,
    checked_edges,
    default_edges,
)
from granular.observables.structure import lattice_vector
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


class TranslationalCorrelation(NamedTuple):
    """g_T(r) in bins (lower edge, upper edge].

    Attributes
    ----------
    edges : float (k + 1,)
        [m]
    g : float (k,)
        NaN in bins without pairs.
    pairs : int (k,)
        Pairs i < j.
    """

    edges: np.ndarray
    g: np.ndarray
    pairs: np.ndarray


def translational_order(positions: np.ndarray, vector: np.ndarray | None = None) -> float:
    """|mean of exp(i G r)| over the grains: 1 for a crystal at rest, about n^(-1/2) for a liquid.

    Parameters
    ----------
    positions : float (n, 2)
        [m]; NaN for absent grains.
    vector : float (2,), optional
        G, a reciprocal lattice vector [1/m]; `lattice_vector` of the positions if not given.

    Raises
    ------
    InputError
        If the positions have another shape, or no grain has an interior cell.
    """
    points = present_positions(positions)
    wave = lattice_vector(points) if vector is None else np.asarray(vector, dtype=np.float64)
    return float(abs(np.exp(1j * (points @ wave)).mean()))


def translational_correlation(
    positions: np.ndarray, edges: np.ndarray | None = None, vector: np.ndarray | None = None
) -> TranslationalCorrelation:
    """g_T(r) = Re <exp(i G (r_i - r_j))>, the mean over pairs of grains at the distance r.

    It tends to a constant or falls algebraically in a crystal in two dimensions, and falls
    exponentially where dislocations are free (Nelson and Halperin, Phys. Rev. B 19, 2457, 1979).

    Parameters
    ----------
    positions : float (n, 2)
        [m]; NaN for absent grains.
    edges : float (k + 1,), optional
        Of the bins [m]; as for `radial_distribution` if not given.
    vector : float (2,), optional
        As of `translational_order`.

    Raises
    ------
    InputError
        If the edges do not increase, or no grain has an interior cell.
    """
    points = present_positions(positions)
    edges = default_edges(points) if edges is None else checked_edges(edges)
    wave = lattice_vector(points) if vector is None else np.asarray(vector, dtype=np.float64)
    if wave.shape != (2,):
        raise InputError(f"the wave vector has the shape {wave.shape}; (2,) is wanted")
    phase = points @ wave
    products = binned_products(points, np.cos(phase), edges) + binned_products(
        points, np.sin(phase), edges
    )
    pairs = binned_pairs(points, edges)
    return TranslationalCorrelation(edges, mean_per_pair(products, pairs), pairs)


def translational_correlation_of_run(
    run: Trajectory,
    edges: np.ndarray | None = None,
    start: float = 0.0,
    stop: float = np.inf,
) -> xarray.DataArray:
    """g_T(r) over all pairs of the frames with start <= time <= stop [s].

    Each frame has the reciprocal lattice vector of its own order.

    Returns
    -------
    xarray.DataArray
        On ``distance``, the middle of the bins [m].

    Raises
    ------
    InputError
        As `translational_correlation`, and where there is no such frame.
    """
    found = in_each_frame(translational_correlation, run, edges, start, stop)
    values = mean_of_frames([one.g for one in found], [one.pairs for one in found])
    return on_distance(values, found[0].edges, "correlation of translational order g_T(r)")
