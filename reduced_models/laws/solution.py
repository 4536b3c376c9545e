"""Solve a law: on a fixed grid during a fit, with diffrax for verification and prediction.

A fit solves the law thousands of times, for many starts simultaneously. For this purpose a sixth-order
Runge-Kutta method on a uniform grid is best: it vectorises, its cost does not depend on the trial
parameters, and its compiled code is small. Diffrax, with an adaptive time step, then verifies the result
and computes all predictions. The intervals between samples are solved one after the other, so that
the same compiled code serves any number of samples.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeVar

import diffrax
import numpy as np
from numpy.typing import NDArray

from granular.shared.array_types import Float
from granular.shared.errors import RecordError
from reduced_models.jax_setup import Compiled, jax
from reduced_models.laws.equation import (
    PROGRAMS,
    compile_jacobian,
    compile_observation,
    compile_rates,
    parse_equation,
)
from reduced_models.laws.law import Law
from reduced_models.records.inputs import Interpolation, piecewise_cubics

jnp = jax.numpy

Value = jax.Array | float
"""A number, or a JAX number that is being traced."""

Data = jax.Array | NDArray[Any]
A = TypeVar("A", jax.Array, NDArray[Any])
"""JAX or NumPy arrays."""

States = tuple[Value, ...]

Ending = Literal["complete", "blow-up", "steps"]

TOLERANCE = 1e-12
"""Relative tolerance of an adaptive solution; the absolute tolerance is this times the amplitude."""
DIVERGENCE = 1e9
"""A solution is taken to diverge if its displacement exceeds this multiple of the amplitude."""

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

# Maximum number of steps of a grid: 4096 periods of 64 steps.
_MAXIMUM_GRID_STEPS = 2**18


def count_grid_steps(duration: float, period: float, per_period: int) -> int:
    """Return the number of grid steps for a duration [s], with at least ``per_period`` in a period [s]."""
    wanted = per_period * duration / period
    if wanted > _MAXIMUM_GRID_STEPS:
        raise RecordError(
            f"the record has about {duration / period:.3g} periods, but the maximum for a fit is "
            f"{_MAXIMUM_GRID_STEPS // per_period}; fit a part of it, record.between(start, stop)"
        )
    return round_up_to_chunks(wanted)


def round_up_to_chunks(steps: float) -> int:
    """Round a number of steps up to a multiple of `CHUNK`, and to at least two chunks."""
    return CHUNK * max(2, math.ceil(steps / CHUNK))


def padded_array_length(count: int, minimum: int) -> int:
    """Return the array length for which code is compiled; records of similar length share the same length."""
    size = minimum
    while size < count:
        size *= 2
    return size


def padded_step_count(steps: int) -> int:
    """Return the number of grid steps for which code is compiled; see `padded_array_length`."""
    return padded_array_length(steps, _MINIMUM_STEPS)


CHUNK = 64
"""Number of grid steps in a chunk, which is solved together; every grid consists of complete chunks."""
_MINIMUM_STEPS = 512
"""Minimum array length for which code is compiled; solving empty steps costs less than compiling again."""


def solve_on_grid(
    field: Callable[..., Sequence[Value]],
    start: Sequence[jax.Array],
    values: Sequence[Value],
    drive: Data,
    step: Value,
    chunks: Value,
    *,
    prescribed: bool = False,
    every_state: bool = False,
) -> jax.Array:
    """Return z, z' and z'', or all states and their rates, on a uniform grid with a step [s] (for JAX)."""
    # Initial values (...) of z, velocity and hidden states (for a prescribed motion of hidden states alone);
    # drive (points, stages, inputs). Beyond the solved chunks the result is zero. Butcher's method
    # (`_STAGES`).

    def rates(state: jax.Array, inputs: jax.Array) -> jax.Array:
        given = [inputs[k] for k in range(inputs.shape[0])]
        slopes = field(*state, *given, *values)
        return _stack_rows(slopes if prescribed else (state[1], *slopes), state[0])

    def state_and_slope_to_store(state: jax.Array, slope: jax.Array) -> jax.Array:
        if every_state:
            return jnp.concatenate([state, slope])
        return jnp.stack([state[0], state[1], slope[1]])

    def advance(state: jax.Array, inputs: jax.Array) -> tuple[jax.Array, jax.Array]:
        slopes: list[jax.Array] = []
        for stage, row in enumerate(_STAGES):
            slopes.append(rates(_advance_state(state, row, slopes, step), inputs[stage]))
        return _advance_state(state, _WEIGHTS, slopes, step), state_and_slope_to_store(state, slopes[0])

    def advance_chunk_of_steps(
        index: Value, carried: tuple[jax.Array, jax.Array]
    ) -> tuple[jax.Array, jax.Array]:
        state, result = carried
        here = jax.lax.dynamic_slice_in_dim(given, index * CHUNK, CHUNK)
        state, points = jax.lax.scan(advance, state, here)
        return state, jax.lax.dynamic_update_slice_in_dim(result, points, index * CHUNK, 0)

    # One array for the whole state: the overhead of a compiled operation exceeds its arithmetic.
    given = jnp.asarray(drive)
    first = _stack_rows(start, start[0])
    empty = jnp.zeros((len(given), 2 * len(first) if every_state else 3, *first.shape[1:]))
    state, output = jax.lax.fori_loop(0, chunks, advance_chunk_of_steps, (first, empty))
    end = jax.lax.dynamic_index_in_dim(given, chunks * CHUNK, keepdims=False)
    last = state_and_slope_to_store(state, rates(state, end[0]))
    return jax.lax.dynamic_update_index_in_dim(output, last, chunks * CHUNK, 0)


