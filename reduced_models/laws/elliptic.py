"""Elliptic motions in JAX: Jacobi's functions, the Duffing oscillator, and a damped ansatz.

``scipy.special.ellipj`` has the values for 0 <= m <= 1, and near m = 1 those of small u only. These
functions do what a fit of a motion needs beyond that: derivatives by u and by m, also at m = 0 and
m = 1; any real m (that of a spring that softens is negative); and compiled code for many starts.

The parameter is m = k^2. Within 0 <= m <= 1 the argument is first brought to a quarter period about
zero; then Landen's transformations shrink whichever of m and 1 - m is the smaller one (Abramowitz &
Stegun 1964, 16.12 and 16.14), written without differences of nearly equal numbers, so that the
limits m -> 0 and m -> 1 keep their digits and their derivatives. Other m are brought there by the
reciprocal and the imaginary transformation (ibid. 16.10, 16.11). An argument of many periods is
rounded as any number is, which costs u eps.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import RecordError
from reduced_models.jax_setup import jax
from reduced_models.records.first_guesses import first_guesses

jnp = jax.numpy

_LANDEN_STEPS = 5  # 1/2 -> 0.03 -> 6e-5 -> 2e-10 -> 1e-20: the fifth leaves nothing
_MEAN_STEPS = 15  # of the arithmetic-geometric mean, enough for 1 - m down to 1e-300
_FAR = 300.0  # where sech is 1e-130; it must not vanish, since it divides
_MOST_FITS = 60  # evaluations of a least-squares search
_POOR = 0.5  # of the record's standard deviation: a residual that follows nothing
_SLOW_STEPS = 256  # of the averaged equations of the damped ansatz


def sn(u: Any, m: Any) -> Any:
    """Jacobi's sn(u | m), an array of the broadcast shape of u and m."""
    return _functions(u, m)[0]


def cn(u: Any, m: Any) -> Any:
    """Jacobi's cn(u | m)."""
    return _functions(u, m)[1]


def dn(u: Any, m: Any) -> Any:
    """Jacobi's dn(u | m)."""
    return _functions(u, m)[2]


def quarter_period(m: Any) -> Any:
    """The complete integral K(m) for m < 1, by the arithmetic-geometric mean."""
    m = jnp.asarray(m, dtype=jnp.float64)
    return _complete(1.0 - m)


def second_integral(m: Any) -> Any:
    """The complete integral E(m) of the second kind for m < 1 (Abramowitz & Stegun 17.6.4)."""
    m = jnp.asarray(m, dtype=jnp.float64)

    def step(k: Any, state: Any) -> Any:
        a, b, total = state
        return 0.5 * (a + b), jnp.sqrt(a * b), total + 2.0**k * (0.5 * (a - b)) ** 2

    start = jnp.ones_like(m), jnp.sqrt(1.0 - m), 0.5 * m
    a, _, total = jax.lax.fori_loop(0, _MEAN_STEPS, step, start)
    return jnp.pi / (2.0 * a) * (1.0 - total)


def _complete(m1: Any) -> Any:
    def step(_: Any, state: Any) -> Any:
        a, b = state
        return 0.5 * (a + b), jnp.sqrt(a * b)

    a, _ = jax.lax.fori_loop(0, _MEAN_STEPS, step, (jnp.ones_like(m1), jnp.sqrt(m1)))
    return jnp.pi / (2.0 * a)


