"""A periodic mesh: sources, levels and potential.

Each level is stored as in `granular.pairs.multilevel_mesh`, with periodic copies in place of zeros. Each
line is preceded and followed by points from its opposite end. One copied line lies below the first line, and
two lie above the last.

The tables give the interaction of a point with another point and all its images. The law is split into bands
of finite range and a remainder ("rest"), as in `granular.pairs.multilevel_mesh`. The rest has infinite range.
On the coarsest level, which has only a few points, it is summed over all images by Ewald's method for the
power r^-3 in the plane. The integral

    1/r^3 = 1/Gamma(3/2) integral of t^(1/2) exp(-r^2 t) dt

is split at t = a^2. The upper part decays within a few 1/a, and the lower part is a Fourier series over the
reciprocal lattice (by Poisson's sum)

    pi/(A Gamma(3/2)) sum_k cos(k d) (2 a exp(-k^2/(4 a^2)) - sqrt(pi) k erfc(k/(2 a))),

with the area A of the cell. The term k = 0 is included, since a sum over r^-3 converges in the plane.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from granular.compiled import Array, compiled
from granular.pairs.dipole_law import far_part_of_inverse_cube
from granular.pairs.mesh_vectors import add_spline_weights, interpolate_with_splines
from granular.pairs.multilevel_mesh import (
    ACROSS,
    REACH,
    UP,
    MeshTables,
    MultilevelMesh,
    SeparableTable,
    allocate_mesh_levels,
    make_separable_table,
)
from granular.shared.array_types import Float, Int

Samples = NDArray[np.float64]

MIN_COARSEST_POINTS = 4
"""Minimum number of points of the coarsest level along the shorter side of the cell; the actual number is
less than twice this minimum.
"""

_MARGIN = 48
"""Number of points discarded around a table, as in `granular.pairs.multilevel_mesh`."""

_SHARPNESS, _IMAGES, _WAVES = 1.8, 6.0, 12.0
"""Parameters of the Ewald sum: a sqrt(A), range of images times a, and maximum wave number divided by a.

Images within 6/a and waves below 12 a are included; the error is then below 1e-15.
"""

_CELLS = 6.0
"""Distance up to which images are summed for r^-5, which decays fast, in units of the cell's longer side."""

_NEGLIGIBLE_FRACTION, _DIGITS = 1e-5, 13
"""Fraction of the first product below which products are neglected, and number of digits to which factors are
rounded. Eight products remain. The neglected products change forces by less than 1e-7; 1e-6 is allowed.
"""


def periodic_mesh_points(width: float, height: float, spacing: float) -> list[tuple[int, int]]:
    """Return the numbers of mesh points along width and height for each level, finest first."""
    needed = [math.ceil(side / spacing) for side in (width, height)]
    levels = 1 + max(0, math.floor(math.log2(min(needed) / MIN_COARSEST_POINTS)))
    across, up = (max(MIN_COARSEST_POINTS, math.ceil(points / 2 ** (levels - 1))) for points in needed)
    return [(across * 2**k, up * 2**k) for k in reversed(range(levels))]


def sum_far_part_over_images(
    dx: Samples, dy: Samples, width: float, height: float, radius: float, inverse_fifth_factor: float = 0.0
) -> Samples:
    """Sum the far part over all images of points at the displacements dx, dy, which have any shape."""
    from scipy.special import erfc, gammainc, gammaincc

    # Ewald 1921, doi:10.1002/andp.19213690304; see the module's docstring.
    sharp = _SHARPNESS / math.sqrt(width * height)
    total = np.zeros(np.broadcast(dx, dy).shape)
    # Within the radius the far part is softened.
    reach = max(radius, _IMAGES / sharp)
    for square in _squared_distances_of_images(dx, dy, (width, height), reach):
        cube = np.maximum(square, 1e-12) ** 1.5
        lower = gammainc(1.5, sharp**2 * square) / cube
        # At r = 0 the lower part has the limit a^3 4/(3 sqrt(pi)).
        lower = np.where(square < 1e-12, sharp**3 * 4.0 / (3.0 * math.sqrt(math.pi)), lower)
        upper = gammaincc(1.5, sharp**2 * square) / cube
        near = far_part_of_inverse_cube(square, radius) - lower
        total += np.where(square < radius**2, near, upper)
    waves = 2.0 * math.pi / np.array([width, height])
    most = [math.ceil(_WAVES * sharp / wave) for wave in waves]
    series = np.full_like(total, 2.0 * sharp)
    for m in range(-most[0], most[0] + 1):
        for n in range(-most[1], most[1] + 1):
            if m or n:
                k = math.hypot(m * waves[0], n * waves[1])
                fraction = 2.0 * sharp * math.exp(-((k / (2.0 * sharp)) ** 2))
                fraction -= math.sqrt(math.pi) * k * erfc(k / (2.0 * sharp))
                series += fraction * np.cos(m * waves[0] * dx + n * waves[1] * dy)
    total += 2.0 * math.sqrt(math.pi) / (width * height) * series
    if inverse_fifth_factor:
        total += _sum_inverse_fifth_over_images(dx, dy, (width, height), radius, inverse_fifth_factor)
    return total


