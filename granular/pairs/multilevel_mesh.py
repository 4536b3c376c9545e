"""Multilevel mesh: its arrays, and its windows around the grains.

Each level is a window of a fixed lattice, just large enough for the grains; the spacing doubles
between levels. Cubic B-splines of one level are sums of splines of the next finer level, so
restriction and prolongation are exact.

The far part is summed by multilevel summation (Brandt and Lubrecht 1990,
J. Comput. Phys. 90, 348; Hardy et al. 2015, doi:10.1021/ct5009075). The far part is split into
bands far(r; r_c) - far(r; 2 r_c), far(r; 2 r_c) - far(r; 4 r_c), ..., and a last remainder ("rest").
Each band has a finite range and is smooth on twice the scale of the previous one, so its mesh is
twice as coarse. The law is a power, so all bands share one table, scaled by 1/8 between levels.
Discs add a second power, r^-5, whose coefficient is also multiplied by 1/4 between bands.

Grains are coupled to the mesh by cubic B-splines. For the splines to interpolate the far part between
mesh points (Hardy et al. 2016, doi:10.1063/1.4943868), the table is the far part divided, in Fourier
space, by the samples of the spline, once for each of the two grains. The table is symmetric, and
stored as a sum of products of its leading eigenvectors.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from granular.compiled import Array, compiled
from granular.pairs.dipole_law import far_part_of_inverse_cube
from granular.pairs.direct_sum import MIN_GRAINS_FOR_PARTS
from granular.pairs.mesh_vectors import EXTRA_LINES, TERMS
from granular.pairs.simd import WIDTH, pad_to_vectors
from granular.shared.array_types import Float, Int

Samples = NDArray[np.float64]

# 2 - sqrt(3) = 0.27, the pole of the inverse of a cubic B-spline's samples.
REACH = 4
"""Number of points by which a table extends beyond its band, since dividing by splines leaves tails that
decay by a factor of 0.27 per point.
"""

_EDGES = 8
"""Maximum number of points by which a window extends beyond the grains, over all levels."""

_NEGLIGIBLE_FRACTION = 1e-6
"""Upper bound for the sum of neglected products, as a fraction of the largest entry of the table."""

_DIGITS = 13
"""Number of digits to which products are rounded, since results of linear algebra differ between machines."""

_MARGIN = 48
"""Number of points discarded around a table; periodic images contribute only 0.27^48 to the kept points."""


class SeparableTable(NamedTuple):
    """Kernel between mesh points: a sum of products of a function of the distance along x and one along y."""

    along: Samples  # (groups, reach, TERMS); stacked: (levels, groups, reach, TERMS)
    across: Samples


class MeshTables(NamedTuple):
    """Tables of the bands, one per level, and of the rest."""

    bands: list[SeparableTable]
    rest: SeparableTable


def mesh_level_count(extent: float, radius: float, spacing: float) -> int:
    """Return the number of levels with which the coarsest table covers a bed of this extent."""
    reach = _reach_in_points(radius, spacing)
    return 1 + max(0, math.ceil(math.log2(extent / (spacing * reach))))


def _reach_in_points(radius: float, spacing: float) -> int:
    return math.ceil(2.0 * radius / spacing) + REACH


def _divide_by_splines(samples: Samples) -> Samples:
    """Divide the Fourier transform of a square table, symmetric about the middle, by two grains' splines."""
    wave = 2.0 * np.pi * np.fft.fftfreq(len(samples))
    spline = (2.0 + np.cos(wave)) / 3.0
    fraction = 1.0 / np.outer(spline, spline) ** 2
    spectrum = np.fft.fft2(np.fft.ifftshift(samples))
    return np.asarray(np.fft.fftshift(np.fft.ifft2(spectrum * fraction).real))


def _middle_of_table_divided_by_splines(samples: Samples, reach: int) -> Samples:
    """Return the table for interpolation by splines, for distances from -``reach`` to ``reach``."""
    middle = len(samples) // 2
    chosen = slice(middle - reach, middle + reach + 1)
    return _divide_by_splines(samples)[chosen, chosen]


