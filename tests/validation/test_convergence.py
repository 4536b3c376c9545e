"""The measurement of orders, on errors of known law, on controls, on the toolkit, and in a root."""

from __future__ import annotations

import numpy as np
import pytest

from granular.linear import root_of_steps
from granular.methods import METHODS
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from validation import exact_solution
from validation.convergence_order import (
    STEEP_IN_ROOT,
    Solver,
    convergence,
    convergence_tasks,
    method_name_to_plot,
    method_suits_problem,
    root_convergence,
    settled_root,
)
from validation.convergence_result import (
    BED_ROOT,
    CLEAR,
    convergence_holds,
    convergence_table,
    fit_convergence_slope,
)
from validation.exact_problems import NAMES, ExactProblem, GrainStates, exact_problem

STEPS = tuple(0.1 * 2.0 ** (-k / 2) for k in range(13))


@pytest.mark.parametrize("order", [1, 2, 4, 6, 8])
def test_slope_of_a_known_law(order: int) -> None:
    fit = fit_convergence_slope(STEPS, [3.0 * h**order for h in STEPS], 1e-30)
    assert fit is not None
    assert fit.value == pytest.approx(order, abs=1e-9)
    assert STEPS[fit.first] / STEPS[fit.last] >= 10.0 - 1e-6
    assert fit.last == len(STEPS) - 1


def test_rounding_is_left_out_of_the_fit() -> None:
    random = np.random.default_rng(5)
    rounding = 1e-9
    errors = [h**4 + rounding * abs(random.standard_normal()) for h in STEPS]
    assert errors[-1] < 2.0 * errors[-2]  # the finest are rounding alone
    fit = fit_convergence_slope(STEPS, errors, rounding)
    assert fit is not None
    assert errors[fit.last] > CLEAR * rounding
    assert fit.last < len(STEPS) - 4
    assert fit.value == pytest.approx(4.0, abs=0.05)
    long = tuple(0.1 * 2.0 ** (-k / 2) for k in range(20))
    errors = [h**2 + rounding * abs(random.standard_normal()) for h in long]
    fit = fit_convergence_slope(long, errors, rounding)
    assert fit is not None
    assert long[fit.last] ** 2 > (CLEAR - 4.0) * rounding
    assert fit.value == pytest.approx(2.0, abs=0.02)


def test_an_error_that_stays_has_no_order() -> None:
    fit = fit_convergence_slope(STEPS, [h**2 + 1e-2 for h in STEPS], 1e-12)
    assert fit is not None
    assert abs(fit.value) < 0.3


def plain_verlet(*, smuggled: bool = False, gravity: float = 1.0) -> Solver:
    """Verlet in plain Python for one grain over the wall or with drag; with slips on demand."""

    def solve(problem: ExactProblem, count: int) -> GrainStates:
        scales, effects = Scales.from_grains(problem.scene.grains), problem.scene.effects
        weight = effects.gravity.acceleration / scales.acceleration if effects.gravity else 0.0
        rate = effects.drag.decay_rate(scales) if effects.drag else 0.0
        plan = problem.scene.arrangement
        x = np.array(plan.positions[0]) / scales.length
        v = np.zeros(2) if plan.velocities is None else np.array(plan.velocities[0])
        v = v / scales.velocity
        h = problem.time / scales.time / count
        decay = np.exp(-0.5 * h * rate)

        def kick(v: np.ndarray, x: np.ndarray) -> np.ndarray:
            wall = 0.5 * x[1] ** -3.5 if effects.walls else 0.0
            force = np.array([0.0, wall - gravity * weight])
            if smuggled:
                return v + 0.5 * h * (force - rate * v)
            return decay * v + 0.5 * h * force

        for _ in range(count):
            v = kick(v, x)
            x = x + h * v
            v = kick(v, x)
        return GrainStates(x[None] * scales.length, v[None] * scales.velocity)

    return solve


def test_a_sound_solver_shows_its_order() -> None:
    counts = [round(64 * 2.0 ** (k / 2)) for k in range(8)]
    problem = exact_problem("oscillation")
    result = convergence(problem, "verlet", counts, solver=plain_verlet(), order=2)
    assert result.fit is not None
    assert result.fit.value == pytest.approx(2.0, abs=0.01)
    assert result.shows_declared_order(0.02)


def test_counts_may_be_given_in_any_order() -> None:
    counts = [round(64 * 2.0 ** (k / 2)) for k in range(8)]
    problem = exact_problem("oscillation")
    fits = [
        convergence(problem, "verlet", given, solver=plain_verlet(), order=2).fit
        for given in (counts, counts[::-1], [*counts[4:], *counts[:4]])
    ]
    assert fits[0] is not None
    assert fits[0] == fits[1] == fits[2]


