"""The sweeps of the direct sum: rows of grains against eight partners at a time.

Numba does not vectorise a loop that also subtracts from the partner (``fx[j] -= ...``), so the
inner loops are emitted here. The law is the dipole pair: with s = r^-5 the force on i is
(3/4) q_i q_j s (r_i - r_j), and r^-3 = r^2 s gives the energy and the friction load in the same
pass. All sums lack the factor `granular.pairs.inverse.SCALE`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

from granular.compiled import Array, compiled
from granular.pairs.inverse import inverse_fifth
from granular.pairs.lanes import (
    INDEX,
    WIDTH,
    Code,
    constant,
    flags,
    has_avx512,
    padded,
)

__all__ = ["WIDTH", "lane_sum", "padded", "sweep_block", "sweep_rows"]


class _Sums(NamedTuple):
    """What pairs add to a grain; None where it is not asked for."""

    fx: Any
    fy: Any
    stiffness: Any
    load: Any


class _Arrays:
    """Pointers of one call. An absent array is None, and no code is made for it."""

    def __init__(self, code: Code, kinds: Any, arrays: Any) -> None:
        pointers = [code.data(kind, array) for kind, array in zip(kinds, arrays, strict=True)]
        self.x, self.y = pointers[:2]
        self.sums = _Sums(pointers[2], pointers[3], pointers[5], pointers[7])
        self.charge, self.extremes, self.weight = pointers[4], pointers[6], pointers[8]


class _Grains(NamedTuple):
    """A vector of grains: eight of them, or one in every lane."""

    x: Any
    y: Any
    charge: Any
    weight: Any


def _present(values: _Sums) -> list[Any]:
    return [value for value in values if value is not None]


def _eight(code: Code, arrays: _Arrays, j: ir.Value) -> _Grains:
    pointers = (arrays.x, arrays.y, arrays.charge, arrays.weight)
    return _Grains(*(None if one is None else code.load(one, j) for one in pointers))


def _one(code: Code, arrays: _Arrays, i: ir.Value) -> _Grains:
    pointers = (arrays.x, arrays.y, arrays.charge, arrays.weight)
    return _Grains(*(None if one is None else code.splat(code.scalar(one, i)) for one in pointers))


class _Extremes:
    """The energy and the closest pair of a sweep."""

    def __init__(self, code: Code, pointer: ir.Value) -> None:
        self.code, self.pointer = code, pointer
        self.energy = pointer and code.variable(constant(0.0))
        self.closest = pointer and code.variable(constant(0.0))

    def meet(self, r2: ir.Value, s: ir.Value, strength: ir.Value) -> None:
        if self.pointer is not None:
            code, b = self.code, self.code.builder
            code.raise_by(self.energy, b.fmul(r2, strength))
            b.store(code.greater(s, b.load(self.closest)), self.closest)

    def finish(self) -> None:
        if self.pointer is not None:
            code, b = self.code, self.code.builder
            first, second = ir.Constant(INDEX, 0), ir.Constant(INDEX, 1)
            code.add_scalar(code.total(b.load(self.energy)), self.pointer, first)
            closest = code.largest(b.load(self.closest))
            held = code.scalar(self.pointer, second)
            closest = b.select(b.fcmp_ordered(">", closest, held), closest, held)
            code.put_scalar(closest, self.pointer, second)


def _interact(
    code: Code, first: _Grains, second: _Grains, wanted: _Sums, extremes: _Extremes,
    lanes: list[bool] | None = None,
) -> tuple[_Sums, _Sums]:  # fmt: skip
    """What the pairs add to the first, and to the second ones, in the lanes that count."""
    b = code.builder
    dx, dy = b.fsub(first.x, second.x), b.fsub(first.y, second.y)
    r2 = code.fused(dx, dx, b.fmul(dy, dy))
    s = inverse_fifth(code, r2)
    if lanes is not None:
        s = b.select(flags(lanes), s, constant(0.0))
    strength = s
    if first.charge is not None:
        strength = b.fmul(s, b.fmul(first.charge, second.charge))
    extremes.meet(r2, s, strength)
    # Products and sums apart: action and reaction are equal to the last bit, and processors with
    # units for sums of their own are faster.
    fx, fy = b.fmul(strength, dx), b.fmul(strength, dy)
    own: list[Any] = [fx, fy, None, None]
    other: list[Any] = [b.fneg(fx), b.fneg(fy), None, None]
    if wanted.stiffness is not None:
        charged = first.charge is not None
        own[2] = b.fmul(s, second.charge) if charged else s
        other[2] = b.fmul(s, first.charge) if charged else s
    if wanted.load is not None:
        cube = b.fmul(r2, s)
        own[3], other[3] = b.fmul(cube, second.weight), b.fmul(cube, first.weight)
    return _Sums(*own), _Sums(*other)


def _added(code: Code, totals: list[Any], values: list[Any]) -> list[Any]:
    return [code.builder.fadd(one, more) for one, more in zip(totals, values, strict=True)]


def _rows_at_once(context: Any) -> int:
    """Four where 32 registers hold their sums (measured: 5 % faster than two)."""
    return 4 if has_avx512(context) else 2


def _sweep(
    code: Code, arrays: _Arrays, first: ir.Value, rows: int, start: ir.Value, stop: ir.Value
) -> None:
    """That many rows from ``first`` on against the partners start .. stop - 1."""
    b = code.builder
    places = [b.add(first, ir.Constant(INDEX, row)) for row in range(rows)]
    grains = [_one(code, arrays, place) for place in places]
    pointers = _present(arrays.sums)
    totals = [[code.variable(constant(0.0)) for _ in pointers] for _ in range(rows)]
    extremes = _Extremes(code, arrays.extremes)
    with cgutils.for_range_slice(b, start, stop, ir.Constant(INDEX, WIDTH), INDEX) as (j, _):
        partners = _eight(code, arrays, j)
        reactions = [code.load(pointer, j) for pointer in pointers]
        for grain, sums in zip(grains, totals, strict=True):
            own, other = _interact(code, grain, partners, arrays.sums, extremes)
            for total, value in zip(sums, _present(own), strict=True):
                code.raise_by(total, value)
            reactions = _added(code, reactions, _present(other))
        for pointer, reaction in zip(pointers, reactions, strict=True):
            code.store(reaction, pointer, j)
    for which, pointer in enumerate(pointers):
        vectors = [b.load(sums[which]) for sums in totals]
        code.add_vector(code.totals(vectors), pointer, first)
    extremes.finish()


def _sweep_among(code: Code, arrays: _Arrays, first: ir.Value) -> None:
    """The pairs of eight grains: each lane with the ones 1, 2, 3 and 4 behind it, round the end."""
    grains = _eight(code, arrays, first)
    pointers = _present(arrays.sums)
    totals = [code.load(pointer, first) for pointer in pointers]
    extremes = _Extremes(code, arrays.extremes)
    for by in range(1, WIDTH // 2 + 1):
        partners = _Grains(*(None if one is None else code.turned(one, by) for one in grains))
        # Half way round, each pair would be met from both ends.
        lanes = [lane < WIDTH // 2 for lane in range(WIDTH)] if by == WIDTH // 2 else None
        own, other = _interact(code, grains, partners, arrays.sums, extremes, lanes)
        totals = _added(code, totals, _present(own))
        back = [code.turned(value, WIDTH - by) for value in _present(other)]
        totals = _added(code, totals, back)
    for pointer, total in zip(pointers, totals, strict=True):
        code.store(total, pointer, first)
    extremes.finish()


@intrinsic
def sweep_rows(
    typing: Any,
    x: Any,
    y: Any,
    fx: Any,
    fy: Any,
    charge: Any,
    stiffness: Any,
    extremes: Any,
    load: Any,
    weight: Any,
    first: Any,
    start: Any,
    stop: Any,
) -> Any:
    """The eight rows from ``first`` on against the partners start .. stop - 1, with reactions."""
    signature = types.void(
        x, y, fx, fy, charge, stiffness, extremes, load, weight, types.intp, types.intp, types.intp
    )

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = Code(context, builder)
        arrays = _Arrays(code, signature.args[:9], values[:9])
        first, start, stop = values[9:]
        rows = _rows_at_once(context)
        last = builder.add(first, ir.Constant(INDEX, WIDTH))
        step = ir.Constant(INDEX, rows)
        with cgutils.for_range_slice(builder, first, last, step, INDEX) as (row, _):
            _sweep(code, arrays, row, rows, start, stop)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def sweep_block(
    typing: Any,
    x: Any,
    y: Any,
    fx: Any,
    fy: Any,
    charge: Any,
    stiffness: Any,
    extremes: Any,
    load: Any,
    weight: Any,
    first: Any,
) -> Any:
    """The eight grains from ``first`` on among themselves."""
    signature = types.void(x, y, fx, fy, charge, stiffness, extremes, load, weight, types.intp)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = Code(context, builder)
        _sweep_among(code, _Arrays(code, signature.args[:9], values[:9]), values[9])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def sum_lanes(typing: Any, values: Any, stop: Any) -> Any:
    """Sum of the first ``stop`` values (a multiple of the width), lane by lane, then as a tree."""
    signature = types.float64(values, types.intp)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code = Code(context, builder)
        pointer = code.data(signature.args[0], arguments[0])
        total = code.variable(constant(0.0))
        start, width = ir.Constant(INDEX, 0), ir.Constant(INDEX, WIDTH)
        with cgutils.for_range_slice(builder, start, arguments[1], width, INDEX) as (j, _):
            code.raise_by(total, code.load(pointer, j))
        return code.total(builder.load(total))

    return signature, generate


@compiled
def _lane_sum(values: Array) -> float:
    return sum_lanes(values, values.size)


def _plain_sum(values: Array) -> float:
    return float(values.sum())


lane_sum = _plain_sum if config.DISABLE_JIT else _lane_sum
"""Sum of a padded array, in an order that depends on nothing but its length."""
