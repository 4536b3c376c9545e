"""Vectorized pair law: contributions of eight pairs to the sums of both grains, and sums for rows of grains.

For dipoles, with s = r^-5, the force on i is (3/4) q_i q_j s (r_i - r_j), and r^-3 = r^2 s gives the energy
and the load for friction in the same pass. To save operations, all sums are computed without the factor
`granular.pairs.simd.SCALE`, and forces also without 3/4.

For discs (`granular.pairs.disc_law`) s = rho^-5, without the factor `DISC_SCALE`. The energy contains
rho^2 (s + c s^2); the load contains two more terms. The force contains (s + g)^2 - g^2; its sums must
be multiplied by a further constant afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from llvmlite import ir

from granular.pairs.grain_arrays import CENTRE, COMMON, FAR, FORCE_SCALE, LOAD_FAR, LOAD_TERM, TERM
from granular.pairs.simd import (
    DISC_SCALE,
    INDEX,
    SCALE,
    WIDTH,
    VectorBuilder,
    broadcast_constant,
    emit_inverse_fifth_power,
    emit_rough_inverse_fifth_power,
    lane_mask,
)

# Only the padding of `granular.pairs.direct_sum`, at 1e70 D, is more distant.
_PADDING_DISTANCE_SQUARED = 1e100
"""Squared distance [D^2] beyond which one grain of a pair is padding."""


class PairSums(NamedTuple):
    """Contributions of pairs to the sums of a grain; sums that are not computed are None."""

    fx: Any
    fy: Any
    stiffness: Any
    load: Any


class SeriesVectors(NamedTuple):
    """Coefficients of the sum over discs, repeated in every lane: b of equal discs, g, -g^2, c, d."""

    common: Any
    centre: Any
    rest: Any
    energy: Any
    load: Any


def _emit_load_of_series(code: VectorBuilder, pointer: Any) -> SeriesVectors | None:
    if pointer is None:
        return None
    b, entries = code.builder, (COMMON, CENTRE, TERM, LOAD_TERM)
    common, centre, term, load = (
        code.broadcast_scalar(code.load_scalar(pointer, ir.Constant(INDEX, k))) for k in entries
    )
    rest = b.fneg(b.fmul(centre, centre))
    energy, load = (b.fmul(broadcast_constant(DISC_SCALE), value) for value in (term, load))
    return SeriesVectors(common, centre, rest, energy, load)


class GrainArrayPointers:
    """Pointers to `GrainArrays`; an absent array is None, and no code is emitted for it."""

    def __init__(self, code: VectorBuilder, kinds: Any, arrays: Any, row: ir.Value | None = None) -> None:
        pointers = [
            code.array_pointer(kind, code.builder.extract_value(arrays, index), row)
            for index, kind in enumerate(kinds)
        ]
        self.x, self.y = pointers[:2]
        self.sums = PairSums(pointers[2], pointers[3], pointers[5], pointers[7])
        self.moments, self.energy_and_closest, self.weight = pointers[4], pointers[6], pointers[8]
        self.series, self.shift = _emit_load_of_series(code, pointers[9]), pointers[10]
        self.scale = SCALE if self.series is None else DISC_SCALE
        self.far, self.load_far = (
            pointers[9] and code.load_scalar(pointers[9], ir.Constant(INDEX, entry))
            for entry in (FAR, LOAD_FAR)
        )
        self.vectorized_force_factor = pointers[9] and code.load_scalar(
            pointers[9], ir.Constant(INDEX, FORCE_SCALE)
        )


class GrainVectors(NamedTuple):
    """A vector of grains: eight different grains, or the same grain in every lane."""

    x: Any
    y: Any
    moments: Any
    weight: Any
    shift: Any


def list_requested_sums(values: PairSums) -> list[Any]:
    """List the sums that are not None, in the order of the fields."""
    return [value for value in values if value is not None]


def emit_load_of_eight_grains(code: VectorBuilder, arrays: GrainArrayPointers, j: ir.Value) -> GrainVectors:
    """Emit the loading of eight successive grains, one in each lane."""
    return _load_grains(arrays, lambda pointer: code.load_vector(pointer, j))


def emit_broadcast_of_grain(code: VectorBuilder, arrays: GrainArrayPointers, i: ir.Value) -> GrainVectors:
    """Emit the loading of one grain into all eight lanes."""
    return _load_grains(arrays, lambda pointer: code.broadcast_scalar(code.load_scalar(pointer, i)))


def _load_grains(arrays: GrainArrayPointers, load: Callable[[ir.Value], ir.Value]) -> GrainVectors:
    pointers = (arrays.x, arrays.y, arrays.moments, arrays.weight, arrays.shift)
    return GrainVectors(*(None if pointer is None else load(pointer) for pointer in pointers))


class FarPartCoefficients(NamedTuple):
    """Coefficients in r^2 of the far parts of r^-5, and of r^-3 in energies and loads, in every lane."""

    fifth: list[Any]
    cube: list[Any]
    load: list[Any]


class CutOffVectors(NamedTuple):
    """Cut-off of pairs, in every lane: squared radius, and scaled r^-3 at the radius."""

    square: Any
    cube: Any
    smooth: FarPartCoefficients | None = None  # far part to be subtracted; None: plain cut-off
    rest: list[Any] | None = None  # of discs: coefficients in b of the energy at the cut-off


def emit_cut_off_vectors(
    code: VectorBuilder,
    square: ir.Value,
    rest: ir.Value,
    smooth: FarPartCoefficients | None,
    far: ir.Value | None,
) -> CutOffVectors:
    """Emit the cut-off of pairs as vectors of eight equal lanes."""
    b = code.builder
    cut = CutOffVectors(code.broadcast_scalar(square), code.broadcast_scalar(rest), smooth)
    if far is None:
        return cut
    # (r^2 - b)^(-3/2) = r^-3 (1 + (3/2) b/r^2 + (15/8) b^2/r^4 + ...), less the far part.
    first = b.fdiv(rest, square)
    second = b.fdiv(first, square)
    begin = rest if smooth is None else b.fneg(b.fmul(far, first))
    factors = [begin, b.fmul(ir.Constant(square.type, 1.5), first)]
    factors.append(b.fmul(ir.Constant(square.type, 1.875), second))
    return cut._replace(rest=[code.broadcast_scalar(factor) for factor in factors])


class PeriodicCellVectors(NamedTuple):
    """Sides of a periodic cell and their inverses, repeated in every lane."""

    width: Any
    height: Any
    per_width: Any
    per_height: Any

    def nearest_image_displacement(
        self, code: VectorBuilder, dx: ir.Value, dy: ir.Value
    ) -> tuple[ir.Value, ir.Value]:
        """Emit the displacement to the nearest image (Allen and Tildesley 1987, section 1.5)."""
        b, result = code.builder, []
        for displacement, side, per in ((dx, self.width, self.per_width), (dy, self.height, self.per_height)):
            turns = code.round_to_integers(b.fmul(displacement, per))
            result.append(b.fsub(displacement, b.fmul(turns, side)))
        # Padding grains have no images.
        padding = b.fcmp_unordered(">", b.fmul(dx, dx), broadcast_constant(_PADDING_DISTANCE_SQUARED))
        return b.select(padding, dx, result[0]), result[1]


class EnergyAndClosestPair:
    """Running energy sum and closest pair of a loop over pairs."""

    def __init__(self, code: VectorBuilder, pointer: ir.Value) -> None:
        self.code, self.pointer = code, pointer
        self.energy = pointer and code.new_variable(broadcast_constant(0.0))
        self.closest = pointer and code.new_variable(broadcast_constant(0.0))

    def include_pairs(self, s: ir.Value, energy: ir.Value) -> None:
        """Emit the addition of eight energies, and the comparison of s = r^-5 with its maximum so far."""
        if self.pointer is not None:
            code, b = self.code, self.code.builder
            code.add_to_variable(self.energy, energy)
            b.store(code.elementwise_maximum(s, b.load(self.closest)), self.closest)

    def add_energy_and_store_closest_pair(self) -> None:
        """Emit the addition of the energy to its array entry, and the storing of r^-5 of the closest pair."""
        if self.pointer is not None:
            code, b = self.code, self.code.builder
            first, second = ir.Constant(INDEX, 0), ir.Constant(INDEX, 1)
            total = b.fadd(code.load_scalar(self.pointer, first), code.sum_lanes(b.load(self.energy)))
            code.store_scalar(total, self.pointer, first)
            closest = code.largest_lane(b.load(self.closest))
            held = code.load_scalar(self.pointer, second)
            closest = b.select(b.fcmp_ordered(">", closest, held), closest, held)
            code.store_scalar(closest, self.pointer, second)


def _emit_polynomial(code: VectorBuilder, coefficients: list[Any], r2: ir.Value) -> ir.Value:
    value = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        value = code.fused_multiply_add(value, r2, coefficient)
    return value


def _emit_pair_energies(
    code: VectorBuilder,
    r2: ir.Value,
    s: ir.Value,
    strength: ir.Value,
    pair: ir.Value | None,
    cut: CutOffVectors | None,
    cube: ir.Value | None,
    shift: ir.Value | None,
) -> ir.Value:
    """Emit the energy of pairs, shifted to be zero at a cut-off."""
    b = code.builder
    if cube is not None:
        if shift is not None and cut is not None and cut.rest is not None:
            inside = b.fcmp_unordered("!=", s, broadcast_constant(0.0))
            rest = _emit_polynomial(code, cut.rest, shift)
            cube = b.select(inside, b.fsub(cube, rest), broadcast_constant(0.0))
        return cube if pair is None else b.fmul(cube, pair)
    energy = b.fmul(r2, strength)
    if cut is None:
        return energy
    rest = cut.cube if pair is None else b.fmul(cut.cube, pair)
    inside = b.fcmp_ordered(">", s, broadcast_constant(0.0))
    return b.select(inside, b.fsub(energy, rest), broadcast_constant(0.0))


def _emit_masked_inverse_fifth_power(
    code: VectorBuilder,
    argument: ir.Value,
    r2: ir.Value,
    lanes: list[bool] | None,
    cut: CutOffVectors | None,
    series: SeriesVectors | None,
) -> ir.Value:
    """Emit ``argument``^(-5/2), set to 0 for excluded pairs."""
    b, zero = code.builder, broadcast_constant(0.0)
    s = (
        emit_inverse_fifth_power(code, argument)
        if series is None
        else emit_rough_inverse_fifth_power(code, argument)
    )
    if lanes is not None:
        s = b.select(lane_mask(lanes), s, zero)
    if cut is not None:
        s = b.select(b.fcmp_ordered("<", r2, cut.square), s, zero)
    return s


def emit_pair_contributions(
    code: VectorBuilder,
    first: GrainVectors,
    second: GrainVectors,
    requested: PairSums,
    energy_and_closest: EnergyAndClosestPair,
    lanes: list[bool] | None = None,
    cut: CutOffVectors | None = None,
    images: PeriodicCellVectors | None = None,
    series: SeriesVectors | None = None,
) -> tuple[PairSums, PairSums]:
    """Emit the contributions of eight pairs to the sums of both grains, in all or in the given lanes (8,)."""
    b = code.builder
    zero = broadcast_constant(0.0)
    dx, dy = b.fsub(first.x, second.x), b.fsub(first.y, second.y)
    if images is not None:
        dx, dy = images.nearest_image_displacement(code, dx, dy)
    r2 = code.fused_multiply_add(dx, dx, b.fmul(dy, dy))
    # For dipoles all of these are equal; for discs s is rho^-5.
    argument, shift = r2, None
    if series is not None:
        shift = series.common if first.shift is None else b.fadd(first.shift, second.shift)
        # Without a cut-off nothing else needs r2.
        within = code.fused_multiply_add(dx, dx, code.fused_multiply_add(dy, dy, b.fneg(shift)))
        argument = within if cut is None else b.fsub(r2, shift)
    s = _emit_masked_inverse_fifth_power(code, argument, r2, lanes, cut, series)
    slope = energy = near = s
    if series is not None:
        root = b.fadd(s, series.centre)
        slope = near = code.fused_multiply_add(root, root, series.rest)
        energy = code.fused_multiply_add(b.fmul(s, series.energy), s, s)
    cube = None
    if cut is not None and cut.smooth is not None:
        # The test includes pairs at zero distance, for which s is NaN.
        inside = b.fcmp_unordered("!=", s, zero)
        fifth = _emit_polynomial(code, cut.smooth.fifth, r2)
        near = b.select(inside, b.fsub(slope, fifth), zero)
    if energy_and_closest.pointer is not None:
        cube = _emit_inverse_cube_in_energy(code, r2, argument, energy, shift, cut)
    pair, strength = None, near
    if first.moments is not None:
        pair = b.fmul(first.moments, second.moments)
        strength = b.fmul(near, pair)
    if energy_and_closest.pointer is not None:
        closest = s if series is None else _emit_masked_inverse_fifth_power(code, r2, r2, lanes, cut, series)
        energy_and_closest.include_pairs(
            closest, _emit_pair_energies(code, r2, s, strength, pair, cut, cube, shift)
        )
    # Separate products and sums make action and reaction equal to the last bit, and are faster on
    # processors with separate adders.
    fx, fy = b.fmul(strength, dx), b.fmul(strength, dy)
    own: list[Any] = [fx, fy, None, None]
    other: list[Any] = [b.fneg(fx), b.fneg(fy), None, None]
    if requested.stiffness is not None:
        differ = first.moments is not None
        own[2] = b.fmul(s, second.moments) if differ else s
        other[2] = b.fmul(s, first.moments) if differ else s
    if requested.load is not None:
        cubes = _emit_inverse_cubes_in_loads(
            code, first, second, r2, s, b.fmul(argument, energy), series, cut
        )
        own[3], other[3] = b.fmul(cubes[0], second.weight), b.fmul(cubes[1], first.weight)
    return PairSums(*own), PairSums(*other)


def _emit_inverse_cube_in_energy(
    code: VectorBuilder,
    r2: ir.Value,
    argument: ir.Value,
    energy: ir.Value,
    shift: ir.Value | None,
    cut: CutOffVectors | None,
) -> ir.Value | None:
    """Emit the value that replaces r^-3 in energies, for discs or if a far part is subtracted."""
    b, zero = code.builder, broadcast_constant(0.0)
    smooth = None if cut is None else cut.smooth
    if shift is None and smooth is None:
        return None
    cube = b.fmul(argument, energy)
    if smooth is not None:
        cube = b.fsub(cube, _emit_polynomial(code, smooth.cube, r2))
    return cube if cut is None else b.select(b.fcmp_unordered("!=", energy, zero), cube, zero)


def _emit_inverse_cubes_in_loads(
    code: VectorBuilder,
    first: GrainVectors,
    second: GrainVectors,
    r2: ir.Value,
    s: ir.Value,
    cube: ir.Value,
    series: SeriesVectors | None,
    cut: CutOffVectors | None,
) -> tuple[ir.Value, ir.Value]:
    """Emit the values that replace r^-3 in the loads on the first and the second grains."""
    b, zero = code.builder, broadcast_constant(0.0)
    if series is not None:
        both = b.fmul(broadcast_constant(3.5), series.common)
        if first.shift is not None:
            both = b.fadd(first.shift, second.shift)
        cube = code.fused_multiply_add(code.fused_multiply_add(series.load, s, both), s, cube)
    if cut is not None and cut.smooth is not None:
        inside = b.fcmp_unordered("!=", s, zero)
        cube = b.select(inside, b.fsub(cube, _emit_polynomial(code, cut.smooth.load, r2)), zero)
    if series is None or first.shift is None:
        return cube, cube
    more = b.fmul(broadcast_constant(5.0), s)
    return (
        code.fused_multiply_add(more, first.shift, cube),
        code.fused_multiply_add(more, second.shift, cube),
    )


def emit_sums_of_vectors(code: VectorBuilder, totals: list[Any], values: list[Any]) -> list[Any]:
    """Emit the addition of each vector of values to the corresponding vector of totals."""
    return [code.builder.fadd(total, more) for total, more in zip(totals, values, strict=True)]


class RowSums(NamedTuple):
    """Rows of grains, their partial sums, and the cut-off of their pairs."""

    arrays: GrainArrayPointers
    grains: list[GrainVectors]
    totals: list[list[Any]]
    energy_and_closest: EnergyAndClosestPair
    cut: CutOffVectors | None
    images: PeriodicCellVectors | None


def emit_start_of_row_sums(
    code: VectorBuilder,
    arrays: GrainArrayPointers,
    first: ir.Value,
    rows: int,
    cut: CutOffVectors | None,
    images: PeriodicCellVectors | None = None,
) -> RowSums:
    """Emit the loading of ``rows`` grains from ``first`` on, with zero sums."""
    indices = [code.builder.add(first, ir.Constant(INDEX, row)) for row in range(rows)]
    grains = [emit_broadcast_of_grain(code, arrays, position) for position in indices]
    pointers = list_requested_sums(arrays.sums)
    totals = [[code.new_variable(broadcast_constant(0.0)) for _ in pointers] for _ in indices]
    energy_and_closest = EnergyAndClosestPair(code, arrays.energy_and_closest)
    return RowSums(arrays, grains, totals, energy_and_closest, cut, images)


def emit_sums_with_eight_partners(
    code: VectorBuilder, sums: RowSums, j: ir.Value, *, own: bool = False
) -> None:
    """Emit sums of rows with partners j .. j + 7; with ``own``, j is the second row, and pairs count once."""
    arrays = sums.arrays
    pointers = list_requested_sums(arrays.sums)
    partners = emit_load_of_eight_grains(code, arrays, j)
    reactions = [code.load_vector(pointer, j) for pointer in pointers]
    for row, (grain, totals) in enumerate(zip(sums.grains, sums.totals, strict=True)):
        lanes = [lane >= row for lane in range(WIDTH)] if own and row else None
        ends = (lanes, sums.cut, sums.images, arrays.series)
        pairs = emit_pair_contributions(code, grain, partners, arrays.sums, sums.energy_and_closest, *ends)
        for total, value in zip(totals, list_requested_sums(pairs[0]), strict=True):
            code.add_to_variable(total, value)
        reactions = emit_sums_of_vectors(code, reactions, list_requested_sums(pairs[1]))
    for pointer, reaction in zip(pointers, reactions, strict=True):
        code.store_vector(reaction, pointer, j)


def emit_addition_of_row_sums(code: VectorBuilder, sums: RowSums, first: ir.Value) -> None:
    """Emit the addition of the sums to the entries of the rows."""
    for index, pointer in enumerate(list_requested_sums(sums.arrays.sums)):
        vectors = [code.builder.load(totals[index]) for totals in sums.totals]
        code.add_vector_to_entries(code.sum_lanes_of_vectors(vectors), pointer, first)
    sums.energy_and_closest.add_energy_and_store_closest_pair()
