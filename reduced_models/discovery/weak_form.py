"""The weak form of an equation of motion, and the noise in it.

z'' = f(z, z', u) is multiplied by a smooth bump and integrated; integration by parts moves the
derivatives from the data to the bump (Messenger & Bortz 2021, doi:10.1137/20M1343166). A spring
needs z alone, and so does every damping G'(z) z', the rate of G(z); only drag and dry friction need
an estimate of z'. The record's noise enters each integral linearly, with known weights; dividing by
its covariance makes the residuals white, of unit variance (Bortz, Messenger & Dukic 2023,
doi:10.1007/s11538-023-01208-6), so that their squares are a likelihood.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.formulas.algebra import function_of
from reduced_models.discovery.symbols import symbols
from reduced_models.discovery.terms import AnyTerm

if TYPE_CHECKING:
    import sympy

_HALF_WIDTH = 0.4  # of a bump, in periods
_SPACING = 0.25  # of bumps, in half-widths
_POWER = 6  # of the bump (1 - s^2)^p
_LEAST_BUMPS, _MOST_BUMPS = 24, 600
_LEAST_SAMPLES = 8  # in a bump
_RANK = 1e-10


class SmoothedMotion(NamedTuple):
    """What the equations are made of.

    Attributes
    ----------
    time, z : float64 (n,)
        Times, and z as recorded.
    smooth, velocity, acceleration : float64 (n,)
        FirstGuesses of z, z', z''.
    drive : float64 (n,) or None
        The input.
    noise : float
        Standard deviation of the white noise of ``z``.
    acceleration_noise : float
        Of the estimate of z''.
    period : float
    """

    time: np.ndarray
    z: np.ndarray
    smooth: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    drive: np.ndarray | None
    noise: float
    acceleration_noise: float
    period: float


@dataclasses.dataclass(frozen=True, eq=False)
class Integrals:
    """The integrals of one motion against bumps.

    Attributes
    ----------
    motion : SmoothedMotion
    bump, slope, curvature : sparse float64 (r, n)
        Bumps and their derivatives at the samples, times the weights of the quadrature.
    target : float64 (r,)
        The integrals of z''.
    """

    motion: SmoothedMotion
    bump: Any
    slope: Any
    curvature: Any
    target: np.ndarray

    def column(self, term: AnyTerm) -> np.ndarray:
        """The integrals (r,) of a term."""
        motion = self.motion
        if term.total:
            return -np.asarray(self.slope @ term.primitive(motion.z))
        z = motion.z if term.still else motion.smooth
        return np.asarray(self.bump @ term.values(z, motion.velocity, motion.drive))

    def matrix(self, terms: Sequence[AnyTerm]) -> np.ndarray:
        """The integrals (r, p) of terms."""
        return np.stack([self.column(term) for term in terms], axis=1)

    def integral(self, expression: sympy.Expr) -> np.ndarray:
        """The integrals (r,) of any expression in z, v and u."""
        motion = self.motion
        return np.asarray(self.bump @ evaluated(expression, motion))

    def noise_weights(self, terms: Sequence[AnyTerm], coefficients: np.ndarray) -> Any:
        """How the residuals depend on each sample's noise, a sparse (r, n)."""
        motion, found = self.motion, self.curvature
        for term, value in zip(terms, coefficients, strict=True):
            if term.total:
                found = found + value * self.slope.multiply(term.by_primitive(motion.z))
            elif term.still:
                rate = term.by_height(motion.z, motion.velocity, motion.drive)
                if np.any(rate):
                    found = found - value * self.bump.multiply(rate)
            elif term.moving:
                found = found + value * self._speed_weights(term)
        return found

    def _speed_weights(self, term: AnyTerm) -> Any:
        """Those of a term that holds the speed in another way than z', by parts as well."""
        motion = self.motion
        here = motion.smooth, motion.velocity, motion.drive
        by_speed = term.by_speed(*here)
        rate = np.gradient(by_speed, motion.time) - term.by_height(*here)
        return self.slope.multiply(by_speed) + self.bump.multiply(rate)

    def whitening(self, terms: Sequence[AnyTerm], coefficients: np.ndarray) -> np.ndarray:
        """The matrix (q, r) that makes the residuals of an equation white, of unit variance."""
        weights = self.noise_weights(terms, coefficients).tocsr()
        covariance = self.motion.noise**2 * (weights @ weights.T).toarray()
        strengths, directions = np.linalg.eigh(covariance)
        kept = strengths > _RANK * strengths[-1]
        return np.asarray((directions[:, kept] / np.sqrt(strengths[kept])).T)


