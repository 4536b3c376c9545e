"""De Paula's Verlet list [D, 5.1], for comparison with de Paula.

A list holds the pairs that are closer than the radius where it is made. From then on all of them
act, at whatever distance, and no others; the list is made anew once a grain has moved by the skin
[D, Algorithm 5.1 without its lines 20 to 22]. Pairs that come closer meanwhile are missed: this is
de Paula's approximation, with its bias. `granular.pairs.stripe_partner_lists` misses none.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.pairs.cell_list import ClosePairs, close_pairs_workspace, find_close_pairs
from granular.pairs.dipole_law import ENERGY, pair_energy, pair_force
from granular.pairs.grain_arrays import (
    GrainArrays,
    add_to_entry_if_given,
    clear_sums,
    set_forces_to_nan,
    value_or_one,
)

if TYPE_CHECKING:
    from jaxtyping import Float

RADIUS, SKIN = 11.26, 4.13
"""De Paula's values, in diameters of the first species."""

# Touching discs, 2/sqrt(3) per D^2, have pi/sqrt(3) = 1.8.
_MOST_PARTNERS = 4.0
"""Pairs that there is room for, per grain and square of the radius [D]: the densest bed of discs
has 1.8."""

LISTED, GRAINS, BUILDS = range(3)
"""Entries of the memory: whether there is a list for the places that it was made at, for how many
grains, and how often one was made."""


class VerletSettings(NamedTuple):
    """Radius and skin of the list [D]."""

    radius: float
    skin: float


class VerletList(NamedTuple):
    """The listed pairs, and where they were listed."""

    pairs: ClosePairs
    built: Float[np.ndarray, "2 m"]  # positions of the last listing [D]; part of a checkpoint
    memory: Float[np.ndarray, "3"]  # see `LISTED` and the others; likewise


def verlet_list_workspace(size: int, radius: float) -> VerletList:
    """Allocate de Paula's list of pairs; radius [D]."""
    capacity = size * int(min(size, _MOST_PARTNERS * max(radius, 2.0) ** 2))
    return VerletList(close_pairs_workspace(size, capacity, np.int32), np.zeros((2, size)), np.zeros(3))


@compiled
def _refresh_verlet_list(
    pair_list: VerletList, listing: VerletSettings, x: Array, y: Array, grains: int
) -> None:
    stale = pair_list.memory[GRAINS] != grains
    for i in range(grains):
        dx, dy = x[i] - pair_list.built[0, i], y[i] - pair_list.built[1, i]
        stale |= not dx * dx + dy * dy < listing.skin * listing.skin
    if stale:
        for i in range(grains):
            pair_list.built[0, i] = x[i]
            pair_list.built[1, i] = y[i]
        pair_list.memory[GRAINS] = grains
        pair_list.memory[BUILDS] += 1.0
    if stale or pair_list.memory[LISTED] == 0.0:
        find_close_pairs(
            pair_list.pairs, pair_list.built[0], pair_list.built[1], grains, listing.radius, None
        )
        pair_list.memory[LISTED] = 1.0


@compiled
def verlet_list_sum(pair_list: VerletList, listing: VerletSettings, grains: int, arrays: GrainArrays) -> None:
    """Compute forces [F*] and sums over the listed pairs; list anew where a grain has moved by the skin."""
    _refresh_verlet_list(pair_list, listing, arrays.x, arrays.y, grains)
    clear_sums(arrays)
    rest = pair_energy(listing.radius)
    if pair_list.pairs.filled[0] < 0:
        set_forces_to_nan(arrays, grains)
    for p in range(pair_list.pairs.filled[0]):
        i, j = pair_list.pairs.first[p], pair_list.pairs.second[p]
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
