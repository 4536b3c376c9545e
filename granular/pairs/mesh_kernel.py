"""Tables of the far part of the pair law on the points of a mesh.

The far part is summed by multilevel summation (Brandt and Lubrecht 1990,
doi:10.1016/0021-9991(90)90002-I; Hardy et al. 2015, doi:10.1021/ct5009075): it is the sum of
bands far(r; r_c) - far(r; 2 r_c), far(r; 2 r_c) - far(r; 4 r_c), ..., and a last rest. Each band
ends at a distance and is smooth on a scale twice that of the one before, so it lives on a mesh
twice as coarse. The law is a power, so all bands are one table, scaled by 1/8 from level to level.

Grains reach the mesh through cubic B-splines. So that these interpolate the far part between the
points of the mesh (Hardy et al. 2016, doi:10.1063/1.4943868), the table is what the far part leaves
after division, in Fourier space, by the samples of the spline, once for each of the two grains.
The table is symmetric, and kept as the sum of the products of its first eigenvectors.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from granular.pairs.convolution import TERMS
from granular.pairs.split import far_cube

Samples = NDArray[np.float64]

REACH = 4
"""Points of a table behind the end of its band: the division spreads it by 0.27 a point."""

_EDGES = 8
"""Points that a window may have beyond the grains, over all levels."""

_NOTHING = 1e-6
"""Of the greatest entry: the products that are left out make less."""

_DIGITS = 13
"""Of the products' numbers: what linear algebra finds differs from machine to machine."""

_MARGIN = 48
"""Points that are thrown away about a table: 0.27^48 of what is periodic about it reaches in."""


class Table(NamedTuple):
    """What a point of the mesh feels of another, by the distances along both axes [1/D^3].

    At the finest level; see `granular.pairs.convolution`.

    Attributes
    ----------
    along, across : float64 (groups, reach, TERMS)
    """

    along: Samples
    across: Samples


class Tables(NamedTuple):
    """Those of the bands, and of the rest."""

    band: Table
    rest: Table


def levels_over(extent: float, radius: float, spacing: float) -> int:
    """Levels until the rest's table covers a bed of that extent [D]."""
    reach = _reach(radius, spacing)
    return 1 + max(0, math.ceil(math.log2(extent / (spacing * reach))))


def _reach(radius: float, spacing: float) -> int:
    return math.ceil(2.0 * radius / spacing) + REACH


def _interpolating(samples: Samples) -> Samples:
    """Divide a square table, symmetric about its middle, by the splines of both grains."""
    wave = 2.0 * np.pi * np.fft.fftfreq(len(samples))
    spline = (2.0 + np.cos(wave)) / 3.0
    share = 1.0 / np.outer(spline, spline) ** 2
    spectrum = np.fft.fft2(np.fft.ifftshift(samples))
    return np.asarray(np.fft.fftshift(np.fft.ifft2(spectrum * share).real))


def _middle(samples: Samples, reach: int) -> Samples:
    """The distances up to ``reach``, on both sides, of an interpolating table."""
    middle = len(samples) // 2
    chosen = slice(middle - reach, middle + reach + 1)
    return _interpolating(samples)[chosen, chosen]


def _products(table: Samples) -> Table:
    """A table, symmetric about its middle and about its diagonals, as a sum of products."""
    reach = len(table) // 2
    values, vectors = np.linalg.eigh(0.5 * (table + table.T))
    order = np.argsort(-np.abs(values))
    # All that is left with a weight is even.
    even = (0.5 * (vectors + vectors[::-1]))[reach:, order]
    even = np.round(even * np.where(even[0] < 0.0, -1.0, 1.0), _DIGITS)
    weights, greatest, many = values[order], float(np.abs(table).max()), 0
    left = table[reach:, reach:].copy()
    while many < len(weights) and np.abs(left).max() > _NOTHING * greatest:
        group = slice(many, many + TERMS)
        left -= (even[:, group] * weights[group]) @ even[:, group].T
        many += TERMS
    along = np.zeros((many // TERMS, reach + 1, TERMS))
    across = np.zeros_like(along)
    for term in range(min(many, len(weights))):
        along[term // TERMS, :, term % TERMS] = even[:, term]
        across[term // TERMS, :, term % TERMS] = weights[term] * even[:, term]
    along[:, 0] *= 0.5
    across[:, 0] *= 0.5
    return Table(along, across)


@functools.cache
def mesh_tables(radius: float, spacing: float) -> Tables:
    """Tables of the band and of the rest, for a split radius and a finest spacing [D]."""
    reach = _reach(radius, spacing)
    most = reach + _EDGES
    n = np.arange(-most - _MARGIN, most + _MARGIN + 1) * spacing
    square = n[:, None] ** 2 + n[None, :] ** 2
    rest = far_cube(square, radius)
    band = rest - far_cube(square, 2.0 * radius)
    return Tables(_products(_middle(band, reach)), _products(_middle(rest, most)))
