"""Near list: the pairs of grains within a reach, with their images in a periodic cell.

Grains are sorted by counting into square cells not smaller than the reach plus a skin (Allen and Tildesley
1987, 5.3.2). Each grain's partners of higher index are listed in the order of their indices. The list
contains every pair within the reach until a grain has moved by half the skin (Verlet 1967,
doi:10.1103/PhysRev.159.98). It is then rebuilt. The terms and the order of the sums do not depend on when the
list was built, so a resumed run has the same bits as an uninterrupted one.

For comparison with de Paula, the module also includes de Paula's Verlet list [D, 5.1]. It lists the pairs
that are closer than a radius when it is built. Until the list is rebuilt, exactly these pairs interact, at
any distance. The list is rebuilt once a grain has moved by a skin that is set separately [D, Algorithm
5.1 without its lines 20 to 22]. Pairs that approach in the meantime are missed, which biases the forces.
`granular.pairs.cut_off_sum` misses no pairs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.dipole_law import ENERGY, pair_energy, pair_force
from granular.pairs.grain_arrays import (
    GrainArrays,
    add_to_entry_if_given,
    clear_sums,
    set_forces_to_nan,
    value_or_one,
)
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError

SKIN = 0.15
"""Default skin [D]. For a reach of 2 D, a fifth of the listed pairs lie within the skin."""

_PARTNERS_PER_AREA = 4.0
"""Capacity of the list in pairs per grain, for a reach equal to the smallest diameter. The capacity increases
with the square of the reach. Touching discs, with a density of 2/sqrt(3) per squared diameter, need
pi/sqrt(3) = 1.8.
"""

_MAX_PAIRS = 200_000_000
"""Maximum number of listed pairs; with their shifts, so many pairs take 4 GB of memory."""

MIN_PARTNERS = 24
"""Minimum capacity of the list in pairs per grain; overlapping discs of any sizes have about three each."""

LISTED, GRAINS, BUILDS = range(3)
"""Entries of an array: 1 if the list belongs to the stored positions; number of grains; number of times that
the list was built.
"""


class NearList(NamedTuple):
    """Listed pairs, cells for the search, and positions at the last listing."""

    starts: Int[np.ndarray, "m+1"]  # index of each grain's first partner
    partners: np.ndarray  # (p,), uint32; in increasing order; periodic images of the grain itself come first
    shifts: Float[np.ndarray, "2 p"] | None  # added to x_i - x_j in a periodic cell [D]
    periods: Float[np.ndarray, "2"] | None  # sides of the periodic cell [D]
    radius: Float[np.ndarray, "m"] | None  # None: the reach is the same for all pairs [D]
    reach: float  # longest reach, without the skin [D]
    skin: float  # [D]
    squared_move_limit: float  # squared displacement of a grain that triggers a new listing [D^2]
    built: Float[np.ndarray, "2 m"]  # positions at the last listing [D]
    memory: Float[np.ndarray, "3"]  # see `LISTED` to `BUILDS`
    cell: Int[np.ndarray, "m"]  # cell of each grain
    order: Int[np.ndarray, "m"]  # grains in the order of cells
    begins: Int[np.ndarray, "c"]  # index in ``order`` at which each cell begins


def allocate_near_list(
    size: int,
    reach: float,
    *,
    skin: float = SKIN,
    periods: tuple[float, float] | None = None,
    radius: Float[np.ndarray, "m"] | None = None,
    smallest: float = 1.0,
) -> NearList:
    """Allocate a near list; if radii of the grains are given, only pairs of overlapping grains are listed."""
    longest = reach + skin
    per_grain = MIN_PARTNERS
    if radius is None:
        per_grain = max(per_grain, math.ceil(_PARTNERS_PER_AREA * (longest / smallest) ** 2))
    max_pairs = size * (size - 1) // 2 if periods is None else size * (size + 1) // 2
    if periods is not None:
        max_pairs *= int(
            (2.0 * math.ceil(longest / periods[0]) + 1.0) * (2.0 * math.ceil(longest / periods[1]) + 1.0)
        )
    capacity = max(1, min(max_pairs, size * per_grain))
    if capacity > _MAX_PAIRS:
        raise InputError(
            f"there may be {capacity:.3g} pairs within {reach:.4g} diameters; the limit is "
            f"{_MAX_PAIRS:.3g}: give the pair law a shorter reach"
        )
    return NearList(
        starts=np.zeros(size + 1, dtype=np.int64),
        partners=np.zeros(capacity, dtype=np.uint32),
        shifts=None if periods is None else np.zeros((2, capacity)),
        periods=None if periods is None else np.array(periods),
        radius=radius,
        reach=reach,
        skin=skin,
        squared_move_limit=0.25 * skin**2,
        built=np.zeros((2, size)),
        memory=np.array([0.0, -1.0, 0.0]),
        cell=np.zeros(size, dtype=np.int64),
        order=np.zeros(size, dtype=np.int64),
        begins=np.zeros(2 * size + 16, dtype=np.int64),
    )


class _Grid(NamedTuple):
    """Grid of cells: origin and sides of a cell [D], numbers of cells, and numbers of neighbours searched."""

    left: float
    low: float
    wide: float
    high: float
    columns: int
    rows: int
    across: int
    up: int


@compiled
def _covering_grid(x: Array, y: Array, grains: int, reach: float, most: int) -> _Grid:
    """Make a grid that covers the grains, with at most ``most`` cells."""
    left, right, low, high = x[0], x[0], y[0], y[0]
    for i in range(grains):
        left, right = min(left, x[i]), max(right, x[i])
        low, high = min(low, y[i]), max(high, y[i])
    # In floating-point numbers, since the product of the numbers of cells may overflow integers.
    size = reach
    columns, rows = np.floor((right - left) / size) + 1.0, np.floor((high - low) / size) + 1.0
    while columns * rows > most and size < np.inf:
        size *= 1.5
        columns, rows = np.floor((right - left) / size) + 1.0, np.floor((high - low) / size) + 1.0
    return _Grid(left, low, size, size, int(columns), int(rows), 1, 1)


@compiled
def _periodic_grid(periods: Array, reach: float, most: int) -> _Grid:
    """Make a grid of a periodic cell; if the reach exceeds a side, several images in a row are searched."""
    columns = min(max(np.floor(periods[0] / reach), 1.0), most)
    rows = min(max(np.floor(periods[1] / reach), 1.0), max(np.floor(most / columns), 1.0))
    wide, high = periods[0] / columns, periods[1] / rows
    across, up = int(np.ceil(reach / wide)), int(np.ceil(reach / high))
    return _Grid(0.0, 0.0, wide, high, int(columns), int(rows), across, up)


@compiled(inline=True)
def _grid_of_cells(periods: Array | None, near: NearList, grains: int, reach: float) -> _Grid:
    most = near.begins.size - 2
    if periods is None:
        return _covering_grid(near.built[0], near.built[1], grains, reach, most)
    return _periodic_grid(periods, reach, most)


@compiled(inline=True)
def _period_count_to_position(periods: Array | None, axis: int, position: float) -> float:
    """Return the number of periods from the periodic cell to a position; 0 in a closed cell."""
    return 0.0 if periods is None else np.floor(position / periods[axis])


@compiled(inline=True)
def _period(periods: Array | None, axis: int) -> float:
    return 0.0 if periods is None else periods[axis]


@compiled
def _sort_into_cells(near: NearList, grid: _Grid, grains: int) -> None:
    """Sort the grains into cells by counting."""
    begins, periods, cells = near.begins, near.periods, grid.columns * grid.rows
    begins[: cells + 1] = 0
    for i in range(grains):
        x, y = near.built[0, i], near.built[1, i]
        x, y = (
            x - _period_count_to_position(periods, 0, x) * _period(periods, 0),
            y - _period_count_to_position(periods, 1, y) * _period(periods, 1),
        )
        column = min(int((x - grid.left) / grid.wide), grid.columns - 1)
        row = min(int((y - grid.low) / grid.high), grid.rows - 1)
        near.cell[i] = row * grid.columns + column
        begins[near.cell[i] + 1] += 1
    for cell in range(cells):
        begins[cell + 1] += begins[cell]
    for i in range(grains - 1, -1, -1):
        # Filling from the back moves the end index of each cell down to the cell's begin.
        begins[near.cell[i] + 1] -= 1
        near.order[begins[near.cell[i] + 1]] = i
    for cell in range(cells):
        begins[cell] = begins[cell + 1]
    begins[cells] = grains


@compiled(inline=True)
def _pair_reach(radius: Array | None, near: NearList, i: int, j: int) -> float:
    return near.reach + near.skin if radius is None else radius[i] + radius[j] + near.skin


@compiled(inline=True)
def _store_image_shift(shifts: Array | None, k: int, x: float, y: float) -> None:
    if shifts is not None:
        shifts[0, k], shifts[1, k] = x, y


@compiled(inline=True)
def _list_entry_comes_after(
    shifts: Array | None, partners: Array, k: int, j: int, x: float, y: float
) -> bool:
    """Return True if entry ``k`` of the list comes after partner ``j`` with the shift (``x``, ``y``)."""
    if partners[k] != j or shifts is None:
        return partners[k] > j
    return shifts[1, k] > y or (shifts[1, k] == y and shifts[0, k] > x)


@compiled(inline=True)
def _copy_image_shift(shifts: Array | None, source: int, target: int) -> None:
    if shifts is not None:
        shifts[0, target], shifts[1, target] = shifts[0, source], shifts[1, source]


@compiled
def _list_partners_in_cell(
    near: NearList, i: int, cell: int, turns_x: float, turns_y: float, begin: int, last: int
) -> int:
    """List partners of grain ``i`` in an image of a cell; return the new end, or -1 if the list is full."""
    periods, x, y = near.periods, near.built[0], near.built[1]
    for index in range(near.begins[cell], near.begins[cell + 1]):
        j = near.order[index]
        if j < i:
            continue
        # Grain i is not shifted; the partner is moved to its image.
        by_x = (_period_count_to_position(periods, 0, x[j]) - turns_x) * _period(periods, 0)
        by_y = (_period_count_to_position(periods, 1, y[j]) - turns_y) * _period(periods, 1)
        if j == i and not (by_y > 0.0 or (by_y == 0.0 and by_x > 0.0)):
            continue  # opposite images of the grain itself form one pair
        dx, dy, reach = x[i] - x[j] + by_x, y[i] - y[j] + by_y, _pair_reach(near.radius, near, i, j)
        if dx * dx + dy * dy < reach * reach:
            if last == near.partners.size:
                return -1
            # Sorted, so that sums do not depend on the time of listing.
            at = last
            while at > begin and _list_entry_comes_after(near.shifts, near.partners, at - 1, j, by_x, by_y):
                near.partners[at] = near.partners[at - 1]
                _copy_image_shift(near.shifts, at - 1, at)
                at -= 1
            near.partners[at] = j
            _store_image_shift(near.shifts, at, by_x, by_y)
            last += 1
    return last


@compiled
def _list_pairs(near: NearList, grains: int) -> bool:
    """List the pairs at the stored positions; return False if the list is full."""
    grid = _grid_of_cells(near.periods, near, grains, near.reach + near.skin)
    _sort_into_cells(near, grid, grains)
    last = 0
    for i in range(grains):
        begin = last
        near.starts[i] = begin
        column, row = near.cell[i] % grid.columns, near.cell[i] // grid.columns
        home_x, home_y = (
            _period_count_to_position(near.periods, 0, near.built[0, i]),
            _period_count_to_position(near.periods, 1, near.built[1, i]),
        )
        for up in range(row - grid.up, row + grid.up + 1):
            for across in range(column - grid.across, column + grid.across + 1):
                inside = 0 <= up < grid.rows and 0 <= across < grid.columns
                if near.periods is None and not inside:
                    continue
                cell = up % grid.rows * grid.columns + across % grid.columns
                turns_x, turns_y = home_x + across // grid.columns, home_y + up // grid.rows
                last = _list_partners_in_cell(near, i, cell, turns_x, turns_y, begin, last)
                if last < 0:
                    return False
    near.starts[grains] = last
    return True


@compiled
def has_any_grain_moved(
    before: Float[Array, "2 m"], x: Float[Array, "m"], y: Float[Array, "m"], grains: int, squared_limit: float
) -> bool:
    """Return True if a grain has moved so far that its squared displacement is ``squared_limit`` or more."""
    moved = 0
    for i in range(grains):
        dx, dy = x[i] - before[0, i], y[i] - before[1, i]
        moved += not dx * dx + dy * dy < squared_limit
    return moved > 0


@compiled(inline=True)
def store_positions(
    before: Float[Array, "2 m"] | None, x: Float[Array, "m"], y: Float[Array, "m"], grains: int
) -> None:
    """Copy the positions to ``before``, if given."""
    if before is not None:
        for i in range(grains):
            before[0, i], before[1, i] = x[i], y[i]


@compiled
def positions_are_finite(x: Float[Array, "m"], y: Float[Array, "m"], grains: int) -> bool:
    """Return True if all positions are finite."""
    invalid = 0
    for i in range(grains):
        invalid += 0.0 * x[i] + 0.0 * y[i] != 0.0
    return invalid == 0


@compiled
def refresh_near_list(near: NearList, x: Float[Array, "m"], y: Float[Array, "m"], grains: int) -> bool:
    """Rebuild the list if a grain moved too far; return False if it overflows or a position is not finite."""
    if near.memory[GRAINS] != grains or has_any_grain_moved(
        near.built, x, y, grains, near.squared_move_limit
    ):
        store_positions(near.built, x, y, grains)
        if not positions_are_finite(x, y, grains):
            near.memory[GRAINS] = -1.0
            return False
        near.memory[LISTED], near.memory[GRAINS] = 0.0, grains
        near.memory[BUILDS] += 1.0
    if near.memory[LISTED] == 0.0:
        if grains > 0 and not _list_pairs(near, grains):
            near.memory[GRAINS] = -1.0
            return False
        near.memory[LISTED] = 1.0
    return True


@compiled(inline=True)
def pair_displacement(
    shifts: Float[Array, "2 p"] | None, k: int, dx: float, dy: float
) -> tuple[float, float]:
    """Return the displacement of a listed pair; in a periodic cell, to the listed image of the partner."""
    if shifts is None:
        return dx, dy
    return dx + shifts[0, k], dy + shifts[1, k]


VERLET_RADIUS, VERLET_SKIN = 11.26, 4.13
"""De Paula's radius and skin, in diameters of the first species."""


