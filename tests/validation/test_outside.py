"""Outside references: their forces are the toolkit's, and they reach the same exact motion."""

from __future__ import annotations

import numpy as np
import pytest

from granular import Scene, evaluate
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from validation import exact_solution
from validation.exact_problems import exact_problem
from validation.external_integrators import (
    ORDERS,
    equations_of_motion,
    external_solver,
    initial_state,
    solve_adaptively,
)


def test_forces_are_those_of_the_toolkit(small_bed: Scene) -> None:
    """Pairs, four walls and weight, written twice; drag is left to the exact problem."""
    scene = small_bed.replace(**{"effects.drag": None})
    begin, count = initial_state(scene), scene.grains.count
    motion = equations_of_motion(scene)(0.0, begin.state)[2 * count :].reshape(-1, 2)
    force = evaluate(scene, *scene.initial_positions_and_velocities()).force
    assert motion * begin.scales.force == pytest.approx(force, rel=1e-11, abs=1e-18)


@pytest.mark.parametrize(
    ("problem", "name"),
    [
        pytest.param(problem, name, marks=pytest.mark.long if (place + number) % 2 else ())
        for place, problem in enumerate(("oscillation", "scattering", "drag"))
        for number, name in enumerate(ORDERS)
    ],
)
def test_equal_steps_reach_the_exact_motion(name: str, problem: str) -> None:
    one = exact_problem(problem)
    exact = one.exact(one.time)
    errors = [
        np.abs(external_solver(name)(one, count).positions - exact.positions).max()
        for count in (one.fewest_steps, 2 * one.fewest_steps)
    ]
    assert errors[1] < 0.1 * errors[0] < 1e-8
    found = external_solver(name)(one, one.fewest_steps)
    assert found.steps == one.fewest_steps
    assert found.velocities == pytest.approx(exact.velocities, abs=1e-5)


@pytest.mark.parametrize("name", ORDERS)
def test_tolerance_sets_the_error(name: str) -> None:
    problem = exact_solution.bounce_problem()
    exact = problem.exact(0.5).positions / Scales.from_grains(problem.scene.grains).length
    errors = []
    for tolerance in (1e-6, 1e-9, 1e-12):
        found = solve_adaptively(name, problem.scene, 0.5, tolerance).positions
        errors.append(np.abs(found / Scales.from_grains(problem.scene.grains).length - exact).max())
    assert errors[2] < 1e-8
    assert errors[0] > 10.0 * errors[1] > 100.0 * errors[2]


def test_what_is_left_out_is_refused(small_bed: Scene) -> None:
    with pytest.raises(InputError, match="needs it without"):
        initial_state(small_bed.replace(**{"effects.friction": {}}))
