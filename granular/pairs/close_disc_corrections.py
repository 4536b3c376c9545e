"""Close pairs of discs: what their law has beyond that of all pairs, from a list and tables.

The list holds the pairs within the reach of the tables and a skin, in the order of their grains.
What a pair adds does not depend on when the list was made, and neither does the order of the sums:
a run that goes on from a checkpoint has the bits of one that was not interrupted.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.dipole_law import STRENGTH, head_on_frequency_squared
from granular.pairs.disc_law_tables import (
    CONTACT,
    END,
    HEIGHT,
    LEAST,
    PER_PIECE,
    SHIFT,
    SINGULAR,
    SMOOTH,
    SQUARES,
    START,
    STIFFNESS,
    STIFFNESSES,
    TERM,
    CloseDiscTables,
    DiscLaw,
)
from granular.pairs.grain_arrays import GrainArrays, add_to_entry_if_given, value_or_one

if TYPE_CHECKING:
    from jaxtyping import Float, Int

SKIN = 0.15
"""Added to the reach of the list [D]: it is made anew once a grain has moved by half of it."""

_PARTNERS = 24
"""Room for pairs, per grain, at a reach of 2 D; a longer one needs more, as its square."""


class CloseDiscList(NamedTuple):
    """The list of close pairs, and what makes it."""

    first: np.ndarray  # the lower grain of each pair (p,), uint32
    second: np.ndarray  # the other one (p,), uint32; in order
    filled: Int[np.ndarray, "1"]  # number of pairs
    built: Float[np.ndarray, "2 m"]  # positions at which the list was made [D]
    grains: Int[np.ndarray, "1"]  # number of grains then; -1 before
    cell: Int[np.ndarray, "m"]  # cell of each grain
    order: Int[np.ndarray, "m"]  # grains in the order of cells
    firsts: Int[np.ndarray, "c"]  # index in ``order`` at which each cell begins
    periods: Float[np.ndarray, "2"] | None  # sides of a periodic cell [D]


def close_disc_list_workspace(size: int, reach: float, periods: tuple[float, float] | None) -> CloseDiscList:
    """Allocate the list of close pairs of discs; reach, periods [D]."""
    capacity = size * math.ceil(_PARTNERS * max(1.0, (reach / 2.0) ** 2))
    capacity = min(capacity, max(1, size * (size - 1) // 2))
    return CloseDiscList(
        first=np.zeros(capacity, dtype=np.uint32),
        second=np.zeros(capacity, dtype=np.uint32),
        filled=np.zeros(1, dtype=np.int64),
        built=np.zeros((2, size)),
        grains=np.full(1, -1, dtype=np.int64),
        cell=np.zeros(size, dtype=np.int64),
        order=np.zeros(size, dtype=np.int64),
        firsts=np.zeros(2 * size + 16, dtype=np.int64),
        periods=None if periods is None else np.array(periods),
    )


@compiled(inline=True)
def _nearest_image_component(periods: Array | None, axis: int, displacement: float) -> float:
    if periods is None:
        return displacement
    return displacement - periods[axis] * np.rint(displacement / periods[axis])


@compiled(inline=True)
def _wrap_coordinate(periods: Array | None, axis: int, position: float) -> float:
    if periods is None:
        return position
    return position - periods[axis] * np.floor(position / periods[axis])


@compiled(inline=True)
def _coordinate_extent(periods: Array | None, axis: int, values: Array, grains: int) -> tuple[float, float]:
    """Lowest position along an axis, and the extent from there on."""
    if periods is not None:
        return 0.0, periods[axis]
    low, high = values[0], values[0]
    for i in range(grains):
        low, high = min(low, values[i]), max(high, values[i])
    return low, high - low


@compiled(inline=True)
def _neighbour_line_of_cells(periods: Array | None, line: int, lines: int) -> int:
    """Line of cells beside another one; -1 outside of a closed cell."""
    if periods is not None:
        return line % lines
    return line if 0 <= line < lines else -1


@compiled
def _sort_into_cells(close: CloseDiscList, x: Array, y: Array, grains: int, reach: float) -> tuple[int, int]:
    """Sort grains into cells no smaller than the reach; return the columns and rows."""
    periods, firsts = close.periods, close.firsts
    left, width = _coordinate_extent(periods, 0, x, grains)
    low, height = _coordinate_extent(periods, 1, y, grains)
    most = math.floor(math.sqrt(firsts.size - 8.0))
    columns = int(max(1.0, min(np.floor(width / reach), most)))
    rows = int(max(1.0, min(np.floor(height / reach), (firsts.size - 2.0) // columns)))
    # Two lines round a periodic cell are neighbours on both sides, and would be met twice.
    columns, rows = 1 if columns < 3 else columns, 1 if rows < 3 else rows
    wide, high = max(width / columns, reach), max(height / rows, reach)
    firsts[: columns * rows + 1] = 0
    for i in range(grains):
        across = int((_wrap_coordinate(periods, 0, x[i]) - left) / wide)
        up = int((_wrap_coordinate(periods, 1, y[i]) - low) / high)
        close.cell[i] = min(up, rows - 1) * columns + min(across, columns - 1)
        firsts[close.cell[i] + 1] += 1
    for cell in range(columns * rows):
        firsts[cell + 1] += firsts[cell]
    for i in range(grains - 1, -1, -1):
        firsts[close.cell[i] + 1] -= 1
        close.order[firsts[close.cell[i] + 1]] = i
    for cell in range(columns * rows):
        firsts[cell] = firsts[cell + 1]
    firsts[columns * rows] = grains
    return columns, rows


@compiled
def _list_close_pairs(close: CloseDiscList, x: Array, y: Array, grains: int, reach: float) -> bool:
    """Fill the list; False where it has no room."""
    columns, rows = _sort_into_cells(close, x, y, grains, reach)
    periods, second, last = close.periods, close.second, 0
    for i in range(grains):
        begin = last
        column, row = close.cell[i] % columns, close.cell[i] // columns
        for up in range(-1 if rows > 1 else 0, 2 if rows > 1 else 1):
            for by in range(-1 if columns > 1 else 0, 2 if columns > 1 else 1):
                line = _neighbour_line_of_cells(periods, row + up, rows)
                across = _neighbour_line_of_cells(periods, column + by, columns)
                if line < 0 or across < 0:
                    continue
                cell = line * columns + across
                for k in range(close.firsts[cell], close.firsts[cell + 1]):
                    j = close.order[k]
                    dx = _nearest_image_component(periods, 0, x[i] - x[j])
                    dy = _nearest_image_component(periods, 1, y[i] - y[j])
                    if j > i and dx * dx + dy * dy < reach * reach:
                        if last == second.size:
                            return False
                        # In their order: the sums do not depend on when the list was made.
                        at = last
                        while at > begin and second[at - 1] > j:
                            second[at] = second[at - 1]
                            at -= 1
                        second[at] = j
                        close.first[last] = i
                        last += 1
    close.filled[0] = last
    return True


@compiled
def _refresh_pair_list(close: CloseDiscList, x: Array, y: Array, grains: int, reach: float) -> bool:
    """Make the list hold every pair within the reach; False where it cannot."""
    # Two grains that moved by half the skin each may have come nearer by all of it.
    moved, most = 0, 0.25 * SKIN * SKIN
    for i in range(grains):
        dx, dy = x[i] - close.built[0, i], y[i] - close.built[1, i]
        moved += not dx * dx + dy * dy < most
    if moved == 0 and close.grains[0] == grains:
        return True
    odd = 0
    for i in range(grains):
        odd += 0.0 * x[i] + 0.0 * y[i] != 0.0
        close.built[0, i], close.built[1, i] = x[i], y[i]
    close.grains[0] = -1 if odd else grains
    return odd == 0 and _list_close_pairs(close, x, y, grains, reach + SKIN)


@compiled(inline=True)
def _table_row_of_pair(species: Array | None, kinds: int, i: int, j: int) -> int:
    return 0 if species is None else species[i] * kinds + species[j]


@compiled(inline=True)
def _force_table_entries(tables: CloseDiscTables, row: int) -> tuple[float, float, float]:
    """Entries of a pair of species that the forces take."""
    return tables.pairs[row, START], tables.pairs[row, PER_PIECE], tables.pairs[row, SMOOTH]


@compiled(inline=True)
def _force_table_entries_of_pair(
    species: Array | None, tables: CloseDiscTables, row: int, alike: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Those of a pair: where all grains are alike they stay in registers."""
    return alike if species is None else _force_table_entries(tables, row)


