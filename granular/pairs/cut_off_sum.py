"""Sum over pairs within a cut-off radius, at a cost linear in the number of grains.

The grains are sorted into horizontal stripes (`granular.pairs.stripes`); a sorted grain is called a row. Each
row is combined with its partners eight at a time; pairs beyond the radius are masked. The rows are
distributed over parts of about equal cost. Each part has separate sums, which are added in a fixed order, so
the results have the same bits for one thread and for several.

The reach is the cut-off radius plus a margin, the skin. The partners of a row within the reach are listed as
a few ranges of consecutive rows. No pair is missed until a grain has moved by more than half the skin. Before
each sum the motion of the grains is checked; if a grain has moved that far, the ranges are listed again. The
number of ranges is fixed, so no list can overflow. The skin is adapted so that listing and summing cost about
the same.

In a periodic cell partners have images on the left and on the right, and images of the lowest stripes lie
above the highest stripes. With each range the shift from the grains to their images is stored. The cell has
at least four stripes, and both its sides are longer than twice the reach, so that each pair is counted once.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from granular.compiled import Array, compiled, make_optionally_threaded_kernel
from granular.pairs.dipole_law import CUBE, FIFTH, FIFTH_ENERGY, SEVENTH, STRENGTH
from granular.pairs.grain_arrays import (
    GrainArrays,
    array_if_requested,
    replace_energy_and_closest,
    set_forces_to_nan,
    vectorized_force_factor,
    vectorized_sum_factor,
)
from granular.pairs.near_list import has_any_grain_moved, positions_are_finite, store_positions
from granular.pairs.pair_contributions import (
    CutOffVectors,
    FarPartCoefficients,
    GrainArrayPointers,
    RowSums,
    emit_addition_of_row_sums,
    emit_cut_off_vectors,
    emit_start_of_row_sums,
    emit_sums_of_vectors,
    emit_sums_with_eight_partners,
)
from granular.pairs.pure_python_sums import pure_python_cut_off_sum
from granular.pairs.simd import INDEX, WIDTH, VectorBuilder
from granular.pairs.stripes import (
    BUILDS,
    CALLS,
    GRAINS,
    IMAGES,
    LISTED,
    PADDING,
    RANGES,
    ROWS,
    SKIN,
    STRIPES,
    Stripes,
    sort_into_periodic_stripes,
    sort_into_stripes,
)


def _emit_shift_of_rows_by_image(
    code: VectorBuilder, row_sums: RowSums, shifts: Any, index: ir.Value
) -> RowSums:
    """Subtract the shift of an image from the positions of the rows, so that the partners need no shift."""
    if shifts is None:
        return row_sums
    b = code.builder
    across = code.broadcast_scalar(code.load_scalar(shifts, index))
    up = code.broadcast_scalar(code.load_scalar(shifts, b.add(index, ir.Constant(INDEX, 1))))
    grains = [grain._replace(x=b.fsub(grain.x, across), y=b.fsub(grain.y, up)) for grain in row_sums.grains]
    return row_sums._replace(grains=grains)


def _emit_sum_of_two_rows(
    code: VectorBuilder, all_rows: RowSums, first: ir.Value, partner_ranges: ir.Value, shifts: Any
) -> None:
    b, row_sums = code.builder, all_rows
    second = b.add(first, ir.Constant(INDEX, 1))
    # The first row's partners begin with the second row; the seven entries after it are included, unlisted.
    emit_sums_with_eight_partners(code, row_sums, second, own=True)
    number = RANGES if shifts is None else RANGES * IMAGES
    many, item = ir.Constant(INDEX, number), ir.Constant(INDEX, 1)
    begin = b.mul(first, many)  # start and stop of each run, for each pair of rows
    zero = ir.Constant(INDEX, 0)
    with cgutils.for_range_slice(b, zero, many, item, INDEX) as (run, _):
        index = b.add(begin, b.mul(run, ir.Constant(INDEX, 2)))
        start, stop = (
            code.load_scalar(partner_ranges, index),
            code.load_scalar(partner_ranges, b.add(index, item)),
        )
        row_sums = _emit_shift_of_rows_by_image(code, all_rows, shifts, index)
        with cgutils.for_range_slice(b, start, stop, ir.Constant(INDEX, WIDTH), INDEX) as (j, _):
            emit_sums_with_eight_partners(code, row_sums, j)
    emit_addition_of_row_sums(code, all_rows, first)


def _emit_coefficients_in_r_squared(
    code: VectorBuilder, numbers: tuple[float, ...], power: ir.Value, square: ir.Value, scale: float
) -> list[Any]:
    """Convert coefficients in (r/r_c)^2 to coefficients in r^2, and multiply them by ``power``/``scale``."""
    b, out = code.builder, []
    for number in numbers:
        out.append(code.broadcast_scalar(b.fmul(ir.Constant(power.type, number / scale), power)))
        power = b.fdiv(power, square)
    return out


def _emit_smooth_cut_off(
    code: VectorBuilder, arrays: GrainArrayPointers, radius: ir.Value, *, smooth: bool
) -> CutOffVectors:
    b, far, scale = code.builder, arrays.far, arrays.scale
    square = b.fmul(radius, radius)
    cube = b.fdiv(ir.Constant(radius.type, 1.0), b.fmul(square, radius))
    rest = b.fmul(ir.Constant(radius.type, 1.0 / scale), cube)
    part = None
    if smooth:
        fifth, of_force = b.fdiv(cube, square), scale
        energies = loads = _emit_coefficients_in_r_squared(code, CUBE, cube, square, scale)
        if far is not None:
            energies, loads = (
                emit_sums_of_vectors(
                    code,
                    energies,
                    _emit_coefficients_in_r_squared(code, FIFTH_ENERGY, b.fmul(factor, fifth), square, scale),
                )
                for factor in (far, arrays.load_far)
            )
            fifth, of_force = b.fdiv(fifth, arrays.vectorized_force_factor), 1.0
        forces = _emit_coefficients_in_r_squared(code, FIFTH, fifth, square, of_force)
        if far is not None:
            seventh = b.fdiv(b.fmul(far, fifth), square)
            more = _emit_coefficients_in_r_squared(code, SEVENTH, seventh, square, of_force)
            forces = emit_sums_of_vectors(code, forces, more)
        part = FarPartCoefficients(forces, energies, loads)
    return emit_cut_off_vectors(code, square, rest, part, far)


@intrinsic
def sum_rows_with_partner_ranges(
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
    """Sum the pairs of rows with the partners in the listed ranges, after their shifts (Numba intrinsic)."""
    signature = types.void(
        arrays, partner_ranges, types.intp, types.intp, types.intp, types.float64, smooth, shifts
    )

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = VectorBuilder(context, builder)
        part, first, stop, radius = values[2:6]
        arrays = GrainArrayPointers(code, signature.args[0], values[0], part)
        listed = code.array_pointer(signature.args[1], values[1])
        smooth = not isinstance(signature.args[6], types.NoneType)
        cut = _emit_smooth_cut_off(code, arrays, radius, smooth=smooth)
        away = code.array_pointer(signature.args[7], values[7])
        step = ir.Constant(INDEX, ROWS)
        with cgutils.for_range_slice(builder, first, stop, step, INDEX) as (row, _):
            row_sums = emit_start_of_row_sums(code, arrays, row, ROWS, cut)
            _emit_sum_of_two_rows(code, row_sums, row, listed, away)
        return context.get_dummy_value()

    return signature, generate


_ROW_COST = 3
"""Fixed cost of summing two rows, in units of the cost per eight partners."""

_FIRST_SKIN, _MIN_SKIN, _MAX_SKIN = 0.05, 0.01, 0.5
_LISTING_COST = 2.0
"""Ratio of the cost of listing partners to the cost of one sum."""

_MAX_REACH_FRACTION = 0.4
"""Maximum ratio of the reach to the shorter side of a periodic cell. The cell then has room for five stripes,
each at least half as high as the reach.
"""


_RIGHT, _LEFT = 1, 2
"""Indices of two ranges of a stripe: the images on the right, and the images on the left. Index 0 is the
range of the grains themselves.
"""


@compiled
def _list_partner_ranges(
    shifts: Array | None, periods: Array | None, stripes: Stripes, number: int, reach: float
) -> None:
    """For each pair of rows, list the ranges of partners and, in a periodic cell, their shifts."""
    # So that no pair at the reach is lost to rounding.
    far = reach * (1.0 + 1e-12)
    for k in range(number):
        for up in range(RANGES):
            if shifts is None or periods is None:
                _list_partner_ranges_in_stripe(stripes, k, min(k + up, number), up, up, 0.0, 0.0, far)
            else:
                rows = slice(stripes.begins[k] // ROWS, stripes.begins[k + 1] // ROWS)
                there, rise = (k + up) % number, periods[1] * ((k + up) // number)
                for image in range(IMAGES):
                    across, run = periods[0] * ((image == _RIGHT) - (image == _LEFT)), IMAGES * up + image
                    _list_partner_ranges_in_stripe(stripes, k, there, up, run, across, rise, far)
                    shifts[rows, run, 0], shifts[rows, run, 1] = across, rise


@compiled
def _list_partner_ranges_in_stripe(
    stripes: Stripes, k: int, there: int, up: int, run: int, across: float, rise: float, far: float
) -> None:
    """List the partners that the rows of stripe ``k`` have in stripe ``there`` or in one of its images."""
    x, y, partner_ranges = stripes.x, stripes.y, stripes.partner_ranges
    begin = stripes.begins[there]
    end, lowest = begin, math.inf
    while end < stripes.begins[there + 1] and x[end] < PADDING:
        lowest = min(lowest, y[end] + rise)
        end += 1
    start, stop = begin, begin
    for first in range(stripes.begins[k], stripes.begins[k + 1], ROWS):
        pair = first // ROWS
        partner_ranges[pair, run, 0] = partner_ranges[pair, run, 1] = 0
        # Within its stripe a grain is paired with the entries after it, including images on the right.
        if x[first] < PADDING and not (up == 0 and across < 0.0):
            two = x[first + 1] < PADDING
            left, right = x[first] - across, (x[first + 1] if two else x[first]) - across
            apart = lowest - (max(y[first], y[first + 1]) if two else y[first])
            wide = far if up == 0 else math.sqrt(max(far * far - max(apart, 0.0) ** 2, 0.0))
            while start > begin and x[start - 1] >= left - wide:
                start -= 1
            while start < end and x[start] < left - wide:
                start += 1
            while stop > begin and x[stop - 1] > right + wide:
                stop -= 1
            while stop < end and x[stop] <= right + wide:
                stop += 1
            if apart < far or up == 0:
                # The seven entries after the second row are included with it.
                partner_ranges[pair, run, 0] = first + 1 + WIDTH if up == 0 and across == 0.0 else start
                partner_ranges[pair, run, 1] = stop


@compiled(inline=True)
def _row_cost_and_partner_bounds(stripes: Stripes, first: int) -> tuple[int, int, int]:
    """Return the cost of eight rows, in units of the cost of eight partners, and their index range."""
    cost, low, last = 0, first, first + 2 * WIDTH
    for pair in range(first // ROWS, (first + WIDTH) // ROWS):
        cost += _ROW_COST
        for run in range(stripes.partner_ranges.shape[1]):
            start, stop = stripes.partner_ranges[pair, run, 0], stripes.partner_ranges[pair, run, 1]
            if stop > start:
                vectors = (stop - start + WIDTH - 1) // WIDTH
                cost += vectors
                low, last = min(low, start), max(last, start + vectors * WIDTH)
    return cost, low // WIDTH * WIDTH, (last + WIDTH - 1) // WIDTH * WIDTH


@compiled
def _divide_rows_into_parts(stripes: Stripes, grains: int, end: int) -> None:
    """Divide the rows into parts of about equal cost; each part begins at a multiple of the vector width."""
    parts, total, done, part = stripes.ends.size, 0, 0, 0
    for first in range(0, end, WIDTH):
        total += _row_cost_and_partner_bounds(stripes, first)[0]
    stripes.rows[:] = end
    stripes.rows[0] = 0
    stripes.lows[:] = end
    stripes.ends[:] = 0
    for first in range(0, end, WIDTH):
        cost, low, last = _row_cost_and_partner_bounds(stripes, first)
        while part + 1 < parts and (2 * done + cost) * parts >= 2 * (part + 1) * total:
            part += 1
            stripes.rows[part] = first
        done += cost
        stripes.lows[part] = min(stripes.lows[part], low)
        stripes.ends[part] = max(stripes.ends[part], last)
    part = 0
    stripes.firsts[:] = grains
    for k in range(grains):
        while part <= parts and stripes.rows[part] <= stripes.slot[k]:
            stripes.firsts[part] = k
            part += 1


@compiled
def _sort_values_into_stripes(
    values: Array | None, sorted_values: Array | None, stripes: Stripes, grains: int
) -> None:
    if values is not None and sorted_values is not None:
        sorted_values[:] = 0.0
        for k in range(grains):
            sorted_values[stripes.slot[k]] = values[stripes.order[k]]


@compiled(inline=True)
def _list_partners(
    shifts: Array | None, stripes: Stripes, grains: int, arrays: GrainArrays, radius: float
) -> None:
    reach = radius + stripes.memory[SKIN]
    if shifts is None:
        number = sort_into_stripes(stripes, grains, reach)
    else:
        number = sort_into_periodic_stripes(stripes, grains, reach)
    _list_partner_ranges(shifts, stripes.periods, stripes, number, reach)
    _sort_values_into_stripes(arrays.moments, stripes.moments, stripes, grains)
    _sort_values_into_stripes(arrays.weight, stripes.weight, stripes, grains)
    _sort_values_into_stripes(arrays.shift, stripes.shift, stripes, grains)
    _divide_rows_into_parts(stripes, grains, stripes.begins[number])
    stripes.memory[LISTED] = 1.0
    stripes.memory[STRIPES] = number


@compiled
def _adapt_skin(memory: Array, radius: float) -> None:
    """Adapt the skin so that listing costs as much as summing over the pairs that lie within the skin."""
    if memory[SKIN] == 0.0:
        memory[SKIN] = _FIRST_SKIN * radius
    # Per sum, listing costs `_LISTING_COST`/CALLS and the pairs beyond the radius cost 2 skin/radius.
    # CALLS is proportional to the skin, so the total is minimal when both are equal.
    elif memory[CALLS] * memory[SKIN] < _LISTING_COST * radius / 2.0:
        memory[SKIN] = min(1.25 * memory[SKIN], _MAX_SKIN * radius)
    else:
        memory[SKIN] = max(memory[SKIN] / 1.1, _MIN_SKIN * radius)


@compiled(inline=True)
def _limit_skin(periods: Array | None, memory: Array, radius: float) -> None:
    if periods is not None:
        memory[SKIN] = min(memory[SKIN], _MAX_REACH_FRACTION * min(periods[0], periods[1]) - radius)


@compiled
def refresh_partner_lists(stripes: Stripes, arrays: GrainArrays, grains: int, radius: float) -> bool:
    """List partners again if a grain has moved by half the skin; return False if a position is not finite."""
    x, y = arrays.x, arrays.y
    squared_limit = 0.25 * stripes.memory[SKIN] * stripes.memory[SKIN] * (1.0 - 1e-9)
    if stripes.memory[GRAINS] != grains or has_any_grain_moved(stripes.built, x, y, grains, squared_limit):
        if not positions_are_finite(x, y, grains):
            return False
        _adapt_skin(stripes.memory, radius)
        _limit_skin(stripes.periods, stripes.memory, radius)
        store_positions(stripes.built, x, y, grains)
        stripes.memory[GRAINS] = grains
        stripes.memory[CALLS] = 0.0
        stripes.memory[BUILDS] += 1.0
        stripes.memory[LISTED] = 0.0
    if stripes.memory[LISTED] == 0.0:
        _list_partners(stripes.shifts, stripes, grains, arrays, radius)
    stripes.memory[CALLS] += 1.0
    return True


@compiled
def _load_positions_and_clear_sums_of_part(stripes: Stripes, requested: GrainArrays, part: int) -> None:
    """Load the present positions of the grains of a part, and clear the sums of that part."""
    for k in range(stripes.firsts[part], stripes.firsts[part + 1]):
        stripes.x[stripes.slot[k]] = requested.x[stripes.order[k]]
        stripes.y[stripes.slot[k]] = requested.y[stripes.order[k]]
    _wrap_into_cell(stripes.cell_offsets, stripes, part)
    _clear_sums_if_requested(requested.fx, stripes.fx, stripes, part)
    _clear_sums_if_requested(requested.fy, stripes.fy, stripes, part)
    _clear_sums_if_requested(requested.stiffness, stripes.stiffness, stripes, part)
    _clear_sums_if_requested(requested.load, stripes.load, stripes, part)


@compiled(inline=True)
def _wrap_into_cell(cell_offsets: Array | None, stripes: Stripes, part: int) -> None:
    """In a periodic cell, move the grains of a part by whole periods into the cell."""
    if cell_offsets is not None:
        for k in range(stripes.firsts[part], stripes.firsts[part + 1]):
            stripes.x[stripes.slot[k]] -= cell_offsets[0, stripes.order[k]]
            stripes.y[stripes.slot[k]] -= cell_offsets[1, stripes.order[k]]


@compiled(inline=True)
def _clear_sums_if_requested(
    requested: Array | None, sums: Array | None, stripes: Stripes, part: int
) -> None:
    if requested is not None and sums is not None:
        sums[part, stripes.lows[part] : stripes.ends[part]] = 0.0


@compiled
def _sum_pairs_of_part(
    stripes: Stripes, requested: GrainArrays, part: int, radius: float, smooth: bool | None
) -> None:
    """Sum the pairs of each row of this part with its listed partners."""
    sums = GrainArrays(
        stripes.x,
        stripes.y,
        stripes.fx,
        stripes.fy,
        stripes.moments,
        array_if_requested(requested.stiffness, stripes.stiffness),
        requested.energy_and_closest,
        array_if_requested(requested.load, stripes.load),
        stripes.weight,
        requested.series,
        stripes.shift,
    )
    first, stop = stripes.rows[part], stripes.rows[part + 1]
    sum_rows_with_partner_ranges(
        sums, stripes.partner_ranges, part, first, stop, radius, smooth, stripes.shifts
    )


@compiled(inline=True)
def _add_sums_of_other_parts(sums: Array, stripes: Stripes, part: int) -> None:
    """Add the sums that other parts computed for the rows of this part."""
    for other in range(stripes.ends.size):
        first = max(stripes.lows[other], stripes.rows[part])
        end = min(stripes.ends[other], stripes.rows[part + 1])
        if other != part:
            total, more = sums[part, first:end], sums[other, first:end]
            for k in range(total.size):
                total[k] += more[k]


@compiled
def _copy_sums_if_requested(
    out: Array | None, sums: Array | None, scale: float, stripes: Stripes, part: int
) -> None:
    """If ``out`` is given, add the sums of other parts to ``part``, and write the scaled sums to ``out``."""
    if out is not None and sums is not None:
        _add_sums_of_other_parts(sums, stripes, part)
        for k in range(stripes.firsts[part], stripes.firsts[part + 1]):
            out[stripes.order[k]] = scale * sums[part, stripes.slot[k]]


@compiled
def _copy_all_sums_of_part(stripes: Stripes, requested: GrainArrays, part: int) -> None:
    scale, strength = (
        vectorized_sum_factor(requested.series),
        STRENGTH * vectorized_force_factor(requested.series),
    )
    _copy_sums_if_requested(requested.fx, stripes.fx, strength, stripes, part)
    _copy_sums_if_requested(requested.fy, stripes.fy, strength, stripes, part)
    _copy_sums_if_requested(requested.stiffness, stripes.stiffness, scale, stripes, part)
    _copy_sums_if_requested(requested.load, stripes.load, scale, stripes, part)


# Separate kernels: Numba fuses two parallel loops if it sees no dependence, and it does not look into
# the kernels that they call.


@make_optionally_threaded_kernel
def _load_positions_and_clear_sums(stripes: Stripes, requested: GrainArrays) -> None:
    for part in numba.prange(stripes.ends.size):
        _load_positions_and_clear_sums_of_part(stripes, requested, part)


@make_optionally_threaded_kernel
def _sum_pairs(stripes: Stripes, requested: GrainArrays, radius: float, smooth: bool | None) -> None:
    for part in numba.prange(stripes.ends.size):
        _sum_pairs_of_part(stripes, requested, part, radius, smooth)


@make_optionally_threaded_kernel
def _copy_sums(stripes: Stripes, requested: GrainArrays) -> None:
    for part in numba.prange(stripes.ends.size):
        _copy_all_sums_of_part(stripes, requested, part)


@compiled
def _sum_all_parts(
    threaded: bool | None, stripes: Stripes, requested: GrainArrays, radius: float, smooth: bool | None
) -> None:
    _load_positions_and_clear_sums(threaded, stripes, requested)
    _sum_pairs(threaded, stripes, requested, radius, smooth)
    _copy_sums(threaded, stripes, requested)


@compiled(inline=True)
def _sum_with_energy_and_closest(
    energy_and_closest: Array | None,
    threaded: bool | None,
    stripes: Stripes,
    arrays: GrainArrays,
    radius: float,
    smooth: bool | None,
) -> None:
    """Sum the pairs; if requested, each part stores its energy and closest pair in a separate row."""
    if energy_and_closest is None:
        _sum_all_parts(threaded, stripes, arrays, radius, smooth)
    else:
        parts = np.zeros((stripes.ends.size, 2))
        measured = replace_energy_and_closest(arrays, parts)
        _sum_all_parts(threaded, stripes, measured, radius, smooth)
        energy_and_closest[:] = 0.0
        scale = vectorized_sum_factor(arrays.series)
        for part in range(len(parts)):
            energy_and_closest[0] += scale * parts[part, 0]
            energy_and_closest[1] = max(energy_and_closest[1], scale * parts[part, 1])


@compiled
def _compiled_cut_off_sum(
    stripes: Stripes,
    radius: float,
    smooth: bool | None,
    threaded: bool | None,
    grains: int,
    arrays: GrainArrays,
) -> None:
    if refresh_partner_lists(stripes, arrays, grains, radius):
        _sum_with_energy_and_closest(arrays.energy_and_closest, threaded, stripes, arrays, radius, smooth)
    else:
        set_forces_to_nan(arrays, grains)


cut_off_sum = pure_python_cut_off_sum if numba.config.DISABLE_JIT else _compiled_cut_off_sum
"""Pair forces within a radius, with the other requested sums in the same pass.

Parameters
----------
stripes : Stripes
radius : float
    Cut-off radius [D]. The energy of a pair is taken as zero there.
smooth : bool or None
    None for a plain cut-off. Otherwise the far part of the law, which the far field contains, is subtracted
    from each pair.
threaded : bool or None
    None for one thread; any other value for Numba's threads.
grains : int
arrays : GrainArrays
"""
