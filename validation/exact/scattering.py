"""Two grains that pass each other, repelling: scattering with an impact parameter.

In natural units the distance vector obeys r'' = 2 (3/4) rhat/r^4 (each grain has the mass 1). With
the angular momentum l = r^2 phi' the distance moves in

    u(r) = 1/(2 r^3) + l^2/(2 r^2),

with one turning point, the closest approach. r(t) is the quadrature of the energy integral and the
angle swept is the integral of l/r^2 dt along it (Landau and Lifshitz, Mechanics, sections 14, 18).
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from granular.scene.scene import Scene
from validation.exact.problem import (
    DIGITS,
    ExactProblem,
    GrainStates,
    Number,
    few_grains_scene,
    grain_start_state,
    natural_units,
)
from validation.exact.quadrature import (
    Potential,
    integrate_from_zero,
    position_after_turning,
    time_from_turning,
    time_integrand_past_turning,
)

# Twice the time to the closest approach, 12.7 ms at 1.92 D: the grains are as far apart again [s].
TIME = 0.025
SPEED = 1.0
"""Speed of each grain [m/s]."""
APART, ASIDE = 6.0, 0.5
"""Distance at the start along and across the velocities [D]."""


class Orbit(NamedTuple):
    """The relative motion, in natural units."""

    potential: Potential  # [D^2/tau^2] of a distance [D]
    closest_distance: Number  # [D]
    angular_momentum: Number  # [D^2/tau]
    time_to_closest: Number  # [tau]


def scattering_problem(
    speed: float = SPEED, impact_parameter: float = ASIDE, time: float = TIME
) -> ExactProblem:
    """Make the problem of two grains that pass and repel; speed [m/s], impact_parameter [D], time [s]."""
    across, along = impact_parameter / 2.0, APART / 2.0
    arrangement = {
        "positions": [
            [f"{30 - along!r} D", f"{30 - across!r} D"],
            [f"{30 + along!r} D", f"{30 + across!r} D"],
        ],
        "velocities": [[speed, 0.0], [-speed, 0.0]],
    }
    scene = few_grains_scene("scattering", time, {"dipole": {}}, arrangement=arrangement)
    return ExactProblem("scattering", scene, time, partial(exact_scattering, scene), fewest_steps=32)


def relative_orbit(scene: Scene) -> tuple[Orbit, tuple[Number, Number]]:
    """Compute the relative motion of two grains, and their direction [rad] and distance [D] at the start."""
    # Call within mpmath's working precision.
    from mpmath import atan2, findroot, mpf, sqrt

    units = natural_units(scene.grains)
    (first, slow), (second, fast) = grain_start_state(scene, 0), grain_start_state(scene, 1)
    x, y = ((mpf(b) - mpf(a)) / units.length for a, b in zip(first, second, strict=True))
    vx, vy = ((mpf(b) - mpf(a)) / units.velocity for a, b in zip(slow, fast, strict=True))
    momentum = x * vy - y * vx
    distance = sqrt(x * x + y * y)

    def potential(r: Number) -> Number:
        return 1 / (2 * r**3) + momentum**2 / (2 * r**2)

    energy = potential(distance) + ((x * vx + y * vy) / distance) ** 2 / 2
    reach = (2 * energy) ** (mpf(-1) / 3)  # the turning point of the head-on collision
    guess = sqrt(reach**2 + momentum**2 / (2 * energy))
    turning = findroot(lambda r: potential(r) - energy, guess)
    before = time_from_turning(potential, turning, distance)
    return Orbit(potential, turning, momentum, before), (atan2(y, x), distance)


def _swept_angle(orbit: Orbit, distance: Number) -> Number:
    """Angle swept between the closest approach and a distance."""
    from mpmath import sqrt

    integrand = time_integrand_past_turning(orbit.potential, orbit.closest_distance)
    return integrate_from_zero(
        lambda s: orbit.angular_momentum / (orbit.closest_distance + s * s) ** 2 * integrand(s),
        sqrt(distance - orbit.closest_distance),
    )


def exact_scattering(scene: Scene, time: float) -> GrainStates:
    """Compute places [m] and velocities [m/s] of two grains that scatter, at a time [s]."""
    from mpmath import cos, mpf, sin, sqrt, workdps

    with workdps(DIGITS):
        units = natural_units(scene.grains)
        path, (angle, start) = relative_orbit(scene)
        late = mpf(time) / units.time - path.time_to_closest
        distance = position_after_turning(path.potential, path.closest_distance, late)
        side = 1 if late > 0 else -1
        angle += _swept_angle(path, start) + side * _swept_angle(path, distance)
        energy = path.potential(path.closest_distance)
        along = side * sqrt(2 * abs(energy - path.potential(distance)))
        across = path.angular_momentum / distance
        c, s = cos(angle), sin(angle)
        position = [distance * c, distance * s]
        velocity = [along * c - across * s, along * s + across * c]
        return _both_grain_states(scene, units.length, units.velocity, position, velocity, time)


def _both_grain_states(
    scene: Scene, length: Number, speed: Number, point: list[Number], velocity: list[Number], time: float
) -> GrainStates:
    """Both grains from the relative motion and that of their centre."""
    from mpmath import mpf

    positions, velocities = np.empty((2, 2)), np.empty((2, 2))
    starts = [grain_start_state(scene, grain) for grain in (0, 1)]
    for axis in range(2):
        start = sum(mpf(position[axis]) for position, _ in starts) / 2
        drift = sum(mpf(velocity[axis]) for _, velocity in starts) / 2
        for grain, sign in ((0, -1), (1, 1)):
            where = start + drift * mpf(time) + sign * point[axis] * length / 2
            positions[grain, axis] = float(where)
            velocities[grain, axis] = float(drift + sign * velocity[axis] * speed / 2)
    return GrainStates(positions, velocities)
