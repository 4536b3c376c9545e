"""Vector code for the pair sum: eight pairs at a time, written out as LLVM vector operations.

Numba does not vectorise a loop that also subtracts from the partner (``fx[j] -= ...``), so the
inner loops are emitted here. LLVM splits the eight lanes on processors with narrower registers.
Every operation is IEEE double and its order is fixed: the result has the same bits whichever
thread runs it.

The law is the dipole pair: with s = r^-5 the force on i is (3/4) q_i q_j s (r_i - r_j), and
r^-3 = r^2 s gives the energy and the friction load in the same pass.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

from granular.compiled import Array, compiled

WIDTH = 8
"""Lanes of a vector; arrays are padded to a multiple of it."""

_ROWS = 2  # rows swept together; more gained nothing (measured at 368 and 1472 grains)
_DOUBLE = ir.DoubleType()
_INDEX = ir.IntType(64)
_LANES = ir.VectorType(_DOUBLE, WIDTH)
_UNDEFINED = ir.Constant(_LANES, ir.Undefined)


def padded(count: int) -> int:
    """The least multiple of the vector width that holds ``count`` grains (at least one vector)."""
    return max(WIDTH, -(-count // WIDTH) * WIDTH)


def _mask(lanes: list[int]) -> ir.Constant:
    return ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), lanes)


def _constant(value: float) -> ir.Constant:
    return ir.Constant(_LANES, [value] * WIDTH)


class _Code:
    """An instruction builder with the few vector operations that are needed."""

    def __init__(self, context: Any, builder: ir.IRBuilder) -> None:
        self.context, self.builder = context, builder

    def data(self, kind: Any, array: Any) -> Any:
        """Pointer to an array's first element; None for an absent array."""
        if isinstance(kind, types.NoneType):
            return None
        return self.context.make_array(kind)(self.context, self.builder, array).data

    def intrinsic(self, name: str, *operands: ir.Value) -> ir.Value:
        module = self.builder.module
        full = f"llvm.{name}.v{WIDTH}f64"
        function = module.globals.get(full)
        if function is None:
            kind = ir.FunctionType(_LANES, [_LANES] * len(operands))
            function = ir.Function(module, kind, full)
        return self.builder.call(function, operands)

    def fused(self, a: ir.Value, b: ir.Value, c: ir.Value) -> ir.Value:
        return self.intrinsic("fmuladd", a, b, c)

    def splat(self, scalar: ir.Value) -> ir.Value:
        zero = ir.Constant(ir.IntType(32), 0)
        first = self.builder.insert_element(_UNDEFINED, scalar, zero)
        return self.builder.shuffle_vector(first, _UNDEFINED, _mask([0] * WIDTH))

    def _vector_at(self, pointer: ir.Value, index: ir.Value) -> ir.Value:
        return self.builder.bitcast(self.builder.gep(pointer, [index]), _LANES.as_pointer())

    def load(self, pointer: ir.Value, index: ir.Value) -> ir.Value:
        return self.builder.load(self._vector_at(pointer, index), align=8)

    def store(self, vector: ir.Value, pointer: ir.Value, index: ir.Value) -> None:
        self.builder.store(vector, self._vector_at(pointer, index), align=8)

    def scalar(self, pointer: ir.Value, index: ir.Value) -> ir.Value:
        return self.builder.load(self.builder.gep(pointer, [index]))

    def add_scalar(self, value: ir.Value, pointer: ir.Value, index: ir.Value) -> None:
        place = self.builder.gep(pointer, [index])
        self.builder.store(self.builder.fadd(self.builder.load(place), value), place)

    def total(self, vector: ir.Value) -> ir.Value:
        """Sum of the lanes, as a tree."""
        for half in (4, 2, 1):
            swapped = _mask([lane ^ half for lane in range(WIDTH)])
            other = self.builder.shuffle_vector(vector, _UNDEFINED, swapped)
            vector = self.builder.fadd(vector, other)
        return self.builder.extract_element(vector, ir.Constant(ir.IntType(32), 0))

    def largest(self, vector: ir.Value) -> ir.Value:
        for half in (4, 2, 1):
            swapped = _mask([lane ^ half for lane in range(WIDTH)])
            vector = self.greater(vector, self.builder.shuffle_vector(vector, _UNDEFINED, swapped))
        return self.builder.extract_element(vector, ir.Constant(ir.IntType(32), 0))

    def greater(self, a: ir.Value, b: ir.Value) -> ir.Value:
        return self.builder.select(self.builder.fcmp_ordered(">", a, b), a, b)

    def variable(self, start: ir.Value) -> ir.Value:
        return cgutils.alloca_once_value(self.builder, start)

    def accumulate(self, variable: ir.Value, a: ir.Value, b: ir.Value) -> None:
        """Variable += a b"""
        self.builder.store(self.fused(a, b, self.builder.load(variable)), variable)


