"""Statistics of samples: Pearson's correlation, order of directions, modes, and histograms."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from granular.observables.frame import check_series, check_vectors
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError


class PearsonCorrelation(NamedTuple):
    """Pearson's correlation."""

    coefficient: float  # -1 to 1; NaN if a quantity does not vary
    p_value: float  # of one this far from 0 for independent normal samples
    samples: int


def pearson_correlation(first: np.ndarray, second: np.ndarray) -> PearsonCorrelation:
    """Pearson's correlation of two quantities, such as Psi6 and n6 of many beds [D, Fig. 4.13].

    The probability is that of Student's t (SciPy's ``pearsonr``).

    Parameters
    ----------
    first, second : float (n,)
        Samples, each of any unit; those where one is not finite are ignored.

    Returns
    -------
    PearsonCorrelation
        Coefficient from -1 to 1 and its probability by chance, both without unit and NaN where one of the
        quantities does not vary, and the number of samples.

    Raises
    ------
    InputError
        If the shapes differ or are not (n,), or fewer than three samples are left.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import pearson_correlation
    >>> first = np.arange(10.0)
    >>> round(pearson_correlation(first, 2.0 * first)[0], 3)
    1.0
    """
    from scipy.stats import pearsonr

    x, y = check_series("first and second", first, second)
    known = np.isfinite(x) & np.isfinite(y)
    count = int(np.count_nonzero(known))
    if count < 3:
        raise InputError(f"{count} samples; a correlation needs at least 3")
    x, y = x[known], y[known]
    if np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return PearsonCorrelation(np.nan, np.nan, count)
    result = pearsonr(x, y)
    return PearsonCorrelation(float(result.statistic), float(result.pvalue), count)


class DirectionalOrder(NamedTuple):
    """Order of the directions of vectors: 0 for none, 1 where all point alike."""

    polar: float  # |mean of exp(i theta)|
    axial: float  # |mean of exp(2 i theta)|: a vector and its opposite are the same
    polar_p: float  # Rayleigh's test
    axial_p: float  # Rayleigh's test
    vectors: int


def axial_order_parameter(vectors: np.ndarray) -> DirectionalOrder:
    """Polar and axial order parameter of the directions of vectors, |mean exp(i k theta)|, k = 1 and 2.

    Vectors that are not finite, or 0, are left out, and lengths do not count. The probability is
    exp(-n R^2) with the first correction for few vectors (Mardia and Jupp, Directional Statistics,
    2000, sect. 6.3.1).

    Parameters
    ----------
    vectors : float (n, 2)
        Vectors of any unit.

    Returns
    -------
    DirectionalOrder
        Both parameters from 0 to 1, without unit, their probabilities by chance, and the number of vectors.

    Raises
    ------
    InputError
        If no vector is left, or the shape is another one.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import axial_order_parameter
    >>> found = axial_order_parameter(np.array([[1.0, 0.0]] * 20))
    >>> found
    DirectionalOrder(polar=1.0, axial=1.0, polar_p=0.0, axial_p=0.0, vectors=20)
    """
    array = check_vectors(vectors, "vectors")
    array = array[np.isfinite(array).all(axis=1) & (array != 0.0).any(axis=1)]
    if not len(array):
        raise InputError("0 vectors; at least 1 that is not 0 has a direction")
    angle = np.arctan2(array[:, 1], array[:, 0])
    polar, axial = (float(abs(np.exp(1j * k * angle).mean())) for k in (1, 2))
    count = len(array)
    return DirectionalOrder(
        polar, axial, _rayleigh_p_value(polar, count), _rayleigh_p_value(axial, count), count
    )


def _rayleigh_p_value(order: float, count: int) -> float:
    z = count * order**2
    # Rayleigh's test with the first correction in 1/n (Mardia and Jupp, Directional Statistics, 2000, 6.3).
    return float(np.clip(np.exp(-z) * (1.0 + (2.0 * z - z * z) / (4.0 * count)), 0.0, 1.0))


