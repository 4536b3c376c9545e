"""External references: third-party integrators with separately written forces.

SciPy's DOP853 (Hairer, Norsett and Wanner 1993, II.5) and diffrax's Tsit5 (Tsitouras 2011,
doi:10.1016/j.camwa.2011.06.002) use neither the time loop nor the forces of the toolkit. The forces here are
sums over complete arrays ([D, eqs 2.6 and 2.8], as in `granular.effects`). Both integrators are explicit
Runge-Kutta methods with an error estimate, and are not symplectic.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from granular.protocol import Hold
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.shared.array_types import Float
from granular.shared.errors import InputError
from validation.exact_solution import ExactProblem, GrainStates

SCIPY, DIFFRAX = "SciPy DOP853", "diffrax Tsit5"
ORDERS = {SCIPY: 8, DIFFRAX: 5}
"""External integrators and their orders."""

# Beyond this number of steps diffrax ends a run with an error, which the report shows, instead of taking very
# long.
MOST_STEPS = 2**20

Rate = Callable[[Any, Any], Any]
"""Function d(state)/dt of a time and a state (4 n,) in natural units; positions precede velocities."""


def supports_scene(scene: Scene) -> bool:
    """Return True if the external integrators support all parts of the scene."""
    effects = scene.effects
    others = (effects.friction, effects.contact, effects.shaking)
    walls = effects.walls
    laws = [] if walls is None else [wall.law for _, wall in walls.sides_with_walls]
    return (
        not any(others)
        and len(scene.grains.species) == 1
        and all(law == "experimental" for law in laws)
        and (scene.piston is None or isinstance(scene.protocol[0], Hold))
    )


def initial_state_and_scales(scene: Scene) -> tuple[Float[np.ndarray, "4n"], Scales]:
    """Return initial positions [D] and velocities [D/tau] for an external integrator, and the scales."""
    if not supports_scene(scene):
        raise InputError(
            f"scene {scene.name!r} has parts that external integrators do not support; they need grains of "
            f"one kind, pair forces, experimental walls, weight, drag and a held piston"
        )
    scales = Scales.from_grains(scene.grains)
    positions, velocities = scene.initial_positions_and_velocities()
    state = [positions / scales.length, velocities / scales.velocity]
    return np.concatenate([part.ravel() for part in state]), scales


def make_equations_of_motion(scene: Scene, arrays: Any = np) -> Rate:
    """Make the equations of motion of a scene in natural units, in NumPy or ``jax.numpy``."""
    # Pairs repel by (3/4)/r^4, walls by (1/2) w^-3.5 [D, eqs 2.6 and 2.8], independently of the engine.
    scales, effects, count = Scales.from_grains(scene.grains), scene.effects, scene.grains.count
    weight = effects.gravity.acceleration / scales.acceleration if effects.gravity else 0.0
    decay = effects.drag.coefficient * scales.time / scales.mass if effects.drag else 0.0
    alone = np.eye(count)

    def pair_forces(x: Any) -> Any:
        apart = x[:, None] - x[None]
        square = (apart**2).sum(axis=2) + alone
        fall = (1.0 - alone) / (square * square * arrays.sqrt(square))
        return 0.75 * (apart * fall[:, :, None]).sum(axis=1)

    walls = _wall_planes(scene, scales)

    def state_rates(_: Any, state: Any) -> Any:
        x, v = state[: 2 * count].reshape(-1, 2), state[2 * count :].reshape(-1, 2)
        a = -decay * v - weight * np.array([0.0, 1.0])
        if effects.dipole is not None and count > 1:
            a = a + pair_forces(x)
        for normal, point in walls:
            push = 0.5 * ((x - point) @ normal) ** -3.5
            a = a + push[:, None] * normal
        return arrays.concatenate([v.ravel(), a.ravel()])

    return state_rates


def _wall_planes(scene: Scene, scales: Scales) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the inward normal of each wall and a point [D] on the wall."""
    walls, height = scene.effects.walls, 0.0 if scene.piston is None else scene.piston.height
    walled = set() if walls is None else {side for side, _ in walls.sides_with_walls}
    return [
        (np.array(line.normal), np.array(line.origin(height)) / scales.length)
        for line in scene.cell.lines
        if line.name in walled
    ]


