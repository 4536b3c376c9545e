"""Distribution of the forces on the grains: Knuth's bins, and Hartigan's test for one mode."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.forces import compressive_forces
from granular.observables.frames import species_names
from granular.observables.voronoi import voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory


LEAST_VALUES = 4
DRAWS = 2000
"""Samples of the uniform distribution that a dip is compared with."""
LARGEST_DRAWN = 200
"""Values of such a sample at most: beyond, the dip falls with the root of their number."""


class DipTest(NamedTuple):
    """The outcome of the test.

    Attributes
    ----------
    dip : float
        Greatest distance of the values' distribution from the nearest one with one mode.
    p : float
        Probability of so great a dip in as many values of one mode: of the uniform distribution,
        the hardest of these to tell apart.
    """

    dip: float
    p: float


def dip_test(values: np.ndarray) -> DipTest:
    """Test values for more than one mode (Hartigan and Hartigan 1985, doi:10.1214/aos/1176346577).

    Parameters
    ----------
    values : float (n,)
        NaN is ignored.

    Raises
    ------
    InputError
        If there are fewer than `LEAST_VALUES`.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import dip_test
    >>> two = np.concatenate([np.linspace(0, 1, 50), np.linspace(4, 5, 50)])
    >>> dip_test(two).p < 0.01  # not one mode
    True
    """
    known = np.asarray(values, dtype=np.float64).ravel()
    known = np.sort(known[np.isfinite(known)])
    count = len(known)
    if count < LEAST_VALUES:
        raise InputError(f"{count} values; the dip test needs at least {LEAST_VALUES}")
    found = dip(known)
    drawn = min(count, LARGEST_DRAWN)
    null = _uniform_dips(drawn) * np.sqrt(drawn / count)
    return DipTest(found, float((1 + (null >= found).sum()) / (1 + len(null))))


def dip(values: np.ndarray) -> float:
    """The dip of values in order (n,), n at least 2.

    Between a lower and an upper end, which close in on the mode, the greatest convex minorant of
    the distribution and its least concave majorant are compared where either touches it.
    """
    x, heights = np.unique(values, return_counts=True)
    if len(x) == 1:
        return 0.5 / len(values)
    jumps = heights / len(values)
    upper = np.cumsum(jumps)
    lower = upper - jumps
    start, stop, found = 0, len(x) - 1, 1.0 / len(values)
    while True:
        part = slice(start, stop + 1)
        minorant, touching = _convex_minorant(x[part], lower[part])
        mirrored, touched = _convex_minorant(-x[part][::-1], -upper[part][::-1])
        majorant, touched = -mirrored[::-1], (stop - start - touched)[::-1]
        gaps, others = (majorant - minorant)[touching], (majorant - minorant)[touched]
        if others.max() > gaps.max():
            right = touched[others.argmax()]
            left = touching[touching <= right][-1]
        else:
            left = touching[gaps.argmax()]
            right = touched[touched >= left][0]
        gap = max(gaps.max(), others.max())
        if gap <= found:
            return 0.5 * found
        beside = np.abs(upper[part] - minorant)[: left + 1].max()
        beyond = np.abs(majorant - lower[part])[right:].max()
        found = max(found, beside, beyond)
        if (left, right) == (0, stop - start) or gap <= found:
            return 0.5 * found
        start, stop = start + left, start + right


def _convex_minorant(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The greatest convex function at or below y, at every x, and where it touches."""
    hull: list[int] = []
    for k in range(len(x)):
        while len(hull) > 1 and _bends_down(x, y, hull[-2], hull[-1], k):
            hull.pop()
        hull.append(k)
    return np.interp(x, x[hull], y[hull]), np.array(hull)


def _bends_down(x: np.ndarray, y: np.ndarray, a: int, b: int, c: int) -> bool:
    return bool((y[b] - y[a]) * (x[c] - x[b]) >= (y[c] - y[b]) * (x[b] - x[a]))


@cache
def _uniform_dips(count: int) -> np.ndarray:
    random = np.random.default_rng(count)
    return np.array([dip(np.sort(random.random(count))) for _ in range(DRAWS)])


MOST_BINS = 1000


class Histogram(NamedTuple):
    """A histogram of bins of one width.

    Attributes
    ----------
    edges : float (k + 1,)
        In the unit of the values.
    counts : int (k,)
    density : float (k,)
        Of probability, in one over the unit of the values; its integral is 1.
    """

    edges: np.ndarray
    counts: np.ndarray
    density: np.ndarray


