"""Convolution of a mesh with a table that is a sum of products, eight columns at a time.

What a point of the mesh feels of another is, by the distances along both axes, the sum of `TERMS`
products of a number for the one distance and a number for the other. So each column of lines is
met along its lines first, for all terms at once, and then, term by term, across them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

from granular.compiled import Array, compiled
from granular.pairs.lanes import INDEX, WIDTH, Code, constant

TERMS = WIDTH
"""Products that are taken together."""


def _add_along(
    code: Code, source: ir.Value, at: ir.Value, table: ir.Value, reach: ir.Value
) -> list[ir.Value]:
    """Sums over both sides of a point along its line, one for each term."""
    b = code.builder
    sums = [code.variable(constant(0.0)) for _ in range(TERMS)]
    for one in sums:
        b.store(constant(0.0), one)
    zero, step = ir.Constant(INDEX, 0), ir.Constant(INDEX, 1)
    with cgutils.for_range_slice(b, zero, reach, step, INDEX) as (apart, _):
        both = b.fadd(code.load(source, b.sub(at, apart)), code.load(source, b.add(at, apart)))
        first = b.mul(apart, ir.Constant(INDEX, TERMS))
        for term, total in enumerate(sums):
            share = code.splat(code.scalar(table, b.add(first, ir.Constant(INDEX, term))))
            b.store(code.fused(both, share, b.load(total)), total)
    return [b.load(one) for one in sums]


def _add_across(
    code: Code, rows: ir.Value, line: ir.Value, table: ir.Value, reach: ir.Value
) -> ir.Value:
    """Sum over both sides of a point across the lines, and over the terms."""
    b = code.builder
    width = ir.Constant(INDEX, WIDTH)
    sums = [code.variable(constant(0.0)) for _ in range(TERMS)]
    for one in sums:
        b.store(constant(0.0), one)
    zero, step = ir.Constant(INDEX, 0), ir.Constant(INDEX, 1)
    many = ir.Constant(INDEX, TERMS)
    with cgutils.for_range_slice(b, zero, reach, step, INDEX) as (apart, _):
        first = b.mul(apart, many)
        below, above = b.mul(b.sub(line, apart), many), b.mul(b.add(line, apart), many)
        for term, total in enumerate(sums):
            place = ir.Constant(INDEX, term)
            share = code.splat(code.scalar(table, b.add(first, place)))
            both = b.fadd(
                code.load(rows, b.mul(b.add(below, place), width)),
                code.load(rows, b.mul(b.add(above, place), width)),
            )
            b.store(code.fused(both, share, b.load(total)), total)
    values = [b.load(one) for one in sums]
    while len(values) > 1:
        values = [b.fadd(*pair) for pair in zip(values[::2], values[1::2], strict=True)]
    return values[0]


@intrinsic
def _convolve_columns(
    typing: Any, source: Any, out: Any, along: Any, across: Any, rows: Any, at: Any, stride: Any,
    lines: Any, first: Any, scale: Any,
) -> Any:  # fmt: skip
    signature = types.void(
        source, out, along, across, rows, types.intp, types.intp, types.intp, types.boolean,
        types.float64,
    )  # fmt: skip

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code, b = Code(context, builder), builder
        pointers = [
            code.data(kind, array)
            for kind, array in zip(signature.args[:5], values[:5], strict=True)
        ]
        source, out, along, across, rows = pointers
        at, stride, lines, first, scale = values[5:]
        shape = context.make_array(signature.args[2])(context, b, values[2]).shape
        reach = b.extract_value(shape, 0)
        zero, step = ir.Constant(INDEX, 0), ir.Constant(INDEX, 1)
        block = ir.Constant(INDEX, TERMS * WIDTH)
        with cgutils.for_range_slice(b, zero, lines, step, INDEX) as (line, _):
            sums = _add_along(code, source, b.add(at, b.mul(line, stride)), along, reach)
            begin = b.mul(b.add(line, reach), block)
            for term, value in enumerate(sums):
                code.store(value, rows, b.add(begin, ir.Constant(INDEX, term * WIDTH)))
        factor = code.splat(scale)
        with cgutils.for_range_slice(b, zero, lines, step, INDEX) as (line, _):
            value = _add_across(code, rows, b.add(line, reach), across, reach)
            place = b.add(at, b.mul(line, stride))
            before = b.select(first, constant(0.0), code.load(out, place))
            code.store(b.fadd(before, b.fmul(value, factor)), out, place)
        return context.get_dummy_value()

    return signature, generate


@compiled
def _convolve(
    source: Array, out: Array, along: Array, across: Array, rows: Array, at: int, stride: int,
    lines: int, scale: float,
) -> None:  # fmt: skip
    reach, block = along.shape[1], TERMS * WIDTH
    rows[: reach * block] = 0.0
    rows[(reach + lines) * block : (2 * reach + lines) * block] = 0.0
    for group in range(len(along)):
        _convolve_columns(
            source, out, along[group], across[group], rows, at, stride, lines, group == 0, scale
        )


def _plain_convolve(
    source: Array, out: Array, along: Array, across: Array, rows: Array, at: int, stride: int,
    lines: int, scale: float,
) -> None:  # fmt: skip
    reach = along.shape[1]
    places = at + stride * np.arange(lines)[:, None] + np.arange(WIDTH)
    out[places] = 0.0
    for here in range(1 - reach, reach):
        for there in range(1 - reach, reach):
            share = (along[:, abs(here)] * across[:, abs(there)]).sum()
            share *= (2.0 if here == 0 else 1.0) * (2.0 if there == 0 else 1.0)
            chosen = np.arange(max(0, -there), min(lines, lines - there))
            out[places[chosen]] += scale * share * source[places[chosen + there] + here]


convolve = _plain_convolve if config.DISABLE_JIT else _convolve
"""Overwrite eight columns of some lines by what the sources about them make there.

Parameters
----------
source, out : float64 (p,)
    Lines one after another; beside every one there are zeros for the reach of the table.
along, across : float64 (groups, reach, `TERMS`)
    By the distance, from 0 on, where it is halved.
rows : float64 (q,)
    Scratch: for so many lines and twice the reach, `TERMS` times `WIDTH` numbers.
at : int
    Place of the first line's first column.
stride, lines : int
    From line to line, and how many lines.
scale : float
"""