def test_controls_are_told_apart() -> None:
    counts = [round(64 * 2.0 ** (k / 2)) for k in range(8)]
    drag = exact_problem("drag")
    smuggled = convergence(drag, "smuggled", counts, solver=plain_verlet(smuggled=True), order=2)
    assert smuggled.fit is not None
    assert smuggled.fit.value == pytest.approx(1.0, abs=0.1)
    assert not smuggled.shows_declared_order(0.3)
    problem = exact_problem("oscillation")
    wrong = convergence(problem, "wrong", counts, solver=plain_verlet(gravity=1.0001), order=2)
    assert not wrong.shows_declared_order(0.3)


def test_too_few_steps_show_no_order() -> None:
    counts = (64, 80, 96, 112)
    problem = exact_problem("oscillation")
    result = convergence(problem, "verlet", counts, solver=plain_verlet(), order=2)
    assert result.fit is None  # less than half a decade
    with pytest.raises(InputError, match="each at least 2"):
        convergence(problem, "verlet", [], solver=plain_verlet(), order=2)
    assert len(convergence_table([result]).rows[0]) == len(convergence_table([result]).header)
    assert len(result.table().rows) == len(counts)
    table = result.to_dataframe()
    assert list(table) == ["step", "error", "slope", "seconds"]
    assert table["slope"][1] == result.local_slopes[0]


def test_toolkit_on_the_oscillation() -> None:
    problem = exact_problem("oscillation")
    result = convergence(problem, "stormer-verlet")
    assert result.fit is not None
    assert result.fit.value == pytest.approx(2.0, abs=0.01)
    assert result.steps[result.fit.first] / result.steps[result.fit.last] >= 10.0 - 1e-6


def test_free_fall_is_exact() -> None:
    result = convergence(exact_problem("free-fall"), "stormer-verlet")
    assert result.is_exact
    assert result.shows_declared_order(0.0)
    assert max(result.errors) < 1e-13


TOLERANCE = {1: 0.02, 2: 0.02, 4: 0.1, 6: 0.1, 8: 0.3}


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", NAMES)
def test_every_method_has_its_order(name: str, method: str) -> None:
    problem = (
        exact_solution.bounce_problem(time=exact_solution.SHORT) if name == "bounce" else exact_problem(name)
    )
    if not method_suits_problem(problem, method):
        pytest.skip("does not suit the problem")
    result = convergence(problem, method_name_to_plot(method))
    if not problem.smooth:  # the stop limits the order to two
        assert result.fit is not None
        assert result.fit.value == pytest.approx(min(2, METHODS[method].order), abs=0.1)
        return
    order = METHODS[method].order
    if order > 6 and result.fit is None:
        # Errors of order eight are rounding before they have fallen for half a decade of steps.
        assert min(result.errors) < 1e-14
        return
    assert result.shows_declared_order(TOLERANCE[order]), str(convergence_table([result]))
    if order <= 6 and not result.is_exact:
        assert result.decades_of_fit > 0.99


EQUAL = [name for name, method in METHODS.items() if not method.variable and name not in STEEP_IN_ROOT]


QUICK = "stormer-verlet"


@pytest.mark.parametrize(
    "method", [QUICK, *(pytest.param(name, marks=pytest.mark.long) for name in EQUAL if name != QUICK)]
)
def test_each_method_has_its_order_in_the_root(method: str) -> None:
    result = root_convergence(method)
    assert result.fit is not None
    assert convergence_holds(result), (result.fit, str(result.table()))


def test_a_wrong_root_shows_no_order() -> None:
    exact = settled_root("stormer-verlet")[1].s
    wrong = root_convergence("stormer-verlet", exact * (1.0 + 1e-4))
    assert wrong.fit is not None
    assert not convergence_holds(wrong)
    assert not wrong.shows_declared_order(0.3)


def test_all_methods_of_equal_steps_are_in_the_full_report() -> None:
    tasks = [task for task in convergence_tasks(full=True) if task.key["problem"] == BED_ROOT]
    assert [task.key["method"] for task in tasks] == EQUAL


def test_a_method_that_takes_no_drag_is_refused() -> None:
    rest, root = settled_root("stormer-verlet")
    with pytest.raises(InputError, match="takes no drag"):
        root_of_steps(rest, root, 1e-3, "runge-kutta-4")
