"""Exact solutions compared with independent solutions of the same motion and with external integrators."""

from collections.abc import Callable

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import Scene, evaluate
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from validation.exact_problems import NAMES, ExactProblem, exact_problem
from validation.exact_solution import (
    bounce_period,
    bounce_problem,
    bounce_scene,
    equilibrium_height_above_wall,
    harmonic_period,
    natural_units,
    oscillation_problem,
    position_after_upper_turning,
    potential_turning_points_and_units_of_well,
    speed_from_energy,
)
from validation.external_integrators import (
    ORDERS,
    initial_state_and_scales,
    make_equations_of_motion,
    make_external_solver,
    solve_adaptively,
)
from validation.hard_case import head_on_collision

Force = Callable[[float, np.ndarray, np.ndarray, ExactProblem, Scales], np.ndarray]


def weight(problem: ExactProblem, scales: Scales) -> float:
    return problem.scene.effects.gravity.acceleration / scales.acceleration


def free_fall(_: float, x: np.ndarray, __: np.ndarray, problem: ExactProblem, s: Scales) -> np.ndarray:
    return np.array([[0.0, -weight(problem, s)]])


def bounce(_: float, x: np.ndarray, __: np.ndarray, problem: ExactProblem, s: Scales) -> np.ndarray:
    return np.array([[0.0, 0.5 * x[0, 1] ** -3.5 - weight(problem, s)]])


def scattering(_: float, x: np.ndarray, __: np.ndarray, *___: object) -> np.ndarray:
    apart = x[0] - x[1]
    push = 0.75 * apart / np.linalg.norm(apart) ** 5
    return np.stack([push, -push])


def drag(_: float, __: np.ndarray, v: np.ndarray, problem: ExactProblem, s: Scales) -> np.ndarray:
    return -problem.scene.effects.drag.coefficient * s.time / s.mass * v


def driven_piston(t: float, x: np.ndarray, __: np.ndarray, problem: ExactProblem, s: Scales) -> np.ndarray:
    move = problem.scene.protocol[0]
    start = problem.scene.piston.height
    height = start + (move.prescribed_final_height() - start) * t * s.time / move.maximum_duration(start)
    return np.array([[0.0, -0.5 * (height / s.length - x[0, 1]) ** -3.5]])


FORCES: dict[str, Force] = {
    "free-fall": free_fall,
    "bounce": bounce,
    "oscillation": bounce,
    "scattering": scattering,
    "drag": drag,
    "driven-piston": driven_piston,
}


