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

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import RecordError
from reduced_models.discovery.terms import AnyTerm, MotionState, evaluate_expression
from reduced_models.laws.law import HeightLine
from reduced_models.records.derivatives import derivatives, noise_level
from reduced_models.records.first_guesses import first_guesses
from reduced_models.records.inputs import input_column

if TYPE_CHECKING:
    import sympy

# Of a bump, in periods. Wider, it averages the motion itself away; narrower, its second derivative magnifies
# the noise.
_HALF_WIDTH = 0.4
_SPACING = 0.25  # of bumps, in half-widths
_POWER = 6  # of the bump (1 - s^2)^p
_LEAST_BUMPS, _MOST_BUMPS = 24, 600  # so that a library of a dozen terms is overdetermined
_LEAST_SAMPLES = 8  # in a bump
# Of the covariance's largest eigenvalue. Overlapping bumps are nearly dependent: below it is rounding, which
# whitening would blow up.
_RANK = 1e-10

_EDGE = 0.02  # fraction of a record at each end where derivatives are poor


class SmoothedMotion(NamedTuple):
    """A recorded motion with estimates of its derivatives and noise, and what an equation gives of it."""

    time: Float[np.ndarray, "n"]
    z: Float[np.ndarray, "n"]
    smooth: Float[np.ndarray, "n"]  # estimate of z
    velocity: Float[np.ndarray, "n"]  # of z'
    acceleration: Float[np.ndarray, "n"]  # of z'', or the force or the height that an equation gives
    drive: Float[np.ndarray, "n"] | None
    noise: float  # standard deviation of the white noise of z, or of the force
    acceleration_noise: float  # and of what an equation gives
    period: float  # [s]

    @property
    def recorded_state(self) -> MotionState:
        """The state with z as it was recorded."""
        return MotionState(self.z, self.velocity, self.drive, self.time)

    @property
    def smooth_state(self) -> MotionState:
        """The state with the estimate of z."""
        return MotionState(self.smooth, self.velocity, self.drive, self.time)

    @property
    def inner(self) -> SmoothedMotion:
        """The motion without its ends, where derivatives are poor."""
        edge = int(_EDGE * len(self.time))
        rows = slice(edge, len(self.time) - edge)
        columns: Any = (value[rows] if isinstance(value, np.ndarray) else value for value in self)
        return SmoothedMotion(*columns)