def _sum_inverse_fifth_over_images(
    dx: Samples, dy: Samples, sides: tuple[float, float], radius: float, inverse_fifth_factor: float
) -> Samples:
    """Sum the far part of r^-5 over images; images beyond the sum's range contribute a constant."""
    total = np.zeros(np.broadcast(dx, dy).shape)
    for square in _squared_distances_of_images(dx, dy, sides, max(radius, _CELLS * max(sides))):
        every = far_part_of_inverse_cube(square, radius, inverse_fifth_factor)
        total += every - far_part_of_inverse_cube(square, radius)
    return total


def _squared_distances_of_images(
    dx: Samples, dy: Samples, sides: tuple[float, float], reach: float
) -> Iterator[Samples]:
    """For each image that may be within reach of a point of the cell, yield the squared distances."""
    most = [math.ceil(reach / side) + 1 for side in sides]
    for column in range(-most[0], most[0] + 1):
        for row in range(-most[1], most[1] + 1):
            yield (dx + column * sides[0]) ** 2 + (dy + row * sides[1]) ** 2


def _divide_by_splines(samples: Samples) -> Samples:
    """Divide the Fourier transform of a periodic table by the splines of the two interacting grains."""
    up, across = ((2.0 + np.cos(2.0 * np.pi * np.fft.fftfreq(many))) / 3.0 for many in samples.shape)
    spectrum = np.fft.fft2(samples) / np.outer(up, across) ** 2
    return np.asarray(np.fft.ifft2(spectrum).real)


def _factor_into_products(table: Samples, reach: int) -> SeparableTable:
    """Write a quarter of a table, with the distances up and across as indices, as a sum of products."""
    left, weights, right = np.linalg.svd(table, full_matrices=False)
    # Fix the free sign of each pair of vectors and round, for equal results on all machines.
    signs = np.where(right[:, 0] < 0.0, -1.0, 1.0)
    left, right = np.round(left * signs, _DIGITS), np.round(right * signs[:, None], _DIGITS)
    many = int(np.count_nonzero(weights > _NEGLIGIBLE_FRACTION * weights[0]))
    return make_separable_table(right[:many], (weights * left)[:, :many].T, reach)


def _band_table(radius: float, spacings: tuple[float, float], inverse_fifth_factor: float) -> Samples:
    """Return one quarter of the table of a band: distances from 0 on along both axes."""
    reach = math.ceil(2.0 * radius / min(spacings)) + REACH
    n = np.arange(-reach - _MARGIN, reach + _MARGIN + 1)
    square = (n[:, None] * spacings[1]) ** 2 + (n[None, :] * spacings[0]) ** 2
    samples = far_part_of_inverse_cube(square, radius, inverse_fifth_factor) - far_part_of_inverse_cube(
        square, 2.0 * radius, inverse_fifth_factor
    )
    table = np.fft.fftshift(_divide_by_splines(np.fft.ifftshift(samples)))
    middle = len(n) // 2
    return np.asarray(table[middle : middle + reach + 1, middle : middle + reach + 1])


