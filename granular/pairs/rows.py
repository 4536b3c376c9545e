"""Rows of sums, eight places at a time: cleared, and added to each other."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from granular.pairs.lanes import INDEX, WIDTH, Code, constant


@intrinsic
def clear_row(typing: Any, sums: Any, row: Any, first: Any, end: Any) -> Any:
    """Set the places first .. end - 1 of a row to zero; both are multiples of the width."""
    signature = types.void(sums, types.intp, types.intp, types.intp)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code, (array, row, first, end) = Code(context, builder), values
        pointer = code.data(signature.args[0], array, row)
        with cgutils.for_range_slice(builder, first, end, _step(), INDEX) as (place, _):
            code.store(constant(0.0), pointer, place)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def add_row(typing: Any, sums: Any, row: Any, other: Any, first: Any, end: Any) -> Any:
    """Add to the places first .. end - 1 of a row those of another; as in `clear_row`."""
    signature = types.void(sums, types.intp, types.intp, types.intp, types.intp)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code, (array, row, other, first, end) = Code(context, builder), values
        total = code.data(signature.args[0], array, row)
        more = code.data(signature.args[0], array, other)
        with cgutils.for_range_slice(builder, first, end, _step(), INDEX) as (place, _):
            value = builder.fadd(code.load(total, place), code.load(more, place))
            code.store(value, total, place)
        return context.get_dummy_value()

    return signature, generate


def _step() -> ir.Constant:
    return ir.Constant(INDEX, WIDTH)
