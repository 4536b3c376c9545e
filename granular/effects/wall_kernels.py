"""The laws of the four walls together: forces, energies and stiffness.

The force on every wall is the sum of the reactions of the grains; that of the top wall is the
piston force.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

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
)
from granular.kernel_data.constants import Constants, multiply_by_moment_over_mass, relative_moments
from granular.kernel_data.state import HEIGHT, Bed
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

    def workspace(self, size: int, count: int) -> Float[np.ndarray, "m"] | None:
        """Make the workspace for the forces along a wall, which slabs and discs alone have."""
        slabs = any(hasattr(law, "add_forces") for law in self)
        return np.zeros(size) if slabs else None

    @staticmethod
    @compiled(inline=True)
    def add_forces(
        law: WallLaws, workspace: Float[Array, "m"] | None, index: int, bed: Bed, time: float
    ) -> int:
        """Add the walls' forces on the grains, and enter the force on each wall [F*]; time [tau]."""
        state, constants = bed.state, bed.constants
        return _add_wall_forces(
            law,
            constants.grains,
            relative_moments(constants),
            state.x,
            state.y,
            state.fx,
            state.fy,
            constants.width,
            state.piston[HEIGHT],
            state.scratch,
            workspace,
            state.wall_forces,
        )

    @staticmethod
    @compiled
    def measure_energy_and_stiffness(
        law: WallLaws,
        workspace: Float[Array, "m"] | None,
        index: int,
        bed: Bed,
        time: float,
        stiffness: Float[Array, "m"],
        energies: Float[Array, "laws"],
    ) -> int:
        """Enter the energy of the grains at the walls [F* D], and add their stiffness [1/tau^2]."""
        state, constants = bed.state, bed.constants
        # Before the walls, so that what the other effects entered is whole again after the multiplication.
        _undo_moment_over_mass(stiffness, constants.moments, constants.masses, constants.grains)
        energies[index] = _measure_wall_energies(
            law,
            constants.grains,
            relative_moments(constants),
            state.x,
            state.y,
            constants.width,
            state.piston[HEIGHT],
            stiffness,
            state.scratch,
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
            _turning_stiffness_of_side(law.left, speed),
            _turning_stiffness_of_side(law.right, speed),
            _turning_stiffness_of_side(law.bottom, speed),
            _turning_stiffness_of_side(law.top, speed),
        )


@compiled
def add_piston_stiffness(law: Any, bed: Bed, slopes: Float[Array, "m"]) -> None:
    """Add each grain's stiffness against the piston over its mass; slopes [1/tau^2]."""
    state, constants = bed.state, bed.constants
    side = WallSide(state.y, state.x, state.piston[HEIGHT], -1.0)
    _measure_wall_energy(law, constants.grains, relative_moments(constants), side, slopes, state.scratch)
    multiply_by_moment_over_mass(slopes, constants.moments, constants.masses, constants.grains)


@compiled
def _undo_moment_over_mass(stiffness: Array, moments: Array | None, masses: Array | None, count: int) -> None:
    """Undo `multiply_by_moment_over_mass`: for terms of the walls that count a grain's moment as 1."""
    if moments is not None:
        for i in range(count):
            stiffness[i] *= value_or_one(masses, i) / moments[i]


@compiled
def _add_no_tangential_forces(
    law: Any, count: int, moments: Array | None, along_force: Array, tangential: Array | None
) -> None:
    """Return the forces along the wall, of a law of the distance alone."""


_forces = call_hook("add_forces", "count moments side force normal tangential", add_normal_wall_forces)
_tangential_forces = call_hook(
    "add_tangential_forces", "count moments along_force tangential", _add_no_tangential_forces
)
_energies = call_hook("measure_energy_and_stiffness", "count side stiffness energies", add_wall_energies)


@compiled
def _zero_turning_point_stiffness(law: Any, speed: float) -> float:
    return 0.0


_turning_stiffness_of_law = call_hook("turning_point_stiffness", "speed", _zero_turning_point_stiffness)


@compiled(inline=True)
def _add_side_forces(
    law: Any,
    which: int,
    count: int,
    moments: Array | None,
    side: WallSide,
    force: Array,
    along_force: Array,
    normal: Array,
    tangential: Array | None,
    wall_forces: Array,
) -> int:
    if law is None:
        return 0
    outside = _forces(law, count, moments, side, force, normal, tangential)
    _tangential_forces(law, count, moments, along_force, tangential)
    wall_forces[which] = reproducible_sum(normal)
    # Behind a wall the force may be no number, and at it infinite, so the total tells.
    return outside + (not wall_forces[which] < math.inf)


@compiled(inline=True)
def _add_wall_forces(
    laws: WallLaws,
    count: int,
    moments: Array | None,
    x: Array,
    y: Array,
    fx: Array,
    fy: Array,
    width: float,
    height: float,
    normal: Array,
    tangential: Array | None,
    wall_forces: Array,
) -> int:
    """Add the forces of all four walls."""
    left, right = WallSide(x, y, 0.0, 1.0), WallSide(x, y, width, -1.0)
    bottom, top = WallSide(y, x, 0.0, 1.0), WallSide(y, x, height, -1.0)
    return (
        _add_side_forces(laws.left, LEFT, count, moments, left, fx, fy, normal, tangential, wall_forces)
        + _add_side_forces(laws.right, RIGHT, count, moments, right, fx, fy, normal, tangential, wall_forces)
        + _add_side_forces(
            laws.bottom, BOTTOM, count, moments, bottom, fy, fx, normal, tangential, wall_forces
        )
        + _add_side_forces(laws.top, TOP, count, moments, top, fy, fx, normal, tangential, wall_forces)
    )


@compiled
def _measure_wall_energy(
    law: Any, count: int, moments: Array | None, side: WallSide, stiffness: Array, energies: Array
) -> float:
    if law is None:
        return 0.0
    _energies(law, count, side, stiffness, energies)
    if moments is not None:
        for i in range(count):
            energies[i] *= moments[i]
    return reproducible_sum(energies)


@compiled
def _measure_wall_energies(
    laws: WallLaws,
    count: int,
    moments: Array | None,
    x: Array,
    y: Array,
    width: float,
    height: float,
    stiffness: Array,
    energies: Array,
) -> float:
    """Energy of the grains at the walls [F* D]; adds each wall's stiffness over the grain's mass."""
    return (
        _measure_wall_energy(laws.left, count, moments, WallSide(x, y, 0.0, 1.0), stiffness, energies)
        + _measure_wall_energy(laws.right, count, moments, WallSide(x, y, width, -1.0), stiffness, energies)
        + _measure_wall_energy(laws.bottom, count, moments, WallSide(y, x, 0.0, 1.0), stiffness, energies)
        + _measure_wall_energy(laws.top, count, moments, WallSide(y, x, height, -1.0), stiffness, energies)
    )


@compiled
def _turning_stiffness_of_side(law: Any, speed: float) -> float:
    if law is None:
        return 0.0
    return _turning_stiffness_of_law(law, speed)