def states_at_samples(
    grid: jax.Array, step: Value, point: Data, fraction: Data, *, prescribed: bool
) -> list[jax.Array]:
    """Interpolate states (n, ...) between grid points, where ``grid`` has states and rates, for JAX."""
    count = grid.shape[1] // 2
    states, rates = grid[:, :count], grid[:, count:]
    result = (
        []
        if prescribed
        else [
            hermite_quintic(states[:, 0], states[:, 1], rates[:, 1], step, point, fraction),
            _hermite_cubic(states[:, 1], rates[:, 1], step, point, fraction),
        ]
    )
    hidden = range(len(result), count)
    return result + [_hermite_cubic(states[:, k], rates[:, k], step, point, fraction) for k in hidden]


def _hermite_cubic(value: A, rate: A, step: Value, point: Data, fraction: Data) -> A:
    """Interpolate a state (n, ...) by cubics, from its values and rates (points, ...) at grid points."""
    s = fraction
    late = s * s * (3.0 - 2.0 * s)
    inside = s * (1.0 - s) * ((1.0 - s) * rate[point] - s * rate[point + 1])
    return value[point] * (1.0 - late) + value[point + 1] * late + step * inside


def _stack_rows(parts: Sequence[Value], like: jax.Array) -> jax.Array:
    """Stack numbers or arrays as the rows of one array."""
    return jnp.stack([jnp.broadcast_to(part, jnp.shape(like)) for part in parts])


def _advance_state(
    state: jax.Array, weights: Sequence[float], slopes: Sequence[jax.Array], step: Value
) -> jax.Array:
    """Return the state after a step along the weighted sum of slopes."""
    for weight, slope in zip(weights, slopes, strict=True):
        if weight:
            state = state + weight * step * slope
    return state


def hermite_quintic(z: A, v: A, a: A, step: Value, point: Data, fraction: Data) -> A:
    """Interpolate z (n, ...) by quintics at a fraction of a step [s] after grid points."""
    s = fraction
    # Quintic Hermite polynomials in nested form.
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

    states: Float[np.ndarray, "n s"]  # z and z' (if they are states) and hidden states; NaN if not reached
    ending: Ending  # "steps": more than `MAXIMUM_STEPS` are needed

    @property
    def z(self) -> Float[np.ndarray, "n"]:
        """Coordinate of the law."""
        return self.states[:, 0]

    @property
    def velocity(self) -> Float[np.ndarray, "n"]:
        """Velocity of the coordinate."""
        return self.states[:, 1]


_INTERVALS_PER_CALL = 2**11
"""Number of time intervals that one call of a program solves."""
_STEPS_PER_CALL = 2**14
"""Number of steps in one call of a program; after each call the solution is checked and may be aborted."""
MAXIMUM_STEPS = 64
"""A solution is aborted if its number of steps exceeds this constant times (n + T). Here n is the number of
time intervals solved, and T is the time solved, in units of the shortest time constant."""
_STIFF_STEP = 2.0
"""Step, in units of the shortest time constant, above which stability limits the step. Accuracy would limit
it to less than 0.5.
"""
_IMPLICIT_COST = 10.0
"""Ratio of the costs of an implicit and an explicit step. A solution with stiff parts may need
both kinds of steps.
"""
_NO_PROGRESS = 1e-12  # fraction of the duration: a call that advances less is at a singularity
_SAMPLED_STATES = 64  # number of states per call whose time constants are computed