@compiled(inline=True)
def _find_spline_piece(
    tables: CloseDiscTables, start: float, per_piece: float, u: float
) -> tuple[np.uint64, float]:
    """Piece of a table at r^2 = u, and the fraction of it that is passed."""
    passed = min(max((u - start) * per_piece, 0.0), tables.pieces.shape[1] - 1.0)
    # An index without a sign takes no look at whether it counts from the end.
    piece = np.uint64(passed)
    return piece, passed - np.floor(passed)


@compiled(inline=True)
def _find_spline_piece_of_row(tables: CloseDiscTables, row: int, u: float) -> tuple[np.uint64, float]:
    return _find_spline_piece(tables, tables.pairs[row, START], tables.pairs[row, PER_PIECE], u)


@compiled(inline=True)
def _spline_force_ratio(tables: CloseDiscTables, row: int, k: np.uint64, t: float) -> float:
    """F/r that a piece adds, over the moments."""
    p = tables.pieces
    return p[row, k, 0] + t * p[row, k, 1] + t * t * (p[row, k, 2] + t * p[row, k, 3])


@compiled(inline=True)
def _spline_energy(tables: CloseDiscTables, row: int, u: float) -> float:
    """Energy that they add."""
    k, t = _find_spline_piece_of_row(tables, row, u)
    p = tables.pieces
    passed = p[row, k, 1] / 2.0 + t * (p[row, k, 2] / 3.0 + t * p[row, k, 3] / 4.0)
    passed = t * (p[row, k, 0] + t * passed) / tables.pairs[row, PER_PIECE]
    return tables.energies[row, k] - 0.5 * passed


