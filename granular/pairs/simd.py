"""Operations on eight doubles at a time, emitted as LLVM vector instructions.

LLVM splits the eight lanes on processors with narrower registers. Every operation follows IEEE 754 in double
precision, and the order of the operations is fixed, so the bits of the result do not depend on the thread.

The inverse fifth power of a distance is computed without division, the slowest operation. An estimate y of
1/sqrt(r^2), the seed, is corrected by a polynomial: with e = 1 - r^2 y^2,
r^-5 = y^5 (1 - e)^(-5/2) = y^5 (1 + (5/2) e + (35/8) e^2 + (105/16) e^3 + ...). The fourth-order
remainder is below 2e-15 for |e| < 1.3e-4, which both seeds satisfy:

- AVX-512 has an instruction for the seed, with a relative error below 2^-14.
- On other processors the seed is obtained by halving the exponent in the bits of the number (Lomont 2003,
  "Fast inverse square root"; error 3.4 %). The minimax polynomial in r^2 y^2 then reduces e to below 5e-5. On
  processors with fast division this method saves no time, but all these processors give the same bits.

The cubic is evaluated as (105/16) ((e + 2/3) (e^2 + 8/21) - 32/315): two products instead of
three (Knuth, The Art of Computer Programming 2, 4.6.4). The factor 105/16 is applied only after summation;
it is called `SCALE`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils

WIDTH = 8
"""Number of lanes of a vector; arrays are padded to a multiple of it."""

DOUBLE = ir.DoubleType()
INDEX = ir.IntType(64)
LANES = ir.VectorType(DOUBLE, WIDTH)
_BITS = ir.VectorType(INDEX, WIDTH)
_FLAGS = ir.VectorType(ir.IntType(1), WIDTH)
_UNDEFINED = ir.Constant(LANES, ir.Undefined)


def pad_to_vectors(count: int) -> int:
    """Round a number of grains up to the next multiple of the vector width."""
    return max(WIDTH, -(-count // WIDTH) * WIDTH)


def broadcast_constant(value: float) -> ir.Constant:
    """Make a constant vector <8 x double> with one value in all lanes."""
    return ir.Constant(LANES, [value] * WIDTH)


def constant_vector(values: Sequence[float]) -> ir.Constant:
    """Make a constant vector <8 x double> from eight values."""
    return ir.Constant(LANES, list(values))


def lane_mask(lanes: list[bool]) -> ir.Constant:
    """Make a constant mask <8 x i1> that selects lanes."""
    return ir.Constant(_FLAGS, lanes)


def has_avx512(context: Any) -> bool:
    """Return True if the processor for which Numba compiles has 512-bit vectors."""
    return "+avx512f" in context.codegen().magic_tuple()[2]


class VectorBuilder:
    """An instruction builder for vector operations."""

    def __init__(self, context: Any, builder: ir.IRBuilder) -> None:
        self.context, self.builder = context, builder

    def array_pointer(self, kind: Any, array: Any, row: ir.Value | None = None) -> Any:
        """Emit the pointer to the first element of an array, or of one of its rows."""
        if isinstance(kind, types.NoneType):
            return None
        made = self.context.make_array(kind)(self.context, self.builder, array)
        if row is None or kind.ndim == 1:
            return made.data
        across = self.builder.extract_value(made.shape, 1)
        return self.builder.gep(made.data, [self.builder.mul(row, across)])

    def call_llvm_function(self, name: str, *operands: ir.Value) -> ir.Value:
        """Emit the call of an LLVM function on vectors of doubles."""
        module = self.builder.module
        function = module.globals.get(name)
        if function is None:
            kind = ir.FunctionType(LANES, [operand.type for operand in operands])
            function = ir.Function(module, kind, name)
        return self.builder.call(function, operands)

    def fused_multiply_add(self, a: ir.Value, b: ir.Value, c: ir.Value) -> ir.Value:
        """Emit a b + c in every lane, with one rounding if the processor supports it."""
        return self.call_llvm_function(f"llvm.fmuladd.v{WIDTH}f64", a, b, c)

    def round_to_integers(self, vector: ir.Value) -> ir.Value:
        """Emit rounding to integers, with halves to even."""
        return self.call_llvm_function(f"llvm.rint.v{WIDTH}f64", vector)

    def broadcast_scalar(self, scalar: ir.Value) -> ir.Value:
        """Emit a vector with one double in all eight lanes."""
        first = self.builder.insert_element(_UNDEFINED, scalar, ir.Constant(ir.IntType(32), 0))
        return self.shuffle(first, first, [0] * WIDTH)

    def shuffle(self, first: ir.Value, second: ir.Value, lanes: list[int]) -> ir.Value:
        """Emit a vector of chosen lanes of two vectors."""
        mask = ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), lanes)
        return self.builder.shuffle_vector(first, second, mask)

    def rotate_lanes(self, vector: ir.Value, by: int) -> ir.Value:
        """Rotate the lanes cyclically: lane l takes the value of lane l + ``by``."""
        return self.shuffle(vector, vector, [(lane + by) % WIDTH for lane in range(WIDTH)])

    def _vector_pointer(self, pointer: ir.Value, index: ir.Value) -> ir.Value:
        return self.builder.bitcast(self.builder.gep(pointer, [index]), LANES.as_pointer())

    def load_vector(self, pointer: ir.Value, index: ir.Value) -> ir.Value:
        """Emit the loading of eight successive doubles."""
        return self.builder.load(self._vector_pointer(pointer, index), align=8)

    def store_vector(self, vector: ir.Value, pointer: ir.Value, index: ir.Value) -> None:
        """Emit the storing of eight successive doubles."""
        self.builder.store(vector, self._vector_pointer(pointer, index), align=8)

    def load_scalar(self, pointer: ir.Value, index: ir.Value) -> ir.Value:
        """Emit the loading of one number."""
        return self.builder.load(self.builder.gep(pointer, [index]))

    def store_scalar(self, value: ir.Value, pointer: ir.Value, index: ir.Value) -> None:
        """Emit the storing of one number."""
        self.builder.store(value, self.builder.gep(pointer, [index]))

    def extract_lane(self, vector: ir.Value, lane: int) -> ir.Value:
        """Emit the value of one lane."""
        return self.builder.extract_element(vector, ir.Constant(ir.IntType(32), lane))

    def _add_folded_lanes(self, first: ir.Value, second: ir.Value, half: int) -> ir.Value:
        """Add lanes at distance ``half`` within each of two vectors, and interleave the results."""
        lanes = range(WIDTH)
        there = [lane + WIDTH if lane & half else lane for lane in lanes]
        other = [(lane ^ half) + WIDTH if lane & half else lane ^ half for lane in lanes]
        return self.builder.fadd(self.shuffle(first, second, there), self.shuffle(first, second, other))

    def sum_lanes_of_vectors(self, vectors: list[ir.Value]) -> ir.Value:
        """Emit the sums of the lanes of 1, 2, 4 or 8 vectors, each by pairwise addition."""
        indices = [0]
        for half in (4, 2, 1):
            if len(vectors) > 1:
                pairs = zip(vectors[::2], vectors[1::2], strict=True)
                vectors = [self._add_folded_lanes(first, second, half) for first, second in pairs]
                indices = [*indices, *(position + half for position in indices)]
            else:
                vectors = [self._add_folded_lanes(vectors[0], vectors[0], half)]
        return self.shuffle(vectors[0], vectors[0], indices)

    def sum_lanes(self, vector: ir.Value) -> ir.Value:
        """Emit the sum of the lanes of one vector, by pairwise addition."""
        return self.extract_lane(self.sum_lanes_of_vectors([vector]), 0)

    def add_vector_to_entries(self, vector: ir.Value, pointer: ir.Value, index: ir.Value) -> None:
        """Emit the addition of a vector of any length to successive stored doubles."""
        position = self.builder.bitcast(self.builder.gep(pointer, [index]), vector.type.as_pointer())
        total = self.builder.fadd(self.builder.load(position, align=8), vector)
        self.builder.store(total, position, align=8)

    def largest_lane(self, vector: ir.Value) -> ir.Value:
        """Emit the largest lane of a vector."""
        for half in (4, 2, 1):
            other = self.shuffle(vector, vector, [lane ^ half for lane in range(WIDTH)])
            vector = self.elementwise_maximum(vector, other)
        return self.extract_lane(vector, 0)

    def elementwise_maximum(self, a: ir.Value, b: ir.Value) -> ir.Value:
        """Emit the lane-wise maximum of two vectors."""
        return self.builder.select(self.builder.fcmp_ordered(">", a, b), a, b)

    def new_variable(self, start: ir.Value) -> ir.Value:
        """Emit a variable on the stack with an initial value."""
        return cgutils.alloca_once_value(self.builder, start)

    def add_to_variable(self, variable: ir.Value, value: ir.Value) -> None:
        """Emit the addition of a value to a variable."""
        self.builder.store(self.builder.fadd(self.builder.load(variable), value), variable)


SCALE = 105.0 / 16.0
"""Factor by which sums of `emit_inverse_fifth_power` must still be multiplied."""

# Lomont's constant for double precision: the error of the seed is at most 3.4 %.
_HALVED_EXPONENT = 0x5FE6EB50C7B537A9
# Minimax polynomial for t^(-1/2) in the seed's range of t = r^2 y^2.
_FIRST = (1.8765983221738327, -1.252100297322187, 0.37550218858758094)
_SHIFT, _SQUARE, _REST = 2.0 / 3.0, 8.0 / 21.0, -32.0 / 315.0


def _emit_avx512_inverse_root_seed(code: VectorBuilder, r2: ir.Value) -> ir.Value:
    """Emit the processor's estimate of 1/sqrt(r2)."""
    b = code.builder
    name = "llvm.x86.avx512.rsqrt14.pd.512"
    function = b.module.globals.get(name)
    byte = ir.IntType(8)
    if function is None:
        kind = ir.FunctionType(r2.type, [r2.type, r2.type, byte])
        function = ir.Function(b.module, kind, name)
    return b.call(function, [r2, broadcast_constant(0.0), ir.Constant(byte, -1)])


