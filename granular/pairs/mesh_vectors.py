"""Convolution on a mesh, and cubic B-splines, as vector instructions.

The kernel of a convolution is a sum of products of a function of the distance along x and a function of the
distance along y (`TERMS` products per group). The sources are therefore convolved first along the lines, for
all terms together, and then across the lines, term by term.

Splines are evaluated on the four by four points around a grain, one line at a time. The splines of the four
points along an axis, and their slopes, are eight polynomials of one variable: the distance of the grain from
the second point towards the third.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

from granular.compiled import Array, compiled
from granular.pairs.simd import (
    DOUBLE,
    INDEX,
    LANES,
    WIDTH,
    VectorBuilder,
    broadcast_constant,
    constant_vector,
)

TERMS = WIDTH
"""Number of products that are evaluated together."""

EXTRA_LINES = 3
"""Number of lines beyond the last one that are read although they are not used."""

_LINES, _DISTANCES = 1 + EXTRA_LINES, (4, 2, 1)
"""`_LINES` is the number of lines that are processed together. `_DISTANCES` lists the numbers of distances
between lines whose terms are added together: four fill the registers, and the remaining distances are added
in a group of two or singly.
"""


def _emit_convolution_along_lines(
    code: VectorBuilder, source: ir.Value, indices: list[ir.Value], table: ir.Value, reach: ir.Value
) -> list[list[ir.Value]]:
    """Convolve points along their lines, on both sides of each point; emit a sum for each point and term."""
    b = code.builder
    sums = [_emit_zero_sums(code, TERMS) for _ in indices]
    zero, step = ir.Constant(INDEX, 0), ir.Constant(INDEX, 1)
    with cgutils.for_range_slice(b, zero, reach, step, INDEX) as (apart, _):
        first = b.mul(apart, ir.Constant(INDEX, TERMS))
        both = [
            b.fadd(code.load_vector(source, b.sub(at, apart)), code.load_vector(source, b.add(at, apart)))
            for at in indices
        ]
        for term in range(TERMS):
            fraction = code.broadcast_scalar(code.load_scalar(table, b.add(first, ir.Constant(INDEX, term))))
            for values, totals in zip(both, sums, strict=True):
                b.store(code.fused_multiply_add(values, fraction, b.load(totals[term])), totals[term])
    return [[b.load(total) for total in totals] for totals in sums]


def _emit_copy_of_periodic_lines(
    code: VectorBuilder, rows: ir.Value, lines: ir.Value, reach: ir.Value
) -> None:
    """Copy the sums along lines to the periodic images of the lines, before the first and after the last."""
    b = code.builder
    block, width = ir.Constant(INDEX, TERMS * WIDTH), ir.Constant(INDEX, WIDTH)
    zero, unity = ir.Constant(INDEX, 0), ir.Constant(INDEX, 1)
    total = b.mul(lines, reach)
    behind = b.add(reach, ir.Constant(INDEX, EXTRA_LINES))
    with cgutils.for_range_slice(b, zero, b.add(reach, behind), unity, INDEX) as (copy, _):
        before = b.icmp_signed("<", copy, reach)
        here = b.select(before, copy, b.add(copy, lines))
        from_line = b.urem(b.sub(b.add(here, total), reach), lines)
        there = b.mul(b.add(from_line, reach), block)
        with cgutils.for_range_slice(b, zero, block, width, INDEX) as (position, _):
            value = code.load_vector(rows, b.add(there, position))
            code.store_vector(value, rows, b.add(b.mul(here, block), position))


def _emit_zero_sums(code: VectorBuilder, many: int) -> list[Any]:
    sums = [code.new_variable(broadcast_constant(0.0)) for _ in range(many)]
    for sum_pointer in sums:
        code.builder.store(broadcast_constant(0.0), sum_pointer)
    return sums


def _emit_addition_of_terms_to_line_sums(
    code: VectorBuilder,
    rows: ir.Value,
    begin: ir.Value,
    table: ir.Value,
    apart: ir.Value,
    distances: int,
    sums: list[Any],
) -> None:
    """Emit code that adds the terms for a group of distances to the sum of each mesh line."""
    b = code.builder
    block = TERMS * WIDTH
    down = b.sub(begin, b.mul(apart, ir.Constant(INDEX, block)))
    up = b.add(begin, b.mul(apart, ir.Constant(INDEX, block)))
    many = len(sums) + distances - 1
    below = [
        code.load_vector(rows, b.add(down, ir.Constant(INDEX, (line - distances + 1) * block)))
        for line in range(many)
    ]
    above = [code.load_vector(rows, b.add(up, ir.Constant(INDEX, line * block))) for line in range(many)]
    for by in range(distances):
        index = b.mul(b.add(apart, ir.Constant(INDEX, by)), ir.Constant(INDEX, TERMS))
        fraction = code.broadcast_scalar(code.load_scalar(table, index))
        for line, total in enumerate(sums):
            both = b.fadd(below[line + distances - 1 - by], above[line + by])
            b.store(code.fused_multiply_add(both, fraction, b.load(total)), total)


def _emit_convolution_across_lines(
    code: VectorBuilder, rows: ir.Value, line: ir.Value, table: ir.Value, reach: ir.Value
) -> list[ir.Value]:
    """Convolve `_LINES` points across the lines, on both sides of each point, and sum over the terms."""
    b = code.builder
    block = ir.Constant(INDEX, TERMS * WIDTH)
    zero, unity, many = (ir.Constant(INDEX, value) for value in (0, 1, TERMS))
    result = [cgutils.alloca_once(b, LANES, size=TERMS) for _ in range(_LINES)]
    with cgutils.for_range_slice(b, zero, many, unity, INDEX) as (term, _):
        begin = b.add(b.mul(line, block), b.mul(term, ir.Constant(INDEX, WIDTH)))
        fractions, sums, done = b.gep(table, [term]), _emit_zero_sums(code, _LINES), zero
        for distances in _DISTANCES:
            step = ir.Constant(INDEX, distances)
            end = b.sub(reach, b.urem(b.sub(reach, done), step))
            with cgutils.for_range_slice(b, done, end, step, INDEX) as (apart, _):
                _emit_addition_of_terms_to_line_sums(code, rows, begin, fractions, apart, distances, sums)
            done = end
        for position, total in zip(result, sums, strict=True):
            b.store(b.load(total), b.gep(position, [term]))
    terms = [ir.Constant(INDEX, term) for term in range(TERMS)]
    values = [[b.load(b.gep(index, [term])) for index in result] for term in terms]
    while len(values) > 1:
        values = [
            [b.fadd(*pair) for pair in zip(first, second, strict=True)]
            for first, second in zip(values[::2], values[1::2], strict=True)
        ]
    return values[0]


@intrinsic
def _convolve_eight_columns(
    typing: Any,
    source: Any,
    out: Any,
    along: Any,
    across: Any,
    rows: Any,
    at: Any,
    stride: Any,
    lines: Any,
    first: Any,
    scale: Any,
    points_per_length: Any,
) -> Any:
    signature = types.void(
        source,
        out,
        along,
        across,
        rows,
        types.intp,
        types.intp,
        types.intp,
        types.boolean,
        types.float64,
        points_per_length,
    )

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code, b = VectorBuilder(context, builder), builder
        pointers = [
            code.array_pointer(kind, array)
            for kind, array in zip(signature.args[:5], values[:5], strict=True)
        ]
        source, out, along, across, rows = pointers
        at, stride, lines, first, scale = values[5:10]
        shape = context.make_array(signature.args[2])(context, b, values[2]).shape
        reach = b.extract_value(shape, 0)
        zero, unity = ir.Constant(INDEX, 0), ir.Constant(INDEX, 1)
        block = ir.Constant(INDEX, TERMS * WIDTH)
        last = b.sub(lines, unity)
        with cgutils.for_range_slice(b, zero, lines, ir.Constant(INDEX, 2), INDEX) as (line, _):
            behind = b.add(line, unity)
            two = [line, b.select(b.icmp_signed("<", behind, lines), behind, last)]
            indices = [b.add(at, b.mul(here, stride)) for here in two]
            for here, sums in zip(
                two, _emit_convolution_along_lines(code, source, indices, along, reach), strict=True
            ):
                begin = b.mul(b.add(here, reach), block)
                for term, value in enumerate(sums):
                    code.store_vector(value, rows, b.add(begin, ir.Constant(INDEX, term * WIDTH)))
        if not isinstance(signature.args[10], types.NoneType):
            _emit_copy_of_periodic_lines(code, rows, lines, reach)
        factor = code.broadcast_scalar(scale)
        many = ir.Constant(INDEX, _LINES)
        with cgutils.for_range_slice(b, zero, lines, many, INDEX) as (line, _):
            values = _emit_convolution_across_lines(code, rows, b.add(line, reach), across, reach)
            for behind, value in enumerate(values):
                here = b.add(line, ir.Constant(INDEX, behind))
                with b.if_then(b.icmp_signed("<", here, lines)):
                    index = b.add(at, b.mul(here, stride))
                    before = b.select(first, broadcast_constant(0.0), code.load_vector(out, index))
                    code.store_vector(b.fadd(before, b.fmul(value, factor)), out, index)
        return context.get_dummy_value()

    return signature, generate


@compiled
def _compiled_convolve(
    source: Array,
    out: Array,
    along: Array,
    across: Array,
    rows: Array,
    at: int,
    stride: int,
    lines: int,
    scale: float,
    points_per_length: Array | None,
) -> None:
    reach, block = along.shape[1], TERMS * WIDTH
    rows[: reach * block] = 0.0
    rows[(reach + lines) * block : (2 * reach + lines) * block] = 0.0
    for group in range(len(along)):
        _convolve_eight_columns(
            source,
            out,
            along[group],
            across[group],
            rows,
            at,
            stride,
            lines,
            group == 0,
            scale,
            points_per_length,
        )


def _pure_python_convolve(
    source: Array,
    out: Array,
    along: Array,
    across: Array,
    rows: Array,
    at: int,
    stride: int,
    lines: int,
    scale: float,
    points_per_length: Array | None,
) -> None:
    weights = np.tensordot(along, across, axes=([0, 2], [0, 2]))
    weights[0] *= 2.0
    weights[:, 0] *= 2.0
    reach = len(weights)
    shifts = np.arange(1 - reach, reach)
    indices = at + stride * np.arange(lines)[:, None] + np.arange(WIDTH)
    out[indices] = 0.0
    for there in range(1 - reach, reach):
        chosen = np.arange(lines)
        if points_per_length is None:
            chosen = np.arange(max(0, -there), min(lines, lines - there))
        others = indices[(chosen + there) % lines]
        near = source[others[:, None] + shifts[:, None]]
        out[indices[chosen]] += scale * np.einsum("h,lhw->lw", weights[abs(shifts), abs(there)], near)


convolve_eight_columns = _pure_python_convolve if config.DISABLE_JIT else _compiled_convolve
"""Overwrite eight columns of all lines with the potential of the surrounding sources.