def _factor_into_products(table: Samples) -> SeparableTable:
    """Write a table, symmetric about the middle and about the diagonals, as a sum of products."""
    reach = len(table) // 2
    values, vectors = np.linalg.eigh(0.5 * (table + table.T))
    order = np.argsort(-np.abs(values))
    # The table is symmetric about its middle, so odd eigenvectors have the eigenvalue 0.
    even = (0.5 * (vectors + vectors[::-1]))[reach:, order]
    even = np.round(even * np.where(even[0] < 0.0, -1.0, 1.0), _DIGITS)
    weights, largest, many = values[order], float(np.abs(table).max()), 0
    remainder = table[reach:, reach:].copy()
    while many < len(weights) and np.abs(remainder).max() > _NEGLIGIBLE_FRACTION * largest:
        group = slice(many, many + TERMS)
        remainder -= (even[:, group] * weights[group]) @ even[:, group].T
        many += TERMS
    return make_separable_table(even[:, :many].T, (weights * even)[:, :many].T, reach + 1)


def make_separable_table(along: Samples, across: Samples, reach: int) -> SeparableTable:
    """Group the factors (terms, distances) of a sum of products, and halve the entries at distance 0."""
    result = np.zeros((2, -(-len(along) // TERMS) * TERMS, reach))
    for table, terms in zip(result, (along, across), strict=True):
        table[: len(terms), : terms.shape[1]] = terms
    result[:, :, 0] *= 0.5
    grouped = result.reshape(2, -1, TERMS, reach).swapaxes(2, 3)
    return SeparableTable(*np.ascontiguousarray(grouped))


@functools.cache
def make_mesh_tables(
    radius: float, spacing: float, levels: int, inverse_fifth_factor: float = 0.0
) -> MeshTables:
    """Make the tables of all levels; ``inverse_fifth_factor``: coefficient of r^-5 relative to r^-3."""
    reach = _reach_in_points(radius, spacing)
    most = reach + _EDGES
    n = np.arange(-most - _MARGIN, most + _MARGIN + 1) * spacing
    square = n[:, None] ** 2 + n[None, :] ** 2

    @functools.cache
    def cached_band_table(factor: float) -> SeparableTable:
        far = far_part_of_inverse_cube(square, radius, factor)
        table = far - far_part_of_inverse_cube(square, 2.0 * radius, factor)
        return _factor_into_products(_middle_of_table_divided_by_splines(table, reach))

    # In units of each level's spacing, the coefficient of r^-5 is a quarter of the next finer level's.
    factors = [0.25**level * inverse_fifth_factor for level in range(levels)]
    rest = far_part_of_inverse_cube(square, radius, factors[-1])
    return MeshTables(
        list(map(cached_band_table, factors)),
        _factor_into_products(_middle_of_table_divided_by_splines(rest, most)),
    )


LEFT, LOW, ACROSS, UP = range(4)
"""Entries of a window: indices of the first point along x and y, and numbers of points along x and y."""

PARTS = 4
"""Number of parts into which grains and points are divided for parallel threads."""

_EDGE = 3
"""Number of points beyond the grains that splines and the next coarser mesh need."""


class MultilevelMesh(NamedTuple):
    """The levels of a mesh, stored consecutively in the same arrays."""

    spacing: float  # of the finest level [D]
    band_along: Float[np.ndarray, "levels groups reach TERMS"]
    band_across: Float[np.ndarray, "levels groups reach TERMS"]
    rest_along: Float[np.ndarray, "groups reach TERMS"]
    rest_across: Float[np.ndarray, "groups reach TERMS"]
    source: Float[
        np.ndarray, "p"
    ]  # lines of each level, zero-padded on both sides; a line of zeros at the end
    potential: Float[np.ndarray, "p"]  # same layout [1/D^3]
    begins: Int[np.ndarray, "levels+1"]  # index at which each level begins, and the end
    strides: Int[np.ndarray, "levels"]  # distance between lines of a level
    margin: int  # number of zeros before a line
    windows: Int[np.ndarray, "levels 4"]  # see `LEFT` to `UP`
    part_sources: Float[np.ndarray, "parts q"]  # sources of each part of the grains on the finest level
    reached: Int[np.ndarray, "parts 2"]  # first and end line of these sources
    rows: Float[np.ndarray, "PARTS r"]  # scratch of the convolution
    points_per_length: Float[np.ndarray, "2"] | None  # for a periodic cell, along x and y [1/D]


def allocate_multilevel_mesh(
    width: float, height: float, radius: float, spacing: float, grains: int, inverse_fifth_factor: float = 0.0
) -> MultilevelMesh:
    """Allocate a multilevel mesh for a closed cell."""
    levels = mesh_level_count(max(width, height), radius, spacing)
    tables = make_mesh_tables(radius, spacing, levels, inverse_fifth_factor)
    points = [
        tuple(math.ceil(extent / (spacing * 2.0**level)) + 2 * _EDGE + 2 for extent in (width, height))
        for level in range(levels)
    ]
    mesh, parts = (
        allocate_mesh_levels(tables, spacing, points, 0),
        PARTS if grains >= MIN_GRAINS_FOR_PARTS else 1,
    )
    return mesh._replace(
        part_sources=np.zeros((parts, mesh.begins[1])), reached=np.zeros((parts, 2), dtype=np.int64)
    )


def allocate_mesh_levels(
    tables: MeshTables, spacing: float, points: Sequence[tuple[int, ...]], copied_lines: int
) -> MultilevelMesh:
    """Allocate the levels of a mesh from their numbers of points and of copied lines."""
    most = max(len(band.along) for band in tables.bands)
    band_along, band_across = (
        np.array([np.pad(table, ((0, most - len(table)), (0, 0), (0, 0))) for table in of_levels])
        for of_levels in zip(*tables.bands, strict=True)
    )
    reach = tables.rest.along.shape[1]
    margin = pad_to_vectors(reach)
    strides = [2 * margin + pad_to_vectors(across) for across, _ in points]
    lines = [up + copied_lines for _, up in points]
    begins = np.cumsum([0, *(stride * up for stride, up in zip(strides, lines, strict=True))])
    # Scratch of each part: eight columns with the reach of a table on both sides, or one whole line.
    scratch = max((max(up for _, up in points) + 2 * reach + EXTRA_LINES) * TERMS * WIDTH, *strides)
    return MultilevelMesh(
        spacing=spacing,
        band_along=band_along,
        band_across=band_across,
        rest_along=tables.rest.along,
        rest_across=tables.rest.across,
        source=np.zeros(begins[-1] + max(strides)),
        potential=np.zeros(begins[-1] + max(strides)),
        begins=begins,
        strides=np.array(strides),
        margin=margin,
        windows=np.zeros((len(points), 4), dtype=np.int64),
        part_sources=np.zeros((0, 0)),
        reached=np.zeros((0, 2), dtype=np.int64),
        rows=np.zeros((PARTS, scratch)),
        points_per_length=None,
    )


@compiled
def fit_windows_to_grains(
    mesh: MultilevelMesh, x: Float[Array, "m"], y: Float[Array, "m"], grains: int
) -> bool:
    """Fit the window of each level to the grains; return False if a window is too small for them."""
    left, right, low, high = x[0], x[0], y[0], y[0]
    for i in range(grains):
        left, right = min(left, x[i]), max(right, x[i])
        low, high = min(low, y[i]), max(high, y[i])
    most = mesh.spacing * mesh.source.size
    if not (right - left <= most and high - low <= most):
        return False
    fineness = 1.0 / mesh.spacing
    window = mesh.windows[0]
    window[LEFT] = math.floor(left * fineness) - 1
    window[ACROSS] = math.floor(right * fineness) + 3 - window[LEFT]
    window[LOW] = math.floor(low * fineness) - 1
    window[UP] = math.floor(high * fineness) + 3 - window[LOW]
    fits = _window_fits_arrays(mesh, 0)
    for level in range(1, len(mesh.windows)):
        fine, coarse = mesh.windows[level - 1], mesh.windows[level]
        for first, many in ((LEFT, ACROSS), (LOW, UP)):
            coarse[first] = fine[first] // 2 - 1
            coarse[many] = (fine[first] + fine[many]) // 2 + 2 - coarse[first]
        fits = fits and _window_fits_arrays(mesh, level)
    last = mesh.windows[len(mesh.windows) - 1]
    return fits and max(last[ACROSS], last[UP]) <= mesh.rest_along.shape[1]


@compiled
def _window_fits_arrays(mesh: MultilevelMesh, level: int) -> bool:
    window, stride = mesh.windows[level], mesh.strides[level]
    workspace = mesh.begins[level + 1] - mesh.begins[level]
    return window[ACROSS] <= stride - 2 * mesh.margin and window[UP] * stride <= workspace
