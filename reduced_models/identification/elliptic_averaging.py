"""Elliptic functions as solutions of fitted cubic laws, and decay of the amplitude by averaging.

Jacobi's elliptic functions solve x'' = -k x - beta x^3 (Kovacic & Brennan 2011,
doi:10.1002/9780470977859, ch. 3). With a rate W and a parameter m, the solution is A cn(W t | m) for a
stiffening spring or a motion across two wells, A sn(W t | m) for a softening spring, and A dn(W t | m) within
one of two wells.

A damping term 2 (decay + tilt x + bend x^2) x' slowly changes the amplitude a. Averages < > over a cycle
of the undamped motion a cn(W t | m) give

    a' = -2 a <(decay + bend a^2 cn^2) sn^2 dn^2>,  W^2 = k + beta a^2,  m = beta a^2/(2 W^2).

The relative error is of the order of the damping divided by W. Terms odd in x average to zero. This is the
method of Krylov and Bogoliubov with elliptic functions (P. G. D. Barkham, A. C. Soudack 1969,
doi:10.1080/00207176908905886; V. T. Coppola, R. H. Rand, Acta Mechanica 81 (1990) 125).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from granular.shared.array_types import Float
from granular.shared.errors import InputError, RecordError
from reduced_models.laws.duffing import DUFFING
from reduced_models.laws.linearization import SmallOscillation, make_rates_of_law, small_oscillation
from reduced_models.laws.van_der_pol_like import VAN_DER_POL_LIKE
from reduced_models.models.at_rest import engineering_units
from reduced_models.models.model import ReducedModel
from reduced_models.models.prediction import interval_half_widths
from reduced_models.models.quantities import QuantityWithError
from reduced_models.records.envelope import envelope

# Midpoints in a quarter period for the averages: for a periodic function the midpoint rule converges
# faster than any power.
_PHASES = 32
_ALONG = 101  # number of heights in a cycle at which the damping is evaluated


class EllipticMotion(NamedTuple):
    """Motion z(t) = rest + amplitude * function(rate t + phase | m), with a Jacobi elliptic function."""

    function: str  # cn, sn or dn
    rest: float  # [m]
    amplitude: float  # [m]
    rate: float  # [rad/s]
    m: float  # parameter k^2, from 0 to 1

    def text(self, digits: int = 4) -> str:
        """Return the formula of the motion with numbers; only the phase remains a symbol."""
        numbers = (f"{value:.{digits}g}" for value in (self.amplitude, self.rate, self.m))
        amplitude, rate, m = numbers
        rest = f"{self.rest:.{digits}g} + " if abs(self.rest) > 1e-3 * abs(self.amplitude) else ""
        return f"z(t) = {rest}{amplitude} {self.function}({rate} t + phase | {m})"


def elliptic_motion(k: float, beta: float, rest: float, z0: float, v0: float) -> EllipticMotion | None:
    """Return the motion of z'' + k (z - rest) + beta (z - rest)^3 = 0 from z0 [m] and v0 [m/s]."""
    # Energy conservation: the squared amplitude solves k a^2/2 + beta a^4/4 = energy, with k [1/s^2] and
    # beta [1/(m^2 s^2)].
    swing = z0 - rest
    energy = 0.5 * v0**2 + 0.5 * k * swing**2 + 0.25 * beta * swing**4
    square = k**2 + 4.0 * beta * energy
    if not square > 0.0:
        return None
    root = math.sqrt(square)
    if k < 0.0 and energy < 0.0 < beta:
        # Within one well the outer turning point is the amplitude.
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
        return None  # on or beyond the barrier
    m = -0.5 * beta * amplitude2 / rate2
    return EllipticMotion("sn", rest, math.sqrt(amplitude2), math.sqrt(rate2), m)


class DuffingVanDerPolOscillator(NamedTuple):
    """Equation x'' + 2 (decay + tilt x + bend x^2) x' + k x + beta x^3 = 0; x is zero at an equilibrium."""

    k: float  # [1/s^2]
    beta: float  # [1/(m^2 s^2)]
    decay: float  # [1/s]
    tilt: float = 0.0  # [1/(m s)]
    bend: float = 0.0  # [1/(m^2 s)]


def _van_der_pol_like_oscillator(values: Mapping[str, float]) -> DuffingVanDerPolOscillator:
    alpha, square, scale = values["alpha"], values["omega"] ** 2, values.get("scale", 1.0)
    level = values["g0"] / square
    decay, tilt = alpha * (level**2 - 2.0 * level), 2.0 * alpha * (level - 1.0) / scale
    return DuffingVanDerPolOscillator(square, 0.0, decay, tilt, alpha / scale**2)


