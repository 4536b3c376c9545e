"""The laws of the cell's walls: forces, energies and stiffness of one side, and of all sides together.

The force on every wall is the sum of the reactions of the grains; the force on the piston is the
sum of those of its sides, upwards.

The experimental wall: a power law fitted to measurements.

Force on a grain at the distance w: (1/2) q / w^3.5 along the normal; energy (1/5) q / w^2.5
[D, eq. 2.8, in the reading that reproduces the published forces: as printed its dimensions do not
match].

The infinite wall: a half plane of dipoles.

Force on a grain at the distance w: q / w^3 along the normal; energy q / (2 w^2) [D, eq. 3.3].

The finite magnetic slab: a line of dipoles of a given length.

With w the distance from the line, and a and b the signed distances of the grain's projection from
the slab's two ends (both positive above the slab), the energy is

    q / (4 w^2) [a / sqrt(w^2 + a^2) + b / sqrt(w^2 + b^2)].

Its normal force is [D, eq. 3.17] (there for a and b positive; [D, eq. 3.16] misprints a power).
De Paula gives the normal force only; the slab also pushes along itself, by
(q/4) [(w^2 + b^2)^-3/2 - (w^2 + a^2)^-3/2] towards the end that a is counted from, without which
energy would not be conserved. It tends to the infinite wall as the slab grows.

Beyond an end (a or b negative) the two terms nearly cancel close to the line; there the difference
is written out, so that nothing is lost to rounding.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from granular.compiled import Array, compiled, entry
from granular.compiled.hook_calls import greatest_of_hooks, sum_of_hooks
from granular.effects.wall_side import Side, WallView, distance_from_wall, position_along_wall, push_grain
from granular.kernel_data.state import Bed, Constants, multiply_by_moment_over_mass
from granular.pairs.grain_arrays import value_or_one
from granular.shared.array_types import Float

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


# [D, eq. 2.8]; energy and stiffness are its integral and slope.
STRENGTH = 0.5
ENERGY = STRENGTH / 2.5
STIFFNESS = STRENGTH * 3.5


class ExperimentalWall(NamedTuple):
    """The law as the kernels take it."""

    @staticmethod
    @compiled(inline=True)
    def is_behind(law: object, w: float) -> bool:
        """Return False: behind the wall the force is no number, so that the total tells; w [D]."""
        return False

    @staticmethod
    @entry
    def force(law: object, w: float) -> float:
        """Force 1/(2 w^3.5) away from the wall on a grain of the first species, [D, eq. 2.8] [F*]; w [D]."""
        return STRENGTH / (w * w * w * math.sqrt(w))

    @staticmethod
    @entry
    def energy(law: object, w: float) -> float:
        """Energy 1/(5 w^2.5) of a grain of the first species at the wall, [D, eq. 2.8] [F* D]; w [D]."""
        return ENERGY / (w * w * math.sqrt(w))

    @staticmethod
    @entry
    def stiffness(law: object, w: float) -> float:
        """Minus the slope of the force, 7/(4 w^4.5), of a grain of the first species [F*/D]; w [D]."""
        w2 = w * w
        return STIFFNESS / (w2 * w2 * math.sqrt(w))

    @staticmethod
    @entry
    def turning_point_stiffness(law: object, speed: float) -> float:
        """Stiffness per mass [1/tau^2] where a grain of this speed [D/tau] turns: U(w) = v^2/2."""
        return STIFFNESS * (speed * speed / (2.0 * ENERGY)) ** 1.8


class InfiniteWall(NamedTuple):
    """The law as the kernels take it."""

    @staticmethod
    @entry
    def force(law: object, w: float) -> float:
        """Force 1/w^3 away from the wall on a grain of the first species, [D, eq. 3.3] [F*]; w [D]."""
        return 1.0 / (w * w * w)

    @staticmethod
    @entry
    def energy(law: object, w: float) -> float:
        """Energy 1/(2 w^2) of a grain of the first species at the wall, [D, eq. 3.3] [F* D]; w [D]."""
        return 0.5 / (w * w)

    @staticmethod
    @entry
    def stiffness(law: object, w: float) -> float:
        """Minus the slope of the force, 3/w^4, of a grain of the first species [F*/D]; w [D]."""
        w2 = w * w
        return 3.0 / (w2 * w2)

    @staticmethod
    @entry
    def turning_point_stiffness(law: object, speed: float) -> float:
        """Stiffness per mass [1/tau^2] where a grain of this speed [D/tau] turns: 1/(2 w^2) = v^2/2."""
        square = speed * speed
        return 3.0 * square * square


_endless = InfiniteWall.turning_point_stiffness


@compiled
def _end_energy_decrease(w: float, a: float) -> float:
    """(1 - a/sqrt(w^2 + a^2))/w^2: decrease of an endless wall's energy at an end, times 4."""
    root = math.sqrt(w * w + a * a)
    return 1.0 / (root * (root + a))


