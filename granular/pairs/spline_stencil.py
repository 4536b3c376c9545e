"""Cubic B-splines on the four by four points of a mesh about a grain, a line of them at a time.

The splines of the four points along an axis, and their slopes, are eight polynomials of one
number: the distance of the grain from the second point towards the third.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from granular.compiled import Array
from granular.pairs.simd import DOUBLE, VectorBuilder, constant_vector

POINTS = 4
"""Points of a spline along each axis."""

_POLYNOMIALS = (
    (1 / 6, 2 / 3, 1 / 6, 0.0, -0.5, 0.0, 0.5, 0.0),
    (-0.5, 0.0, 0.5, 0.0, 1.0, -2.0, 1.0, 0.0),
    (0.5, -1.0, 0.5, 0.0, -0.5, 1.5, -1.5, 0.5),
    (-1 / 6, 0.5, -0.5, 1 / 6, 0.0, 0.0, 0.0, 0.0),
)
"""Splines of the four points by the power of the displacement, and behind them their slopes."""

_FOUR = ir.VectorType(DOUBLE, POINTS)


def _spline_values_and_slopes(code: VectorBuilder, displacement: ir.Value) -> ir.Value:
    """Values of the four splines, and of their slopes."""
    u = code.broadcast_scalar(displacement)
    result: Any = constant_vector(_POLYNOMIALS[-1])
    for coefficients in reversed(_POLYNOMIALS[:-1]):
        result = code.fused_multiply_add(result, u, constant_vector(coefficients))
    return result


def _pointer_to_line(code: VectorBuilder, values: ir.Value, at: ir.Value) -> ir.Value:
    """Pointer to four points that follow each other."""
    return code.builder.bitcast(code.builder.gep(values, [at]), _FOUR.as_pointer())


def _sum_half_lanes(code: VectorBuilder, vector: ir.Value) -> ir.Value:
    """Return the sums of the first and of the last four lanes, each in its first lane."""
    for lanes in ((2, 3, 0, 1, 6, 7, 4, 5), (1, 0, 3, 2, 5, 4, 7, 6)):
        vector = code.builder.fadd(vector, code.shuffle(vector, vector, list(lanes)))
    return vector


@intrinsic
def _emit_spline_weights(typing: Any, values: Any, at: Any, stride: Any, u: Any, v: Any, amount: Any) -> Any:
    signature = types.void(values, types.intp, types.intp, types.float64, types.float64, types.float64)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code = VectorBuilder(context, builder)
        pointer = code.array_pointer(signature.args[0], arguments[0])
        at, stride, u, v, amount = arguments[1:]
        across = _spline_values_and_slopes(code, u)
        along = code.shuffle(across, across, list(range(POINTS)))
        ups = builder.fmul(_spline_values_and_slopes(code, v), code.broadcast_scalar(amount))
        for line in range(POINTS):
            fraction = code.shuffle(ups, ups, [line] * POINTS)
            index = _pointer_to_line(code, pointer, at)
            total = builder.fadd(builder.load(index, align=8), builder.fmul(along, fraction))
            builder.store(total, index, align=8)
            at = builder.add(at, stride)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def _emit_spline_sums(typing: Any, values: Any, at: Any, stride: Any, u: Any, v: Any) -> Any:
    number = types.float64
    signature = types.UniTuple(number, 3)(values, types.intp, types.intp, number, number)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        code = VectorBuilder(context, builder)
        pointer = code.array_pointer(signature.args[0], arguments[0])
        at, stride, u, v = arguments[1:]
        along, up = _spline_values_and_slopes(code, u), _spline_values_and_slopes(code, v)
        total = None
        for line in range(POINTS):
            points = builder.load(_pointer_to_line(code, pointer, at), align=8)
            both = code.shuffle(points, points, [*range(POINTS), *range(POINTS)])
            # The spline of the line in the first four lanes, its slope in the others.
            fraction = code.shuffle(up, up, [line] * POINTS + [line + POINTS] * POINTS)
            total = (
                builder.fmul(both, fraction)
                if total is None
                else code.fused_multiply_add(both, fraction, total)
            )
            at = builder.add(at, stride)
        half = [*range(POINTS), *range(POINTS)]
        splines = code.shuffle(along, along, half)
        slopes = code.shuffle(along, along, [lane + POINTS for lane in half])
        by_value = _sum_half_lanes(code, builder.fmul(total, splines))
        by_slope = _sum_half_lanes(code, builder.fmul(total, slopes))
        result = [
            code.extract_lane(by_value, 0),
            code.extract_lane(by_slope, 0),
            code.extract_lane(by_value, POINTS),
        ]
        return context.make_tuple(builder, signature.return_type, result)

    return signature, generate


def _pure_python_spline_values(displacement: float) -> np.ndarray:
    """Values of the splines, and of their slopes, float64 (2, 4)."""
    result = np.polynomial.polynomial.polyval(displacement, np.array(_POLYNOMIALS))
    return np.asarray(result).reshape(2, POINTS)


def _pure_python_add_spline_weights(
    values: Array, at: int, stride: int, u: float, v: float, amount: float
) -> None:
    indices = at + stride * np.arange(POINTS)[:, None] + np.arange(POINTS)
    values[indices] += amount * np.outer(_pure_python_spline_values(v)[0], _pure_python_spline_values(u)[0])


def _pure_python_interpolate_with_splines(
    values: Array, at: int, stride: int, u: float, v: float
) -> tuple[float, float, float]:
    points = values[at + stride * np.arange(POINTS)[:, None] + np.arange(POINTS)]
    across, up = _pure_python_spline_values(u), _pure_python_spline_values(v)
    return up[0] @ points @ across[0], up[0] @ points @ across[1], up[1] @ points @ across[0]


add_spline_weights = _pure_python_add_spline_weights if config.DISABLE_JIT else _emit_spline_weights
"""Add an amount to the four by four points from ``at`` on, whose lines are ``stride`` apart.

Parameters
----------
values : float64 (p,)
at, stride : int
u, v : float
    Way along both axes from the second point to the third, 0 to 1.
amount : float
"""

interpolate_with_splines = _pure_python_interpolate_with_splines if config.DISABLE_JIT else _emit_spline_sums
"""Value of the spline through such points, and its slopes along both axes [1/spacing]."""
