"""Tables of the far part of the pair law on the points of a mesh.

The far part is summed by multilevel summation (Brandt and Lubrecht 1990,
doi:10.1016/0021-9991(90)90002-I; Hardy et al. 2015, doi:10.1021/ct5009075): it is the sum of
bands far(r; r_c) - far(r; 2 r_c), far(r; 2 r_c) - far(r; 4 r_c), ..., and a last rest. Each band
ends at a distance and is smooth on a scale twice that of the one before, so it lives on a mesh
twice as coarse. The law is a power, so all bands are one table, scaled by 1/8 from level to level.

Grains reach the mesh through cubic B-splines. So that these interpolate the far part between the
points of the mesh (Hardy et al. 2016, doi:10.1063/1.4943868), the table is what the far part leaves
after division, in Fourier space, by the samples of the spline, once for each of the two grains.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from granular.pairs.split import far_cube

Table = NDArray[np.float64]

REACH = 4
"""Points of a table behind the end of its band: the division spreads it by 0.27 a point."""

_EDGES = 8
"""Points that a window may have beyond the grains, over all levels."""

COLUMNS_AT_ONCE = 4
"""The columns of a table are met by so many; it is padded with zeros."""

_NOTHING = 1e-6
"""Of the greatest entry: less is left out."""

_MARGIN = 48
"""Points that are thrown away about a table: 0.27^48 of what is periodic about it reaches in."""


class Tables(NamedTuple):
    """What a point of the mesh feels of another, by the distances along both axes.

    Attributes
    ----------
    band, rest : float64 (r + 1, padded)
        [1/D^3], at the finest level.
    ends : int64 (r + 1,)
        Where each row of the band has come to nothing.
    """

    band: Table
    rest: Table
    ends: NDArray[np.int64]


def levels_over(extent: float, radius: float, spacing: float) -> int:
    """Levels until the rest's table covers a bed of that extent [D]."""
    reach = _reach(radius, spacing)
    return 1 + max(0, math.ceil(math.log2(extent / (spacing * reach))))


def _reach(radius: float, spacing: float) -> int:
    return math.ceil(2.0 * radius / spacing) + REACH


def _interpolating(samples: Table) -> Table:
    """Divide a square table, symmetric about its middle, by the splines of both grains."""
    wave = 2.0 * np.pi * np.fft.fftfreq(len(samples))
    spline = (2.0 + np.cos(wave)) / 3.0
    share = 1.0 / np.outer(spline, spline) ** 2
    spectrum = np.fft.fft2(np.fft.ifftshift(samples))
    return np.asarray(np.fft.fftshift(np.fft.ifft2(spectrum * share).real))


def _quadrant(samples: Table, reach: int) -> Table:
    """Rows and columns 0 .. reach of an interpolating table, padded."""
    middle = len(samples) // 2
    columns = COLUMNS_AT_ONCE * (reach // COLUMNS_AT_ONCE + 1) + 1
    out = np.zeros((reach + 1, columns))
    chosen = slice(middle, middle + reach + 1)
    out[:, : reach + 1] = _interpolating(samples)[chosen, chosen]
    return out


def _ends(table: Table) -> NDArray[np.int64]:
    """Where each row has come to nothing, at the end of a group of columns."""
    last = (np.abs(table) > _NOTHING * table[0, 0]) * np.arange(table.shape[1])
    groups = -(-last.max(axis=1) // COLUMNS_AT_ONCE)
    return np.asarray(1 + COLUMNS_AT_ONCE * groups, dtype=np.int64)


@functools.cache
def mesh_tables(radius: float, spacing: float) -> Tables:
    """Tables of the band and of the rest, for a split radius and a finest spacing [D]."""
    reach = _reach(radius, spacing)
    most = reach + _EDGES
    n = np.arange(-most - _MARGIN, most + _MARGIN + 1) * spacing
    square = n[:, None] ** 2 + n[None, :] ** 2
    rest = far_cube(square, radius)
    band = rest - far_cube(square, 2.0 * radius)
    nearer = _quadrant(band, reach)
    return Tables(nearer, _quadrant(rest, most), _ends(nearer))
