"""Spreading of grains on the finest level of a mesh, and interpolation from it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numba

from granular.compiled import Array, compiled, threaded_if_wanted
from granular.pairs.multilevel_mesh import LEFT, LOW, PARTS, UP, MultilevelMesh
from granular.pairs.periodic_mesh import interpolate_on_periodic_mesh, spread_on_periodic_mesh
from granular.pairs.spline_stencil import add_spline_weights, interpolate_with_splines

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_STRANDS = 4
"""Grains that are spread in turn come from so many places: a sum waits for the one before it where
both are of the same points."""


@compiled
def _clear_reached_lines(
    mesh: MultilevelMesh, y: Array, order: Array, first: int, end: int, part: int
) -> None:
    """Clear the lines that a part of the grains reaches, and remember which."""
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
def _add_spread_to_part(mesh: MultilevelMesh, part: int) -> None:
    """Add up what all parts of the grains put on a part of the finest level's lines."""
    up, stride = mesh.windows[0, UP], mesh.strides[0]
    for line in range(part * up // PARTS, (part + 1) * up // PARTS):
        total = mesh.source[line * stride : (line + 1) * stride]
        total[:] = 0.0
        for other in range(len(mesh.part_sources)):
            if mesh.reached[other, 0] <= line < mesh.reached[other, 1]:
                more = mesh.part_sources[other, line * stride : (line + 1) * stride]
                for index in range(total.size):
                    total[index] += more[index]


@threaded_if_wanted
def _spread_parts(
    mesh: MultilevelMesh, x: Array, y: Array, amounts: Array | None, order: Array, grains: int
) -> None:
    for part in numba.prange(len(mesh.part_sources)):
        _spread_grains_of_part(mesh, x, y, amounts, order, grains, part)


@threaded_if_wanted
def _add_spread_parts(mesh: MultilevelMesh) -> None:
    for part in numba.prange(PARTS):
        _add_spread_to_part(mesh, part)


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
    """Spread amounts by cubic B-splines on the finest level, quickest in an order of neighbours; x, y [D]."""
    if points_per_length is not None:
        spread_on_periodic_mesh(mesh, points_per_length, x, y, amounts, order, grains)
    else:
        _spread_parts(threaded, mesh, x, y, amounts, order, grains)
        _add_spread_parts(threaded, mesh)


@compiled(inline=True)
def interpolate_potential(
    points_per_length: Float[Array, "2"] | None, mesh: MultilevelMesh, x: float, y: float
) -> tuple[float, float, float]:
    """Potential of the mesh and its derivatives at a point by cubic B-splines [1/D^3, 1/D^4]; x, y [D]."""
    if points_per_length is not None:
        return interpolate_on_periodic_mesh(mesh, points_per_length, x, y)
    window, fineness, stride = mesh.windows[0], 1.0 / mesh.spacing, mesh.strides[0]
    u, v = x * fineness, y * fineness
    column, line = math.floor(u), math.floor(v)
    row = int(line) - 1 - window[LOW]
    at = mesh.margin - 1 - window[LEFT] + int(column) + row * stride
    value, by_u, by_v = interpolate_with_splines(mesh.potential, at, stride, u - column, v - line)
    return value, by_u * fineness, by_v * fineness
