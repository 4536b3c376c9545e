"""Functions of the distance of two grains: g(r), spatial correlations, and means over a run."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.frame import (
    bounding_box,
    check_grain_values,
    check_vectors,
    is_present,
    labelled_array,
    observable,
    observable_metadata,
    present_positions,
    select_frames,
)
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray
    from jaxtyping import Float, Int

    from granular.run.trajectory import Trajectory

FARTHEST = 10.0
"""Default of the greatest distance, in mean spacings: farther, large beds would be slow."""

# Together a tenth of a spacing a bin.
BINS = 100


class PairDistanceFunction(NamedTuple):
    """A function of the distance of two grains, in bins (lower edge, upper edge]."""

    edges: Float[np.ndarray, "k+1"]  # edges of the bins [m], increasing
    values: Float[np.ndarray, "k"]  # NaN in bins without pairs, if it is a mean over pairs
    pairs: Int[np.ndarray, "k"]  # pairs i < j in each bin
    weights: Float[np.ndarray, "k"]  # of frames in a mean over them: the pairs, or those expected


def per_distance(
    run: Trajectory,
    function: Callable[[np.ndarray, np.ndarray], PairDistanceFunction],
    edges: np.ndarray | None = None,
    start: float = 0.0,
    stop: float = np.inf,
) -> xarray.DataArray:
    """Evaluate a function of the distance over all pairs of the frames with start <= time <= stop.

    Parameters
    ----------
    run : Trajectory
        Finished run, or one that was cut off.
    function : function of positions (n, 2) [m] and edges (k + 1,) [m]
        `radial_distribution` or `bond_correlation`, or one's own.
        Each frame has its own box.
    edges : float (k + 1,), optional
        Edges of the bins [m], increasing from 0 or more; if not given, the default ones of the frame whose
        edges reach least.
    start, stop : float
        First and last time of the frames [s].

    Returns
    -------
    xarray.DataArray
        Mean over the frames, weighted by their pairs (see `PairDistanceFunction`), on ``distance``, the
        middle of the bins [m]; NaN in bins without pairs; with unit and meaning if the function is an
        `observable`. Frames in which the grains span no box are left out.

    Raises
    ------
    InputError
        As the function, and if no frame lies in the range, or in none the grains span a box.
    """
    chosen = run.dataset["position"].values[select_frames(run, start, stop)]
    frames = box_spanning_frames(run.scene.cell.wrap_positions(chosen))
    if edges is None:
        edges = min((default_bin_edges(frame) for frame in frames), key=lambda some: float(some[-1]))
    parts = [function(frame, edges) for frame in frames]
    total = np.sum([np.where(p.weights > 0, p.values * p.weights, 0.0) for p in parts], axis=0)
    values = divide_by_pair_count(total, np.sum([part.weights for part in parts], axis=0))
    middle = 0.5 * (parts[0].edges[:-1] + parts[0].edges[1:])
    coordinates = {"distance": ("distance", middle, {"units": "m"})}
    return labelled_array(values, "distance", coordinates, observable_metadata(function))


def check_bin_edges(edges: Float[np.ndarray, "k+1"]) -> Float[np.ndarray, "k+1"]:
    """Check the edges of distance bins, and convert them [m]; edges [m]."""
    array = np.asarray(edges, dtype=np.float64)
    if array.ndim != 1 or len(array) < 2 or not (np.diff(array) > 0.0).all() or array[0] < 0.0:
        raise InputError("edges must be at least two distances that increase from 0 m up; sort them")
    return array


def default_bin_edges(positions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "BINS+1"]:
    """Choose bins up to half the box's shorter side or `FARTHEST` spacings [m]; positions (n, 2) [m]."""
    low, high = bounding_box(positions)
    sides = high - low
    if not (sides > 0.0).all():
        raise InputError("the grains span no box; at least two grains not in a row are needed")
    count = int(is_present(positions).sum())
    spacing = float(np.sqrt(np.prod(sides) / count))
    return np.linspace(0.0, min(0.5 * float(sides.min()), FARTHEST * spacing), BINS + 1)


def box_spanning_frames(frames: Float[np.ndarray, "f n 2"]) -> list[np.ndarray]:
    """Select the frames (n, 2) whose grains span a box, as the last ones of an emptying cell do not [m]."""
    result = [frame for frame in frames if (np.ptp(bounding_box(frame), axis=0) > 0.0).all()]
    if not result:
        raise InputError("in no frame do the grains span a box; give frames with more grains")
    return result


def count_pairs(points: Float[np.ndarray, "n 2"], edges: Float[np.ndarray, "k+1"]) -> Int[np.ndarray, "k"]:
    """Count the pairs i < j in each bin (lower edge, upper edge] of their distance; points, edges [m]."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    return np.diff(tree.count_neighbors(tree, edges)) // 2


def mean_over_pairs(
    points: Float[np.ndarray, "n 2"], products: Float[np.ndarray, "k"], edges: Float[np.ndarray, "k+1"]
) -> PairDistanceFunction:
    """Divide sums over the pairs of each bin by the number of these pairs; points, edges [m]."""
    pairs = count_pairs(points, edges)
    return PairDistanceFunction(edges, divide_by_pair_count(products, pairs), pairs, pairs)


def divide_by_pair_count(total: Float[np.ndarray, "k"], pairs: np.ndarray) -> Float[np.ndarray, "k"]:
    """Divide sums by numbers of pairs, with NaN where there are no pairs."""
    return np.divide(total, pairs, out=np.full(len(total), np.nan), where=pairs > 0)


def sum_pair_products(
    points: Float[np.ndarray, "n 2"], values: Float[np.ndarray, "n"], edges: Float[np.ndarray, "k+1"]
) -> Float[np.ndarray, "k"]:
    """Sum v_i v_j over the pairs i < j in each bin (lower edge, upper edge] of distance; edges [m]."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    sums = tree.count_neighbors(tree, edges, weights=(values, values), cumulative=False)
    # Entry 0 holds the distances up to the first edge; each pair is counted from both ends.
    return np.asarray(0.5 * sums[1:])


