"""Rows of grains against eight partners at a time: the body of the sweeps over pairs."""

from __future__ import annotations

from typing import Any, NamedTuple

from llvmlite import ir

from granular.pairs.pair_contributions import (
    CutOffVectors,
    EnergyAndClosestPair,
    GrainArrayPointers,
    GrainVectors,
    PeriodicCellVectors,
    add_vectors,
    broadcast_grain,
    computed_sums,
    load_eight_grains,
    pair_contributions,
)
from granular.pairs.simd import INDEX, WIDTH, VectorBuilder, broadcast_constant


class RowSums(NamedTuple):
    """Some rows, their sums so far, and where their pairs end."""

    arrays: GrainArrayPointers
    grains: list[GrainVectors]
    totals: list[list[Any]]
    energy_and_closest: EnergyAndClosestPair
    cut: CutOffVectors | None
    images: PeriodicCellVectors | None


def begin_row_sums(
    code: VectorBuilder,
    arrays: GrainArrayPointers,
    first: ir.Value,
    rows: int,
    cut: CutOffVectors | None,
    images: PeriodicCellVectors | None = None,
) -> RowSums:
    """Emit the loading of some grains from ``first`` on, with sums of zero."""
    indices = [code.builder.add(first, ir.Constant(INDEX, row)) for row in range(rows)]
    grains = [broadcast_grain(code, arrays, position) for position in indices]
    pointers = computed_sums(arrays.sums)
    totals = [[code.new_variable(broadcast_constant(0.0)) for _ in pointers] for _ in indices]
    energy_and_closest = EnergyAndClosestPair(code, arrays.energy_and_closest)
    return RowSums(arrays, grains, totals, energy_and_closest, cut, images)


def add_eight_partners(code: VectorBuilder, sums: RowSums, j: ir.Value, *, own: bool = False) -> None:
    """Emit rows against the partners from j on; with ``own`` j is the second row, a partner of the first."""
    arrays = sums.arrays
    pointers = computed_sums(arrays.sums)
    partners = load_eight_grains(code, arrays, j)
    reactions = [code.load_vector(pointer, j) for pointer in pointers]
    for row, (grain, totals) in enumerate(zip(sums.grains, sums.totals, strict=True)):
        lanes = [lane >= row for lane in range(WIDTH)] if own and row else None
        ends = (lanes, sums.cut, sums.images, arrays.series)
        pairs = pair_contributions(code, grain, partners, arrays.sums, sums.energy_and_closest, *ends)
        for total, value in zip(totals, computed_sums(pairs[0]), strict=True):
            code.add_to_variable(total, value)
        reactions = add_vectors(code, reactions, computed_sums(pairs[1]))
    for pointer, reaction in zip(pointers, reactions, strict=True):
        code.store_vector(reaction, pointer, j)


def store_row_sums(code: VectorBuilder, sums: RowSums, first: ir.Value) -> None:
    """Emit the addition of the sums to the entries of the rows."""
    for which, pointer in enumerate(computed_sums(sums.arrays.sums)):
        vectors = [code.builder.load(totals[which]) for totals in sums.totals]
        code.add_vector_to_entries(code.sum_lanes_of_vectors(vectors), pointer, first)
    sums.energy_and_closest.store_results()