@dataclasses.dataclass(frozen=True, eq=False)
class MotionIntegrals:
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
    target: Float[np.ndarray, "r"]
    white_noise: float | None = None

    def term_integrals(self, term: AnyTerm) -> Float[np.ndarray, "r"]:
        """Integrals of a term against the bumps.

        A term G'(z) z' is integrated by parts, so that it needs no z' (Messenger & Bortz 2021,
        doi:10.1137/20M1343166).

        Parameters
        ----------
        term : term
            Term in z, z' and the input.

        Returns
        -------
        float64 (r,)
            One for each bump, in the unit of the term times s.
        """
        motion = self.motion
        if term.is_total_derivative:
            return -np.asarray(self.slope @ term.antiderivative(motion.z))
        state = motion.recorded_state if term.is_speed_independent else motion.smooth_state
        return np.asarray(self.bump @ term.values(state))

    def expression_integrals(self, expression: sympy.Expr) -> Float[np.ndarray, "r"]:
        """Integrals of any expression in z, z' and the input against the bumps.

        Parameters
        ----------
        expression : sympy.Expr
            In the symbols of `motion_symbols`.

        Returns
        -------
        float64 (r,)
            One for each bump, in the unit of the expression times s.
        """
        return np.asarray(self.bump @ evaluate_expression(expression, self.motion.smooth_state))

    def residual_noise_weights(self, terms: Sequence[AnyTerm], coefficients: Float[np.ndarray, "p"]) -> Any:
        """Compute the derivatives of an equation's weak residuals by the noise of each sample of z.

        To first order in the noise (Bortz, Messenger & Dukic 2023, doi:10.1007/s11538-023-01208-6).

        Parameters
        ----------
        terms : sequence of terms
            Terms of the equation.
        coefficients : float64 (p,)
            Coefficient of each.

        Returns
        -------
        sparse float64 (r, n)
            A row for each bump, a column for each sample [1/s].
        """
        motion, weights = self.motion, self.curvature
        if self.white_noise is not None:
            return self.bump * (self.white_noise / motion.noise)
        for term, value in zip(terms, coefficients, strict=True):
            if term.is_total_derivative:
                weights = weights + value * self.slope.multiply(term.height_factor(motion.z))
            elif term.is_speed_independent:
                rate = term.derivative_by_height(motion.recorded_state)
                if np.any(rate):
                    weights = weights - value * self.bump.multiply(rate)
            elif term.varies_with_speed:
                weights = weights + value * self._speed_weights(term)
        return weights

    def _speed_weights(self, term: AnyTerm) -> Any:
        """Weights of a term that holds the speed otherwise than as z', by parts as well."""
        state = self.motion.smooth_state
        by_speed = term.derivative_by_speed(state)
        rate = np.gradient(by_speed, self.motion.time) - term.derivative_by_height(state)
        return self.slope.multiply(by_speed) + self.bump.multiply(rate)

    def whitening_matrix(
        self, terms: Sequence[AnyTerm], coefficients: Float[np.ndarray, "p"]
    ) -> Float[np.ndarray, "q r"]:
        """Matrix that makes the weak residuals of an equation white, of unit variance.

        Inverse square root of their covariance on its numerical range (Bortz, Messenger & Dukic 2023,
        doi:10.1007/s11538-023-01208-6).

        Parameters
        ----------
        terms : sequence of terms
            Terms of the equation; none for the noise of z'' alone.
        coefficients : float64 (p,)
            Coefficient of each.

        Returns
        -------
        float64 (q, r)
            One row for each direction of the residuals that the noise reaches; q is r at most.
        """
        weights = self.residual_noise_weights(terms, coefficients).tocsr()
        covariance = self.motion.noise**2 * (weights @ weights.T).toarray()
        strengths, directions = np.linalg.eigh(covariance)
        saved = strengths > _RANK * strengths[-1]
        return np.asarray((directions[:, saved] / np.sqrt(strengths[saved])).T)


@dataclasses.dataclass(frozen=True, eq=False)
class WeakForm:
    """The integrals of some motions against bumps, which one equation has to explain."""

    parts: tuple[MotionIntegrals, ...]

    @property
    def motions(self) -> tuple[SmoothedMotion, ...]:
        """Motions whose integrals these are, a tuple of SmoothedMotion."""
        return tuple(part.motion for part in self.parts)

    @property
    def sample_count(self) -> int:
        """Number of samples of all motions together."""
        return sum(len(motion.time) for motion in self.motions)

    @property
    def target(self) -> np.ndarray:
        """Integrals of z'' (or of the force) against all bumps, float64 (r,), in the unit of z over s."""
        return np.concatenate([part.target for part in self.parts])

    def term_integral_matrix(self, terms: Sequence[AnyTerm]) -> Float[np.ndarray, "r p"]:
        """Integrals of several terms against the bumps of all motions."""
        columns = [np.concatenate([part.term_integrals(term) for part in self.parts]) for term in terms]
        return np.stack(columns, axis=1)

    def expression_integrals(self, expression: sympy.Expr) -> Float[np.ndarray, "r"]:
        """Integrals of any expression in z, z' and the input against the bumps of all motions."""
        return np.concatenate([part.expression_integrals(expression) for part in self.parts])

    def whitening_matrix(
        self, terms: Sequence[AnyTerm], coefficients: Float[np.ndarray, "p"]
    ) -> Float[np.ndarray, "q r"]:
        """Matrix that makes the weak residuals of all motions white, of unit variance."""
        # A block for each motion: their noises are independent.
        from scipy.linalg import block_diag

        return np.asarray(block_diag(*(part.whitening_matrix(terms, coefficients) for part in self.parts)))


