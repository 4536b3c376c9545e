"""Near part of a pair law: the correction for close pairs to the sum over all pairs.

Each pair law is split in two. Its tail in r^-3 is summed over all pairs like the law of dipoles, with a
charge for each grain in place of its moment; for discs this sum has one more term
(`granular.pairs.disc_law`). The near part is the law's energy minus the energy of the tail. It is tabulated
for each pair of species and summed over a list of close pairs. Discs and user-defined laws use this split.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.dipole_law import STRENGTH
from granular.pairs.direct_sum import pad_values
from granular.pairs.grain_arrays import value_or_one
from granular.pairs.near_list import NearList, allocate_near_list, pair_displacement, refresh_near_list
from granular.pairs.piecewise import (
    PiecewiseTable,
    Samples,
    tabulated_energy,
    tabulated_force_over_distance,
    tabulated_slope_of_force_over_distance,
)
from granular.shared.array_types import Float, Int

TAIL, SHIFT, STOP, END = range(4)
"""Entries for a pair of species:

- strength of the tail in the sum over all pairs, divided by the strength for two dipoles of the first
  species;
- shift b = r^2 - rho^2 of the squared distance in this sum [D^2];
- squared distance below which a simulation stops [D^2];
- squared distance at which the table ends [D^2].
"""


class SeriesTerms(NamedTuple):
    """Second term of the sum over all pairs, and bound of its stiffness; rho^2 = r^2 - b."""

    term: float = 0.0  # c of the energy rho^-3 + c rho^-8
    stiffness: float = 1.0  # bound of the stiffness divided by 3 / rho^5


class NearTables(NamedTuple):
    """Tables of the near part for each pair of species."""

    energies: PiecewiseTable  # [F* D], divided by the product of both factors
    pairs: Float[np.ndarray, "p 4"]  # see `TAIL` to `END`
    series: SeriesTerms
    collisions: Float[np.ndarray, "2 n"]  # squares of speeds and frequencies, divided by ``strength``
    loads: PiecewiseTable | None = None  # with friction: addition to 1/r^3 in the first grain's load [1/D^3]


class NearLaw(NamedTuple):
    """Near part of a pair law, for compiled loops."""

    factor: Float[np.ndarray, "m"] | None  # charge or moment of each grain; None: 1
    species: Int[np.ndarray, "m"] | None  # None: all equal
    kinds: int  # number of species
    reach: float  # [D]; infinite: all pairs
    strength: float  # squared factor divided by mass, of the grains that approach closest
    periods: tuple[float, float] | None  # sides of a periodic cell [D]
    tables: NearTables
    smallest: float  # smallest diameter [D]


def species_pairs_and_indices(kinds: int) -> tuple[list[tuple[int, int]], list[int]]:
    """List each pair of species once, and for each ordered pair its index in this list."""
    pairs = list(itertools.combinations_with_replacement(range(kinds), 2))
    return pairs, [pairs.index((min(i, j), max(i, j))) for i in range(kinds) for j in range(kinds)]


def make_near_law(
    tables: NearTables,
    diameters: Sequence[float],
    species: Int[np.ndarray, "n"],
    factor: Float[np.ndarray, "m"] | None,
    strength: float,
    periods: tuple[float, float] | None,
) -> NearLaw:
    """Make the near part of a law from its tables and the diameter of each species."""
    kinds = len(diameters)
    index = None if kinds == 1 else pad_values(species).astype(np.int64)
    reach = math.sqrt(tables.pairs[:, END].max())
    return NearLaw(factor, index, kinds, reach, strength, periods, tables, min(diameters))


def allocate_near_list_of_law(law: NearLaw, size: int) -> NearList | None:
    """Allocate the list of close pairs; return None if the law applies to all pairs."""
    if math.isinf(law.reach):
        return None
    return allocate_near_list(size, law.reach, periods=law.periods, smallest=law.smallest)


def collision_frequency_table(r: Samples, energy: Samples, mass: float = 1.0) -> Float[np.ndarray, "2 n"]:
    """Return squared speeds of head-on collisions, each with the maximum squared frequency up to this speed.

    The energy (n,) [F* D] of the pair is given at increasing distances r [D]. Energy and mass must already be
    divided by `NearLaw.factor` squared. At the turning point of two grains of speed v the energy is m v^2,
    and the stiffness acts on the reduced mass m/2.
    """
    slopes = np.gradient(np.gradient(energy, r), r)
    barriers = np.maximum.accumulate(energy[::-1])
    return np.array([barriers / mass, 2.0 * np.maximum.accumulate(np.abs(slopes[::-1])) / mass])


def join_collision_frequency_tables(rows: Sequence[Float[np.ndarray, "2 n"]]) -> Float[np.ndarray, "2 n"]:
    """Combine tables of several species: take the maximum of their frequencies at each speed."""
    squares = np.unique(np.concatenate([speeds for speeds, _ in rows]))
    envelopes = [
        stiffness[np.minimum(np.searchsorted(speeds, squares), len(speeds) - 1)] for speeds, stiffness in rows
    ]
    return np.array([squares, np.max(envelopes, axis=0)])


@compiled
def squared_collision_frequency(law: NearLaw, speed: float) -> float:
    """Return the squared maximum angular frequency in a head-on collision of two grains of this speed."""
    squares, frequencies = law.tables.collisions[0], law.tables.collisions[1]
    last = min(np.searchsorted(squares, speed * speed / law.strength), squares.size - 1)
    return law.strength * frequencies[last]


@compiled(inline=True)
def _table_row_of_pair(species: Array | None, kinds: int, i: int, j: int) -> int:
    return 0 if species is None else species[i] * kinds + species[j]


@compiled(inline=True)
def _stop_distance_of_pair(species: Array | None, tables: NearTables, row: int, common: float) -> float:
    """Return the entry `STOP` of a pair; for equal grains return ``common``, which stays in a register."""
    return common if species is None else tables.pairs[row, STOP]


@compiled(inline=True)
def periodic_shifts_of_list(near: NearList | None) -> Array | None:
    return None if near is None else near.shifts


@compiled(inline=True)
def partner_index_range(near: NearList | None, i: int, grains: int) -> tuple[int, int]:
    """Return begin and end of the range of a grain's partners: listed partners, or all later grains."""
    return (i + 1, grains) if near is None else (near.starts[i], near.starts[i + 1])


