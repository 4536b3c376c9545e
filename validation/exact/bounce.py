"""One grain above the magnetic bottom wall under gravity: bounces, and small oscillations.

De Paula tests its method with it [D, 2.3.4]: D = 5 mm, start at 40 D, 2 s, some five bounces. In
natural units y'' = (1/2) y^-3.5 - G, so the energy per mass is v^2/2 + (1/5) y^-2.5 + G y. The
motion is periodic; with the turning points a < b (b is the start) its period is

    T = 2 integral_a^b dy / sqrt(2 (u(b) - u(y))),   u(y) = (1/5) y^-2.5 + G y,

taken by quadrature (see `validation.exact.problem`). a is the other root of u(a) = u(b), where
(1/5) a^-2.5 is close to G (b - a).

The harmonic limit: the wall carries the weight at y_e = (1/(2 G))^(2/7); there u'' = (7/4) y_e^-4.5 =
(7/2) G/y_e. With u = (u''/2) x^2 + (a/3) x^3 + (b/4) x^4, the frequency at the amplitude A is

    omega = omega_0 [1 + (3 b/(8 w^2) - 5 a^2/(12 w^4)) A^2 + O(A^4)],   w^2 = u''

(Landau and Lifshitz, Mechanics, section 28). Here a = -(9/4) w^2/y_e and b = (33/8) w^2/y_e^2, so
the bracket is 1 - (9/16) (A/y_e)^2: the amplitude correction. A simulation is compared with the exact
motion, by quadrature, at every amplitude.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from granular.scene.scene import Scene
from validation.exact.problem import (
    BOTTOM_ONLY,
    DIGITS,
    ExactProblem,
    GrainStates,
    NaturalUnits,
    Number,
    Potential,
    few_grains_scene,
    grain_start_state,
    natural_units,
    oscillation_period,
    position_after_upper_turning,
    speed_from_energy,
)

__all__ = ["harmonic_period", "oscillation_problem"]

START = 40
"""Height at the start [D]."""

TIME = 2.0
"""De Paula's [s]."""

SHORT = 0.205
"""Within the first turn at the wall [s], where no term of an error cancels by symmetry: over a
whole bounce a Runge-Kutta method of order four seems to have order five."""


class PotentialWell(NamedTuple):
    """The well that the grain moves in, in natural units."""

    potential: Potential
    low: Number  # [D]
    high: Number  # [D]
    units: NaturalUnits


def bounce_problem(start: float = START, time: float = TIME) -> ExactProblem:
    """Make the problem of a grain that bounces on the magnetic wall [D, 2.3.4]; start [D], time [s]."""
    scene = bounce_scene(start, time)
    return ExactProblem(
        "bounce", scene, time, partial(exact_bounce, scene), fewest_steps=round(2000 * time / TIME)
    )


def bounce_scene(start: float, time: float, name: str = "bounce") -> Scene:
    """Scene of a lone grain at a height over the bottom wall, under gravity; start [D], time [s]."""
    effects = {"gravity": {}, "walls": BOTTOM_ONLY}
    arrangement = {"positions": [["30 D", f"{start!r} D"]]}
    return few_grains_scene(name, time, effects, arrangement=arrangement)


def potential_well(scene: Scene) -> PotentialWell:
    """Potential well [D^2/tau^2] of a lone grain over the wall, with its turning points [D]."""
    # Call within mpmath's working precision, as natural units and turning points are taken in it.
    from mpmath import findroot, mpf

    units = natural_units(scene.grains)
    assert scene.effects.gravity is not None
    weight = mpf(scene.effects.gravity.acceleration) / units.acceleration

    def potential(y: Number) -> Number:
        return y ** mpf(-2.5) / 5 + weight * y

    start = mpf(grain_start_state(scene)[0][1]) / units.length
    rest = (1 / (2 * weight)) ** (mpf(2) / 7)
    # The other turning point lies as far beyond the place of rest, to first order.
    guess = rest * (2 - start / rest) if start < 1.5 * rest else (5 * weight * start) ** mpf(-0.4)
    other = findroot(lambda y: potential(y) - potential(start), guess)
    low, high = min(start, other), max(start, other)
    return PotentialWell(potential, low, high, units)


def bounce_period(scene: Scene) -> Number:
    """Compute the period of a bouncing grain, to thirty digits and more [s]."""
    from mpmath import workdps

    with workdps(DIGITS):
        well_ = potential_well(scene)
        return oscillation_period(well_.potential, well_.low, well_.high) * well_.units.time


def exact_bounce(scene: Scene, time: float) -> GrainStates:
    """Compute the place [m] and velocity [m/s] at a time [s], for a start at the upper turning point."""
    from mpmath import floor, mpf, workdps

    with workdps(DIGITS):
        well_ = potential_well(scene)
        late = mpf(time) / well_.units.time
        position = position_after_upper_turning(well_.potential, well_.low, well_.high, late)
        magnitude = speed_from_energy(well_.potential, well_.potential(well_.high), position)
        half = oscillation_period(well_.potential, well_.low, well_.high) / 2
        upwards = int(floor(late / half)) % 2 == 1
        velocity = magnitude if upwards else -magnitude
        return GrainStates(
            np.array([[grain_start_state(scene)[0][0], float(position * well_.units.length)]]),
            np.array([[0.0, float(velocity * well_.units.velocity)]]),
        )


# Small oscillations -----------------------------------------------------------------------------

AMPLITUDE = 0.05
"""Start above the place of rest, in units of its height."""

# 0.71 periods [s]: neither a turn nor a passage through rest, at which errors of phase or of amplitude
# vanish.
OSCILLATION_TIME = 0.12


def oscillation_problem(amplitude: float = AMPLITUDE, time: float = OSCILLATION_TIME) -> ExactProblem:
    """Make the problem of a grain that oscillates above a wall that repels it.

    Parameters
    ----------
    amplitude : float
        Height of the start above that of rest, over that of rest, without unit.
    time : float
        Duration [s].

    Returns
    -------
    ExactProblem
        Scene with its exact solution.
    """
    height = float(wall_rest_height(bounce_scene(10.0, time))) * (1.0 + amplitude)
    scene = bounce_scene(height, time, "oscillation")
    return ExactProblem("oscillation", scene, time, partial(exact_bounce, scene), fewest_steps=12)


def wall_rest_height(scene: Scene) -> Number:
    """Compute the height at which the wall carries the grain, (1/(2 G))^(2/7) [D]."""
    from mpmath import mpf, workdps

    with workdps(DIGITS):
        units = natural_units(scene.grains)
        assert scene.effects.gravity is not None
        weight = mpf(scene.effects.gravity.acceleration) / units.acceleration
        return (1 / (2 * weight)) ** (mpf(2) / 7)


def harmonic_period(scene: Scene, amplitude: float = 0.0) -> float:
    """Compute the period of a small oscillation, corrected for its amplitude to second order.

    By Landau and Lifshitz, Mechanics, section 28.

    Parameters
    ----------
    scene : Scene
        Scene of one grain on a wall.
    amplitude : float
        Amplitude over the height of rest, without unit; 0 for the harmonic limit.

    Returns
    -------
    float
        Period [s].
    """
    from mpmath import mpf, pi, sqrt, workdps

    with workdps(DIGITS):
        units = natural_units(scene.grains)
        height = wall_rest_height(scene)
        omega = sqrt(mpf(7) / 4 * height ** mpf(-4.5))
        return float(2 * pi * units.time / omega / (1 - mpf(9) / 16 * mpf(amplitude) ** 2))