def weak_form(*motions: SmoothedMotion) -> WeakForm:
    """Weak form of the equation of motion of some motions."""
    # Bumps (1 - s^2)^6 of 0.4 periods to either side, a tenth of a period apart, but for very short and long
    # records (Messenger & Bortz 2021, doi:10.1137/20M1343166).
    return WeakForm(tuple(map(_motion_integrals, motions)))


def _motion_integrals(motion: SmoothedMotion) -> MotionIntegrals:
    """Integrals of a motion, with bumps that overlap all along it."""
    from scipy.sparse import csr_array

    time = motion.time
    duration = float(time[-1] - time[0])
    half = min(_HALF_WIDTH * motion.period, duration / 4.0)
    half = max(half, _LEAST_SAMPLES * duration / len(time))
    count = int(np.clip(duration / (_SPACING * half), _LEAST_BUMPS, _MOST_BUMPS))
    centres = np.linspace(time[0] + half, time[-1] - half, count)
    quadrature = np.gradient(time)
    parts: list[list[np.ndarray]] = [[], [], []]
    columns, starts = [], [0]
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
        columns.append(np.arange(first, last))
        starts.append(starts[-1] + last - first)
    indices = np.concatenate(columns)
    bump, slope, curvature = (
        csr_array((np.concatenate(part), indices, starts), shape=(count, len(time))) for part in parts
    )
    return MotionIntegrals(motion, bump, slope, curvature, np.asarray(curvature @ motion.z))


_FLOOR = 1e-6  # least noise, in standard deviations of the record or the force: rounding


def estimate_motion(record: PistonRecord, line: HeightLine, drive: str | None = None) -> SmoothedMotion:
    """Estimate derivatives, noise and period of a record's motion in z; record [s, m], line [m]."""
    guess = first_guesses(record.time, record.height)
    smooth = derivatives(record)
    size = abs(line.scale)
    swing = float(record.height.std())
    return SmoothedMotion(
        time=record.time - record.time[0],
        z=np.asarray(line.coordinate(record.height)),
        smooth=np.asarray(line.coordinate(smooth.height)),
        velocity=smooth.velocity / line.scale,
        acceleration=smooth.acceleration / line.scale,
        drive=None if drive is None else input_column(record, drive),
        noise=max(smooth.record_noise, _FLOOR * swing) / size,
        acceleration_noise=max(smooth.acceleration_noise, _FLOOR * swing) / size,
        period=guess.period,
    )


def normalising_line(records: Sequence[PistonRecord]) -> HeightLine:
    """Line from z to the height, by the record of the largest amplitude."""
    guesses = (first_guesses(record.time, record.height) for record in records)
    guess = max(guesses, key=lambda guess: guess.amplitude)
    # Powers of a height that hardly changes could not be told apart.
    if abs(guess.rest) <= guess.amplitude:
        return HeightLine()
    return HeightLine(guess.rest, guess.amplitude)


def observed_weak_form(
    target: str, records: Sequence[PistonRecord], motions: Sequence[SmoothedMotion]
) -> WeakForm:
    """Weak form of the measured forces [N], or of the heights [m], of some motions."""
    # Of a prescribed motion z'' says nothing and a force all: its integrals replace those of z'', its noise
    # theirs.
    parts = []
    for record, part in zip(records, weak_form(*motions).parts, strict=True):
        values = record.height if target == "height" else record.force
        if values is None:
            raise RecordError(
                "target = 'force' needs a measured force, which the record does not have; give "
                "one with a column force"
            )
        noise = max(noise_level(values, record.time), _FLOOR * float(values.std()))
        motion = part.motion._replace(acceleration=values, acceleration_noise=noise, noise=noise)
        integrals = np.asarray(part.bump @ values)
        parts.append(dataclasses.replace(part, motion=motion, target=integrals, white_noise=noise))
    return WeakForm(tuple(parts))


def white_noise_weak_form(weak: WeakForm) -> WeakForm:
    """Weak form of z'' whose errors are white noise of z'', as large as in its estimate."""
    # Weights by the noise of heights count the quickest errors most. A simulated bed has no noise, and an
    # equation that is off by more than it is weighed by something else.
    return WeakForm(
        tuple(dataclasses.replace(part, white_noise=part.motion.acceleration_noise) for part in weak.parts)
    )
