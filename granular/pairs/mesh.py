"""A mesh of several levels: what grains put on its points, and the potential there.

Each level is a window of a lattice that stands still, just large enough for the grains; spacing
doubles from level to level. Cubic B-splines of one level are sums of those of the level before, so
that going up and down the levels loses nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.convolution import TERMS, convolve
from granular.pairs.direct import PARTED_FROM
from granular.pairs.lanes import WIDTH, padded
from granular.pairs.mesh_kernel import levels_over, mesh_tables

LEFT, LOW, ACROSS, UP = range(4)
"""Entries of a window: its first point along both axes, and how many there are."""

PARTS = 4
"""Parts of the grains, and of the points, which threads may take side by side."""

_EDGE = 3
"""Points that a spline, and the coarser mesh below it, need beyond the grains."""


class Mesh(NamedTuple):
    """The levels of a mesh, one after another in the same arrays.

    Attributes
    ----------
    spacing : float
        Of the finest level [D].
    band_along, band_across, rest_along, rest_across : float64 (groups, reach, TERMS)
        See `granular.pairs.mesh_kernel`. One by one, since Numba's threads take no nested tuples.
    source, potential : float64 (p,)
        Each level's lines, with zeros on both sides of every one.
    begins : int64 (levels + 1,)
        Where each level's room begins.
    strides : int64 (levels,)
        From a level's line to its next one.
    margin : int
        Zeros before a line.
    windows : int64 (levels, 4)
        See `LEFT` and the others.
    shares : float64 (parts, q)
        What each part of the grains puts on the finest level.
    reached : int64 (parts, 2)
        The lines that it does so on: the first one, and the one behind the last.
    rows : float64 (PARTS, r)
        Scratch of the convolution.
    """

    spacing: float
    band_along: np.ndarray
    band_across: np.ndarray
    rest_along: np.ndarray
    rest_across: np.ndarray
    source: np.ndarray
    potential: np.ndarray
    begins: np.ndarray
    strides: np.ndarray
    margin: int
    windows: np.ndarray
    shares: np.ndarray
    reached: np.ndarray
    rows: np.ndarray


def mesh_room(width: float, height: float, radius: float, spacing: float, grains: int) -> Mesh:
    """Room for that many grains in a cell of that size [D]."""
    tables = mesh_tables(radius, spacing)
    levels = levels_over(max(width, height), radius, spacing)
    reach = tables.rest.along.shape[1]
    margin = padded(reach)
    begins, strides, most = [0], [], 0
    for level in range(levels):
        across, up = (
            math.ceil(extent / (spacing * 2.0**level)) + 2 * _EDGE + 2 for extent in (width, height)
        )
        strides.append(2 * margin + padded(across))
        begins.append(begins[-1] + strides[-1] * up)
        most = max(most, up)
    parts = PARTS if grains >= PARTED_FROM else 1
    return Mesh(
        spacing=spacing,
        band_along=tables.band.along,
        band_across=tables.band.across,
        rest_along=tables.rest.along,
        rest_across=tables.rest.across,
        source=np.zeros(begins[-1] + margin),
        potential=np.zeros(begins[-1] + margin),
        begins=np.array(begins),
        strides=np.array(strides),
        margin=margin,
        windows=np.zeros((levels, 4), dtype=np.int64),
        shares=np.zeros((parts, begins[1])),
        reached=np.zeros((parts, 2), dtype=np.int64),
        rows=np.zeros((PARTS, (most + 2 * reach) * TERMS * WIDTH)),
    )


@compiled
def open_windows(mesh: Mesh, x: Array, y: Array, grains: int) -> bool:
    """Lay each level's window about the grains; False where there is no room for them."""
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
    fits = _fits(mesh, 0)
    for level in range(1, len(mesh.windows)):
        fine, coarse = mesh.windows[level - 1], mesh.windows[level]
        for first, many in ((LEFT, ACROSS), (LOW, UP)):
            coarse[first] = fine[first] // 2 - 1
            coarse[many] = (fine[first] + fine[many]) // 2 + 2 - coarse[first]
        fits = fits and _fits(mesh, level)
    last = mesh.windows[len(mesh.windows) - 1]
    return fits and max(last[ACROSS], last[UP]) <= mesh.rest_along.shape[1]