@dataclasses.dataclass(frozen=True, eq=False)
class WeakForm:
    """The integrals of some motions against bumps, which one equation has to explain.

    Attributes
    ----------
    parts : tuple of Integrals
        One a motion.
    """

    parts: tuple[Integrals, ...]

    @property
    def motions(self) -> tuple[SmoothedMotion, ...]:
        """The motions."""
        return tuple(part.motion for part in self.parts)

    @property
    def samples(self) -> int:
        """Of all motions."""
        return sum(len(motion.time) for motion in self.motions)

    @property
    def target(self) -> np.ndarray:
        """The integrals (r,) of z''."""
        return np.concatenate([part.target for part in self.parts])

    def matrix(self, terms: Sequence[AnyTerm]) -> np.ndarray:
        """The integrals (r, p) of terms."""
        return np.concatenate([part.matrix(terms) for part in self.parts])

    def integral(self, expression: sympy.Expr) -> np.ndarray:
        """The integrals (r,) of any expression in z, v and u."""
        return np.concatenate([part.integral(expression) for part in self.parts])

    def whitening(self, terms: Sequence[AnyTerm], coefficients: np.ndarray) -> np.ndarray:
        """The matrix (q, r) that makes the residuals of an equation white, of unit variance."""
        from scipy.linalg import block_diag

        return np.asarray(block_diag(*(part.whitening(terms, coefficients) for part in self.parts)))


def weak_form(*motions: SmoothedMotion) -> WeakForm:
    """The weak form of some motions."""
    return WeakForm(tuple(map(_integrals, motions)))


def _integrals(motion: SmoothedMotion) -> Integrals:
    """The integrals of a motion, with bumps that overlap all along it."""
    from scipy.sparse import csr_array

    time = motion.time
    duration = float(time[-1] - time[0])
    half = min(_HALF_WIDTH * motion.period, duration / 4.0)
    half = max(half, _LEAST_SAMPLES * duration / len(time))
    count = int(np.clip(duration / (_SPACING * half), _LEAST_BUMPS, _MOST_BUMPS))
    centres = np.linspace(time[0] + half, time[-1] - half, count)
    quadrature = np.gradient(time)
    parts: list[list[np.ndarray]] = [[], [], []]
    places, starts = [], [0]
    for centre in centres:
        first, last = np.searchsorted(time, (centre - half, centre + half))
        s = (time[first:last] - centre) / half
        rest = np.maximum(1.0 - s * s, 0.0)
        values = (
            rest**_POWER,
            -2.0 * _POWER * s * rest ** (_POWER - 1) / half,
            2.0 * _POWER * rest ** (_POWER - 2) * ((2 * _POWER - 1) * s * s - 1.0) / half**2,
        )
        for part, value in zip(parts, values, strict=True):
            part.append(value * quadrature[first:last])
        places.append(np.arange(first, last))
        starts.append(starts[-1] + last - first)
    indices = np.concatenate(places)
    bump, slope, curvature = (
        csr_array((np.concatenate(part), indices, starts), shape=(count, len(time)))
        for part in parts
    )
    return Integrals(motion, bump, slope, curvature, np.asarray(curvature @ motion.z))


def evaluated(expression: sympy.Expr, motion: SmoothedMotion) -> np.ndarray:
    """Values (n,) of an expression along a motion."""
    function = function_of(symbols(), expression)
    drive = 0.0 if motion.drive is None else motion.drive
    with np.errstate(all="ignore"):
        found = function(motion.smooth, motion.velocity, drive)
    return np.broadcast_to(np.asarray(found, dtype=np.float64), motion.time.shape)