def _functions(u: Any, m: Any) -> tuple[Any, Any, Any]:
    """sn, cn and dn for any real m."""
    u, m = jnp.broadcast_arrays(jnp.asarray(u, jnp.float64), jnp.asarray(m, jnp.float64))
    below, above = m < 0.0, m > 1.0
    # Each branch gets numbers of its own domain, or the derivatives of the others were undefined.
    lower, upper = jnp.where(below, m, -1.0), jnp.where(above, m, 2.0)
    inner = jnp.where(below | above, 0.5, m)
    reduced_m = jnp.where(below, -lower / (1.0 - lower), jnp.where(above, 1.0 / upper, inner))
    reduced_m1 = jnp.where(
        below, 1.0 / (1.0 - lower), jnp.where(above, (upper - 1.0) / upper, 1.0 - inner)
    )
    stretch = jnp.where(below, jnp.sqrt(1.0 - lower), jnp.where(above, jnp.sqrt(upper), 1.0))
    s, c, d = _standard(u * stretch, reduced_m, reduced_m1)
    safe_d = jnp.where(below, d, 1.0)
    return (
        jnp.where(below, s / (stretch * safe_d), jnp.where(above, s / stretch, s)),
        jnp.where(below, c / safe_d, jnp.where(above, d, c)),
        jnp.where(below, 1.0 / safe_d, jnp.where(above, c, d)),
    )


def _standard(u: Any, m: Any, m1: Any) -> tuple[Any, Any, Any]:
    """sn, cn and dn for 0 <= m <= 1, m1 = 1 - m."""
    periodic = m1 > 0.0
    quarter = _complete(jnp.where(periodic, m1, 1.0))
    turns = jnp.where(periodic, jnp.round(u / (2.0 * quarter)), 0.0)
    rest = u - turns * (2.0 * quarter)
    small = m <= 0.5
    low = _descending(rest, jnp.where(small, m, 0.25))
    high = _ascending(rest, jnp.where(small, 0.25, m1))
    s, c, d = (jnp.where(small, one, other) for one, other in zip(low, high, strict=True))
    sign = jnp.where(turns % 2.0 == 0.0, 1.0, -1.0)
    return sign * s, sign * c, d


def _descending(u: Any, m: Any) -> tuple[Any, Any, Any]:
    """Landen's transformation towards m = 0, where the functions are circular."""
    moduli = []
    square = m
    for _ in range(_LANDEN_STEPS):
        modulus = square / (1.0 + jnp.sqrt(1.0 - square)) ** 2
        moduli.append(modulus)
        u = u / (1.0 + modulus)
        square = modulus * modulus
    s, c, d = jnp.sin(u), jnp.cos(u), jnp.ones_like(u)
    for modulus in reversed(moduli):
        part = modulus * s * s
        s, c, d = (1.0 + modulus) * s / (1.0 + part), c * d / (1.0 + part), (1 - part) / (1 + part)
    return s, c, d


def _ascending(u: Any, m1: Any) -> tuple[Any, Any, Any]:
    """Landen's transformation towards m = 1, where the functions are hyperbolic."""
    moduli = []
    square = m1
    for _ in range(_LANDEN_STEPS):
        modulus = square / (1.0 + jnp.sqrt(1.0 - square)) ** 2
        moduli.append(modulus)
        u = u / (1.0 + modulus)
        square = modulus * modulus
    u = jnp.clip(u, -_FAR, _FAR)
    s, c = jnp.tanh(u), 1.0 / jnp.cosh(u)
    d = c
    for modulus in reversed(moduli):
        part = modulus * s * s
        s, c, d = (1.0 + modulus) * s * c / d, (c * c - part) / d, (c * c + part) / d
    return s, c, d


# The Duffing oscillator ----------------------------------------------------------------------


def duffing_motion(t: Any, omega: Any, beta: Any, z0: Any, v0: Any) -> Any:
    """The solution of z'' + omega^2 z + beta z^3 = 0 from z0 with the velocity v0 at t = 0.

    With the energy h = v0^2/2 + omega^2 z0^2/2 + beta z0^4/4, the rate W^2 = sqrt(omega^4 +
    4 beta h), the amplitude A^2 = 4 h/(W^2 + omega^2) and m = beta A^2/(2 W^2) the motion is
    A cn(W t + c, m); the addition theorem of cn takes the place of the phase c.

    Parameters
    ----------
    t : float (n,)
        Times [s].
    omega : float
        [rad/s], above zero.
    beta : float
        [1/(m^2 s^2)]; where it is negative the motion must stay within the potential's barriers,
        or the result is NaN.
    z0, v0 : float
        [m], [m/s]

    Returns
    -------
    float (n,)
        Heights [m]; differentiable in every argument.

    Source: I. Kovacic, M. J. Brennan, The Duffing Equation, 2011, doi:10.1002/9780470977859, ch. 3.
    """
    energy = 0.5 * v0**2 + 0.5 * omega**2 * z0**2 + 0.25 * beta * z0**4
    rate2 = jnp.sqrt(omega**4 + 4.0 * beta * energy)
    rate = jnp.sqrt(rate2)
    amplitude2 = 4.0 * energy / (rate2 + omega**2)
    s, c, d = _functions(rate * t, 0.5 * beta * amplitude2 / rate2)
    left = 0.5 * beta * (amplitude2 - z0**2) / rate2
    return (z0 * c + v0 / rate * s * d) / (1.0 - left * s * s)


