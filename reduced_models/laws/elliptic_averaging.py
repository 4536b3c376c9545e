"""Elliptic averaging: from a damped elliptic motion that was fitted to a law of motion.

A swing whose amplitude, rate and modulus drift slowly, z = rest + a(t) cn(W(a) t + ... | m(a)), has
the drift that its damping averages to. With x = z - rest, a spring k x + beta x^3 and a damping
2 (decay + bend x^2) x' the amplitude obeys

    a' = -2 a <(decay + bend a^2 cn^2) sn^2 dn^2>,  W^2 = k + beta a^2,  m = beta a^2/(2 W^2),

means over a period. So the numbers that describe the drift are those of a law: of a Duffing
oscillator with drag, or of the Van der Pol-like law, whose damping is a parabola. The error is of
the order of the damping over the rate.

Source: P. G. D. Barkham, A. C. Soudack 1969, doi:10.1080/00207176908905886 (the method of Krylov
and Bogoliubov with elliptic functions); V. T. Coppola, R. H. Rand, Averaging using elliptic
functions: approximation of limit cycles, Acta Mechanica 81 (1990) 125.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import RecordError
from reduced_models.laws.height_map import HeightMap
from reduced_models.records.first_guesses import first_guesses

_AMPLITUDES = 48
_PLACES = 24  # of a quarter period, for the means
_NODES = 400  # of the slow motion
_MOST_FITS = 80
_ALONG = 101  # heights of a swing at which the damping is looked at
_POOR = 0.5  # of the record's standard deviation: a residual that follows nothing


class AveragedMotion(NamedTuple):
    """A damped elliptic motion.

    Attributes
    ----------
    rest, swing : float
        Level of rest, and amplitude at the start [m].
    phase : float
        At the start [rad].
    decay, bend : float
        The damping 2 (decay + bend x^2) x' [1/s], [1/(m^2 s)].
    k, beta : float
        The spring k x + beta x^3 [1/s^2], [1/(m^2 s^2)]; k above zero.
    """

    rest: float
    swing: float
    phase: float
    decay: float
    bend: float
    k: float
    beta: float


@dataclasses.dataclass(frozen=True, eq=False)
class AveragedFit:
    """A damped elliptic motion that was fitted to a record.

    Attributes
    ----------
    motion : AveragedMotion
    covariance : float64 (7, 7)
        Of its numbers, for white residuals.
    residual : float
        Root mean square of height minus motion [m].
    """

    motion: AveragedMotion
    covariance: np.ndarray
    residual: float

    @property
    def duffing(self) -> dict[str, float]:
        """The parameters of the law ``"duffing"`` that has this motion; its drag is linear."""
        one = self.motion
        return {"lam": one.decay, "k": self._stiffness, "rest": one.rest, "beta": one.beta}

    @property
    def _stiffness(self) -> float:
        """Of the small swing: drag slows it by decay^2, which the averaged motion has in k."""
        return self.motion.k + self.motion.decay**2

    def van_der_pol_like(self, height_map: HeightMap) -> dict[str, float]:
        """The parameters of the law ``"van-der-pol-like"`` for z = ``height_map`` of the height.

        Its damping 2 alpha (z^2 - 2 z) is 2 alpha (r^2 - 2 r) at the level of rest r, and curved by
        alpha/scale^2; what is odd in x averages out. Both tell alpha, each by its certainty.

        Averaging is of the first order in the damping. On made records with 1 % of noise alpha is
        off by 0.6 % where the damping comes to 0.13 of critical within the swing, by 2 % at 0.4 and
        by 3 % at 0.75; beyond critical all numbers go astray (a tenth at 1.8, a quarter at 2.3).

        Raises
        ------
        RecordError
            If the damping comes to critical within the swing.
        """
        one = self.motion
        level = float(height_map.to_law(one.rest))
        share = np.array([level**2 - 2.0 * level, 1.0 / height_map.scale**2])
        places = [AveragedMotion._fields.index(name) for name in ("decay", "bend")]
        weight = np.linalg.pinv(self.covariance[np.ix_(places, places)])
        found = np.array([one.decay, one.bend])
        alpha = float(share @ weight @ found / (share @ weight @ share))
        rate = self._stiffness**0.5
        z = level + one.swing / height_map.scale * np.linspace(-1.0, 1.0, _ALONG)
        critical = float(np.abs(alpha * (z**2 - 2.0 * z)).max()) / rate
        if critical >= 1.0:
            raise RecordError(
                f"within the swing the damping comes to {critical:.2g} of critical, and averaging "
                "holds below 1: fit the law itself, fit(record, 'van-der-pol-like')"
            )
        return {"alpha": alpha, "omega": rate, "g0": self._stiffness * level}


def averaged_motion(time: np.ndarray, motion: AveragedMotion) -> np.ndarray:
    """Heights (n,) at times from 0 on [m]; NaN where the amplitude leaves what the spring holds."""
    swings = np.linspace(0.02, 1.3, _AMPLITUDES) * abs(motion.swing)
    rate, pitch = _slow_rates(swings, motion)
    if not (np.isfinite(rate).all() and np.isfinite(pitch).all()):
        return np.full(len(time), np.nan)
    end = float(time[-1])
    step = end / _NODES
    swing, phase = abs(motion.swing), motion.phase
    nodes = np.empty((_NODES + 1, 2))
    for k in range(_NODES + 1):
        nodes[k] = swing, phase
        if not swings[0] < swing < swings[-1]:
            if not swing < swings[-1]:
                return np.full(len(time), np.nan)
            # Below the table the swing decays as it does at the table's end.
            swing, phase = swing * np.exp(rate[0] / swings[0] * step), phase + pitch[0] * step
            continue
        middle = swing + 0.5 * step * float(np.interp(swing, swings, rate))
        swing += step * float(np.interp(middle, swings, rate))
        phase += step * float(np.interp(middle, swings, pitch))
    grid = np.linspace(0.0, end, _NODES + 1)
    from scipy.interpolate import CubicSpline

    slow = CubicSpline(grid, nodes)(time)
    return motion.rest + _elliptic_cosine(slow[:, 0], slow[:, 1], motion)


def _modulus(swing: np.ndarray, motion: AveragedMotion) -> tuple[np.ndarray, np.ndarray]:
    """The parameter m of a swing and its rate W."""
    square = motion.k + motion.beta * swing**2
    with np.errstate(all="ignore"):
        return 0.5 * motion.beta * swing**2 / square, np.sqrt(square)


def _slow_rates(swings: np.ndarray, motion: AveragedMotion) -> tuple[np.ndarray, np.ndarray]:
    """Rates of amplitude and phase (s,) at amplitudes."""
    from scipy.special import ellipk

    m, rate = _modulus(swings, motion)
    quarter = ellipk(m)
    places = (np.arange(_PLACES) + 0.5) / _PLACES
    s, c, d = _functions(quarter[:, None] * places, m[:, None])
    damping = motion.decay + motion.bend * (swings[:, None] * c) ** 2
    mean = (damping * (s * d) ** 2).mean(axis=1)
    return -2.0 * swings * mean, 0.5 * np.pi * rate / quarter


def _elliptic_cosine(swing: np.ndarray, phase: np.ndarray, motion: AveragedMotion) -> np.ndarray:
    from scipy.special import ellipk

    m, _ = _modulus(swing, motion)
    return np.asarray(swing * _functions(2.0 * ellipk(m) * phase / np.pi, m)[1])


def _functions(u: np.ndarray, m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """sn, cn and dn, also for m < 0 (Abramowitz & Stegun 1964, 16.10)."""
    from scipy.special import ellipj

    below = m < 0.0
    stretch = np.sqrt(np.where(below, 1.0 - m, 1.0))
    s, c, d, _ = ellipj(u * stretch, np.where(below, -m / (1.0 - m), m))
    return (
        np.where(below, s / (d * stretch), s),
        np.where(below, c / d, c),
        np.where(below, 1.0 / d, d),
    )


def fit_averaged_motion(record: PistonRecord) -> AveragedFit:
    """Fit a damped elliptic motion to a record, by least squares.

    Raises
    ------
    RecordError
        If the record is too short or does not move, or no start leads to a motion that follows it.
    """
    from scipy.optimize import least_squares

    guess = first_guesses(record)
    time, swing = record.time - record.time[0], guess.amplitude
    square = guess.frequency**2
    size = np.array(
        [swing, swing, 1.0, guess.frequency, guess.frequency / swing**2, square, square / swing**2]
    )
    phase = float(np.arctan2(-guess.velocity / guess.frequency, guess.height - guess.rest))

    def residual(x: np.ndarray) -> np.ndarray:
        found = AveragedMotion(*(x * size))
        if not found.k > 0.0 or not found.k + 1.5 * found.beta * found.swing**2 > 0.0:
            return np.full(len(time), 1e3)
        left = (averaged_motion(time, found) - record.height) / swing
        return np.where(np.isfinite(left), left, 1e3)

    share = guess.decay / guess.frequency
    starts = (
        np.array([guess.rest / swing, 1.0, phase, share, bend, 1.0 - 0.75 * hardness, hardness])
        for bend, hardness in ((0.0, 0.0), (share, 0.3), (0.0, -0.2))
    )
    fits = [least_squares(residual, one, x_scale="jac", max_nfev=_MOST_FITS) for one in starts]
    best = min(fits, key=lambda one: float(one.cost))
    rms = float(np.sqrt(2.0 * best.cost / len(time)))
    if not swing * rms < _POOR * float(record.height.std()):
        raise RecordError(
            "no start led to a damped elliptic motion that follows the record; it must swing "
            "about one level of rest: give a later part of it, record.between(start, stop)"
        )
    variance = 2.0 * best.cost / max(1, len(time) - len(size))
    covariance = variance * np.linalg.pinv(best.jac.T @ best.jac) * np.outer(size, size)
    return AveragedFit(AveragedMotion(*map(float, best.x * size)), covariance, swing * rms)