@functools.lru_cache(maxsize=PROGRAMS)
def _compile_adaptive_solver(
    equation: str, inputs: tuple[str, ...], *, implicit: bool = False
) -> Compiled[..., tuple[jax.Array, ...]]:
    rates = compile_rates(equation, inputs)
    prescribed = parse_equation(equation, inputs).acceleration is None

    def scaled_state_rates(s: Any, state: Any, piece: Any) -> jax.Array:
        cubic, values = piece
        given = cubic[0] + s * (cubic[1] + s * (cubic[2] + s * cubic[3]))
        slopes = rates(*state, *given, *values)
        return _stack_rows(slopes if prescribed else (state[1], *slopes), state[0])

    term = diffrax.ODETerm(scaled_state_rates)

    def solve(
        start: tuple[Value, Value, jax.Array],
        length: jax.Array,
        cubics: jax.Array,
        values: States,
        size: Value,
    ) -> tuple[Any, ...]:
        """Solve one interval after the other, up to an interval of zero length."""
        # Hidden states are of order 1.
        tolerance = TOLERANCE * jnp.where(jnp.arange(len(start[2])) < 2, size, 1.0)
        control = diffrax.PIDController(rtol=TOLERANCE, atol=tolerance)

        def make_solver(step: Value, state: jax.Array) -> Any:
            if not implicit:
                return diffrax.Dopri8()
            # Newton's method solves for rates: their tolerance is the tolerance of the state / step.
            error: Any = (tolerance + TOLERANCE * jnp.abs(state)) / step
            return diffrax.Kvaerno5(root_finder=diffrax.VeryChord(rtol=TOLERANCE, atol=error))

        solver, piece = make_solver(*start[1:]), (cubics[0], values)
        order = solver.order(term)
        first = solver.init(term, 0.0, start[1], start[2], piece)
        memory = control.init(term, *start, start[1], piece, solver.func, order)[1]

        def advance(carried: tuple[Any, ...]) -> tuple[Any, ...]:
            k, (time, step, state), memory, steps_taken, output = carried
            piece, end = (cubics[k], values), jnp.minimum(time + step, length[k])
            solver = make_solver(end - time, state)
            moved, error, _, _, outcome = solver.step(term, time, end, state, piece, first, made_jump=True)
            sound = diffrax.is_okay(outcome) & jnp.isfinite(error).all() & jnp.isfinite(moved).all()
            error, moved = jnp.where(sound, error, jnp.inf), jnp.where(sound, moved, state)
            keep, now, then, _, memory, _ = control.adapt_step_size(
                time, end, state, moved, piece, error, order, memory
            )
            ended, state = keep & (end == length[k]), jnp.where(keep, moved, state)
            # The end of a piece shortens this step, but not the following ones.
            longer = ended & (then - now >= end - time)
            step = jnp.where(longer, jnp.maximum(step, then - now), then - now)
            position = jnp.where(ended, 0.0, now), step, state
            return k + ended, position, memory, steps_taken + 1, output.at[k].set(state)

        def has_steps_left_and_no_divergence(carried: tuple[Any, ...]) -> jax.Array:
            k, (_, _, state), _, steps_taken, _ = carried
            return (
                (length[k] > 0.0) & (steps_taken < _STEPS_PER_CALL) & (jnp.abs(state[0]) < DIVERGENCE * size)
            )

        output = jnp.zeros((len(length), len(start[2])))
        position = jax.tree.map(jnp.asarray, start)
        return jax.lax.while_loop(has_steps_left_and_no_divergence, advance, (0, position, memory, 0, output))

    return Compiled(solve, (equation, inputs, implicit))


