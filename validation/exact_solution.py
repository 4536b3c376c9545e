"""One grain above the magnetic bottom wall under gravity: bounces, and small oscillations.

De Paula tests Verlet's method with this motion [D, 2.3.4]: a grain of diameter D = 5 mm starts at a height of
40 D and bounces about five times in 2 s. In natural units y'' = (1/2) y^-3.5 - G, so the energy per mass is
v^2/2 + (1/5) y^-2.5 + G y. The motion is periodic; with the turning points a < b, of which b is the initial
height, its period is

    T = 2 integral_a^b dy / sqrt(2 (u(b) - u(y))),   u(y) = (1/5) y^-2.5 + G y,

computed by quadrature. The lower turning point a is the other root of u(a) = u(b); (1/5) a^-2.5 is close to G
(b - a).

In the harmonic limit, the wall carries the weight at y_e = (1/(2 G))^(2/7); there u'' = (7/4) y_e^-4.5 =
(7/2) G/y_e. With the expansion u = (u''/2) x^2 + (a/3) x^3 + (b/4) x^4, whose coefficients a and b are not
the turning points above, the frequency at the amplitude A is

    omega = omega_0 [1 + (3 b/(8 w^2) - 5 a^2/(12 w^4)) A^2 + O(A^4)],   w^2 = u''

(Landau and Lifshitz, Mechanics, section 28). Here a = -(9/4) w^2/y_e and b = (33/8) w^2/y_e^2, so the
amplitude correction in the bracket is 1 - (9/16) (A/y_e)^2. A simulation is compared with the exact motion,
by quadrature, at every amplitude.

An exact problem consists of a scene, a time, and the state of the grains at that time.

Natural units are computed here in high precision from the grains' material, independently of the engine: m =
rho pi eps D^2/4, mu = Br V/mu0, F* = mu0 mu^2/(pi D^4), tau = sqrt(m D/F*) [D, 2.2], with mu0 = 4 pi 1e-7 H/m
as in the source paper [D]. A mistake in the engine's conversion would show as an error that does not decrease
with the time step.

Motion in one dimension comes from its energy integral. For q'' = -u'(q) with the energy e per mass, the
time is t = integral of dq / sqrt(2 (e - u(q))) (Landau and Lifshitz, Mechanics, section 11). The integrand is
singular at a turning point; the substitutions

    q = q_t + s^2                        for one turning point q_t,
    q = a + (b - a) sin^2(phi/2)         between two, a and b,

make it analytic, so Gauss-Legendre quadrature converges faster than any power. The position at a given time
is the root of t(s), found by Newton's method in the working precision; dt/ds is the integrand.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from granular.scene.scene import Scene
from granular.schema.apparatus import Grains
from granular.shared.array_types import Float

DIGITS = 50
"""Working precision [digits]; results are accurate to more than thirty digits."""

Number = Any
"""A number of mpmath, which has no type annotations."""

Potential = Callable[[Number], Number]


class NaturalUnits(NamedTuple):
    """Values of the natural units in SI, for grains of the first species."""

    length: Number  # D [m]
    mass: Number  # m [kg]
    force: Number  # F* [N]
    time: Number  # tau [s]

    @property
    def velocity(self) -> Number:
        """Unit of velocity, D/tau [m/s]."""
        return self.length / self.time

    @property
    def acceleration(self) -> Number:
        """Unit of acceleration, F*/m [m/s^2]."""
        return self.force / self.mass


def natural_units(grains: Grains) -> NaturalUnits:
    """Compute the natural units in SI, in mpmath's working precision."""
    from mpmath import mpf, pi, sqrt

    diameter = mpf(grains.species[0].diameter)
    permeability = 4 * pi / 10**7
    volume = pi * mpf(grains.thickness) * diameter**2 / 4
    moment = mpf(grains.remanence) * volume / permeability
    force = permeability * moment**2 / (pi * diameter**4)
    mass = mpf(grains.density) * volume
    return NaturalUnits(diameter, mass, force, sqrt(mass * diameter / force))


class GrainStates(NamedTuple):
    """Positions and velocities of the grains at one time."""

    positions: Float[np.ndarray, "n 2"]  # [m]
    velocities: Float[np.ndarray, "n 2"]  # [m/s]
    steps: int | None = None  # number taken by a simulation with variable steps


