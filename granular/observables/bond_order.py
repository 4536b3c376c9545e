"""Bond-orientational order: Psi6 of each grain and of the bed, its susceptibility, g6(r), g6(t)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.frame import (
    bounding_box,
    checked_frames,
    checked_grain_values,
    checked_or_default_lags,
    checked_period_lengths,
    checked_vectors,
    labelled_array,
    observable,
    observable_metadata,
    present_grain_mask,
    present_positions,
    select_frame_indices,
    sum_by_index,
)
from granular.observables.voronoi import VoronoiCells, checked_positions_and_cells, voronoi_cells
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


MAXIMUM_SPACINGS = 10.0
"""Default maximum pair distance, in mean grain spacings; it limits the computing time in large beds."""

# With `MAXIMUM_SPACINGS`, a bin is a tenth of a spacing wide.
BINS = 100


class PairDistanceFunction(NamedTuple):
    """Function of the distance between two grains, with one value for each bin (lower edge, upper edge]."""

    edges: Float[np.ndarray, "k+1"]  # edges of the bins [m], increasing
    values: Float[np.ndarray, "k"]  # NaN in bins without pairs, if it is a mean over pairs
    pairs: Int[np.ndarray, "k"]  # pairs i < j in each bin
    weights: Float[
        np.ndarray, "k"
    ]  # weight of this frame in a mean over frames: number of pairs, or of expected pairs


def per_distance(
    run: Trajectory,
    function: Callable[[np.ndarray, np.ndarray], PairDistanceFunction],
    edges: np.ndarray | None = None,
    start: float = 0.0,
    stop: float = np.inf,
) -> xarray.DataArray:
    """Average a function of the pair distance over the frames with start <= time <= stop.

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.
    function : function of positions (n, 2) [m] and edges (k + 1,) [m]
        `radial_distribution`, `bond_correlation` or a user-defined function. The box is determined for each
        frame separately.
    edges : float (k + 1,), optional
        Edges of the bins [m], increasing from 0 or more. If not given, default edges are computed for each
        frame, and those with the smallest last edge are used for all frames.
    start, stop : float
        First and last time of the frames [s].

    Returns
    -------
    xarray.DataArray
        Mean over the frames, weighted by their numbers of pairs (see `PairDistanceFunction`), as a function
        of ``distance``, the centres of the bins [m]; NaN in bins without pairs. Unit and meaning are attached
        if the function is an `observable`. Frames in which the bounding box of the grains has no area are
        omitted.

    Raises
    ------
    InputError
        If no frame lies in the range, the bounding box of the grains has no area in any frame, or the
        function raises this error.
    """
    chosen = run.dataset["position"].values[select_frame_indices(run, start, stop)]
    frames = box_spanning_frames(run.scene.cell.wrap_positions(chosen))
    if edges is None:
        edges = min((default_bin_edges(frame) for frame in frames), key=lambda some: float(some[-1]))
    parts = [function(frame, edges) for frame in frames]
    total = np.sum([np.where(p.weights > 0, p.values * p.weights, 0.0) for p in parts], axis=0)
    values = divide_by_pair_count(total, np.sum([part.weights for part in parts], axis=0))
    middle = 0.5 * (parts[0].edges[:-1] + parts[0].edges[1:])
    coordinates = {"distance": ("distance", middle, {"units": "m"})}
    return labelled_array(values, "distance", coordinates, observable_metadata(function))


def checked_bin_edges(edges: Float[np.ndarray, "k+1"]) -> Float[np.ndarray, "k+1"]:
    """Check the edges of distance bins [m], and convert them to an array."""
    array = np.asarray(edges, dtype=np.float64)
    if array.ndim != 1 or len(array) < 2 or not (np.diff(array) > 0.0).all() or array[0] < 0.0:
        raise InputError(
            "the edges must be 2 or more increasing distances, none below 0 m; correct the edges"
        )
    return array


def default_bin_edges(positions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "BINS+1"]:
    """Choose bin edges [m] up to half the box's shorter side, at most `MAXIMUM_SPACINGS` mean spacings."""
    low, high = bounding_box(positions)
    sides = high - low
    if not (sides > 0.0).all():
        raise InputError(
            "the bounding box of the grains has no area; pass 2 or more grains that differ in both x and y"
        )
    count = int(present_grain_mask(positions).sum())
    spacing = float(np.sqrt(np.prod(sides) / count))
    return np.linspace(0.0, min(0.5 * float(sides.min()), MAXIMUM_SPACINGS * spacing), BINS + 1)