@compiled
def _fits(mesh: Mesh, level: int) -> bool:
    window, stride = mesh.windows[level], mesh.strides[level]
    room = mesh.begins[level + 1] - mesh.begins[level]
    return window[ACROSS] <= stride - 2 * mesh.margin and window[UP] * stride <= room


@compiled(inline=True)
def spline(u: float) -> tuple[float, float, float, float]:
    """Cubic B-splines of four points, at the share u of the way from the second to the third."""
    v = 1.0 - u
    return (
        v * v * v / 6.0,
        (0.5 * u - 1.0) * u * u + 2.0 / 3.0,
        (0.5 * v - 1.0) * v * v + 2.0 / 3.0,
        u * u * u / 6.0,
    )


@compiled(inline=True)
def spline_slope(u: float) -> tuple[float, float, float, float]:
    """Derivatives of `spline`."""
    v = 1.0 - u
    return -0.5 * v * v, (1.5 * u - 2.0) * u, (2.0 - 1.5 * v) * v, 0.5 * u * u


@compiled(inline=True)
def _spread_row(
    share: Array, at: np.uintp, amount: float, a: float, b: float, c: float, d: float
) -> None:
    # Unsigned, since an index that may be negative is looked at every time.
    share[at] += amount * a
    share[at + np.uintp(1)] += amount * b
    share[at + np.uintp(2)] += amount * c
    share[at + np.uintp(3)] += amount * d


@compiled
def _reach_lines(mesh: Mesh, y: Array, order: Array, first: int, end: int, part: int) -> None:
    """Clear the lines that a part of the grains reaches, and remember which."""
    fineness, low, high = 1.0 / mesh.spacing, math.inf, -math.inf
    for k in range(first, end):
        line = math.floor(y[order[k]] * fineness)
        low, high = min(low, line), max(high, line)
    reached = mesh.reached[part]
    reached[0] = reached[1] = 0
    if first < end:
        reached[0] = int(low) - 1 - mesh.windows[0, LOW]
        reached[1] = int(high) + 3 - mesh.windows[0, LOW]
    stride = mesh.strides[0]
    mesh.shares[part, reached[0] * stride : reached[1] * stride] = 0.0


@compiled
def _spread_part(
    mesh: Mesh, x: Array, y: Array, amounts: Array | None, order: Array, grains: int, part: int
) -> None:
    parts = len(mesh.shares)
    first, end = part * grains // parts, (part + 1) * grains // parts
    _reach_lines(mesh, y, order, first, end, part)
    window, share, stride = mesh.windows[0], mesh.shares[part], np.uintp(mesh.strides[0])
    fineness = 1.0 / mesh.spacing
    corner = mesh.margin - 1 - window[LEFT] - (1 + window[LOW]) * mesh.strides[0]
    for k in range(first, end):
        i = order[k]
        u, v = x[i] * fineness, y[i] * fineness
        column, line = math.floor(u), math.floor(v)
        a, b, c, d = spline(u - column)
        e, f, g, h = spline(v - line)
        if amounts is not None:
            e, f, g, h = e * amounts[i], f * amounts[i], g * amounts[i], h * amounts[i]
        at = np.uintp(corner + int(line) * mesh.strides[0] + int(column))
        _spread_row(share, at, e, a, b, c, d)
        at += stride
        _spread_row(share, at, f, a, b, c, d)
        at += stride
        _spread_row(share, at, g, a, b, c, d)
        at += stride
        _spread_row(share, at, h, a, b, c, d)


