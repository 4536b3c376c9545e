"""The weak form of an equation of motion, and the noise in it.

z'' = f(z, z', u) is multiplied by a smooth test function ("bump") and integrated; integration by parts
moves the derivatives from the data to the bump (Messenger & Bortz 2021, doi:10.1137/20M1343166). Spring
terms, and damping terms of the form G'(z) z' = dG/dt, need only z; drag and dry friction also need an
estimate of z'. The record's noise enters each integral linearly, with known weights. Dividing by the square
root of the covariance makes the residuals white with unit variance (Bortz, Messenger & Dukic 2023,
doi:10.1007/s11538-023-01208-6), so that their sum of squares gives a likelihood.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import RecordError
from reduced_models.discovery.terms import AnyTerm, TermArguments, evaluate_expression
from reduced_models.laws.law import HeightLine
from reduced_models.records.derivatives import derivatives, noise_standard_deviation
from reduced_models.records.first_guesses import first_guesses
from reduced_models.records.inputs import input_column

if TYPE_CHECKING:
    import sympy

# Of a bump, in periods. A wider bump averages out the motion; the second derivative of a narrower one
# amplifies the noise.
_HALF_WIDTH = 0.4
_SPACING = 0.25  # distance between bumps, in half-widths
_POWER = 6  # power p of the bump (1 - s^2)^p
_MINIMUM_BUMPS, _MAXIMUM_BUMPS = 24, 600  # so that a library of a dozen terms is overdetermined
_MINIMUM_SAMPLES = 8  # minimum number of samples in a bump
# Smallest eigenvalue kept, relative to the largest. Overlapping bumps are nearly dependent, so smaller
# eigenvalues are rounding errors, which whitening would amplify.
_RANK = 1e-10

_EDGE = 0.02  # fraction of a record at each end with poor derivatives


class SmoothedMotion(NamedTuple):
    """A recorded motion with estimates of its derivatives and noise, and the target of its equation."""

    time: Float[np.ndarray, "n"]
    z: Float[np.ndarray, "n"]
    smooth: Float[np.ndarray, "n"]  # estimate of z
    velocity: Float[np.ndarray, "n"]  # estimate of z'
    acceleration: Float[np.ndarray, "n"]  # target: estimate of z'', or the measured force or height
    drive: Float[np.ndarray, "n"] | None
    noise: float  # standard deviation of the white noise of z, or of a force or height target
    acceleration_noise: float  # standard deviation of the target's noise
    period: float  # [s]

    @property
    def recorded_state(self) -> TermArguments:
        """Arguments of terms, with z as recorded."""
        return TermArguments(self.z, self.velocity, self.drive, self.time)

    @property
    def smooth_state(self) -> TermArguments:
        """Arguments of terms, with the smoothed z."""
        return TermArguments(self.smooth, self.velocity, self.drive, self.time)

    @property
    def without_ends(self) -> SmoothedMotion:
        """The motion without its ends, where derivatives are inaccurate."""
        edge = int(_EDGE * len(self.time))
        rows = slice(edge, len(self.time) - edge)
        columns: Any = (value[rows] if isinstance(value, np.ndarray) else value for value in self)
        return SmoothedMotion(*columns)


@dataclasses.dataclass(frozen=True, eq=False)
class MotionIntegrals:
    """Integrals of one motion multiplied by bumps (smooth test functions).

    Attributes
    ----------
    motion : SmoothedMotion
    bump, slope, curvature : sparse float64 (r, n)
        Bumps and their first and second derivatives at the samples, times the quadrature weights.
    target : float64 (r,)
        Integrals of z''.
    """

    motion: SmoothedMotion
    bump: Any
    slope: Any
    curvature: Any
    target: Float[np.ndarray, "r"]
    white_noise: float | None = None

    def term_integrals(self, term: AnyTerm) -> Float[np.ndarray, "r"]:
        """Integrals of a term against the bumps.

        A term G'(z) z' is integrated by parts, which avoids z' (Messenger & Bortz 2021,
        doi:10.1137/20M1343166).

        Parameters
        ----------
        term : term
            Term in z, z' and the input.

        Returns
        -------
        float64 (r,)
            One integral for each bump, in the unit of the term times s.
        """
        motion = self.motion
        if term.is_total_derivative:
            return -np.asarray(self.slope @ term.antiderivative(motion.z))
        state = motion.recorded_state if term.is_speed_independent else motion.smooth_state
        return np.asarray(self.bump @ term.values(state))

    def expression_integrals(self, expression: sympy.Expr) -> Float[np.ndarray, "r"]:
        """Integrals of an expression in z, z' and the input against the bumps.

        Parameters
        ----------
        expression : sympy.Expr
            In the symbols of `motion_symbols`.

        Returns
        -------
        float64 (r,)
            One integral for each bump, in the unit of the expression times s.
        """
        return np.asarray(self.bump @ evaluate_expression(expression, self.motion.smooth_state))

    def residual_derivatives_by_sample_noise(
        self, terms: Sequence[AnyTerm], coefficients: Float[np.ndarray, "p"]
    ) -> Any:
        """Compute derivatives of an equation's weak-form residuals with respect to the noise of each sample.

        The derivatives are valid to first order in the noise (Bortz, Messenger & Dukic 2023,
        doi:10.1007/s11538-023-01208-6).

        Parameters
        ----------
        terms : sequence of terms
            Terms of the equation.
        coefficients : float64 (p,)
            Coefficient of each term.

        Returns
        -------
        sparse float64 (r, n)
            One row for each bump and one column for each sample [1/s].
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
                weights = weights + value * self._noise_weights_of_speed_term(term)
        return weights

    def _noise_weights_of_speed_term(self, term: AnyTerm) -> Any:
        """Return the weights of the samples' noise in a term that is nonlinear in z', integrated by parts."""
        state = self.motion.smooth_state
        by_speed = term.derivative_by_speed(state)
        rate = np.gradient(by_speed, self.motion.time) - term.derivative_by_height(state)
        return self.slope.multiply(by_speed) + self.bump.multiply(rate)

    def whitening_matrix(
        self, terms: Sequence[AnyTerm], coefficients: Float[np.ndarray, "p"]
    ) -> Float[np.ndarray, "q r"]:
        """Matrix that whitens the weak-form residuals of an equation to unit variance.

        It is the inverse square root of their covariance, without eigenvalues that are only rounding errors
        (Bortz, Messenger & Dukic 2023, doi:10.1007/s11538-023-01208-6).

        Parameters
        ----------
        terms : sequence of terms
            Terms of the equation; empty for the noise of z'' alone.
        coefficients : float64 (p,)
            Coefficient of each term.

        Returns
        -------
        float64 (q, r)
            One row for each independent combination of the residuals that carries noise; q <= r.
        """
        weights = self.residual_derivatives_by_sample_noise(terms, coefficients).tocsr()
        covariance = self.motion.noise**2 * (weights @ weights.T).toarray()
        strengths, directions = np.linalg.eigh(covariance)
        saved = strengths > _RANK * strengths[-1]
        return np.asarray((directions[:, saved] / np.sqrt(strengths[saved])).T)


