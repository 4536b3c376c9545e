"""Contact of two grains closer than the sum of their radii: Hertz's law with a dashpot.

At an overlap d the force is k d^(3/2) and the energy (2/5) k d^(5/2). Here k = (4/3) E* sqrt(R*) and R* = R1
R2/(R1 + R2) for grains of radii R1 and R2 (Johnson, Contact Mechanics, 1985). The dashpot coefficient eta =
alpha sqrt(m* k) d^(1/4), with the reduced mass m*, applies to the normal velocity. With alpha = -sqrt(5) ln e
/ sqrt(ln(e)^2 + pi^2), the coefficient of restitution is e at every impact speed (Antypov and Elliott 2011,
doi:10.1209/0295-5075/94/50004).

The dashpots are solved exactly, one pair after another, at fixed positions. The second half of a step treats
the pairs in reverse order, so that the step is symmetric in time.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects.dipole import discs_unless_dipoles
from granular.effects.effect import DissipativeEffect, EffectContext, ForceEffect, recorded_energy_variable
from granular.kernel_data.state import LOSSES, Bed, Constants, State
from granular.pairs.dipole_law import ENERGY, pair_energy
from granular.pairs.disc_law import disc_energy_and_force
from granular.pairs.grain_arrays import value_or_one
from granular.pairs.near_list import NearList, allocate_near_list, pair_displacement, refresh_near_list
from granular.schema.sections import quantity
from granular.shared.array_types import Float


class Contact(ForceEffect, DissipativeEffect):
    """Hertzian contact between grains; it acts only if the scene lists it.

    Attributes
    ----------
    modulus : float
        Effective modulus E* of the pair [Pa]. It is about 1e11 for real magnets; a softer contact
        allows longer time steps.
    restitution : float
        Coefficient of restitution e: ratio of the relative speeds after and before an impact.
    """

    key = "contact"
    rank = 1
    periodic = True
    example: ClassVar[Any] = {"modulus": "1 MPa", "restitution": 0.8}
    dry = True  # the dashpots are solved pair by pair
    energy_record = recorded_energy_variable("contact_energy", "energy of the contacts")
    loss_record = recorded_energy_variable("contact_loss", "energy lost in contacts")

    modulus: float = quantity("Pa", above=0.0)
    restitution: float = quantity("1", default=0.5, above=0.0, most=1.0)

    def make_kernel_law(self, context: EffectContext) -> ContactLaw:
        """Make the law for the compiled loop, in natural units."""
        scales = context.scales
        diameters = np.array([specy.diameter for specy in context.grains.species]) / scales.length
        logarithm = math.log(self.restitution)
        alpha = -math.sqrt(5.0) * logarithm / math.hypot(logarithm, math.pi)
        return ContactLaw(
            modulus=4.0 / 3.0 * self.modulus * scales.length**2 / scales.force,
            alpha=alpha,
            radius=0.5 * diameters[context.species],
            widest=float(diameters.max()),
            barrier=_lowest_magnetic_energy_of_touching_pair_per_squared_moment(context, diameters),
            periods=context.periods,
        )


def _lowest_magnetic_energy_of_touching_pair_per_squared_moment(
    context: EffectContext, diameters: Float[np.ndarray, "s"]
) -> float:
    """Minimum magnetic energy [F* D] of equal grains in contact, per squared moment; 0 without dipoles."""
    if "dipole" not in context.effects:
        return 0.0
    discs = discs_unless_dipoles(context.grains, context.scales.length)
    if not discs:
        return pair_energy(float(diameters.min()))
    touching = [
        disc_energy_and_force(np.array([diameter]), disc, disc)[0][0]
        for disc, diameter in zip(discs, diameters, strict=True)
    ]
    return ENERGY * float(min(touching))


class ContactLaw(NamedTuple):
    """Contact in natural units, for the compiled loop."""

    modulus: float  # [F*/D^2]
    alpha: float
    radius: Float[Array, "n"]  # [D]
    widest: float  # [D]
    barrier: float  # magnetic energy at contact, per squared moment [F* D]
    periods: tuple[float, float] | None  # side lengths of a periodic cell [D]

    def workspace(self, size: int, count: int) -> NearList:
        """Make the list of near pairs, which may touch."""
        return allocate_near_list(count, self.widest, periods=self.periods, radius=self.radius)

    @staticmethod
    @compiled
    def add_forces(law: ContactLaw, near: NearList, index: int, bed: Bed, time: float) -> int:
        """Add the Hertzian forces of the grains in contact [F*]; time [tau]."""
        state, grains = bed.state, bed.constants.grains
        if not refresh_near_list(near, state.x, state.y, grains):
            return 1
        for i in range(grains):
            for k in range(near.starts[i], near.starts[i + 1]):
                j = near.partners[k]
                overlap, r, dx, dy = _overlap_distance_and_displacement(law, near, k, i, j, state)
                if overlap > 0.0:
                    spring = hertz_spring_constant(law, law.radius[i], law.radius[j])
                    ratio = hertz_force(spring, overlap) / r
                    state.fx[i] += ratio * dx
                    state.fy[i] += ratio * dy
                    state.fx[j] -= ratio * dx
                    state.fy[j] -= ratio * dy
        return 0

    @staticmethod
    @compiled
    def measure_energy_and_stiffness(
        law: ContactLaw,
        near: NearList,
        index: int,
        bed: Bed,
        time: float,
        stiffness: Float[Array, "m"],
        energies: Float[Array, "laws"],
    ) -> int:
        """Store the energy of the contacts [F* D]; add their stiffness per mass [1/tau^2]."""
        state, masses, total = bed.state, bed.constants.masses, 0.0
        for i in range(bed.constants.grains):
            for k in range(near.starts[i], near.starts[i + 1]):
                j = near.partners[k]
                overlap, _, _, _ = _overlap_distance_and_displacement(law, near, k, i, j, state)
                if overlap > 0.0:
                    spring = hertz_spring_constant(law, law.radius[i], law.radius[j])
                    total += hertz_energy(spring, overlap)
                    # A row sum of the Hessian has the pair's block twice: once on the diagonal, once off it
                    # (Gershgorin).
                    slope = 2.0 * _hertz_stiffness(spring, overlap)
                    stiffness[i] += slope / value_or_one(masses, i)
                    stiffness[j] += slope / value_or_one(masses, j)
        energies[index] = total
        return 0

    @staticmethod
    @compiled
    def damp_velocities(
        law: ContactLaw, near: NearList, index: int, dt: float, bed: Bed, opens_step: bool
    ) -> int:
        """Apply the dashpots to the normal velocities of grains in contact; dt [tau]."""
        grains = bed.constants.grains
        for turn in range(grains):
            # In reverse order when a step closes: dashpots that share a grain do not commute.
            i = turn if opens_step else grains - 1 - turn
            begin, end = near.starts[i], near.starts[i + 1]
            for passed in range(end - begin):
                k = begin + passed if opens_step else end - 1 - passed
                _damp_normal_velocity_of_pair(law, near, index, dt, bed, i, k)
        return 0

    @staticmethod
    @compiled
    def squared_head_on_impact_frequency(
        law: ContactLaw, workspace: None, index: int, speed: float, constants: Constants
    ) -> float:
        """Squared maximum angular frequency [1/tau^2] in a head-on impact of two grains; speed [D/tau]."""
        reduced = 0.5 * constants.minimum_mass
        # Both grains move at ``speed``, so the relative speed is twice as high: the kinetic energy in the
        # centre-of-mass frame is (1/2) m* (2 v)^2.
        remaining = 2.0 * reduced * speed * speed - law.barrier * constants.minimum_moment**2
        if remaining <= 0.0:
            return 0.0
        k = hertz_spring_constant(law, 0.5 * law.widest, 0.5 * law.widest)
        # The maximum overlap d follows from (2/5) k d^(5/2) = remaining.
        return _hertz_stiffness(k, (2.5 * remaining / k) ** 0.4) / reduced


@compiled(inline=True)
def _overlap_distance_and_displacement(
    law: ContactLaw, near: NearList, k: int, i: int, j: int, state: State
) -> tuple[float, float, float, float]:
    """Return a listed pair's overlap, the distance of the centres and their displacement x, y [D]."""
    dx, dy = pair_displacement(near.shifts, k, state.x[i] - state.x[j], state.y[i] - state.y[j])
    r = math.sqrt(dx * dx + dy * dy)
    return law.radius[i] + law.radius[j] - r, r, dx, dy