@compiled(inline=True)
def _spline_force_slope(tables: CloseDiscTables, row: int, u: float) -> float:
    """d(F/r)/d(r^2) that they add."""
    k, t = _find_spline_piece_of_row(tables, row, u)
    p = tables.pieces
    slope = p[row, k, 1] + t * (2.0 * p[row, k, 2] + 3.0 * t * p[row, k, 3])
    return tables.pairs[row, PER_PIECE] * slope


@compiled
def _singular_contact_part(tables: CloseDiscTables, row: int, u: float) -> tuple[float, float, float]:
    """F/r, energy and d(F/r)/d(r^2) of the singular part; the root is that of x + iz."""
    factor = tables.pairs[row, SINGULAR]
    x, z = u - tables.pairs[row, CONTACT], tables.pairs[row, HEIGHT]
    size = math.sqrt(x * x + z * z)
    real, imaginary = math.sqrt(0.5 * (size + x)), math.sqrt(0.5 * (size - x))
    energy = -0.2 * ((x * x - z * z) * real - 2.0 * x * z * imaginary)
    return factor * (x * real - z * imaginary), factor * energy, factor * 1.5 * real


@compiled
def _stiffness_above_bound(discs: DiscLaw, row: int, u: float) -> float:
    """Stiffness of a close pair less the bound that stands for it, over the moments."""
    tables, force = discs.close, 8.0 / 3.0 * discs.coefficients[TERM]
    rho2 = u - tables.pairs[row, SHIFT]
    fifth = 1.0 / (rho2 * rho2 * math.sqrt(rho2))
    ratio = STRENGTH * fifth * (1.0 + force * fifth) + _spline_force_ratio(
        tables, row, *_find_spline_piece_of_row(tables, row, u)
    )
    slope = -2.5 * STRENGTH * fifth / rho2 * (1.0 + 2.0 * force * fifth) + _spline_force_slope(tables, row, u)
    if u < tables.pairs[row, SMOOTH]:
        more, _, by_u = _singular_contact_part(tables, row, u)
        ratio, slope = ratio + more, slope + by_u
    # The sum over all pairs has this much already.
    bound = 3.0 * discs.coefficients[STIFFNESS] * fifth
    return max(abs(ratio + 2.0 * u * slope), abs(ratio)) - bound


