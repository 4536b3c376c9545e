"""Solutions of a law: a fixed grid for the search, and diffrax as the judge.

A fit solves the law thousands of times, for many starts side by side. There a Runge-Kutta method
of sixth order on a uniform grid is best: it vectorises, its cost does not depend on what the trial
parameters do, and its compiled code is small. The result is then judged, and every later
prediction made, by diffrax with an adaptive step.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import diffrax
import numpy as np
from numpy.typing import NDArray

from granular.shared.errors import RecordError
from reduced_models.jax_setup import Compiled, jax, jit
from reduced_models.laws.equation import PROGRAMS, compile_rates
from reduced_models.laws.law import Law
from reduced_models.records.inputs import Interpolation, piecewise_cubics

if TYPE_CHECKING:
    from jaxtyping import Float

jnp = jax.numpy

Value = jax.Array | float
"""A number, or one that JAX traces."""

Data = jax.Array | NDArray[Any]
A = TypeVar("A", jax.Array, NDArray[Any])
"""Arrays of JAX or of NumPy."""

States = tuple[Value, ...]
Parameters = tuple[tuple[Value, ...], Value]
"""Arguments of a law's field in diffrax: the law's own, and the amplitude."""

Ending = Literal["complete", "blow-up", "steps"]

TOLERANCE = 1e-10
"""Relative tolerance of an adaptive solution; times the motion's amplitude, the absolute one."""
STEP_BUDGETS = (2**14, 2**17)
"""Steps of an adaptive solution; the second budget is spent where the first does not suffice."""
FAR = 1e9
"""A solution that goes this many amplitudes away diverges."""

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

# Most steps of a grid that is counted by a law's period: 4,096 periods of 64 steps.
MOST_STEPS = 2**18


def count_grid_steps(duration: float, period: float, per_period: int) -> int:
    """Return the steps of a grid over a duration [s], with at least so many a period [s]."""
    wanted = per_period * duration / period
    if wanted > MOST_STEPS:
        raise RecordError(
            f"the record holds about {duration / period:.3g} periods, and a fit can follow at most "
            f"{MOST_STEPS // per_period}; fit a part of it, record.between(start, stop)"
        )
    return round_up_to_chunks(wanted)


def round_up_to_chunks(steps: float) -> int:
    """Round a number of steps up to whole chunks, two at least."""
    return CHUNK * max(2, math.ceil(steps / CHUNK))


def padded_length(count: int, least: int) -> int:
    """Return the length that code is compiled for, which records of similar lengths share."""
    size = least
    while size < count:
        size *= 2
    return size


def padded_step_count(steps: int) -> int:
    """Return the number of grid steps that code is compiled for; see `padded_length`."""
    return padded_length(steps, _LEAST_STEPS)


CHUNK = 64
"""Grid steps that are solved together; every grid has an integer of such chunks."""
_LEAST_STEPS, _LEAST_TIMES = 512, 8192
"""Least lengths that code is compiled for: what is left empty costs less than another compilation."""


