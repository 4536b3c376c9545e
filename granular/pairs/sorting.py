"""Sorting of grains within kernels."""

from __future__ import annotations

from granular.compiled import Array, compiled


@compiled
def sort_by_value(order: Array, values: Array) -> None:
    """Sort numbers of grains by a value of each, smallest first.

    By Shell's method, with the steps of [Knuth, The Art of Computer Programming 3, 5.2.1]: faster than
    Numba's ``argsort`` for the hundred grains of a stripe, 1.7 times as slow for 1e5, and compiled in
    a fraction of its time.

    Parameters
    ----------
    order : int64 (k,)
        Numbers of grains, sorted in place.
    values : float64 (n,)
        Values by number; none may be NaN.
    """
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