def make_external_solver(name: str) -> Callable[[ExactProblem, int], GrainStates]:
    """Make an external integrator with equal steps, to measure its order of convergence."""
    solve = _solve_with_scipy if name == SCIPY else _solve_with_diffrax

    def solve_with_equal_steps(problem: ExactProblem, count: int) -> GrainStates:
        return solve(problem.scene, problem.time, count, None)

    return solve_with_equal_steps


def solve_adaptively(name: str, scene: Scene, time: float, tolerance: float) -> GrainStates:
    """Integrate a scene up to a time [s] by an external integrator that adapts its steps to a tolerance."""
    solve = _solve_with_scipy if name == SCIPY else _solve_with_diffrax
    return solve(scene, time, None, tolerance)


def _grain_states_from_vector(state: np.ndarray, scales: Scales, steps: int) -> GrainStates:
    positions, velocities = np.split(np.asarray(state), 2)
    return GrainStates(
        positions.reshape(-1, 2) * scales.length, velocities.reshape(-1, 2) * scales.velocity, steps
    )


def _solve_with_scipy(scene: Scene, time: float, count: int | None, tolerance: float | None) -> GrainStates:
    from scipy.integrate import DOP853

    begin, scales = initial_state_and_scales(scene)
    until = time / scales.time
    if count is not None:
        # Every step meets this tolerance, so all steps have the maximum length, which also covers the last
        # step's remainder.
        longest = until / count * (1.0 + 1e-12)
        options = {"first_step": until / count, "max_step": longest, "rtol": 1e6, "atol": 1e6}
    else:
        assert tolerance is not None
        options = {"max_step": math.inf, "rtol": tolerance, "atol": tolerance}
    steps = 0
    with np.errstate(invalid="ignore"):  # a trial step may cross a wall; the error estimate rejects it
        run = DOP853(make_equations_of_motion(scene), 0.0, begin, until, **options)
        while run.status == "running":
            run.step()
            steps += 1
    return _grain_states_from_vector(run.y, scales, steps)


_SOLVES: dict[str, Any] = {}
"""Solvers compiled by JAX, one for each set of forces and kind of step."""


def _solve_with_diffrax(scene: Scene, time: float, count: int | None, tolerance: float | None) -> GrainStates:
    begin, scales = initial_state_and_scales(scene)
    until = time / scales.time
    parts = (scene.grains, scene.effects, scene.cell, scene.piston, count is None)
    if repr(parts) not in _SOLVES:
        _SOLVES[repr(parts)] = _compile_diffrax_solver(scene, equal=count is not None)
    given = tolerance if count is None else until / count
    state, steps = _SOLVES[repr(parts)](begin, until, given)
    return _grain_states_from_vector(state, scales, int(steps))


def _compile_diffrax_solver(scene: Scene, *, equal: bool) -> Any:
    """Compile a solver that maps state, time and step (or tolerance) to final state and number of steps."""
    from reduced_models.jax_setup import jax, Compiled  # sets double precision; isort: skip
    import diffrax

    motion = make_equations_of_motion(scene, jax.numpy)
    term = diffrax.ODETerm(lambda t, state, _: motion(t, state))

    def solve(state: Any, until: Any, given: Any) -> Any:
        control = diffrax.ConstantStepSize() if equal else diffrax.PIDController(rtol=given, atol=given)
        result = diffrax.diffeqsolve(
            term,
            diffrax.Tsit5(),
            0.0,
            until,
            given if equal else None,
            state,
            stepsize_controller=control,
            max_steps=MOST_STEPS,
            adjoint=diffrax.ForwardMode(),
        )
        assert result.ys is not None
        return result.ys[-1], result.stats["num_steps"]

    return Compiled(solve)
