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
from granular.pairs.mesh_kernel import levels_over, mesh_tables

LEFT, LOW, ACROSS, UP = range(4)
"""Entries of a window: its first point along both axes, and how many there are."""

PARTS = 8
"""Parts of a level's lines, which threads may take side by side."""

_EDGE = 3
"""Points that a spline, and the coarser mesh below it, need beyond the grains."""


class Mesh(NamedTuple):
    """The levels of a mesh, one after another in the same arrays.

    Attributes
    ----------
    spacing : float
        Of the finest level [D].
    band, rest : float64 (r + 1, padded)
    ends : int64 (r + 1,)
        See `granular.pairs.mesh_kernel.Tables`.
    source, potential : float64 (p,)
    begins : int64 (levels + 1,)
        Where each level's room begins.
    windows : int64 (levels, 4)
        See `LEFT` and the others.
    rows : float64 (PARTS, q)
        Scratch of the convolution: a row with zeros on both sides, for each part of its lines.
    """

    spacing: float
    band: np.ndarray
    rest: np.ndarray
    ends: np.ndarray
    source: np.ndarray
    potential: np.ndarray
    begins: np.ndarray
    windows: np.ndarray
    rows: np.ndarray


def mesh_room(width: float, height: float, radius: float, spacing: float) -> Mesh:
    """Room for grains in a cell of that size [D]."""
    tables = mesh_tables(radius, spacing)
    levels = levels_over(max(width, height), radius, spacing)
    begins, longest = [0], 0
    for level in range(levels):
        across, up = (
            math.ceil(extent / (spacing * 2.0**level)) + 2 * _EDGE + 2 for extent in (width, height)
        )
        begins.append(begins[-1] + across * up)
        longest = max(longest, across)
    return Mesh(
        spacing=spacing,
        band=tables.band,
        rest=tables.rest,
        ends=tables.ends,
        source=np.zeros(begins[-1]),
        potential=np.zeros(begins[-1]),
        begins=np.array(begins),
        windows=np.zeros((levels, 4), dtype=np.int64),
        rows=np.zeros((PARTS, longest + 2 * tables.rest.shape[1])),
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
    window = mesh.windows[0]
    window[LEFT] = math.floor(left / mesh.spacing) - 1
    window[ACROSS] = math.floor(right / mesh.spacing) + 3 - window[LEFT]
    window[LOW] = math.floor(low / mesh.spacing) - 1
    window[UP] = math.floor(high / mesh.spacing) + 3 - window[LOW]
    fits = _fits(mesh, 0)
    for level in range(1, len(mesh.windows)):
        fine, coarse = mesh.windows[level - 1], mesh.windows[level]
        for first, many in ((LEFT, ACROSS), (LOW, UP)):
            coarse[first] = fine[first] // 2 - 1
            coarse[many] = (fine[first] + fine[many]) // 2 + 2 - coarse[first]
        fits = fits and _fits(mesh, level)
    last = mesh.windows[len(mesh.windows) - 1]
    return fits and max(last[ACROSS], last[UP]) <= len(mesh.rest)


@compiled
def _fits(mesh: Mesh, level: int) -> bool:
    window = mesh.windows[level]
    room = mesh.begins[level + 1] - mesh.begins[level]
    return (
        window[ACROSS] * window[UP] <= room
        and window[ACROSS] + 2 * mesh.rest.shape[1] <= mesh.rows.shape[1]
    )


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
    source: Array, at: int, amount: float, a: float, b: float, c: float, d: float
) -> None:
    source[at] += amount * a
    source[at + 1] += amount * b
    source[at + 2] += amount * c
    source[at + 3] += amount * d


@compiled
def spread(mesh: Mesh, x: Array, y: Array, amounts: Array | None, grains: int) -> None:
    """Put amounts (ones where there are none) on the finest level."""
    window, source = mesh.windows[0], mesh.source
    across = window[ACROSS]
    source[: across * window[UP]] = 0.0
    for i in range(grains):
        u, v = x[i] / mesh.spacing, y[i] / mesh.spacing
        column, line = math.floor(u), math.floor(v)
        a, b, c, d = spline(u - column)
        e, f, g, h = spline(v - line)
        if amounts is not None:
            e, f, g, h = e * amounts[i], f * amounts[i], g * amounts[i], h * amounts[i]
        at = (int(line) - 1 - window[LOW]) * across + int(column) - 1 - window[LEFT]
        _spread_row(source, at, e, a, b, c, d)
        _spread_row(source, at + across, f, a, b, c, d)
        _spread_row(source, at + 2 * across, g, a, b, c, d)
        _spread_row(source, at + 3 * across, h, a, b, c, d)


