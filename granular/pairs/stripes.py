"""Pairs within a cut-off radius, at a cost linear in the number of grains.

Grains are sorted into horizontal stripes and, within a stripe, by x. The partners of a grain are
then a few runs of places that follow each other: the rest of its own stripe, and a part of each of
the two stripes above. They are met eight at a time and masked at the radius. Every stripe ends
with places so far away that a vector may run over its end.

The runs are listed for a reach that is longer than the radius by a skin. No pair can be missed
while no grain has moved by more than half the skin since; that is looked at before every sum, and
the runs are listed anew where one has. How many runs there are is known beforehand: there is no
list that could overflow. The skin grows or shrinks by how long the lists last.

The rows are dealt out to parts that take about equally long, each with sums of its own, which are
added in a fixed order: one thread or several give the same bits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from granular.compiled import Array, compiled
from granular.effects.dipole import STRENGTH
from granular.pairs.direct import PARTED_FROM, PARTS
from granular.pairs.inverse import SCALE
from granular.pairs.lanes import WIDTH, padded
from granular.pairs.plain import plain_cut_sum
from granular.pairs.rows import add_row, clear_row
from granular.pairs.runs import ROWS, RUNS, if_given, sweep_runs

PADDING = 1e70

_LEAST_IN_STRIPE = 8
"""Fewer grains a stripe are not worth one: stripes are made higher, and memory stays bounded."""

LISTED, GRAINS, SKIN, CALLS, BUILDS, STRIPES = range(6)
"""Entries of the memory: whether there are lists for the places that they were made at; for how
many grains; the skin [D]; sums since; how often lists were made; in how many stripes."""

_ROW_COST = 3
"""Of two rows besides their partners, in vectors of these."""

_FIRST_SKIN, _LEAST_SKIN, _MOST_SKIN = 0.05, 0.01, 0.5
_COST = 2.0
"""Of listing, in sums."""


class CutOff(NamedTuple):
    """Pairs end at a distance.

    Attributes
    ----------
    radius : float
        [D]
    moments : bool
        Whether the grains' moments differ.
    smooth : bool or None
        None where pairs just end; else the far part of their law is taken off, for a far field.
    """

    radius: float
    moments: bool
    smooth: bool | None


class Stripes(NamedTuple):
    """Grains in stripes, and the runs of partners.

    Attributes
    ----------
    x, y : float64 (s,)
        In the order of stripes, with far places between them.
    moments, weight : float64 (s,) or None
    fx, fy, stiffness, load : float64 (parts, s), the last one or None
        Sums of each part, where it has any.
    rows, firsts : int64 (parts + 1,)
        Where each part's rows begin, and which of the grains in ``order`` is the first in them.
    ends : int64 (parts,)
        Behind the last place that a part adds to.
    order, place : int64 (m,)
        The grains in that order, one after another, and where each of them stands there; before the
        first listing, as they come.
    stripe : int64 (m,)
        Scratch.
    begins : int64 (k,)
        Where each stripe begins; a multiple of the vector width.
    runs : int64 (s / 2, RUNS, 2)
        Where each run starts and stops.
    built : float64 (2, m)
        Places of the grains when the runs were listed. Part of a checkpoint, as ``memory`` is:
        the order of the sums depends on it.
    memory : float64 (6,)
        See `LISTED` and the others.
    """

    x: np.ndarray
    y: np.ndarray
    moments: np.ndarray | None
    weight: np.ndarray | None
    fx: np.ndarray
    fy: np.ndarray
    stiffness: np.ndarray
    load: np.ndarray | None
    rows: np.ndarray
    firsts: np.ndarray
    ends: np.ndarray
    place: np.ndarray
    order: np.ndarray
    stripe: np.ndarray
    begins: np.ndarray
    runs: np.ndarray
    built: np.ndarray
    memory: np.ndarray


def _most_stripes(size: int) -> int:
    return max(1, size // _LEAST_IN_STRIPE)


def stripes_room(size: int, *, moments: bool, loaded: bool) -> Stripes:
    """Room for that many grains (padded); linear in it."""
    most = _most_stripes(size)
    places = padded(size + 2 * WIDTH * most) + 2 * WIDTH
    parts = PARTS if size >= PARTED_FROM else 1
    return Stripes(
        x=np.zeros(places),
        y=np.zeros(places),
        moments=np.zeros(places) if moments else None,
        weight=np.zeros(places) if loaded else None,
        fx=np.zeros((parts, places)),
        fy=np.zeros((parts, places)),
        stiffness=np.zeros((parts, places)),
        load=np.zeros((parts, places)) if loaded else None,
        rows=np.zeros(parts + 1, dtype=np.int64),
        firsts=np.zeros(parts + 1, dtype=np.int64),
        ends=np.zeros(parts, dtype=np.int64),
        place=np.zeros(size, dtype=np.int64),
        order=np.arange(size),
        stripe=np.zeros(size, dtype=np.int64),
        begins=np.zeros(most + 2, dtype=np.int64),
        runs=np.zeros((places // ROWS, RUNS, 2), dtype=np.int64),
        built=np.zeros((2, size)),
        memory=np.zeros(6),
    )


@compiled
def _sort(stripes: Stripes, grains: int, reach: float) -> tuple[int, float]:
    """Sort the grains into stripes by the places in ``built``; number and height of stripes."""
    x, y = stripes.built[0], stripes.built[1]
    low, high = y[0], y[0]
    for i in range(grains):
        low, high = min(low, y[i]), max(high, y[i])
    most = max(1, min(stripes.begins.size - 2, grains // _LEAST_IN_STRIPE))
    height = max(reach / (RUNS - 1), (high - low) / most)
    number = min(int((high - low) / height) + 1, most)
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
        across = np.empty(chosen.size)
        for c in range(chosen.size):
            across[c] = x[chosen[c]]
        turns = np.argsort(across)
        for c in range(chosen.size):
            stripes.stripe[c] = chosen[turns[c]]
        for c in range(chosen.size):
            chosen[c] = stripes.stripe[c]
            stripes.place[counts[k] + c] = stripes.begins[k] + c
            stripes.x[stripes.begins[k] + c] = x[chosen[c]]
    return number, height


@compiled
def _list_runs(stripes: Stripes, number: int, height: float, reach: float) -> None:
    """List the runs of every two rows; both ends of a run move right only, from row to row."""
    x = stripes.x
    slack = 1.0 + 1e-12
    for k in range(number):
        begin, end = stripes.begins[k], stripes.begins[k + 1]
        for up in range(RUNS):
            apart = max(up - 1, 0) * height
            far = reach * slack
            wide = math.sqrt(max(far * far - apart * apart, 0.0))
            there = min(k + up, number)
            start, stop = stripes.begins[there], stripes.begins[there]
            last = stripes.begins[min(there + 1, number)]
            if apart >= far:
                last = start
            for first in range(begin, end, ROWS):
                if x[first] < PADDING:
                    right = x[first + 1] if x[first + 1] < PADDING else x[first]
                    while start < last and x[start] < x[first] - wide:
                        start += 1
                    while stop < last and x[stop] <= right + wide:
                        stop += 1
                    # The seven behind the second row are met with it.
                    stripes.runs[first // ROWS, up, 0] = first + 1 + WIDTH if up == 0 else start
                    stripes.runs[first // ROWS, up, 1] = stop
                else:
                    stripes.runs[first // ROWS, up, 0] = 0
                    stripes.runs[first // ROWS, up, 1] = 0


@compiled(inline=True)
def _row_cost(stripes: Stripes, first: int) -> tuple[int, int]:
    """Cost of eight rows, in vectors of partners; behind the last place that they meet."""
    cost, last = 0, first + 2 * WIDTH
    for pair in range(first // ROWS, (first + WIDTH) // ROWS):
        cost += _ROW_COST
        for run in range(RUNS):
            start, stop = stripes.runs[pair, run, 0], stripes.runs[pair, run, 1]
            if stop > start:
                vectors = (stop - start + WIDTH - 1) // WIDTH
                cost += vectors
                last = max(last, start + vectors * WIDTH)
    return cost, (last + WIDTH - 1) // WIDTH * WIDTH


@compiled
def _deal_rows(stripes: Stripes, grains: int, end: int) -> None:
    """Deal the rows out to parts that take about equally long; they begin at whole vectors."""
    parts, total, done, part = stripes.ends.size, 0, 0, 0
    for first in range(0, end, WIDTH):
        total += _row_cost(stripes, first)[0]
    stripes.rows[:] = end
    stripes.rows[0] = 0
    stripes.ends[:] = 0
    for first in range(0, end, WIDTH):
        cost, last = _row_cost(stripes, first)
        while part + 1 < parts and (2 * done + cost) * parts >= 2 * (part + 1) * total:
            part += 1
            stripes.rows[part] = first
        done += cost
        stripes.ends[part] = max(stripes.ends[part], last)
    part = 0
    stripes.firsts[:] = grains
    for k in range(grains):
        while part <= parts and stripes.rows[part] <= stripes.place[k]:
            stripes.firsts[part] = k
            part += 1


@compiled
def _put_values(stripes: Stripes, grains: int, moments: Array | None, weight: Array | None) -> None:
    if moments is not None and stripes.moments is not None:
        stripes.moments[:] = 0.0
        for k in range(grains):
            stripes.moments[stripes.place[k]] = moments[stripes.order[k]]
    if weight is not None and stripes.weight is not None:
        stripes.weight[:] = 0.0
        for k in range(grains):
            stripes.weight[stripes.place[k]] = weight[stripes.order[k]]


@compiled
def _list_partners(
    stripes: Stripes, grains: int, moments: Array | None, weight: Array | None, radius: float
) -> None:
    reach = radius + stripes.memory[SKIN]
    number, height = _sort(stripes, grains, reach)
    _list_runs(stripes, number, height, reach)
    _put_values(stripes, grains, moments, weight)
    _deal_rows(stripes, grains, stripes.begins[number])
    stripes.memory[LISTED] = 1.0
    stripes.memory[STRIPES] = number


@compiled
def _adapt_skin(memory: Array, radius: float) -> None:
    """Bring the skin nearer to where making lists costs as much as the partners in it."""
    if memory[SKIN] == 0.0:
        memory[SKIN] = _FIRST_SKIN * radius
    elif memory[CALLS] * memory[SKIN] < _COST * radius / 2.0:
        memory[SKIN] = min(1.25 * memory[SKIN], _MOST_SKIN * radius)
    else:
        memory[SKIN] = max(memory[SKIN] / 1.1, _LEAST_SKIN * radius)


@compiled
def _moved(stripes: Stripes, x: Array, y: Array, grains: int) -> bool:
    """Whether the lists may lack a pair."""
    if stripes.memory[GRAINS] != grains:
        return True
    most = 0.25 * stripes.memory[SKIN] * stripes.memory[SKIN] * (1.0 - 1e-9)
    moved = 0
    for i in range(grains):
        dx, dy = x[i] - stripes.built[0, i], y[i] - stripes.built[1, i]
        moved += not dx * dx + dy * dy <= most
    return moved > 0


@compiled
def finite(x: Array, y: Array, grains: int) -> bool:
    odd = 0
    for i in range(grains):
        odd += 0.0 * x[i] + 0.0 * y[i] != 0.0
    return odd == 0


@compiled
def _make_ready(
    stripes: Stripes, x: Array, y: Array, grains: int, moments: Array | None, weight: Array | None,
    radius: float,
) -> bool:  # fmt: skip
    """Make the lists hold every pair within the radius; False where a place is no number."""
    if _moved(stripes, x, y, grains):
        if not finite(x, y, grains):
            return False
        _adapt_skin(stripes.memory, radius)
        for i in range(grains):
            stripes.built[0, i] = x[i]
            stripes.built[1, i] = y[i]
        stripes.memory[GRAINS] = grains
        stripes.memory[CALLS] = 0.0
        stripes.memory[BUILDS] += 1.0
        stripes.memory[LISTED] = 0.0
    if stripes.memory[LISTED] == 0.0:
        _list_partners(stripes, grains, moments, weight, radius)
    stripes.memory[CALLS] += 1.0
    return True


class Asked(NamedTuple):
    """What a sum is asked for: where it reads the places, and what it fills.

    Attributes
    ----------
    x, y, fx, fy : float64 (m,)
    stiffness, load : float64 (m,) or None
    extremes : float64 (parts, 2) or None
        Of each part.
    """

    x: np.ndarray
    y: np.ndarray
    fx: np.ndarray
    fy: np.ndarray
    stiffness: np.ndarray | None
    load: np.ndarray | None
    extremes: np.ndarray | None


@compiled
def _place_part(stripes: Stripes, asked: Asked, part: int) -> None:
    """Put the grains of a part where they are now, and clear its sums."""
    for k in range(stripes.firsts[part], stripes.firsts[part + 1]):
        stripes.x[stripes.place[k]] = asked.x[stripes.order[k]]
        stripes.y[stripes.place[k]] = asked.y[stripes.order[k]]
    _clear(asked.fx, stripes.fx, stripes, part)
    _clear(asked.fy, stripes.fy, stripes, part)
    _clear(asked.stiffness, stripes.stiffness, stripes, part)
    _clear(asked.load, stripes.load, stripes, part)


@compiled(inline=True)
def _clear(asked: Array | None, sums: Array | None, stripes: Stripes, part: int) -> None:
    if asked is not None:
        _clear_part(sums, stripes, part)


@compiled(inline=True)
def _clear_part(sums: Array | None, stripes: Stripes, part: int) -> None:
    if sums is not None:
        clear_row(sums, part, stripes.rows[part], stripes.ends[part])


@compiled
def _sweep_part(
    stripes: Stripes, asked: Asked, part: int, radius: float, smooth: bool | None
) -> None:
    """Meet the partners of a part's rows."""
    sweep_runs(
        stripes.x, stripes.y, stripes.fx, stripes.fy, stripes.moments,
        if_given(asked.stiffness, stripes.stiffness), asked.extremes,
        if_given(asked.load, stripes.load), stripes.weight, stripes.runs,
        part, stripes.rows[part], stripes.rows[part + 1], radius, smooth,
    )  # fmt: skip