def duffing_frequency(swing: Any, omega: Any, beta: Any) -> Any:
    """The backbone of the Duffing oscillator: angular frequency [rad/s] at an amplitude [m]."""
    rate2 = omega**2 + beta * jnp.asarray(swing, jnp.float64) ** 2
    return jnp.pi * jnp.sqrt(rate2) / (2.0 * quarter_period(0.5 * beta * swing**2 / rate2))


# The damped ansatz ---------------------------------------------------------------------------


class DampedElliptic(NamedTuple):
    """z(t) = rest + a(t) cn(2 K(m) phase(t)/pi, m(t)), slowly damped.

    Attributes
    ----------
    rest, swing : float
        Level of rest, and amplitude a at t = 0 [m].
    phase : float
        At t = 0 [rad].
    decay : float
        lam of the term 2 lam z' [1/s].
    omega, beta : float
        Of the spring omega^2 z + beta z^3 [rad/s], [1/(m^2 s^2)].
    """

    rest: Any
    swing: Any
    phase: Any
    decay: Any
    omega: Any
    beta: Any


def damped_elliptic(t: Any, ansatz: DampedElliptic) -> Any:
    """The damped elliptic ansatz at times t (n,), from 0 on: an approximate Duffing motion.

    Amplitude and phase follow the averaged energy balance, a' = -2 lam a <sn^2 dn^2>,
    phase' = pi W/(2 K(m)) with W^2 = omega^2 + beta a^2, m = beta a^2/(2 W^2); the error is of the
    order of lam/omega. For beta = 0 it is the damped cosine.

    Source: P. G. D. Barkham, A. C. Soudack 1969, doi:10.1080/00207176908905886 (the method of
    Krylov and Bogoliubov with elliptic functions).
    """
    t = jnp.asarray(t, jnp.float64)
    step = jnp.max(t) / _SLOW_STEPS
    step = jnp.where(step > 0.0, step, 1.0)

    def slow(swing: Any) -> tuple[Any, Any]:
        return _decay_rate(swing, ansatz), duffing_frequency(swing, ansatz.omega, ansatz.beta)

    def advance(state: Any, _: Any) -> Any:
        swing, phase = state
        rates = [slow(swing)]
        for share in (0.5, 0.5, 1.0):
            rates.append(slow(swing + share * step * rates[-1][0]))
        moved = [
            value + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            for value, k1, k2, k3, k4 in zip(state, *rates, strict=True)
        ]
        return tuple(moved), (swing, phase, *rates[0])

    start = (jnp.asarray(ansatz.swing, jnp.float64), jnp.asarray(ansatz.phase, jnp.float64))
    _, nodes = jax.lax.scan(advance, start, None, length=_SLOW_STEPS + 1)
    swing, phase = _at(t / step, step, *nodes)
    m = 0.5 * ansatz.beta * swing**2 / (ansatz.omega**2 + ansatz.beta * swing**2)
    return ansatz.rest + swing * cn(2.0 * quarter_period(m) * phase / jnp.pi, m)


