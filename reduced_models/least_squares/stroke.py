"""A prescribed stroke, and the forces of a law along it, compiled.

Hidden states go along the stroke by the classical Runge-Kutta method; between samples the stroke is
the cubic that fits height and velocity at both. All starts, with their sensitivities, go side by
side.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.run.piston_record import PistonRecord
from reduced_models.jax_setup import jax, jit
from reduced_models.laws.equation import PROGRAMS, compile_rates
from reduced_models.laws.force_law import ACCELERATION
from reduced_models.laws.law import Law
from reduced_models.records.derivatives import derivatives
from reduced_models.records.inputs import input_column

if TYPE_CHECKING:
    from jaxtyping import Float, Int

jnp = jax.numpy

FINE = 0.02
"""Greatest travel of a step of the hidden states, in half strokes."""


class StrokeSteps(NamedTuple):
    """Steps of the hidden states, with the stroke at the start, the middle and the end of each."""

    length: Float[np.ndarray, "k"]  # [s]
    z: Float[np.ndarray, "k 3"]  # columns: start, middle and end of a step
    velocity: Float[np.ndarray, "k 3"]
    drive: Float[np.ndarray, "k 3 inputs"]


class Stroke(NamedTuple):
    """A prescribed motion, as compiled code takes it."""

    z: Float[np.ndarray, "n"]
    velocity: Float[np.ndarray, "n"]
    drive: Float[np.ndarray, "n inputs"]
    steps: StrokeSteps
    point: Int[np.ndarray, "n"]  # number of steps before each sample


def stroke_of_record(record: PistonRecord, law: Law, travel: float = FINE) -> Stroke:
    """Stroke of a record, with the inputs of a law."""
    smooth = derivatives(record)
    velocity = smooth.velocity if record.velocity is None else record.velocity
    columns = [
        smooth.acceleration
        if name == ACCELERATION and name not in record.extra
        else input_column(record, name)
        for name in law.inputs
    ]
    drive = np.array(columns).reshape(len(columns), len(record)).T
    steps, parts = np.diff(record.time), 1
    if law.hidden:
        speed = np.maximum(abs(velocity[1:]), abs(velocity[:-1]))
        half = 0.5 * float(np.ptp(smooth.height))
        parts = max(1, math.ceil(float((steps * speed).max()) / (travel * half)))
    fractions = (np.arange(parts)[:, None] + np.array([0.0, 0.5, 1.0])) / parts
    z, speed = _hermite_cubic(record.time, smooth.height, velocity, fractions)
    inputs = drive[:-1, None, None] + fractions[:, :, None] * np.diff(drive, axis=0)[:, None, None]
    count = len(steps) * parts
    used = slice(count if law.hidden else 0)
    return Stroke(
        smooth.height,
        velocity,
        drive,
        StrokeSteps(
            np.repeat(steps / parts, parts)[used],
            z.reshape(count, 3)[used],
            speed.reshape(count, 3)[used],
            inputs.reshape(count, 3, drive.shape[1])[used],
        ),
        parts * np.arange(len(record)),
    )


def _hermite_cubic(
    time: np.ndarray, height: np.ndarray, velocity: np.ndarray, fractions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Height and velocity (n - 1, parts, 3) at fractions (parts, 3) of the steps between samples."""
    step, s = np.diff(time)[:, None, None], fractions[None]
    start, ahead = height[:-1, None, None], np.diff(height)[:, None, None]
    first, last = (step * part[:, None, None] for part in (velocity[:-1], velocity[1:]))
    bend, twist = 3.0 * ahead - 2.0 * first - last, first + last - 2.0 * ahead
    return start + s * (first + s * (bend + s * twist)), (first + s * (2.0 * bend + 3.0 * s * twist)) / step


@functools.lru_cache(maxsize=PROGRAMS)
def force_function(equation: str, inputs: tuple[str, ...]) -> Callable[..., Any]:
    """Return a function that gives the forces [N] of a law along a stroke (for JAX)."""
    # (values (p, s), hidden states at the start (h, s), stroke) -> forces (n, s).
    field = compile_rates(equation, inputs)

    def forces(values: Any, states: Any, stroke: Stroke) -> Any:
        shape = (len(stroke.z), *values[0].shape)
        path: tuple[Any, ...] = ()
        if len(states):

            def rates(state: Any, at: StrokeSteps, k: int) -> Any:
                slopes = field(at.z[k], at.velocity[k], *state, *at.drive[k], *values)[1:]
                return jnp.stack([jnp.broadcast_to(slope, state.shape[1:]) for slope in slopes])

            def advance(state: Any, at: StrokeSteps) -> tuple[Any, Any]:
                a = rates(state, at, 0)
                b = rates(state + 0.5 * at.length * a, at, 1)
                c = rates(state + 0.5 * at.length * b, at, 1)
                d = rates(state + at.length * c, at, 2)
                moved = state + at.length / 6.0 * (a + 2.0 * b + 2.0 * c + d)
                return moved, moved

            every = jax.lax.scan(advance, states, stroke.steps)[1]
            path = tuple(jnp.concatenate([states[None], every])[stroke.point].transpose(1, 0, 2))
        drive = tuple(stroke.drive.T[:, :, None])
        result = field(stroke.z[:, None], stroke.velocity[:, None], *path, *drive, *values)[0]
        return jnp.broadcast_to(result, shape)

    return forces


@functools.lru_cache(maxsize=PROGRAMS)
def compiled_force_function(equation: str, inputs: tuple[str, ...]) -> Callable[..., Any]:
    """Compile `force_function`, once for each equation."""
    return jit(force_function(equation, inputs), (equation, inputs))