def solve_on_grid(
    field: Callable[..., Sequence[Value]],
    start: Sequence[jax.Array],
    values: Sequence[Value],
    drive: Data,
    step: Value,
    chunks: Value,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return z, z' [1/s] and z'' [1/s^2], over the unit of z, on a uniform grid; step [s] (for JAX)."""
    # Start (...) of z, velocity and hidden states; drive (points, stages, inputs). Beyond the first chunks
    # all three are zero. Butcher's method (`_STAGES`).

    def rates(state: jax.Array, inputs: jax.Array) -> jax.Array:
        given = [inputs[k] for k in range(inputs.shape[0])]
        return _stack_rows((state[1], *field(*state, *given, *values)), state[0])

    def advance(state: jax.Array, inputs: jax.Array) -> tuple[jax.Array, jax.Array]:
        slopes: list[jax.Array] = []
        for stage, row in enumerate(_STAGES):
            slopes.append(rates(_advance_state(state, row, slopes, step), inputs[stage]))
        point = jnp.stack([state[0], state[1], slopes[0][1]])
        return _advance_state(state, _WEIGHTS, slopes, step), point

    def chunk(index: Value, carried: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        state, result = carried
        here = jax.lax.dynamic_slice_in_dim(given, index * CHUNK, CHUNK)
        state, points = jax.lax.scan(advance, state, here)
        return state, jax.lax.dynamic_update_slice_in_dim(result, points, index * CHUNK, 0)

    # One array for all of the state: each of the compiled operations costs more than its numbers.
    given = jnp.asarray(drive)
    first = _stack_rows(start, start[0])
    empty = jnp.zeros((len(given), 3, *first.shape[1:]))
    state, output = jax.lax.fori_loop(0, chunks, chunk, (first, empty))
    end = jax.lax.dynamic_index_in_dim(given, chunks * CHUNK, keepdims=False)
    last = jnp.stack([state[0], state[1], rates(state, end[0])[1]])
    output = jax.lax.dynamic_update_index_in_dim(output, last, chunks * CHUNK, 0)
    return output[:, 0], output[:, 1], output[:, 2]


def _stack_rows(parts: Sequence[Value], like: jax.Array) -> jax.Array:
    """Numbers or arrays as the rows of one array."""
    return jnp.stack([jnp.broadcast_to(part, jnp.shape(like)) for part in parts])


def _advance_state(
    state: jax.Array, weights: Sequence[float], slopes: Sequence[jax.Array], step: Value
) -> jax.Array:
    """State moved along some slopes."""
    for weight, slope in zip(weights, slopes, strict=True):
        if weight:
            state = state + weight * step * slope
    return state


def hermite_interpolate(z: A, v: A, a: A, step: Value, point: Data, fraction: Data) -> A:
    """Quintic values (n, ...) of z (points, ...), a fraction of a step behind grid points; step [s]."""
    s = fraction
    # Quintic Hermite polynomials, nested.
    s3 = s * s * s
    late = s3 * (10.0 - s * (15.0 - 6.0 * s))
    z1 = z[point] * (1.0 - late) + z[point + 1] * late
    v0 = s - s3 * (6.0 - s * (8.0 - 3.0 * s))
    v1 = -s3 * (4.0 - s * (7.0 - 3.0 * s))
    a0 = 0.5 * s * s * (1.0 - s * (3.0 - s * (3.0 - s)))
    a1 = 0.5 * s3 * (1.0 - s * (2.0 - s))
    return z1 + step * (v0 * v[point] + v1 * v[point + 1]) + step * step * (a0 * a[point] + a1 * a[point + 1])


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """A solution at given times."""

    z: Float[np.ndarray, "n"]  # NaN at times that it does not reach
    velocity: Float[np.ndarray, "n"]
    ending: Ending  # steps: their budget was spent, as on a stiff law


@functools.lru_cache(maxsize=PROGRAMS)
def _adaptive_solver(equation: str, budget: int) -> Compiled[..., tuple[jax.Array, ...]]:
    rates = compile_rates(equation)

    def field(t: object, state: States, parameters: Parameters) -> States:
        # Hidden states, whose own size is 1 or so, are carried in amplitudes, for one tolerance.
        z, v, *memory = state
        values, size = parameters
        a, *changes = rates(z, v, *(value / size for value in memory), *values)
        return v, a, *(size * change for change in changes)

    def far_away(t: object, state: States, parameters: Parameters, **_: object) -> jax.Array:
        return jnp.abs(state[0]) > FAR * parameters[1]

    def solve(times: jax.Array, state: States, parameters: Parameters, size: Value) -> tuple[jax.Array, ...]:
        # A dense solution: asking for times here would check them by a callback into Python, and
        # code with callbacks cannot be kept on disk.
        start = (state[0], state[1], *(size * value for value in state[2:]))
        result = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Dopri8(),
            times[0],
            times[-1],
            None,
            start,
            parameters,
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

    return jit(solve, (equation, budget))


def solve_law(
    law: Law,
    times: Float[np.ndarray, "n"],
    z0: float,
    v0: float,
    parameters: Sequence[float],
    size: float,
    inputs: Sequence[np.ndarray] = (),
    hidden: Sequence[float] = (),
    how: Interpolation = "spline",
) -> Solution:
    """Return the motion of a law at times [s]; size is the amplitude that the tolerance refers to."""
    # Dopri8 (Prince and Dormand 1981, doi:10.1016/0771-050X(81)90010-3), with steps that adapt or, if driven,
    # that end at the samples.
    values = tuple(map(float, parameters))
    start = (float(z0), float(v0), *map(float, hidden or (0.0,) * len(law.hidden)))
    if law.inputs:
        return _driven_solution(law, times, start, values, size, list(inputs), how)
    count = len(times)
    padded = np.full(padded_length(count, _LEAST_TIMES), times[-1])
    padded[:count] = times
    for budget in STEP_BUDGETS:
        solve = _adaptive_solver(law.equation, budget)
        z, v, complete, blown_up = solve(padded, start, (values, float(size)), float(size))
        if complete or blown_up:
            break
    ending: Ending = "complete" if complete else ("blow-up" if blown_up else "steps")
    return Solution(np.asarray(z)[:count], np.asarray(v)[:count], ending)


def compile_solution_ahead(law: Law) -> None:
    """Compile what `solve_law` calls for a law without inputs and the usual number of times."""
    start, parameters = (0.0,) * (2 + len(law.hidden)), ((0.0,) * len(law.parameters), 0.0)
    _adaptive_solver(law.equation, STEP_BUDGETS[0]).compile_ahead(
        np.zeros(_LEAST_TIMES), start, parameters, 0.0
    )


_DRIVEN_TOLERANCE = 1e-7
"""Agreement of two numbers of steps, in amplitudes, that a driven solution needs."""
_SURE = 16  # parts of a sample's time in which a solution that leaves every bound does blow up
_MOST_DRIVEN = 2**22
"""Steps of a driven solution: as many as a gigabyte holds."""


@functools.lru_cache(maxsize=PROGRAMS)
def _fixed_step_solver(equation: str, inputs: tuple[str, ...]) -> Callable[..., jax.Array]:
    rates = compile_rates(equation, inputs)
    solver = diffrax.Dopri8()

    def field(s: Any, state: Any, piece: Any) -> States:
        cubic, values = piece
        given = cubic[0] + s * (cubic[1] + s * (cubic[2] + s * cubic[3]))
        a, *changes = rates(*state, *given, *values)
        return state[1], a, *changes

    term = diffrax.ODETerm(field)

    def solve(start: States, values: States, length: jax.Array, cubics: jax.Array, split: Value) -> jax.Array:
        """State behind each piece of the inputs, that is solved in ``split`` steps."""
        first = solver.init(term, 0.0, length[0], start, (cubics[0], values))

        def interval(state: jax.Array, piece: tuple[jax.Array, jax.Array]) -> Any:
            step = piece[0] / split

            def advance(index: Value, state: jax.Array) -> jax.Array:
                result = solver.step(
                    term,
                    index * step,
                    (index + 1) * step,
                    tuple(state),
                    (piece[1], values),
                    first,
                    made_jump=True,
                )[0]
                return jnp.stack(result)

            state = jax.lax.fori_loop(0, split, advance, state)
            return state, state[:2]

        return jax.lax.scan(interval, jnp.stack(start), (length, cubics))[1]

    return jit(solve, (equation, inputs))


def _driven_solution(
    law: Law,
    times: np.ndarray,
    start: tuple[float, ...],
    values: tuple[float, ...],
    size: float,
    inputs: list[np.ndarray],
    how: Interpolation,
) -> Solution:
    """Solve by diffrax's Dopri8 in equal parts of the time between samples, until two numbers agree."""
    result = piecewise_cubics(times, inputs, how)
    every = len(result.length) // (len(times) - 1)
    count = len(result.length)
    padded = padded_step_count(count)
    length, cubics = np.ones(padded), np.zeros((padded, *result.cubics.shape[1:]))
    length[:count], cubics[:count] = result.length, result.cubics
    solve = _fixed_step_solver(law.equation, law.inputs)
    before = np.full((len(times), 2), np.inf)
    split = 1
    while split * count <= _MOST_DRIVEN:
        states = np.asarray(solve(start, values, length, cubics, split))[:count]
        here = np.concatenate([[start[:2]], states[every - 1 :: every]])
        with np.errstate(invalid="ignore"):
            sound = np.abs(here[:, 0]) < FAR * size
            change = np.abs(here[:, 0] - before[:, 0]).max()
        if sound.all() and change <= _DRIVEN_TOLERANCE * size:
            return Solution(here[:, 0], here[:, 1], "complete")
        if not sound.all() and split >= _SURE:
            here[int(np.argmin(sound)) :] = np.nan
            return Solution(here[:, 0], here[:, 1], "blow-up")
        before, split = here, 2 * split
    return Solution(before[:, 0], before[:, 1], "steps")