Parameters
----------
source, out : float64 (p,)
    Consecutive lines, each padded with as many zeros as the table has distances (the reach).
along, across : float64 (groups, reach, `TERMS`)
    Factors of the kernel at distances 0, 1, ...; the factors at distance 0 are halved.
rows : float64 (q,)
    Scratch: `TERMS` times `WIDTH` numbers per line, for ``lines`` + twice the reach + `EXTRA_LINES` lines.
at : int
    Index of the first line's first column.
stride, lines : int
    Distance between lines in the array, and number of lines.
scale : float
points_per_length : float64 (2,) or None
    Not None if the lines are periodic, that is, if the last line is followed by the first.
"""


POINTS = 4
"""Number of points of a spline along each axis."""

_POLYNOMIALS = (
    (1 / 6, 2 / 3, 1 / 6, 0.0, -0.5, 0.0, 0.5, 0.0),
    (-0.5, 0.0, 0.5, 0.0, 1.0, -2.0, 1.0, 0.0),
    (0.5, -1.0, 0.5, 0.0, -0.5, 1.5, -1.5, 0.5),
    (-1 / 6, 0.5, -0.5, 1 / 6, 0.0, 0.0, 0.0, 0.0),
)
"""Coefficients of the four splines, then of their slopes, by power of the displacement."""

_FOUR = ir.VectorType(DOUBLE, POINTS)


def _emit_spline_values_and_slopes(code: VectorBuilder, displacement: ir.Value) -> ir.Value:
    """Emit the values of the four splines and of their slopes."""
    u = code.broadcast_scalar(displacement)
    result: Any = constant_vector(_POLYNOMIALS[-1])
    for coefficients in reversed(_POLYNOMIALS[:-1]):
        result = code.fused_multiply_add(result, u, constant_vector(coefficients))
    return result


def _emit_pointer_to_line(code: VectorBuilder, values: ir.Value, at: ir.Value) -> ir.Value:
    """Emit a pointer to four consecutive points."""
    return code.builder.bitcast(code.builder.gep(values, [at]), _FOUR.as_pointer())


def _emit_sums_of_half_lanes(code: VectorBuilder, vector: ir.Value) -> ir.Value:
    """Return the sums of the first and of the last four lanes, in lanes 0 and 4."""
    for lanes in ((2, 3, 0, 1, 6, 7, 4, 5), (1, 0, 3, 2, 5, 4, 7, 6)):
        vector = code.builder.fadd(vector, code.shuffle(vector, vector, list(lanes)))
    return vector


@intrinsic
def _emit_addition_of_spline_weights(
    typing: Any, values: Any, at: Any, stride: Any, u: Any, v: Any, amount: Any
) -> Any:
    signature = types.void(values, types.intp, types.intp, types.float64, types.float64, types.float64)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code = VectorBuilder(context, builder)
        pointer = code.array_pointer(signature.args[0], arguments[0])
        at, stride, u, v, amount = arguments[1:]
        across = _emit_spline_values_and_slopes(code, u)
        along = code.shuffle(across, across, list(range(POINTS)))
        ups = builder.fmul(_emit_spline_values_and_slopes(code, v), code.broadcast_scalar(amount))
        for line in range(POINTS):
            fraction = code.shuffle(ups, ups, [line] * POINTS)
            index = _emit_pointer_to_line(code, pointer, at)
            total = builder.fadd(builder.load(index, align=8), builder.fmul(along, fraction))
            builder.store(total, index, align=8)
            at = builder.add(at, stride)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def _emit_spline_interpolation(typing: Any, values: Any, at: Any, stride: Any, u: Any, v: Any) -> Any:
    number = types.float64
    signature = types.UniTuple(number, 3)(values, types.intp, types.intp, number, number)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code = VectorBuilder(context, builder)
        pointer = code.array_pointer(signature.args[0], arguments[0])
        at, stride, u, v = arguments[1:]
        along, up = _emit_spline_values_and_slopes(code, u), _emit_spline_values_and_slopes(code, v)
        total = None
        for line in range(POINTS):
            points = builder.load(_emit_pointer_to_line(code, pointer, at), align=8)
            both = code.shuffle(points, points, [*range(POINTS), *range(POINTS)])
            # The first four lanes hold the spline of the line, the others the slope of this spline.
            fraction = code.shuffle(up, up, [line] * POINTS + [line + POINTS] * POINTS)
            total = (
                builder.fmul(both, fraction)
                if total is None
                else code.fused_multiply_add(both, fraction, total)
            )
            at = builder.add(at, stride)
        half = [*range(POINTS), *range(POINTS)]
        splines = code.shuffle(along, along, half)
        slopes = code.shuffle(along, along, [lane + POINTS for lane in half])
        by_value = _emit_sums_of_half_lanes(code, builder.fmul(total, splines))
        by_slope = _emit_sums_of_half_lanes(code, builder.fmul(total, slopes))
        result = [
            code.extract_lane(by_value, 0),
            code.extract_lane(by_slope, 0),
            code.extract_lane(by_value, POINTS),
        ]
        return context.make_tuple(builder, signature.return_type, result)

    return signature, generate


def _pure_python_spline_values(displacement: float) -> np.ndarray:
    """Return the values of the four splines and of their slopes, float64 (2, 4)."""
    result = np.polynomial.polynomial.polyval(displacement, np.array(_POLYNOMIALS))
    return np.asarray(result).reshape(2, POINTS)


def _pure_python_add_spline_weights(
    values: Array, at: int, stride: int, u: float, v: float, amount: float
) -> None:
    indices = at + stride * np.arange(POINTS)[:, None] + np.arange(POINTS)
    values[indices] += amount * np.outer(_pure_python_spline_values(v)[0], _pure_python_spline_values(u)[0])


def _pure_python_spline_value_and_gradient(
    values: Array, at: int, stride: int, u: float, v: float
) -> tuple[float, float, float]:
    points = values[at + stride * np.arange(POINTS)[:, None] + np.arange(POINTS)]
    across, up = _pure_python_spline_values(u), _pure_python_spline_values(v)
    return up[0] @ points @ across[0], up[0] @ points @ across[1], up[1] @ points @ across[0]


add_spline_weights = (
    _pure_python_add_spline_weights if config.DISABLE_JIT else _emit_addition_of_spline_weights
)
"""Add an amount to the four by four points from index ``at`` on, with lines ``stride`` apart.

Parameters
----------
values : float64 (p,)
at, stride : int
u, v : float
    Position along both axes between the second point (0) and the third (1).
amount : float
"""

interpolate_with_splines = (
    _pure_python_spline_value_and_gradient if config.DISABLE_JIT else _emit_spline_interpolation
)
"""Return the value interpolated from the four by four points, and its slopes along both axes per mesh
spacing.
"""
