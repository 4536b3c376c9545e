"""Pairs of grains closer than a distance, by a grid of cells."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.compiled import Array, compiled

if TYPE_CHECKING:
    from jaxtyping import Float, Int

PLACES_A_GRAIN = 16
"""Entries for close pairs, per grain: overlapping discs of any sizes have about three each."""


class CellList(NamedTuple):
    """Grains in the cells of a grid, and the partners of one grain: always long enough."""

    partners: Int[np.ndarray, "n"]  # of the grain of the last search
    cell: Int[np.ndarray, "n"]  # cell of each grain
    order: Int[np.ndarray, "n"]  # grains in the order of cells
    begins: Int[np.ndarray, "c"]  # index in ``order`` at which each cell begins
    shape: Int[np.ndarray, "2"]  # columns, rows


class ClosePairs(NamedTuple):
    """Close pairs, and the cells for their search."""

    first: Int[np.ndarray, "p"]
    second: Int[np.ndarray, "p"]
    filled: Int[np.ndarray, "1"]  # number of pairs; -1: no room, or a position is NaN
    cells: CellList


def cell_list_workspace(count: int) -> CellList:
    """Allocate a cell list for that many grains, with up to four cells a grain."""
    size = max(count, 1)
    return CellList(
        partners=np.zeros(size, dtype=np.int64),
        cell=np.zeros(size, dtype=np.int64),
        order=np.zeros(size, dtype=np.int64),
        begins=np.zeros(4 * size + 64, dtype=np.int64),
        shape=np.zeros(2, dtype=np.int64),
    )


def close_pairs_workspace(count: int, capacity: int, kind: type = np.int64) -> ClosePairs:
    """Allocate arrays for close pairs, and the cell list that finds them."""
    capacity = max(1, min(count * (count - 1) // 2, capacity))
    return ClosePairs(
        first=np.zeros(capacity, dtype=kind),
        second=np.zeros(capacity, dtype=kind),
        filled=np.zeros(1, dtype=np.int64),
        cells=cell_list_workspace(count),
    )


@compiled
def _grid_that_covers(
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
def sort_into_cells(
    cells: CellList, x: Float[Array, "m"], y: Float[Array, "m"], count: int, reach: float
) -> bool:
    """Sort grains into cells at least reach [D] wide, by counting (Allen and Tildesley 1987, 5.3.2)."""
    if count == 0:
        return True
    left, low, size, columns, rows = _grid_that_covers(x, y, count, reach, cells.begins.size - 2)
    cells.shape[0], cells.shape[1] = columns, rows
    cells.begins[: columns * rows + 1] = 0
    for i in range(count):
        across, up = (x[i] - left) / size, (y[i] - low) / size
        if not (0.0 <= across < columns and 0.0 <= up < rows):
            return False  # a place that is no number has no cell
        cells.cell[i] = int(up) * columns + int(across)
        cells.begins[cells.cell[i] + 1] += 1
    for cell in range(columns * rows):
        cells.begins[cell + 1] += cells.begins[cell]
    for i in range(count - 1, -1, -1):
        # Filling from the back moves each end down to its beginning.
        cells.begins[cells.cell[i] + 1] -= 1
        cells.order[cells.begins[cells.cell[i] + 1]] = i
    # begins[c + 1] is now where cell c begins.
    for cell in range(columns * rows):
        cells.begins[cell] = cells.begins[cell + 1]
    cells.begins[columns * rows] = count
    return True


@compiled
def _find_partners_in_cell(
    cells: CellList, x: Array, y: Array, i: int, cell: int, reach: float, result: int
) -> int:
    for index in range(cells.begins[cell], cells.begins[cell + 1]):
        j = cells.order[index]
        if cell == cells.cell[i] and j <= i:
            continue
        dx, dy = x[i] - x[j], y[i] - y[j]
        if dx * dx + dy * dy < reach * reach:
            cells.partners[result] = j
            result += 1
    return result


@compiled
def find_partners_of_grain(
    cells: CellList, x: Float[Array, "m"], y: Float[Array, "m"], i: int, reach: float
) -> int:
    """Fill ``cells.partners`` with the grains within reach [D]; each pair is met from one end only."""
    columns, rows = cells.shape[0], cells.shape[1]
    column, row = cells.cell[i] % columns, cells.cell[i] // columns
    result = _find_partners_in_cell(cells, x, y, i, cells.cell[i], reach, 0)
    if column + 1 < columns:
        result = _find_partners_in_cell(cells, x, y, i, cells.cell[i] + 1, reach, result)
    if row + 1 < rows:
        for adjacent in range(max(column - 1, 0), min(column + 2, columns)):
            result = _find_partners_in_cell(cells, x, y, i, (row + 1) * columns + adjacent, reach, result)
    return result


@compiled
def find_close_pairs(
    pairs: ClosePairs,
    x: Float[Array, "m"],
    y: Float[Array, "m"],
    count: int,
    reach: float,
    radius: Float[Array, "m"] | None,
) -> None:
    """Fill ``pairs`` with the pairs within reach [D], or whose radii [D] overlap; positions fix the order."""
    pairs.filled[0] = 0
    if not sort_into_cells(pairs.cells, x, y, count, reach):
        pairs.filled[0] = -1
        return
    for i in range(count):
        for k in range(find_partners_of_grain(pairs.cells, x, y, i, reach)):
            j = pairs.cells.partners[k]
            if radius is not None:
                dx, dy, near = x[i] - x[j], y[i] - y[j], radius[i] + radius[j]
                if dx * dx + dy * dy >= near * near:
                    continue
            if pairs.filled[0] == pairs.first.size:
                pairs.filled[0] = -1
                return
            pairs.first[pairs.filled[0]] = i
            pairs.second[pairs.filled[0]] = j
            pairs.filled[0] += 1