@compiled(inline=True)
def _join(sums: Array, stripes: Stripes, part: int) -> None:
    """Add to a part's sums what the parts before it have for its rows."""
    for other in range(part):
        end = min(stripes.ends[other], stripes.rows[part + 1])
        add_row(sums, part, other, stripes.rows[part], end)


@compiled(inline=True)
def _collect(
    out: Array | None, sums: Array | None, scale: float, stripes: Stripes, part: int
) -> None:
    """Give the grains of a part their sums, where they are asked for."""
    if out is not None:
        _give(out, sums, scale, stripes, part)


@compiled
def _give(out: Array, sums: Array | None, scale: float, stripes: Stripes, part: int) -> None:
    if sums is not None:
        _join(sums, stripes, part)
        for k in range(stripes.firsts[part], stripes.firsts[part + 1]):
            out[stripes.order[k]] = scale * sums[part, stripes.place[k]]


@compiled
def _collect_part(stripes: Stripes, asked: Asked, part: int) -> None:
    _collect(asked.fx, stripes.fx, STRENGTH * SCALE, stripes, part)
    _collect(asked.fy, stripes.fy, STRENGTH * SCALE, stripes, part)
    _collect(asked.stiffness, stripes.stiffness, SCALE, stripes, part)
    _collect(asked.load, stripes.load, SCALE, stripes, part)


