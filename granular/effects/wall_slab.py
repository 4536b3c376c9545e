"""The finite magnetic slab: a line of dipoles of a given length.

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
from typing import TYPE_CHECKING, NamedTuple

from granular.compiled import Array, compiled, entry
from granular.effects.wall_infinite import InfiniteWall
from granular.effects.wall_side import WallView, distance_from_wall, position_along_wall, push_grain
from granular.pairs.grain_arrays import value_or_one

if TYPE_CHECKING:
    from jaxtyping import Float

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
