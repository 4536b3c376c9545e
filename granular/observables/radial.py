"""The radial distribution function g(r) in a rectangle."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.correlation import (
    binned_pairs,
    checked_edges,
    default_edges,
    in_each_frame,
    on_distance,
)
from granular.observables.frames import present_positions, spanned_box
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


class RadialDistribution(NamedTuple):
    """g(r) in bins (lower edge, upper edge].

    Attributes
    ----------
    edges : float (k + 1,)
        [m]
    g : float (k,)
    pairs : int (k,)
        Pairs i < j counted.
    expected : float (k,)
        Pairs expected of as many grains, independent and uniform in the box.
    """

    edges: np.ndarray
    g: np.ndarray
    pairs: np.ndarray
    expected: np.ndarray


def radial_distribution(
    positions: np.ndarray, edges: np.ndarray | None = None, box: np.ndarray | None = None
) -> RadialDistribution:
    """g(r): pairs counted over pairs expected without any order, bin by bin.

    The expectation is exact for N grains in a rectangle a x b, so that no grain need be left out at
    the rim and g is 1 on average for grains without order, at every distance up to the shorter
    side: the set covariance of the rectangle, a b - (2/pi) (a + b) r + r^2/pi, weighs 2 pi r dr
    (Ohser and Stoyan, Biom. J. 23, 523, 1981; Ghosh, Bull. Calcutta Math. Soc. 43, 17, 1951), and
    is integrated over each bin.

    Parameters
    ----------
    positions : float (n, 2)
        [m]; NaN for absent grains.
    edges : float (k + 1,), optional
        Of the bins [m]; 100 bins up to half the shorter side of the box of the outermost centres
        (or 10 mean spacings, where that is less) if not given.
    box : float (2, 2), optional
        Lowest and highest x and y of the rectangle that the grains could be in [m]; that of the
        outermost centres if not given.

    Raises
    ------
    InputError
        If the edges do not increase or reach beyond the shorter side of the box, a grain lies
        outside of the box, or there are fewer than two grains.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import radial_distribution
    >>> found = radial_distribution(places)
    >>> bool(found.g.max() > 1.0)
    True
    """
    points = present_positions(positions)
    if len(points) < 2:
        raise InputError(f"{len(points)} grains; g(r) needs at least 2")
    edges = default_edges(points) if edges is None else checked_edges(edges)
    low, high = spanned_box(points) if box is None else np.asarray(box, dtype=np.float64)
    if not ((points >= low) & (points <= high)).all():
        raise InputError("a grain lies outside of the box; give a box that holds all grains")
    pairs = binned_pairs(points, edges)
    expected = _expected_pairs(len(points), high - low, edges)
    return RadialDistribution(edges, pairs / expected, pairs, expected)


def radial_distribution_of_run(
    run: Trajectory,
    edges: np.ndarray | None = None,
    start: float = 0.0,
    stop: float = np.inf,
) -> xarray.DataArray:
    """g(r) over the frames with start <= time <= stop [s]: all pairs over all expected ones.

    Each frame has the box of its outermost centres.

    Returns
    -------
    xarray.DataArray
        On ``distance``, the middle of the bins [m].

    Raises
    ------
    InputError
        As `radial_distribution`, and where there is no such frame.
    """
    found = in_each_frame(radial_distribution, run, edges, start, stop)
    pairs, expected = (np.sum([one[k] for one in found], axis=0) for k in (2, 3))
    return on_distance(pairs / expected, found[0].edges, "radial distribution function g(r)")


def _expected_pairs(count: int, sides: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Pairs i < j in each bin, of grains that are independent and uniform in a rectangle."""
    a, b = (float(side) for side in sides)
    if edges[-1] > min(a, b) * (1.0 + 1e-12):
        raise InputError(
            f"the last edge, {edges[-1]:.6g} m, is beyond the shorter side of the box, "
            f"{min(a, b):.6g} m, up to which g(r) is exact; give smaller edges"
        )
    nearer = np.pi * a * b * edges**2 - 4.0 / 3.0 * (a + b) * edges**3 + 0.5 * edges**4
    return np.asarray(0.5 * count * (count - 1) * np.diff(nearer) / (a * b) ** 2)