@dataclasses.dataclass(frozen=True)
class ExactProblem:
    """A scene whose motion has a known solution."""

    name: str
    scene: Scene
    time: float  # [s]
    exact: Callable[[float], GrainStates]  # [s]
    fewest_steps: int  # number of steps with which each step is about half a radian of the stiffest mode
    smooth: bool = True  # True if the motion has enough derivatives for high orders

    def perturb_start(self, last_place_units: int) -> ExactProblem:
        """Return the same problem with the initial positions moved by a few units in the last place."""
        # The exact solution is not shifted: the difference of the two simulations is their rounding error.
        plan = self.scene.arrangement
        factor = 1.0 + last_place_units * np.finfo(float).eps
        moved = {
            f"arrangement.{name}": [[factor * x, factor * y] for x, y in rows]
            for name, rows in (("positions", plan.positions), ("velocities", plan.velocities))
            if rows is not None
        }
        return dataclasses.replace(self, scene=self.scene.replace(**moved))


RECORDS = 16
"""Number of records of a run, enough to find its maximum kinetic energy; energy errors are divided by it."""


def few_grains_scene(name: str, time: float, effects: dict[str, Any], **parts: Any) -> Scene:
    """Make a scene of 5 mm grains in a cell 60 D wide without piston motion, for a time [s]."""
    count = len(parts["arrangement"]["positions"])
    plain: dict[str, Any] = {
        "name": name,
        "grains": {"count": count, "species": [{"name": "grain", "diameter": "5 mm"}]},
        "cell": {"width": "60 D"},
        "effects": effects,
        "protocol": [{"kind": "hold", "name": "hold", "duration": time}],
        "output": {"scalars": time / RECORDS, "frames": time},
        **parts,
    }
    return Scene.from_plain(plain)


BOTTOM_ONLY = {"left": "none", "right": "none", "top": "none"}
"""Walls of a scene in which only the bottom repels."""


def grain_start_position_and_velocity(
    scene: Scene, grain: int = 0
) -> tuple[Sequence[float], Sequence[float]]:
    """Return the initial position [m] and velocity [m/s] of a grain."""
    plan = scene.arrangement
    assert plan.positions is not None
    velocity = (0.0, 0.0) if plan.velocities is None else plan.velocities[grain]
    return plan.positions[grain], velocity


# Quadrature of the energy integral ---------------------------------------------------------------


def integrate_from_zero(integrand: Potential, end: Number) -> Number:
    """Integrate a function from zero by Gauss-Legendre quadrature on eight intervals."""
    from mpmath import mp

    # Intervals of equal length keep the degree low at the start, the most curved part of the integrand.
    points = [end * k / 8 for k in range(9)]
    return mp.quad(integrand, points, method="gauss-legendre")


def _invert_integral(integrand: Potential, time: Number, guess: Number) -> Number:
    """Return the upper limit at which the integral from zero equals a given time."""
    # Five of the working digits are reserved for the rounding of quadrature and integrand.
    from mpmath import mp, mpf

    end = guess
    for _ in range(80):
        step = (integrate_from_zero(integrand, end) - time) / integrand(end)
        end -= step
        if abs(step) < mpf(10) ** (5 - mp.dps) * (1 + abs(end)):
            return end
    raise ArithmeticError(f"no position found at the time {time}; the guess {guess} is too far away")


def _first_guess_of_inverse(integrand: Potential, time: Number, scale: Number) -> Number:
    """Return a first guess for `_invert_integral`, by Simpson's rule over growing intervals."""
    # The integrand is 0/0 at zero.
    width, end, reached = scale / 64, 0 * scale, 0 * scale
    before = integrand(width / 10**6)
    while True:
        middle, after = integrand(end + width / 2), integrand(end + width)
        gain = width * (before + 4 * middle + after) / 6
        if reached + gain >= time:
            return end + width * (time - reached) / gain
        reached, end, before = reached + gain, end + width, after


def time_integrand_past_turning(potential: Potential, turning: Number) -> Potential:
    """Return the integrand dt/ds for q = turning + s^2, in natural units."""
    from mpmath import sqrt

    energy = potential(turning)
    return lambda s: 2 * s / sqrt(2 * (energy - potential(turning + s * s)))


