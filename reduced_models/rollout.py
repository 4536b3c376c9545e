"""Solutions of a law as a function of its parameters, with diffrax."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import diffrax
import numpy as np

from reduced_models.jax_setup import jax
from reduced_models.law import Law, compiled_rate

TOLERANCE = 1e-9
"""Relative tolerance of a solution; a tenth of it, in units of the motion's amplitude, is the
absolute one."""
MOST_STEPS = 2**16


@functools.cache
def solution(equation: str) -> Callable[..., Any]:
    """A function ``(times, z0, v0, parameters, size, tolerance) -> (z, v)`` at increasing times.

    ``size`` is the amplitude of z, which the absolute tolerance refers to. Behind a point where
    the solution blows up, the values are not finite.
    """
    rate = compiled_rate(equation)

    def field(t: Any, state: Any, parameters: Any) -> Any:
        z, v = state
        return v, rate(z, v, *parameters)

    def solve(times: Any, z0: Any, v0: Any, parameters: Any, size: Any, tolerance: Any) -> Any:
        result = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Tsit5(),
            times[0],
            times[-1],
            None,
            (z0, v0),
            parameters,
            saveat=diffrax.SaveAt(ts=times),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=0.1 * tolerance * size),
            adjoint=diffrax.ForwardMode(),
            max_steps=MOST_STEPS,
            throw=False,
        )
        return result.ys

    return solve


@functools.cache
def _compiled_solution(equation: str) -> Callable[..., Any]:
    return jax.jit(solution(equation))


def motion(
    law: Law, times: np.ndarray, z0: float, v0: float, parameters: Sequence[float], size: float
) -> tuple[np.ndarray, np.ndarray]:
    """Z and its velocity at the times, for given parameters; not finite where it blows up."""
    solve = _compiled_solution(law.equation)
    z, v = solve(times, float(z0), float(v0), tuple(map(float, parameters)), size, TOLERANCE)
    return np.asarray(z), np.asarray(v)