def _emit_portable_inverse_root_seed(code: VectorBuilder, r2: ir.Value) -> ir.Value:
    """Emit an estimate of 1/sqrt(r2) from its bits, equal on every processor."""
    b = code.builder
    halved = b.lshr(b.bitcast(r2, _BITS), ir.Constant(_BITS, [1] * WIDTH))
    y = b.bitcast(b.sub(ir.Constant(_BITS, [_HALVED_EXPONENT] * WIDTH), halved), LANES)
    t = b.fmul(r2, b.fmul(y, y))
    slope = code.fused_multiply_add(t, broadcast_constant(_FIRST[2]), broadcast_constant(_FIRST[1]))
    return b.fmul(y, code.fused_multiply_add(t, slope, broadcast_constant(_FIRST[0])))


DISC_SCALE = 35.0 / 8.0
"""Factor by which sums of `emit_rough_inverse_fifth_power` must still be multiplied."""

# 1 + (5/2) e + (35/8) e^2 = (35/8) ((e + 2/7)^2 + 36/245); 9/7 = 1 + 2/7.
_SHORT_SHIFT, _SHORT_REST = 9.0 / 7.0, 36.0 / 245.0


def _emit_inverse_root_seed(code: VectorBuilder, r2: ir.Value) -> ir.Value:
    return (
        _emit_avx512_inverse_root_seed(code, r2)
        if has_avx512(code.context)
        else _emit_portable_inverse_root_seed(code, r2)
    )