def _decay_rate(swing: Any, ansatz: DampedElliptic) -> Any:
    """Da/dt of the averaged energy balance."""
    ratio = ansatz.beta * swing**2 / (ansatz.omega**2 + ansatz.beta * swing**2)
    m = 0.5 * ratio
    # <sn^2 dn^2> = ((2 m - 1) E + (1 - m) K)/(3 m K), which is 1/2 - m/16 + ... near m = 0.
    near = jnp.abs(m) < 1e-3
    safe = jnp.where(near, 0.25, m)
    integral = quarter_period(safe)
    mean = ((2 * safe - 1) * second_integral(safe) + (1 - safe) * integral) / (3 * safe * integral)
    series = 0.5 - m / 16.0 - m**2 / 32.0
    return -2.0 * ansatz.decay * swing * jnp.where(near, series, mean)


def _at(place: Any, step: Any, swing: Any, phase: Any, d_swing: Any, d_phase: Any) -> Any:
    """Cubic Hermite values of the slow motion at places on its grid."""
    index = jnp.clip(place.astype(jnp.int32), 0, _SLOW_STEPS - 1)
    s = place - index
    late = s * s * (3.0 - 2.0 * s)

    def value(y: Any, slope: Any) -> Any:
        bend = s * (1.0 - s) * ((1.0 - s) * slope[index] - s * slope[index + 1])
        return y[index] * (1.0 - late) + y[index + 1] * late + step * bend

    return value(swing, d_swing), value(phase, d_phase)


@dataclasses.dataclass(frozen=True)
class EllipticFit:
    """A damped elliptic ansatz that was fitted to a record.

    Attributes
    ----------
    ansatz : DampedElliptic
        For times since the record's start.
    errors : DampedElliptic
        Standard errors of its numbers, for white residuals.
    residual : float
        Root mean square of height minus ansatz [m].
    """

    ansatz: DampedElliptic
    errors: DampedElliptic
    residual: float


def fit_damped_elliptic(record: PistonRecord) -> EllipticFit:
    """Fit the damped elliptic ansatz for z(t) to a record, by least squares.

    Raises
    ------
    RecordError
        If the record is too short or does not move, or no start leads to a finite ansatz.
    """
    from scipy.optimize import least_squares

    guess = first_guesses(record)
    time = record.time - record.time[0]
    swing = guess.amplitude
    size = np.array(
        [swing, swing, 1.0, guess.frequency, guess.frequency, (guess.frequency / swing) ** 2]
    )
    phase = float(np.arctan2(-guess.velocity / guess.frequency, guess.height - guess.rest))
    value, slope = _compiled()

    def residual(x: np.ndarray) -> np.ndarray:
        found = np.asarray(value(time, DampedElliptic(*(x * size)))) - record.height
        return np.where(np.isfinite(found), found, 1e3 * swing) / swing

    def jacobian(x: np.ndarray) -> np.ndarray:
        columns = np.stack([np.asarray(c) for c in slope(time, DampedElliptic(*(x * size)))], 1)
        return np.where(np.isfinite(columns), columns, 0.0) * size / swing

    best = None
    for bend in (0.0, 0.3, -0.2):
        start = np.array(
            [guess.rest / swing, 1.0, phase, guess.decay / guess.frequency, 1.0 - 0.3 * bend, bend]
        )
        found = least_squares(residual, start, jacobian, x_scale="jac", max_nfev=_MOST_FITS)
        best = found if best is None or found.cost < best.cost else best
    limit = 0.5 * len(time) * (_POOR * float(record.height.std()) / swing) ** 2
    if best is None or not best.cost < limit:
        raise RecordError(
            "no start led to a damped elliptic motion that follows the record; it must swing "
            "about one level of rest: give a later part of it, record.between(start, stop)"
        )
    variance = 2.0 * best.cost / max(1, len(time) - len(size))
    errors = np.sqrt(variance * np.diag(np.linalg.pinv(best.jac.T @ best.jac))) * size
    rms = swing * float(np.sqrt(2.0 * best.cost / len(time)))
    return EllipticFit(
        DampedElliptic(*map(float, best.x * size)), DampedElliptic(*map(float, errors)), rms
    )


@functools.cache
def _compiled() -> tuple[Callable[..., Any], Callable[..., Any]]:
    return jax.jit(damped_elliptic), jax.jit(jax.jacfwd(damped_elliptic, argnums=1))