# The dip of three different values is 1/6, whichever they are.
LEAST_VALUES = 4
# The probability is known to sqrt(p/2000): 0.005 at 5 %.
DRAWS = 2000
"""Samples of the uniform distribution that a dip is compared with."""
LARGEST_DRAWN = 200
"""Values of such a sample at most: beyond, the dip falls with the root of their number."""


class DipTest(NamedTuple):
    """The outcome of the test."""

    dip: float  # distance of the distribution from the nearest with one mode
    p: float  # probability of so large a dip in the uniform distribution


def dip_test(values: np.ndarray) -> DipTest:
    """Test values for more than one mode (Hartigan and Hartigan 1985, doi:10.1214/aos/1176346577).

    The probability is that of dips of uniform samples (`DRAWS` of them) of as many values, or of
    `LARGEST_DRAWN` where there are more: the dip falls with the root of their number.

    Parameters
    ----------
    values : float (n,)
        Values of any unit; those that are not finite are ignored.

    Returns
    -------
    DipTest
        Dip, and its probability under one mode, at least 1/(`DRAWS` + 1), both without unit.

    Raises
    ------
    InputError
        If there are fewer than `LEAST_VALUES` finite values.

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
    result = dip_statistic(known)
    drawn = min(count, LARGEST_DRAWN)
    null = _dips_of_uniform_samples(drawn) * np.sqrt(drawn / count)
    return DipTest(result, float((1 + (null >= result).sum()) / (1 + len(null))))


def dip_statistic(values: Float[np.ndarray, "n"]) -> float:
    """Dip of sorted values: the greatest distance of their distribution from the nearest with one mode."""
    x, heights = np.unique(values, return_counts=True)
    if len(x) == 1:
        return 0.5 / len(values)
    jumps = heights / len(values)
    upper = np.cumsum(jumps)
    lower = upper - jumps
    # Between two ends that close in on the mode, greatest convex minorant and least concave majorant are
    # compared where either touches (Hartigan, Appl. Stat. 34, 320, 1985, AS 217).
    start, stop, result = 0, len(x) - 1, 1.0 / len(values)
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
        if gap <= result:
            return 0.5 * result
        adjacent = np.abs(upper[part] - minorant)[: left + 1].max()
        beyond = np.abs(majorant - lower[part])[right:].max()
        result = max(result, adjacent, beyond)
        if (left, right) == (0, stop - start) or gap <= result:
            return 0.5 * result
        start, stop = start + left, start + right


def _convex_minorant(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Greatest convex function at or below y, at every x, and where it touches."""
    hull: list[int] = []
    for k in range(len(x)):
        while len(hull) > 1:
            a, b = hull[-2:]
            if (y[b] - y[a]) * (x[k] - x[b]) < (y[k] - y[b]) * (x[b] - x[a]):
                break
            hull.pop()
        hull.append(k)
    return np.interp(x, x[hull], y[hull]), np.array(hull)


@cache
def _dips_of_uniform_samples(count: int) -> np.ndarray:
    random = np.random.default_rng(count)
    return np.array([dip_statistic(np.sort(random.random(count))) for _ in range(DRAWS)])


MOST_BINS = 1000


class Histogram(NamedTuple):
    """A histogram of bins of one width."""

    edges: Float[np.ndarray, "k+1"]  # in the unit of the values
    counts: Int[np.ndarray, "k"]
    density: Float[np.ndarray, "k"]  # in one over the unit of the values; its integral is 1


def knuth_bin_count(values: Float[np.ndarray, "n"]) -> int:
    """Choose the number of bins of a histogram by Knuth's rule."""
    from scipy.special import gammaln

    values = _sorted_finite_values(values)
    count, low, high = len(values), values[0], values[-1]
    if low == high:
        return 1
    # Every number is tried, lest a local maximum be taken for the highest.
    bins = np.arange(1, min(count, MOST_BINS) + 1)
    counts = (np.histogram(values, np.linspace(low, high, m + 1))[0] for m in bins)
    filled = np.array([gammaln(filling + 0.5).sum() for filling in counts])
    # Logarithm of the posterior, [D, eq. 4.33] (K. H. Knuth, Digital Signal Processing 95, 102581, 2019).
    posterior = (
        count * np.log(bins)
        + gammaln(0.5 * bins)
        - bins * gammaln(0.5)
        - gammaln(count + 0.5 * bins)
        + filled
    )
    return int(bins[np.argmax(posterior)])


