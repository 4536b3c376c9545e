"""The harmonic limit: a small oscillation about the height at which the wall carries the grain.

The wall carries the weight at y_e = (1/(2 G))^(2/7); there u'' = (7/4) y_e^-4.5 = (7/2) G/y_e. With
u = (u''/2) x^2 + (a/3) x^3 + (b/4) x^4, the frequency at the amplitude A is

    omega = omega_0 [1 + (3 b/(8 w^2) - 5 a^2/(12 w^4)) A^2 + O(A^4)],   w^2 = u''

(Landau and Lifshitz, Mechanics, section 28). Here a = -(9/4) w^2/y_e and b = (33/8) w^2/y_e^2, so
the bracket is 1 - (9/16) (A/y_e)^2: the amplitude correction. The exact motion that a simulation is
compared with is that of `validation.exact.bounce`, by quadrature, at every amplitude.
"""

from __future__ import annotations

from functools import partial

from granular.scene.scene import Scene
from validation.exact.bounce import bounce_scene, snapshot
from validation.exact.problem import DIGITS, Number, Problem, natural_units

__all__ = ["harmonic_period", "oscillation_problem"]

AMPLITUDE = 0.05
"""Start above the place of rest, in units of its height."""

TIME = 0.12


def oscillation_problem(amplitude: float = AMPLITUDE, time: float = TIME) -> Problem:
    """Make the problem of a grain that oscillates above a wall that repels it.

    Parameters
    ----------
    amplitude : float
        Height of the start above that of rest, over that of rest, without unit.
    time : float
        Duration [s].

    Returns
    -------
    Problem
        Scene with its exact solution.
    """
    height = float(rest_height(bounce_scene(10.0, time))) * (1.0 + amplitude)
    scene = bounce_scene(height, time, "oscillation")
    return Problem(
        "oscillation", "small oscillation above the wall", scene, time, partial(snapshot, scene), fewest=12
    )


def rest_height(scene: Scene) -> Number:
    """Height y_e [D] at which the wall carries the grain."""
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
        height = rest_height(scene)
        omega = sqrt(mpf(7) / 4 * height ** mpf(-4.5))
        return float(2 * pi * units.time / omega / (1 - mpf(9) / 16 * mpf(amplitude) ** 2))