@compiled
def _sum_parts(stripes: Stripes, asked: Asked, radius: float, smooth: bool | None) -> None:
    parts = stripes.ends.size
    for part in range(parts):
        _place_part(stripes, asked, part)
    for part in range(parts):
        _sweep_part(stripes, asked, part, radius, smooth)
    for part in range(parts):
        _collect_part(stripes, asked, part)


# A kernel each: Numba runs two loops as one where it sees nothing that the second takes from the
# first, and it does not look into the kernels that they call.


@compiled(parallel=True)
def _place_threaded(stripes: Stripes, asked: Asked) -> None:
    for part in numba.prange(stripes.ends.size):
        _place_part(stripes, asked, part)


@compiled(parallel=True)
def _sweep_threaded(stripes: Stripes, asked: Asked, radius: float, smooth: bool | None) -> None:
    for part in numba.prange(stripes.ends.size):
        _sweep_part(stripes, asked, part, radius, smooth)


@compiled(parallel=True)
def _collect_threaded(stripes: Stripes, asked: Asked) -> None:
    for part in numba.prange(stripes.ends.size):
        _collect_part(stripes, asked, part)


@compiled
def _sum_all(
    threaded: bool | None, stripes: Stripes, asked: Asked, radius: float, smooth: bool | None
) -> None:
    if threaded is None:
        _sum_parts(stripes, asked, radius, smooth)
    else:
        _place_threaded(stripes, asked)
        _sweep_threaded(stripes, asked, radius, smooth)
        _collect_threaded(stripes, asked)


