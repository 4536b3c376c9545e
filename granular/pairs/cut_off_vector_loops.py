"""The sweep of the cut-off path: two rows of grains against the runs of their partners."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from granular.pairs.dipole_law import CUBE, FIFTH, FIFTH_ENERGY, SEVENTH
from granular.pairs.pair_contributions import (
    CutOffVectors,
    FarPartCoefficients,
    GrainArrayPointers,
    add_vectors,
    make_cut_off_vectors,
)
from granular.pairs.row_sums import RowSums, add_eight_partners, begin_row_sums, store_row_sums
from granular.pairs.simd import INDEX, WIDTH, VectorBuilder

ROWS = 2
"""Rows swept together, neighbours in a stripe."""

RANGES = 3
"""Runs of partners for two rows: the rest of their stripe, and the two stripes above it."""

IMAGES = 3
"""Runs in the place of one in a periodic cell: of the grains themselves, and of their images on the
right and on the left."""


def _shift_rows_by_image(code: VectorBuilder, row_sums: RowSums, shifts: Any, index: ir.Value) -> RowSums:
    """Rows as the images of a run's partners see them."""
    if shifts is None:
        return row_sums
    b = code.builder
    across = code.broadcast_scalar(code.load_scalar(shifts, index))
    up = code.broadcast_scalar(code.load_scalar(shifts, b.add(index, ir.Constant(INDEX, 1))))
    grains = [grain._replace(x=b.fsub(grain.x, across), y=b.fsub(grain.y, up)) for grain in row_sums.grains]
    return row_sums._replace(grains=grains)


def _sum_two_rows(
    code: VectorBuilder, all_rows: RowSums, first: ir.Value, partner_ranges: ir.Value, shifts: Any
) -> None:
    b, row_sums = code.builder, all_rows
    second = b.add(first, ir.Constant(INDEX, 1))
    # The first row's partners begin with the second row; the seven behind that are met here too, unlisted.
    add_eight_partners(code, row_sums, second, own=True)
    number = RANGES if shifts is None else RANGES * IMAGES
    many, item = ir.Constant(INDEX, number), ir.Constant(INDEX, 1)
    begin = b.mul(first, many)  # two places for each run, two rows
    zero = ir.Constant(INDEX, 0)
    with cgutils.for_range_slice(b, zero, many, item, INDEX) as (run, _):
        index = b.add(begin, b.mul(run, ir.Constant(INDEX, 2)))
        start, stop = (
            code.load_scalar(partner_ranges, index),
            code.load_scalar(partner_ranges, b.add(index, item)),
        )
        row_sums = _shift_rows_by_image(code, all_rows, shifts, index)
        with cgutils.for_range_slice(b, start, stop, ir.Constant(INDEX, WIDTH), INDEX) as (j, _):
            add_eight_partners(code, row_sums, j)
    store_row_sums(code, all_rows, first)


def _rescaled_coefficients(
    code: VectorBuilder, numbers: tuple[float, ...], power: ir.Value, square: ir.Value, scale: float
) -> list[Any]:
    """Coefficients in r^2 from those in (r/r_c)^2, in each lane: times ``power`` over ``scale``."""
    b, out = code.builder, []
    for number in numbers:
        out.append(code.broadcast_scalar(b.fmul(ir.Constant(power.type, number / scale), power)))
        power = b.fdiv(power, square)
    return out


def _make_smooth_cut_off(
    code: VectorBuilder, arrays: GrainArrayPointers, radius: ir.Value, *, smooth: bool
) -> CutOffVectors:
    b, far, scale = code.builder, arrays.far, arrays.scale
    square = b.fmul(radius, radius)
    cube = b.fdiv(ir.Constant(radius.type, 1.0), b.fmul(square, radius))
    rest = b.fmul(ir.Constant(radius.type, 1.0 / scale), cube)
    part = None
    if smooth:
        fifth, of_force = b.fdiv(cube, square), scale
        energies = loads = _rescaled_coefficients(code, CUBE, cube, square, scale)
        if far is not None:
            energies, loads = (
                add_vectors(
                    code,
                    energies,
                    _rescaled_coefficients(code, FIFTH_ENERGY, b.fmul(factor, fifth), square, scale),
                )
                for factor in (far, arrays.load_far)
            )
            fifth, of_force = b.fdiv(fifth, arrays.unscaled_force_factor), 1.0
        forces = _rescaled_coefficients(code, FIFTH, fifth, square, of_force)
        if far is not None:
            seventh = b.fdiv(b.fmul(far, fifth), square)
            more = _rescaled_coefficients(code, SEVENTH, seventh, square, of_force)
            forces = add_vectors(code, forces, more)
        part = FarPartCoefficients(forces, energies, loads)
    return make_cut_off_vectors(code, square, rest, part, far)


@intrinsic
def sum_row_ranges(
    typing: Any,
    arrays: Any,
    partner_ranges: Any,
    part: Any,
    first: Any,
    stop: Any,
    radius: Any,
    smooth: Any,
    shifts: Any,
) -> Any:
    """Sum rows with partners in ranges (rows/2, runs, 2) (intrinsic); radius, shifts (same shape) [D]."""
    signature = types.void(
        arrays, partner_ranges, types.intp, types.intp, types.intp, types.float64, smooth, shifts
    )

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = VectorBuilder(context, builder)
        part, first, stop, radius = values[2:6]
        arrays = GrainArrayPointers(code, signature.args[0], values[0], part)
        listed = code.array_pointer(signature.args[1], values[1])
        ends = not isinstance(signature.args[6], types.NoneType)
        cut = _make_smooth_cut_off(code, arrays, radius, smooth=ends)
        away = code.array_pointer(signature.args[7], values[7])
        step = ir.Constant(INDEX, ROWS)
        with cgutils.for_range_slice(builder, first, stop, step, INDEX) as (row, _):
            row_sums = begin_row_sums(code, arrays, row, ROWS, cut)
            _sum_two_rows(code, row_sums, row, listed, away)
        return context.get_dummy_value()

    return signature, generate
