"""The potential on a mesh: sources are passed to coarser levels, and potentials back to finer levels."""

from __future__ import annotations

import math

import numba
import numpy as np

from granular.compiled import Array, compiled, make_optionally_threaded_kernel
from granular.pairs.mesh_vectors import add_spline_weights, convolve_eight_columns, interpolate_with_splines
from granular.pairs.multilevel_mesh import ACROSS, LEFT, LOW, PARTS, UP, MultilevelMesh
from granular.pairs.periodic_mesh import (
    copy_periodic_margin,
    index_of_first_mesh_point,
    interpolate_potential_and_gradient_on_periodic_mesh,
    spread_on_periodic_mesh,
)
from granular.pairs.simd import WIDTH
from granular.shared.array_types import Float, Int

_FRACTIONS = (0.75, 0.5, 0.125)
"""Coefficients of a cubic B-spline as a sum of splines half as wide, whose centres are 0, 1 and 2 fine mesh
spacings away.
"""

# Unsigned, since each signed index is checked for being negative.
_UNIT, _TWO = np.uintp(1), np.uintp(2)


# Numbers only: passing arrays for each line would add the cost of reference counting.
@compiled(inline=True)
def _line_start_index(at: int, up: int, begin: int, stride: int, outside: int, periodic: bool) -> np.uintp:
    """Return the start index of a line; beyond the ends, of its periodic image or of a line of zeros."""
    if periodic:
        at %= up
    return np.uintp(begin + at * stride if 0 <= at < up else outside)


@compiled(inline=True)
def _index_of_first_line(points_per_length: Array | None, mesh: MultilevelMesh, level: int) -> int:
    """Return the index at which the first line of a level begins, including the line's margin."""
    if points_per_length is not None:
        return index_of_first_mesh_point(mesh, level) - mesh.margin
    return mesh.begins[level]


@compiled
def _restrict_sources(mesh: MultilevelMesh, level: int) -> None:
    """Compute the sources of a level from the next finer level."""
    fine, coarse = mesh.windows[level - 1], mesh.windows[level]
    row, source, margin = mesh.rows[0], mesh.source, mesh.margin
    total, half, rest = _FRACTIONS
    first = np.uintp(2 * coarse[LEFT] - fine[LEFT] + margin)
    lines, stride, coarse_stride = fine[UP], mesh.strides[level - 1], mesh.strides[level]
    start = _index_of_first_line(mesh.points_per_length, mesh, level - 1)
    outside, coarse_start = mesh.begins[-1], _index_of_first_line(mesh.points_per_length, mesh, level)
    periodic = mesh.points_per_length is not None
    lowest, across = 2 * coarse[LOW] - fine[LOW], coarse[ACROSS]
    for up in range(coarse[UP]):
        at_line = lowest + 2 * up
        lower = _line_start_index(at_line - 2, lines, start, stride, outside, periodic)
        low = _line_start_index(at_line - 1, lines, start, stride, outside, periodic)
        middle = _line_start_index(at_line, lines, start, stride, outside, periodic)
        high = _line_start_index(at_line + 1, lines, start, stride, outside, periodic)
        higher = _line_start_index(at_line + 2, lines, start, stride, outside, periodic)
        for point in range(stride):
            p = np.uintp(point)
            near, far = source[low + p] + source[high + p], source[lower + p] + source[higher + p]
            row[p] = total * source[middle + p] + half * near + rest * far
        begin = np.uintp(coarse_start + up * coarse_stride)
        for point in range(coarse_stride):
            source[begin + np.uintp(point)] = 0.0
        begin += np.uintp(margin)
        for column in range(across):
            at = first + _TWO * np.uintp(column)
            near, far = row[at - _UNIT] + row[at + _UNIT], row[at - _TWO] + row[at + _TWO]
            source[begin + np.uintp(column)] = total * row[at] + half * near + rest * far


