"""Solutions of a law: a fixed grid for the search, and diffrax as the judge.

A fit solves the law thousands of times, for many starts side by side. There a Runge-Kutta method
of sixth order on a uniform grid is best: it vectorises, its cost does not depend on what the trial
parameters do, and its compiled code is small. The result is then judged, and every later
prediction made, by diffrax with an adaptive step.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeVar

import diffrax
import numpy as np
from numpy.typing import NDArray

from granular.shared.errors import RecordError
from reduced_models.jax_setup import jax
from reduced_models.laws.law import PROGRAMS, Law, compiled_field
from reduced_models.records.inputs import STAGE_TIMES, drive_at

jnp = jax.numpy

Value = jax.Array | float
"""A number, or one that JAX traces."""

Data = jax.Array | NDArray[Any]
A = TypeVar("A", jax.Array, NDArray[Any])
"""Arrays of JAX or of NumPy."""

States = tuple[Value, ...]
Parameters = tuple[tuple[Value, ...], Value]
"""Of a law's field in diffrax: the law's own, and the amplitude."""

Ending = Literal["complete", "blow-up", "steps"]

TOLERANCE = 1e-10
"""Relative tolerance of an adaptive solution; times the motion's amplitude, the absolute one."""
STEP_BUDGETS = (2**14, 2**17)
"""Steps of an adaptive solution; the second budget is spent where the first does not suffice."""
FAR = 1e9
"""A solution that goes this many amplitudes away blows up."""

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

GRIDS = (
    128,
    192,
    256,
    384,
    512,
    768,
    1024,
    1536,
    2048,
    3072,
    4096,
    6144,
    *(2**k for k in range(13, 19)),
)
"""Numbers of grid steps: few, so that records share compiled code."""


def grid_steps(duration: float, period: float, per_period: int) -> int:
    """Steps of a grid over a record with at least that many steps a period.

    Raises
    ------
    RecordError
        If these are more than the finest grid has.
    """
    wanted = per_period * duration / period
    for steps in GRIDS:
        if steps >= wanted:
            return steps
    raise RecordError(
        f"the record holds about {duration / period:.3g} periods, and a fit can follow at most "
        f"{GRIDS[-1] // per_period}; fit a part of it, record.between(start, stop)"
    )


def finer_grid(steps: int) -> int | None:
    """The next grid of at least twice as many steps; None behind the finest."""
    return next((finer for finer in GRIDS if finer >= 2 * steps), None)


def on_grid(
    field: Callable[..., Sequence[Value]],
    start: Sequence[jax.Array],
    values: Sequence[Value],
    drive: Data,
    step: Value,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """z, its velocity and its acceleration at the points of a uniform grid (for JAX).

    ``start`` holds z, its velocity and the hidden states, each of a shape (...) that the three
    (points, ...) keep; ``drive`` (points, stages, inputs) the inputs at the stages of each step.
    """

    def advance(state: jax.Array, inputs: jax.Array) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        slopes: list[jax.Array] = []
        for stage, row in enumerate(_STAGES):
            place = _moved(state, row, slopes, step)
            given = [inputs[stage, k] for k in range(inputs.shape[1])]
            rates = (place[1], *field(*place, *given, *values))
            slopes.append(_stacked(rates, place[0]))
        return _moved(state, _WEIGHTS, slopes, step), (state[0], state[1], slopes[0][1])

    # One array for all of the state: each of the compiled operations costs more than its numbers.
    _, (z, v, a) = jax.lax.scan(advance, _stacked(start, start[0]), jnp.asarray(drive))
    return z, v, a


def _stacked(parts: Sequence[Value], like: jax.Array) -> jax.Array:
    """Numbers or arrays as the rows of one array."""
    return jnp.stack([jnp.broadcast_to(part, jnp.shape(like)) for part in parts])


def _moved(
    state: jax.Array, weights: Sequence[float], slopes: Sequence[jax.Array], step: Value
) -> jax.Array:
    """A state moved along some slopes."""
    for weight, slope in zip(weights, slopes, strict=True):
        if weight:
            state = state + weight * step * slope
    return state


def between(z: A, v: A, a: A, step: Value, place: Data, share: Data) -> A:
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


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """A solution at given times.

    Attributes
    ----------
    z, velocity : float64 (n,)
        NaN at times that the solution does not reach.
    ending : str
        ``"complete"``; ``"blow-up"`` where z leaves every bound; ``"steps"`` where the solver's
        step budget was spent, on a stiff law or at the edge of where the law is defined.
    """

    z: np.ndarray
    velocity: np.ndarray
    ending: Ending


Motion = Solution  # its former name


@functools.lru_cache(maxsize=PROGRAMS)
def _adaptive(equation: str, hidden: int, budget: int) -> Callable[..., tuple[jax.Array, ...]]:
    rates = compiled_field(equation)

    def field(t: object, state: States, parameters: Parameters) -> States:
        # Hidden states, whose own size is 1 or so, are carried in amplitudes, for one tolerance.
        z, v, *memory = state
        values, size = parameters
        a, *changes = rates(z, v, *(each / size for each in memory), *values)
        return v, a, *(size * change for change in changes)

    def far_away(t: object, state: States, parameters: Parameters, **_: object) -> jax.Array:
        return jnp.abs(state[0]) > FAR * parameters[1]

    def solve(
        times: jax.Array, z0: jax.Array, v0: jax.Array, parameters: tuple[Value, ...], size: Value
    ) -> tuple[jax.Array, ...]:
        # A dense solution: asking for times here would check them by a callback into Python, and
        # code with callbacks cannot be kept on disk.
        start = (z0, v0, *(jnp.zeros_like(z0) for _ in range(hidden)))
        result = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Dopri8(),
            times[0],
            times[-1],
            None,
            start,
            (parameters, size),
            saveat=diffrax.SaveAt(dense=True, t1=True),
            stepsize_controller=diffrax.PIDController(rtol=TOLERANCE, atol=TOLERANCE * size),
            event=diffrax.Event(far_away),
            max_steps=budget,
            throw=False,
        )
        z, v, *_ = jax.vmap(result.evaluate)(times)
        reached = times <= result.ts[-1]
        complete = result.result == diffrax.RESULTS.successful
        blown_up = result.result == diffrax.RESULTS.event_occurred
        reached = (reached & jnp.isfinite(z)) | complete
        return jnp.where(reached, z, jnp.nan), jnp.where(reached, v, jnp.nan), complete, blown_up

    return jax.jit(solve)