def box_spanning_frames(frames: Float[np.ndarray, "f n 2"]) -> list[np.ndarray]:
    """Select the frames (n, 2) [m] in which the bounding box of the grains has an area above 0."""
    result = [frame for frame in frames if (np.ptp(bounding_box(frame), axis=0) > 0.0).all()]
    if not result:
        raise InputError("the bounding box of the grains has no area in any frame; use a larger bed")
    return result


def count_pairs(points: Float[np.ndarray, "n 2"], edges: Float[np.ndarray, "k+1"]) -> Int[np.ndarray, "k"]:
    """Count the pairs i < j whose distance lies in each bin (lower edge, upper edge]; all lengths in m."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    return np.diff(tree.count_neighbors(tree, edges)) // 2


def divide_by_pair_count(total: Float[np.ndarray, "k"], pairs: np.ndarray) -> Float[np.ndarray, "k"]:
    """Divide the sum in each bin by its number of pairs; NaN for 0 pairs."""
    return np.divide(total, pairs, out=np.full(len(total), np.nan), where=pairs > 0)


def sum_pair_products(
    points: Float[np.ndarray, "n 2"], values: Float[np.ndarray, "n"], edges: Float[np.ndarray, "k+1"]
) -> Float[np.ndarray, "k"]:
    """Sum v_i v_j over the pairs i < j whose distance lies in each bin (lower edge, upper edge] [m]."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    sums = tree.count_neighbors(tree, edges, weights=(values, values), cumulative=False)
    # Entry 0 counts the distances up to the first edge. Each pair is counted twice, once from each grain.
    return np.asarray(0.5 * sums[1:])


@observable("1", "radial distribution function g(r)")
def radial_distribution(
    positions: np.ndarray, edges: np.ndarray | None = None, box: np.ndarray | None = None
) -> PairDistanceFunction:
    """Radial distribution g(r): pairs in each bin, divided by the number expected for random positions.

    The expected number is exact for N grains in a rectangle a x b. For each bin, 2 pi r dr is weighted by the
    set covariance of the rectangle, a b - (2/pi) (a + b) r + r^2/pi, and integrated over the bin (Ohser and
    Stoyan, Biom. J. 23, 523, 1981; Ghosh, Bull. Calcutta Math. Soc. 43, 17, 1951). Grains at the rim are
    therefore included, and for random positions the mean of g is 1 at every distance up to the shorter side.

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.
    edges : float (k + 1,), optional
        Edges of the bins [m], increasing from 0 or more. If not given, there are 100 bins. They extend to
        half the shorter side of the bounding box of the centres, but to at most 10 mean spacings.
    box : float (2, 2), optional
        Lowest and highest x and y of the rectangle available to the grains [m]; the bounding box of the
        centres if not given.

    Returns
    -------
    PairDistanceFunction
        Value of g in each bin (k,), dimensionless, 0 in bins without pairs, and the number of pairs.

    Raises
    ------
    InputError
        If the shape of positions or box is wrong, there are fewer than two grains, or a grain lies outside
        the box. Also if the edges do not increase from 0 m or more, or exceed the shorter side of the box;
        or, without ``edges`` or ``box``, if the bounding box of the grains has no area.

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
        raise InputError(f"{len(points)} grains; g(r) needs 2 or more")
    edges = default_bin_edges(points) if edges is None else checked_bin_edges(edges)
    box = bounding_box(points) if box is None else np.asarray(box, dtype=np.float64)
    if box.shape != (2, 2):
        raise InputError(
            f"the box has the shape {box.shape}; pass the shape (2, 2): lowest and highest x and y"
        )
    low, high = box
    if not ((points >= low) & (points <= high)).all():
        raise InputError("a grain lies outside the box; use a box that contains all grains")
    pairs = count_pairs(points, edges)
    expected = _expected_pair_counts(len(points), high - low, edges)
    return PairDistanceFunction(edges, pairs / expected, pairs, expected)


def _expected_pair_counts(count: int, sides: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Compute the expected number of pairs i < j in each bin for uniformly random grains in a rectangle."""
    a, b = (float(side) for side in sides)
    if edges[-1] > min(a, b) * (1.0 + 1e-12):
        raise InputError(
            f"the last edge, {edges[-1]:.6g} m, exceeds the shorter side of the box, "
            f"{min(a, b):.6g} m, beyond which g(r) is not exact; use smaller edges"
        )
    # Integral over the disc of radius r of the overlap (a - |x|)(b - |y|) of the box with a copy shifted by
    # (x, y); exact for r below both sides.
    within = np.pi * a * b * edges**2 - 4.0 / 3.0 * (a + b) * edges**3 + 0.5 * edges**4
    return np.asarray(0.5 * count * (count - 1) * np.diff(within) / (a * b) ** 2)


