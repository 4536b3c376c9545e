"""Solutions of a law: a fixed grid for the search, and diffrax as the judge.

A fit solves the law thousands of times, for many starts side by side. There a Runge-Kutta method
of sixth order on a uniform grid is best: it vectorises, its cost does not depend on what the trial
parameters do, and its compiled code is small. The result is then judged, and every later
prediction made, by diffrax with an adaptive step.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import diffrax
import numpy as np

from reduced_models.jax_setup import jax
from reduced_models.law import Law, compiled_rate

jnp = jax.numpy

TOLERANCE = 1e-10
"""Relative tolerance of an adaptive solution; times the motion's amplitude, the absolute one."""
MOST_STEPS = 2**14

# J. C. Butcher, "On Runge-Kutta processes of high order", J. Austral. Math. Soc. 4 (1964) 179:
# seven stages, sixth order.
_STAGES = (
    (),
    (1 / 3,),
    (0.0, 2 / 3),
    (1 / 12, 1 / 3, -1 / 12),
    (25 / 48, -55 / 24, 35 / 48, 15 / 8),
    (3 / 20, -11 / 24, -1 / 8, 1 / 2, 1 / 10),
    (-261 / 260, 33 / 13, 43 / 156, -118 / 39, 32 / 195, 80 / 39),
)
_WEIGHTS = (13 / 200, 0.0, 11 / 40, 11 / 40, 4 / 25, 4 / 25, 13 / 200)

GRIDS = (128, 192, 256, 384, 512, 768, 1024, 1536, 2048, 3072, 4096, 6144, 8192, 16384, 32768)
"""Numbers of grid steps: few, so that records share compiled code."""


def grid_steps(duration: float, period: float, per_period: int) -> int:
    """Steps of a grid over a record with at least that many steps a period (or the most)."""
    wanted = per_period * duration / period
    return next((one for one in GRIDS if one >= wanted), GRIDS[-1])


def on_grid(
    rate: Callable[..., Any], z0: Any, v0: Any, values: Any, step: Any, steps: int
) -> tuple[Any, Any, Any]:
    """z, its velocity and its acceleration at the points of a uniform grid (for JAX)."""

    def advance(state: Any, _: Any) -> Any:
        z, v = state
        slopes: list[tuple[Any, Any]] = []
        for row in _STAGES:
            zi, vi = z, v
            for weight, (dz, dv) in zip(row, slopes, strict=True):
                if weight:
                    zi, vi = zi + weight * step * dz, vi + weight * step * dv
            slopes.append((vi, rate(zi, vi, *values)))
        for weight, (dz, dv) in zip(_WEIGHTS, slopes, strict=True):
            if weight:
                z, v = z + weight * step * dz, v + weight * step * dv
        return (z, v), (*state, slopes[0][1])

    _, (z, v, a) = jax.lax.scan(advance, (z0, v0), None, length=steps + 1)
    return z, v, a


def between(z: Any, v: Any, a: Any, step: Any, place: Any, share: Any) -> Any:
    """Quintic Hermite values of z, a share of a step behind grid points."""
    s = share
    s3 = s * s * s
    late = s3 * (10.0 - s * (15.0 - 6.0 * s))
    z1 = z[place] * (1.0 - late) + z[place + 1] * late
    v0 = s - s3 * (6.0 - s * (8.0 - 3.0 * s))
    v1 = -s3 * (4.0 - s * (7.0 - 3.0 * s))
    a0 = 0.5 * s * s * (1.0 - s * (3.0 - s * (3.0 - s)))
    a1 = 0.5 * s3 * (1.0 - s * (2.0 - s))
    return (
        z1
        + step * (v0 * v[place] + v1 * v[place + 1])
        + step * step * (a0 * a[place] + a1 * a[place + 1])
    )


@functools.cache
def _adaptive(equation: str) -> Callable[..., Any]:
    rate = compiled_rate(equation)

    def field(t: Any, state: Any, parameters: Any) -> Any:
        z, v = state
        return v, rate(z, v, *parameters)

    def solve(times: Any, z0: Any, v0: Any, parameters: Any, size: Any) -> Any:
        # A dense solution: asking for times here would check them by a callback into Python, and
        # code with callbacks cannot be kept on disk.
        result = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Dopri8(),
            times[0],
            times[-1],
            None,
            (z0, v0),
            parameters,
            saveat=diffrax.SaveAt(dense=True),
            stepsize_controller=diffrax.PIDController(rtol=TOLERANCE, atol=TOLERANCE * size),
            max_steps=MOST_STEPS,
            throw=False,
        )
        z, v = jax.vmap(result.evaluate)(times)
        fine = result.result == diffrax.RESULTS.successful
        return jnp.where(fine, z, jnp.nan), jnp.where(fine, v, jnp.nan)

    return jax.jit(solve)


def motion(
    law: Law, times: np.ndarray, z0: float, v0: float, parameters: Sequence[float], size: float
) -> tuple[np.ndarray, np.ndarray]:
    """Z and its velocity at increasing times, by diffrax; NaN where the solution blows up.

    ``size`` is the amplitude of z, which the absolute tolerance refers to.
    """
    count = len(times)
    padded = np.full(-(-count // 1024) * 1024, times[-1])
    padded[:count] = times
    values = tuple(map(float, parameters))
    z, v = _adaptive(law.equation)(padded, float(z0), float(v0), values, float(size))
    return np.asarray(z)[:count], np.asarray(v)[:count]
