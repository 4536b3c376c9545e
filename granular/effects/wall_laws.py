"""Wall laws of the cell: forces, energies and stiffness of one side, and of all sides together.

All formulas are in natural units, for a grain with the moment q relative to the first species. The force on
each wall is the sum of the reactions of the grains; the force on the piston is the sum of the upward forces
on its sides.

**Experimental wall**, a power law fitted to measurements. Force on a grain at distance w: (1/2) q / w^3.5
along the normal; energy (1/5) q / w^2.5 [D, eq. 2.8]. The dimensions of eq. 2.8 as printed are inconsistent;
the form used here reproduces the published forces.

**Infinite wall**, a half plane of dipoles.
Force on a grain at distance w: q / w^3 along the normal; energy q / (2 w^2) [D, eq. 3.3].

**Finite magnetic slab**, a line of dipoles of a given length. Let w be the distance from the line, and a and
b the signed distances of the grain's projection from the slab's two ends (both positive if the projection
lies on the slab). The energy is

    q / (4 w^2) [a / sqrt(w^2 + a^2) + b / sqrt(w^2 + b^2)].

The normal force is [D, eq. 3.17], which de Paula gives for positive a and b; a power in [D, eq. 3.16] is
misprinted. The slab also exerts a tangential force, which de Paula does not give, but without which energy
would not be conserved: (q/4) [(w^2 + b^2)^-3/2 - (w^2 + a^2)^-3/2] in the direction of increasing a. For a
long slab, the law tends to the law of the infinite wall.

Beyond an end (a or b negative), the two terms nearly cancel close to the line. The difference is then
computed in a closed form without cancellation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from granular.compiled import Array, compiled, entry
from granular.compiled.hook_calls import make_hook_maximum_kernel, make_hook_sum_kernel
from granular.effects.wall_side import (
    GrainsRelativeToWall,
    Side,
    add_wall_force_to_grain,
    distance_from_wall,
    position_along_wall,
)
from granular.kernel_data.state import Bed, Constants, multiply_by_moment_over_mass
from granular.pairs.grain_arrays import value_or_one
from granular.shared.array_types import Float

_add_forces = make_hook_sum_kernel("add_forces", "bed")
_measure_energy = make_hook_sum_kernel("energy_and_add_stiffness", "bed stiffness", 0.0)
_add_stiffness_against_body = make_hook_sum_kernel("add_stiffness_against_body", "bed body slopes", 0.0)
_upward_force = make_hook_sum_kernel("upward_force", "forces body", 0.0)
_turning_point_stiffness = make_hook_maximum_kernel("turning_point_stiffness", "speed")


class CellSidesWithLaws(NamedTuple):
    """Sides of the cell with their wall laws, for the compiled loop."""

    sides: tuple[Side, ...]

    @staticmethod
    @compiled(inline=True)
    def add_forces(law: CellSidesWithLaws, workspace: None, index: int, bed: Bed, time: float) -> int:
        """Add the walls' forces to the grains, and store the force on each wall [F*]; time [tau]."""
        return _add_forces(law.sides, law.sides, bed)

    @staticmethod
    @compiled
    def measure_energy_and_stiffness(
        law: CellSidesWithLaws,
        workspace: None,
        index: int,
        bed: Bed,
        time: float,
        stiffness: Float[Array, "m"],
        energies: Float[Array, "laws"],
    ) -> int:
        """Store the energy of the grains at the walls [F* D]; add their stiffness per mass [1/tau^2]."""
        constants = bed.constants
        # The multiplication below then applies only to the walls, not to the other effects' stiffness.
        _undo_multiplication_by_moment_over_mass(
            stiffness, constants.moments, constants.masses, constants.grains
        )
        energies[index] = _measure_energy(law.sides, law.sides, bed, stiffness)
        multiply_by_moment_over_mass(stiffness, constants.moments, constants.masses, constants.grains)
        return 0

    @staticmethod
    @compiled
    def squared_head_on_impact_frequency(
        law: CellSidesWithLaws, workspace: None, index: int, speed: float, constants: Constants
    ) -> float:
        """Maximum ratio of stiffness to mass [1/tau^2] of a grain that hits any wall; speed [D/tau]."""
        # From q U(w) = m v^2/2, a grain of small q/m comes as close as a grain of the first species with
        # the speed v/sqrt(q/m).
        ratio = constants.minimum_ratio
        return ratio * _turning_point_stiffness(law.sides, law.sides, speed / math.sqrt(ratio))