@compiled
def _tabulated_energy(tables: CloseDiscTables, row: int, u: float) -> float:
    """Energy that a table adds, over the moments."""
    singular = _singular_contact_part(tables, row, u)[1] if u < tables.pairs[row, SMOOTH] else 0.0
    return _spline_energy(tables, row, u) + singular


@compiled
def head_on_disc_frequency_squared(discs: DiscLaw, speed: float, mass: float, moment: float) -> float:
    """Squared frequency at the closest approach of two discs, by a table [1/tau^2]; speed [D/tau]."""
    strength = moment * (moment / mass)
    squares = discs.collision[SQUARES]
    square = speed * speed / strength
    # Slower discs turn beyond the table, where they are dipoles.
    if square < squares[0]:
        return head_on_frequency_squared(speed, mass, moment)
    last = min(np.searchsorted(squares, square), squares.size - 1)
    return strength * discs.collision[STIFFNESSES, last]


@compiled(inline=True)
def _pair_displacement(periods: Array | None, x: Array, y: Array, i: int, j: int) -> tuple[float, float]:
    """Displacement from one grain to another, or to its nearest image."""
    return _nearest_image_component(periods, 0, x[i] - x[j]), _nearest_image_component(
        periods, 1, y[i] - y[j]
    )


def closest_distance_over_contact(
    discs: DiscLaw, close: CloseDiscList, x: Float[np.ndarray, "m"], y: Float[np.ndarray, "m"]
) -> tuple[float, int]:
    """Find the least distance of two discs over that at which they touch; x, y [D]."""
    i, j = close.first[: close.filled[0]], close.second[: close.filled[0]]
    if not len(i):
        return math.inf, -1
    apart = np.array([x[i] - x[j], y[i] - y[j]])
    if close.periods is not None:
        apart -= close.periods[:, None] * np.rint(apart / close.periods[:, None])
    row = 0 if discs.species is None else discs.species[i] * discs.kinds + discs.species[j]
    ratio = np.hypot(*apart) / np.sqrt(discs.close.pairs[row, CONTACT])
    return float(ratio.min()), int(i[ratio.argmin()])


@compiled(inline=True)
def _add_pair_force(arrays: GrainArrays, i: int, j: int, dx: float, dy: float, ratio: float) -> None:
    fx, fy = ratio * dx, ratio * dy
    arrays.fx[i] += fx
    arrays.fy[i] += fy
    arrays.fx[j] -= fx
    arrays.fy[j] -= fy


