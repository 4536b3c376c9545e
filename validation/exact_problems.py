"""Problems whose motion is known to thirty digits: one grain, two grains that scatter, a grain and a piston.

Two grains pass and repel each other: in natural units the distance vector obeys
r'' = 2 (3/4) rhat/r^4 (each grain has the mass 1). With the angular momentum l = r^2 phi' the distance r
behaves like the coordinate of a particle in the potential

    u(r) = 1/(2 r^3) + l^2/(2 r^2),

with one turning point, the closest approach. The distance r(t) follows from the energy integral by
quadrature, and the swept angle is the integral of l/r^2 dt (Landau and Lifshitz, Mechanics, sections 14, 18).

A piston descends at constant speed V on one grain at rest, without gravity. In the piston's frame, which is
inertial, the wall is at rest and the grain approaches at V. With the distance w = H - y, w'' = (1/2) w^-3.5
and the energy per mass w'^2/2 + (1/5) w^-2.5 is conserved. The one turning point is the minimum distance;
quadrature gives w(t), and the change of frame gives y = H_0 - V t - w. The piston does work on the grain: the
energy of the grain is not conserved.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from granular.scene.scene import Scene
from granular.shared.errors import InputError, unknown_word_message
from validation.exact_solution import (
    DIGITS,
    ExactProblem,
    GrainStates,
    Number,
    Potential,
    bounce_problem,
    few_grains_scene,
    grain_start_position_and_velocity,
    integrate_from_zero,
    natural_units,
    oscillation_problem,
    position_after_turning,
    time_from_turning,
    time_integrand_past_turning,
)

__all__ = ["NAMES", "ExactProblem", "GrainStates", "exact_problem"]

# One grain in closed form -----------------------------------------------------------------------

SLIDING_TIME = 0.078
"""Duration of the sliding problem [s]. Its ratio to the time until the grain stops is near the golden ratio,
so with neighbouring numbers of steps the stop occurs at all phases of a time step."""

Factors = tuple[Number, Number, Number, Number]
"""Four factors of a motion in closed form, in this order: displacement divided by initial velocity [s], final
velocity divided by initial velocity, contribution of gravity to the height [m], and to the velocity [m/s]."""


def _free_fall_displacement_and_velocity_factors(scene: Scene, t: Number, _: Number) -> Factors:
    """Return the factors of free fall: y = y0 + v0 t - g t^2/2 ([D, 2.18] prints g t^2)."""
    from mpmath import mpf

    assert scene.effects.gravity is not None
    g = mpf(scene.effects.gravity.acceleration)
    return t, 1, -g * t * t / 2, -g * t


def _drag_displacement_and_velocity_factors(scene: Scene, t: Number, _: Number) -> Factors:
    """Return the factors of viscous drag: v = v0 e^(-c t), x = x0 + v0 (1 - e^(-c t))/c, c = gamma/m."""
    from mpmath import exp, expm1, mpf

    assert scene.effects.drag is not None
    rate = mpf(scene.effects.drag.coefficient) / natural_units(scene.grains).mass
    return -expm1(-rate * t) / rate, exp(-rate * t), 0, 0


def _sliding_displacement_and_velocity_factors(scene: Scene, t: Number, speed: Number) -> Factors:
    """Return the factors of Coulomb friction: the speed decreases at a = mu_d N/m until t = v0/a."""
    from mpmath import mpf

    friction = scene.effects.friction
    assert friction is not None
    loss = mpf(friction.dynamic) * mpf(friction.load) / natural_units(scene.grains).mass
    late = min(t, speed / loss)
    return (1 - loss * late / (2 * speed)) * late, (speed - loss * late) / speed, 0, 0


class LoneGrain(NamedTuple):
    """A lone grain whose motion has a closed form."""

    time: float  # [s]
    effects: dict[str, Any]
    start: tuple[str, str]
    velocity: tuple[float, float]  # [m/s]
    factors: Callable[[Scene, Number, Number], Factors]
    fewest_steps: int
    smooth: bool = True


LONE_GRAINS = {
    # This motion is exact to rounding with every method of order two or more; the error of order one is g t
    # h/2.
    "free-fall": LoneGrain(
        0.25, {"gravity": {}}, ("20 D", "40 D"), (0.1, 0.5), _free_fall_displacement_and_velocity_factors, 16
    ),
    # The velocity falls to a hundredth. It is exact with every method that integrates drag by its exact flow.
    # The position is not exact: between two half steps of drag the drift uses the speed at the midpoint, and
    # so the order shows.
    "drag": LoneGrain(
        0.1,
        {"drag": {"coefficient": 0.02}},
        ("10 D", "10 D"),
        (2.0, 1.0),
        _drag_displacement_and_velocity_factors,
        8,
    ),
    # The grain of 0.43 g decelerates at 10.4 m/s^2, slightly above g. In the step of the stop the position
    # errs by up to a h^2/8 whatever the order, so the worst error falls like h^2.
    "sliding": LoneGrain(
        SLIDING_TIME,
        {"friction": {"load": 0.01}},
        ("10 D", "10 D"),
        (0.4, 0.3),
        _sliding_displacement_and_velocity_factors,
        256,
        smooth=False,
    ),
}


def _lone_grain_problem(name: str) -> ExactProblem:
    row = LONE_GRAINS[name]
    arrangement = {"positions": [list(row.start)], "velocities": [list(row.velocity)]}
    scene = few_grains_scene(name, row.time, row.effects, arrangement=arrangement)
    exact = partial(_exact_motion_of_lone_grain, scene, row.factors)
    return ExactProblem(name, scene, row.time, exact, row.fewest_steps, row.smooth)


def _exact_motion_of_lone_grain(
    scene: Scene, factors: Callable[[Scene, Number, Number], Factors], time: float
) -> GrainStates:
    """Return position [m] and velocity [m/s] of a lone grain at a time [s]."""
    from mpmath import mpf, sqrt, workdps

    with workdps(DIGITS):
        start, velocity = (
            [mpf(value) for value in values] for values in grain_start_position_and_velocity(scene)
        )
        reach, remainder, rise, gain = factors(scene, mpf(time), sqrt(sum(v * v for v in velocity)))
        x, y = (q + v * reach for q, v in zip(start, velocity, strict=True))
        vx, vy = (v * remainder for v in velocity)
        return GrainStates(np.array([[float(x), float(y + rise)]]), np.array([[float(vx), float(vy + gain)]]))


# Two grains that scatter ------------------------------------------------------------------------

# Time [s], twice the time to the closest approach (12.7 ms, at 1.92 D), after which the grains are at their
# initial distance.
TIME = 0.025
SPEED = 1.0
"""Speed of each grain [m/s]."""
APART, ASIDE = 6.0, 0.5
"""Initial distances of the grains, along and across their velocities [D]."""


def scattering_problem(
    speed: float = SPEED, impact_parameter: float = ASIDE, time: float = TIME
) -> ExactProblem:
    """Make the problem of two repelling grains that scatter; ``impact_parameter`` is in D."""
    across, along = impact_parameter / 2.0, APART / 2.0
    arrangement = {
        "positions": [
            [f"{30 - along!r} D", f"{30 - across!r} D"],
            [f"{30 + along!r} D", f"{30 + across!r} D"],
        ],
        "velocities": [[speed, 0.0], [-speed, 0.0]],
    }
    scene = few_grains_scene("scattering", time, {"dipole": {}}, arrangement=arrangement)
    return ExactProblem(
        "scattering", scene, time, partial(exact_motion_of_scattering, scene), fewest_steps=32
    )


def potential_and_invariants_of_relative_orbit(
    scene: Scene,
) -> tuple[Potential, Number, Number, Number, Number]:
    """Return potential, closest distance, angular momentum, initial angle and distance of the orbit."""
    # Call within mpmath's working precision.
    from mpmath import atan2, findroot, mpf, sqrt

    units = natural_units(scene.grains)
    (first, slow), (second, fast) = (
        grain_start_position_and_velocity(scene, 0),
        grain_start_position_and_velocity(scene, 1),
    )
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
    return potential, turning, momentum, atan2(y, x), distance


def _swept_angle(potential: Potential, closest: Number, momentum: Number, distance: Number) -> Number:
    """Return the angle swept between the closest approach and a given distance."""
    from mpmath import sqrt

    integrand = time_integrand_past_turning(potential, closest)
    return integrate_from_zero(
        lambda s: momentum / (closest + s * s) ** 2 * integrand(s), sqrt(distance - closest)
    )


def exact_motion_of_scattering(scene: Scene, time: float) -> GrainStates:
    """Compute positions [m] and velocities [m/s] of two scattering grains at a time [s]."""
    from mpmath import cos, mpf, sin, sqrt, workdps

    with workdps(DIGITS):
        units = natural_units(scene.grains)
        potential, closest, momentum, angle, start = potential_and_invariants_of_relative_orbit(scene)
        late = mpf(time) / units.time - time_from_turning(potential, closest, start)
        distance = position_after_turning(potential, closest, late)
        side = 1 if late > 0 else -1
        angle += _swept_angle(potential, closest, momentum, start)
        angle += side * _swept_angle(potential, closest, momentum, distance)
        along = side * sqrt(2 * abs(potential(closest) - potential(distance)))
        across = momentum / distance
        c, s = cos(angle), sin(angle)
        point = [distance * c, distance * s]
        velocity = [along * c - across * s, along * s + across * c]
        # Both grains follow from the relative motion and the motion of their centre of mass.
        positions, velocities = np.empty((2, 2)), np.empty((2, 2))
        starts = [grain_start_position_and_velocity(scene, grain) for grain in (0, 1)]
        for axis in range(2):
            middle = sum(mpf(position[axis]) for position, _ in starts) / 2
            drift = sum(mpf(speed[axis]) for _, speed in starts) / 2
            for grain, sign in ((0, -1), (1, 1)):
                reached = middle + drift * mpf(time) + sign * point[axis] * units.length / 2
                positions[grain, axis] = float(reached)
                velocities[grain, axis] = float(drift + sign * velocity[axis] * units.velocity / 2)
        return GrainStates(positions, velocities)


# A piston that drives a grain --------------------------------------------------------------------

# Initial distance [D]: the piston's force there is 1/128 of its value at one diameter.
GAP = 4.0


def driven_piston_problem() -> ExactProblem:
    """Make the problem of a grain at rest that a piston approaches at constant speed."""
    top, speed, time = 40.0, 0.5, 0.05  # [D], [m/s], [s]
    scene = few_grains_scene(
        "driven-piston",
        time,
        {"walls": {"left": "none", "right": "none", "bottom": "none"}},
        arrangement={"positions": [["30 D", f"{top - GAP!r} D"]]},
        piston={"height": f"{top!r} D"},
        protocol=[{"kind": "move", "name": "move", "to": 0.005 * top - speed * time, "duration": time}],
    )
    return ExactProblem(
        "driven-piston", scene, time, partial(exact_motion_of_driven_grain, scene), fewest_steps=24
    )


def exact_motion_of_driven_grain(scene: Scene, time: float) -> GrainStates:
    """Compute position [m] and velocity [m/s] of the grain at a time [s]; the piston has a constant speed."""
    from mpmath import findroot, mpf, sqrt, workdps

    from granular.protocol import Move

    move = scene.protocol[0]
    assert scene.piston is not None
    assert isinstance(move, Move)
    assert move.duration is not None
    with workdps(DIGITS):
        units = natural_units(scene.grains)
        height, (x, y) = mpf(scene.piston.height), grain_start_position_and_velocity(scene)[0]
        down = (height - mpf(move.to)) / mpf(move.duration)
        start, speed = (height - mpf(y)) / units.length, down / units.velocity

        def potential(w: object) -> object:
            return mpf(w) ** mpf(-2.5) / 5

        energy = speed**2 / 2 + potential(start)
        turning = findroot(lambda w: potential(w) - energy, (5 * energy) ** mpf(-0.4))
        late = mpf(time) / units.time - time_from_turning(potential, turning, start)
        gap = position_after_turning(potential, turning, late)
        opening = sqrt(2 * abs(energy - potential(gap))) * (1 if late > 0 else -1)
        position = height - down * mpf(time) - gap * units.length
        return GrainStates(
            np.array([[x, float(position)]]), np.array([[0.0, float(-down - opening * units.velocity)]])
        )


# Table ------------------------------------------------------------------------------------------

_PROBLEMS: dict[str, Callable[[], ExactProblem]] = {
    "free-fall": partial(_lone_grain_problem, "free-fall"),
    "bounce": bounce_problem,
    "oscillation": oscillation_problem,
    "scattering": scattering_problem,
    "drag": partial(_lone_grain_problem, "drag"),
    "sliding": partial(_lone_grain_problem, "sliding"),
    "driven-piston": driven_piston_problem,
}
NAMES = tuple(_PROBLEMS)


def exact_problem(name: str) -> ExactProblem:
    """Return the exact problem with a given name.

    Parameters
    ----------
    name : str
        One of `NAMES`.

    Returns
    -------
    ExactProblem
        Scene with its exact solution.

    Raises
    ------
    InputError
        If the name is unknown; the message gives the nearest name.

    Examples
    --------
    >>> from validation import exact_problem
    >>> exact_problem("bounce").name
    'bounce'
    """
    if name not in NAMES:
        raise InputError(unknown_word_message(name, NAMES, "exact problem"))
    return _PROBLEMS[name]()
