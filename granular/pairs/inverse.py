"""The inverse fifth power of a distance without a division, which would take longest of all.

A seed y of 1/sqrt(r^2) is corrected by a polynomial: with e = 1 - r^2 y^2,
r^-5 = y^5 (1 - e)^(-5/2) = y^5 (1 + (5/2) e + (35/8) e^2 + (105/16) e^3 + ...). The fourth-order
rest is below 2e-15 for |e| < 1.3e-4, which both seeds keep:

- AVX-512 has an instruction for it, with a relative error below 2^-14;
- elsewhere half the exponent is taken on the bits of the number (Lomont 2003, "Fast inverse square
  root"; error 3.4 %), and a polynomial in r^2 y^2, the minimax one over its range, takes e below
  5e-5. It takes about as long as it saves on processors with fast division, and gives the same
  bits on all of them.

The cubic is evaluated as (105/16) ((e + 2/3) (e^2 + 8/21) - 32/315): two products instead of
three (Knuth, The Art of Computer Programming 2, 4.6.4). The factor 105/16 is left to the end of a
sum: `SCALE`.
"""

from __future__ import annotations

from llvmlite import ir

from granular.pairs.lanes import Code, constant, has_avx512, whole_constant

SCALE = 105.0 / 16.0
"""What sums of `inverse_fifth` lack as a factor."""

_HALVED_EXPONENT = 0x5FE6EB50C7B537A9
_FIRST = (1.8765983221738327, -1.252100297322187, 0.37550218858758094)
_SHIFT, _SQUARE, _REST = 2.0 / 3.0, 8.0 / 21.0, -32.0 / 315.0


def _estimated_seed(code: Code, r2: ir.Value) -> ir.Value:
    """The processor's own estimate."""
    b = code.builder
    name = "llvm.x86.avx512.rsqrt14.pd.512"
    function = b.module.globals.get(name)
    byte = ir.IntType(8)
    if function is None:
        kind = ir.FunctionType(r2.type, [r2.type, r2.type, byte])
        function = ir.Function(b.module, kind, name)
    return b.call(function, [r2, constant(0.0), ir.Constant(byte, -1)])


def _portable_seed(code: Code, r2: ir.Value) -> ir.Value:
    """From the bits: the same on every processor."""
    b = code.builder
    halved = b.lshr(code.bits(r2), whole_constant(1))
    y = code.number(b.sub(whole_constant(_HALVED_EXPONENT), halved))
    t = b.fmul(r2, b.fmul(y, y))
    slope = code.fused(t, constant(_FIRST[2]), constant(_FIRST[1]))
    return b.fmul(y, code.fused(t, slope, constant(_FIRST[0])))


def inverse_fifth(code: Code, r2: ir.Value) -> ir.Value:
    """r^-5 / `SCALE` from r^2; not a number where r is zero."""
    b = code.builder
    y = _estimated_seed(code, r2) if has_avx512(code.context) else _portable_seed(code, r2)
    y2 = b.fmul(y, y)
    e = code.fused(b.fneg(r2), y2, constant(1.0))
    square = code.fused(e, e, constant(_SQUARE))
    cubic = code.fused(b.fadd(e, constant(_SHIFT)), square, constant(_REST))
    return b.fmul(b.fmul(b.fmul(y2, y2), y), cubic)