def emit_rough_inverse_fifth_power(code: VectorBuilder, r2: ir.Value) -> ir.Value:
    """Emit r^-5 / `DISC_SCALE`, faster than `emit_inverse_fifth_power`, with a relative error of 2e-11."""
    b = code.builder
    y = _emit_inverse_root_seed(code, r2)
    y2 = b.fmul(y, y)
    t = code.fused_multiply_add(b.fneg(r2), y2, broadcast_constant(_SHORT_SHIFT))
    square = code.fused_multiply_add(t, t, broadcast_constant(_SHORT_REST))
    return b.fmul(b.fmul(b.fmul(y2, y2), y), square)


def emit_inverse_fifth_power(code: VectorBuilder, r2: ir.Value) -> ir.Value:
    """Emit r^-5 / `SCALE` from r^2, with a relative error of 2e-15; NaN at r = 0."""
    b = code.builder
    y = _emit_inverse_root_seed(code, r2)
    y2 = b.fmul(y, y)
    e = code.fused_multiply_add(b.fneg(r2), y2, broadcast_constant(1.0))
    square = code.fused_multiply_add(e, e, broadcast_constant(_SQUARE))
    cubic = code.fused_multiply_add(b.fadd(e, broadcast_constant(_SHIFT)), square, broadcast_constant(_REST))
    return b.fmul(b.fmul(b.fmul(y2, y2), y), cubic)
