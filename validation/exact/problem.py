"""An exact problem: a scene, a time, and the state of its grains then.

Natural units stand here once more, in high precision and from the grains' material, not by way of
the engine: m = rho pi eps D^2/4, mu = Br V/mu0, F* = mu0 mu^2/(pi D^4), tau = sqrt(m D/F*)
[D, 2.2], with the source's mu0 = 4 pi 1e-7 H/m. A slip in the engine's own conversion would show as
an error that no step makes smaller.

Motion in one dimension comes from its energy integral. For q'' = -u'(q) with the energy e per mass, the
time is t = integral of dq / sqrt(2 (e - u(q))) (Landau and Lifshitz, Mechanics, section 11). The
integrand is singular where the motion turns;

    q = q_t + s^2                        for one turning point q_t,
    q = a + (b - a) sin^2(phi/2)         between two, a and b,

make it analytic, so Gauss-Legendre quadrature converges faster than any power. The place at a given time
is the root of t(s), by Newton's method in the working precision; dt/ds is the integrand.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.scene.scene import Scene
from granular.schema.apparatus import Grains

if TYPE_CHECKING:
    from jaxtyping import Float

DIGITS = 50
"""Working precision; the results keep more than thirty digits of it."""

Number = Any
"""A number of mpmath, which has no types of its own."""

Potential = Callable[[Number], Number]


class NaturalUnits(NamedTuple):
    """Sizes of the natural units in SI, for grains of the first species."""

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
    """The grains at one time."""

    positions: Float[np.ndarray, "n 2"]  # [m]
    velocities: Float[np.ndarray, "n 2"]  # [m/s]
    steps: int | None = None  # that a simulation took, if it chooses them itself


@dataclasses.dataclass(frozen=True)
class ExactProblem:
    """A scene whose motion is known."""

    name: str
    scene: Scene
    time: float  # [s]
    exact: Callable[[float], GrainStates]  # [s]
    fewest_steps: int  # steps of about half a radian of the stiffest mode
    smooth: bool = True  # has as many derivatives as a high order asks for

    def perturb_start(self, last_place_units: int) -> ExactProblem:
        """Return the same problem with its start moved by a few units in the last place."""
        # The exact motion is not moved along: the difference of both simulations is the rounding that they
        # suffer.
        plan = self.scene.arrangement
        factor = 1.0 + last_place_units * np.finfo(float).eps
        moved = {
            f"arrangement.{name}": [[factor * x, factor * y] for x, y in rows]
            for name, rows in (("positions", plan.positions), ("velocities", plan.velocities))
            if rows is not None
        }
        return dataclasses.replace(self, scene=self.scene.replace(**moved))


RECORDS = 16
"""Records of a run: enough to see how much energy is turned over, which the ledger is judged by."""


def few_grains_scene(name: str, time: float, effects: dict[str, Any], **parts: Any) -> Scene:
    """Scene of grains of 5 mm in a cell 60 D wide, held for a time [s]."""
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
"""Walls of a scene where only the bottom repels."""


def grain_start_state(scene: Scene, grain: int = 0) -> tuple[Sequence[float], Sequence[float]]:
    """Position [m] and velocity [m/s] that a grain starts with."""
    plan = scene.arrangement
    assert plan.positions is not None
    velocity = (0.0, 0.0) if plan.velocities is None else plan.velocities[grain]
    return plan.positions[grain], velocity


# Quadrature of the energy integral ---------------------------------------------------------------


def integrate_from_zero(integrand: Potential, end: Number) -> Number:
    """Integrate a function from zero by Gauss-Legendre quadrature on eight intervals."""
    from mpmath import mp

    # Intervals of equal length keep the degree low where the integrand bends most, at its start.
    points = [end * k / 8 for k in range(9)]
    return mp.quad(integrand, points, method="gauss-legendre")


def _invert_integral(integrand: Potential, time: Number, guess: Number) -> Number:
    """Upper end at which the integral from zero equals the time."""
    # Five of the working digits are left to the rounding of quadrature and integrand.
    from mpmath import mp, mpf

    end = guess
    for _ in range(80):
        step = (integrate_from_zero(integrand, end) - time) / integrand(end)
        end -= step
        if abs(step) < mpf(10) ** (5 - mp.dps) * (1 + abs(end)):
            return end
    raise ArithmeticError(f"no place found for the time {time}; the guess {guess} is too far off")


def _rough_inverse(integrand: Potential, time: Number, scale: Number) -> Number:
    """First guess of the upper end, by Simpson's rule over ever longer stretches."""
    # The integrand is 0/0 at zero itself.
    width, end, reached = scale / 64, 0 * scale, 0 * scale
    before = integrand(width / 10**6)
    while True:
        middle, after = integrand(end + width / 2), integrand(end + width)
        gain = width * (before + 4 * middle + after) / 6
        if reached + gain >= time:
            return end + width * (time - reached) / gain
        reached, end, before = reached + gain, end + width, after


