"""Correlations: Pearson's, of Psi6 and hexagons over a run, and of a quantity over distance."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from granular.observables.bond_order import psi6
from granular.observables.frames import (
    checked_positions,
    chosen_frames,
    frame_positions,
    spanned_box,
    values_of_grains,
)
from granular.observables.voronoi import cell_shares, voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


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


class Correlation(NamedTuple):
    """Pearson's correlation.

    Attributes
    ----------
    coefficient : float
        From -1 to 1; NaN where one of the quantities does not vary.
    p_value : float
        Probability of a coefficient this far from 0 for independent, normally distributed samples.
    samples : int
        How many there were.
    """

    coefficient: float
    p_value: float
    samples: int


def pearson_correlation(first: np.ndarray, second: np.ndarray) -> Correlation:
    """Pearson's correlation of two quantities, such as Psi6 and n6 of many beds [D, Fig. 4.13].

    Parameters
    ----------
    first, second : float (n,)
        Samples where one is NaN are ignored.

    Raises
    ------
    InputError
        If the shapes differ, or fewer than three samples are left.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import pearson_correlation
    >>> first = np.arange(10.0)
    >>> round(pearson_correlation(first, 2.0 * first)[0], 3)
    1.0
    """
    from scipy.special import stdtr

    x, y = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if x.ndim != 1 or x.shape != y.shape:
        raise InputError(f"the shapes {x.shape} and {y.shape} differ; give two arrays (n,)")
    known = np.isfinite(x) & np.isfinite(y)
    count = int(np.count_nonzero(known))
    if count < 3:
        raise InputError(f"{count} samples; a correlation needs at least 3")
    x, y = x[known] - x[known].mean(), y[known] - y[known].mean()
    size = np.linalg.norm(x) * np.linalg.norm(y)
    if size == 0.0:
        return Correlation(np.nan, np.nan, count)
    r = float(np.clip(x @ y / size, -1.0, 1.0))
    free = count - 2
    # (1 - r)(1 + r) loses fewer bits than 1 - r^2; an exact line has an infinite t.
    rest = (1.0 - r) * (1.0 + r)
    t = np.inf if rest == 0.0 else abs(r) * np.sqrt(free / rest)
    return Correlation(r, float(2.0 * stdtr(free, -t)), count)


def order_correlation_of_run(run: Trajectory) -> Correlation:
    """`pearson_correlation` of Psi6 and the share of hexagons over the frames of a run.

    Frames that follow each other are no independent samples, so that the p-value is too small; over
    runs of different beds, as in [D, Fig. 4.13], use `pearson_correlation`.

    Raises
    ------
    InputError
        If fewer than three frames have interior cells.
    """
    orders, shares = [], []
    for positions in frame_positions(run):
        cells = voronoi_cells(positions)
        orders.append(psi6(positions, cells))
        shares.append(cell_shares(cells).hexagons)
    return pearson_correlation(np.array(orders), np.array(shares))


class ValueCorrelation(NamedTuple):
    """The correlation of a value of the grains in bins (lower edge, upper edge].

    Attributes
    ----------
    edges : float (k + 1,)
        [m]
    correlation : float (k,)
        1 where both have the same deviation from the mean, 0 where they know nothing of each other;
        NaN in bins without pairs.
    pairs : int (k,)
        Pairs i < j.
    """

    edges: np.ndarray
    correlation: np.ndarray
    pairs: np.ndarray


def value_correlation(
    positions: np.ndarray, values: np.ndarray, edges: np.ndarray | None = None
) -> ValueCorrelation:
    """<dv(0) dv(r)> / <dv^2> with dv the deviation of a grain's value from the mean.

    In mixtures take values over the mean of their species, or the order of the species is what is
    found.

    Parameters
    ----------
    positions : float (n, 2)
        [m]
    values : float (n,)
        Grains whose value or position is NaN are left out.
    edges : float (k + 1,), optional
        Of the bins [m]; as for `radial_distribution` if not given.

    Raises
    ------
    InputError
        If shapes or edges do not fit, or all values are the same.
    """
    positions = checked_positions(positions)
    values = values_of_grains("values", values, len(positions))
    known = np.isfinite(positions).all(axis=1) & np.isfinite(values)
    points, deviation = (
        positions[known],
        values[known] - (values[known].mean() if known.any() else 0.0),
    )
    edges = default_edges(points) if edges is None else checked_edges(edges)
    variance = float(np.mean(deviation**2)) if len(points) else 0.0
    if not variance > 0.0:
        raise InputError("the values do not differ; there is nothing to correlate")
    pairs, products = binned_pairs(points, edges), binned_products(points, deviation, edges)
    found = np.where(pairs > 0, products / np.maximum(pairs, 1) / variance, np.nan)
    return ValueCorrelation(edges, found, pairs)


Found = TypeVar("Found")


def in_each_frame(
    correlation: Callable[[np.ndarray, np.ndarray], Found],
    run: Trajectory,
    edges: np.ndarray | None,
    start: float,
    stop: float,
) -> list[Found]:
    """A correlation of the frames with start <= time <= stop [s], all in the same bins.

    Raises
    ------
    InputError
        As the correlation, and where there is no such frame.
    """
    chosen = run.dataset["position"].values[chosen_frames(run, start, stop)]
    frames = spanning(run.scene.cell.inside(chosen))
    if edges is None:
        edges = min((default_edges(one) for one in frames), key=lambda found: float(found[-1]))
    return [correlation(one, edges) for one in frames]


def mean_per_pair(total: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """NaN in bins without pairs."""
    return np.where(pairs > 0, total / np.maximum(pairs, 1), np.nan)


def mean_of_frames(values: list[np.ndarray], pairs: list[np.ndarray]) -> np.ndarray:
    """The mean over all pairs of all frames, of the means over the pairs of each."""
    total = np.sum(
        [np.where(count > 0, one * count, 0.0) for one, count in zip(values, pairs, strict=True)],
        axis=0,
    )
    return mean_per_pair(total, np.sum(pairs, axis=0))


def on_distance(values: np.ndarray, edges: np.ndarray, name: str) -> xarray.DataArray:
    """Values of bins on ``distance``, the middle of the bins [m]."""
    import xarray

    return xarray.DataArray(
        values,
        dims="distance",
        coords={"distance": ("distance", 0.5 * (edges[:-1] + edges[1:]), {"units": "m"})},
        attrs={"units": "1", "long_name": name},
    )
