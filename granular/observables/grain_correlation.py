"""How alike what two grains feel is, over their distance: chains of forces would show in it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.observables.frames import checked_positions, values_of_grains
from granular.observables.pairs_in_bins import (
    binned_pairs,
    binned_products,
    checked_edges,
    default_edges,
)
from granular.shared.errors import InputError


class ValueCorrelation(NamedTuple):
    """The correlation of a value of the grains in bins (lower edge, upper edge].

    Attributes
    ----------
    edges : float (k + 1,)
        [m]
    correlation : float (k,)
        1 where both have the same deviation from the mean, 0 where they know nothing of each other;
        NaN in bins without pairs.
    pairs : int (k,)
        Pairs i < j.
    """

    edges: np.ndarray
    correlation: np.ndarray
    pairs: np.ndarray


def value_correlation(
    positions: np.ndarray, values: np.ndarray, edges: np.ndarray | None = None
) -> ValueCorrelation:
    """<dv(0) dv(r)> / <dv^2> with dv the deviation of a grain's value from the mean.

    In mixtures take values over the mean of their species, or the order of the species is what is
    found.

    Parameters
    ----------
    positions : float (n, 2)
        [m]
    values : float (n,)
        Grains whose value or position is NaN are left out.
    edges : float (k + 1,), optional
        Of the bins [m]; as for `radial_distribution` if not given.

    Raises
    ------
    InputError
        If shapes or edges do not fit, or all values are the same.
    """
    positions = checked_positions(positions)
    values = values_of_grains("values", values, len(positions))
    known = np.isfinite(positions).all(axis=1) & np.isfinite(values)
    points, deviation = (
        positions[known],
        values[known] - (values[known].mean() if known.any() else 0.0),
    )
    edges = default_edges(points) if edges is None else checked_edges(edges)
    variance = float(np.mean(deviation**2)) if len(points) else 0.0
    if not variance > 0.0:
        raise InputError("the values do not differ; there is nothing to correlate")
    pairs, products = binned_pairs(points, edges), binned_products(points, deviation, edges)
    found = np.where(pairs > 0, products / np.maximum(pairs, 1) / variance, np.nan)
    return ValueCorrelation(edges, found, pairs)