@compiled
def _restrict(mesh: Mesh, level: int) -> None:
    """Sources of a level from those of the finer one before it."""
    fine, coarse = mesh.windows[level - 1], mesh.windows[level]
    inner, outer = mesh.begins[level - 1], mesh.begins[level]
    across = coarse[ACROSS]
    mesh.source[outer : outer + across * coarse[UP]] = 0.0
    for row in range(fine[UP]):
        line = fine[LOW] + row
        for column in range(fine[ACROSS]):
            place = fine[LEFT] + column
            amount = mesh.source[inner + row * fine[ACROSS] + column]
            for up in range(-1, 2):
                share = _share(line, up) * amount
                if share != 0.0:
                    at = outer + (line // 2 + up - coarse[LOW]) * across
                    at += place // 2 - coarse[LEFT]
                    for over in range(-1, 2):
                        part = _share(place, over)
                        if part != 0.0:
                            mesh.source[at + over] += part * share


@compiled(inline=True)
def _share(place: int, by: int) -> float:
    """Share that the coarse spline ``by`` points from place // 2 has of the fine one at a place.

    A cubic B-spline is (1, 4, 6, 4, 1)/8 of those half as wide.
    """
    if place % 2 == 0:
        return 0.75 if by == 0 else 0.125
    return 0.5 if by >= 0 else 0.0


@compiled
def _prolong(mesh: Mesh, level: int) -> None:
    """Add the potential of a level to that of the finer one before it."""
    fine, coarse = mesh.windows[level - 1], mesh.windows[level]
    inner, outer = mesh.begins[level - 1], mesh.begins[level]
    across = coarse[ACROSS]
    for row in range(fine[UP]):
        line = fine[LOW] + row
        for column in range(fine[ACROSS]):
            place = fine[LEFT] + column
            total = 0.0
            for up in range(-1, 2):
                share = _share(line, up)
                if share != 0.0:
                    at = outer + (line // 2 + up - coarse[LOW]) * across
                    at += place // 2 - coarse[LEFT]
                    for over in range(-1, 2):
                        part = _share(place, over)
                        if part != 0.0:
                            total += share * part * mesh.potential[at + over]
            mesh.potential[inner + row * fine[ACROSS] + column] += total


@compiled(inline=True)
def _add_columns(table: Array, row: Array, out: Array, pad: int) -> None:
    """Add what a row of sources, with zeros on both sides, makes in a row of the potential."""
    across = out.size
    # Slices, since an index that may be negative is not vectorised.
    middle = row[pad : pad + across]
    for p in range(across):
        out[p] += table[0] * middle[p]
    for k in range(1, table.size, 4):
        a, b, c, d = table[k], table[k + 1], table[k + 2], table[k + 3]
        before, behind = row[pad - k - 3 : pad - k + across], row[pad + k : pad + k + across + 3]
        for p in range(across):
            near = a * (before[p + 3] + behind[p]) + b * (before[p + 2] + behind[p + 1])
            far = c * (before[p + 1] + behind[p + 2]) + d * (before[p] + behind[p + 3])
            out[p] += near + far


@compiled
def _convolve_lines(mesh: Mesh, level: int, whole: bool, part: int) -> None:
    """The potential of a level's own sources on a part of its lines."""
    table = mesh.rest if whole else mesh.band
    scale = 0.125**level
    window, begin = mesh.windows[level], mesh.begins[level]
    across, up, pad = window[ACROSS], window[UP], table.shape[1]
    source, row = mesh.source, mesh.rows[part]
    row[: across + 2 * pad] = 0.0
    for line in range(part * up // PARTS, (part + 1) * up // PARTS):
        out = mesh.potential[begin + line * across : begin + (line + 1) * across]
        out[:] = 0.0
        for apart in range(min(len(table), up)):
            below, above = line - apart, line + apart
            if below < 0 and above >= up:
                break
            if below >= 0 and above < up and apart > 0:
                first, second = begin + below * across, begin + above * across
                one, other = source[first : first + across], source[second : second + across]
                for p in range(across):
                    row[pad + p] = one[p] + other[p]
            else:
                first = begin + (below if below >= 0 else above) * across
                row[pad : pad + across] = source[first : first + across]
            stop = table.shape[1] if whole else mesh.ends[apart]
            _add_columns(table[apart, :stop], row, out, pad)
        for p in range(across):
            out[p] *= scale


@compiled
def _convolve(mesh: Mesh, level: int, whole: bool) -> None:
    """The potential of a level's own sources: the band's, or the ``whole`` rest's."""
    for part in range(PARTS):
        _convolve_lines(mesh, level, whole, part)


@compiled(parallel=True)
def _convolve_threaded(mesh: Mesh, level: int, whole: bool) -> None:
    for part in numba.prange(PARTS):
        _convolve_lines(mesh, level, whole, part)


@compiled
def find_potential(mesh: Mesh, threaded: bool | None) -> None:
    """Find the potential on the finest level of the sources there."""
    levels = len(mesh.windows)
    for level in range(1, levels):
        _restrict(mesh, level)
    for level in range(levels):
        whole = level == levels - 1
        if threaded is None:
            _convolve(mesh, level, whole)
        else:
            _convolve_threaded(mesh, level, whole)
    for level in range(levels - 1, 0, -1):
        _prolong(mesh, level)


@compiled(inline=True)
def gathered(mesh: Mesh, x: float, y: float) -> tuple[float, float, float]:
    """The potential at a place, and its derivatives."""
    window, potential = mesh.windows[0], mesh.potential
    across = window[ACROSS]
    u, v = x / mesh.spacing, y / mesh.spacing
    column, line = math.floor(u), math.floor(v)
    a, b, c, d = spline(u - column)
    da, db, dc, dd = spline_slope(u - column)
    up, slope = spline(v - line), spline_slope(v - line)
    at = (int(line) - 1 - window[LOW]) * across + int(column) - 1 - window[LEFT]
    value = by_x = by_y = 0.0
    for k in range(4):
        p, q, r, s = potential[at], potential[at + 1], potential[at + 2], potential[at + 3]
        total = p * a + q * b + r * c + s * d
        value += up[k] * total
        by_x += up[k] * (p * da + q * db + r * dc + s * dd)
        by_y += slope[k] * total
        at += across
    return value, by_x / mesh.spacing, by_y / mesh.spacing