OSCILLATORS: Mapping[str, Callable[[Mapping[str, float]], DuffingVanDerPolOscillator]] = {
    DUFFING.name: lambda values: DuffingVanDerPolOscillator(values["k"], values["beta"], values["lam"]),
    VAN_DER_POL_LIKE.name: _van_der_pol_like_oscillator,
}
"""For each law's name, the function that turns the law's parameters into an oscillator."""


def averaged_amplitude(
    time: Float[np.ndarray, "n"], amplitude: float, oscillator: DuffingVanDerPolOscillator
) -> Float[np.ndarray, "n"]:
    """Return amplitudes [m] by averaging, at increasing times [s]; ``amplitude`` [m] is at the first time."""
    from scipy.integrate import solve_ivp

    ivp = solve_ivp(
        lambda _, a: _averaged_amplitude_rate(a, oscillator),
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
    """Return the undamped frequency [Hz] at amplitudes [m] (the backbone curve)."""
    from scipy.special import ellipk

    rate, m = _elliptic_rate_and_parameter(amplitude, oscillator)
    return np.asarray(rate / (4.0 * ellipk(m)))


def maximum_damping_over_rate(amplitude: float, oscillator: DuffingVanDerPolOscillator) -> float:
    """Return the maximum of |decay + tilt x + bend x^2|/W in a cycle of this amplitude [m]."""
    x = amplitude * np.linspace(-1.0, 1.0, _ALONG)
    rate, _ = _elliptic_rate_and_parameter(np.array([amplitude]), oscillator)
    return float(np.abs(oscillator.decay + oscillator.tilt * x + oscillator.bend * x**2).max() / rate[0])


def oscillates_about_equilibrium(
    amplitude: Float[np.ndarray, "n"], oscillator: DuffingVanDerPolOscillator
) -> bool:
    """Return whether undamped motions of these amplitudes [m] oscillate about the equilibrium."""
    stiffening = oscillator.beta * amplitude**2
    return bool((np.minimum(oscillator.k + 0.5 * stiffening, oscillator.k + stiffening) > 0.0).all())


def _elliptic_rate_and_parameter(
    amplitude: np.ndarray, oscillator: DuffingVanDerPolOscillator
) -> tuple[np.ndarray, np.ndarray]:
    stiffening = oscillator.beta * amplitude**2
    # Slightly below a barrier, since the period diverges there.
    least = 0.5 * (1.0 + 1e-9) * stiffening if oscillator.beta > 0.0 else 1e-6 * oscillator.k
    square = np.maximum(oscillator.k + stiffening, least)
    return np.sqrt(square), 0.5 * stiffening / square


def _averaged_amplitude_rate(amplitude: np.ndarray, oscillator: DuffingVanDerPolOscillator) -> np.ndarray:
    """Return da/dt (n,) at amplitudes (n,), averaged over a quarter period."""
    from scipy.special import ellipk

    _, m = _elliptic_rate_and_parameter(amplitude, oscillator)
    indices = (np.arange(_PHASES) + 0.5) / _PHASES
    s, c, d = _jacobi_sn_cn_and_dn(ellipk(m)[:, None] * indices, m[:, None])
    damping = oscillator.decay + oscillator.bend * (amplitude[:, None] * c) ** 2
    return np.asarray(-2.0 * amplitude * (damping * (s * d) ** 2).mean(axis=1))


def _jacobi_sn_cn_and_dn(u: np.ndarray, m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return sn, cn and dn of u, for m < 0 by Abramowitz & Stegun (1964), 16.10."""
    from scipy.special import ellipj

    below = m < 0.0
    stretch = np.sqrt(np.where(below, 1.0 - m, 1.0))
    s, c, d, _ = ellipj(u * stretch, np.where(below, -m / (1.0 - m), m))
    return (np.where(below, s / (d * stretch), s), np.where(below, c / d, c), np.where(below, 1.0 / d, d))


# Minimum m: below it the third harmonic, m/16 of the first, is less than 6e-4.
_BENT = 0.01
# Maximum force at the middle of a spring that counts as symmetric, relative to the force at the start.
_SKEW = 1e-3
_MOST_LOST = 0.5
"""An elliptic function is reported if drag reduces the amplitude by at most this fraction in the record."""


class InitialEllipticMotion(NamedTuple):
    """Undamped motion of a fitted cubic law from its initial state, as an elliptic function."""

    model: ReducedModel
    motion: EllipticMotion
    lost: float  # fraction of the amplitude lost to drag in the record

    @property
    def text(self) -> str:
        """State the elliptic function that describes the same motion as the law."""
        loss = f" at the start (drag takes {100 * self.lost:.2g} % of the amplitude)"
        start = "" if self.lost < 0.01 else loss
        return (
            f"The motion of {self.model.law.name}{start} is {self.motion.text()}, with m = k^2: Jacobi's "
            f"{self.motion.function} solves this law, so the elliptic function and the law describe the same "
            "motion."
        )


def solve_elliptic_motion(model: ReducedModel, duration: float) -> InitialEllipticMotion | None:
    """Solve a fitted cubic law without damping; None if drag is large over the ``duration`` [s]."""
    # Jacobi's functions solve the undamped law (Kovacic & Brennan 2011, doi:10.1002/9780470977859, ch. 3).
    spring = _coefficients_of_symmetric_cubic_law(model)
    if spring is None or (lost := 1.0 - math.exp(-spring[0] * duration)) > _MOST_LOST:
        return None
    motion = elliptic_motion(*spring[1:], *model.initial)
    return InitialEllipticMotion(model, motion, lost) if motion is not None and motion.m >= _BENT else None


def _coefficients_of_symmetric_cubic_law(model: ReducedModel) -> tuple[float, float, float, float] | None:
    """Return decay, k, beta and rest of z'' + 2 decay z' + k (z - rest) + beta (z - rest)^3 = 0, or None."""
    import sympy

    law = model.law
    if law.hidden or law.inputs:
        return None
    parsed = law.parsed_equation
    z, v = parsed.symbol_z, parsed.symbol_v
    values = {sympy.Symbol(name): value for name, value in model.all_parameters.items()}
    rate = parsed.acceleration.subs(values)
    if not rate.is_polynomial(z, v):
        return None
    powers = sympy.Poly(rate, z, v).as_dict()
    cubic = {key: float(value) for key, value in powers.items()}
    if not set(cubic) <= {(0, 0), (1, 0), (2, 0), (3, 0), (0, 1)} or not cubic.get((3, 0)):
        return None
    constant, linear, square, third = (cubic.get((power, 0), 0.0) for power in range(4))
    rest = -square / (3.0 * third)
    skew = constant + rest * (linear + rest * (square + rest * third))
    z0, v0 = model.initial
    inner = linear + rest * (2.0 * square + 3.0 * rest * third)
    away = z0 - rest
    if abs(skew) > _SKEW * max(abs(inner * away), abs(third * away**3), abs(v0) * math.sqrt(abs(inner))):
        return None
    return -0.5 * cubic.get((0, 1), 0.0), -inner, -third, rest


class EllipticAveraging(NamedTuple):
    """Decay of a law's amplitude from elliptic averaging, compared with the numerical solution."""

    law: str
    unit: str
    amplitudes: tuple[float, float]  # in the first and last cycle [m, rad]
    frequencies: tuple[float, float]  # [Hz]
    solved_amplitudes: tuple[float, float]  # [m, rad]
    solved_frequencies: tuple[float, float]  # [Hz]
    critical: float  # maximum ratio of damping to critical damping; averaging needs values below 1

    @property
    def text(self) -> str:
        """Amplitude and frequency in the first and last cycle, by averaging and by numerical solution."""
        head = f"amplitude of {self.law} by elliptic averaging: "
        if not self.critical < 1.0:
            return (
                f"{head}not available, since the damping reaches {self.critical:.2g} times the critical "
                "damping within a cycle; averaging is valid below 1"
            )
        (first, last), (fast, late) = self.amplitudes, self.frequencies
        solved, own = self.solved_amplitudes[1], self.solved_frequencies
        return (
            f"{head}{first:.4g} {self.unit} in the first cycle, {last:.4g} {self.unit} in the last "
            f"({solved:.4g} {self.unit} by numerical solution), at {fast:.4g} and {late:.4g} Hz "
            f"({own[0]:.4g} and {own[1]:.4g} Hz)"
        )


def average_elliptically(model: ReducedModel, time: Float[np.ndarray, "n"]) -> EllipticAveraging | None:
    """Compare elliptic averaging of a fitted law with its numerical solution; None if impossible."""
    # Krylov-Bogoliubov averaging with elliptic functions (Barkham & Soudack 1969,
    # doi:10.1080/00207176908905886).
    make = OSCILLATORS.get(model.law.name)
    if make is None or model.law.inputs:
        return None
    oscillator = make(model.all_parameters)
    try:
        cycles = envelope(model.simulate(time))
    except (InputError, RecordError):
        return None
    if not oscillates_about_equilibrium(cycles.amplitude, oscillator):
        return None
    averaged = averaged_amplitude(cycles.time, float(cycles.amplitude[0]), oscillator)
    return EllipticAveraging(
        law=model.law.name,
        unit=model.coordinate_unit,
        amplitudes=_first_and_last(averaged),
        frequencies=_first_and_last(averaged_frequency(averaged, oscillator)),
        solved_amplitudes=_first_and_last(cycles.amplitude),
        solved_frequencies=_first_and_last(cycles.frequency / (2.0 * math.pi)),
        critical=maximum_damping_over_rate(float(cycles.amplitude[0]), oscillator),
    )


def _first_and_last(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[-1])


LOWER_WELL = "lower well"
_POINTS = 401  # number of heights in the grid that brackets equilibria
_TRIES = 8  # doublings of the time within which the motion must return


def two_well_quantities(model: ReducedModel) -> tuple[QuantityWithError, ...]:
    """Return positions and frequencies of two potential wells, and the frequency of motion across both."""
    figures = _well_heights_and_frequencies(model)
    errors = None if figures is None else interval_half_widths(model, _well_heights_and_frequencies, figures)
    if figures is None or errors is None or not len(model.covariance):
        return ()
    units = engineering_units(model.coordinate_unit, None)
    size = f"{units.scale * figures[5]:.3g} {units.length}"
    rows = (
        (LOWER_WELL, "z1", units.length, units.scale),
        ("upper well", "z2", units.length, units.scale),
        ("frequency in the lower well", "f1", "Hz", 1.0),
        ("frequency in the upper well", "f2", "Hz", 1.0),
        (f"frequency over both wells at {size}", "f", "Hz", 1.0),
    )
    return tuple(
        QuantityWithError(name, symbol, unit, scale * float(figures[k]), {"fit": scale * float(errors[k])})
        for k, (name, symbol, unit, scale) in enumerate(rows)
    )


def _well_heights_and_frequencies(model: ReducedModel) -> np.ndarray | None:
    """Return heights [m] and frequencies [Hz] of wells; frequency and amplitude [m] of motion across both."""
    law = model.law
    if law.hidden or law.inputs or "height" not in model.domain:
        return None
    values = list(model.all_parameters.values())
    rates = make_rates_of_law(law, values)

    def force(z: np.ndarray | float) -> np.ndarray:
        return np.asarray(rates(z, 0.0 * np.asarray(z))[0], dtype=float)

    z = np.linspace(*model.domain["height"], _POINTS)
    with np.errstate(all="ignore"):
        pulls = np.broadcast_to(force(z), z.shape)
    stable = np.flatnonzero((pulls[:-1] > 0.0) & (pulls[1:] <= 0.0))
    if not np.isfinite(pulls).all() or len(stable) != 2:
        return None
    swings = [small_oscillation(law, values, float(z[k])) for k in stable]
    if not all(isinstance(swing, SmallOscillation) for swing in swings):
        return None
    wells = sorted((swing.z, 1.0 / swing.period) for swing in swings)  # type: ignore[union-attr]  # checked
    orbit = _undamped_range_and_frequency(force, model)
    if orbit is None:
        return None
    low, high, frequency = orbit
    (first, slow), (second, fast) = wells
    if not low < first < second < high:
        return None
    return np.array([first, second, slow, fast, frequency, 0.5 * (high - low)])


def _undamped_range_and_frequency(
    force: Callable[[Any], np.ndarray], model: ReducedModel
) -> tuple[float, float, float] | None:
    """Return extreme heights [m] and frequency [Hz] of the undamped motion from the record's start."""
    from scipy.integrate import solve_ivp

    height, velocity = model.initial
    size = float(np.ptp(model.domain["height"]))
    pulls = np.abs(force(np.array(model.domain["height"])))
    duration = 4.0 * math.tau * math.sqrt(size / float(pulls.max()))
    for _ in range(_TRIES):
        motion = solve_ivp(
            lambda _, state: (state[1], float(force(state[0]))),
            (0.0, duration),
            (height, velocity),
            "DOP853",
            events=lambda _, state: state[1],
            rtol=1e-10,
            atol=1e-12 * size,
        )
        # By rounding, a release at zero velocity may or may not count as a turning point.
        turns = [k for k, time in enumerate(motion.t_events[0]) if time > 1e-6 * duration][:3]
        if len(turns) == 3:
            ends = motion.y_events[0][turns[:2], 0]
            period = float(motion.t_events[0][turns[2]] - motion.t_events[0][turns[0]])
            return float(ends.min()), float(ends.max()), 1.0 / period
        duration *= 2.0
    return None