@observable("1", "spatial correlation")
def spatial_correlation(
    positions: np.ndarray, values: np.ndarray, edges: np.ndarray | None = None
) -> PairDistanceFunction:
    """Spatial correlation <dv(0) dv(r)>/<dv^2>, where dv is a grain's value minus the mean value.

    This is Pearson's correlation coefficient of pairs at the distance r, with the mean and variance of all
    grains. A positive correlation means that both grains tend to deviate in the same direction; independent
    values give 0. In mixtures, first divide each value by the mean of its species; otherwise the result
    mainly shows how the species are arranged.

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent ones.
    values : float (n,)
        Value v of each grain, in any unit; grains whose value or position is not finite are ignored.
    edges : float (k + 1,), optional
        Edges of the bins [m]; as for `radial_distribution` if not given.

    Returns
    -------
    PairDistanceFunction
        Correlation in each bin (k,), dimensionless, NaN in bins without pairs, and the number of pairs.

    Raises
    ------
    InputError
        If a shape does not match, the edges do not increase from 0 m or more, all values are equal, or,
        without ``edges``, the bounding box of the grains with values has no area.
    """
    positions = checked_vectors(positions)
    values = checked_grain_values("values", values, len(positions))
    known = present_grain_mask(positions) & np.isfinite(values)
    points, deviation = (positions[known], values[known] - (values[known].mean() if known.any() else 0.0))
    edges = default_bin_edges(points) if edges is None else checked_bin_edges(edges)
    variance = float(np.mean(deviation**2)) if len(points) else 0.0
    if not variance > 0.0:
        raise InputError("all values are equal, and their correlation is undefined; pass values that differ")
    pairs, products = count_pairs(points, edges), sum_pair_products(points, deviation, edges)
    return PairDistanceFunction(edges, divide_by_pair_count(products, pairs) / variance, pairs, pairs)


def local_psi6(positions: np.ndarray, cells: VoronoiCells | None = None) -> np.ndarray:
    """Complex bond order of each grain: mean of exp(6 i theta) over its Voronoi neighbours.

    Here theta is the angle between the bond and the x axis (Nelson and Halperin, Phys. Rev. B 19, 2457,
    1979).

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent ones.
    cells : VoronoiCells, optional
        Voronoi cells of these positions, if already computed.

    Returns
    -------
    complex128 (n,)
        Order of each grain, dimensionless, of modulus 1 or less. NaN for absent grains and for grains without
        neighbours. Grains at the rim also have a value; ``cells.interior`` is False for them.

    Raises
    ------
    InputError
        If the positions do not have the shape (n, 2), or ``cells`` has another number of grains.

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
    positions, cells = checked_positions_and_cells(positions, cells)
    i, j = cells.neighbours.T
    arm = positions[j] - positions[i]
    bond = arm[:, 0] + 1j * arm[:, 1]
    # exp(6 i theta) is the same for both directions of a bond.
    rotation = (bond / np.abs(bond)) ** 6
    total = sum_by_index(i, rotation, len(positions)) + sum_by_index(j, rotation, len(positions))
    known = cells.sides > 0
    local = np.full(len(positions), complex(np.nan, np.nan))
    local[known] = total[known] / cells.sides[known]
    return local


def psi6(positions: np.ndarray, cells: VoronoiCells | None = None) -> float:
    """Psi6 = mean of |local Psi6| over the grains with an interior cell [D, eq. 4.28].

    Psi6 is 1 for perfect hexagonal order, even if parts of the bed differ in orientation.

    Parameters
    ----------
    positions : float64 (n, 2)
        Positions of the grains [m]; NaN for absent ones.
    cells : VoronoiCells, optional
        Voronoi cells of these positions, if already computed.

    Returns
    -------
    float
        Order parameter from 0 to 1, dimensionless; NaN without interior cells.

    Raises
    ------
    InputError
        If the positions do not have the shape (n, 2), or ``cells`` has another number of grains.

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
    positions, cells = checked_positions_and_cells(positions, cells)
    sizes = np.abs(local_psi6(positions, cells)[cells.interior])
    return float(sizes.mean()) if len(sizes) else np.nan


