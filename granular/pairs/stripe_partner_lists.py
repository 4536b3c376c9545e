"""Lists of the runs of entries that hold the partners of a row of grains, in stripes.

The runs are listed for a reach that is longer than the radius by a skin. No pair can be missed
while no grain has moved by more than half the skin since; that is looked at before every sum, and
the runs are listed anew where one has. How many runs there are is known beforehand: there is no
list that could overflow. The skin grows or shrinks by how long the lists last.

In a periodic cell the partners have images on both sides, and those of the lowest stripes stand
above the highest ones: each run has a shift, by which its partners stand away from the positions
that they have within the cell. There are four stripes or more, and twice the reach is
less than the cell is wide and high, so that each pair is met once.
"""

from __future__ import annotations

import math

from granular.compiled import Array, compiled
from granular.pairs.cut_off_vector_loops import IMAGES, RANGES, ROWS
from granular.pairs.grain_arrays import GrainArrays
from granular.pairs.near_list import any_grain_moved, positions_are_finite, store_positions
from granular.pairs.simd import WIDTH
from granular.pairs.stripes import (
    BUILDS,
    CALLS,
    GRAINS,
    LISTED,
    PADDING,
    SKIN,
    STRIPES,
    Stripes,
    sort_into_periodic_stripes,
    sort_into_stripes,
)

_ROW_COST = 3
"""Cost of two rows besides their partners, in vectors of these."""

_FIRST_SKIN, _LEAST_SKIN, _MOST_SKIN = 0.05, 0.01, 0.5
_COST = 2.0
"""Cost of listing, in sums."""

_MOST_REACH = 0.4
"""Greatest reach over the shorter side of a periodic cell: five stripes are as high as two reaches."""


_RIGHT, _LEFT = 1, 2
"""Images in a periodic cell, by their place among the runs; 0 are the grains themselves."""