@compiled
def _add_spline_forces(discs: DiscLaw, close: CloseDiscList, arrays: GrainArrays) -> int:
    """Add the forces of the pieces; return how many pairs have a singular part as well."""
    x, y, tables, touching = arrays.x, arrays.y, discs.close, 0
    alike = _force_table_entries(tables, 0)
    # No branch: how many pairs a grain has is a guess that goes wrong.
    for p in range(close.filled[0]):
        i, j = close.first[p], close.second[p]
        dx, dy = _pair_displacement(close.periods, x, y, i, j)
        u, row = dx * dx + dy * dy, _table_row_of_pair(discs.species, discs.kinds, i, j)
        start, per_piece, smooth = _force_table_entries_of_pair(discs.species, tables, row, alike)
        touching += u < smooth
        piece, t = _find_spline_piece(tables, start, per_piece, u)
        both = value_or_one(arrays.moments, i) * value_or_one(arrays.moments, j)
        _add_pair_force(arrays, i, j, dx, dy, both * _spline_force_ratio(tables, row, piece, t))
    return touching


# By itself: most beds have no such pair, and its roots take longer than all else.
@compiled
def _add_singular_contact_forces(discs: DiscLaw, close: CloseDiscList, arrays: GrainArrays) -> int:
    """Add the forces of the singular parts; return how many pairs are too near."""
    tables, crowded = discs.close, 0
    for p in range(close.filled[0]):
        i, j = close.first[p], close.second[p]
        dx, dy = _pair_displacement(close.periods, arrays.x, arrays.y, i, j)
        u, row = dx * dx + dy * dy, _table_row_of_pair(discs.species, discs.kinds, i, j)
        if u < tables.pairs[row, SMOOTH]:
            crowded += u < tables.pairs[row, LEAST]
            both = value_or_one(arrays.moments, i) * value_or_one(arrays.moments, j)
            _add_pair_force(arrays, i, j, dx, dy, both * _singular_contact_part(tables, row, u)[0])
    return crowded


@compiled
def _add_energy_load_stiffness(discs: DiscLaw, close: CloseDiscList, arrays: GrainArrays) -> None:
    """Add what is asked for besides forces."""
    tables = discs.close
    for p in range(close.filled[0]):
        i, j = close.first[p], close.second[p]
        dx, dy = _pair_displacement(close.periods, arrays.x, arrays.y, i, j)
        u, row = dx * dx + dy * dy, _table_row_of_pair(discs.species, discs.kinds, i, j)
        if u < tables.pairs[row, END]:
            first, second = value_or_one(arrays.moments, i), value_or_one(arrays.moments, j)
            # As 1/r^3 in the sums, and the stiffness as 1/r^5.
            cube = 3.0 / STRENGTH * _tabulated_energy(tables, row, u)
            fifth = _stiffness_above_bound(discs, row, u) / (3.0 * discs.coefficients[STIFFNESS])
            add_to_entry_if_given(arrays.energy_and_closest, 0, first * second * cube)
            add_to_entry_if_given(arrays.load, i, value_or_one(arrays.weight, j) * cube)
            add_to_entry_if_given(arrays.load, j, value_or_one(arrays.weight, i) * cube)
            add_to_entry_if_given(arrays.stiffness, i, second * fifth)
            add_to_entry_if_given(arrays.stiffness, j, first * fifth)


@compiled(inline=True)
def _add_energy_load_stiffness_if_wanted(
    wanted: Array | None, discs: DiscLaw, close: CloseDiscList, arrays: GrainArrays
) -> bool:
    if wanted is None:
        return False
    _add_energy_load_stiffness(discs, close, arrays)
    return True


@compiled
def add_close_disc_corrections(discs: DiscLaw, close: CloseDiscList, grains: int, arrays: GrainArrays) -> int:
    """Add to all sums what close pairs of discs have beyond the law that serves all pairs; arrays [D, F*]."""
    if grains == 0:
        return 0
    if not _refresh_pair_list(close, arrays.x, arrays.y, grains, discs.reach):
        return 1
    touching, crowded = _add_spline_forces(discs, close, arrays), 0
    if touching > 0:
        crowded = _add_singular_contact_forces(discs, close, arrays)
    if not _add_energy_load_stiffness_if_wanted(arrays.energy_and_closest, discs, close, arrays):
        _add_energy_load_stiffness_if_wanted(arrays.load, discs, close, arrays)
    return crowded