def knuth_histogram(values: np.ndarray) -> Histogram:
    """Histogram of values by Knuth's rule, from the least to the greatest of them.

    Bins are as many as `knuth_bin_count` gives (K. H. Knuth, Digital Signal Processing 95, 102581, 2019;
    [D, eq. 4.33]). Values that are all the same have one bin about them, of width 1.

    Parameters
    ----------
    values : float (n,)
        Values of any unit; those that are not finite are left out.

    Returns
    -------
    Histogram
        Edges (k + 1,) in the unit of the values, counts (k,), and densities (k,) in one over that unit.

    Raises
    ------
    InputError
        If there is no finite value.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import knuth_histogram
    >>> found = knuth_histogram(np.random.default_rng(1).normal(size=1000))
    >>> len(found.edges) - 1
    16
    """
    values = _sorted_finite_values(values)
    counts, edges = np.histogram(values, knuth_bin_count(values))
    return Histogram(edges, counts, counts / (counts.sum() * np.diff(edges)))


def _sorted_finite_values(values: np.ndarray) -> np.ndarray:
    """Finite values in order."""
    array = np.asarray(values, dtype=np.float64).ravel()
    array = np.sort(array[np.isfinite(array)])
    if not len(array):
        raise InputError("0 values; at least 1 finite value makes a histogram")
    return array


RATES = (-30.0, -12.0, -6.0, -3.0, -1.0, -0.3, 0.3, 1.0, 3.0, 6.0, 12.0, 30.0)
"""Rates of the starts, over the span of x; every two of them make one."""

# Faster, an exponential is over within a sixtieth of the span, between two samples.
LARGEST_RATE = 60.0
"""Bound of the rates, over the span of x."""

REFINED = 12
"""Number of starts, the best ones, that are followed to their minimum."""