def time_from_turning(potential: Potential, turning: Number, position: Number) -> Number:
    """Compute the time from a turning point to a position beyond it, in natural units."""
    from mpmath import sqrt

    return integrate_from_zero(time_integrand_past_turning(potential, turning), sqrt(position - turning))


def position_after_turning(potential: Potential, turning: Number, time: Number) -> Number:
    """Compute the position at a time after or before a turning point, in natural units."""
    integrand = time_integrand_past_turning(potential, turning)
    time = abs(time)
    if time == 0:
        return turning
    guess = _first_guess_of_inverse(integrand, time, 1 + 0 * turning)
    s = _invert_integral(integrand, time, guess)
    return turning + s * s


def time_integrand_between_turnings(potential: Potential, turning: Number, other: Number) -> Potential:
    """Make the integrand dt/dphi for q = a + (b - a) sin^2(phi/2), in natural units."""
    from mpmath import sin, sqrt

    energy = potential(turning)
    interval = other - turning

    def integrand(phi: Number) -> Number:
        position = turning + interval * sin(phi / 2) ** 2
        return abs(interval) * sin(phi) / 2 / sqrt(2 * (energy - potential(position)))

    return integrand


def oscillation_period(potential: Potential, low: Number, high: Number) -> Number:
    """Compute the period of an oscillation between two turning points, in natural units."""
    from mpmath import pi

    half = +pi / 2
    lower = integrate_from_zero(time_integrand_between_turnings(potential, low, high), half)
    return 2 * (lower + integrate_from_zero(time_integrand_between_turnings(potential, high, low), half))


def position_after_upper_turning(potential: Potential, low: Number, high: Number, time: Number) -> Number:
    """Compute the position at a time after the upper turning point, in natural units."""
    from mpmath import floor, pi, sin

    total = oscillation_period(potential, low, high)
    late = abs(time - total * floor(time / total + 0.5))
    early = total / 2 - late
    # The time is measured from the nearer turning point, since the energies then cancel least.
    turning, other, away = (high, low, late) if late < early else (low, high, early)
    if away <= 0:
        return turning
    integrand = time_integrand_between_turnings(potential, turning, other)
    phi = _invert_integral(integrand, away, _first_guess_of_inverse(integrand, away, +pi))
    return turning + (other - turning) * sin(phi / 2) ** 2


def speed_from_energy(potential: Potential, energy: Number, position: Number) -> Number:
    """Compute the speed sqrt(2 (e - u)) at a position, in natural units."""
    from mpmath import sqrt

    return sqrt(2 * abs(energy - potential(position)))


__all__ = ["harmonic_period", "oscillation_problem"]

START = 40
"""Initial height [D]."""

TIME = 2.0
"""Duration of de Paula's test [s]."""

SHORT = 0.205
"""Time [s] during the first reflection at the wall; at this time no error term cancels by symmetry. Over a
complete bounce a Runge-Kutta method of order four seems to have order five."""


def bounce_problem(start: float = START, time: float = TIME) -> ExactProblem:
    """Make the problem of a grain that bounces on the magnetic wall [D, 2.3.4] from a height in D."""
    scene = bounce_scene(start, time)
    return ExactProblem(
        "bounce", scene, time, partial(exact_motion_of_bounce, scene), fewest_steps=round(2000 * time / TIME)
    )


def bounce_scene(start: float, time: float, name: str = "bounce") -> Scene:
    """Make the scene of a lone grain above the bottom wall under gravity; it starts at a height in D."""
    effects = {"gravity": {}, "walls": BOTTOM_ONLY}
    arrangement = {"positions": [["30 D", f"{start!r} D"]]}
    return few_grains_scene(name, time, effects, arrangement=arrangement)


