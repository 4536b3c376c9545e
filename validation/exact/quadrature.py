"""Motion in one dimension from its energy integral.

For q'' = -u'(q) with the energy e per mass, the time is t = integral of dq / sqrt(2 (e - u(q)))
(Landau and Lifshitz, Mechanics, section 11). The integrand is singular where the motion turns;

    q = q_t + s^2                        for one turning point q_t,
    q = a + (b - a) sin^2(phi/2)         between two, a and b,

make it analytic, so Gauss-Legendre quadrature converges faster than any power. The place at a
given time is the root of t(s), by Newton's method in the working precision; dt/ds is the integrand.
"""

from __future__ import annotations

from collections.abc import Callable

from validation.exact.problem import Number

Potential = Callable[[Number], Number]


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
