"""The sweeps of the direct sum: rows of grains against eight partners at a time.

Numba does not vectorise a loop that also subtracts from the partner (``fx[j] -= ...``), so the
inner loops are emitted here; see `granular.pairs.pair_contributions` for what they sum.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

from granular.compiled import Array, compiled
from granular.pairs.pair_contributions import (
    CutOffVectors,
    EnergyAndClosestPair,
    GrainArrayPointers,
    GrainVectors,
    PeriodicCellVectors,
    add_vectors,
    computed_sums,
    load_eight_grains,
    make_cut_off_vectors,
    pair_contributions,
)
from granular.pairs.row_sums import add_eight_partners, begin_row_sums, store_row_sums
from granular.pairs.simd import INDEX, WIDTH, VectorBuilder, broadcast_constant, has_avx512, pad_to_vectors

__all__ = ["WIDTH", "pad_to_vectors", "reproducible_sum", "sum_pairs_within_block", "sum_rows_with_partners"]


def _rows_at_once(context: Any) -> int:
    """Four where 32 registers hold their sums (5 % faster than two with AVX-512), else two."""
    return 4 if has_avx512(context) else 2


class _PeriodicCutOff(NamedTuple):
    """Cut-off and images of the pairs in a periodic cell; None and None where all pairs count."""

    cut: CutOffVectors | None
    images: PeriodicCellVectors | None


def _make_periodic_cut_off(
    code: VectorBuilder, arrays: GrainArrayPointers, kind: Any, periodic_cut_off: Any
) -> _PeriodicCutOff:
    """Make it from width, height and radius [D]."""
    if isinstance(kind, types.NoneType):
        return _PeriodicCutOff(None, None)
    b, item = code.builder, ir.Constant(ir.DoubleType(), 1.0)
    pointer = code.array_pointer(kind, periodic_cut_off)
    width, height, radius = (code.load_scalar(pointer, ir.Constant(INDEX, k)) for k in range(3))
    square = b.fmul(radius, radius)
    rest = b.fdiv(ir.Constant(square.type, 1.0 / arrays.scale), b.fmul(square, radius))
    sides = (width, height, b.fdiv(item, width), b.fdiv(item, height))
    cut = make_cut_off_vectors(code, square, rest, None, arrays.far)
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
    """Sum the pairs of some grains from ``first`` on with the partners start .. stop - 1."""
    sums = begin_row_sums(code, arrays, first, rows, *ends)
    with cgutils.for_range_slice(code.builder, start, stop, ir.Constant(INDEX, WIDTH), INDEX) as (j, _):
        add_eight_partners(code, sums, j)
    store_row_sums(code, sums, first)


def _emit_pairs_within_block(
    code: VectorBuilder, arrays: GrainArrayPointers, ends: _PeriodicCutOff, first: ir.Value
) -> None:
    """Pairs of eight grains: each lane with the ones 1, 2, 3 and 4 behind it, round the end."""
    grains = load_eight_grains(code, arrays, first)
    pointers = computed_sums(arrays.sums)
    totals = [code.load_vector(pointer, first) for pointer in pointers]
    energy_and_closest = EnergyAndClosestPair(code, arrays.energy_and_closest)
    for by in range(1, WIDTH // 2 + 1):
        partners = GrainVectors(
            *(None if grain is None else code.rotate_lanes(grain, by) for grain in grains)
        )
        # Half way round, each pair would be met from both ends.
        lanes = [lane < WIDTH // 2 for lane in range(WIDTH)] if by == WIDTH // 2 else None
        own, other = pair_contributions(
            code, grains, partners, arrays.sums, energy_and_closest, lanes, *ends, arrays.series
        )
        totals = add_vectors(code, totals, computed_sums(own))
        back = [code.rotate_lanes(value, WIDTH - by) for value in computed_sums(other)]
        totals = add_vectors(code, totals, back)
    for pointer, total in zip(pointers, totals, strict=True):
        code.store_vector(total, pointer, first)
    energy_and_closest.store_results()


@intrinsic
def sum_rows_with_partners(
    typing: Any, arrays: Any, first: Any, start: Any, stop: Any, periodic_cut_off: Any
) -> Any:
    """Sum eight grains with the partners start .. stop - 1 (Numba intrinsic); periodic_cut_off (3,) [D]."""
    signature = types.void(arrays, types.intp, types.intp, types.intp, periodic_cut_off)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = VectorBuilder(context, builder)
        arrays = GrainArrayPointers(code, signature.args[0], values[0])
        first, start, stop, periodic_cut_off = values[1:]
        ends = _make_periodic_cut_off(code, arrays, signature.args[4], periodic_cut_off)
        rows = _rows_at_once(context)
        last = builder.add(first, ir.Constant(INDEX, WIDTH))
        step = ir.Constant(INDEX, rows)
        with cgutils.for_range_slice(builder, first, last, step, INDEX) as (row, _):
            _emit_rows_with_partners(code, arrays, ends, row, rows, start, stop)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def sum_pairs_within_block(typing: Any, arrays: Any, first: Any, periodic_cut_off: Any) -> Any:
    """Sum the pairs of eight successive grains (Numba intrinsic); periodic_cut_off (3,) [D]."""
    signature = types.void(arrays, types.intp, periodic_cut_off)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = VectorBuilder(context, builder)
        arrays = GrainArrayPointers(code, signature.args[0], values[0])
        ends = _make_periodic_cut_off(code, arrays, signature.args[2], values[2])
        _emit_pairs_within_block(code, arrays, ends, values[1])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def emit_sum_of_array(typing: Any, values: Any, stop: Any) -> Any:
    """Sum the first ``stop`` entries of an array (m,), lane by lane, then as a tree (Numba intrinsic)."""
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
    return emit_sum_of_array(values, values.size)


def _numpy_array_sum(values: Array) -> float:
    return float(values.sum())


reproducible_sum = _numpy_array_sum if config.DISABLE_JIT else _compiled_array_sum
"""Sum of a padded array, in an order that depends on nothing but its length."""