@compiled(inline=True)
def partner_at_list_entry(near: NearList | None, k: int) -> int:
    return k if near is None else near.partners[k]


@compiled(inline=True)
def try_to_refresh_near_list(near: NearList | None, x: Array, y: Array, grains: int) -> bool:
    return True if near is None else refresh_near_list(near, x, y, grains)


@compiled
def add_near_forces(
    law: NearLaw | None,
    near: NearList | None,
    grains: int,
    x: Float[Array, "m"],
    y: Float[Array, "m"],
    force_x: Float[Array, "m"],
    force_y: Float[Array, "m"],
) -> int:
    """Add the near forces; return the number of pairs closer than the distance at which simulations stop."""
    if law is None:
        return 0
    tables, overlapping, common_stop = law.tables, 0, law.tables.pairs[0, STOP]
    if not try_to_refresh_near_list(near, x, y, grains):
        return 1
    for i in range(grains):
        fx, fy, factor = 0.0, 0.0, value_or_one(law.factor, i)
        begin, end = partner_index_range(near, i, grains)
        for k in range(begin, end):
            j = partner_at_list_entry(near, k)
            dx, dy = pair_displacement(periodic_shifts_of_list(near), k, x[i] - x[j], y[i] - y[j])
            u, row = dx * dx + dy * dy, _table_row_of_pair(law.species, law.kinds, i, j)
            overlapping += u < _stop_distance_of_pair(law.species, tables, row, common_stop)
            ratio = (
                factor * value_or_one(law.factor, j) * tabulated_force_over_distance(tables.energies, row, u)
            )
            fx += ratio * dx
            fy += ratio * dy
            force_x[j] -= ratio * dx
            force_y[j] -= ratio * dy
        force_x[i] += fx
        force_y[i] += fy
    return overlapping