def potential_turning_points_and_units_of_well(
    scene: Scene,
) -> tuple[Potential, Number, Number, NaturalUnits]:
    """Return potential and turning points of a lone grain above the wall, and the natural units in SI."""
    # Call within mpmath's working precision: natural units and turning points are computed in it.
    from mpmath import findroot, mpf

    units = natural_units(scene.grains)
    assert scene.effects.gravity is not None
    weight = mpf(scene.effects.gravity.acceleration) / units.acceleration

    def potential(y: Number) -> Number:
        return y ** mpf(-2.5) / 5 + weight * y

    start = mpf(grain_start_position_and_velocity(scene)[0][1]) / units.length
    rest = (1 / (2 * weight)) ** (mpf(2) / 7)
    # To first order the other turning point is at the same distance on the other side of the equilibrium.
    guess = rest * (2 - start / rest) if start < 1.5 * rest else (5 * weight * start) ** mpf(-0.4)
    other = findroot(lambda y: potential(y) - potential(start), guess)
    return potential, min(start, other), max(start, other), units


def bounce_period(scene: Scene) -> Number:
    """Compute the period [s] of a bouncing grain to thirty digits or more."""
    from mpmath import workdps

    with workdps(DIGITS):
        *well, units = potential_turning_points_and_units_of_well(scene)
        return oscillation_period(*well) * units.time


def exact_motion_of_bounce(scene: Scene, time: float) -> GrainStates:
    """Compute position [m] and velocity [m/s] at a time [s] after a start at the upper turning point."""
    from mpmath import floor, mpf, workdps

    with workdps(DIGITS):
        potential, low, high, units = potential_turning_points_and_units_of_well(scene)
        late = mpf(time) / units.time
        position = position_after_upper_turning(potential, low, high, late)
        magnitude = speed_from_energy(potential, potential(high), position)
        half = oscillation_period(potential, low, high) / 2
        upwards = int(floor(late / half)) % 2 == 1
        velocity = magnitude if upwards else -magnitude
        return GrainStates(
            np.array([[grain_start_position_and_velocity(scene)[0][0], float(position * units.length)]]),
            np.array([[0.0, float(velocity * units.velocity)]]),
        )


# Small oscillations -----------------------------------------------------------------------------

AMPLITUDE = 0.05
"""Initial displacement above the equilibrium, divided by the equilibrium height."""

# Time [s], 0.71 periods: the grain is then neither at a turning point nor at equilibrium, where phase or
# amplitude errors vanish.
OSCILLATION_TIME = 0.12


def oscillation_problem(amplitude: float = AMPLITUDE, time: float = OSCILLATION_TIME) -> ExactProblem:
    """Make the problem of a grain that oscillates above a wall that repels it.

    Parameters
    ----------
    amplitude : float
        Initial displacement above the equilibrium, divided by the equilibrium height, dimensionless.
    time : float
        Duration [s].

    Returns
    -------
    ExactProblem
        Scene with its exact solution.
    """
    height = float(equilibrium_height_above_wall(bounce_scene(10.0, time))) * (1.0 + amplitude)
    scene = bounce_scene(height, time, "oscillation")
    return ExactProblem("oscillation", scene, time, partial(exact_motion_of_bounce, scene), fewest_steps=12)


def equilibrium_height_above_wall(scene: Scene) -> Number:
    """Compute the equilibrium height (1/(2 G))^(2/7) [D] of a grain above the wall."""
    from mpmath import mpf, workdps

    with workdps(DIGITS):
        units = natural_units(scene.grains)
        assert scene.effects.gravity is not None
        weight = mpf(scene.effects.gravity.acceleration) / units.acceleration
        return (1 / (2 * weight)) ** (mpf(2) / 7)


def harmonic_period(scene: Scene, amplitude: float = 0.0) -> float:
    """Compute the period of a small oscillation, corrected for its amplitude to second order.

    The formula is from Landau and Lifshitz, Mechanics, section 28.

    Parameters
    ----------
    scene : Scene
        Scene of one grain on a wall.
    amplitude : float
        Amplitude divided by the equilibrium height, dimensionless; 0 for the harmonic limit.

    Returns
    -------
    float
        Period [s].
    """
    from mpmath import mpf, pi, sqrt, workdps

    with workdps(DIGITS):
        units = natural_units(scene.grains)
        height = equilibrium_height_above_wall(scene)
        omega = sqrt(mpf(7) / 4 * height ** mpf(-4.5))
        return float(2 * pi * units.time / omega / (1 - mpf(9) / 16 * mpf(amplitude) ** 2))