@compiled
def _list_partner_ranges(
    shifts: Array | None, periods: Array | None, stripes: Stripes, number: int, reach: float
) -> None:
    """List the runs of every two rows, and in a periodic cell their shifts; shifts, periods, reach [D]."""
    # No pair at the reach itself is lost to rounding.
    far = reach * (1.0 + 1e-12)
    for k in range(number):
        for up in range(RANGES):
            if shifts is None or periods is None:
                _list_ranges_of_stripe(stripes, k, min(k + up, number), up, up, 0.0, 0.0, far)
            else:
                rows = slice(stripes.begins[k] // ROWS, stripes.begins[k + 1] // ROWS)
                there, rise = (k + up) % number, periods[1] * ((k + up) // number)
                for image in range(IMAGES):
                    across, run = periods[0] * ((image == _RIGHT) - (image == _LEFT)), IMAGES * up + image
                    _list_ranges_of_stripe(stripes, k, there, up, run, across, rise, far)
                    shifts[rows, run, 0], shifts[rows, run, 1] = across, rise


@compiled
def _list_ranges_of_stripe(
    stripes: Stripes, k: int, there: int, up: int, run: int, across: float, rise: float, far: float
) -> None:
    """List the partners of a stripe's rows in itself or in one above, which may be none, or in an image."""
    x, y, partner_ranges = stripes.x, stripes.y, stripes.partner_ranges
    begin = stripes.begins[there]
    end, lowest = begin, math.inf
    while end < stripes.begins[there + 1] and x[end] < PADDING:
        lowest = min(lowest, y[end] + rise)
        end += 1
    start, stop = begin, begin
    for first in range(stripes.begins[k], stripes.begins[k + 1], ROWS):
        pair = first // ROWS
        partner_ranges[pair, run, 0] = partner_ranges[pair, run, 1] = 0
        # In its own stripe a grain meets those behind it, the images on the right among them.
        if x[first] < PADDING and not (up == 0 and across < 0.0):
            two = x[first + 1] < PADDING
            left, right = x[first] - across, (x[first + 1] if two else x[first]) - across
            apart = lowest - (max(y[first], y[first + 1]) if two else y[first])
            wide = far if up == 0 else math.sqrt(max(far * far - max(apart, 0.0) ** 2, 0.0))
            while start > begin and x[start - 1] >= left - wide:
                start -= 1
            while start < end and x[start] < left - wide:
                start += 1
            while stop > begin and x[stop - 1] > right + wide:
                stop -= 1
            while stop < end and x[stop] <= right + wide:
                stop += 1
            if apart < far or up == 0:
                # The seven behind the second row are met with it.
                partner_ranges[pair, run, 0] = first + 1 + WIDTH if up == 0 and across == 0.0 else start
                partner_ranges[pair, run, 1] = stop


@compiled(inline=True)
def _row_cost(stripes: Stripes, first: int) -> tuple[int, int, int]:
    """Cost of eight rows, in vectors of partners; their partners' entries: first, behind last."""
    cost, low, last = 0, first, first + 2 * WIDTH
    for pair in range(first // ROWS, (first + WIDTH) // ROWS):
        cost += _ROW_COST
        for run in range(stripes.partner_ranges.shape[1]):
            start, stop = stripes.partner_ranges[pair, run, 0], stripes.partner_ranges[pair, run, 1]
            if stop > start:
                vectors = (stop - start + WIDTH - 1) // WIDTH
                cost += vectors
                low, last = min(low, start), max(last, start + vectors * WIDTH)
    return cost, low // WIDTH * WIDTH, (last + WIDTH - 1) // WIDTH * WIDTH


@compiled
def _distribute_rows(stripes: Stripes, grains: int, end: int) -> None:
    """Deal the rows out to parts that take about equally long; they begin at whole vectors."""
    parts, total, done, part = stripes.ends.size, 0, 0, 0
    for first in range(0, end, WIDTH):
        total += _row_cost(stripes, first)[0]
    stripes.rows[:] = end
    stripes.rows[0] = 0
    stripes.lows[:] = end
    stripes.ends[:] = 0
    for first in range(0, end, WIDTH):
        cost, low, last = _row_cost(stripes, first)
        while part + 1 < parts and (2 * done + cost) * parts >= 2 * (part + 1) * total:
            part += 1
            stripes.rows[part] = first
        done += cost
        stripes.lows[part] = min(stripes.lows[part], low)
        stripes.ends[part] = max(stripes.ends[part], last)
    part = 0
    stripes.firsts[:] = grains
    for k in range(grains):
        while part <= parts and stripes.rows[part] <= stripes.slot[k]:
            stripes.firsts[part] = k
            part += 1


@compiled
def _sort_values_into_stripes(
    values: Array | None, sorted_values: Array | None, stripes: Stripes, grains: int
) -> None:
    if values is not None and sorted_values is not None:
        sorted_values[:] = 0.0
        for k in range(grains):
            sorted_values[stripes.slot[k]] = values[stripes.order[k]]


@compiled(inline=True)
def _list_partners(
    shifts: Array | None, stripes: Stripes, grains: int, arrays: GrainArrays, radius: float
) -> None:
    reach = radius + stripes.memory[SKIN]
    if shifts is None:
        number = sort_into_stripes(stripes, grains, reach)
    else:
        number = sort_into_periodic_stripes(stripes, grains, reach)
    _list_partner_ranges(shifts, stripes.periods, stripes, number, reach)
    _sort_values_into_stripes(arrays.moments, stripes.moments, stripes, grains)
    _sort_values_into_stripes(arrays.weight, stripes.weight, stripes, grains)
    _sort_values_into_stripes(arrays.shift, stripes.shift, stripes, grains)
    _distribute_rows(stripes, grains, stripes.begins[number])
    stripes.memory[LISTED] = 1.0
    stripes.memory[STRIPES] = number


@compiled
def _adapt_skin(memory: Array, radius: float) -> None:
    """Bring the skin nearer to where making lists costs as much as the partners in it."""
    if memory[SKIN] == 0.0:
        memory[SKIN] = _FIRST_SKIN * radius
    # A list costs `_COST` sums in CALLS, its pairs beyond the radius 2 skin/radius of a sum. CALLS grows as
    # the skin, so their total is least where both are equal.
    elif memory[CALLS] * memory[SKIN] < _COST * radius / 2.0:
        memory[SKIN] = min(1.25 * memory[SKIN], _MOST_SKIN * radius)
    else:
        memory[SKIN] = max(memory[SKIN] / 1.1, _LEAST_SKIN * radius)


@compiled(inline=True)
def _limit_skin(periods: Array | None, memory: Array, radius: float) -> None:
    if periods is not None:
        memory[SKIN] = min(memory[SKIN], _MOST_REACH * min(periods[0], periods[1]) - radius)


@compiled
def refresh_partner_lists(stripes: Stripes, arrays: GrainArrays, grains: int, radius: float) -> bool:
    """Hold all pairs within the radius [D]; list anew once a grain moved by half the skin (Verlet 1967)."""
    x, y = arrays.x, arrays.y
    farthest = 0.25 * stripes.memory[SKIN] * stripes.memory[SKIN] * (1.0 - 1e-9)
    if stripes.memory[GRAINS] != grains or any_grain_moved(stripes.built, x, y, grains, farthest):
        if not positions_are_finite(x, y, grains):
            return False
        _adapt_skin(stripes.memory, radius)
        _limit_skin(stripes.periods, stripes.memory, radius)
        store_positions(stripes.built, x, y, grains)
        stripes.memory[GRAINS] = grains
        stripes.memory[CALLS] = 0.0
        stripes.memory[BUILDS] += 1.0
        stripes.memory[LISTED] = 0.0
    if stripes.memory[LISTED] == 0.0:
        _list_partners(stripes.shifts, stripes, grains, arrays, radius)
    stripes.memory[CALLS] += 1.0
    return True
