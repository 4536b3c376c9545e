"""Hartigan's dip test: whether values come from a distribution of more than one mode."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from granular.shared.errors import InputError

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