@compiled
def _join_part(mesh: Mesh, part: int) -> None:
    """Add up what all parts of the grains put on a part of the finest level's lines."""
    up, stride = mesh.windows[0, UP], mesh.strides[0]
    for line in range(part * up // PARTS, (part + 1) * up // PARTS):
        total = mesh.source[line * stride : (line + 1) * stride]
        total[:] = 0.0
        for other in range(len(mesh.shares)):
            if mesh.reached[other, 0] <= line < mesh.reached[other, 1]:
                more = mesh.shares[other, line * stride : (line + 1) * stride]
                for place in range(total.size):
                    total[place] += more[place]


@compiled(parallel=True)
def _spread_threaded(
    mesh: Mesh, x: Array, y: Array, amounts: Array | None, order: Array, grains: int
) -> None:
    for part in numba.prange(len(mesh.shares)):
        _spread_part(mesh, x, y, amounts, order, grains, part)


@compiled(parallel=True)
def _join_threaded(mesh: Mesh) -> None:
    for part in numba.prange(PARTS):
        _join_part(mesh, part)


@compiled
def spread(
    mesh: Mesh, threaded: bool | None, x: Array, y: Array, amounts: Array | None, order: Array,
    grains: int,
) -> None:  # fmt: skip
    """Put amounts (ones where there are none) on the finest level.

    ``order``, int64 (m,), names the grains one after another: it is quickest where neighbours
    follow each other.
    """
    if threaded is None:
        for part in range(len(mesh.shares)):
            _spread_part(mesh, x, y, amounts, order, grains, part)
        for part in range(PARTS):
            _join_part(mesh, part)
    else:
        _spread_threaded(mesh, x, y, amounts, order, grains)
        _join_threaded(mesh)


SHARES = (0.75, 0.5, 0.125)
"""Share of a cubic B-spline in the one twice as wide, by the points of the fine mesh between."""


@compiled(inline=True)
def _line_of(level: int, mesh: Mesh, values: Array, line: int) -> Array:
    """A line of a level, by its place on the lattice, with its margins; empty outside."""
    window, stride = mesh.windows[level], mesh.strides[level]
    at = line - window[LOW]
    begin = mesh.begins[level] + at * stride
    return values[begin : begin + (stride if 0 <= at < window[UP] else 0)]


@compiled
def _restrict(mesh: Mesh, level: int) -> None:
    """Sources of a level from those of the finer one before it."""
    fine, coarse = mesh.windows[level - 1], mesh.windows[level]
    row = mesh.rows[0, : mesh.strides[level - 1]]
    for up in range(coarse[UP]):
        line = coarse[LOW] + up
        row[:] = 0.0
        for by in range(-2, 3):
            share = SHARES[abs(by)]
            values = _line_of(level - 1, mesh, mesh.source, 2 * line + by)
            for place in range(values.size):
                row[place] += share * values[place]
        begin = mesh.begins[level] + up * mesh.strides[level]
        mesh.source[begin : begin + mesh.strides[level]] = 0.0
        begin += mesh.margin
        first = 2 * coarse[LEFT] - fine[LEFT] + mesh.margin
        out = mesh.source[begin : begin + coarse[ACROSS]]
        for column in range(coarse[ACROSS]):
            at = first + 2 * column
            near, far = row[at - 1] + row[at + 1], row[at - 2] + row[at + 2]
            out[column] = SHARES[0] * row[at] + SHARES[1] * near + SHARES[2] * far


@compiled
def _prolong(mesh: Mesh, level: int) -> None:
    """Add the potential of a level to that of the finer one before it."""
    fine, coarse = mesh.windows[level - 1], mesh.windows[level]
    row = mesh.rows[0, : mesh.strides[level]]
    for up in range(fine[UP]):
        line = fine[LOW] + up
        row[:] = 0.0
        for half in range(line // 2 - 1, line // 2 + 2):
            apart = abs(line - 2 * half)
            if apart < len(SHARES):
                values = _line_of(level, mesh, mesh.potential, half)
                for place in range(values.size):
                    row[place] += SHARES[apart] * values[place]
        begin = mesh.begins[level - 1] + up * mesh.strides[level - 1] + mesh.margin
        out = mesh.potential[begin : begin + fine[ACROSS]]
        first = mesh.margin - coarse[LEFT]
        for column in range(fine[LEFT] % 2, fine[ACROSS], 2):
            at = first + (fine[LEFT] + column) // 2
            out[column] += SHARES[0] * row[at] + SHARES[2] * (row[at - 1] + row[at + 1])
        for column in range(1 - fine[LEFT] % 2, fine[ACROSS], 2):
            at = first + (fine[LEFT] + column) // 2
            out[column] += SHARES[1] * (row[at] + row[at + 1])


@compiled
def _convolve_part(mesh: Mesh, part: int) -> None:
    """The potential of each level's own sources on a part of all columns.

    The bands', and on the last level the rest's. Parts take about equally long.
    """
    levels, total, done = len(mesh.windows), 0, 0
    for level in range(levels):
        total += _cost(mesh, level) * (_columns(mesh, level) // WIDTH)
    for level in range(levels):
        cost = _cost(mesh, level)
        for column in range(0, _columns(mesh, level), WIDTH):
            middle = 2 * done + cost
            done += cost
            if part * total * 2 <= middle * PARTS < (part + 1) * total * 2:
                _convolve_columns(mesh, level, column, part)


@compiled
def _convolve_columns(mesh: Mesh, level: int, column: int, part: int) -> None:
    at, up = mesh.begins[level] + mesh.margin + column, mesh.windows[level, UP]
    along, across = mesh.band_along, mesh.band_across
    if level == len(mesh.windows) - 1:
        along, across = mesh.rest_along, mesh.rest_across
    convolve(
        mesh.source, mesh.potential, along, across, mesh.rows[part], at, mesh.strides[level], up,
        0.125**level,
    )  # fmt: skip


@compiled(inline=True)
def _columns(mesh: Mesh, level: int) -> int:
    return (mesh.windows[level, ACROSS] + WIDTH - 1) // WIDTH * WIDTH


@compiled(inline=True)
def _cost(mesh: Mesh, level: int) -> int:
    """Of eight columns of a level: the rest takes more groups of terms, and reaches further."""
    table = mesh.rest_along if level == len(mesh.windows) - 1 else mesh.band_along
    return mesh.windows[level, UP] * table.shape[0] * table.shape[1]


@compiled(parallel=True)
def _convolve_threaded(mesh: Mesh) -> None:
    for part in numba.prange(PARTS):
        _convolve_part(mesh, part)


@compiled
def find_potential(mesh: Mesh, threaded: bool | None) -> None:
    """Find the potential on the finest level of the sources there."""
    levels = len(mesh.windows)
    for level in range(1, levels):
        _restrict(mesh, level)
    if threaded is None:
        for part in range(PARTS):
            _convolve_part(mesh, part)
    else:
        _convolve_threaded(mesh)
    for level in range(levels - 1, 0, -1):
        _prolong(mesh, level)


@compiled(inline=True)
def gathered(mesh: Mesh, x: float, y: float) -> tuple[float, float, float]:
    """The potential at a place, and its derivatives."""
    window, potential = mesh.windows[0], mesh.potential
    fineness, stride = 1.0 / mesh.spacing, np.uintp(mesh.strides[0])
    u, v = x * fineness, y * fineness
    column, line = math.floor(u), math.floor(v)
    a, b, c, d = spline(u - column)
    da, db, dc, dd = spline_slope(u - column)
    up, slope = spline(v - line), spline_slope(v - line)
    row = int(line) - 1 - window[LOW]
    at = np.uintp(mesh.margin - 1 - window[LEFT] + int(column) + row * mesh.strides[0])
    p = q = r = s = dp = dq = dr = ds = 0.0
    for k in range(4):
        e, f = potential[at], potential[at + np.uintp(1)]
        g, h = potential[at + np.uintp(2)], potential[at + np.uintp(3)]
        p, q, r, s = p + up[k] * e, q + up[k] * f, r + up[k] * g, s + up[k] * h
        dp, dq = dp + slope[k] * e, dq + slope[k] * f
        dr, ds = dr + slope[k] * g, ds + slope[k] * h
        at += stride
    value = p * a + q * b + r * c + s * d
    by_x = p * da + q * db + r * dc + s * dd
    by_y = dp * a + dq * b + dr * c + ds * d
    return value, by_x * fineness, by_y * fineness