def _coarsest_level_table(
    width: float, height: float, radius: float, across: int, up: int, inverse_fifth_factor: float
) -> Samples:
    """Return a quarter of the table of the rest; entries at half a period, added twice, are halved."""
    dx, dy = np.meshgrid(np.arange(across) * width / across, np.arange(up) * height / up)
    table = _divide_by_splines(sum_far_part_over_images(dx, dy, width, height, radius, inverse_fifth_factor))
    quarter = table[: up // 2 + 1, : across // 2 + 1].copy()
    if up % 2 == 0:
        quarter[-1] *= 0.5
    if across % 2 == 0:
        quarter[:, -1] *= 0.5
    return quarter


@functools.cache
def make_periodic_mesh_tables(
    width: float, height: float, radius: float, spacing: float, inverse_fifth_factor: float = 0.0
) -> MeshTables:
    """Make the tables of a periodic mesh; ``inverse_fifth_factor``: coefficient of r^-5 relative to r^-3."""
    points = periodic_mesh_points(width, height, spacing)
    fine, coarse = points[0], points[-1]
    scale = 2.0 ** (len(points) - 1)
    spacings = (width / fine[0], height / fine[1])
    factors = [0.25**level * inverse_fifth_factor for level in range(len(points))]
    bands = {factor: _band_table(radius, spacings, factor) for factor in set(factors)}
    rest = _coarsest_level_table(width, height, radius * scale, *coarse, inverse_fifth_factor) * scale**3
    reach = max(*bands[factors[0]].shape, *rest.shape)
    made = {factor: _factor_into_products(band, reach) for factor, band in bands.items()}
    return MeshTables([made[factor] for factor in factors], _factor_into_products(rest, reach))


BELOW, ABOVE = 1, 2
"""Numbers of copied lines before the first line and after the last one, which splines need."""


@compiled(inline=True)
def index_of_first_mesh_point(mesh: MultilevelMesh, level: int) -> int:
    """Return the index of a level's first point in the mesh arrays, after the copied line and the margin."""
    return mesh.begins[level] + mesh.margin + BELOW * mesh.strides[level]


@compiled
def copy_periodic_margin(mesh: MultilevelMesh, values: Float[Array, "p"], level: int) -> None:
    """Copy the points on each side of a level to the margin beyond the opposite side."""
    across, up = mesh.windows[level, ACROSS], mesh.windows[level, UP]
    stride, margin, first = mesh.strides[level], mesh.margin, index_of_first_mesh_point(mesh, level)
    for line in range(up):
        at = first + line * stride
        for apart in range(1, margin + 1):
            values[at - apart] = values[at + (across - apart % across) % across]
        for apart in range(stride - margin - across):
            values[at + across + apart] = values[at + apart % across]
    for line in range(-BELOW, up + ABOVE):
        if line < 0 or line >= up:
            there, here = first - margin + line % up * stride, first - margin + line * stride
            for column in range(stride):
                values[here + column] = values[there + column]


@compiled
def _fold_periodic_margin(mesh: MultilevelMesh, level: int) -> None:
    """Add the amounts spread on copied points to the original points."""
    across, up = mesh.windows[level, ACROSS], mesh.windows[level, UP]
    stride, first, source = mesh.strides[level], index_of_first_mesh_point(mesh, level), mesh.source
    for line in range(-BELOW, up + ABOVE):
        at = first + line * stride
        source[at + across - 1] += source[at - 1]
        for apart in range(2):
            source[at + apart % across] += source[at + across + apart]
        if line < 0 or line >= up:
            there = first + line % up * stride
            for column in range(across):
                source[there + column] += source[at + column]


@compiled
def spread_on_periodic_mesh(
    mesh: MultilevelMesh,
    fineness: Float[Array, "2"],
    x: Float[Array, "m"],
    y: Float[Array, "m"],
    amounts: Float[Array, "m"] | None,
    order: Int[Array, "m"],
    grains: int,
) -> None:
    """Spread amounts by cubic B-splines on a periodic mesh's finest level; ``fineness``: points per D."""
    mesh.source[: mesh.begins[1]] = 0.0
    across, up, stride = mesh.windows[0, ACROSS], mesh.windows[0, UP], mesh.strides[0]
    corner = index_of_first_mesh_point(mesh, 0) - 1 - stride
    for k in range(grains):
        i = order[k]
        u, v = x[i] * fineness[0], y[i] * fineness[1]
        column, line = math.floor(u), math.floor(v)
        at = corner + int(line) % up * stride + int(column) % across
        amount = 1.0 if amounts is None else amounts[i]
        add_spline_weights(mesh.source, at, stride, u - column, v - line, amount)
    _fold_periodic_margin(mesh, 0)
    copy_periodic_margin(mesh, mesh.source, 0)


@compiled(inline=True)
def interpolate_potential_and_gradient_on_periodic_mesh(
    mesh: MultilevelMesh, fineness: Float[Array, "2"], x: float, y: float
) -> tuple[float, float, float]:
    """Interpolate potential and derivatives at a point with cubic B-splines; ``fineness``: points per D."""
    across, up, stride = mesh.windows[0, ACROSS], mesh.windows[0, UP], mesh.strides[0]
    u, v = x * fineness[0], y * fineness[1]
    column, line = math.floor(u), math.floor(v)
    at = index_of_first_mesh_point(mesh, 0) - 1 - stride + int(line) % up * stride + int(column) % across
    value, by_u, by_v = interpolate_with_splines(mesh.potential, at, stride, u - column, v - line)
    return value, by_u * fineness[0], by_v * fineness[1]


def allocate_periodic_mesh(
    width: float, height: float, radius: float, spacing: float, inverse_fifth_factor: float = 0.0
) -> MultilevelMesh:
    """Allocate a periodic mesh."""
    tables = make_periodic_mesh_tables(width, height, radius, spacing, inverse_fifth_factor)
    points = periodic_mesh_points(width, height, spacing)
    mesh = allocate_mesh_levels(tables, spacing, points, BELOW + ABOVE)
    return mesh._replace(
        windows=np.array([(0, 0, across, up) for across, up in points], dtype=np.int64),
        points_per_length=np.array([points[0][0] / width, points[0][1] / height]),
    )