@compiled
def _cut_sum(
    stripes: Stripes, radius: float, smooth: bool | None, threaded: bool | None, grains: int,
    x: Array, y: Array, fx: Array, fy: Array, moments: Array | None, stiffness: Array | None,
    extremes: Array | None, load: Array | None, weight: Array | None,
) -> None:  # fmt: skip
    if not _make_ready(stripes, x, y, grains, moments, weight, radius):
        fx[:grains] = np.nan
        fy[:grains] = np.nan
        return
    if extremes is None:
        asked = Asked(x, y, fx, fy, stiffness, load, None)
        _sum_all(threaded, stripes, asked, radius, smooth)
    else:
        parts = np.zeros((stripes.ends.size, 2))
        measured = Asked(x, y, fx, fy, stiffness, load, parts)
        _sum_all(threaded, stripes, measured, radius, smooth)
        extremes[:] = 0.0
        for part in range(len(parts)):
            extremes[0] += SCALE * parts[part, 0]
            extremes[1] = max(extremes[1], SCALE * parts[part, 1])


cut_sum = plain_cut_sum if numba.config.DISABLE_JIT else _cut_sum
"""Pair forces within a radius, and what else is asked for in the same pass.

Parameters
----------
stripes : Stripes
radius : float
    Cut-off radius [D]. The energy of a pair is taken as zero there.
smooth : bool or None
    As in `CutOff`.
threaded : bool or None
    None sweeps the stripes one after another, anything else on Numba's threads.
grains : int
x, y, fx, fy, moments, stiffness, extremes, load, weight
    As in `granular.pairs.direct.direct_sum`.
"""
