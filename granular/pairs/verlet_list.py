"""De Paula's Verlet list [D, 5.1], for comparison with de Paula.

A list holds the pairs that are closer than the radius where it is made. From then on all of them
act, at whatever distance, and no others; the list is made again once a grain has moved by the skin
[D, Algorithm 5.1 without its lines 20 to 22]. Pairs that come closer meanwhile are missed: this is
de Paula's approximation, with its bias. `granular.pairs.stripe_partner_lists` misses none.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from granular.compiled import Array, compiled
from granular.pairs.dipole_law import ENERGY, pair_energy, pair_force
from granular.pairs.grain_arrays import (
    GrainArrays,
    add_to_entry_if_given,
    clear_sums,
    set_forces_to_nan,
    value_or_one,
)
from granular.pairs.near_list import NearList, near_list_workspace, refresh_near_list

RADIUS, SKIN = 11.26, 4.13
"""De Paula's values, in diameters of the first species."""


class VerletSettings(NamedTuple):
    """Radius and skin of the list [D]."""

    radius: float
    skin: float


def verlet_list_workspace(size: int, settings: VerletSettings) -> NearList:
    """Allocate de Paula's list of pairs: no pair beyond the radius is listed, and the skin has no pairs."""
    near = near_list_workspace(size, settings.radius, skin=0.0)
    return near._replace(farthest=settings.skin**2)


@compiled
def verlet_list_sum(near: NearList, grains: int, arrays: GrainArrays) -> None:
    """Compute forces [F*] and sums over the listed pairs; list again where a grain has moved by the skin."""
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
