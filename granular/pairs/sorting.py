"""Sorting of grains within kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from granular.compiled import Array, compiled

if TYPE_CHECKING:
    from jaxtyping import Float, Int


@compiled
def sort_by_value(order: Int[Array, "k"], values: Float[Array, "n"]) -> None:
    """Sort numbers of grains by a value of each, smallest first."""
    # Shell's method, steps of [Knuth, The Art of Computer Programming 3, 5.2.1]: quicker than Numba's
    # ``argsort`` for the hundred grains of a stripe, 1.7 times as slow for 1e5, compiled in a tenth of the
    # time.
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