@compiled
def _prolong_potential(mesh: MultilevelMesh, level: int) -> None:
    """Add the potential of a level to the next finer level."""
    fine, coarse = mesh.windows[level - 1], mesh.windows[level]
    row, potential, margin = mesh.rows[0], mesh.potential, mesh.margin
    total, half, rest = _FRACTIONS
    odd = fine[LEFT] % 2
    first = np.uintp(fine[LEFT] // 2 - coarse[LEFT] + margin)
    lines, stride, fine_stride = coarse[UP], mesh.strides[level], mesh.strides[level - 1]
    start = _index_of_first_line(mesh.points_per_length, mesh, level)
    fine_start = _index_of_first_line(mesh.points_per_length, mesh, level - 1)
    outside, periodic = mesh.begins[-1], mesh.points_per_length is not None
    lowest, lowest_coarse, pairs = fine[LOW], coarse[LOW], (fine[ACROSS] + odd + 1) // 2
    for up in range(fine[UP]):
        line = lowest + up
        at_line = line // 2 - lowest_coarse
        middle = _line_start_index(at_line, lines, start, stride, outside, periodic)
        below = _line_start_index(at_line - 1, lines, start, stride, outside, periodic)
        above = _line_start_index(at_line + 1, lines, start, stride, outside, periodic)
        own, adjacent = (half, 0.0) if line % 2 == 1 else (total, rest)
        next_one = half if line % 2 == 1 else rest
        for point in range(stride):
            p = np.uintp(point)
            row[p] = (
                own * potential[middle + p]
                + adjacent * potential[below + p]
                + next_one * potential[above + p]
            )
        # If the window begins at an odd point, start one point before it.
        begin = np.uintp(fine_start + up * fine_stride + margin - odd)
        for pair in range(pairs):
            at, out = first + np.uintp(pair), begin + _TWO * np.uintp(pair)
            potential[out] += total * row[at] + rest * (row[at - _UNIT] + row[at + _UNIT])
            potential[out + _UNIT] += half * (row[at] + row[at + _UNIT])


@compiled
def _convolve_columns_of_part(mesh: MultilevelMesh, part: int) -> None:
    """Convolve the sources of every level, on one part of all columns."""
    levels, total, done = len(mesh.windows), 0, 0
    for level in range(levels):
        total += _column_cost(mesh, level) * (_column_count(mesh, level) // WIDTH)
    for level in range(levels):
        cost = _column_cost(mesh, level)
        for column in range(0, _column_count(mesh, level), WIDTH):
            middle = 2 * done + cost
            done += cost
            # A column belongs to the part that contains the middle of its cost, so parts have about equal
            # cost.
            if part * total * 2 <= middle * PARTS < (part + 1) * total * 2:
                _convolve_columns(mesh, level, column, part)


@compiled
def _convolve_columns(mesh: MultilevelMesh, level: int, column: int, part: int) -> None:
    at = _index_of_first_line(mesh.points_per_length, mesh, level) + mesh.margin + column
    along, across = mesh.band_along[level], mesh.band_across[level]
    if level == len(mesh.windows) - 1:
        along, across = mesh.rest_along, mesh.rest_across
    convolve_eight_columns(
        mesh.source,
        mesh.potential,
        along,
        across,
        mesh.rows[part],
        at,
        mesh.strides[level],
        mesh.windows[level, UP],
        # The law is r^-3, and the spacing doubles between levels.
        0.125**level,
        mesh.points_per_length,
    )


@compiled(inline=True)
def _column_count(mesh: MultilevelMesh, level: int) -> int:
    return (mesh.windows[level, ACROSS] + WIDTH - 1) // WIDTH * WIDTH


@compiled(inline=True)
def _column_cost(mesh: MultilevelMesh, level: int) -> int:
    """Return the cost of eight columns of a level; the last level has more terms and a longer range."""
    table = mesh.rest_along if level == len(mesh.windows) - 1 else mesh.band_along[0]
    return mesh.windows[level, UP] * table.shape[0] * table.shape[1]


@make_optionally_threaded_kernel
def _convolve_parts(mesh: MultilevelMesh) -> None:
    for part in numba.prange(PARTS):
        _convolve_columns_of_part(mesh, part)


@compiled
def compute_mesh_potential(
    points_per_length: Float[Array, "2"] | None, mesh: MultilevelMesh, threaded: bool | None
) -> None:
    """Compute the potential [1/D^3] on the finest level of a mesh from its sources."""
    levels = len(mesh.windows)
    for level in range(1, levels):
        _restrict_sources(mesh, level)
        if points_per_length is not None:
            copy_periodic_margin(mesh, mesh.source, level)
    _convolve_parts(threaded, mesh)
    for level in range(levels - 1, 0, -1):
        if points_per_length is not None:
            copy_periodic_margin(mesh, mesh.potential, level)
        _prolong_potential(mesh, level)
    if points_per_length is not None:
        copy_periodic_margin(mesh, mesh.potential, 0)


_STRANDS = 4
"""Number of sequences into which the grains are divided; their amounts are spread on the mesh in turns. An
addition must wait for the previous one if both change the same mesh points, which is rare for grains of
different sequences.
"""


@compiled
def _clear_reached_lines(
    mesh: MultilevelMesh, y: Array, order: Array, first: int, end: int, part: int
) -> None:
    """Clear the lines to which a part of the grains contributes, and store the range of these lines."""
    fineness, low, high = 1.0 / mesh.spacing, math.inf, -math.inf
    for k in range(first, end):
        low, high = min(low, y[order[k]]), max(high, y[order[k]])
    reached = mesh.reached[part]
    reached[0] = reached[1] = 0
    if first < end:
        reached[0] = math.floor(low * fineness) - 1 - mesh.windows[0, LOW]
        reached[1] = math.floor(high * fineness) + 3 - mesh.windows[0, LOW]
    stride = mesh.strides[0]
    mesh.part_sources[part, reached[0] * stride : reached[1] * stride] = 0.0


@compiled
def _spread_grains_of_part(
    mesh: MultilevelMesh, x: Array, y: Array, amounts: Array | None, order: Array, grains: int, part: int
) -> None:
    parts = len(mesh.part_sources)
    first, end = part * grains // parts, (part + 1) * grains // parts
    _clear_reached_lines(mesh, y, order, first, end, part)
    window, fraction, stride = mesh.windows[0], mesh.part_sources[part], mesh.strides[0]
    fineness = 1.0 / mesh.spacing
    corner = mesh.margin - 1 - window[LEFT] - (1 + window[LOW]) * stride
    many = (end - first + _STRANDS - 1) // _STRANDS
    for k in range(_STRANDS * many):
        index = first + k % _STRANDS * many + k // _STRANDS
        if index < end:
            i = order[index]
            u, v = x[i] * fineness, y[i] * fineness
            column, line = math.floor(u), math.floor(v)
            at = corner + int(line) * stride + int(column)
            amount = 1.0 if amounts is None else amounts[i]
            add_spline_weights(fraction, at, stride, u - column, v - line, amount)


@compiled
def _sum_spread_parts_on_lines_of_part(mesh: MultilevelMesh, part: int) -> None:
    """For one part of the finest level's lines, add up the sources from all parts of the grains."""
    up, stride = mesh.windows[0, UP], mesh.strides[0]
    for line in range(part * up // PARTS, (part + 1) * up // PARTS):
        total = mesh.source[line * stride : (line + 1) * stride]
        total[:] = 0.0
        for other in range(len(mesh.part_sources)):
            if mesh.reached[other, 0] <= line < mesh.reached[other, 1]:
                more = mesh.part_sources[other, line * stride : (line + 1) * stride]
                for index in range(total.size):
                    total[index] += more[index]


@make_optionally_threaded_kernel
def _spread_parts(
    mesh: MultilevelMesh, x: Array, y: Array, amounts: Array | None, order: Array, grains: int
) -> None:
    for part in numba.prange(len(mesh.part_sources)):
        _spread_grains_of_part(mesh, x, y, amounts, order, grains, part)


@make_optionally_threaded_kernel
def _sum_spread_parts(mesh: MultilevelMesh) -> None:
    for part in numba.prange(PARTS):
        _sum_spread_parts_on_lines_of_part(mesh, part)


@compiled(inline=True)
def spread_grains(
    points_per_length: Float[Array, "2"] | None,
    mesh: MultilevelMesh,
    threaded: bool | None,
    x: Float[Array, "m"],
    y: Float[Array, "m"],
    amounts: Float[Array, "m"] | None,
    order: Int[Array, "m"],
    grains: int,
) -> None:
    """Spread amounts by cubic B-splines on the finest level; fastest if ``order`` groups neighbours."""
    if points_per_length is not None:
        spread_on_periodic_mesh(mesh, points_per_length, x, y, amounts, order, grains)
    else:
        _spread_parts(threaded, mesh, x, y, amounts, order, grains)
        _sum_spread_parts(threaded, mesh)


@compiled(inline=True)
def interpolate_potential_and_gradient(
    points_per_length: Float[Array, "2"] | None, mesh: MultilevelMesh, x: float, y: float
) -> tuple[float, float, float]:
    """Interpolate the mesh potential [1/D^3] and its derivatives [1/D^4] at a point with cubic B-splines."""
    if points_per_length is not None:
        return interpolate_potential_and_gradient_on_periodic_mesh(mesh, points_per_length, x, y)
    window, fineness, stride = mesh.windows[0], 1.0 / mesh.spacing, mesh.strides[0]
    u, v = x * fineness, y * fineness
    column, line = math.floor(u), math.floor(v)
    row = int(line) - 1 - window[LOW]
    at = mesh.margin - 1 - window[LEFT] + int(column) + row * stride
    value, by_u, by_v = interpolate_with_splines(mesh.potential, at, stride, u - column, v - line)
    return value, by_u * fineness, by_v * fineness