@observable("1", "radial distribution function g(r)")
def radial_distribution(
    positions: np.ndarray, edges: np.ndarray | None = None, box: np.ndarray | None = None
) -> PairDistanceFunction:
    """Radial distribution g(r): pairs counted over pairs expected without any order, bin by bin.

    The expectation is exact for N grains in a rectangle a x b, so that no grain need be left out at
    the rim and g is 1 on average for grains without order, at every distance up to the shorter
    side: the set covariance of the rectangle, a b - (2/pi) (a + b) r + r^2/pi, weighs 2 pi r dr
    (Ohser and Stoyan, Biom. J. 23, 523, 1981; Ghosh, Bull. Calcutta Math. Soc. 43, 17, 1951), and
    is integrated over each bin.

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.
    edges : float (k + 1,), optional
        Edges of the bins [m], increasing from 0 or more; 100 bins up to half the shorter side of the box of
        the outermost centres (or 10 mean spacings, where that is less) if not given.
    box : float (2, 2), optional
        Lowest and highest x and y of the rectangle that the grains could be in [m]; that of the
        outermost centres if not given.

    Returns
    -------
    PairDistanceFunction
        Function g of each bin (k,), without unit, 0 in bins without pairs, and the number of its pairs.

    Raises
    ------
    InputError
        If positions or box have another shape, the edges do not increase from 0 m or more or reach beyond
        the shorter side of the box, a grain lies outside of the box, there are fewer than two, or they span
        no box (without ``edges`` or ``box``).

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import radial_distribution
    >>> g = radial_distribution(places)
    >>> bool(g.values.max() > 1.0)
    True
    """
    points = present_positions(positions)
    if len(points) < 2:
        raise InputError(f"{len(points)} grains; g(r) needs at least 2")
    edges = default_bin_edges(points) if edges is None else check_bin_edges(edges)
    box = bounding_box(points) if box is None else np.asarray(box, dtype=np.float64)
    if box.shape != (2, 2):
        raise InputError(f"the box has the shape {box.shape}; (2, 2) is wanted: lowest and highest x and y")
    low, high = box
    if not ((points >= low) & (points <= high)).all():
        raise InputError("a grain lies outside of the box; give a box that holds all grains")
    pairs = count_pairs(points, edges)
    expected = _expected_pair_counts(len(points), high - low, edges)
    return PairDistanceFunction(edges, pairs / expected, pairs, expected)


def _expected_pair_counts(count: int, sides: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Pairs i < j in each bin, of grains that are independent and uniform in a rectangle."""
    a, b = (float(side) for side in sides)
    if edges[-1] > min(a, b) * (1.0 + 1e-12):
        raise InputError(
            f"the last edge, {edges[-1]:.6g} m, is beyond the shorter side of the box, "
            f"{min(a, b):.6g} m, up to which g(r) is exact; give smaller edges"
        )
    # The overlap (a - |x|)(b - |y|) of the box with itself, moved by (x, y), over the disc of radius r: exact
    # while r is below both sides.
    nearer = np.pi * a * b * edges**2 - 4.0 / 3.0 * (a + b) * edges**3 + 0.5 * edges**4
    return np.asarray(0.5 * count * (count - 1) * np.diff(nearer) / (a * b) ** 2)


@observable("1", "spatial correlation")
def spatial_correlation(
    positions: np.ndarray, values: np.ndarray, edges: np.ndarray | None = None
) -> PairDistanceFunction:
    """Spatial correlation <dv(0) dv(r)>/<dv^2>, dv being a grain's deviation from the mean value.

    It is Pearson's correlation of pairs at a distance, with the mean and variance of all grains: positive
    where both deviate the same way, and 0 where they are independent. In mixtures take values over the
    mean of their species, or the order of the species is what is found.

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent ones.
    values : float (n,)
        Value v of each grain, of any unit; grains whose value or position is not finite are left out.
    edges : float (k + 1,), optional
        Edges of the bins [m]; as for `radial_distribution` if not given.

    Returns
    -------
    PairDistanceFunction
        Correlation of each bin (k,), without unit, NaN in bins without pairs, and the number of its pairs.

    Raises
    ------
    InputError
        If a shape does not fit, the edges do not increase from 0 m or more, all values are the same, or,
        without ``edges``, the grains that count span no box.
    """
    positions = check_vectors(positions)
    values = check_grain_values("values", values, len(positions))
    known = is_present(positions) & np.isfinite(values)
    points, deviation = (positions[known], values[known] - (values[known].mean() if known.any() else 0.0))
    edges = default_bin_edges(points) if edges is None else check_bin_edges(edges)
    variance = float(np.mean(deviation**2)) if len(points) else 0.0
    if not variance > 0.0:
        raise InputError("the values do not differ; there is nothing to correlate")
    pairs, products = count_pairs(points, edges), sum_pair_products(points, deviation, edges)
    return PairDistanceFunction(edges, divide_by_pair_count(products, pairs) / variance, pairs, pairs)