@dataclasses.dataclass(frozen=True, eq=False)
class WeakForm:
    """Integrals of several motions against bumps (test functions); one equation has to fit them all."""

    parts: tuple[MotionIntegrals, ...]
    least_effect: float = 0.0  # change of the motion that a term must make, relative to rms displacement

    @functools.cached_property
    def least_effect_sum_of_squares(self) -> float:
        """Sum of squares, in units of the noise, of the minimum change that a term must cause."""
        # Whitened by the covariance of the whole equation, the integrals of a term have the sum of squares
        # of the change of z that the term makes.
        return sum(
            len(motion.time)
            * (self.least_effect * rms_displacement_from_line(motion.time, motion.z) / motion.noise) ** 2
            for motion in self.motions
        )

    @property
    def motions(self) -> tuple[SmoothedMotion, ...]:
        """The motions whose integrals are given."""
        return tuple(part.motion for part in self.parts)

    @property
    def sample_count(self) -> int:
        """Total number of samples of all motions."""
        return sum(len(motion.time) for motion in self.motions)

    @property
    def target(self) -> np.ndarray:
        """Integrals of z'' (or of the force) against all bumps, float64 (r,), in the unit of z per s."""
        return np.concatenate([part.target for part in self.parts])

    def term_integral_matrix(self, terms: Sequence[AnyTerm]) -> Float[np.ndarray, "r p"]:
        """Integrals of several terms against the bumps of all motions."""
        columns = [np.concatenate([part.term_integrals(term) for part in self.parts]) for term in terms]
        return np.stack(columns, axis=1)

    def expression_integrals(self, expression: sympy.Expr) -> Float[np.ndarray, "r"]:
        """Integrals of an expression in z, z' and the input against the bumps of all motions."""
        return np.concatenate([part.expression_integrals(expression) for part in self.parts])

    def whitening_matrix(
        self, terms: Sequence[AnyTerm], coefficients: Float[np.ndarray, "p"]
    ) -> Float[np.ndarray, "q r"]:
        """Matrix that whitens the weak-form residuals of all motions to unit variance."""
        # Block-diagonal, since the noise of different motions is independent.
        from scipy.linalg import block_diag

        return np.asarray(block_diag(*(part.whitening_matrix(terms, coefficients) for part in self.parts)))


def make_weak_form(*motions: SmoothedMotion, least_effect: float = 0.0) -> WeakForm:
    """Integrate motions against bumps; for ``least_effect`` see `WeakForm.least_effect`."""
    # Bumps (1 - s^2)^6 with a half-width of 0.4 periods, a tenth of a period apart, except for very short or
    # long records (Messenger & Bortz 2021, doi:10.1137/20M1343166).
    return WeakForm(tuple(map(_motion_integrals, motions)), least_effect)