def time_integrand_past_turning(potential: Potential, turning: Number) -> Potential:
    """Integrand dt/ds [tau/D^(1/2)] for q = turning + s^2; potential [D^2/tau^2], turning [D]."""
    from mpmath import sqrt

    energy = potential(turning)
    return lambda s: 2 * s / sqrt(2 * (energy - potential(turning + s * s)))


def time_from_turning(potential: Potential, turning: Number, position: Number) -> Number:
    """Compute the time [tau] between a turning point and a place beyond it [D]; potential [D^2/tau^2]."""
    from mpmath import sqrt

    return integrate_from_zero(time_integrand_past_turning(potential, turning), sqrt(position - turning))


def position_after_turning(potential: Potential, turning: Number, time: Number) -> Number:
    """Compute the place [D] at a time [tau] after or before the turn [D]; potential [D^2/tau^2]."""
    integrand = time_integrand_past_turning(potential, turning)
    time = abs(time)
    if time == 0:
        return turning
    guess = _rough_inverse(integrand, time, 1 + 0 * turning)
    s = _invert_integral(integrand, time, guess)
    return turning + s * s


def time_integrand_between_turnings(potential: Potential, turning: Number, other: Number) -> Potential:
    """Integrand dt/dphi [tau] for q = a + (b - a) sin^2(phi/2) [D] in a potential [D^2/tau^2]."""
    from mpmath import sin, sqrt

    energy = potential(turning)
    interval = other - turning

    def integrand(phi: Number) -> Number:
        position = turning + interval * sin(phi / 2) ** 2
        return abs(interval) * sin(phi) / 2 / sqrt(2 * (energy - potential(position)))

    return integrand


def oscillation_period(potential: Potential, low: Number, high: Number) -> Number:
    """Compute the period [tau] between two turning points [D]; potential [D^2/tau^2]."""
    from mpmath import pi

    half = +pi / 2
    lower = integrate_from_zero(time_integrand_between_turnings(potential, low, high), half)
    return 2 * (lower + integrate_from_zero(time_integrand_between_turnings(potential, high, low), half))


def position_after_upper_turning(potential: Potential, low: Number, high: Number, time: Number) -> Number:
    """Compute the place [D] at a time [tau] after the upper turning point [D]; potential [D^2/tau^2]."""
    from mpmath import floor, pi, sin

    total = oscillation_period(potential, low, high)
    late = abs(time - total * floor(time / total + 0.5))
    early = total / 2 - late
    # Counted from the nearer turn, where the energies cancel least.
    turning, other, away = (high, low, late) if late < early else (low, high, early)
    if away <= 0:
        return turning
    integrand = time_integrand_between_turnings(potential, turning, other)
    phi = _invert_integral(integrand, away, _rough_inverse(integrand, away, +pi))
    return turning + (other - turning) * sin(phi / 2) ** 2


def speed_from_energy(potential: Potential, energy: Number, position: Number) -> Number:
    """Compute the speed at a place, sqrt(2 (e - u)) [D/tau]; potential, energy [D^2/tau^2], position [D]."""
    from mpmath import sqrt

    return sqrt(2 * abs(energy - potential(position)))