@compiled
def _damp_normal_velocity_of_pair(
    law: ContactLaw, near: NearList, index: int, dt: float, bed: Bed, i: int, k: int
) -> None:
    """Apply the dashpot to the normal velocity of a listed pair."""
    state, masses, j = bed.state, bed.constants.masses, near.partners[k]
    overlap, r, dx, dy = _overlap_distance_and_displacement(law, near, k, i, j, state)
    if overlap > 0.0:
        first, second = value_or_one(masses, i), value_or_one(masses, j)
        mass = first * second / (first + second)
        spring = hertz_spring_constant(law, law.radius[i], law.radius[j])
        nx, ny = dx / r, dy / r
        speed = (state.vx[i] - state.vx[j]) * nx + (state.vy[i] - state.vy[j]) * ny
        decay = dashpot_decay_factor(law, spring, overlap, mass, dt)
        impulse = mass * (decay - 1.0) * speed
        state.vx[i] += impulse / first * nx
        state.vy[i] += impulse / first * ny
        state.vx[j] -= impulse / second * nx
        state.vy[j] -= impulse / second * ny
        state.ledger[LOSSES + index] += 0.5 * mass * speed * speed * (1.0 - decay * decay)


@compiled
def hertz_spring_constant(law: ContactLaw, first: float, second: float) -> float:
    """Spring constant k [F*/D^(3/2)] of two grains in contact; ``first`` and ``second``: radii [D]."""
    return law.modulus * math.sqrt(first * second / (first + second))


@compiled
def hertz_force(k: float, overlap: float) -> float:
    """Repulsion k d^(3/2) of two grains at an overlap d [F*]; k [F*/D^(3/2)], overlap [D]."""
    return k * overlap * math.sqrt(overlap)


@compiled
def hertz_energy(k: float, overlap: float) -> float:
    """Energy (2/5) k d^(5/2) of two grains at an overlap d [F* D]; k [F*/D^(3/2)], overlap [D]."""
    return 0.4 * k * overlap * overlap * math.sqrt(overlap)


@compiled
def _hertz_stiffness(k: float, overlap: float) -> float:
    """Contact stiffness d(force)/d(overlap) [F*/D]; k [F*/D^(3/2)], overlap [D]."""
    return 1.5 * k * math.sqrt(overlap)


@compiled
def dashpot_decay_factor(law: ContactLaw, k: float, overlap: float, mass: float, dt: float) -> float:
    """Remaining fraction of the normal velocity after dt [tau]; k [F*/D^(3/2)], overlap [D]."""
    # eta/m* with eta = alpha sqrt(m* k) d^(1/4) (Antypov and Elliott 2011).
    rate = law.alpha * math.sqrt(k / mass) * math.sqrt(math.sqrt(overlap))
    return math.exp(-rate * dt)
