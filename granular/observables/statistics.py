"""Statistics of samples: correlation, order of directions, test for several modes, histograms, fits."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from granular.observables.frame import checked_series, checked_vectors
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError


class PearsonCorrelation(NamedTuple):
    """Result of a Pearson correlation."""

    coefficient: float  # -1 to 1; NaN if a quantity does not vary
    p_value: float  # probability of a coefficient this far from 0 for independent normal samples
    samples: int


def pearson_correlation(first: np.ndarray, second: np.ndarray) -> PearsonCorrelation:
    """Pearson correlation of two quantities, such as Psi6 and n6 of many beds [D, Fig. 4.13].

    The p-value follows from Student's t distribution (SciPy's ``pearsonr``).

    Parameters
    ----------
    first, second : float (n,)
        Samples, in any units; pairs with a value that is not finite are ignored.

    Returns
    -------
    PearsonCorrelation
        Coefficient from -1 to 1 and its p-value, dimensionless; both are NaN if one quantity is constant.
        Also the number of samples.

    Raises
    ------
    InputError
        If the shapes differ or are not (n,), or fewer than three samples are finite.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import pearson_correlation
    >>> first = np.arange(10.0)
    >>> round(pearson_correlation(first, 2.0 * first)[0], 3)
    1.0
    """
    from scipy.stats import pearsonr

    x, y = checked_series("first and second", first, second)
    known = np.isfinite(x) & np.isfinite(y)
    count = int(np.count_nonzero(known))
    if count < 3:
        raise InputError(f"{count} samples; a correlation needs 3 or more")
    x, y = x[known], y[known]
    if np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return PearsonCorrelation(np.nan, np.nan, count)
    result = pearsonr(x, y)
    return PearsonCorrelation(float(result.statistic), float(result.pvalue), count)


class DirectionalOrder(NamedTuple):
    """Order of the directions of vectors: 0 without order, 1 if all are parallel."""

    polar: float  # |mean of exp(i theta)|
    axial: float  # |mean of exp(2 i theta)|: a vector and its opposite are equivalent
    polar_p: float  # Rayleigh's test
    axial_p: float  # Rayleigh's test
    vectors: int


def axial_order_parameter(vectors: np.ndarray) -> DirectionalOrder:
    """Order parameters |mean exp(i k theta)| of directions theta: polar (k = 1) and axial (k = 2).

    Only the directions of the vectors matter; vectors that are 0 or not finite are ignored. For n vectors
    with the order parameter R, the p-value is exp(-n R^2) with the first-order correction for small n (Mardia
    and Jupp, Directional Statistics, 2000, sect. 6.3.1).

    Parameters
    ----------
    vectors : float (n, 2)
        Vectors in any units.

    Returns
    -------
    DirectionalOrder
        Both parameters from 0 to 1, dimensionless, their p-values, and the number of vectors.

    Raises
    ------
    InputError
        If every vector is 0 or not finite, or the shape is wrong.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import axial_order_parameter
    >>> found = axial_order_parameter(np.array([[1.0, 0.0]] * 20))
    >>> found
    DirectionalOrder(polar=1.0, axial=1.0, polar_p=0.0, axial_p=0.0, vectors=20)
    """
    array = checked_vectors(vectors, "vectors")
    array = array[np.isfinite(array).all(axis=1) & (array != 0.0).any(axis=1)]
    if not len(array):
        raise InputError("all vectors are 0 or not finite; pass 1 or more finite vectors other than 0")
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


# The dip of any three different values is 1/6.
MINIMUM_VALUES = 4
# The standard error of the p-value is sqrt(p/2000): 0.005 at 5 %.
DRAWS = 2000
"""Number of samples drawn from the uniform distribution to determine the p-value of a dip."""
LARGEST_SAMPLE = 200
"""Maximum size of a random sample; for larger data sets the dips are scaled in proportion to 1/sqrt(size)."""


class DipTest(NamedTuple):
    """The result of a dip test."""

    dip: float  # distance of the distribution from the nearest unimodal one
    p: float  # probability of a dip this large for the uniform distribution


def dip_test(values: np.ndarray) -> DipTest:
    """Test for more than one mode by the dip test (Hartigan and Hartigan 1985, doi:10.1214/aos/1176346577).

    The p-value follows from the dips of `DRAWS` samples of the same size from the uniform distribution. For
    more than `LARGEST_SAMPLE` values, samples of the size `LARGEST_SAMPLE` are used, and their dips are
    scaled in proportion to 1/sqrt(size).

    Parameters
    ----------
    values : float (n,)
        Values in any unit; values that are not finite are ignored.

    Returns
    -------
    DipTest
        Dip, and p-value of the hypothesis that there is one mode, both dimensionless. The p-value is at least
        1/(`DRAWS` + 1).

    Raises
    ------
    InputError
        If there are fewer than `MINIMUM_VALUES` finite values.

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
    if count < MINIMUM_VALUES:
        raise InputError(f"{count} values; the dip test needs {MINIMUM_VALUES} or more")
    result = dip_statistic(known)
    drawn = min(count, LARGEST_SAMPLE)
    null = _dips_of_uniform_samples(drawn) * np.sqrt(drawn / count)
    return DipTest(result, float((1 + (null >= result).sum()) / (1 + len(null))))