@compiled
def _end_force_decrease(w: float, a: float) -> float:
    """Decrease of an endless wall's normal force at an end, times 4; for a > 0."""
    q = math.sqrt(1.0 + (w / a) * (w / a))
    return w * (2.0 * q + 1.0) / (a * a * a * a * (q + 1.0) * (q + 1.0) * q * q * q)


@entry
def energy(w: float, a: float, b: float) -> float:
    """Energy of a grain of the first species at a slab [F* D]; w, a, b [D]."""
    if a >= 0.0 and b >= 0.0:
        w2 = w * w
        return 0.25 / w2 * (a / math.sqrt(w2 + a * a) + b / math.sqrt(w2 + b * b))
    if a < 0.0:
        a, b = b, a
    return 0.25 * (_end_energy_decrease(w, -b) - _end_energy_decrease(w, a))


@entry
def normal_force(w: float, a: float, b: float) -> float:
    """Force of a slab on a grain of the first species, away from its line [F*]; w, a, b [D]."""
    if a >= 0.0 and b >= 0.0:
        w2 = w * w
        ra, rb = math.sqrt(w2 + a * a), math.sqrt(w2 + b * b)
        # [D, eq. 3.17]; eq. 3.16 misprints a power.
        near = a * (3.0 * w2 + 2.0 * a * a) / (ra * ra * ra)
        far = b * (3.0 * w2 + 2.0 * b * b) / (rb * rb * rb)
        return 0.25 * (near + far) / (w2 * w)
    if a < 0.0:
        a, b = b, a
    return 0.25 * (_end_force_decrease(w, -b) - _end_force_decrease(w, a))


@entry
def tangential_force(w: float, a: float, b: float) -> float:
    """Force of a slab along itself on a grain of the first species, where a grows [F*]; w, a, b [D]."""
    w2 = w * w
    ra, rb = math.sqrt(w2 + a * a), math.sqrt(w2 + b * b)
    return 0.25 * (1.0 / (rb * rb * rb) - 1.0 / (ra * ra * ra))


@entry
def stiffness(w: float, a: float, b: float) -> float:
    """Bound of the stiffness at a slab: that of an infinite wall at its nearest point [F*/D]; w, a, b [D]."""
    beyond = max(0.0, -min(a, b))
    square = w * w + beyond * beyond
    return 3.0 / (square * square)


class SlabWall(NamedTuple):
    """One or two slabs in a line, as the kernels take them."""

    starts: Float[Array, "k"]  # of each slab along the wall [D]
    ends: Float[Array, "k"]  # [D]
    closed: bool  # no gap: no grain can come behind it

    @staticmethod
    @compiled(inline=True)
    def add_forces(
        law: SlabWall,
        count: int,
        moments: Float[Array, "m"] | None,
        view: WallView,
        normal: Float[Array, "m"],
    ) -> int:
        """Add the forces of the slabs; fill in those away from them, ``normal`` [F*]."""
        outside = 0
        for i in range(count):
            w, along = distance_from_wall(view, i), position_along_wall(view, i)
            normal[i], tangential, moment = 0.0, 0.0, value_or_one(moments, i)
            for k in range(law.starts.size):
                a, b = along - law.starts[k], law.ends[k] - along
                normal[i] += normal_force(w, a, b)
                tangential += tangential_force(w, a, b)
            normal[i] *= moment
            push_grain(view, i, normal[i], moment * tangential)
            outside += (not w > 0.0) if law.closed else (not abs(w) >= 0.0)
        return outside

    @staticmethod
    @compiled
    def measure_energy_and_stiffness(
        law: SlabWall, count: int, view: WallView, slopes: Float[Array, "m"], energies: Float[Array, "m"]
    ) -> None:
        """Fill in energies of grains of moment 1 [F* D], and add bounds of their stiffness [F*/D]."""
        for i in range(count):
            w, along = distance_from_wall(view, i), position_along_wall(view, i)
            energies[i] = 0.0
            for k in range(law.starts.size):
                a, b = along - law.starts[k], law.ends[k] - along
                energies[i] += energy(w, a, b)
                slopes[i] += stiffness(w, a, b)

    @staticmethod
    @compiled
    def turning_point_stiffness(law: SlabWall, speed: float) -> float:
        """Bound of the stiffness where a grain of this speed turns [1/tau^2]; speed [D/tau]."""
        # At its end a slab has half the infinite wall's energy: a grain comes sqrt(2) nearer, and 3/w^4 is 4
        # times as large.
        return 4.0 * _endless(None, speed)
