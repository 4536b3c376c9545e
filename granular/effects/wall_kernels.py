"""The laws of all sides of the cell together: forces, energies and stiffness.

The force on every wall is the sum of the reactions of the grains; the force on the piston is the
sum of those of its sides, upwards.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import greatest_of_hooks, sum_of_hooks
from granular.effects.wall_side import Side
from granular.kernel_data.constants import Constants, multiply_by_moment_over_mass
from granular.kernel_data.state import Bed
from granular.pairs.grain_arrays import value_or_one

if TYPE_CHECKING:
    from jaxtyping import Float

_add_forces = sum_of_hooks("add_forces", "bed")
_measure_energy = sum_of_hooks("measure_energy", "bed stiffness", 0.0)
_add_stiffness_against_body = sum_of_hooks("add_stiffness_against_body", "bed body slopes", 0.0)
_upward_force = sum_of_hooks("upward_force", "forces body", 0.0)
_turning_point_stiffness = greatest_of_hooks("turning_point_stiffness", "speed")


class WallLaws(NamedTuple):
    """The sides of the cell, with their laws."""

    sides: tuple[Side, ...]

    @staticmethod
    @compiled(inline=True)
    def add_forces(law: WallLaws, workspace: None, index: int, bed: Bed, time: float) -> int:
        """Add the walls' forces on the grains, and enter the force on each wall [F*]; time [tau]."""
        return _add_forces(law.sides, law.sides, bed)

    @staticmethod
    @compiled
    def measure_energy_and_stiffness(
        law: WallLaws,
        workspace: None,
        index: int,
        bed: Bed,
        time: float,
        stiffness: Float[Array, "m"],
        energies: Float[Array, "laws"],
    ) -> int:
        """Enter the energy of the grains at the walls [F* D], and add their stiffness [1/tau^2]."""
        constants = bed.constants
        # Before the walls, so that what the other effects entered is whole again after the multiplication.
        _undo_moment_over_mass(stiffness, constants.moments, constants.masses, constants.grains)
        energies[index] = _measure_energy(law.sides, law.sides, bed, stiffness)
        multiply_by_moment_over_mass(stiffness, constants.moments, constants.masses, constants.grains)
        return 0

    @staticmethod
    @compiled
    def squared_head_on_impact_frequency(
        law: WallLaws, workspace: None, index: int, speed: float, constants: Constants
    ) -> float:
        """Largest stiffness over mass of a grain at any wall [1/tau^2], at that speed [D/tau]."""
        # Energy q U(w) = m v^2/2: per moment a grain of small q/m comes as near as one of the first species
        # at v/sqrt(q/m).
        ratio = constants.least_ratio
        return ratio * _turning_point_stiffness(law.sides, law.sides, speed / math.sqrt(ratio))


@compiled(inline=True)
def force_on_body(bed: Bed, body: int) -> float:
    """Upward force of the grains on the sides of a body [F*]."""
    sides = bed.constants.acting.sides
    return _upward_force(sides, sides, bed.state.wall_forces, body)


@compiled(inline=True)
def add_body_stiffness(bed: Bed, body: int, slopes: Float[Array, "m"]) -> None:
    """Add each grain's stiffness against the sides of a body over its mass; slopes [1/tau^2]."""
    constants = bed.constants
    _add_stiffness_against_body(constants.acting.sides, constants.acting.sides, bed, body, slopes)
    multiply_by_moment_over_mass(slopes, constants.moments, constants.masses, constants.grains)


@compiled
def _undo_moment_over_mass(stiffness: Array, moments: Array | None, masses: Array | None, count: int) -> None:
    """Undo `multiply_by_moment_over_mass`: for terms of the walls that count a grain's moment as 1."""
    if moments is not None:
        for i in range(count):
            stiffness[i] *= value_or_one(masses, i) / moments[i]
