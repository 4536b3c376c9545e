"""The laws of the four walls together: forces, energies and stiffness.

The force on every wall is the sum of the reactions of the grains; that of the top wall is the
piston force.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

from granular.compiled import Array, compiled
from granular.compiled.hook_calls import call_hook
from granular.effects.wall_side import (
    BOTTOM,
    LEFT,
    RIGHT,
    TOP,
    WallSide,
    add_normal_wall_forces,
    add_wall_energies,
    sides_of_cell,
    zero_of_no_law,
)
from granular.kernel_data.constants import Constants, multiply_by_moment_over_mass, relative_moments
from granular.kernel_data.state import Bed
from granular.pairs.direct_vector_loops import reproducible_sum
from granular.pairs.grain_arrays import value_or_one

if TYPE_CHECKING:
    from jaxtyping import Float


class WallLaws(NamedTuple):
    """The law of each side; None is open."""

    left: Any
    right: Any
    bottom: Any
    top: Any

    @staticmethod
    @compiled(inline=True)
    def add_forces(law: WallLaws, workspace: None, index: int, bed: Bed, time: float) -> int:
        """Add the walls' forces on the grains, and enter the force on each wall [F*]; time [tau]."""
        left, right, bottom, top = sides_of_cell(bed)
        return (
            _add_side_forces(law.left, LEFT, left, bed)
            + _add_side_forces(law.right, RIGHT, right, bed)
            + _add_side_forces(law.bottom, BOTTOM, bottom, bed)
            + _add_side_forces(law.top, TOP, top, bed)
        )

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
        left, right, bottom, top = sides_of_cell(bed)
        # Before the walls, so that what the other effects entered is whole again after the multiplication.
        _undo_moment_over_mass(stiffness, constants.moments, constants.masses, constants.grains)
        energies[index] = (
            _measure_wall_energy(law.left, left, bed, stiffness)
            + _measure_wall_energy(law.right, right, bed, stiffness)
            + _measure_wall_energy(law.bottom, bottom, bed, stiffness)
            + _measure_wall_energy(law.top, top, bed, stiffness)
        )
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
        speed /= math.sqrt(ratio)
        return ratio * max(
            _turning_point_stiffness(law.left, speed),
            _turning_point_stiffness(law.right, speed),
            _turning_point_stiffness(law.bottom, speed),
            _turning_point_stiffness(law.top, speed),
        )


@compiled(inline=True)
def add_piston_stiffness(law: Any, bed: Bed, slopes: Float[Array, "m"]) -> None:
    """Add each grain's stiffness against the piston over its mass; slopes [1/tau^2]."""
    constants = bed.constants
    if law is not None:
        _measure_wall_energy(law, sides_of_cell(bed)[TOP], bed, slopes)
    multiply_by_moment_over_mass(slopes, constants.moments, constants.masses, constants.grains)


@compiled
def _undo_moment_over_mass(stiffness: Array, moments: Array | None, masses: Array | None, count: int) -> None:
    """Undo `multiply_by_moment_over_mass`: for terms of the walls that count a grain's moment as 1."""
    if moments is not None:
        for i in range(count):
            stiffness[i] *= value_or_one(masses, i) / moments[i]


_forces = call_hook("add_forces", "count moments side normal", add_normal_wall_forces)
_energies = call_hook("measure_energy_and_stiffness", "count side stiffness energies", add_wall_energies)


_turning_point_stiffness = call_hook("turning_point_stiffness", "speed", zero_of_no_law)


@compiled(inline=True)
def _add_side_forces(law: Any, which: int, side: WallSide, bed: Bed) -> int:
    if law is None:
        return 0
    state, constants = bed.state, bed.constants
    outside = _forces(law, constants.grains, relative_moments(constants), side, state.scratch)
    state.wall_forces[which] = reproducible_sum(state.scratch)
    # Behind a wall the force may be no number, and at it infinite, so the total tells.
    return outside + (not state.wall_forces[which] < math.inf)


@compiled
def _measure_wall_energy(law: Any, side: WallSide, bed: Bed, stiffness: Array) -> float:
    if law is None:
        return 0.0
    energies, constants = bed.state.scratch, bed.constants
    moments = relative_moments(constants)
    _energies(law, constants.grains, side, stiffness, energies)
    for i in range(constants.grains):
        energies[i] *= value_or_one(moments, i)
    return reproducible_sum(energies)
