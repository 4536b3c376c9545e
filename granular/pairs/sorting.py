"""Sorting of grains within kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from granular.compiled import Array, compiled

if TYPE_CHECKING:
    from jaxtyping import Float, Int


@compiled
def sort_by_value(order: Int[Array, "k"], values: Float[Array, "n"]) -> None:
    """Sort numbers of grains by a value of each, smallest first."""
    gap = 1
    while gap < order.size // 9:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, order.size):
            grain = order[i]
            at = i
            while at >= gap and values[order[at - gap]] > values[grain]:
                order[at] = order[at - gap]
                at -= gap
            order[at] = grain
        gap //= 3
