"""Pairs within a cut-off radius, at a cost linear in the number of grains.

Grains are sorted into horizontal stripes and, within a stripe, by x. The partners of a grain are
then a few runs of places that follow each other: the rest of its own stripe, and a part of each of
the three stripes above. They are met eight at a time and masked at the radius. Every stripe ends
with places so far away that a vector may run over its end.

The runs are listed for a reach that is longer than the radius by a skin. No pair can be missed
while no grain has moved by more than half the skin since; that is looked at before every sum, and
the runs are listed anew where one has. How many runs there are is known beforehand: there is no
list that could overflow. The skin grows or shrinks by how long the lists last.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from granular.compiled import Array, compiled
from granular.effects.dipole import STRENGTH
from granular.pairs.inverse import SCALE
from granular.pairs.lanes import WIDTH, padded
from granular.pairs.plain import plain_cut_sum
from granular.pairs.runs import ROWS, RUNS, sweep_runs

PADDING = 1e70

_LEAST_IN_STRIPE = 8
"""Fewer grains a stripe are not worth one: stripes are made higher, and memory stays bounded."""

LISTED, GRAINS, SKIN, CALLS, BUILDS, STRIPES = range(6)
"""Entries of the memory: whether there are lists for the places that they were made at; for how
many grains; the skin [D]; sums since; how often lists were made; in how many stripes."""

_TOGETHER = RUNS
"""Stripes swept together. They push grains in the next three at most, so every second group can be
swept at the same time as the others of its kind."""

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
    x, y, fx, fy : float64 (s,)
        In the order of stripes, with far places between them.
    moments, weight, load, stiffness : float64 (s,) or None
    place : int64 (m,)
        Where each grain stands in that order.
    order, stripe : int64 (m,)
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
    fx: np.ndarray
    fy: np.ndarray
    moments: np.ndarray | None
    weight: np.ndarray | None
    load: np.ndarray | None
    stiffness: np.ndarray
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
    zeros = np.zeros(places)
    return Stripes(
        x=zeros.copy(),
        y=zeros.copy(),
        fx=zeros.copy(),
        fy=zeros.copy(),
        moments=zeros.copy() if moments else None,
        weight=zeros.copy() if loaded else None,
        load=zeros.copy() if loaded else None,
        stiffness=zeros.copy(),
        place=np.zeros(size, dtype=np.int64),
        order=np.zeros(size, dtype=np.int64),
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
            stripes.place[chosen[turns[c]]] = stripes.begins[k] + c
            stripes.x[stripes.begins[k] + c] = across[turns[c]]
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


@compiled
def _put_values(stripes: Stripes, grains: int, moments: Array | None, weight: Array | None) -> None:
    if moments is not None and stripes.moments is not None:
        stripes.moments[:] = 0.0
        for i in range(grains):
            stripes.moments[stripes.place[i]] = moments[i]
    if weight is not None and stripes.weight is not None:
        stripes.weight[:] = 0.0
        for i in range(grains):
            stripes.weight[stripes.place[i]] = weight[i]


@compiled
def _list_partners(
    stripes: Stripes, grains: int, moments: Array | None, weight: Array | None, radius: float
) -> None:
    reach = radius + stripes.memory[SKIN]
    number, height = _sort(stripes, grains, reach)
    _list_runs(stripes, number, height, reach)
    _put_values(stripes, grains, moments, weight)
    stripes.begins[stripes.begins.size - 1] = stripes.begins[number]
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
    total = 0.0
    for i in range(grains):
        total += 0.0 * x[i] + 0.0 * y[i]
    return total == 0.0


@compiled
def _make_ready(
    stripes: Stripes, x: Array, y: Array, grains: int, moments: Array | None, weight: Array | None,
    radius: float,
) -> None:  # fmt: skip
    """Make the lists hold every pair within the radius."""
    if _moved(stripes, x, y, grains):
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


@compiled
def _sweep_group(
    stripes: Stripes, sums: Array | None, parts: Array | None, load: Array | None, group: int,
    radius: float, smooth: bool | None,
) -> None:  # fmt: skip
    first = stripes.begins[group * _TOGETHER]
    end = stripes.begins[min((group + 1) * _TOGETHER, int(stripes.memory[STRIPES]))]
    if parts is None:
        sweep_runs(
            stripes.x, stripes.y, stripes.fx, stripes.fy, stripes.moments, sums, None, load,
            stripes.weight, stripes.runs, first, end, radius, smooth,
        )  # fmt: skip
    else:
        sweep_runs(
            stripes.x, stripes.y, stripes.fx, stripes.fy, stripes.moments, sums, parts[group], load,
            stripes.weight, stripes.runs, first, end, radius, smooth,
        )  # fmt: skip


@compiled
def _sweep_groups(
    stripes: Stripes, sums: Array | None, parts: Array | None, load: Array | None, groups: int,
    radius: float, smooth: bool | None,
) -> None:  # fmt: skip
    for odd in range(2):
        for half in range((groups + 1 - odd) // 2):
            _sweep_group(stripes, sums, parts, load, 2 * half + odd, radius, smooth)


@compiled(parallel=True)
def _sweep_groups_threaded(
    stripes: Stripes, sums: Array | None, parts: Array | None, load: Array | None, groups: int,
    radius: float, smooth: bool | None,
) -> None:  # fmt: skip
    for odd in range(2):
        for half in numba.prange((groups + 1 - odd) // 2):
            _sweep_group(stripes, sums, parts, load, 2 * half + odd, radius, smooth)


@compiled
def _sweep_all(
    threaded: bool | None, stripes: Stripes, sums: Array | None, parts: Array | None,
    load: Array | None, groups: int, radius: float, smooth: bool | None,
) -> None:  # fmt: skip
    """Sweep all groups, every second one first: each grain's sum has one order on any threads."""
    if threaded is None:
        _sweep_groups(stripes, sums, parts, load, groups, radius, smooth)
    else:
        _sweep_groups_threaded(stripes, sums, parts, load, groups, radius, smooth)


