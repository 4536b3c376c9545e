"""Pearson's correlation, above all of Psi6 and the share of hexagons."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.bond_order import psi6
from granular.observables.frames import frame_positions
from granular.observables.voronoi import cell_shares, voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory


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
