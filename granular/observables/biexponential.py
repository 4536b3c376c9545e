"""The bi-exponential law A exp(l1 x) + B exp(l2 x), as for the greatest piston force over R."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.frame import check_series
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float

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