@compiled
def _sweep(
    threaded: bool | None, stripes: Stripes, sums: Array | None, extremes: Array | None,
    load: Array | None, radius: float, smooth: bool | None,
) -> None:  # fmt: skip
    groups = (int(stripes.memory[STRIPES]) + _TOGETHER - 1) // _TOGETHER
    if extremes is None:
        _sweep_all(threaded, stripes, sums, None, load, groups, radius, smooth)
    else:
        parts = np.zeros((groups, 2))
        _sweep_all(threaded, stripes, sums, parts, load, groups, radius, smooth)
        extremes[:] = 0.0
        for group in range(groups):
            extremes[0] += parts[group, 0]
            extremes[1] = max(extremes[1], parts[group, 1])


@compiled
def _cut_sum(
    stripes: Stripes, radius: float, smooth: bool | None, threaded: bool | None, grains: int,
    x: Array, y: Array, fx: Array, fy: Array, moments: Array | None, stiffness: Array | None,
    extremes: Array | None, load: Array | None, weight: Array | None,
) -> None:  # fmt: skip
    if not finite(x, y, grains):
        fx[:grains] = np.nan
        fy[:grains] = np.nan
        return
    _make_ready(stripes, x, y, grains, moments, weight, radius)
    end = stripes.begins[stripes.begins.size - 1]
    for i in range(grains):
        stripes.x[stripes.place[i]] = x[i]
        stripes.y[stripes.place[i]] = y[i]
    stripes.fx[: end + WIDTH] = 0.0
    stripes.fy[: end + WIDTH] = 0.0
    sums = stiffness
    if stiffness is not None:
        stripes.stiffness[: end + WIDTH] = 0.0
        sums = stripes.stiffness
    if load is not None and stripes.load is not None:
        stripes.load[: end + WIDTH] = 0.0
    _sweep(threaded, stripes, sums, extremes, stripes.load, radius, smooth)
    for i in range(grains):
        fx[i] = STRENGTH * SCALE * stripes.fx[stripes.place[i]]
        fy[i] = STRENGTH * SCALE * stripes.fy[stripes.place[i]]
    if stiffness is not None:
        for i in range(grains):
            stiffness[i] = SCALE * stripes.stiffness[stripes.place[i]]
    if load is not None and stripes.load is not None:
        for i in range(grains):
            load[i] = SCALE * stripes.load[stripes.place[i]]
    if extremes is not None:
        extremes *= SCALE


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