@compiled(inline=True)
def upward_force_of_grains_on_body(bed: Bed, body: int) -> float:
    """Upward force of the grains on the sides of a body [F*]."""
    sides = bed.constants.acting.sides
    return _upward_force(sides, sides, bed.state.wall_forces, body)


@compiled(inline=True)
def add_stiffness_at_sides_of_body(bed: Bed, body: int, slopes: Float[Array, "m"]) -> None:
    """Add to ``slopes`` each grain's stiffness per mass [1/tau^2] due to the sides of a body."""
    constants = bed.constants
    _add_stiffness_against_body(constants.acting.sides, constants.acting.sides, bed, body, slopes)
    multiply_by_moment_over_mass(slopes, constants.moments, constants.masses, constants.grains)


@compiled
def _undo_multiplication_by_moment_over_mass(
    stiffness: Array, moments: Array | None, masses: Array | None, count: int
) -> None:
    """Undo `multiply_by_moment_over_mass`, since wall terms are added for grains of moment 1."""
    if moments is not None:
        for i in range(count):
            stiffness[i] *= value_or_one(masses, i) / moments[i]


# Force of [D, eq. 2.8]; energy and stiffness are its integral and slope.
STRENGTH = 0.5
ENERGY = STRENGTH / 2.5
STIFFNESS = STRENGTH * 3.5


class ExperimentalWall(NamedTuple):
    """Experimental wall, for the compiled loop."""

    @staticmethod
    @compiled(inline=True)
    def is_behind(law: object, w: float) -> bool:
        """Return False: no test is needed, because the force behind this wall is NaN; w [D]."""
        return False

    @staticmethod
    @entry
    def force(law: object, w: float) -> float:
        """Repulsion 1/(2 w^3.5) of a grain of the first species [F*]; w [D] (de Paula, eq. 2.8)."""
        return STRENGTH / (w * w * w * math.sqrt(w))

    @staticmethod
    @entry
    def energy(law: object, w: float) -> float:
        """Energy 1/(5 w^2.5) of a grain of the first species [F* D]; w [D] (de Paula, eq. 2.8)."""
        return ENERGY / (w * w * math.sqrt(w))

    @staticmethod
    @entry
    def stiffness(law: object, w: float) -> float:
        """Stiffness 7/(4 w^4.5) of a grain of the first species [F*/D]; w [D]."""
        w2 = w * w
        return STIFFNESS / (w2 * w2 * math.sqrt(w))

    @staticmethod
    @entry
    def turning_point_stiffness(law: object, speed: float) -> float:
        """Stiffness per mass [1/tau^2] at the turning point, at which U(w) = v^2/2; speed v [D/tau]."""
        return STIFFNESS * (speed * speed / (2.0 * ENERGY)) ** 1.8


class InfiniteWall(NamedTuple):
    """Infinite wall, for the compiled loop."""

    @staticmethod
    @entry
    def force(law: object, w: float) -> float:
        """Repulsion 1/w^3 of a grain of the first species [F*]; w [D] (de Paula, eq. 3.3)."""
        return 1.0 / (w * w * w)

    @staticmethod
    @entry
    def energy(law: object, w: float) -> float:
        """Energy 1/(2 w^2) of a grain of the first species [F* D]; w [D] (de Paula, eq. 3.3)."""
        return 0.5 / (w * w)

    @staticmethod
    @entry
    def stiffness(law: object, w: float) -> float:
        """Stiffness 3/w^4 of a grain of the first species [F*/D]; w [D]."""
        w2 = w * w
        return 3.0 / (w2 * w2)

    @staticmethod
    @entry
    def turning_point_stiffness(law: object, speed: float) -> float:
        """Stiffness per mass [1/tau^2] at the turning point, at which 1/(2 w^2) = v^2/2; speed v [D/tau]."""
        square = speed * speed
        return 3.0 * square * square


_infinite_wall_stiffness = InfiniteWall.turning_point_stiffness


@compiled
def _quadrupled_energy_decrease_by_wall_end(w: float, a: float) -> float:
    """Return (1 - a/sqrt(w^2 + a^2))/w^2, four times the decrease in energy if a wall ends at a."""
    root = math.sqrt(w * w + a * a)
    return 1.0 / (root * (root + a))


@compiled
def _quadrupled_force_decrease_by_wall_end(w: float, a: float) -> float:
    """Return four times the decrease in normal force if an infinite wall ends at a > 0."""
    q = math.sqrt(1.0 + (w / a) * (w / a))
    return w * (2.0 * q + 1.0) / (a * a * a * a * (q + 1.0) * (q + 1.0) * q * q * q)


