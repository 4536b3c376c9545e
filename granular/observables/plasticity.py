"""Plastic events: drops of a force or an energy while a bed is driven."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.shared.errors import InputError


class PlasticEvents(NamedTuple):
    """Drops of a quantity, in the order of time.

    Attributes
    ----------
    begin, end : int (k,)
        Sample at the top and at the foot of each drop.
    size : float (k,)
        By how much the quantity fell, in its unit.
    time : float (k,)
        At the top [s].
    """

    begin: np.ndarray
    end: np.ndarray
    size: np.ndarray
    time: np.ndarray


class DropStatistics(NamedTuple):
    """How large drops are.

    Attributes
    ----------
    exponent, error : float
        tau of a density ~ size^-tau above the least size, and its standard error; NaN for fewer
        than two drops.
    events : int
    mean : float
        In the unit of the drops.
    """

    exponent: float
    error: float
    events: int
    mean: float


def plastic_events(time: np.ndarray, values: np.ndarray, least: float) -> PlasticEvents:
    """Every stretch along which a quantity falls without a rise, by ``least`` or more.

    Parameters
    ----------
    time : float (n,)
        [s]
    values : float (n,)
        Such as the piston's force under compression, ``run.dataset["piston_force"]``.
    least : float
        Smallest drop that counts, above the noise, in the unit of the values.

    Raises
    ------
    InputError
        If the shapes do not fit, a value is not finite, or ``least`` is not above 0.
    """
    times, series = np.asarray(time, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if series.ndim != 1 or times.shape != series.shape:
        raise InputError(f"the shapes {times.shape} and {series.shape} differ; give two (n,)")
    if not np.isfinite(series).all():
        raise InputError("a value is not finite; leave such samples out")
    if not least > 0.0:
        raise InputError(f"least {least:g} is not above 0; give the smallest drop that counts")
    falls = np.concatenate([[False], np.diff(series) < 0.0, [False]])
    edges = np.flatnonzero(np.diff(falls.astype(np.int8)))
    begin, end = edges[::2], edges[1::2]
    size = series[begin] - series[end]
    chosen = size >= least
    return PlasticEvents(begin[chosen], end[chosen], size[chosen], times[begin[chosen]])


def drop_statistics(sizes: np.ndarray, least: float) -> DropStatistics:
    """Exponent of a power law of drops, by greatest likelihood, and their mean.

    tau = 1 + k/sum log(size/least), with the error (tau - 1)/sqrt(k) (Clauset, Shalizi and Newman,
    SIAM Review 51, 661, 2009). Whether a power law holds at all it does not say.

    Parameters
    ----------
    sizes : float (k,)
    least : float
        Smallest drop that counts, in the same unit.

    Raises
    ------
    InputError
        If ``least`` is not above 0, or a drop is smaller.
    """
    drops = np.asarray(sizes, dtype=np.float64)
    if not least > 0.0 or (drops < least).any():
        raise InputError(f"drops below least = {least:g}, or least is not above 0; leave them out")
    count = len(drops)
    logs = float(np.log(drops / least).sum())
    if count < 2 or logs == 0.0:
        return DropStatistics(np.nan, np.nan, count, float(drops.mean()) if count else np.nan)
    exponent = 1.0 + count / logs
    return DropStatistics(
        exponent, (exponent - 1.0) / float(np.sqrt(count)), count, float(drops.mean())
    )
