"""A mesh that goes round a periodic cell: sources, levels and potential, by their places on it.

Each level is stored like those of `granular.pairs.mesh`, with copies in place of zeros: points of
the other side before and behind every line, one line below the first one and two above the last.
"""

from __future__ import annotations

import math

import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.convolution import BESIDE, TERMS
from granular.pairs.lanes import WIDTH, padded
from granular.pairs.mesh import ACROSS, PARTS, UP, Mesh
from granular.pairs.mesh_images import image_tables, points_around
from granular.pairs.stencil import put_spline, spline_sums

BELOW, ABOVE = 1, 2
"""Copied lines that a spline reaches."""

SHARES = (0.75, 0.5, 0.125)
"""Share of a cubic B-spline in the one twice as wide, by the points of the fine mesh between."""


@compiled(inline=True)
def first_point(mesh: Mesh, level: int) -> int:
    """Place of a level's first point."""
    return mesh.begins[level] + mesh.margin + BELOW * mesh.strides[level]


@compiled
def copy_round(mesh: Mesh, values: Array, level: int) -> None:
    """Copy what lies on the one side of a level to the other one."""
    across, up = mesh.windows[level, ACROSS], mesh.windows[level, UP]
    stride, margin, first = mesh.strides[level], mesh.margin, first_point(mesh, level)
    for line in range(up):
        at = first + line * stride
        for apart in range(1, margin + 1):
            values[at - apart] = values[at + (across - apart % across) % across]
        for apart in range(stride - margin - across):
            values[at + across + apart] = values[at + apart % across]
    for line in range(-BELOW, up + ABOVE):
        if line < 0 or line >= up:
            there, here = first - margin + line % up * stride, first - margin + line * stride
            values[here : here + stride] = values[there : there + stride]


@compiled
def _fold(mesh: Mesh, level: int) -> None:
    """Add what was put on the copies of points to the points."""
    across, up = mesh.windows[level, ACROSS], mesh.windows[level, UP]
    stride, first, source = mesh.strides[level], first_point(mesh, level), mesh.source
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
def spread_around(
    mesh: Mesh, fineness: Array, x: Array, y: Array, amounts: Array | None, order: Array,
    grains: int,
) -> None:  # fmt: skip
    """Put amounts (ones where there are none) on the finest level; ``fineness`` [1/D]."""
    mesh.source[: mesh.begins[1]] = 0.0
    across, up, stride = mesh.windows[0, ACROSS], mesh.windows[0, UP], mesh.strides[0]
    corner = first_point(mesh, 0) - 1 - stride
    for k in range(grains):
        i = order[k]
        u, v = x[i] * fineness[0], y[i] * fineness[1]
        column, line = math.floor(u), math.floor(v)
        at = corner + int(line) % up * stride + int(column) % across
        amount = 1.0 if amounts is None else amounts[i]
        put_spline(mesh.source, at, stride, u - column, v - line, amount)
    _fold(mesh, 0)
    copy_round(mesh, mesh.source, 0)


@compiled(inline=True)
def gathered_around(mesh: Mesh, fineness: Array, x: float, y: float) -> tuple[float, float, float]:
    """The potential at a place, and its derivatives."""
    across, up, stride = mesh.windows[0, ACROSS], mesh.windows[0, UP], mesh.strides[0]
    u, v = x * fineness[0], y * fineness[1]
    column, line = math.floor(u), math.floor(v)
    at = first_point(mesh, 0) - 1 - stride + int(line) % up * stride + int(column) % across
    value, by_u, by_v = spline_sums(mesh.potential, at, stride, u - column, v - line)
    return value, by_u * fineness[0], by_v * fineness[1]


@compiled
def restrict_around(mesh: Mesh, level: int) -> None:
    """Sources of a level from those of the finer one before it."""
    row, source, margin = mesh.rows[0], mesh.source, mesh.margin
    whole, half, rest = SHARES
    lines, start, stride = (
        mesh.windows[level - 1, UP],
        first_point(mesh, level - 1),
        mesh.strides[level - 1],
    )
    own, own_stride = first_point(mesh, level), mesh.strides[level]
    across, start = mesh.windows[level, ACROSS], start - margin
    for up in range(mesh.windows[level, UP]):
        lower = start + (2 * up - 2) % lines * stride
        low = start + (2 * up - 1) % lines * stride
        middle = start + 2 * up * stride
        high = start + (2 * up + 1) % lines * stride
        higher = start + (2 * up + 2) % lines * stride
        for p in range(stride):
            near, far = source[low + p] + source[high + p], source[lower + p] + source[higher + p]
            row[p] = whole * source[middle + p] + half * near + rest * far
        for column in range(across):
            at = margin + 2 * column
            near, far = row[at - 1] + row[at + 1], row[at - 2] + row[at + 2]
            source[own + up * own_stride + column] = whole * row[at] + half * near + rest * far
    copy_round(mesh, source, level)


@compiled
def prolong_around(mesh: Mesh, level: int) -> None:
    """Add the potential of a level to that of the finer one before it."""
    row, potential, margin = mesh.rows[0], mesh.potential, mesh.margin
    whole, half, rest = SHARES
    copy_round(mesh, potential, level)
    coarse, stride = first_point(mesh, level) - margin, mesh.strides[level]
    fine, fine_stride = first_point(mesh, level - 1), mesh.strides[level - 1]
    for line in range(mesh.windows[level - 1, UP]):
        # Copies of lines stand beside the first and the last one.
        middle = coarse + line // 2 * stride
        below, above = middle - stride, middle + stride
        odd = line % 2 == 1
        own, beside, behind = (half, 0.0, half) if odd else (whole, rest, rest)
        for p in range(stride):
            row[p] = (
                own * potential[middle + p]
                + beside * potential[below + p]
                + behind * potential[above + p]
            )
        for column in range(mesh.windows[level, ACROSS]):
            at, out = margin + column, fine + line * fine_stride + 2 * column
            potential[out] += whole * row[at] + rest * (row[at - 1] + row[at + 1])
            potential[out + 1] += half * (row[at] + row[at + 1])


def mesh_around_room(width: float, height: float, radius: float, spacing: float) -> Mesh:
    """Room for a mesh round a periodic cell of that size, for a split radius [D]."""
    tables = image_tables(width, height, radius, spacing)
    points = points_around(width, height, spacing)
    reach = tables.rest.along.shape[1]
    margin = padded(reach)
    begins, strides = [0], []
    for across, up in points:
        strides.append(2 * margin + padded(across))
        begins.append(begins[-1] + strides[-1] * (BELOW + up + ABOVE))
    most = points[0][1]
    return Mesh(
        spacing=spacing,
        band_along=tables.band.along,
        band_across=tables.band.across,
        rest_along=tables.rest.along,
        rest_across=tables.rest.across,
        source=np.zeros(begins[-1]),
        potential=np.zeros(begins[-1]),
        begins=np.array(begins),
        strides=np.array(strides),
        margin=margin,
        windows=np.array([(0, 0, across, up) for across, up in points], dtype=np.int64),
        shares=np.zeros((0, 0)),
        reached=np.zeros((0, 2), dtype=np.int64),
        rows=np.zeros((PARTS, (most + 2 * reach + BESIDE) * TERMS * WIDTH)),
        around=np.array([points[0][0] / width, points[0][1] / height]),
    )