class _Arrays:
    """Pointers of one call. An absent array is None, and no code is made for it."""

    def __init__(self, code: _Code, kinds: Any, arrays: Any) -> None:
        pointers = [code.data(kind, array) for kind, array in zip(kinds, arrays, strict=True)]
        self.x, self.y, self.fx, self.fy, self.charge = pointers[:5]
        self.stiffness, self.extremes, self.load, self.weight = pointers[5:]


class _Row:
    """One row i: its place, its charge, and the sums over its partners."""

    def __init__(self, code: _Code, arrays: _Arrays, index: ir.Value) -> None:
        self.code, self.arrays, self.index = code, arrays, index
        self.x = code.splat(code.scalar(arrays.x, index))
        self.y = code.splat(code.scalar(arrays.y, index))
        self.charge = arrays.charge and code.splat(code.scalar(arrays.charge, index))
        self.weight = arrays.weight and code.splat(code.scalar(arrays.weight, index))
        zero = _constant(0.0)
        self.fx, self.fy = code.variable(zero), code.variable(zero)
        self.stiffness = arrays.stiffness and code.variable(zero)
        self.energy = arrays.extremes and code.variable(zero)
        self.closest = arrays.extremes and code.variable(zero)
        self.load = arrays.load and code.variable(zero)

    def interact(self, partner: _Partner, skip: int | None = None) -> None:
        """Add the pairs of this row with the eight partners; lane ``skip`` is the row itself."""
        code, b = self.code, self.code.builder
        dx, dy = b.fsub(self.x, partner.x), b.fsub(self.y, partner.y)
        r2 = code.fused(dx, dx, b.fmul(dy, dy))
        s = b.fdiv(_constant(1.0), b.fmul(b.fmul(r2, r2), code.intrinsic("sqrt", r2)))
        if skip is not None:
            one = ir.VectorType(ir.IntType(1), WIDTH)
            other = ir.Constant(one, [lane != skip for lane in range(WIDTH)])
            s = b.select(other, s, _constant(0.0))
        cube = b.fmul(r2, s) if self.energy or self.load else None
        strength = s
        if self.charge is not None:
            strength = b.fmul(s, b.fmul(self.charge, partner.charge))
        code.accumulate(self.fx, strength, dx)
        code.accumulate(self.fy, strength, dy)
        if skip is None:
            minus = b.fneg(strength)
            partner.fx = code.fused(minus, dx, partner.fx)
            partner.fy = code.fused(minus, dy, partner.fy)
        if self.stiffness is not None:
            code.accumulate(self.stiffness, s, partner.charge or _constant(1.0))
            if skip is None:
                partner.stiffness = code.fused(s, self.charge or _constant(1.0), partner.stiffness)
        if self.energy is not None:
            code.accumulate(self.energy, b.fmul(r2, strength), _constant(1.0))
            b.store(code.greater(s, b.load(self.closest)), self.closest)
        if self.load is not None:
            code.accumulate(self.load, cube, partner.weight)
            if skip is None:
                partner.load = code.fused(cube, self.weight, partner.load)

    def finish(self, share: float) -> None:
        """Write the row's sums; ``share`` of the pair energy is this row's."""
        code, b, arrays = self.code, self.code.builder, self.arrays
        code.add_scalar(code.total(b.load(self.fx)), arrays.fx, self.index)
        code.add_scalar(code.total(b.load(self.fy)), arrays.fy, self.index)
        if self.stiffness is not None:
            code.add_scalar(code.total(b.load(self.stiffness)), arrays.stiffness, self.index)
        if self.load is not None:
            code.add_scalar(code.total(b.load(self.load)), arrays.load, self.index)
        if self.energy is not None:
            first, second = ir.Constant(_INDEX, 0), ir.Constant(_INDEX, 1)
            energy = b.fmul(code.total(b.load(self.energy)), ir.Constant(_DOUBLE, share))
            code.add_scalar(energy, arrays.extremes, first)
            place = b.gep(arrays.extremes, [second])
            closest, held = code.largest(b.load(self.closest)), b.load(place)
            b.store(b.select(b.fcmp_ordered(">", closest, held), closest, held), place)