@pytest.mark.parametrize("name", FORCES)
def test_the_exact_motion_agrees_with_an_adaptive_integration(name: str) -> None:
    problem = exact_problem(name)
    scales, plan = Scales.from_grains(problem.scene.grains), problem.scene.arrangement
    place = np.array(plan.positions) / scales.length
    velocity = (
        np.zeros_like(place) if plan.velocities is None else np.array(plan.velocities) / scales.velocity
    )
    count = place.size

    def motion(t: float, state: np.ndarray) -> np.ndarray:
        x, v = state[:count].reshape(-1, 2), state[count:].reshape(-1, 2)
        return np.concatenate([state[count:], FORCES[name](t, x, v, problem, scales).ravel()])

    # The bounce is compared at an earlier time: errors grow with the number of bounces.
    time = 0.45 if name == "bounce" else problem.time
    start = np.concatenate([place.ravel(), velocity.ravel()])
    end = solve_ivp(motion, (0.0, time / scales.time), start, "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    exact = problem.exact(time)
    assert end[:count].reshape(-1, 2) * scales.length == pytest.approx(exact.positions, rel=1e-10)
    fastest = np.abs(exact.velocities).max()
    assert end[count:].reshape(-1, 2) * scales.velocity == pytest.approx(exact.velocities, abs=1e-9 * fastest)


@pytest.mark.parametrize("name", NAMES)
def test_the_exact_motion_has_the_initial_state_at_time_zero(name: str) -> None:
    problem = exact_problem(name)
    plan = problem.scene.arrangement
    begin = problem.exact(0.0)
    assert begin.positions == pytest.approx(np.array(plan.positions), rel=1e-15)
    velocity = np.zeros_like(begin.velocities) if plan.velocities is None else plan.velocities
    assert begin.velocities == pytest.approx(np.array(velocity), abs=1e-15)


@pytest.mark.long  # quick: a bounce that returns, and external integrators that reach the exact motion
def test_quadrature_agrees_with_a_taylor_series_to_25_digits() -> None:
    scene = bounce_scene(3.0, 0.05)
    with mpmath.workdps(40):
        potential, low, high, _ = potential_turning_points_and_units_of_well(scene)
        time = mpmath.mpf(12)
        gravity = (potential(high) - high ** mpmath.mpf(-2.5) / 5) / high
        series = mpmath.odefun(
            lambda _, s: [s[1], s[0] ** mpmath.mpf(-3.5) / 2 - gravity], 0, [high, mpmath.mpf(0)]
        )
        place, velocity = series(time)
        exact = position_after_upper_turning(potential, low, high, time)
        assert abs(place - exact) < mpmath.mpf(10) ** -25
        assert abs(abs(velocity) - speed_from_energy(potential, potential(high), exact)) < 1e-25


def test_a_bouncing_grain_returns_after_its_period() -> None:
    problem = exact_problem("bounce")
    period = float(bounce_period(problem.scene))
    assert 0.40 < period < 0.42  # approximately twice the time of a fall of 0.2 m
    for time in (0.05, 0.31):
        now, later = problem.exact(time), problem.exact(time + 3.0 * period)
        assert later.positions == pytest.approx(now.positions, rel=1e-13)
        assert later.velocities == pytest.approx(now.velocities, abs=1e-12)


def test_the_first_bounce_agrees_with_de_paula() -> None:
    """[D, 2.3.4]: the grain falls from 40 D = 0.2 m and turns after about 0.2 s."""
    scene = exact_problem("bounce").scene
    with mpmath.workdps(30):
        low = float(potential_turning_points_and_units_of_well(scene)[1])
    assert float(bounce_period(scene)) / 2.0 == pytest.approx(0.2, abs=0.005)
    assert low == pytest.approx((5.0 * 0.0017897 * 38.5) ** -0.4, rel=2e-3)


def test_small_oscillation_has_the_harmonic_period_with_amplitude_correction() -> None:
    """The relative error of the harmonic period is (9/16) A^2, for A relative to the equilibrium height.

    After the correction, the error decreases like A^4.
    """

    def misses(start: float) -> tuple[float, float, float]:
        scene = oscillation_problem(start).scene
        with mpmath.workdps(50):
            _, low, high, _ = potential_turning_points_and_units_of_well(scene)
            amplitude = float((high - low) / 2 / equilibrium_height_above_wall(scene))
        exact = float(bounce_period(scene))
        harmonic, corrected = (harmonic_period(scene, a) for a in (0.0, amplitude))
        return amplitude, exact / harmonic - 1.0, exact / corrected - 1.0

    large, plain, corrected = misses(0.04)
    small, plain_small, corrected_small = misses(0.01)
    assert plain_small / small**2 == pytest.approx(9.0 / 16.0, rel=1e-3)
    assert plain / large**2 == pytest.approx(9.0 / 16.0, rel=1e-2)
    assert corrected / corrected_small == pytest.approx((large / small) ** 4, rel=0.05)


def test_friction_over_the_sliding_distance_dissipates_the_kinetic_energy() -> None:
    problem = exact_problem("sliding")
    law, scales = problem.scene.effects.friction, Scales.from_grains(problem.scene.grains)
    assert problem.time > 0.5 * scales.mass / (law.dynamic * law.load)  # v0 m/(mu_d N)
    end = problem.exact(problem.time)
    way = np.linalg.norm(end.positions[0] - np.array(problem.scene.arrangement.positions)[0])
    assert law.dynamic * law.load * way == pytest.approx(0.5 * scales.mass * 0.5**2, rel=1e-12)
    assert (end.velocities == 0.0).all()


def test_scattering_of_a_pair_conserves_energy_and_angular_momentum() -> None:
    problem = exact_problem("scattering")
    scales = Scales.from_grains(problem.scene.grains)

    def kept(time: float) -> tuple[float, float]:
        now = problem.exact(time)
        x, v = now.positions / scales.length, now.velocities / scales.velocity
        apart, relative = x[1] - x[0], v[1] - v[0]
        energy = 0.5 * (v**2).sum() + 0.25 / np.linalg.norm(apart) ** 3
        return energy, apart[0] * relative[1] - apart[1] * relative[0]

    energy, momentum = kept(0.0)
    for time in (0.4, 0.5, 0.7, 1.0):
        now = kept(time * problem.time)
        assert now == pytest.approx((energy, momentum), rel=1e-13)


def test_natural_units_of_the_exact_problems_agree_with_the_engine() -> None:
    grains = exact_problem("bounce").scene.grains
    scales = Scales.from_grains(grains)
    with mpmath.workdps(30):
        units = natural_units(grains)
    for name in ("length", "mass", "force", "time"):
        assert float(getattr(units, name)) == pytest.approx(getattr(scales, name), rel=4e-16)


def test_the_error_for_an_unknown_problem_suggests_the_nearest_name() -> None:
    with pytest.raises(InputError, match="did you mean 'bounce'"):
        exact_problem("bouncy")
    with pytest.raises(InputError, match="below 6 D"):
        head_on_collision(6.0)


def test_forces_for_external_integrators_agree_with_the_toolkit(small_bed: Scene) -> None:
    """Pairs, four walls and weight are implemented twice; drag is tested by its exact problem."""
    scene = small_bed.replace(**{"effects.drag": None})
    (begin, scales), count = initial_state_and_scales(scene), scene.grains.count
    motion = make_equations_of_motion(scene)(0.0, begin)[2 * count :].reshape(-1, 2)
    force = evaluate(scene, *scene.initial_positions_and_velocities()).force
    assert motion * scales.force == pytest.approx(force, rel=1e-11, abs=1e-18)


@pytest.mark.parametrize(
    ("problem", "name"),
    [
        pytest.param(problem, name, marks=pytest.mark.long if (place + number) % 2 else ())
        for place, problem in enumerate(("oscillation", "scattering", "drag"))
        for number, name in enumerate(ORDERS)
    ],
)
def test_external_integrators_with_fixed_steps_reach_the_exact_motion(name: str, problem: str) -> None:
    one = exact_problem(problem)
    exact = one.exact(one.time)
    errors = [
        np.abs(make_external_solver(name)(one, count).positions - exact.positions).max()
        for count in (one.fewest_steps, 2 * one.fewest_steps)
    ]
    assert errors[1] < 0.1 * errors[0] < 1e-8
    found = make_external_solver(name)(one, one.fewest_steps)
    assert found.steps == one.fewest_steps
    assert found.velocities == pytest.approx(exact.velocities, abs=1e-5)


@pytest.mark.parametrize("name", ORDERS)
def test_errors_of_external_adaptive_solvers_decrease_with_their_tolerance(name: str) -> None:
    problem = bounce_problem()
    exact = problem.exact(0.5).positions / Scales.from_grains(problem.scene.grains).length
    errors = []
    for tolerance in (1e-6, 1e-9, 1e-12):
        found = solve_adaptively(name, problem.scene, 0.5, tolerance).positions
        errors.append(np.abs(found / Scales.from_grains(problem.scene.grains).length - exact).max())
    assert errors[2] < 1e-8
    assert errors[0] > 10.0 * errors[1] > 100.0 * errors[2]


def test_scenes_that_external_integrators_do_not_support_are_refused(small_bed: Scene) -> None:
    with pytest.raises(InputError, match="they need grains of one kind"):
        initial_state_and_scales(small_bed.replace(**{"effects.friction": {}}))