def solution(
    law: Law,
    times: np.ndarray,
    z0: float,
    v0: float,
    parameters: Sequence[float],
    size: float,
    inputs: Sequence[np.ndarray] = (),
) -> Solution:
    """The motion of a law at increasing times.

    ``size`` is the amplitude of z, which the absolute tolerance refers to. ``inputs`` are those of
    the law, each (n,) at the times. A law without inputs is solved by diffrax; one with inputs,
    which are smooth between samples only, on grids that are refined until two agree.
    """
    values = tuple(map(float, parameters))
    if law.inputs:
        return _driven_solution(law, times, (z0, v0), values, size, list(inputs))
    count = len(times)
    padded = np.full(-(-count // 1024) * 1024, times[-1])
    padded[:count] = times
    for budget in STEP_BUDGETS:
        solve = _adaptive(law.equation, len(law.hidden), budget)
        z, v, complete, blown_up = solve(padded, float(z0), float(v0), values, float(size))
        if complete or blown_up:
            break
    ending: Ending = "complete" if complete else ("blow-up" if blown_up else "steps")
    return Solution(np.asarray(z)[:count], np.asarray(v)[:count], ending)


_DRIVEN_TOLERANCE = 1e-7
"""Agreement of two grids, in amplitudes, that a driven solution needs."""


@functools.lru_cache(maxsize=PROGRAMS)
def _gridded(
    equation: str, inputs: tuple[str, ...], hidden: int
) -> Callable[..., tuple[jax.Array, ...]]:
    field = compiled_field(equation, inputs)

    def solve(
        start: tuple[jax.Array, ...], values: tuple[Value, ...], drive: jax.Array, step: Value
    ) -> tuple[jax.Array, ...]:
        state = (*start, *(jnp.zeros_like(start[0]) for _ in range(hidden)))
        return on_grid(field, state, values, drive, step)

    return jax.jit(solve)


def _driven_solution(
    law: Law,
    times: np.ndarray,
    start: tuple[float, float],
    values: tuple[float, ...],
    size: float,
    inputs: list[np.ndarray],
) -> Solution:
    duration = float(times[-1] - times[0])
    solve = _gridded(law.equation, law.inputs, len(law.hidden))
    before = np.full((2, len(times)), np.inf)
    for steps in GRIDS[GRIDS.index(1024) :: 2]:
        step = duration / steps
        nodes = times[0] + step * (np.arange(steps + 1)[:, None] + np.array(STAGE_TIMES))
        drive = drive_at(times, inputs, nodes)
        z, v, a = map(np.asarray, solve(tuple(map(float, start)), values, drive, step))
        if not (np.abs(z) < FAR * size).all():
            reached = int(np.argmin(np.abs(z) < FAR * size)) * step + times[0]
            found = np.full((2, len(times)), np.nan)
            if np.isfinite(before).all():
                found[:, times < reached] = before[:, times < reached]
            return Solution(found[0], found[1], "blow-up")
        place = np.minimum(((times - times[0]) / step).astype(np.int64), steps - 1)
        share = (times - times[0]) / step - place
        found = np.stack(
            [between(z, v, a, step, place, share), _slope(z, v, a, step, place, share)]
        )
        if np.abs(found[0] - before[0]).max() <= _DRIVEN_TOLERANCE * size:
            return Solution(found[0], found[1], "complete")
        before = found
    return Solution(before[0], before[1], "steps")


def _slope(z: A, v: A, a: A, step: Value, place: A, share: A) -> A:
    """Derivative of `between` by time."""
    s = share
    rise = 30.0 * s * s * (1.0 - s) ** 2
    v0 = 1.0 - s * s * (18.0 - s * (32.0 - 15.0 * s))
    v1 = -s * s * (12.0 - s * (28.0 - 15.0 * s))
    a0 = s * (1.0 - s * (4.5 - s * (6.0 - 2.5 * s)))
    a1 = 0.5 * s * s * (3.0 - s * (8.0 - 5.0 * s))
    return (
        rise * (z[place + 1] - z[place]) / step
        + v0 * v[place]
        + v1 * v[place + 1]
        + step * (a0 * a[place] + a1 * a[place + 1])
    )