class VerletSettings(NamedTuple):
    """Radius and skin of de Paula's list [D]."""

    radius: float
    skin: float


def allocate_verlet_list(size: int, settings: VerletSettings) -> NearList:
    """Allocate de Paula's list, which contains only pairs within the radius, without a margin (skin)."""
    near = allocate_near_list(size, settings.radius, skin=0.0)
    return near._replace(squared_move_limit=settings.skin**2)


@compiled
def sum_pairs_of_verlet_list(near: NearList, grains: int, arrays: GrainArrays) -> None:
    """Sum forces and other quantities over listed pairs; rebuild the list first if a grain moved too far."""
    listed = refresh_near_list(near, arrays.x, arrays.y, grains)
    clear_sums(arrays)
    if not listed:
        set_forces_to_nan(arrays, grains)
        return
    rest = pair_energy(near.reach)
    for i in range(grains):
        for k in range(near.starts[i], near.starts[i + 1]):
            j = near.partners[k]
            dx, dy = arrays.x[i] - arrays.x[j], arrays.y[i] - arrays.y[j]
            r = math.sqrt(dx * dx + dy * dy)
            force, energy = pair_force(r), pair_energy(r)
            first, second = value_or_one(arrays.moments, i), value_or_one(arrays.moments, j)
            ratio = force / r * (first * second)
            arrays.fx[i] += ratio * dx
            arrays.fy[i] += ratio * dy
            arrays.fx[j] -= ratio * dx
            arrays.fy[j] -= ratio * dy
            fifth = force / (3.0 * ENERGY * r)
            add_to_entry_if_given(arrays.stiffness, i, fifth * second)
            add_to_entry_if_given(arrays.stiffness, j, fifth * first)
            _update_energy_and_closest(
                arrays.energy_and_closest, first * second * (energy - rest) / ENERGY, fifth
            )
            add_to_entry_if_given(arrays.load, i, value_or_one(arrays.weight, j) * energy / ENERGY)
            add_to_entry_if_given(arrays.load, j, value_or_one(arrays.weight, i) * energy / ENERGY)


@compiled(inline=True)
def _update_energy_and_closest(energy_and_closest: Array | None, energy: float, fifth: float) -> None:
    if energy_and_closest is not None:
        energy_and_closest[0] += energy
        energy_and_closest[1] = max(energy_and_closest[1], fifth)