@compiled
def add_near_loads(
    law: NearLaw | None,
    near: NearList | None,
    grains: int,
    x: Float[Array, "m"],
    y: Float[Array, "m"],
    weight: Float[Array, "m"] | None,
    load: Float[Array, "m"] | None,
) -> None:
    """Add the near part of the loads for friction, using the pair list that the forces have just updated."""
    if law is None or weight is None or load is None:
        return
    loads = law.tables.loads
    assert loads is not None
    for i in range(grains):
        begin, end = partner_index_range(near, i, grains)
        for k in range(begin, end):
            j = partner_at_list_entry(near, k)
            dx, dy = pair_displacement(periodic_shifts_of_list(near), k, x[i] - x[j], y[i] - y[j])
            u = dx * dx + dy * dy
            load[i] += weight[j] * tabulated_force_over_distance(
                loads, _table_row_of_pair(law.species, law.kinds, i, j), u
            )
            load[j] += weight[i] * tabulated_force_over_distance(
                loads, _table_row_of_pair(law.species, law.kinds, j, i), u
            )


@compiled
def _stiffness_minus_all_pairs_bound(tables: NearTables, row: int, u: float) -> float:
    """Return the stiffness [F*/D] of a close pair with factors 1, minus its bound in the all-pairs sum."""
    ratio, slope = (
        tabulated_force_over_distance(tables.energies, row, u),
        tabulated_slope_of_force_over_distance(tables.energies, row, u),
    )
    # Soft grains may coincide; without a tail this adds nothing.
    rho2 = max(u - tables.pairs[row, SHIFT], 1e-30)
    fifth = 1.0 / (rho2 * rho2 * math.sqrt(rho2))
    tail, power = STRENGTH * tables.pairs[row, TAIL] * fifth, 8.0 / 3.0 * tables.series.term * fifth
    ratio += tail * (1.0 + power)
    slope -= 2.5 * tail / rho2 * (1.0 + 2.0 * power)
    bound = 3.0 / STRENGTH * tables.series.stiffness * tail
    return max(abs(ratio + 2.0 * u * slope), abs(ratio)) - bound


@compiled
def near_energy_and_add_stiffness(
    law: NearLaw | None,
    near: NearList | None,
    grains: int,
    x: Float[Array, "m"],
    y: Float[Array, "m"],
    masses: Float[Array, "m"] | None,
    stiffness: Float[Array, "m"],
) -> float:
    """Return the near energy; add upper bounds of near stiffness divided by mass to ``stiffness``."""
    if law is None:
        return 0.0
    tables, total = law.tables, 0.0
    if not try_to_refresh_near_list(near, x, y, grains):
        return math.nan
    for i in range(grains):
        begin, end = partner_index_range(near, i, grains)
        for k in range(begin, end):
            j = partner_at_list_entry(near, k)
            dx, dy = pair_displacement(periodic_shifts_of_list(near), k, x[i] - x[j], y[i] - y[j])
            u, row = dx * dx + dy * dy, _table_row_of_pair(law.species, law.kinds, i, j)
            if u < tables.pairs[row, END]:
                factors = value_or_one(law.factor, i) * value_or_one(law.factor, j)
                total += factors * tabulated_energy(tables.energies, row, u)
                # Twice: in Gershgorin's row sum the pair enters on and off the diagonal.
                slope = 2.0 * factors * _stiffness_minus_all_pairs_bound(tables, row, u)
                stiffness[i] += slope / value_or_one(masses, i)
                stiffness[j] += slope / value_or_one(masses, j)
    return total


def minimum_stop_distance_ratio_and_grain(
    law: NearLaw, near: NearList | None, grains: int, x: Float[np.ndarray, "m"], y: Float[np.ndarray, "m"]
) -> tuple[float, int]:
    """Return the minimum ratio of a pair's distance to its stop distance, and a grain of that pair."""
    if near is None or not near.starts[grains] or not law.tables.pairs[:, STOP].any():
        return math.inf, -1
    i = np.repeat(np.arange(grains), np.diff(near.starts[: grains + 1]))
    j = near.partners[: len(i)].astype(np.int64)
    apart = np.array([x[i] - x[j], y[i] - y[j]])
    if near.shifts is not None:
        apart += near.shifts[:, : len(i)]
    row = 0 if law.species is None else law.species[i] * law.kinds + law.species[j]
    ratio = np.hypot(*apart) / np.sqrt(law.tables.pairs[row, STOP])
    return float(ratio.min()), int(i[ratio.argmin()])
