"""Jacobi's elliptic functions behind a cubic spring: the undamped motion, and slow damping.

Jacobi's functions of W t solve y'' = -k y - beta y^3: A cn(W t | m) where a spring stiffens or goes
through both of two wells, A sn(W t | m) where it softens, and A dn(W t | m) within one of two wells
(Kovacic & Brennan 2011, doi:10.1002/9780470977859, ch. 3).

Damping makes the amplitude drift. Averaged over a cycle of that motion, 2 (decay + tilt x +
bend x^2) x' leaves

    a' = -2 a <(decay + bend a^2 cn^2) sn^2 dn^2>,  W^2 = k + beta a^2,  m = beta a^2/(2 W^2),

with an error of the order of the damping over the rate; what is odd in x averages out (the method
of Krylov and Bogoliubov with elliptic functions: P. G. D. Barkham, A. C. Soudack 1969,
doi:10.1080/00207176908905886; V. T. Coppola, R. H. Rand, Acta Mechanica 81 (1990) 125).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from granular.shared.array_types import Float
from reduced_models.laws.duffing import DUFFING
from reduced_models.laws.van_der_pol_like import VAN_DER_POL_LIKE

# Of a quarter period, for the means: the midpoint rule of a periodic function converges faster than any
# power.
_POINTS = 32
_ALONG = 101  # heights of a swing at which the damping is looked at


class EllipticMotion(NamedTuple):
    """z(t) = rest + amplitude * function(rate t + phase | m)."""

    function: str  # cn, sn or dn
    rest: float  # [m]
    amplitude: float  # [m]
    rate: float  # [rad/s]
    m: float  # parameter k^2, from 0 to 1

    def text(self, digits: int = 4) -> str:
        """Motion as a formula, at any phase."""
        numbers = (f"{value:.{digits}g}" for value in (self.amplitude, self.rate, self.m))
        amplitude, rate, m = numbers
        rest = f"{self.rest:.{digits}g} + " if abs(self.rest) > 1e-3 * abs(self.amplitude) else ""
        return f"z(t) = {rest}{amplitude} {self.function}({rate} t + phase | {m})"


def elliptic_motion(k: float, beta: float, rest: float, z0: float, v0: float) -> EllipticMotion | None:
    """Motion of z'' + k (z - rest) + beta (z - rest)^3 = 0 from z0 [m] and v0 [m/s]."""
    # By energy: k [1/s^2], beta [1/(m^2 s^2)]. The squared amplitude solves k a^2/2 + beta a^4/4 = energy.
    swing = z0 - rest
    energy = 0.5 * v0**2 + 0.5 * k * swing**2 + 0.25 * beta * swing**4
    square = k**2 + 4.0 * beta * energy
    if not square > 0.0:
        return None
    root = math.sqrt(square)
    if k < 0.0 and energy < 0.0 < beta:
        # Within a well: the outer turning point is the amplitude.
        amplitude = math.copysign(math.sqrt((root - k) / beta), swing)
        rate2 = 0.5 * (root - k)
        return EllipticMotion("dn", rest, amplitude, math.sqrt(rate2), 2.0 + k / rate2)
    if not energy > 0.0 or not root + k > 0.0:
        return None
    amplitude2 = 4.0 * energy / (root + k)
    if beta >= 0.0:
        m = 0.5 * beta * amplitude2 / root
        return EllipticMotion("cn", rest, math.sqrt(amplitude2), math.sqrt(root), m)
    rate2 = k + 0.5 * beta * amplitude2
    if not rate2 > 0.0 or swing**2 > amplitude2 * (1.0 + 1e-9):
        return None  # beyond the barrier, or on it
    m = -0.5 * beta * amplitude2 / rate2
    return EllipticMotion("sn", rest, math.sqrt(amplitude2), math.sqrt(rate2), m)


class DuffingVanDerPolOscillator(NamedTuple):
    """x'' + 2 (decay + tilt x + bend x^2) x' + k x + beta x^3 = 0, x from a level of rest."""

    k: float  # [1/s^2]
    beta: float  # [1/(m^2 s^2)]
    decay: float  # [1/s]
    tilt: float = 0.0  # [1/(m s)]
    bend: float = 0.0  # [1/(m^2 s)]


def _duffing_oscillator(values: Mapping[str, float]) -> DuffingVanDerPolOscillator:
    return DuffingVanDerPolOscillator(values["k"], values["beta"], values["lam"])


