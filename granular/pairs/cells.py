"""Pairs of grains closer than a distance, found with a grid of cells."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled

PLACES_A_GRAIN = 16
"""Room for close pairs, per grain. Discs of one size have at most three each; more fit only where
small ones crowd about a big one."""


class ClosePairs(NamedTuple):
    """Close pairs, and the grid's scratch.

    Attributes
    ----------
    first, second : int64 (p,)
    filled : int64 (1,)
        How many are filled; -1 where there was no room, or a place is no number.
    cell, order : int64 (n,)
        Cell of each grain, and the grains in the order of cells.
    begins : int64 (c,)
        Where each cell's grains begin in ``order``; grown when it is too short.
    """

    first: np.ndarray
    second: np.ndarray
    filled: np.ndarray
    cell: np.ndarray
    order: np.ndarray
    begins: np.ndarray


def close_pairs_room(count: int) -> ClosePairs:
    """Room for the pairs of that many grains; about one cell a grain."""
    places = PLACES_A_GRAIN * max(count, 1)
    return ClosePairs(
        first=np.zeros(places, dtype=np.int64),
        second=np.zeros(places, dtype=np.int64),
        filled=np.zeros(1, dtype=np.int64),
        cell=np.zeros(max(count, 1), dtype=np.int64),
        order=np.zeros(max(count, 1), dtype=np.int64),
        begins=np.zeros(4 * max(count, 1) + 64, dtype=np.int64),
    )


@compiled
def _grid(
    x: Array, y: Array, count: int, reach: float, most: int
) -> tuple[float, float, float, int, int]:
    """Origin, size and numbers of cells that cover the grains, with at most ``most`` cells."""
    left, right, low, high = x[0], x[0], y[0], y[0]
    for i in range(count):
        left, right = min(left, x[i]), max(right, x[i])
        low, high = min(low, y[i]), max(high, y[i])
    # In floating-point numbers: the product of far more cells than there is room for overflows.
    size = reach
    columns, rows = np.floor((right - left) / size) + 1.0, np.floor((high - low) / size) + 1.0
    while columns * rows > most and size < np.inf:
        size *= 1.5
        columns, rows = np.floor((right - left) / size) + 1.0, np.floor((high - low) / size) + 1.0
    if not columns * rows <= most:  # a place is no number
        return left, low, reach, 1, 1
    return left, low, size, int(columns), int(rows)


@compiled
def _pair_up(
    room: ClosePairs, x: Array, y: Array, i: int, cell: int, reach: float, own: bool
) -> None:
    for place in range(room.begins[cell], room.begins[cell + 1]):
        j = room.order[place]
        if own and j <= i:
            continue
        dx, dy = x[i] - x[j], y[i] - y[j]
        if dx * dx + dy * dy < reach * reach and room.filled[0] >= 0:
            if room.filled[0] == room.first.size:
                room.filled[0] = -1
                return
            room.first[room.filled[0]] = i
            room.second[room.filled[0]] = j
            room.filled[0] += 1


@compiled
def find_close_pairs(room: ClosePairs, x: Array, y: Array, count: int, reach: float) -> None:
    """Fill ``room`` with the pairs closer than ``reach`` [D]; the positions fix their order."""
    room.filled[0] = 0
    if count < 2:
        return
    left, low, size, columns, rows = _grid(x, y, count, reach, room.begins.size - 2)
    room.begins[: columns * rows + 1] = 0
    for i in range(count):
        across, up = (x[i] - left) / size, (y[i] - low) / size
        if not (0.0 <= across < columns and 0.0 <= up < rows):
            room.filled[0] = -1  # a place that is no number has no cell
            return
        room.cell[i] = int(up) * columns + int(across)
        room.begins[room.cell[i] + 1] += 1
    for cell in range(columns * rows):
        room.begins[cell + 1] += room.begins[cell]
    for i in range(count - 1, -1, -1):
        # Filling from the back moves each end down to its beginning.
        room.begins[room.cell[i] + 1] -= 1
        room.order[room.begins[room.cell[i] + 1]] = i
    # begins[c + 1] is now where cell c begins.
    for cell in range(columns * rows):
        room.begins[cell] = room.begins[cell + 1]
    room.begins[columns * rows] = count
    for i in range(count):
        column, row = room.cell[i] % columns, room.cell[i] // columns
        _pair_up(room, x, y, i, room.cell[i], reach, True)
        if column + 1 < columns:
            _pair_up(room, x, y, i, room.cell[i] + 1, reach, False)
        if row + 1 < rows:
            for beside in range(max(column - 1, 0), min(column + 2, columns)):
                _pair_up(room, x, y, i, (row + 1) * columns + beside, reach, False)
