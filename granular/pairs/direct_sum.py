"""The direct sum over all pairs: exact, each of the N(N-1)/2 pairs computed once.

Arrays are padded to the vector width with fictitious grains so far away that they contribute nothing
(`PADDING`). From `MIN_GRAINS_FOR_PARTS` grains on, the rows are distributed over a fixed number of parts
with separate sums, which are added in a fixed order. The results therefore have the same bits for one thread
and for several.

The inner loops combine rows of grains with eight partners at a time. Numba does not vectorise a loop
that also subtracts from the partner (``fx[j] -= ...``), so these loops are emitted as LLVM code; their
summands are in `granular.pairs.pair_contributions`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

from granular.compiled import Array, compiled, make_optionally_threaded_kernel
from granular.pairs.dipole_law import STRENGTH
from granular.pairs.grain_arrays import (
    GrainArrays,
    array_if_requested,
    clear_array_if_given,
    clear_sums,
    replace_sums,
    scale_array_if_given,
    vectorized_force_factor,
    vectorized_sum_factor,
)
from granular.pairs.pair_contributions import (
    CutOffVectors,
    EnergyAndClosestPair,
    GrainArrayPointers,
    GrainVectors,
    PeriodicCellVectors,
    emit_addition_of_row_sums,
    emit_cut_off_vectors,
    emit_load_of_eight_grains,
    emit_pair_contributions,
    emit_start_of_row_sums,
    emit_sums_of_vectors,
    emit_sums_with_eight_partners,
    list_requested_sums,
)
from granular.pairs.pure_python_sums import pure_python_direct_sum
from granular.pairs.simd import INDEX, WIDTH, VectorBuilder, broadcast_constant, has_avx512, pad_to_vectors
from granular.shared.array_types import Float

__all__ = ["WIDTH", "pad_to_vectors", "reproducible_sum", "sum_pairs_within_block", "sum_rows_with_partners"]


def _rows_summed_per_pass(context: Any) -> int:
    """Return 4 with AVX-512, whose 32 registers hold the sums of 4 rows (5 % faster), otherwise 2."""
    return 4 if has_avx512(context) else 2


class _PeriodicCutOff(NamedTuple):
    """Cut-off and images of pairs in a periodic cell; in a closed cell both fields are None."""

    cut: CutOffVectors | None
    images: PeriodicCellVectors | None


def _emit_periodic_cut_off(
    code: VectorBuilder, arrays: GrainArrayPointers, kind: Any, periodic_cut_off: Any
) -> _PeriodicCutOff:
    """Make cut-off and images from ``periodic_cut_off``: width and height of the cell, and radius."""
    if isinstance(kind, types.NoneType):
        return _PeriodicCutOff(None, None)
    b, item = code.builder, ir.Constant(ir.DoubleType(), 1.0)
    pointer = code.array_pointer(kind, periodic_cut_off)
    width, height, radius = (code.load_scalar(pointer, ir.Constant(INDEX, k)) for k in range(3))
    square = b.fmul(radius, radius)
    rest = b.fdiv(ir.Constant(square.type, 1.0 / arrays.scale), b.fmul(square, radius))
    sides = (width, height, b.fdiv(item, width), b.fdiv(item, height))
    cut = emit_cut_off_vectors(code, square, rest, None, arrays.far)
    return _PeriodicCutOff(cut, PeriodicCellVectors(*(code.broadcast_scalar(side) for side in sides)))


def _emit_rows_with_partners(
    code: VectorBuilder,
    arrays: GrainArrayPointers,
    ends: _PeriodicCutOff,
    first: ir.Value,
    rows: int,
    start: ir.Value,
    stop: ir.Value,
) -> None:
    """Sum the pairs of ``rows`` grains, starting with ``first``, with the partners start .. stop - 1."""
    sums = emit_start_of_row_sums(code, arrays, first, rows, *ends)
    with cgutils.for_range_slice(code.builder, start, stop, ir.Constant(INDEX, WIDTH), INDEX) as (j, _):
        emit_sums_with_eight_partners(code, sums, j)
    emit_addition_of_row_sums(code, sums, first)


def _emit_pairs_within_block(
    code: VectorBuilder, arrays: GrainArrayPointers, ends: _PeriodicCutOff, first: ir.Value
) -> None:
    """Sum the pairs within eight grains: each lane with the next 1, 2, 3 and 4 lanes, cyclically."""
    grains = emit_load_of_eight_grains(code, arrays, first)
    pointers = list_requested_sums(arrays.sums)
    totals = [code.load_vector(pointer, first) for pointer in pointers]
    energy_and_closest = EnergyAndClosestPair(code, arrays.energy_and_closest)
    for by in range(1, WIDTH // 2 + 1):
        partners = GrainVectors(
            *(None if grain is None else code.rotate_lanes(grain, by) for grain in grains)
        )
        # With a rotation by half the width, each pair would be counted twice.
        lanes = [lane < WIDTH // 2 for lane in range(WIDTH)] if by == WIDTH // 2 else None
        own, other = emit_pair_contributions(
            code, grains, partners, arrays.sums, energy_and_closest, lanes, *ends, arrays.series
        )
        totals = emit_sums_of_vectors(code, totals, list_requested_sums(own))
        back = [code.rotate_lanes(value, WIDTH - by) for value in list_requested_sums(other)]
        totals = emit_sums_of_vectors(code, totals, back)
    for pointer, total in zip(pointers, totals, strict=True):
        code.store_vector(total, pointer, first)
    energy_and_closest.add_energy_and_store_closest_pair()


@intrinsic
def sum_rows_with_partners(
    typing: Any, arrays: Any, first: Any, start: Any, stop: Any, periodic_cut_off: Any
) -> Any:
    """Sum the pairs of eight grains with the partners start .. stop - 1 (Numba intrinsic)."""
    signature = types.void(arrays, types.intp, types.intp, types.intp, periodic_cut_off)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = VectorBuilder(context, builder)
        arrays = GrainArrayPointers(code, signature.args[0], values[0])
        first, start, stop, periodic_cut_off = values[1:]
        ends = _emit_periodic_cut_off(code, arrays, signature.args[4], periodic_cut_off)
        rows = _rows_summed_per_pass(context)
        last = builder.add(first, ir.Constant(INDEX, WIDTH))
        step = ir.Constant(INDEX, rows)
        with cgutils.for_range_slice(builder, first, last, step, INDEX) as (row, _):
            _emit_rows_with_partners(code, arrays, ends, row, rows, start, stop)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def sum_pairs_within_block(typing: Any, arrays: Any, first: Any, periodic_cut_off: Any) -> Any:
    """Sum the pairs within a block of eight successive grains (Numba intrinsic)."""
    signature = types.void(arrays, types.intp, periodic_cut_off)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = VectorBuilder(context, builder)
        arrays = GrainArrayPointers(code, signature.args[0], values[0])
        ends = _emit_periodic_cut_off(code, arrays, signature.args[2], values[2])
        _emit_pairs_within_block(code, arrays, ends, values[1])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def sum_leading_entries(typing: Any, values: Any, stop: Any) -> Any:
    """Sum the first ``stop`` entries of an array (m,), lane by lane, then pairwise (Numba intrinsic)."""
    signature = types.float64(values, types.intp)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code = VectorBuilder(context, builder)
        pointer = code.array_pointer(signature.args[0], arguments[0])
        total = code.new_variable(broadcast_constant(0.0))
        start, width = ir.Constant(INDEX, 0), ir.Constant(INDEX, WIDTH)
        with cgutils.for_range_slice(builder, start, arguments[1], width, INDEX) as (j, _):
            code.add_to_variable(total, code.load_vector(pointer, j))
        return code.sum_lanes(builder.load(total))

    return signature, generate


@compiled
def _compiled_array_sum(values: Array) -> float:
    return sum_leading_entries(values, values.size)


def _numpy_array_sum(values: Array) -> float:
    return float(values.sum())


reproducible_sum = _numpy_array_sum if config.DISABLE_JIT else _compiled_array_sum
"""Sum of a padded array, in an order that depends only on the array's length."""