@entry
def slab_energy(w: float, a: float, b: float) -> float:
    """Energy of a grain of the first species at a slab [F* D]; w, a, b [D]."""
    if a >= 0.0 and b >= 0.0:
        w2 = w * w
        return 0.25 / w2 * (a / math.sqrt(w2 + a * a) + b / math.sqrt(w2 + b * b))
    if a < 0.0:
        a, b = b, a
    return 0.25 * (
        _quadrupled_energy_decrease_by_wall_end(w, -b) - _quadrupled_energy_decrease_by_wall_end(w, a)
    )


@entry
def slab_normal_force(w: float, a: float, b: float) -> float:
    """Return the normal force of a slab on a grain of the first species [F*]; w, a, b [D]."""
    if a >= 0.0 and b >= 0.0:
        w2 = w * w
        ra, rb = math.sqrt(w2 + a * a), math.sqrt(w2 + b * b)
        # [D, eq. 3.17]; eq. 3.16 misprints a power.
        near = a * (3.0 * w2 + 2.0 * a * a) / (ra * ra * ra)
        far = b * (3.0 * w2 + 2.0 * b * b) / (rb * rb * rb)
        return 0.25 * (near + far) / (w2 * w)
    if a < 0.0:
        a, b = b, a
    return 0.25 * (
        _quadrupled_force_decrease_by_wall_end(w, -b) - _quadrupled_force_decrease_by_wall_end(w, a)
    )


@entry
def slab_tangential_force(w: float, a: float, b: float) -> float:
    """Tangential force of a slab on a grain of the first species, towards larger a [F*]; w, a, b [D]."""
    w2 = w * w
    ra, rb = math.sqrt(w2 + a * a), math.sqrt(w2 + b * b)
    return 0.25 * (1.0 / (rb * rb * rb) - 1.0 / (ra * ra * ra))


@entry
def slab_stiffness_bound(w: float, a: float, b: float) -> float:
    """Upper bound of a slab's stiffness [F*/D], computed from its nearest point; w, a, b [D]."""
    beyond = max(0.0, -min(a, b))
    square = w * w + beyond * beyond
    return 3.0 / (square * square)


class SlabWall(NamedTuple):
    """One or two slabs in a line, for the compiled loop."""

    starts: Float[Array, "k"]  # of each slab along the wall [D]
    ends: Float[Array, "k"]  # [D]
    closed: bool  # whether there is no gap, so that no grain can be behind the wall

    @staticmethod
    @compiled(inline=True)
    def add_forces(
        law: SlabWall,
        count: int,
        moments: Float[Array, "m"] | None,
        view: GrainsRelativeToWall,
        normal: Float[Array, "m"],
    ) -> int:
        """Add the slabs' forces to the grains; store the normal forces in ``normal`` [F*]."""
        outside = 0
        for i in range(count):
            w, along = distance_from_wall(view, i), position_along_wall(view, i)
            normal[i], tangential, moment = 0.0, 0.0, value_or_one(moments, i)
            for k in range(law.starts.size):
                a, b = along - law.starts[k], law.ends[k] - along
                normal[i] += slab_normal_force(w, a, b)
                tangential += slab_tangential_force(w, a, b)
            normal[i] *= moment
            add_wall_force_to_grain(view, i, normal[i], moment * tangential)
            outside += (not w > 0.0) if law.closed else (not abs(w) >= 0.0)
        return outside

    @staticmethod
    @compiled
    def measure_energy_and_stiffness(
        law: SlabWall,
        count: int,
        view: GrainsRelativeToWall,
        slopes: Float[Array, "m"],
        energies: Float[Array, "m"],
    ) -> None:
        """Store the energies [F* D] of grains of moment 1; add upper bounds of their stiffness [F*/D]."""
        for i in range(count):
            w, along = distance_from_wall(view, i), position_along_wall(view, i)
            energies[i] = 0.0
            for k in range(law.starts.size):
                a, b = along - law.starts[k], law.ends[k] - along
                energies[i] += slab_energy(w, a, b)
                slopes[i] += slab_stiffness_bound(w, a, b)

    @staticmethod
    @compiled
    def turning_point_stiffness(law: SlabWall, speed: float) -> float:
        """Upper bound of the stiffness per mass [1/tau^2] at the turning point of a grain; speed [D/tau]."""
        # At the end of a slab the energy is half the infinite wall's: a grain comes closer by a factor
        # sqrt(2), and 3/w^4 is 4 times as large.
        return 4.0 * _infinite_wall_stiffness(None, speed)
