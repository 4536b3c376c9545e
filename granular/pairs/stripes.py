"""Arrays for grains in horizontal stripes, sorted by x within each stripe, and for their partners.

The partners of a grain are a few ranges of consecutive entries: later entries of the grain's stripe, and a
part of each of the two stripes above. Each stripe ends with distant padding entries, so that a vector may
extend beyond its end. See `granular.pairs.cut_off_sum`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.direct_sum import MIN_GRAINS_FOR_PARTS, PARTS
from granular.pairs.simd import WIDTH, pad_to_vectors
from granular.shared.array_types import Float, Int

ROWS = 2
"""Number of consecutive sorted grains ("rows") of a stripe whose sums are computed together."""

RANGES = 3
"""Number of ranges of partners for two rows: one in their stripe and one in each of the two stripes above."""

IMAGES = 3
"""Number of ranges per stripe in a periodic cell: grains, images on the right, images on the left."""


@compiled
def sort_indices_by_value(order: Int[Array, "k"], values: Float[Array, "n"]) -> None:
    """Sort the indices of grains by a value, smallest first."""
    # Shell sort with the increments of [Knuth, The Art of Computer Programming 3, 5.2.1]: faster than Numba's
    # ``argsort`` for the hundred grains of a stripe, 1.7 times slower for 1e5, and compiled in a tenth of
    # the time.
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


MIN_PER_STRIPE = 8
"""Minimum mean number of grains per stripe. Stripes that would contain fewer grains are made
higher, which limits the memory.
"""

LISTED, GRAINS, SKIN, CALLS, BUILDS, STRIPES = range(6)
"""Entries of an array: 1 if the lists are valid; number of grains in the lists; skin [D]; number of sums
since the lists were made; number of times that lists were made; number of stripes.
"""


class CutOffSettings(NamedTuple):
    """Settings of a cut-off."""

    radius: float  # [D]
    moments: bool  # True if moments differ between grains
    smooth: bool | None  # None: plain cut-off; else the far part of the law is subtracted
    periods: tuple[float, float] | None = None  # width and height of a periodic cell [D]


class Stripes(NamedTuple):
    """Grains in stripes, and the ranges of their partners."""

    x: Float[np.ndarray, "s"]  # in the order of stripes, with distant padding between them [D]
    y: Float[np.ndarray, "s"]  # [D]
    moments: Float[np.ndarray, "s"] | None
    weight: Float[np.ndarray, "s"] | None
    shift: Float[np.ndarray, "s"] | None  # [D^2]
    fx: np.ndarray  # (parts, s): sums of each part
    fy: np.ndarray  # (parts, s)
    stiffness: np.ndarray  # (parts, s)
    load: np.ndarray | None  # (parts, s)
    rows: Int[np.ndarray, "parts+1"]  # first row of each part
    firsts: Int[np.ndarray, "parts+1"]  # index in ``order`` of each part's first grain
    lows: Int[np.ndarray, "parts"]  # first entry to which a part adds
    ends: Int[np.ndarray, "parts"]  # end of the entries to which a part adds
    slot: Int[np.ndarray, "m"]  # entry that belongs to each grain of ``order``
    order: Int[np.ndarray, "m"]  # grains in the order of stripes; initially 0, 1, ...
    stripe: Int[np.ndarray, "m"]  # scratch
    begins: Int[np.ndarray, "k"]  # first entry of each stripe, a multiple of the vector width
    partner_ranges: Int[np.ndarray, "s/2 RANGES 2"]  # start and stop of each run
    shifts: Float[np.ndarray, "s/2 RANGES*IMAGES 2"] | None  # shift of the images of each run [D]
    cell_offsets: Float[np.ndarray, "2 m"] | None  # offset of each grain from its image in the cell [D]
    periods: Float[np.ndarray, "2"] | None  # sides of the periodic cell [D]
    built: Float[np.ndarray, "2 m"]  # positions of the last listing [D]; part of a checkpoint
    memory: Float[np.ndarray, "6"]  # see `LISTED` to `STRIPES`; part of a checkpoint


def allocate_stripes(
    size: int,
    *,
    moments: bool,
    with_loads: bool,
    shifted: bool = False,
    periods: tuple[float, float] | None = None,
) -> Stripes:
    """Allocate stripes for pairs within a radius; the memory is proportional to the number of grains."""
    periodic = periods is not None
    runs = RANGES * IMAGES if periodic else RANGES
    max_stripes = max(1, size // MIN_PER_STRIPE)
    length = pad_to_vectors(size + 2 * WIDTH * max_stripes) + 2 * WIDTH
    parts = PARTS if size >= MIN_GRAINS_FOR_PARTS else 1
    return Stripes(
        x=np.zeros(length),
        y=np.zeros(length),
        moments=np.zeros(length) if moments else None,
        weight=np.zeros(length) if with_loads else None,
        shift=np.zeros(length) if shifted else None,
        fx=np.zeros((parts, length)),
        fy=np.zeros((parts, length)),
        stiffness=np.zeros((parts, length)),
        load=np.zeros((parts, length)) if with_loads else None,
        rows=np.zeros(parts + 1, dtype=np.int64),
        firsts=np.zeros(parts + 1, dtype=np.int64),
        lows=np.zeros(parts, dtype=np.int64),
        ends=np.zeros(parts, dtype=np.int64),
        slot=np.zeros(size, dtype=np.int64),
        order=np.arange(size),
        stripe=np.zeros(size, dtype=np.int64),
        begins=np.zeros(max_stripes + 2, dtype=np.int64),
        partner_ranges=np.zeros((length // ROWS, runs, 2), dtype=np.int64),
        shifts=np.zeros((length // ROWS, runs, 2)) if periodic else None,
        cell_offsets=np.zeros((2, size)) if periodic else None,
        periods=np.array(periods) if periodic else None,
        built=np.zeros((2, size)),
        memory=np.zeros(6),
    )


PADDING = 1e9
"""Position of the first padding entry [D]: farther than any grain, but near enough that a shift by a period
is not lost to rounding. It is also farther than the cut-off radius from its own image, since at zero distance
the energy would be NaN.
"""


@compiled
def sort_into_stripes(stripes: Stripes, grains: int, reach: float) -> int:
    """Sort the grains into horizontal stripes, and by x within each; return the number of stripes."""
    y = stripes.built[1]
    low, high = y[0], y[0]
    for i in range(grains):
        low, high = min(low, y[i]), max(high, y[i])
    most = max(1, min(stripes.begins.size - 2, grains // MIN_PER_STRIPE))
    # With half the reach all partners lie in the stripe itself and the two above it.
    height = max(reach / (RANGES - 1), (high - low) / most)
    number = min(int((high - low) / height) + 1, most)
    _sort_into_equal_stripes(stripes, stripes.built[0], y, grains, low, height, number)
    return number


@compiled
def _sort_into_equal_stripes(
    stripes: Stripes, x: Array, y: Array, grains: int, low: float, height: float, number: int
) -> None:
    """Sort grains at the given positions into ``number`` stripes."""
    counts = np.zeros(number + 1, dtype=np.int64)
    for i in range(grains):
        stripes.stripe[i] = min(max(int((y[i] - low) / height), 0), number - 1)
        counts[stripes.stripe[i] + 1] += 1
    stripes.begins[0] = 0
    for k in range(number):
        stripes.begins[k + 1] = stripes.begins[k] + ((counts[k + 1] + 7) // WIDTH + 1) * WIDTH
        counts[k + 1] += counts[k]
    ends = counts[:number].copy()
    for i in range(grains):
        stripes.order[ends[stripes.stripe[i]]] = i
        ends[stripes.stripe[i]] += 1
    for slot in range(stripes.begins[number] + 2 * WIDTH):
        stripes.x[slot] = PADDING * (slot + 1.0)
        stripes.y[slot] = 0.0
    for k in range(number):
        chosen = stripes.order[counts[k] : counts[k + 1]]
        sort_indices_by_value(chosen, x)
        for c in range(chosen.size):
            stripes.slot[counts[k] + c] = stripes.begins[k] + c
            stripes.x[stripes.begins[k] + c] = x[chosen[c]]
            stripes.y[stripes.begins[k] + c] = y[chosen[c]]


@compiled
def sort_into_periodic_stripes(stripes: Stripes, grains: int, reach: float) -> int:
    """Sort grains of a periodic cell into equal stripes, by x within each; return the number of stripes."""
    periods, cell_offsets = stripes.periods, stripes.cell_offsets
    assert periods is not None
    assert cell_offsets is not None
    inside = np.empty((2, grains))
    for axis in range(2):
        for i in range(grains):
            index = stripes.built[axis, i]
            cell_offsets[axis, i] = periods[axis] * np.floor(index / periods[axis])
            inside[axis, i] = index - cell_offsets[axis, i]
    most = min(stripes.begins.size - 2, grains // MIN_PER_STRIPE)
    number = min(int(periods[1] * (RANGES - 1) / reach), most)
    _sort_into_equal_stripes(stripes, inside[0], inside[1], grains, 0.0, periods[1] / number, number)
    return number