PADDING = 1e70
"""Position of the first padding grain [D]. At this distance r^5 overflows, so the force on a grain is
exactly 0.
"""

# Above this number a sum takes 0.2 ms, several times the start of threads (50 us).
MIN_GRAINS_FOR_PARTS = 1024
# Fixed, so that the order of the sums does not depend on the number of threads.
PARTS = 8


def pad_coordinates(positions: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Split positions into padded arrays of x and y."""
    count, size = len(positions), pad_to_vectors(len(positions))
    x, y = PADDING * np.arange(1.0, size + 1.0), np.zeros(size)
    x[:count], y[:count] = positions[:, 0], positions[:, 1]
    return x, y


def pad_values(values: np.ndarray) -> Float[np.ndarray, "m"]:
    """Append zeros to an array of one value per grain, up to a whole number of vectors."""
    out = np.zeros(pad_to_vectors(len(values)))
    out[: len(values)] = values
    return out


def allocate_partial_sums(size: int) -> Float[np.ndarray, "PARTS 5 m"] | None:
    """Allocate the partial sums of a direct sum; None below `MIN_GRAINS_FOR_PARTS`."""
    return np.zeros((PARTS, 5, size)) if size >= MIN_GRAINS_FOR_PARTS else None


@compiled
def _sum_pairs_of_part(arrays: GrainArrays, periodic_cut_off: Array | None, part: int, parts: int) -> None:
    size = arrays.x.size
    for first in range(part * WIDTH, size, parts * WIDTH):
        sum_pairs_within_block(arrays, first, periodic_cut_off)
        sum_rows_with_partners(arrays, first, first + WIDTH, size, periodic_cut_off)


@compiled
def _sum_part_into_buffer(
    arrays: GrainArrays, periodic_cut_off: Array | None, buffer: Array, part: int
) -> None:
    buffer[:4] = 0.0
    buffer[4, :2] = 0.0
    sums = replace_sums(
        arrays,
        buffer[0],
        buffer[1],
        array_if_requested(arrays.stiffness, buffer[2]),
        array_if_requested(arrays.energy_and_closest, buffer[4]),
        array_if_requested(arrays.load, buffer[3]),
    )
    _sum_pairs_of_part(sums, periodic_cut_off, part, PARTS)


@make_optionally_threaded_kernel
def _sum_parts_into_buffers(arrays: GrainArrays, periodic_cut_off: Array | None, buffers: Array) -> None:
    for part in numba.prange(PARTS):
        _sum_part_into_buffer(arrays, periodic_cut_off, buffers[part], part)


@compiled
def _add_buffers(buffers: Array, row: int, out: Array | None) -> None:
    if out is not None:
        for i in range(out.size):
            total = buffers[0, row, i]
            for part in range(1, PARTS):
                total += buffers[part, row, i]
            out[i] = total


@compiled
def _combine_energy_and_closest(buffers: Array, energy_and_closest: Array | None) -> None:
    if energy_and_closest is not None:
        for part in range(PARTS):
            energy_and_closest[0] += buffers[part, 4, 0]
            energy_and_closest[1] = max(energy_and_closest[1], buffers[part, 4, 1])


@compiled
def _sum_pairs_directly(
    arrays: GrainArrays, buffers: Array | None, threaded: bool | None, periodic_cut_off: Array | None
) -> None:
    if buffers is None:
        clear_sums(arrays)
        _sum_pairs_of_part(arrays, periodic_cut_off, 0, 1)
    else:
        _sum_parts_into_buffers(threaded, arrays, periodic_cut_off, buffers)
        _add_buffers(buffers, 0, arrays.fx)
        _add_buffers(buffers, 1, arrays.fy)
        _add_buffers(buffers, 2, arrays.stiffness)
        _add_buffers(buffers, 3, arrays.load)
        clear_array_if_given(arrays.energy_and_closest)
        _combine_energy_and_closest(buffers, arrays.energy_and_closest)
    scale, strength = (
        vectorized_sum_factor(arrays.series),
        STRENGTH * vectorized_force_factor(arrays.series),
    )
    scale_array_if_given(arrays.fx, strength)
    scale_array_if_given(arrays.fy, strength)
    scale_array_if_given(arrays.stiffness, scale)
    scale_array_if_given(arrays.load, scale)
    scale_array_if_given(arrays.energy_and_closest, scale)


direct_sum = pure_python_direct_sum if numba.config.DISABLE_JIT else _sum_pairs_directly
"""Pair forces of all grains, with the other requested sums in the same pass.

Parameters
----------
arrays : GrainArrays
buffers : float64 (PARTS, 5, m) or None
    From `allocate_partial_sums`.
threaded : bool or None
    None for one thread; any other value for Numba's threads.
periodic_cut_off : float64 (3,) or None
    Width and height of a periodic cell, and cut-off radius, at most half the shorter side [D]; None for a
    closed cell. In a periodic cell each grain interacts with the nearest image of each other grain. The
    energy of a pair is zero at the cut-off.
"""