class BiexponentialFit(NamedTuple):
    """A exp(l1 x) + B exp(l2 x), with l1 <= l2."""

    amplitudes: Float[np.ndarray, "2"]  # (A, B), in the unit of y
    rates: Float[np.ndarray, "2"]  # (l1, l2), in one over the unit of x
    amplitude_intervals: Float[np.ndarray, "2 2"]  # 95 %: lower and upper end, for A and B
    rate_intervals: Float[np.ndarray, "2 2"]  # the same for l1 and l2; infinite: open
    residual: float  # standard deviation with n - 4 degrees of freedom, in the unit of y

    def values(self, x: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Evaluate the fitted law A exp(l1 x) + B exp(l2 x)."""
        return np.asarray(_exponential_basis(np.asarray(x, dtype=np.float64), self.rates) @ self.amplitudes)


def biexponential_fit(x: np.ndarray, y: np.ndarray) -> BiexponentialFit:
    """Least-squares fit of A exp(l1 x) + B exp(l2 x), as [D, Fig. 4.8, Table 4.5] for F_max(R).

    The rates are sought from many starts, within -60 and 60 over the span of x, with the best amplitudes
    for every pair of rates (variable projection, Golub and Pereyra, SIAM J. Numer. Anal. 10, 413, 1973).
    The intervals, of 95 % confidence, are those of the law linearised at the minimum, with Student's t.

    Parameters
    ----------
    x, y : float (n,)
        Samples, each of any unit, all finite, with at least five different x.

    Returns
    -------
    BiexponentialFit
        Amplitudes A and B (2,) in the unit of y, rates l1 <= l2 (2,) in one over the unit of x, their
        intervals (2, 2), infinite where the data leave a value open, NaN where every y is 0, and the
        standard deviation of the residuals in the unit of y.

    Raises
    ------
    InputError
        If the shapes differ or are not (n,), a value is not finite, or there are fewer than five different
        x.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import biexponential_fit
    >>> x = np.linspace(0.0, 1.0, 20)
    >>> found = biexponential_fit(x, 2.0 * np.exp(-3.0 * x) + np.exp(0.5 * x))
    >>> print(found.amplitudes.round(3), found.rates.round(3))
    [2. 1.] [-3.   0.5]
    """
    x, y = check_series("x and y", x, y)
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("x or y holds a value that is not finite; drop such samples")
    if len(np.unique(x)) < 5:
        raise InputError(f"{len(np.unique(x))} different x; four parameters with intervals need at least 5")
    start, width = float(x.min()), float(np.ptp(x))
    u = (x - start) / width
    rates = _best_exponential_rates(u, y)
    amplitudes = _best_amplitudes(u, y, rates) * np.exp(-rates * start / width)
    rates = rates / width
    order = np.argsort(rates)
    return _fit_with_intervals(x, y, amplitudes[order], rates[order])


def _exponential_basis(u: np.ndarray, rates: np.ndarray) -> np.ndarray:
    return np.exp(np.multiply.outer(u, rates))


def _best_amplitudes(u: np.ndarray, y: np.ndarray, rates: np.ndarray) -> np.ndarray:
    basis = _exponential_basis(u, rates)
    # Columns of one length: beside exp(60) the rank test of `lstsq` would drop the other.
    sizes = np.linalg.norm(basis, axis=0)
    return np.asarray(np.linalg.lstsq(basis / sizes, y, rcond=None)[0] / sizes)


def _best_exponential_rates(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Two rates over the range that leave the least sum of squares."""
    from scipy.optimize import least_squares

    size = float(np.abs(y).max()) or 1.0

    def misfit(rates: np.ndarray) -> np.ndarray:
        return (_exponential_basis(u, rates) @ _best_amplitudes(u, y, rates) - y) / size

    starts = [np.array([a, b]) for k, a in enumerate(RATES) for b in RATES[k + 1 :]]
    starts.sort(key=lambda rates: float(np.square(misfit(rates)).sum()))
    attempts = [
        least_squares(
            misfit, attempt, bounds=(-LARGEST_RATE, LARGEST_RATE), xtol=1e-12, ftol=1e-14, gtol=1e-14
        )
        for attempt in starts[:REFINED]
    ]
    return np.asarray(min(attempts, key=lambda attempt: float(attempt.cost)).x)


def _fit_with_intervals(
    x: np.ndarray, y: np.ndarray, amplitudes: np.ndarray, rates: np.ndarray
) -> BiexponentialFit:
    from scipy.special import stdtrit

    basis = _exponential_basis(x, rates)
    left = y - basis @ amplitudes
    free = len(x) - 4
    variance = float(left @ left) / free
    slopes = np.concatenate([basis, basis * amplitudes * x[:, None]], axis=1)
    widths = stdtrit(free, 0.975) * np.sqrt(variance * _inverse_normal_diagonal(slopes))
    values = np.concatenate([amplitudes, rates])
    intervals = np.stack([values - widths, values + widths], axis=1)
    return BiexponentialFit(amplitudes, rates, intervals[:2], intervals[2:], float(np.sqrt(variance)))


def _inverse_normal_diagonal(slopes: np.ndarray) -> np.ndarray:
    """Diagonal of (J^T J)^-1; infinite where J leaves a parameter open."""
    sizes = np.linalg.norm(slopes, axis=0)
    if not (sizes > 0.0).all():
        return np.full(slopes.shape[1], np.inf)
    singular, turns = np.linalg.svd(slopes / sizes, full_matrices=False)[1:]
    if singular[-1] < singular[0] * len(slopes) * np.finfo(float).eps:
        return np.full(slopes.shape[1], np.inf)
    return np.asarray(((turns / singular[:, None]) ** 2).sum(axis=0) / sizes**2)
