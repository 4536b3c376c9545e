"""Repulsion of magnetic dipoles with parallel moments normal to the plane of the bed.

Let q be the moment relative to the first species. In natural units, the force on i from j is
(3/4) q_i q_j / r^4 along the line of centres, and the energy is q_i q_j / (4 r^3) [D, eq. 2.7; Yung,
Landecker and Villani 1998, doi:10.1155/1998/79537]. [D, eq. 2.6] is misprinted with 1/r; the correct power
is 1/r^4.
"""

from __future__ import annotations

from granular.effects.effect import ForceEffect, recorded_energy_variable
from granular.pairs.disc_law import Disc
from granular.schema.apparatus import Grains


class Dipole(ForceEffect):
    """Dipole repulsion between all grains, without parameters: the moments are properties of the grains."""

    key = "dipole"
    periodic = True
    energy_record = recorded_energy_variable("pair_energy", "energy of the magnetic pairs")


def discs_unless_dipoles(grains: Grains, length: float) -> tuple[Disc, ...]:
    """Return each species' magnet as a disc, with ``length`` [m] as unit; an empty tuple for dipoles."""
    return () if grains.magnets == "dipoles" else species_discs(grains, length)


def species_discs(grains: Grains, length: float) -> tuple[Disc, ...]:
    """Magnet of each species as a disc, with ``length`` [m] as the unit of length."""
    magnets = grains.magnets_in_species()
    return tuple(Disc(0.5 * magnet.diameter / length, magnet.thickness / length) for magnet in magnets)
