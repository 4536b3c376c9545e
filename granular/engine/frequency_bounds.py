"""Bounds of the highest angular frequency that the bed has, and that its fastest grains can meet.

The automatic step follows them, and a given step is judged by them.
"""

from __future__ import annotations

import math

from granular.compiled import Array, compiled, entry
from granular.compiled.by_reference import by_reference
from granular.compiled.hook_calls import greatest_of_hooks
from granular.effects.body_table import BodyLaw
from granular.effects.wall_kernels import add_body_stiffness
from granular.kernel_data.constants import Constants
from granular.kernel_data.state import CELL, PISTON, Bed, Measurement
from granular.pairs.dipole_law import head_on_frequency_squared
from granular.pairs.near_law import NearLaw, squared_collision_frequency
from granular.protocol.piston_motion import Motion

_squared_impact_frequency = greatest_of_hooks("squared_head_on_impact_frequency", "speed constants")


@entry
def evaluate_highest_impact_frequency(constants: Constants, speed: float) -> float:
    """Highest angular frequency of a collision [1/tau], for Python; speed [D/tau]."""
    return highest_impact_frequency(by_reference(constants), speed)


@compiled
def highest_impact_frequency(constants: Constants, speed: float) -> float:
    """Highest angular frequency of a collision at a speed [1/tau]; speed [D/tau]."""
    # Energy fixes the closest approach, so a step is short before a collision, not after it.
    square = 0.0
    if constants.acting.dipole is not None and constants.grains > 1:
        square = _head_on_pair_stiffness(
            constants.acting.near, speed, constants.least_mass, constants.least_moment
        )
    laws = constants.acting.laws
    return math.sqrt(max(square, _squared_impact_frequency(laws, laws, speed, constants)))


@compiled(inline=True)
def _head_on_pair_stiffness(discs: NearLaw | None, speed: float, mass: float, moment: float) -> float:
    if discs is None:
        return head_on_frequency_squared(speed, mass, moment)
    return squared_collision_frequency(discs, speed)


@compiled
def _total_and_largest_stiffness(slopes: Array, count: int, masses: Array | None) -> tuple[float, float]:
    """Stiffness of all grains [F*/D], and the largest of one grain per mass."""
    total, largest = 0.0, 0.0
    for i in range(count):
        largest = max(largest, slopes[i])
        total += slopes[i] if masses is None else slopes[i] * masses[i]
    return total, largest


@compiled
def _raise_by_body(body: int, mass: float, highest: float, bed: Bed, measurement: Measurement) -> float:
    """Bound of the squared frequencies of bed and a body of a mass [m], by its sides [1/tau^2]."""
    slopes, constants = measurement.against_piston, bed.constants
    slopes[:] = 0.0
    add_body_stiffness(bed, body, slopes)
    total, largest = _total_and_largest_stiffness(slopes, constants.grains, constants.masses)
    # The body's row has each grain's stiffness on the diagonal and beside it; a grain's row the body's.
    return max(highest + largest, 2.0 * total / mass)


@compiled
def _raise_by_further_bodies(
    law: BodyLaw | None, highest: float, bed: Bed, measurement: Measurement
) -> float:
    """Bound of the squared frequencies with further bodies, and springs that are not the machine's."""
    if law is None:
        return highest
    masses, links, largest = law.rows.masses, law.links, 0.0
    for b in range(CELL if law.moves else PISTON, masses.size):
        if b > PISTON:
            highest = _raise_by_body(b, masses[b], highest, bed, measurement)
        total = 0.0
        for link in range(law.chain, links.stiffness.size):
            total += 2.0 * abs(links.signs[link, b]) * links.stiffness[link]
        if total > 0.0:
            largest = max(largest, total / masses[b])
    return highest + largest


@compiled
def highest_frequency_bound(speed: float, bed: Bed, motion: Motion, measurement: Measurement) -> float:
    """Bound of the highest angular frequency of bed, free piston and collisions [1/tau]; speed [D/tau]."""
    constants = bed.constants
    highest = 0.0
    # Row sums of the Hessian over the masses bound its eigenvalues (Gershgorin).
    for i in range(constants.grains):
        highest = max(highest, measurement.stiffness[i])
    if motion.free:
        highest = _raise_by_body(PISTON, constants.piston_mass, highest, bed, measurement)
    highest = _raise_by_further_bodies(constants.acting.host, highest, bed, measurement)
    return max(math.sqrt(highest), highest_impact_frequency(constants, speed))