class _Partner:
    """Eight partners j, with their reactions."""

    def __init__(self, code: _Code, arrays: _Arrays, j: ir.Value, reactions: bool) -> None:
        self.code, self.arrays, self.j = code, arrays, j
        self.x, self.y = code.load(arrays.x, j), code.load(arrays.y, j)
        self.charge = arrays.charge and code.load(arrays.charge, j)
        self.weight = arrays.weight and code.load(arrays.weight, j)
        if reactions:
            self.fx, self.fy = code.load(arrays.fx, j), code.load(arrays.fy, j)
            self.stiffness = arrays.stiffness and code.load(arrays.stiffness, j)
            self.load = arrays.load and code.load(arrays.load, j)

    def finish(self) -> None:
        code, arrays = self.code, self.arrays
        code.store(self.fx, arrays.fx, self.j)
        code.store(self.fy, arrays.fy, self.j)
        if arrays.stiffness is not None:
            code.store(self.stiffness, arrays.stiffness, self.j)
        if arrays.load is not None:
            code.store(self.load, arrays.load, self.j)


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
    """Rows first and first + 1 against the partners start .. stop - 1, with reactions."""
    signature = types.void(
        x, y, fx, fy, charge, stiffness, extremes, load, weight, types.intp, types.intp, types.intp
    )

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = _Code(context, builder)
        arrays = _Arrays(code, signature.args[:9], values[:9])
        first, start, stop = values[9:]
        rows = [
            _Row(code, arrays, builder.add(first, ir.Constant(_INDEX, row))) for row in range(_ROWS)
        ]
        width = ir.Constant(_INDEX, WIDTH)
        with cgutils.for_range_slice(builder, start, stop, width, _INDEX) as (j, _):
            partner = _Partner(code, arrays, j, reactions=True)
            for row in rows:
                row.interact(partner)
            partner.finish()
        for row in rows:
            row.finish(share=1.0)
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
    """The eight grains from ``first`` on among themselves, as full rows."""
    signature = types.void(x, y, fx, fy, charge, stiffness, extremes, load, weight, types.intp)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = _Code(context, builder)
        arrays = _Arrays(code, signature.args[:9], values[:9])
        first = values[9]
        partner = _Partner(code, arrays, first, reactions=False)
        for lane in range(WIDTH):
            row = _Row(code, arrays, builder.add(first, ir.Constant(_INDEX, lane)))
            row.interact(partner, skip=lane)
            row.finish(share=0.5)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def sum_lanes(typing: Any, values: Any, stop: Any) -> Any:
    """Sum of the first ``stop`` values (a multiple of the width), lane by lane, then as a tree."""
    signature = types.float64(values, types.intp)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code = _Code(context, builder)
        pointer = code.data(signature.args[0], arguments[0])
        total = code.variable(_constant(0.0))
        start, width = ir.Constant(_INDEX, 0), ir.Constant(_INDEX, WIDTH)
        with cgutils.for_range_slice(builder, start, arguments[1], width, _INDEX) as (j, _):
            builder.store(builder.fadd(builder.load(total), code.load(pointer, j)), total)
        return code.total(builder.load(total))

    return signature, generate


@compiled
def _lane_sum(values: Array) -> float:
    return sum_lanes(values, values.size)


def _plain_sum(values: Array) -> float:
    return float(values.sum())


lane_sum = _plain_sum if config.DISABLE_JIT else _lane_sum
"""Sum of a padded array, in an order that depends on nothing but its length."""
