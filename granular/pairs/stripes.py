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
    charged : bool
        Whether the grains' moments differ.
    smooth : bool or None
        None where pairs just end; else the far part of their law is taken off, for a far field.
    """

    radius: float
    charged: bool
    smooth: bool | None


class Stripes(NamedTuple):
    """Grains in stripes, and the runs of partners.

    Attributes
    ----------
    x, y, fx, fy : float64 (s,)
        In the order of stripes, with far places between them.
    charge, weight, load, stiffness : float64 (s,) or None
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
    charge: np.ndarray | None
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


def stripes_room(size: int, *, charged: bool, loaded: bool) -> Stripes:
    """Room for that many grains (padded); linear in it."""
    most = _most_stripes(size)
    places = padded(size + 2 * WIDTH * most) + 2 * WIDTH
    zeros = np.zeros(places)
    return Stripes(
        x=zeros.copy(),
        y=zeros.copy(),
        fx=zeros.copy(),
        fy=zeros.copy(),
        charge=zeros.copy() if charged else None,
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
def _sort(near: Stripes, grains: int, reach: float) -> tuple[int, float]:
    """Put the grains into stripes, from where they were ``built``: how many, and how high."""
    x, y = near.built[0], near.built[1]
    low, high = y[0], y[0]
    for i in range(grains):
        low, high = min(low, y[i]), max(high, y[i])
    most = max(1, min(near.begins.size - 2, grains // _LEAST_IN_STRIPE))
    height = max(reach / (RUNS - 1), (high - low) / most)
    stripes = min(int((high - low) / height) + 1, most)
    counts = np.zeros(stripes + 1, dtype=np.int64)
    for i in range(grains):
        near.stripe[i] = min(max(int((y[i] - low) / height), 0), stripes - 1)
        counts[near.stripe[i] + 1] += 1
    near.begins[0] = 0
    for k in range(stripes):
        near.begins[k + 1] = near.begins[k] + ((counts[k + 1] + 7) // WIDTH + 1) * WIDTH
        counts[k + 1] += counts[k]
    ends = counts[:stripes].copy()
    for i in range(grains):
        near.order[ends[near.stripe[i]]] = i
        ends[near.stripe[i]] += 1
    for slot in range(near.begins[stripes] + 2 * WIDTH):
        near.x[slot] = PADDING * (slot + 1.0)
        near.y[slot] = 0.0
    for k in range(stripes):
        chosen = near.order[counts[k] : counts[k + 1]]
        across = np.empty(chosen.size)
        for c in range(chosen.size):
            across[c] = x[chosen[c]]
        turns = np.argsort(across)
        for c in range(chosen.size):
            near.place[chosen[turns[c]]] = near.begins[k] + c
            near.x[near.begins[k] + c] = across[turns[c]]
    return stripes, height


@compiled
def _list_runs(near: Stripes, stripes: int, height: float, reach: float) -> None:
    """The runs of every two rows; places go on to the right, so each end moves one way only."""
    x = near.x
    slack = 1.0 + 1e-12
    for k in range(stripes):
        begin, end = near.begins[k], near.begins[k + 1]
        for up in range(RUNS):
            apart = max(up - 1, 0) * height
            far = reach * slack
            wide = math.sqrt(max(far * far - apart * apart, 0.0))
            there = min(k + up, stripes)
            start, stop = near.begins[there], near.begins[there]
            last = near.begins[min(there + 1, stripes)]
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
                    near.runs[first // ROWS, up, 0] = first + 1 + WIDTH if up == 0 else start
                    near.runs[first // ROWS, up, 1] = stop
                else:
                    near.runs[first // ROWS, up, 0] = 0
                    near.runs[first // ROWS, up, 1] = 0


@compiled
def _put_values(near: Stripes, grains: int, charge: Array | None, weight: Array | None) -> None:
    if charge is not None and near.charge is not None:
        near.charge[:] = 0.0
        for i in range(grains):
            near.charge[near.place[i]] = charge[i]
    if weight is not None and near.weight is not None:
        near.weight[:] = 0.0
        for i in range(grains):
            near.weight[near.place[i]] = weight[i]


@compiled
def _list_partners(
    near: Stripes, grains: int, charge: Array | None, weight: Array | None, radius: float
) -> None:
    reach = radius + near.memory[SKIN]
    stripes, height = _sort(near, grains, reach)
    _list_runs(near, stripes, height, reach)
    _put_values(near, grains, charge, weight)
    near.begins[near.begins.size - 1] = near.begins[stripes]
    near.memory[LISTED] = 1.0
    near.memory[STRIPES] = stripes


@compiled
def _adapt_skin(memory: Array, radius: float) -> None:
    """Nearer to where listing costs as much as the partners in the skin."""
    if memory[SKIN] == 0.0:
        memory[SKIN] = _FIRST_SKIN * radius
    elif memory[CALLS] * memory[SKIN] < _COST * radius / 2.0:
        memory[SKIN] = min(1.25 * memory[SKIN], _MOST_SKIN * radius)
    else:
        memory[SKIN] = max(memory[SKIN] / 1.1, _LEAST_SKIN * radius)


@compiled
def _moved(near: Stripes, x: Array, y: Array, grains: int) -> bool:
    """Whether the lists may lack a pair."""
    if near.memory[GRAINS] != grains:
        return True
    most = 0.25 * near.memory[SKIN] * near.memory[SKIN] * (1.0 - 1e-9)
    moved = 0
    for i in range(grains):
        dx, dy = x[i] - near.built[0, i], y[i] - near.built[1, i]
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
    near: Stripes, x: Array, y: Array, grains: int, charge: Array | None, weight: Array | None,
    radius: float,
) -> None:  # fmt: skip
    """Lists that hold every pair within the radius."""
    if _moved(near, x, y, grains):
        _adapt_skin(near.memory, radius)
        for i in range(grains):
            near.built[0, i] = x[i]
            near.built[1, i] = y[i]
        near.memory[GRAINS] = grains
        near.memory[CALLS] = 0.0
        near.memory[BUILDS] += 1.0
        near.memory[LISTED] = 0.0
    if near.memory[LISTED] == 0.0:
        _list_partners(near, grains, charge, weight, radius)
    near.memory[CALLS] += 1.0


@compiled
def _sweep_group(
    near: Stripes, sums: Array | None, parts: Array | None, load: Array | None, group: int,
    radius: float, smooth: bool | None,
) -> None:  # fmt: skip
    first = near.begins[group * _TOGETHER]
    end = near.begins[min((group + 1) * _TOGETHER, int(near.memory[STRIPES]))]
    if parts is None:
        sweep_runs(
            near.x, near.y, near.fx, near.fy, near.charge, sums, None, load, near.weight,
            near.runs, first, end, radius, smooth,
        )  # fmt: skip
    else:
        sweep_runs(
            near.x, near.y, near.fx, near.fy, near.charge, sums, parts[group], load, near.weight,
            near.runs, first, end, radius, smooth,
        )  # fmt: skip


@compiled
def _sweep_groups(
    near: Stripes, sums: Array | None, parts: Array | None, load: Array | None, groups: int,
    radius: float, smooth: bool | None,
) -> None:  # fmt: skip
    for odd in range(2):
        for half in range((groups + 1 - odd) // 2):
            _sweep_group(near, sums, parts, load, 2 * half + odd, radius, smooth)


@compiled(parallel=True)
def _sweep_groups_threaded(
    near: Stripes, sums: Array | None, parts: Array | None, load: Array | None, groups: int,
    radius: float, smooth: bool | None,
) -> None:  # fmt: skip
    for odd in range(2):
        for half in numba.prange((groups + 1 - odd) // 2):
            _sweep_group(near, sums, parts, load, 2 * half + odd, radius, smooth)


@compiled
def _sweep_all(
    threaded: bool | None, near: Stripes, sums: Array | None, parts: Array | None,
    load: Array | None, groups: int, radius: float, smooth: bool | None,
) -> None:  # fmt: skip
    """All groups, every second one first: each place adds up in one order on any threads."""
    if threaded is None:
        _sweep_groups(near, sums, parts, load, groups, radius, smooth)
    else:
        _sweep_groups_threaded(near, sums, parts, load, groups, radius, smooth)


@compiled
def _sweep(
    threaded: bool | None, near: Stripes, sums: Array | None, extremes: Array | None,
    load: Array | None, radius: float, smooth: bool | None,
) -> None:  # fmt: skip
    groups = (int(near.memory[STRIPES]) + _TOGETHER - 1) // _TOGETHER
    if extremes is None:
        _sweep_all(threaded, near, sums, None, load, groups, radius, smooth)
    else:
        parts = np.zeros((groups, 2))
        _sweep_all(threaded, near, sums, parts, load, groups, radius, smooth)
        extremes[:] = 0.0
        for group in range(groups):
            extremes[0] += parts[group, 0]
            extremes[1] = max(extremes[1], parts[group, 1])


@compiled
def _cut_sum(
    near: Stripes, radius: float, smooth: bool | None, threaded: bool | None, grains: int,
    x: Array, y: Array, fx: Array, fy: Array, charge: Array | None, stiffness: Array | None,
    extremes: Array | None, load: Array | None, weight: Array | None,
) -> None:  # fmt: skip
    if not finite(x, y, grains):
        fx[:grains] = np.nan
        fy[:grains] = np.nan
        return
    _make_ready(near, x, y, grains, charge, weight, radius)
    end = near.begins[near.begins.size - 1]
    for i in range(grains):
        near.x[near.place[i]] = x[i]
        near.y[near.place[i]] = y[i]
    near.fx[: end + WIDTH] = 0.0
    near.fy[: end + WIDTH] = 0.0
    sums = stiffness
    if stiffness is not None:
        near.stiffness[: end + WIDTH] = 0.0
        sums = near.stiffness
    if load is not None and near.load is not None:
        near.load[: end + WIDTH] = 0.0
    _sweep(threaded, near, sums, extremes, near.load, radius, smooth)
    for i in range(grains):
        fx[i] = STRENGTH * SCALE * near.fx[near.place[i]]
        fy[i] = STRENGTH * SCALE * near.fy[near.place[i]]
    if stiffness is not None:
        for i in range(grains):
            stiffness[i] = SCALE * near.stiffness[near.place[i]]
    if load is not None and near.load is not None:
        for i in range(grains):
            load[i] = SCALE * near.load[near.place[i]]
    if extremes is not None:
        extremes *= SCALE


cut_sum = plain_cut_sum if numba.config.DISABLE_JIT else _cut_sum
"""Pair forces within a radius, and what else is asked for in the same pass.

Parameters
----------
near : Stripes
radius : float
    Cut-off radius [D]. The energy of a pair is taken as zero there.
smooth : bool or None
    As in `CutOff`.
threaded : bool or None
    None sweeps the stripes one after another, anything else on Numba's threads.
grains : int
x, y, fx, fy, charge, stiffness, extremes, load, weight
    As in `granular.pairs.direct.direct_sum`.
"""