def global_psi6(positions: np.ndarray, cells: VoronoiCells | None = None) -> complex:
    """Mean of the complex local Psi6 over the grains with an interior cell.

    Its modulus is 1 only if all hexagons have the same orientation (Nelson and Halperin, Phys. Rev. B 19,
    2457, 1979).

    Parameters
    ----------
    positions : float64 (n, 2)
        Positions of the grains [m]; NaN for absent ones.
    cells : VoronoiCells, optional
        Voronoi cells of these positions, if already computed.

    Returns
    -------
    complex
        Complex order parameter, dimensionless, of modulus 1 or less; NaN without interior cells.

    Raises
    ------
    InputError
        If the positions do not have the shape (n, 2), or ``cells`` has another number of grains.

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
    positions, cells = checked_positions_and_cells(positions, cells)
    values = local_psi6(positions, cells)[cells.interior]
    return complex(values.mean()) if len(values) else complex(np.nan, np.nan)


@observable("1", "correlation of bond orientation g6(r)")
def bond_correlation(
    positions: np.ndarray, edges: np.ndarray | None = None, cells: VoronoiCells | None = None
) -> PairDistanceFunction:
    """Bond correlation g6(r) = Re <psi6*(0) psi6(r)>, averaged over pairs of grains at the distance r.

    At large distances g6 is constant in a crystal, and decreases algebraically in the hexatic phase and
    exponentially in a liquid (Nelson and Halperin, Phys. Rev. B 19, 2457, 1979). A mean over pairs needs no
    correction at the rim. Only grains with an interior Voronoi cell are included.

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.
    edges : float (k + 1,), optional
        Edges of the bins [m]; as for `radial_distribution` if not given.
    cells : VoronoiCells, optional
        Voronoi cells of these positions, if already computed.

    Returns
    -------
    PairDistanceFunction
        Mean in each bin (k,), dimensionless, NaN in bins without pairs, and the number of pairs.

    Raises
    ------
    InputError
        If the positions do not have the shape (n, 2), ``cells`` has another number of grains, the edges do
        not increase from 0 m or more, or fewer than two grains have an interior cell.
    """
    positions, cells = checked_positions_and_cells(positions, cells)
    edges = default_bin_edges(positions) if edges is None else checked_bin_edges(edges)
    inside = np.flatnonzero(cells.interior)
    if len(inside) < 2:
        raise InputError(f"{len(inside)} grains have an interior Voronoi cell; g6(r) needs 2 or more")
    points, order = positions[inside], local_psi6(positions, cells)[inside]
    products = sum_pair_products(points, order.real, edges) + sum_pair_products(points, order.imag, edges)
    pairs = count_pairs(points, edges)
    return PairDistanceFunction(edges, divide_by_pair_count(products, pairs), pairs, pairs)


@observable("1", "relaxation of bond orientation g6(t)")
def bond_relaxation(
    frames: np.ndarray, lags: np.ndarray | None = None, periods: tuple[float, float] | None = None
) -> np.ndarray:
    """Bond relaxation g6(t) = Re <psi6*(0) psi6(t)>, averaged over grains and frames.

    At long times g6 is constant in a crystal, and decreases algebraically in the hexatic phase and
    exponentially in a liquid (Zahn and Maret, Phys. Rev. Lett. 85, 3656, 2000). A grain is included if its
    Voronoi cell is interior in both frames.

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions of the grains in each frame [m]; NaN for absent grains.
    lags : int (k,), optional
        Lags in frames, 1 to f - 1; about 30, spaced logarithmically, if not given.
    periods : (float, float), optional
        Sides of a periodic cell [m], above 0, into which positions are wrapped. Pairs across a side of this
        cell do not count as neighbours.

    Returns
    -------
    float64 (k,)
        Correlation at each lag, dimensionless.

    Raises
    ------
    InputError
        If a shape, lag or period is invalid, there are fewer than two frames, or at some lag no grain has an
        interior cell in both frames.
    """
    frames = checked_frames(frames, minimum_count=2)
    lags = checked_or_default_lags(lags, len(frames))
    orders = np.full(frames.shape[:2], complex(np.nan, np.nan))
    for k, positions in enumerate(
        frames if periods is None else np.mod(frames, checked_period_lengths(periods))
    ):
        cells = voronoi_cells(positions)
        orders[k, cells.interior] = local_psi6(positions, cells)[cells.interior]
    result = []
    for lag in lags:
        products = (orders[:-lag].conj() * orders[lag:]).real
        products = products[np.isfinite(products)]
        if not len(products):
            raise InputError(
                f"at a lag of {lag} frames, no grain has an interior cell in both frames; use shorter lags"
            )
        result.append(products.mean())
    return np.array(result)
