"""Bounds of the highest angular frequency that the bed has, and that its fastest grains can meet.

The automatic step follows them, and a given step is judged by them.
"""

from __future__ import annotations

import math

from granular.compiled import compiled, entry
from granular.effects.contact import ContactLaw, impact_stiffness
from granular.effects.dipole import head_on_stiffness, pair_energy
from granular.effects.walls import piston_stiffness, turning_stiffness
from granular.engine.state import HEIGHT, Measurement, State
from granular.engine.system import Constants, moments_of
from granular.protocol.motion import Motion


@entry
def collision_frequency(constants: Constants, speed: float) -> float:
    """Highest angular frequency [1/tau] of a collision at that speed [D/tau].

    Two grains of this speed meet head-on, or one of them meets a wall: their energy fixes the
    closest approach, and that the stiffness. So a step is short before a collision, not after it.
    """
    square = 0.0
    if constants.acting.dipole is not None and constants.grains > 1:
        square = head_on_stiffness(speed, constants.least_mass, constants.least_moment)
    square = max(square, turning_stiffness(constants.acting.walls, speed))
    return math.sqrt(max(square, _impact(constants.acting.contact, speed, constants)))


@compiled
def _impact(law: ContactLaw | None, speed: float, constants: Constants) -> float:
    if law is None:
        return 0.0
    barrier = 0.0
    if constants.acting.dipole is not None:
        barrier = pair_energy(law.narrowest) * constants.least_moment**2
    return impact_stiffness(law, speed, constants.least_mass, barrier)


@compiled
def stiffest_mode(
    speed: float, state: State, constants: Constants, motion: Motion, measurement: Measurement
) -> float:
    """Bound of the highest angular frequency [1/tau] of bed and free piston, and of collisions.

    Row sums of the Hessian over the masses bound its eigenvalues (Gershgorin's theorem); they are
    in ``measurement`` after `potential_energies`.
    """
    highest = 0.0
    for i in range(constants.grains):
        highest = max(highest, measurement.stiffness[i])
    if motion.free:
        total, largest = piston_stiffness(
            constants.acting.walls.top, constants.grains, moments_of(constants), state.x, state.y,
            state.piston[HEIGHT], measurement.against_piston, state.scratch,
        )  # fmt: skip
        highest = max(highest + largest, 2.0 * total / constants.piston_mass)
    return max(math.sqrt(highest), collision_frequency(constants, speed))