def solve_law(
    law: Law,
    times: Float[np.ndarray, "n"],
    z0: float,
    v0: float,
    parameters: Sequence[float],
    size: float,
    inputs: Sequence[np.ndarray] = (),
    hidden: Sequence[float] = (),
    interpolation: Interpolation = "spline",
) -> Solution:
    """Return the motion of a law at times [s]; the tolerance is relative to ``size``, the amplitude.

    Along a prescribed stroke only the hidden states are computed; ``z0``, ``v0``, ``size`` are not used.
    """
    # Dopri8 (Prince and Dormand 1981, doi:10.1016/0771-050X(81)90010-3), and on stiff segments Kvaerno5
    # (Kvaerno 2004, doi:10.1023/B:BITN.0000046811.70614.38), with adaptive steps that end at the times.
    values, size = tuple(map(float, parameters)), 1.0 if law.prescribed else float(size)
    if law.prescribed and not law.hidden:
        return Solution(np.zeros((len(times), 0)), "complete")
    length, cubics = piecewise_cubics(times, list(inputs), interpolation)
    motion = () if law.prescribed else (z0, v0)
    state = np.array([*motion, *(hidden or (0.0,) * len(law.hidden))], dtype=np.float64)
    states = np.full((len(length) + 1, len(state)), np.nan)
    states[0] = state
    done, time, step, steps_taken = 0, 0.0, float(length[0]), 0
    rate, implicit, explicit_advance = 0.0, False, 0.0
    ending: Ending = "complete"
    while done < len(length):
        here = slice(done, done + _INTERVALS_PER_CALL)
        empty = (0, 1 + _INTERVALS_PER_CALL - len(length[here]))
        pieces = np.pad(length[here], empty), np.pad(cubics[here], (empty, (0, 0), (0, 0)))
        solve = _compile_adaptive_solver(law.equation, law.inputs, implicit=implicit)
        count, position, _, steps, output = solve((time, step, state), *pieces, values, size)
        before = length[:done].sum() + time
        k, state = int(count), np.asarray(position[2])
        states[done + 1 : done + 1 + k] = output[:k]
        done, time, step, steps_taken = (
            done + k,
            float(position[0]),
            float(position[1]),
            steps_taken + int(steps),
        )
        if not abs(state[0]) < DIVERGENCE * size:
            ending = "blow-up"
            break
        if steps < _STEPS_PER_CALL:
            continue
        total = length[:done].sum() + time
        fastest = _largest_eigenvalue_moduli(law, values, np.asarray(output)[: k + 1], cubics[here])
        rate, advance = max(rate, float(fastest.max())), total - before
        if implicit:
            implicit = advance > _IMPLICIT_COST * explicit_advance
        elif not explicit_advance and np.median(fastest) * advance > _STIFF_STEP * _STEPS_PER_CALL:
            implicit, explicit_advance = True, advance
        if advance <= _NO_PROGRESS * length.sum() or steps_taken > MAXIMUM_STEPS * (done + 1 + rate * total):
            ending = "steps"
            break
    every = len(length) // (len(times) - 1)
    if ending != "complete":
        states[done + 1 :] = np.nan
    return Solution(states[::every], ending)


def observed_signal(
    law: Law, observation: str, solution: Solution, parameters: Sequence[float], inputs: Sequence[np.ndarray]
) -> Float[np.ndarray, "n"]:
    """Return the observed signal of a law for a solution; inputs are given at the same times."""
    observe = compile_observation(law.equation, law.inputs, observation, "numpy")
    with np.errstate(all="ignore"):
        result = observe(*solution.states.T, *inputs, *parameters)
    return np.broadcast_to(np.asarray(result, dtype=np.float64), len(solution.states)).copy()


def _largest_eigenvalue_moduli(
    law: Law, values: States, states: Float[np.ndarray, "k n"], cubics: np.ndarray
) -> Float[np.ndarray, "m"]:
    """Return the largest modulus [1/s] of eigenvalues of a law's Jacobian at given states; zero at a jump."""
    slopes = compile_jacobian(law.equation, law.inputs)
    seen = np.unique(np.linspace(0, len(states) - 1, _SAMPLED_STATES).astype(int))
    velocity = [] if law.prescribed else [np.eye(states.shape[1])[1]]
    matrices = [np.vstack([*velocity, slopes(*states[k], *cubics[k, 0], *values)]) for k in seen]
    return np.abs(np.linalg.eigvals(np.nan_to_num(matrices, posinf=0.0, neginf=0.0))).max(axis=1)


def compile_solution_ahead(law: Law) -> None:
    """Compile the programs of `solve_law` for a law without inputs, before they are needed."""
    length, cubics = np.zeros(1 + _INTERVALS_PER_CALL), np.zeros((1 + _INTERVALS_PER_CALL, 4, 0))
    start, values = (0.0, 0.0, np.zeros(2 + len(law.hidden))), (0.0,) * len(law.parameters)
    _compile_adaptive_solver(law.equation, ()).compile_ahead(start, length, cubics, values, 0.0)