def _motion_integrals(motion: SmoothedMotion) -> MotionIntegrals:
    """Integrate a motion against overlapping bumps that cover it."""
    from scipy.sparse import csr_array

    time = motion.time
    duration = float(time[-1] - time[0])
    half = min(_HALF_WIDTH * motion.period, duration / 4.0)
    half = max(half, _MINIMUM_SAMPLES * duration / len(time))
    count = int(np.clip(duration / (_SPACING * half), _MINIMUM_BUMPS, _MAXIMUM_BUMPS))
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


_WHOLE_TURNS = 2.0  # net rotation, in turns, above which an angle counts as rotating
_NET = 0.7  # minimum net rotation over the range of angles; a decaying oscillation does not reach it
_FLOOR = 1e-6  # smallest noise, relative to the standard deviation of the record or force: rounding


def estimate_smoothed_motion(
    record: PistonRecord, line: HeightLine, drive: str | None = None, least_noise: float = _FLOOR
) -> SmoothedMotion:
    """Estimate a motion's derivatives, noise and period; ``line`` [m] relates z to the recorded height."""
    # Noise below `least_noise` of the rms displacement may be the error of a solver.
    guess = first_guesses(record.time, record.height)
    smooth = derivatives(record)
    size = abs(line.scale)
    deviation = rms_displacement_from_line(record.time, record.height)
    period = guess.period
    if rotates_two_or_more_turns(record):  # a force that depends on the angle repeats with each turn
        period = min(period, 2.0 * math.pi / float(np.sqrt((smooth.velocity**2).mean())))
    return SmoothedMotion(
        time=record.time - record.time[0],
        z=np.asarray(line.coordinate(record.height)),
        smooth=np.asarray(line.coordinate(smooth.height)),
        velocity=smooth.velocity / line.scale,
        acceleration=smooth.acceleration / line.scale,
        drive=None if drive is None else input_column(record, drive),
        noise=max(smooth.record_noise, max(least_noise, _FLOOR) * deviation) / size,
        acceleration_noise=max(smooth.acceleration_noise, _FLOOR * deviation) / size,
        period=period,
    )


def rms_displacement_from_line(time: Float[np.ndarray, "n"], z: Float[np.ndarray, "n"]) -> float:
    """Return the rms deviation of z from its linear trend in time; a rotation angle has such a trend."""
    return float((z - np.polynomial.Polynomial.fit(time, z, 1)(time)).std())


def rotates_two_or_more_turns(record: PistonRecord) -> bool:
    """Return whether the coordinate, an angle, makes a net rotation of two or more turns."""
    net = abs(float(record.height[-1] - record.height[0]))
    return net > max(_WHOLE_TURNS * 2.0 * math.pi, _NET * float(np.ptp(record.height)))


def normalising_height_line(records: Sequence[PistonRecord]) -> HeightLine:
    """Return the linear relation of z to the height, from the record with the largest amplitude."""
    if any(map(rotates_two_or_more_turns, records)):  # z is an angle
        return HeightLine()
    guesses = (first_guesses(record.time, record.height) for record in records)
    guess = max(guesses, key=lambda guess: guess.amplitude)
    # Powers of a nearly constant height would be indistinguishable.
    if abs(guess.rest) <= guess.amplitude:
        return HeightLine()
    return HeightLine(guess.rest, guess.amplitude)


def weak_form_of_measured_signal(
    target: str, records: Sequence[PistonRecord], motions: Sequence[SmoothedMotion]
) -> WeakForm:
    """Return a weak form whose target is the measured force [N], or the height [m], in place of z''."""
    # For a prescribed motion z'' carries no information. The integrals and noise of the force replace those
    # of z''.
    parts = []
    for record, part in zip(records, make_weak_form(*motions).parts, strict=True):
        values = record.height if target == "height" else record.force
        if values is None:
            raise RecordError(
                "target = 'force' needs a measured force, but the record has none; give "
                "a record with a column named force"
            )
        noise = max(noise_standard_deviation(values, record.time), _FLOOR * float(values.std()))
        motion = part.motion._replace(acceleration=values, acceleration_noise=noise, noise=noise)
        integrals = np.asarray(part.bump @ values)
        parts.append(dataclasses.replace(part, motion=motion, target=integrals, white_noise=noise))
    return WeakForm(tuple(parts))


def white_noise_weak_form(weak: WeakForm) -> WeakForm:
    """Return a weak form that assumes white noise in z'', as large as the noise of the estimated z''."""
    # Weights for noise of the height emphasise the fastest errors. A simulated bed has no such noise, so an
    # equation whose error exceeds it needs other weights.
    return WeakForm(
        tuple(dataclasses.replace(part, white_noise=part.motion.acceleration_noise) for part in weak.parts)
    )