def knuth_bins(values: np.ndarray) -> int:
    """The number of bins of Knuth's rule.

    The number M that makes the logarithm of the posterior greatest, [D, eq. 4.33]:

        n ln M + ln G(M/2) - M ln G(1/2) - ln G(n + M/2) + sum_k ln G(n_k + 1/2)

    (K. H. Knuth, Digital Signal Processing 95, 102581, 2019). Every number up to that of the values
    is tried (but no more than `MOST_BINS`), so that a local maximum cannot be taken for the
    greatest.

    Parameters
    ----------
    values : float (n,)
        NaN is ignored.

    Raises
    ------
    InputError
        If there is no value.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import knuth_bins
    >>> knuth_bins(np.random.default_rng(1).normal(size=1000))
    16
    """
    from scipy.special import gammaln

    values = _known(values)
    count, low, high = len(values), values[0], values[-1]
    if low == high:
        return 1
    bins = np.arange(1, min(count, MOST_BINS) + 1)
    filled = np.array(
        [gammaln(_counts(values, np.linspace(low, high, m + 1)) + 0.5).sum() for m in bins]
    )
    posterior = (
        count * np.log(bins)
        + gammaln(0.5 * bins)
        - bins * gammaln(0.5)
        - gammaln(count + 0.5 * bins)
        + filled
    )
    return int(bins[np.argmax(posterior)])


def knuth_histogram(values: np.ndarray) -> Histogram:
    """The histogram of the values in the bins of `knuth_bins`, from the least to the greatest.

    Values that are all the same have one bin about them, of width 1.

    Raises
    ------
    InputError
        If there is no value.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import knuth_histogram
    >>> found = knuth_histogram(np.random.default_rng(1).normal(size=1000))
    >>> len(found.edges) - 1
    16
    """
    values = _known(values)
    counts, edges = np.histogram(values, knuth_bins(values))
    return Histogram(edges, counts, counts / (counts.sum() * np.diff(edges)))


def force_distribution_of_run(
    run: Trajectory, frame: int = -1, *, pooled: bool = False
) -> dict[str, Histogram]:
    """Histograms of the compressive force on the grains of a frame [D, Fig. 4.21].

    Only grains with an interior Voronoi cell count, as in de Paula's pictures of forces.

    Parameters
    ----------
    run : Trajectory
    frame : int
        Index of the frame; the last if not given.
    pooled : bool
        All species in one histogram, named ``"all"``, over the greatest force of the frame, as the
        source draws them.

    Returns
    -------
    dict of str to Histogram
        By the name of the species, for the species that have such grains there; forces in N, or
        over their greatest where they are pooled.

    Raises
    ------
    InputError
        If there is no such frame, no such grain, or a force that cannot be taken apart (see
        `compressive_forces`).
    """
    forces = _inner_forces(run, frame)
    if not np.isfinite(forces).any():
        raise InputError(
            f"frame {frame} has 0 grains with an interior Voronoi cell; give one whose grains lie "
            "in more than two rows"
        )
    if pooled:
        known = _known(forces)
        return {"all": knuth_histogram(known / known[-1])}
    owner = run.dataset["species"].values
    found = {}
    for k, name in enumerate(species_names(run)):
        chosen = (owner == k) & np.isfinite(forces)
        if chosen.any():
            found[name] = knuth_histogram(forces[chosen])
    return found


def force_modes_of_run(run: Trajectory, frame: int = -1) -> DipTest:
    """Whether the compressive forces of a frame, of all species together, have more than one mode.

    Grains and errors as of `force_distribution_of_run`.
    """
    return dip_test(_inner_forces(run, frame))


def _inner_forces(run: Trajectory, frame: int) -> np.ndarray:
    """Compressive forces of the grains with an interior cell (n,) [N]; NaN for the others."""
    total = run.dataset.sizes["frame"]
    if not -total <= frame < total:
        raise InputError(f"frame = {frame}; the run has the frames 0 to {total - 1}")
    positions = run.dataset["position"].values[frame]
    height = float(run.dataset["frame_height"].values[frame])
    forces = compressive_forces(run.scene, positions, height)
    return np.where(voronoi_cells(run.scene.cell.inside(positions)).interior, forces, np.nan)


def _known(values: np.ndarray) -> np.ndarray:
    """The finite values in order."""
    array = np.asarray(values, dtype=np.float64).ravel()
    array = np.sort(array[np.isfinite(array)])
    if not len(array):
        raise InputError("0 values; at least 1 finite value makes a histogram")
    return array


def _counts(ordered: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """How many values each bin holds; the last bin holds its upper edge too."""
    places = np.searchsorted(ordered, edges[1:-1], side="left")
    return np.diff(np.concatenate([[0], places, [len(ordered)]]))
