"""Grains sorted into stripes, and by x within each."""

from __future__ import annotations

import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.lanes import WIDTH
from granular.pairs.runs import RUNS
from granular.pairs.stripes import LEAST_IN_STRIPE, Stripes

PADDING = 1e9
"""Place of the first of what is no grain [D]: farther than any grain, and so near that a period
still shifts it. It stands beyond the radius of its own image, too, whose energy is no number at
no distance."""


@compiled
def sort(stripes: Stripes, grains: int, reach: float) -> int:
    """Sort the grains into stripes by the places in ``built``; the number of stripes."""
    y = stripes.built[1]
    low, high = y[0], y[0]
    for i in range(grains):
        low, high = min(low, y[i]), max(high, y[i])
    most = max(1, min(stripes.begins.size - 2, grains // LEAST_IN_STRIPE))
    height = max(reach / (RUNS - 1), (high - low) / most)
    number = min(int((high - low) / height) + 1, most)
    _sort_into(stripes, stripes.built[0], y, grains, low, height, number)
    return number


@compiled
def _sort_into(
    stripes: Stripes, x: Array, y: Array, grains: int, low: float, height: float, number: int
) -> None:
    """Sort grains at those places into so many stripes."""
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
            stripes.y[stripes.begins[k] + c] = y[chosen[c]]


@compiled
def sort_around(stripes: Stripes, grains: int, reach: float) -> int:
    """`sort` in a periodic cell: the images within it, in stripes of one height."""
    periods, homes = stripes.periods, stripes.homes
    assert periods is not None
    assert homes is not None
    inside = np.empty((2, grains))
    for axis in range(2):
        for i in range(grains):
            place = stripes.built[axis, i]
            homes[axis, i] = periods[axis] * np.floor(place / periods[axis])
            inside[axis, i] = place - homes[axis, i]
    most = min(stripes.begins.size - 2, grains // LEAST_IN_STRIPE)
    number = min(int(periods[1] * (RUNS - 1) / reach), most)
    _sort_into(stripes, inside[0], inside[1], grains, 0.0, periods[1] / number, number)
    return number