def _van_der_pol_like_oscillator(values: Mapping[str, float]) -> DuffingVanDerPolOscillator:
    alpha, square, scale = values["alpha"], values["omega"] ** 2, values.get("scale", 1.0)
    level = values["g0"] / square
    decay, tilt = alpha * (level**2 - 2.0 * level), 2.0 * alpha * (level - 1.0) / scale
    return DuffingVanDerPolOscillator(square, 0.0, decay, tilt, alpha / scale**2)


OSCILLATORS: Mapping[str, Callable[[Mapping[str, float]], DuffingVanDerPolOscillator]] = {
    DUFFING.name: _duffing_oscillator,
    VAN_DER_POL_LIKE.name: _van_der_pol_like_oscillator,
}
"""Laws by name, which make an oscillator of their parameters."""


def averaged_amplitude(
    time: Float[np.ndarray, "n"], amplitude: float, oscillator: DuffingVanDerPolOscillator
) -> Float[np.ndarray, "n"]:
    """Amplitudes [m] at increasing times [s], from that at the first."""
    from scipy.integrate import solve_ivp

    ivp = solve_ivp(
        lambda _, a: _amplitude_rate(a, oscillator),
        (time[0], time[-1]),
        [amplitude],
        t_eval=time,
        rtol=1e-8,
        atol=1e-10 * amplitude,
    )
    return np.asarray(ivp.y[0])


def averaged_frequency(
    amplitude: Float[np.ndarray, "n"], oscillator: DuffingVanDerPolOscillator
) -> Float[np.ndarray, "n"]:
    """Backbone [Hz] at amplitudes [m]."""
    from scipy.special import ellipk

    rate, m = _elliptic_rate_and_parameter(amplitude, oscillator)
    return np.asarray(rate / (4.0 * ellipk(m)))


def greatest_damping_over_rate(amplitude: float, oscillator: DuffingVanDerPolOscillator) -> float:
    """Greatest damping within a swing over the rate of its elliptic function; amplitude [m]."""
    x = amplitude * np.linspace(-1.0, 1.0, _ALONG)
    rate, _ = _elliptic_rate_and_parameter(np.array([amplitude]), oscillator)
    return float(np.abs(oscillator.decay + oscillator.tilt * x + oscillator.bend * x**2).max() / rate[0])


def swings_through_rest(amplitude: Float[np.ndarray, "n"], oscillator: DuffingVanDerPolOscillator) -> bool:
    """Tell whether swings of these amplitudes go through rest and turn back; amplitude [m]."""
    stiffening = oscillator.beta * amplitude**2
    return bool((np.minimum(oscillator.k + 0.5 * stiffening, oscillator.k + stiffening) > 0.0).all())


def _elliptic_rate_and_parameter(
    amplitude: np.ndarray, oscillator: DuffingVanDerPolOscillator
) -> tuple[np.ndarray, np.ndarray]:
    stiffening = oscillator.beta * amplitude**2
    # Not quite up to a hump or a barrier, where a cycle takes for ever.
    least = 0.5 * (1.0 + 1e-9) * stiffening if oscillator.beta > 0.0 else 1e-6 * oscillator.k
    square = np.maximum(oscillator.k + stiffening, least)
    return np.sqrt(square), 0.5 * stiffening / square


def _amplitude_rate(amplitude: np.ndarray, oscillator: DuffingVanDerPolOscillator) -> np.ndarray:
    """Da/dt (n,) at amplitudes (n,), by means over a quarter period."""
    from scipy.special import ellipk

    _, m = _elliptic_rate_and_parameter(amplitude, oscillator)
    indices = (np.arange(_POINTS) + 0.5) / _POINTS
    s, c, d = _jacobi_functions(ellipk(m)[:, None] * indices, m[:, None])
    damping = oscillator.decay + oscillator.bend * (amplitude[:, None] * c) ** 2
    return np.asarray(-2.0 * amplitude * (damping * (s * d) ** 2).mean(axis=1))


def _jacobi_functions(u: np.ndarray, m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """sn, cn and dn, also for m < 0 (Abramowitz & Stegun 1964, 16.10)."""
    from scipy.special import ellipj

    below = m < 0.0
    stretch = np.sqrt(np.where(below, 1.0 - m, 1.0))
    s, c, d, _ = ellipj(u * stretch, np.where(below, -m / (1.0 - m), m))
    return (np.where(below, s / (d * stretch), s), np.where(below, c / d, c), np.where(below, 1.0 / d, d))