def dip_statistic(values: Float[np.ndarray, "n"]) -> float:
    """Dip of sorted values: maximum distance of their distribution from the nearest unimodal distribution."""
    x, heights = np.unique(values, return_counts=True)
    if len(x) == 1:
        return 0.5 / len(values)
    jumps = heights / len(values)
    upper = np.cumsum(jumps)
    lower = upper - jumps
    # Between two ends that converge to the mode, the greatest convex minorant and the least concave majorant
    # are compared at the points that either of them touches (Hartigan, Appl. Stat. 34, 320, 1985, AS 217).
    start, stop, result = 0, len(x) - 1, 1.0 / len(values)
    while True:
        between = slice(start, stop + 1)
        minorant, touching = _convex_minorant_and_touching_points(x[between], lower[between])
        mirrored, touched = _convex_minorant_and_touching_points(-x[between][::-1], -upper[between][::-1])
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
        adjacent = np.abs(upper[between] - minorant)[: left + 1].max()
        beyond = np.abs(majorant - lower[between])[right:].max()
        result = max(result, adjacent, beyond)
        if (left, right) == (0, stop - start) or gap <= result:
            return 0.5 * result
        start, stop = start + left, start + right


def _convex_minorant_and_touching_points(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the greatest convex minorant of y at every x, and the points at which the minorant touches y."""
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


MAXIMUM_BINS = 1000


class Histogram(NamedTuple):
    """A histogram with bins of equal width."""

    edges: Float[np.ndarray, "k+1"]  # in the unit of the values
    counts: Int[np.ndarray, "k"]
    density: Float[np.ndarray, "k"]  # density in one over the unit of the values; its integral is 1


def knuth_bin_count(values: Float[np.ndarray, "n"]) -> int:
    """Choose the number of bins of a histogram by Knuth's rule."""
    from scipy.special import gammaln

    values = _sorted_finite_values(values)
    count, low, high = len(values), values[0], values[-1]
    if low == high:
        return 1
    # Every number is tried, because the posterior has local maxima.
    bins = np.arange(1, min(count, MAXIMUM_BINS) + 1)
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
    """Histogram of values from their minimum to their maximum, with the number of bins from Knuth's rule.

    The number of bins is given by `knuth_bin_count` (K. H. Knuth, Digital Signal Processing 95, 102581, 2019;
    [D, eq. 4.33]). If all values are equal, there is one bin of width 1, centred on this value.

    Parameters
    ----------
    values : float (n,)
        Values in any unit; values that are not finite are ignored.

    Returns
    -------
    Histogram
        Edges (k + 1,) in the unit of the values, counts (k,), and densities (k,) in the inverse of that unit.

    Raises
    ------
    InputError
        If no value is finite.

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
    """Return the finite values in increasing order."""
    array = np.asarray(values, dtype=np.float64).ravel()
    array = np.sort(array[np.isfinite(array)])
    if not len(array):
        raise InputError("0 finite values; a histogram needs 1 or more")
    return array


RATES = (-30.0, -12.0, -6.0, -3.0, -1.0, -0.3, 0.3, 1.0, 3.0, 6.0, 12.0, 30.0)
"""Starting values of a rate times the range of x; the fit is tried from every pair of these values."""

# Faster exponentials decay within a sixtieth of the span, between two samples.
LARGEST_RATE = 60.0
"""Maximum magnitude of a rate times the range of x."""

REFINED = 12
"""Number of the best starting points from which the fit is run to convergence."""


class BiexponentialFit(NamedTuple):
    """Fitted law A exp(l1 x) + B exp(l2 x), with l1 <= l2."""

    amplitudes: Float[np.ndarray, "2"]  # (A, B), in units of y
    rates: Float[np.ndarray, "2"]  # (l1, l2), in one over the unit of x
    amplitude_intervals: Float[np.ndarray, "2 2"]  # 95 % intervals of A and B: lower and upper end
    rate_intervals: Float[np.ndarray, "2 2"]  # 95 % intervals of l1 and l2; infinite if undetermined
    residual: float  # standard deviation with n - 4 degrees of freedom, in units of y

    def values(self, x: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Evaluate the fitted law A exp(l1 x) + B exp(l2 x)."""
        return np.asarray(_exponential_basis(np.asarray(x, dtype=np.float64), self.rates) @ self.amplitudes)


def biexponential_fit(x: np.ndarray, y: np.ndarray) -> BiexponentialFit:
    """Least-squares fit of A exp(l1 x) + B exp(l2 x), as in [D, Fig. 4.8, Table 4.5] for F_max(R).

    The fit starts from many pairs of rates; each rate times the range of x is between -60 and 60. For every
    pair of rates the best amplitudes are computed (variable projection, Golub and Pereyra, SIAM J. Numer.
    Anal. 10, 413, 1973). The 95 % confidence intervals follow from the linearised law and Student's t
    distribution.

    Parameters
    ----------
    x, y : float (n,)
        Samples in any units, all finite, with five or more different x.

    Returns
    -------
    BiexponentialFit
        Amplitudes A and B (2,) in units of y, and rates l1 <= l2 (2,) in the inverse of the unit of x. Their
        confidence intervals (2, 2) are infinite for parameters that the data do not determine, and NaN if
        every y is 0. The residual is the standard deviation of y from the law, in units of y.

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
    x, y = checked_series("x and y", x, y)
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("a value of x or y is not finite; remove such samples")
    if len(np.unique(x)) < 5:
        raise InputError(
            f"{len(np.unique(x))} different values of x; a fit of four parameters with "
            "confidence intervals needs 5 or more"
        )
    start, width = float(x.min()), float(np.ptp(x))
    u = (x - start) / width
    rates = _best_exponential_rates(u, y)
    amplitudes = _least_squares_amplitudes(u, y, rates) * np.exp(-rates * start / width)
    rates = rates / width
    order = np.argsort(rates)
    return _add_intervals_to_fit(x, y, amplitudes[order], rates[order])


def _exponential_basis(u: np.ndarray, rates: np.ndarray) -> np.ndarray:
    return np.exp(np.multiply.outer(u, rates))


def _least_squares_amplitudes(u: np.ndarray, y: np.ndarray, rates: np.ndarray) -> np.ndarray:
    basis = _exponential_basis(u, rates)
    # Columns are scaled to equal length: next to exp(60), the rank test of `lstsq` would drop the other one.
    sizes = np.linalg.norm(basis, axis=0)
    return np.asarray(np.linalg.lstsq(basis / sizes, y, rcond=None)[0] / sizes)


def _best_exponential_rates(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Find the two rates that minimise the sum of squares; return each rate times the range of x."""
    from scipy.optimize import least_squares

    size = float(np.abs(y).max()) or 1.0

    def relative_residuals(rates: np.ndarray) -> np.ndarray:
        return (_exponential_basis(u, rates) @ _least_squares_amplitudes(u, y, rates) - y) / size

    starts = [np.array([a, b]) for k, a in enumerate(RATES) for b in RATES[k + 1 :]]
    starts.sort(key=lambda rates: float(np.square(relative_residuals(rates)).sum()))
    attempts = [
        least_squares(
            relative_residuals,
            attempt,
            bounds=(-LARGEST_RATE, LARGEST_RATE),
            xtol=1e-12,
            ftol=1e-14,
            gtol=1e-14,
        )
        for attempt in starts[:REFINED]
    ]
    return np.asarray(min(attempts, key=lambda attempt: float(attempt.cost)).x)


def _add_intervals_to_fit(
    x: np.ndarray, y: np.ndarray, amplitudes: np.ndarray, rates: np.ndarray
) -> BiexponentialFit:
    from scipy.special import stdtrit

    basis = _exponential_basis(x, rates)
    residuals = y - basis @ amplitudes
    degrees_of_freedom = len(x) - 4
    variance = float(residuals @ residuals) / degrees_of_freedom
    slopes = np.concatenate([basis, basis * amplitudes * x[:, None]], axis=1)
    widths = stdtrit(degrees_of_freedom, 0.975) * np.sqrt(
        variance * _diagonal_of_inverse_normal_matrix(slopes)
    )
    values = np.concatenate([amplitudes, rates])
    intervals = np.stack([values - widths, values + widths], axis=1)
    return BiexponentialFit(amplitudes, rates, intervals[:2], intervals[2:], float(np.sqrt(variance)))


def _diagonal_of_inverse_normal_matrix(slopes: np.ndarray) -> np.ndarray:
    """Diagonal of (J^T J)^-1 for the Jacobian J; infinite for parameters that J does not determine."""
    sizes = np.linalg.norm(slopes, axis=0)
    if not (sizes > 0.0).all():
        return np.full(slopes.shape[1], np.inf)
    singular, directions = np.linalg.svd(slopes / sizes, full_matrices=False)[1:]
    if singular[-1] < singular[0] * len(slopes) * np.finfo(float).eps:
        return np.full(slopes.shape[1], np.inf)
    return np.asarray(((directions / singular[:, None]) ** 2).sum(axis=0) / sizes**2)
